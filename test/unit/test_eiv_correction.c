// SPDX-License-Identifier: Apache-2.0
#include "eiv_correction.h"

#include "regressor.h"
#include "rls.h"
#include "robot.h"

enum { WINDOWS = 4000 };

static const double THETA[IPE_NP] = {40.0, 0.8, 2.0, -6.0, 4.0, 5.0, 6.0, 0.3, -0.4, 0.5};
static const double ZERO[IPE_NP];
static const double S_NOISE = 0.05, ALPHA_NOISE = 0.02;
static ipe_eiv_correction_t attenuation;
static ipe_rls_t rls;
static uint64_t seed;
static double L[IPE_NY][IPE_NY], prior[IPE_NP][IPE_NP];

void setUp(void)
{
    seed = 41;
    memset(&attenuation, 0, sizeof attenuation);
    for (int i = 0; i < IPE_NY; ++i) { L[i][i] = i < 3 ? 3.0 : 0.45; }
    for (int i = 0; i < IPE_NP; ++i) { prior[i][i] = 1e4; }
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, ZERO, (const double (*)[IPE_NP])prior, 0, NULL));
}

void tearDown(void)
{
}

static void normal3(double std, double x[3])
{
    fill_normal(&seed, x, 3);
    for (int i = 0; i < 3; ++i) { x[i] *= std; }
}

/// Windows of a body THETA whose specific force and angular acceleration are measured with noise.
static void identify(double s_size, double alpha_size)
{
    const double ww[6] = {0.0};
    ipe_average_t average = {.n_rows = 1};
    for (int i = 0; i < 3; ++i) {
        average.s_variance[i] = S_NOISE * S_NOISE;
        average.alpha_variance[i] = ALPHA_NOISE * ALPHA_NOISE;
    }
    for (int k = 0; k < WINDOWS; ++k) {
        double s[3], alpha[3], noise[3], Y[IPE_NY][IPE_NP], y[IPE_NY], nis;
        normal3(s_size, s);
        s[2] += 9.81;
        normal3(alpha_size, alpha);
        ipe_regressor(s, ww, alpha, Y);
        fill_normal(&seed, y, IPE_NY);
        for (int i = 0; i < IPE_NY; ++i) {
            y[i] *= i < 3 ? 2.0 : 0.2;
            for (int j = 0; j < IPE_NP; ++j) { y[i] += Y[i][j] * THETA[j]; }
        }
        normal3(S_NOISE, noise);
        for (int i = 0; i < 3; ++i) { s[i] += noise[i]; }
        normal3(ALPHA_NOISE, noise);
        for (int i = 0; i < 3; ++i) { alpha[i] += noise[i]; }
        ipe_regressor(s, ww, alpha, Y);
        TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_update(&rls, &Y[0][0], y, (const double (*)[IPE_NY])L, &nis));
        ipe_eiv_correction_add(&attenuation, &average, 1.0);
    }
}

static void correct(double level, double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    double C[IPE_NP][IPE_NP] = {{0.0}};
    ipe_eiv_correction_information(&attenuation, (const double (*)[IPE_NY])L, level, rls.x, C);
    ipe_eiv_correction_undo((const double (*)[IPE_NP])C, ZERO, (const double (*)[IPE_NP])prior, theta, P);
}

static void undo(double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    memcpy(theta, rls.x, sizeof(double) * IPE_NP);
    ipe_rls_covariance(&rls, IPE_NP, &P[0][0]);
    correct(1.0, theta, P);
}

static void test_undo_noise_as_large_as_the_motion_gives_the_body(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP];
    identify(0.5, ALPHA_NOISE);  // given: half of what the columns of J hold is noise
    TEST_ASSERT_TRUE(rls.x[4] < 0.7 * THETA[4] && rls.x[5] < 0.7 * THETA[5]);
    undo(theta, P);              // when
    for (int i = 0; i < IPE_NP; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(3.0 * sqrt(P[i][i]), THETA[i], theta[i]);  // then
        TEST_ASSERT_TRUE(sqrt(P[i][i]) < fmax(0.3 * fabs(THETA[i]), 0.5));
    }
}

