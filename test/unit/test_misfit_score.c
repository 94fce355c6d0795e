// SPDX-License-Identifier: Apache-2.0
#include "misfit_score.h"

#include "robot.h"

static ipe_misfit_score_t score;
static ipe_noise_t noise;
static ipe_rls_t rls;
static uint64_t seed;
static int64_t now_ns;
static double truth[IPE_NP];

static void start(void)
{
    const ipe_config_t k = cogiro();
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_noise_init(&noise, k.residual_covariance));
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, k.prior_theta, k.prior_covariance, 0, NULL));
}

void setUp(void)
{
    memset(&score, 0, sizeof score);
    seed = 41, now_ns = 1000000000;
    nominal_theta(truth);
    start();
}

void tearDown(void)
{
}

/// n windows, 0.1 s each: motion at 0.5 Hz, noise of `size` times its sigma, and a moment of friction [N m] that turns with
/// the motion's speed.
static void run(int n, double size, double friction)
{
    for (int k = 0; k < n; ++k) {
        double s[3], ww[6] = {0.0}, alpha[3], Y[IPE_NY][IPE_NP], y[IPE_NY], e[IPE_NY], nis;
        const double phase = 3.14 * 1e-9 * (double)now_ns;
        for (int i = 0; i < 3; ++i) { s[i] = sin(phase + i), alpha[i] = 0.5 * sin((1.0 + 0.3 * i) * phase + 2.0 * i); }
        s[2] += 9.81;
        ipe_regressor(s, ww, alpha, Y);
        fill_normal(&seed, e, IPE_NY);
        for (int i = 0; i < IPE_NY; ++i) {
            y[i] = size * noise.L[i][i] * e[i];
            for (int j = 0; j < IPE_NP; ++j) { y[i] += Y[i][j] * truth[j]; }
        }
        y[3] += cos(phase) > 0.0 ? friction : -friction;
        ipe_misfit_score_before(&score, &rls);
        TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_update(&rls, &Y[0][0], y, (const double (*)[IPE_NY])noise.L, &nis));
        ipe_misfit_score_after(&score, &rls, now_ns);
        now_ns += 100000000;
    }
}

static void test_nothing_known_widens_nothing(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(1.0, ipe_misfit_score_factor(&score, &noise, 0.0));
}

static void test_cautious_noise_widens_nothing(void)
{
    run(3000, 0.4, 0.0);  // given, when: 300 s, noise believed larger than it is
    TEST_ASSERT_EQUAL_DOUBLE(1.0, ipe_misfit_score_factor(&score, &noise, 0.0));
    TEST_ASSERT_EQUAL_INT(60, score.n_blocks[0]);
    TEST_ASSERT_EQUAL_INT(4, score.n_blocks[4]);
}

/// The mean of what the score is made of is what the filter says, on every scale.
static void test_ratio_of_a_right_model_is_one(void)
{
    double mean = 0.0;
    run(20000, 1.0, 0.0);
    for (int scale = 0; scale < 3; ++scale) {
        for (int i = 0; i < IPE_NP; ++i) { mean += (double)score.ratio[scale][i] / (3 * IPE_NP); }
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.15, 1.0, mean);
}

static void test_error_that_turns_with_the_motion_is_marked_and_forgotten(void)
{
    run(300, 0.4, 0.0);
    run(300, 0.4, 3.0 * noise.L[3][3]);  // given: 30 s of it
    const double during = ipe_misfit_score_factor(&score, &noise, 0.0);
    start();
    run(12000, 0.4, 0.0);                          // when: gone, and theta is learnt anew
    TEST_ASSERT_TRUE(during > IPE_MISFIT_MARKED);  // then
    TEST_ASSERT_TRUE(ipe_misfit_score_factor(&score, &noise, 0.0) < IPE_MISFIT_MARKED);
}

static void test_large_nis_widens_and_an_unknown_one_does_not(void)
{
    noise.n_summed = 600;                                                                     // given: expected 1.82
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 2.0, ipe_misfit_score_factor(&score, &noise, 4 * 1.82));  // when, then
    TEST_ASSERT_EQUAL_DOUBLE(1.0, ipe_misfit_score_factor(&score, &noise, 1.8));
}

static void test_gap_gives_up_the_open_blocks(void)
{
    run(15, 0.4, 0.0);                            // given: 1.5 s
    TEST_ASSERT_EQUAL_INT(1, score.n_blocks[0]);
    ipe_misfit_score_restart(&score);             // when
    run(9, 0.4, 0.0);
    TEST_ASSERT_EQUAL_INT(1, score.n_blocks[0]);  // then: 0.8 s are no block
    TEST_ASSERT_EQUAL_INT(0, score.n_blocks[1]);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_nothing_known_widens_nothing);
    RUN_TEST(test_cautious_noise_widens_nothing);
    RUN_TEST(test_ratio_of_a_right_model_is_one);
    RUN_TEST(test_error_that_turns_with_the_motion_is_marked_and_forgotten);
    RUN_TEST(test_large_nis_widens_and_an_unknown_one_does_not);
    RUN_TEST(test_gap_gives_up_the_open_blocks);
    return UNITY_END();
}
