// SPDX-License-Identifier: Apache-2.0
#include "filter_states.h"

#include "regressor.h"
#include "robot.h"

/// Number of states, and first index of a block.
#define N (states.layout.n)
#define AT(block) (states.layout.first[block])
#define PATTERN AT(IPE_BLOCK_PATTERN)
#define WANDER AT(IPE_BLOCK_WANDER)

static ipe_config_t config;
static ipe_filter_states_t states;
static double Y[IPE_NY][IPE_NP], X[IPE_NY][IPE_XI_MAX], F[8][3], H[IPE_NY * IPE_NX_MAX], R[3][3];

/// A window with cable forces F, everything else arbitrary.
void setUp(void)
{
    uint64_t seed = 11;
    config = cogiro();
    config.std_attitude = 1e-3, config.std_geometry = 2e-3, config.std_attitude_wander = 3e-3;
    config.std_world_yaw = config.std_acc_bias = config.std_imu_alignment = config.std_position_delay = 0.1;
    config.std_force_delay = config.std_attitude_delay = config.std_imu_position = config.std_tracker_target = 0.2;
    config.std_force_offset = 5.0, config.std_force_gain = 0.01, config.std_friction = 0.02;
    config.std_external_force = 20.0, config.std_external_stiffness = 6.0;
    for (int i = 0; i < 8; ++i) { config.cable[i].weight_per_length = 1.0; }
    for (int i = 0; i < 8; ++i) { config.force_gain[i] = 0.01 * i; }
    fill_normal(&seed, &Y[0][0], IPE_NY * IPE_NP);
    fill_normal(&seed, &X[0][0], IPE_NY * IPE_XI_MAX);
    fill_normal(&seed, &F[0][0], 24);
    for (int i = 0; i < 8; ++i) {
        F[i][2] += 3.0;
        for (int j = 0; j < 3; ++j) { X[j][IPE_XI_FORCE + 8 + i] = -F[i][j] / (1.0 + config.force_gain[i]); }
    }
    const double turn[3] = {0.3, -0.2, 0.5};
    mat3_exp(turn, R);
    ipe_filter_states_init(&states, &config);
}

void tearDown(void)
{
}

static void test_std_are_the_configured_ones(void)
{
    double std[IPE_NX_MAX - IPE_NP];
    ipe_filter_states_std(&states, std);                            // when
    TEST_ASSERT_EQUAL_INT(IPE_NP + 20 + 6 + 8 + 7 + 1 + 6 + 3, N);  // then
    TEST_ASSERT_EQUAL_DOUBLE(1e-3, std[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, std[AT(IPE_BLOCK_CABLE_INERTIA) - IPE_NP]);
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_EQUAL_DOUBLE(20.0, std[AT(IPE_BLOCK_EXTERNAL_FORCE) - IPE_NP + i]);
        TEST_ASSERT_EQUAL_DOUBLE(6.0, std[AT(IPE_BLOCK_EXTERNAL_STIFFNESS) - IPE_NP + i]);
    }
    for (int i = 0; i < 7; ++i) { TEST_ASSERT_EQUAL_DOUBLE(0.01, std[AT(IPE_BLOCK_FORCE_GAIN) - IPE_NP + i]); }
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
        TEST_ASSERT_EQUAL_INT(m, at->count[IPE_BLOCK_FORCE_OFFSET]);
        TEST_ASSERT_EQUAL_INT(m - 1, at->count[IPE_BLOCK_FORCE_GAIN]);
    }
}

/// What is declared perfect is no state: its columns are gone, the others are as they were.
static void test_rows_of_absent_blocks_are_not_there(void)
{
    static double all[IPE_NY * IPE_NX_MAX];
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, all);
    const ipe_filter_layout_t full = states.layout;
    config.std_force_gain = config.std_attitude_wander = config.std_imu_position = 0.0;  // given
    config.std_external_force = config.std_external_stiffness = 0.0;
    ipe_filter_states_init(&states, &config);
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, H);  // when
    TEST_ASSERT_EQUAL_INT(full.n - 7 - 3 - 3 - 6, N);                           // then
    for (int b = 0; b < IPE_BLOCKS; ++b) {
        for (int j = 0; j < IPE_NY; ++j) {
            for (int i = 0; i < states.layout.count[b]; ++i) {
                TEST_ASSERT_EQUAL_DOUBLE(all[j * full.n + full.first[b] + i], H[j * N + states.layout.first[b] + i]);
            }
        }
    }
}

