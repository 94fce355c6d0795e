// SPDX-License-Identifier: Apache-2.0
#include "filter_states.h"

#include "regressor.h"
#include "robot.h"

enum { N = 46, XI = IPE_NP, PATTERN = IPE_NP + 27, WANDER = PATTERN + 6 };

static ipe_config_t config;
static ipe_filter_states_t states;
static double Y[IPE_NY][IPE_NP], X[IPE_NY][IPE_XI_MAX], F[8][3], H[IPE_NY * IPE_NX_MAX];

/// A window with cable forces F, everything else arbitrary.
void setUp(void)
{
    uint64_t seed = 11;
    config = cogiro();
    config.std_attitude = 1e-3, config.std_geometry = 2e-3, config.std_attitude_wander = 3e-3;
    for (int i = 0; i < 8; ++i) { config.force_gain[i] = 0.01 * i; }
    fill_normal(&seed, &Y[0][0], IPE_NY * IPE_NP);
    fill_normal(&seed, &X[0][0], IPE_NY * IPE_XI_MAX);
    fill_normal(&seed, &F[0][0], 24);
    for (int i = 0; i < 8; ++i) {
        F[i][2] += 3.0;
        for (int j = 0; j < 3; ++j) { X[j][IPE_XI_FORCE + 8 + i] = -F[i][j] / (1.0 + config.force_gain[i]); }
    }
    ipe_filter_states_init(&states, &config);
}

void tearDown(void)
{
}

static void test_std_are_the_configured_ones_and_never_zero(void)
{
    double std[IPE_NX_MAX - IPE_NP];
    config.std_world_yaw = 0.0;                           // given
    ipe_filter_states_std(&states.layout, &config, std);  // when
    TEST_ASSERT_EQUAL_INT(N, states.layout.n);            // then
    TEST_ASSERT_EQUAL_DOUBLE(config.std_attitude, std[0]);
    TEST_ASSERT_TRUE(std[IPE_XI_YAW] > 0.0);
    for (int i = 0; i < 6; ++i) { TEST_ASSERT_EQUAL_DOUBLE(2e-3, std[PATTERN - IPE_NP + i]); }
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_EQUAL_DOUBLE(3e-3, std[WANDER - IPE_NP + i]); }
}

static void test_layout_has_every_block_once_and_in_order(void)
{
    for (int m = 1; m <= IPE_CABLES_MAX; ++m) {
        config.n_cables = m;
        ipe_filter_states_init(&states, &config);  // when
        const ipe_filter_layout_t* at = &states.layout;
        int n = 0;
        for (int b = 0; b < IPE_BLOCKS; ++b) {  // then
            TEST_ASSERT_EQUAL_INT(n, at->first[b]);
            TEST_ASSERT_NOT_NULL(ipe_filter_states_name((ipe_block_t)b));
            n += at->count[b];
        }
        TEST_ASSERT_EQUAL_INT(n, at->n);
        TEST_ASSERT_TRUE(at->n <= IPE_NX_MAX);
        TEST_ASSERT_EQUAL_INT(IPE_NP, at->first[IPE_BLOCK_ATTITUDE]);
        TEST_ASSERT_EQUAL_INT(IPE_NP + ipe_systematic_filter_count(m), at->first[IPE_BLOCK_PATTERN]);
        TEST_ASSERT_EQUAL_INT(m, at->count[IPE_BLOCK_FORCE_GAIN]);
    }
}

