// SPDX-License-Identifier: Apache-2.0
#include "change_detector.h"

#include "body.h"
#include "regressor.h"
#include "robot.h"

enum { LEARNT = 300, BODY_MASS = 100 };

/// One sigma of what the cables could lift, and of the noise of each window.
static const double PAYLOAD_STD[IPE_NP] = {300.0, 200.0, 200.0, 200.0, 130.0, 130.0, 130.0, 40.0, 40.0, 40.0};
static const double NOISE[IPE_NY] = {1.0, 1.0, 1.0, 0.4, 0.4, 0.4};

static ipe_change_detector_t detect;
static uint64_t seed;
static int time;
static bool is_noise_known;

/// A motion, what is on the platform, and who leans on it [N, W is P], in one window.
static ipe_change_detector_verdict_t window(const double load[IPE_NP], const double push[3])
{
    double s[3], ww[6], alpha[3], Y[IPE_NY][IPE_NP], S[IPE_NY][IPE_NY] = {{0.0}}, L[IPE_NY][IPE_NY] = {{0.0}};
    double e[IPE_NY];
    for (int i = 0; i < 3; ++i) {
        s[i] = (i == 2 ? 9.81 : 0.0) + 0.5 * sin(0.3 * time + i);
        alpha[i] = 0.3 * sin(0.2 * time + 2 * i);
        ww[i] = 0.05, ww[3 + i] = 0.02 * sin(0.25 * time + i);
    }
    ipe_regressor(s, ww, alpha, Y);
    fill_normal(&seed, e, IPE_NY);
    for (int i = 0; i < IPE_NY; ++i) {
        L[i][i] = NOISE[i], S[i][i] = 0.01;
        e[i] = NOISE[i] * e[i] + (i < 3 ? push[i] : 0.0);
        for (int p = 0; p < IPE_NP; ++p) { e[i] += Y[i][p] * load[p]; }
    }
    ++time;
    const ipe_change_detector_window_t w = {
        .Y = (const double (*)[IPE_NP])Y,
        .innovation = e,
        .S = (const double (*)[IPE_NY])S,
        .L = (const double (*)[IPE_NY])L,
        .nis = ipe_change_detector_nis(e, (const double (*)[IPE_NY])S, (const double (*)[IPE_NY])L),
        .mass = BODY_MASS,
        .is_noise_known = is_noise_known};
    return ipe_change_detector_push(&detect, &w, PAYLOAD_STD);
}

static const double NO_LOAD[IPE_NP] = {0.0}, NO_PUSH[3] = {0.0};

/// Parameters of a load at a point, about P.
static void load_at(double mass, const double at[3], double load[IPE_NP])
{
    memset(load, 0, IPE_NP * sizeof load[0]);
    load[0] = mass;
    ipe_body_shift(at, load, NULL);
}

/// Windows until the change is announced, at most `most`.
static int windows_until_change(const double load[IPE_NP], int most)
{
    int n = 1;
    while (n <= most && window(load, NO_PUSH) != IPE_CHANGE_DETECTOR_CHANGE) { ++n; }
    return n;
}

static void run_quietly(int n)
{
    for (int k = 0; k < n; ++k) { (void)window(NO_LOAD, NO_PUSH); }
}

void setUp(void)
{
    seed = 41;
    time = 0;
    is_noise_known = true;
    ipe_change_detector_init(&detect);
    run_quietly(LEARNT);
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_held);
}

void tearDown(void)
{
}

static void test_nis_of_independent_channels_is_sum_of_normalised_squares(void)
{
    double S[IPE_NY][IPE_NY] = {{0.0}}, L[IPE_NY][IPE_NY] = {{0.0}}, e[IPE_NY], expected = 0.0;  // given
    for (int i = 0; i < IPE_NY; ++i) {
        S[i][i] = 3.0 * i, L[i][i] = 1.0 + i, e[i] = 2.0 - i;
        expected += e[i] * e[i] / (S[i][i] + L[i][i] * L[i][i]);
    }
    TEST_ASSERT_DOUBLE_WITHIN(
        1e-12, expected,
        ipe_change_detector_nis(e, (const double (*)[IPE_NY])S, (const double (*)[IPE_NY])L));  // when, then
}