/// An attitude that is estimated here has an error of its own, however perfect the AHRS is declared.
static void test_an_estimated_attitude_wanders_whatever_is_declared(void)
{
    config.attitude_estimate = IPE_ATTITUDE_FUSED, config.position_source = IPE_POSITION_TRACKER;  // given
    config.std_attitude_wander = 0.0;
    ipe_filter_states_init(&states, &config);                                                      // when
    TEST_ASSERT_EQUAL_INT(3, states.layout.count[IPE_BLOCK_WANDER]);                               // then
    TEST_ASSERT_TRUE(states.std[IPE_BLOCK_WANDER] > 0.0);
    config.position_source = IPE_POSITION_FIXED;
    ipe_filter_states_init(&states, &config);
    TEST_ASSERT_EQUAL_INT(0, states.layout.count[IPE_BLOCK_WANDER]);
}

static void test_rows_hold_regressor_systematic_columns_and_wander(void)
{
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, H);  // when
    for (int j = 0; j < IPE_NY; ++j) {                                          // then
        double rub = 0.0;
        TEST_ASSERT_EQUAL_MEMORY(Y[j], H + j * N, sizeof Y[j]);
        for (int i = 0; i < 19; ++i) { TEST_ASSERT_EQUAL_DOUBLE(-X[j][i], H[j * N + IPE_NP + i]); }
        TEST_ASSERT_EQUAL_DOUBLE(-X[j][IPE_XI_CABLE_INERTIA], H[j * N + AT(IPE_BLOCK_CABLE_INERTIA)]);
        for (int i = 0; i < 8; ++i) {
            TEST_ASSERT_EQUAL_DOUBLE(-X[j][IPE_XI_FORCE + i], H[j * N + AT(IPE_BLOCK_FORCE_OFFSET) + i]);
            rub -= X[j][IPE_XI_FORCE + 16 + i];
        }
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, rub, H[j * N + AT(IPE_BLOCK_FRICTION)]);
        for (int i = 0; i < 3; ++i) {  // about W's axis i: R^T e_i in P axes
            const double along = X[j][0] * R[i][0] + X[j][1] * R[i][1] + X[j][2] * R[i][2];
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, -along, H[j * N + WANDER + i]);
        }
    }
}

/// The gains of all cables that some state of the filter stands for; that state only.
static void gains_of(int state, double xi[IPE_XI_MAX], double std[IPE_XI_MAX])
{
    static ipe_rls_t rls;
    double theta[IPE_NP] = {0.0}, P[IPE_NP][IPE_NP] = {{0.0}}, prior[IPE_NX_MAX - IPE_NP];
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1.0; }
    ipe_filter_states_std(&states, prior);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, theta, (const double (*)[IPE_NP])P, N - IPE_NP, prior));
    rls.x[AT(IPE_BLOCK_FORCE_GAIN) + state] = 1.0;
    ipe_filter_states_systematic(&states, &config, &rls, xi, std);
}

static void test_gains_sum_to_zero_and_their_rows_are_those_of_each_cable(void)
{
    double xi[IPE_XI_MAX], std[IPE_XI_MAX];
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, H);
    for (int k = 0; k < 7; ++k) {
        double sum = 0.0, square = 0.0;
        gains_of(k, xi, std);                        // when
        for (int i = 0; i < 8; ++i) { sum += xi[IPE_XI_FORCE + 8 + i], square += pow(xi[IPE_XI_FORCE + 8 + i], 2.0); }
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, 0.0, sum);  // then
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, 1.0, square);
        for (int j = 0; j < IPE_NY; ++j) {
            double expected = 0.0;
            for (int i = 0; i < 8; ++i) { expected -= X[j][IPE_XI_FORCE + 8 + i] * xi[IPE_XI_FORCE + 8 + i]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, expected, H[j * N + AT(IPE_BLOCK_FORCE_GAIN) + k]);
        }
    }
}

static void test_gains_are_as_unknown_as_declared_before_any_data(void)
{
    double xi[IPE_XI_MAX], std[IPE_XI_MAX];
    gains_of(0, xi, std);                                                                               // when
    for (int i = 0; i < 8; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.01, std[IPE_XI_FORCE + 8 + i]); }  // then
    for (int i = 0; i < 8; ++i) { TEST_ASSERT_EQUAL_DOUBLE(0.02, std[IPE_XI_FORCE + 16 + i]); }
    TEST_ASSERT_EQUAL_DOUBLE(0.0, std[IPE_XI_GYRO_BIAS]);  // no state of the filter
}

static void test_rows_of_patterns_are_moments_of_misplaced_forces(void)
{
    uint64_t seed = 5;
    double c[6];
    fill_normal(&seed, c, 6);                                                   // given
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, H);  // when
    double moment[3] = {0.0};  // then: what is measured lacks the moment of the displacements
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
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, H);  // when
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
    memset(X, 0, sizeof X);                                                     // given
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, H);  // when
    const ipe_filter_states_t none = {.t_ns = 0};                               // then
    TEST_ASSERT_EQUAL_MEMORY(none.pattern, states.pattern, sizeof none.pattern);
}