/// A robot without gains and wander: their columns are gone, the others are as they were.
static void test_rows_of_absent_blocks_are_not_there(void)
{
    double all[IPE_NY * IPE_NX_MAX];
    ipe_filter_states_rows(&states, &config, Y, X, all);
    ipe_filter_layout_t* at = &states.layout;  // given
    at->count[IPE_BLOCK_FORCE_GAIN] = at->count[IPE_BLOCK_WANDER] = 0;
    at->first[IPE_BLOCK_PATTERN] -= 8;
    at->n = N - 8 - 3;
    ipe_filter_states_rows(&states, &config, Y, X, H);  // when
    for (int j = 0; j < IPE_NY; ++j) {                  // then
        for (int i = 0; i < at->n; ++i) {
            const int was = i < at->first[IPE_BLOCK_PATTERN] ? i : i + 8;
            TEST_ASSERT_EQUAL_DOUBLE(all[j * N + was], H[j * at->n + i]);
        }
    }
}

static void test_rows_hold_regressor_systematic_columns_and_wander(void)
{
    ipe_filter_states_rows(&states, &config, Y, X, H);  // when
    for (int j = 0; j < IPE_NY; ++j) {                  // then
        TEST_ASSERT_EQUAL_MEMORY(Y[j], H + j * N, sizeof Y[j]);
        for (int i = 0; i < 27; ++i) { TEST_ASSERT_EQUAL_DOUBLE(-X[j][i], H[j * N + XI + i]); }
        for (int i = 0; i < 3; ++i) { TEST_ASSERT_EQUAL_DOUBLE(-X[j][IPE_XI_ATTITUDE + i], H[j * N + WANDER + i]); }
    }
}

static void test_rows_of_patterns_are_moments_of_misplaced_forces(void)
{
    uint64_t seed = 5;
    double c[6];
    fill_normal(&seed, c, 6);                           // given
    ipe_filter_states_rows(&states, &config, Y, X, H);  // when
    double moment[3] = {0.0};                           // then: what is measured lacks the moment of the displacements
    for (int i = 0; i < 8; ++i) {
        double away[3], part[3];
        for (int j = 0; j < 3; ++j) { away[j] = states.pattern[0][i] * c[j] + states.pattern[1][i] * c[3 + j]; }
        vec3_cross(away, F[i], part);
        vec3_axpy(moment, -1.0, part, moment);
    }
    for (int j = 0; j < IPE_NY; ++j) {
        double found = 0.0;
        for (int k = 0; k < 6; ++k) { found += H[j * N + PATTERN + k] * c[k]; }
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, j < 3 ? 0.0 : moment[j - 3], found);
    }
}

static void test_patterns_are_orthonormal_and_leave_out_the_pull_along_the_resultant(void)
{
    ipe_filter_states_rows(&states, &config, Y, X, H);  // when
    double up[3] = {0.0}, lift[8];
    for (int i = 0; i < 8; ++i) { vec3_axpy(up, 1.0, F[i], up); }
    for (int i = 0; i < 8; ++i) { lift[i] = vec3_dot(F[i], up); }
    for (int k = 0; k < IPE_PATTERNS; ++k) {  // then
        double square = 0.0, with_lift = 0.0, other = 0.0;
        for (int i = 0; i < 8; ++i) {
            square += states.pattern[k][i] * states.pattern[k][i];
            with_lift += states.pattern[k][i] * lift[i];
            other += states.pattern[k][i] * states.pattern[1 - k][i];
        }
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, square);
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, 0.0, with_lift);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, other);
    }
}

static void test_patterns_of_cables_without_force_are_zero(void)
{
    memset(X, 0, sizeof X);                             // given
    ipe_filter_states_rows(&states, &config, Y, X, H);  // when
    const ipe_filter_states_t none = {.t_ns = 0};       // then
    TEST_ASSERT_EQUAL_MEMORY(none.pattern, states.pattern, sizeof none.pattern);
}