static void test_nis_does_not_depend_on_the_channels_units(void)
{
    double A[IPE_NY][IPE_NY], S[IPE_NY][IPE_NY], L[IPE_NY][IPE_NY] = {{0.0}}, e[IPE_NY];  // given: full S and L
    fill_normal(&seed, &A[0][0], IPE_NY * IPE_NY);
    fill_normal(&seed, e, IPE_NY);
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NY; ++j) {
            S[i][j] = 0.0;
            for (int k = 0; k < IPE_NY; ++k) { S[i][j] += A[i][k] * A[j][k]; }
        }
        for (int j = 0; j <= i; ++j) { L[i][j] = i == j ? 2.0 : A[i][j]; }
    }
    const double before = ipe_change_detector_nis(e, (const double (*)[IPE_NY])S, (const double (*)[IPE_NY])L);
    for (int i = 0; i < IPE_NY; ++i) {  // when: channel i in other units
        const double unit = pow(10.0, i - 3);
        e[i] *= unit;
        for (int j = 0; j < IPE_NY; ++j) { S[i][j] *= unit * pow(10.0, j - 3), L[i][j] *= unit; }
    }
    TEST_ASSERT_DOUBLE_WITHIN(
        1e-9, before, ipe_change_detector_nis(e, (const double (*)[IPE_NY])S, (const double (*)[IPE_NY])L));  // then
}

static void test_nis_of_singular_covariance_is_nan(void)
{
    const double zero[IPE_NY][IPE_NY] = {{0.0}}, e[IPE_NY] = {1.0};   // given
    TEST_ASSERT_TRUE(isnan(ipe_change_detector_nis(e, zero, zero)));  // when, then
}

static void test_push_honest_noise_for_a_day_is_no_change(void)
{
    run_quietly(864000);                                              // given, when: 10 windows per second
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes + detect.n_misfit);  // then: next to none is held back
    TEST_ASSERT_LESS_THAN_UINT64(50, detect.n_held);
    TEST_ASSERT_DOUBLE_WITHIN(2.0, 6.0, detect.level);
}

static void test_push_one_outstanding_window_is_held_back_only(void)
{
    const double knock[3] = {1000.0, 0.0, 300.0};
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_HOLD, window(NO_LOAD, knock));   // given, when
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE, window(NO_LOAD, NO_PUSH));  // then
    TEST_ASSERT_EQUAL_UINT64(1, detect.n_held);
    TEST_ASSERT_EQUAL_UINT64(1, detect.n_rejected);
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes);
}

static void test_push_heavy_load_is_a_change_in_the_second_window(void)
{
    const double at[3] = {0.2, -0.1, 0.3};
    double load[IPE_NP];
    load_at(20.0, at, load);                                   // given
    TEST_ASSERT_EQUAL_INT(2, windows_until_change(load, 10));  // when, then
    TEST_ASSERT_EQUAL_UINT64(1, detect.n_changes);
    TEST_ASSERT_FALSE(ipe_change_detector_is_contested(&detect));
}

static void test_push_light_load_is_a_change_within_three_seconds(void)
{
    const double at[3] = {0.2, -0.1, 0.3};
    double load[IPE_NP];
    for (int trial = 0; trial < 20; ++trial) {
        ipe_change_detector_init(&detect);
        run_quietly(LEARNT);
        load_at(trial % 2 == 0 ? 1.0 : -1.0, at, load);                 // given: 1 % of the mass, more or less
        TEST_ASSERT_LESS_THAN_INT(30, windows_until_change(load, 30));  // when, then
    }
}

static void test_push_load_that_still_moves_is_one_change(void)
{
    const double at[3] = {0.1, 0.2, 0.3};
    double load[IPE_NP];
    for (int k = 1; k <= 8; ++k) {  // given, when: picked up within 0.8 s, followed by the filter from each alarm on
        load_at(40.0 * k / 8, at, load);
        (void)window(load, NO_PUSH);
    }
    TEST_ASSERT_EQUAL_UINT64(1, detect.n_changes);  // then
}

static void test_push_leaning_on_the_platform_is_no_change(void)
{
    for (int push = 0; push < 50; ++push) {  // given: half sines of up to 2 s, mostly across gravity
        const double angle = between(&seed, 0.0, 6.28), size = between(&seed, 10.0, 100.0);
        const int n = (int)between(&seed, 8.0, 20.0);
        for (int k = 0; k < n; ++k) {
            const double now = size * pow(sin(M_PI * (k + 0.5) / n), 2.0);
            const double force[3] = {now * cos(angle), now * sin(angle), 0.3 * now};
            (void)window(NO_LOAD, force);  // when
        }
        run_quietly(30);
        TEST_ASSERT_FALSE(ipe_change_detector_is_contested(&detect));  // then: over after each
    }
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes + detect.n_misfit);
    TEST_ASSERT_GREATER_THAN_UINT64(40, detect.n_rejected);
}

static void test_push_force_that_stays_is_a_misfit_until_it_ends(void)
{
    const double lean[3] = {30.0, 20.0, 0.0};
    for (int k = 0; k < 50; ++k) { TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_HOLD, window(NO_LOAD, lean)); }  // given
    TEST_ASSERT_FALSE(ipe_change_detector_is_misfit(&detect));
    for (int k = 0; k < 100; ++k) { TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_MISFIT, window(NO_LOAD, lean)); }  // when
    TEST_ASSERT_TRUE(ipe_change_detector_is_misfit(&detect));                                                    // then
    TEST_ASSERT_TRUE(ipe_change_detector_inflation(&detect) > 4.0);
    run_quietly(10);
    TEST_ASSERT_FALSE(ipe_change_detector_is_contested(&detect));
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes);
    run_quietly(500);
    TEST_ASSERT_TRUE(ipe_change_detector_inflation(&detect) < 1.5);
}