static void test_predict_wander_fades_and_keeps_its_variance(void)
{
    double theta[IPE_NP] = {0.0}, P[IPE_NP][IPE_NP] = {{0.0}}, std[IPE_NX_MAX - IPE_NP];
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1.0; }
    ipe_filter_states_std(&states, std);
    ipe_rls_t rls;
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, theta, P, N - IPE_NP, std));
    double h[IPE_NX_MAX];
    uint64_t seed = 9;
    fill_normal(&seed, h, N);
    ipe_rls_update_row(&rls, h, 3.0);  // given: correlated with everything
    const double before = rls.x[WANDER], known = rls.x[0];

    ipe_average_t window;
    memset(&window, 0, sizeof window);
    for (int i = 0; i < 3; ++i) { window.error.attitude_std[i] = 3e-3, window.error.attitude_time[i] = 20.0; }
    window.t_ns = 1;
    ipe_filter_states_predict(&states, &config, &window, &rls);
    window.t_ns += 20000000000LL;  // when: a correlation time later
    ipe_filter_states_predict(&states, &config, &window, &rls);

    TEST_ASSERT_DOUBLE_WITHIN(1e-15, exp(-1.0) * before, rls.x[WANDER]);  // then
    TEST_ASSERT_EQUAL_DOUBLE(known, rls.x[0]);
    window.t_ns = 1 + 3600000000000LL;
    ipe_filter_states_predict(&states, &config, &window, &rls);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-6, 3e-3, ipe_rls_std(&rls, WANDER + i)); }
    TEST_ASSERT_TRUE(ipe_rls_invariants_hold(&rls));
}

/// The offsets drift by their variance times the time, in steps of 5 s; nothing else does.
static void test_predict_offsets_drift_with_time(void)
{
    static ipe_rls_t rls;
    double theta[IPE_NP] = {0.0}, P[IPE_NP][IPE_NP] = {{0.0}}, std[IPE_NX_MAX - IPE_NP];
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1.0; }
    config.std_force_offset_drift = 0.3;
    ipe_filter_states_std(&states, std);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, theta, (const double (*)[IPE_NP])P, N - IPE_NP, std));
    ipe_average_t window = {.t_ns = 1};
    for (int k = 0; k <= 1000; ++k, window.t_ns += 100000000LL) {  // when: 100 s
        ipe_filter_states_predict(&states, &config, &window, &rls);
    }
    for (int i = 0; i < 8; ++i) {  // then
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, sqrt(25.0 + 0.09 * 100.0), ipe_rls_std(&rls, AT(IPE_BLOCK_FORCE_OFFSET) + i));
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.2, ipe_rls_std(&rls, AT(IPE_BLOCK_FORCE_DELAY)));
}

/// A delay far outside its sigma: the estimate is that of a prior that had allowed it, to the last digit.
static void test_implausible_prior_is_as_if_it_had_been_wide(void)
{
    static ipe_rls_t narrow, wide;
    const int at = AT(IPE_BLOCK_FORCE_DELAY);
    double theta[IPE_NP] = {0.0}, P[IPE_NP][IPE_NP] = {{0.0}}, std[IPE_NX_MAX - IPE_NP], h[IPE_NX_MAX];
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1.0; }
    states.std[IPE_BLOCK_FORCE_DELAY] = 1e-3;
    ipe_filter_states_std(&states, std);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&narrow, theta, (const double (*)[IPE_NP])P, N - IPE_NP, std));
    uint64_t seed = 21;
    double rows[40][IPE_NX_MAX], y[40];
    for (int k = 0; k < 40; ++k) {  // given: 20 ms, sigma 1 ms
        fill_normal(&seed, rows[k], N);
        rows[k][at] *= 500.0;
        y[k] = 0.02 * rows[k][at];
        ipe_rls_update_row(&narrow, rows[k], y[k]);
    }
    ipe_filter_states_widen(&states, &narrow);  // when
    TEST_ASSERT_TRUE(states.std[IPE_BLOCK_FORCE_DELAY] > 3e-3);
    ipe_filter_states_std(&states, std);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&wide, theta, (const double (*)[IPE_NP])P, N - IPE_NP, std));
    for (int k = 0; k < 40; ++k) { ipe_rls_update_row(&wide, rows[k], y[k]); }
    memcpy(h, wide.x, sizeof h);
    for (int i = 0; i < N; ++i) {  // then
        TEST_ASSERT_DOUBLE_WITHIN(1e-9 * (1.0 + fabs(h[i])), wide.x[i], narrow.x[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-7 * ipe_rls_std(&wide, i), ipe_rls_std(&wide, i), ipe_rls_std(&narrow, i));
    }
    TEST_ASSERT_TRUE(ipe_rls_invariants_hold(&narrow));
}