static void test_predict_wander_fades_and_keeps_its_variance(void)
{
    double theta[IPE_NP] = {0.0}, P[IPE_NP][IPE_NP] = {{0.0}}, std[IPE_NX_MAX - IPE_NP];
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1.0; }
    ipe_filter_states_std(&states.layout, &config, std);
    ipe_rls_t rls;
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, theta, P, N - IPE_NP, std));
    double h[N];
    uint64_t seed = 9;
    fill_normal(&seed, h, N);
    ipe_rls_update_row(&rls, h, 3.0);  // given: correlated with everything
    const double before = rls.x[WANDER], known = rls.x[0];

    ipe_filter_states_predict(&states, &config, 1, &rls);
    ipe_filter_states_predict(&states, &config, 1 + 20000000000LL, &rls);  // when: a correlation time later

    TEST_ASSERT_DOUBLE_WITHIN(1e-15, exp(-1.0) * before, rls.x[WANDER]);   // then
    TEST_ASSERT_EQUAL_DOUBLE(known, rls.x[0]);
    ipe_filter_states_predict(&states, &config, 1 + 3600000000000LL, &rls);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-6, 3e-3, ipe_rls_std(&rls, WANDER + i)); }
    TEST_ASSERT_TRUE(ipe_rls_invariants_hold(&rls));
}

enum { OFFSET = IPE_NP + IPE_XI_FORCE, GAIN = OFFSET + 8 };

/// The states' covariance is share of what it is of the noise; f is measured with noise, which explains the innovation.
static void denoise_gains(double share, const double f[8], double noisy[IPE_CABLES_MAX])
{
    double L[IPE_NY][IPE_NY] = {{0.0}}, S[IPE_NY][IPE_NY] = {{0.0}}, innovation[IPE_NY] = {0.0};
    const double v[IPE_NY] = {0.2, -0.1, 0.3, 0.05, -0.2, 0.1};
    ipe_filter_states_rows(&states, &config, Y, X, H);
    for (int i = 0; i < IPE_NY; ++i) { L[i][i] = 2.0, S[i][i] = 4.0 * share; }
    for (int k = 0; k < 8; ++k) {
        noisy[k] = f[k];
        for (int j = 0; j < IPE_NY; ++j) { noisy[k] += H[j * N + OFFSET + k] * v[j]; }
        for (int j = 0; j < IPE_NY; ++j) { innovation[j] += H[j * N + OFFSET + k] * (noisy[k] - f[k]); }
    }
    ipe_filter_states_denoise_gain_columns(&states, noisy, innovation, (const double (*)[IPE_NY])S,
                                           (const double (*)[IPE_NY])L, H);
}

static void check_gains(const double f[8])
{
    for (int j = 0; j < IPE_NY; ++j) {
        for (int k = 0; k < 8; ++k) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-5, H[j * N + OFFSET + k] * f[k], H[j * N + GAIN + k]);
        }
    }
}

static const double TENSION[8] = {10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0};

static void test_denoised_gains_are_those_of_the_tensions_without_noise(void)
{
    double noisy[IPE_CABLES_MAX];
    denoise_gains(0.0, TENSION, noisy);  // given: states known, all of the innovation is noise; when
    check_gains(TENSION);                // then
}

static void test_denoised_gains_believe_the_tensions_where_the_states_are_unknown(void)
{
    double noisy[IPE_CABLES_MAX];
    denoise_gains(1e9, TENSION, noisy);  // given, when
    check_gains(noisy);                  // then
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_std_are_the_configured_ones_and_never_zero);
    RUN_TEST(test_layout_has_every_block_once_and_in_order);
    RUN_TEST(test_rows_of_absent_blocks_are_not_there);
    RUN_TEST(test_rows_hold_regressor_systematic_columns_and_wander);
    RUN_TEST(test_rows_of_patterns_are_moments_of_misplaced_forces);
    RUN_TEST(test_patterns_are_orthonormal_and_leave_out_the_pull_along_the_resultant);
    RUN_TEST(test_patterns_of_cables_without_force_are_zero);
    RUN_TEST(test_predict_wander_fades_and_keeps_its_variance);
    RUN_TEST(test_denoised_gains_are_those_of_the_tensions_without_noise);
    RUN_TEST(test_denoised_gains_believe_the_tensions_where_the_states_are_unknown);
    return UNITY_END();
}