static void test_undo_noise_alone_leaves_what_was_known_before(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP];
    identify(0.5, 0.0);  // given: the platform never turns, the filter is sure of an inertia all the same
    TEST_ASSERT_TRUE(ipe_rls_std(&rls, 4) < 0.5);
    undo(theta, P);      // when
    for (int i = 4; i < IPE_NP; ++i) { TEST_ASSERT_TRUE(sqrt(P[i][i]) > 5.0); }  // then
    TEST_ASSERT_DOUBLE_WITHIN(3.0 * sqrt(P[4][4]), THETA[4], theta[4]);
}

static void test_undo_takes_no_more_for_noise_than_residuals_show(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP];
    identify(0.5, 0.5);                                                      // given: a motor that shakes the platform,
    for (int k = 0; k < 3; ++k) { attenuation.sum[k] *= 100.0F; }            // which looks like ten times the noise
    undo(theta, P);                                                          // when
    for (int i = 0; i < 4; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(3.0 * sqrt(P[i][i]), THETA[i], theta[i]);  // then
        TEST_ASSERT_TRUE(sqrt(P[i][i]) < 2.0 * ipe_rls_std(&rls, i));
    }
}

static void test_undo_never_ends_above_the_prior(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP];
    identify(0.5, ALPHA_NOISE);                                                           // given
    for (int k = 0; k < IPE_NOISE_DENSITY_CHANNELS; ++k) { attenuation.sum[k] *= 1e6F; }  // and noise overrated by far
    const double x[IPE_NP] = {0.0};
    memcpy(rls.x, x, sizeof x);                                                           // nothing to correct
    undo(theta, P);                                                                       // when
    for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_TRUE(P[i][i] <= 1.001 * prior[i][i]); }  // then
}

static void test_undo_without_noise_changes_nothing(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP], before[IPE_NP][IPE_NP];
    identify(0.5, 0.1);  // given
    memset(&attenuation, 0, sizeof attenuation);
    ipe_rls_covariance(&rls, IPE_NP, &before[0][0]);
    undo(theta, P);                                        // when
    TEST_ASSERT_EQUAL_MEMORY(rls.x, theta, sizeof theta);  // then
    TEST_ASSERT_EQUAL_MEMORY(before, P, sizeof P);
}

static void test_undo_knows_the_level_of_each_window(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP], again[IPE_NP], P_again[IPE_NP][IPE_NP];
    identify(0.5, ALPHA_NOISE);  // given: the same, told in another unit
    undo(theta, P);
    for (int k = 0; k < IPE_NOISE_DENSITY_CHANNELS; ++k) { attenuation.sum[k] /= 4.0F; }
    attenuation.n /= 4.0F;
    memcpy(again, rls.x, sizeof again);
    ipe_rls_covariance(&rls, IPE_NP, &P_again[0][0]);
    correct(4.0, again, P_again);                                                                               // when
    for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-6 * fabs(theta[i]), theta[i], again[i]); }  // then
}

static void test_forget_takes_windows_as_the_filter_does(void)
{
    const ipe_average_t average = {.s_variance = {1.0, 2.0, 3.0}, .alpha_variance = {4.0, 5.0, 6.0}};
    ipe_eiv_correction_add(&attenuation, &average, 2.0);                      // given
    ipe_eiv_correction_forget(&attenuation, 0.5);                             // when
    for (int k = 0; k < IPE_NOISE_DENSITY_CHANNELS; ++k) {
        TEST_ASSERT_EQUAL_FLOAT(0.25F * (float)(k + 1), attenuation.sum[k]);  // then
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_undo_noise_as_large_as_the_motion_gives_the_body);
    RUN_TEST(test_undo_noise_alone_leaves_what_was_known_before);
    RUN_TEST(test_undo_takes_no_more_for_noise_than_residuals_show);
    RUN_TEST(test_undo_never_ends_above_the_prior);
    RUN_TEST(test_undo_without_noise_changes_nothing);
    RUN_TEST(test_undo_knows_the_level_of_each_window);
    RUN_TEST(test_forget_takes_windows_as_the_filter_does);
    return UNITY_END();
}