static void test_plausible_priors_stay(void)
{
    static ipe_rls_t rls;
    double theta[IPE_NP] = {0.0}, P[IPE_NP][IPE_NP] = {{0.0}}, std[IPE_NX_MAX - IPE_NP], h[IPE_NX_MAX] = {0.0};
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1.0; }
    ipe_filter_states_std(&states, std);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, theta, (const double (*)[IPE_NP])P, N - IPE_NP, std));
    h[AT(IPE_BLOCK_FORCE_DELAY)] = 100.0;
    ipe_rls_update_row(&rls, h, 2.5 * 0.2 * 100.0);  // given: 2.5 sigma
    const ipe_rls_t before = rls;
    ipe_filter_states_widen(&states, &rls);          // when
    TEST_ASSERT_EQUAL_MEMORY(&before, &rls, sizeof rls);
    TEST_ASSERT_EQUAL_DOUBLE(0.2, states.std[IPE_BLOCK_FORCE_DELAY]);
}

#define OFFSET AT(IPE_BLOCK_FORCE_OFFSET)
#define GAIN AT(IPE_BLOCK_FORCE_GAIN)

/// The states' covariance is share of what it is of the noise; f is measured with noise, which explains the innovation.
static void denoise_gains(double share, const double f[8], double noisy[IPE_CABLES_MAX])
{
    double L[IPE_NY][IPE_NY] = {{0.0}}, S[IPE_NY][IPE_NY] = {{0.0}}, innovation[IPE_NY] = {0.0};
    double by_offset[IPE_NY][IPE_CABLES_MAX];
    const double v[IPE_NY] = {0.2, -0.1, 0.3, 0.05, -0.2, 0.1};
    ipe_filter_states_rows(&states, &config, (const double (*)[3])R, Y, X, H);
    for (int i = 0; i < IPE_NY; ++i) {
        L[i][i] = 2.0, S[i][i] = 4.0 * share;
        memcpy(by_offset[i], X[i] + IPE_XI_FORCE, 8 * sizeof(double));
    }
    for (int k = 0; k < 8; ++k) {
        noisy[k] = f[k];
        for (int j = 0; j < IPE_NY; ++j) { noisy[k] += H[j * N + OFFSET + k] * v[j]; }
        for (int j = 0; j < IPE_NY; ++j) { innovation[j] += H[j * N + OFFSET + k] * (noisy[k] - f[k]); }
    }
    ipe_filter_states_denoise_gain_columns(&states, by_offset, noisy, innovation, (const double (*)[IPE_NY])S,
                                           (const double (*)[IPE_NY])L, H);
}

static void check_gains(const double f[8])
{
    double xi[IPE_XI_MAX], std[IPE_XI_MAX];
    for (int k = 0; k < 7; ++k) {
        gains_of(k, xi, std);
        for (int j = 0; j < IPE_NY; ++j) {
            double expected = 0.0;
            for (int i = 0; i < 8; ++i) { expected += H[j * N + OFFSET + i] * f[i] * xi[IPE_XI_FORCE + 8 + i]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-5, expected, H[j * N + GAIN + k]);
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
    RUN_TEST(test_std_are_the_configured_ones);
    RUN_TEST(test_gains_sum_to_zero_and_their_rows_are_those_of_each_cable);
    RUN_TEST(test_gains_are_as_unknown_as_declared_before_any_data);
    RUN_TEST(test_predict_offsets_drift_with_time);
    RUN_TEST(test_implausible_prior_is_as_if_it_had_been_wide);
    RUN_TEST(test_plausible_priors_stay);
    RUN_TEST(test_layout_has_every_block_once_and_in_order);
    RUN_TEST(test_rows_of_absent_blocks_are_not_there);
    RUN_TEST(test_an_estimated_attitude_wanders_whatever_is_declared);
    RUN_TEST(test_rows_hold_regressor_systematic_columns_and_wander);
    RUN_TEST(test_rows_of_patterns_are_moments_of_misplaced_forces);
    RUN_TEST(test_patterns_are_orthonormal_and_leave_out_the_pull_along_the_resultant);
    RUN_TEST(test_patterns_of_cables_without_force_are_zero);
    RUN_TEST(test_predict_wander_fades_and_keeps_its_variance);
    RUN_TEST(test_denoised_gains_are_those_of_the_tensions_without_noise);
    RUN_TEST(test_denoised_gains_believe_the_tensions_where_the_states_are_unknown);
    return UNITY_END();
}
