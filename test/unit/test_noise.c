// SPDX-License-Identifier: Apache-2.0
#include "noise.h"

#include "robot.h"

static ipe_noise_t noise;
static uint64_t seed;
static double C[IPE_NY][IPE_NY];
static const double KNOWN[IPE_NY][IPE_NY];  // states known well: innovations are all noise

void setUp(void)
{
    seed = 13;
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NY; ++j) { C[i][j] = i == j ? 4.0 : 0.4; }
    }
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_noise_init(&noise, (const double (*)[IPE_NY])C));
}

void tearDown(void)
{
}

static double covariance(int i, int j)
{
    double sum = 0.0;
    for (int k = 0; k <= (i < j ? i : j); ++k) { sum += noise.L[i][k] * noise.L[j][k]; }
    return sum;
}

static void test_init_starts_from_the_configured_covariance(void)
{
    for (int i = 0; i < IPE_NY; ++i) {  // given, when, then
        for (int j = 0; j < IPE_NY; ++j) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, C[i][j], covariance(i, j)); }
    }
}

static void test_init_covariance_not_positive_definite_is_refused(void)
{
    C[0][1] = C[1][0] = 5.0;                                                                     // given
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_noise_init(&noise, (const double (*)[IPE_NY])C));  // when, then
}

/// n innovations e_k = rho e_(k-1) + white, of variance r_0 = 1.
static void push_correlated(double rho, int n)
{
    double e[IPE_NY], white[IPE_NY];
    fill_normal(&seed, e, IPE_NY);
    for (int k = 0; k < n; ++k) {
        fill_normal(&seed, white, IPE_NY);
        for (int i = 0; i < IPE_NY; ++i) { e[i] = rho * e[i] + sqrt(1.0 - rho * rho) * white[i]; }
        ipe_noise_push(&noise, e, KNOWN);
    }
}

static void check_long_run_variance(double rho)
{
    double expected = 1.0;         // given: r_0 + 2 sum (1 - k/26) r_k
    for (int k = 1; k <= 25; ++k) { expected += 2.0 * (1.0 - k / 26.0) * pow(rho, k); }
    push_correlated(rho, 200000);  // when
    for (int i = 0; i < IPE_NY; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(0.08 * expected, expected, covariance(i, i));
    }  // then
}

static void test_push_white_innovations_gives_their_variance(void)
{
    check_long_run_variance(0.0);
}

static void test_push_correlated_innovations_gives_their_long_run_variance(void)
{
    check_long_run_variance(0.9);
}

static void test_push_correlation_of_channels_is_kept(void)
{
    push_correlated(0.5, 5000);                                       // given, when
    const double scale = sqrt(covariance(1, 1) * covariance(4, 4));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.1, covariance(4, 1) / scale);  // then
}

static void test_push_few_innovations_believe_the_configuration(void)
{
    push_correlated(0.0, 2);                                                        // given, when
    for (int i = 0; i < IPE_NY; ++i) { TEST_ASSERT_TRUE(covariance(i, i) > 3.0); }  // then
}

static void test_push_innovation_of_unknown_states_teaches_nothing(void)
{
    double S[IPE_NY][IPE_NY] = {{0.0}}, e[IPE_NY];  // given: states do not know better than 100
    for (int i = 0; i < IPE_NY; ++i) { S[i][i] = 1e4, e[i] = 100.0; }
    for (int k = 0; k < 100; ++k) { ipe_noise_push(&noise, e, (const double (*)[IPE_NY])S); }      // when
    for (int i = 0; i < IPE_NY; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0, covariance(i, i)); }  // then
}

static void test_push_nonfinite_innovation_changes_nothing(void)
{
    push_correlated(0.0, 100);  // given
    const ipe_noise_t before = noise;
    const double e[IPE_NY] = {0.0, 0.0, NAN, 0.0, 0.0, 0.0};
    ipe_noise_push(&noise, e, KNOWN);                         // when
    TEST_ASSERT_EQUAL_MEMORY(&before, &noise, sizeof noise);  // then
}

static void test_push_alternating_innovations_never_make_noise_vanish(void)
{
    for (int k = 0; k < 10000; ++k) {        // given: negatively correlated, sums cancel
        const double e = k % 2 ? 1.0 : -1.0, all[IPE_NY] = {e, e, e, e, e, e};
        ipe_noise_push(&noise, all, KNOWN);  // when
    }
    for (int i = 0; i < IPE_NY; ++i) { TEST_ASSERT_TRUE(noise.L[i][i] > 0.0 && isfinite(noise.L[i][i])); }  // then
}

static void test_weight_of_a_window_that_stands_out_falls_as_huber_has_it(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(1.0, ipe_noise_weight(0.0));            // when, then: noise keeps its weight
    TEST_ASSERT_EQUAL_DOUBLE(1.0, ipe_noise_weight(30.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5, ipe_noise_weight(120.0));  // its pull grows as the distance, no further
    TEST_ASSERT_EQUAL_DOUBLE(ipe_noise_weight(1e6), ipe_noise_weight(1e9));  // a lasting misfit is not thrown away
    TEST_ASSERT_TRUE(ipe_noise_weight(1e9) > 0.0);
}

static void test_restart_separates_what_came_before(void)
{
    const double e[IPE_NY] = {1.0, 1.0, 1.0, 1.0, 1.0, 1.0};  // given
    ipe_noise_push(&noise, e, KNOWN);
    const double once = noise.sum[0];
    ipe_noise_restart(&noise);                                   // when
    ipe_noise_push(&noise, e, KNOWN);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 2.0 * once, noise.sum[0]);  // then: no product of the two
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_init_starts_from_the_configured_covariance);
    RUN_TEST(test_init_covariance_not_positive_definite_is_refused);
    RUN_TEST(test_push_white_innovations_gives_their_variance);
    RUN_TEST(test_push_correlated_innovations_gives_their_long_run_variance);
    RUN_TEST(test_push_correlation_of_channels_is_kept);
    RUN_TEST(test_push_few_innovations_believe_the_configuration);
    RUN_TEST(test_push_innovation_of_unknown_states_teaches_nothing);
    RUN_TEST(test_push_nonfinite_innovation_changes_nothing);
    RUN_TEST(test_push_alternating_innovations_never_make_noise_vanish);
    RUN_TEST(test_weight_of_a_window_that_stands_out_falls_as_huber_has_it);
    RUN_TEST(test_restart_separates_what_came_before);
    return UNITY_END();
}