static void test_push_load_laid_on_during_a_misfit_is_found_when_that_ends(void)
{
    const double lean[3] = {30.0, 20.0, 0.0}, at[3] = {0.1, 0.0, 0.4};
    double load[IPE_NP];
    load_at(20.0, at, load);
    for (int k = 0; k < 80; ++k) { (void)window(k < 60 ? NO_LOAD : load, lean); }  // given
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes);
    TEST_ASSERT_LESS_THAN_INT(90, windows_until_change(load, 90));                 // when, then
}

static void test_push_friction_that_reverses_is_no_change(void)
{
    for (int k = 0; k < 2000; ++k) {  // given, when: a force against a motion of 0.1 Hz, with a moment that it makes
        const double sign = sin(0.063 * k) > 0.0 ? 1.0 : -1.0;
        const double friction[3] = {4.0 * sign, -3.0 * sign, 2.0 * sign};
        (void)window(NO_LOAD, friction);
    }
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes);  // then
    TEST_ASSERT_GREATER_THAN_UINT64(0, detect.n_misfit);
}

static void test_push_load_that_only_moves_is_a_change_after_three_seconds(void)
{
    const double from[3] = {0.3, 0.0, 0.2}, to[3] = {-0.2, 0.2, 0.2};
    double load[IPE_NP], before[IPE_NP];
    load_at(10.0, to, load);
    load_at(10.0, from, before);
    for (int i = 0; i < IPE_NP; ++i) { load[i] -= before[i]; }      // given: the mass stays
    TEST_ASSERT_INT_WITHIN(3, 32, windows_until_change(load, 60));  // when, then
}

static void test_push_nothing_is_announced_before_the_noise_is_known(void)
{
    const double at[3] = {0.2, -0.1, 0.3}, lean[3] = {12.0, 0.0, 0.0}, knock[3] = {100.0, 0.0, 0.0};
    double load[IPE_NP];
    load_at(20.0, at, load);
    is_noise_known = false;                                                 // given
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE, window(NO_LOAD, lean));  // when, then: may be the noise
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_HOLD, window(NO_LOAD, knock));
    run_quietly(2);
    for (int k = 0; k < 50; ++k) { TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_HOLD, window(load, NO_PUSH)); }
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_MISFIT, window(load, NO_PUSH));  // so that it is learnt
    is_noise_known = true;
    TEST_ASSERT_LESS_THAN_INT(40, windows_until_change(load, 40));
}

static void test_restart_ends_the_contest_undecided(void)
{
    const double lean[3] = {30.0, 20.0, 0.0};
    for (int k = 0; k < 60; ++k) { (void)window(NO_LOAD, lean); }
    ipe_change_detector_restart(&detect);  // when
    TEST_ASSERT_FALSE(ipe_change_detector_is_contested(&detect) || ipe_change_detector_is_misfit(&detect));
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE, window(NO_LOAD, NO_PUSH));
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes + detect.n_rejected);
}

static void test_push_nan_is_no_change(void)
{
    const double broken[3] = {NAN, 0.0, 0.0};
    for (int k = 0; k < 10; ++k) {  // given, when, then: the filter will refuse it
        TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE, window(NO_LOAD, broken));
    }
    TEST_ASSERT_TRUE(isfinite(detect.cusum) && isfinite(detect.level));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_nis_of_independent_channels_is_sum_of_normalised_squares);
    RUN_TEST(test_nis_does_not_depend_on_the_channels_units);
    RUN_TEST(test_nis_of_singular_covariance_is_nan);
    RUN_TEST(test_push_honest_noise_for_a_day_is_no_change);
    RUN_TEST(test_push_one_outstanding_window_is_held_back_only);
    RUN_TEST(test_push_heavy_load_is_a_change_in_the_second_window);
    RUN_TEST(test_push_light_load_is_a_change_within_three_seconds);
    RUN_TEST(test_push_load_that_still_moves_is_one_change);
    RUN_TEST(test_push_leaning_on_the_platform_is_no_change);
    RUN_TEST(test_push_force_that_stays_is_a_misfit_until_it_ends);
    RUN_TEST(test_push_load_laid_on_during_a_misfit_is_found_when_that_ends);
    RUN_TEST(test_push_friction_that_reverses_is_no_change);
    RUN_TEST(test_push_load_that_only_moves_is_a_change_after_three_seconds);
    RUN_TEST(test_push_nothing_is_announced_before_the_noise_is_known);
    RUN_TEST(test_restart_ends_the_contest_undecided);
    RUN_TEST(test_push_nan_is_no_change);
    return UNITY_END();
}
