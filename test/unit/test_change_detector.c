// SPDX-License-Identifier: Apache-2.0
#include "change_detector.h"

#include "robot.h"

static ipe_change_detector_t detect;
static uint64_t seed;

void setUp(void)
{
    seed = 41;
    ipe_change_detector_init(&detect);
}

void tearDown(void)
{
}

static double chi_squared_6(double scale)
{
    double e[IPE_NY], sum = 0.0;
    fill_normal(&seed, e, IPE_NY);
    for (int i = 0; i < IPE_NY; ++i) { sum += scale * e[i] * e[i]; }
    return sum;
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

static void test_push_honest_noise_for_a_day_never_alarms(void)
{
    for (int k = 0; k < 864000; ++k) {                                                 // given: 10 windows per second
        TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE,
                              ipe_change_detector_push(&detect, chi_squared_6(1.0)));  // when, then
    }
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes + detect.n_held);
}

static void test_push_one_outstanding_window_is_held_back_only(void)
{
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_HOLD, ipe_change_detector_push(&detect, 1e6));  // given, when
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE, ipe_change_detector_push(&detect, 6.0));   // then
    TEST_ASSERT_EQUAL_UINT64(1, detect.n_held);
    TEST_ASSERT_EQUAL_UINT64(0, detect.n_changes);
}

static void test_push_two_outstanding_windows_are_a_change_and_alarm_repeats(void)
{
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_HOLD, ipe_change_detector_push(&detect, 80.0));  // given, when, then
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_CHANGE, ipe_change_detector_push(&detect, INFINITY));
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_CHANGE, ipe_change_detector_push(&detect, 80.0));
    TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE, ipe_change_detector_push(&detect, 6.0));
    TEST_ASSERT_EQUAL_UINT64(2, detect.n_changes);
}

static void test_push_small_lasting_change_is_noticed(void)
{
    int k = 0;  // given: NIS three times what it should be
    while (k < 100 && ipe_change_detector_push(&detect, chi_squared_6(3.0)) == IPE_CHANGE_DETECTOR_USE) {
        ++k;
    }                                  // when
    TEST_ASSERT_LESS_THAN_INT(40, k);  // then
}

static void test_push_nan_is_no_change(void)
{
    for (int k = 0; k < 10; ++k) {  // given, when, then: the filter will refuse it
        TEST_ASSERT_EQUAL_INT(IPE_CHANGE_DETECTOR_USE, ipe_change_detector_push(&detect, NAN));
    }
    TEST_ASSERT_EQUAL_DOUBLE(0.0, detect.cusum);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_nis_of_independent_channels_is_sum_of_normalised_squares);
    RUN_TEST(test_nis_does_not_depend_on_the_channels_units);
    RUN_TEST(test_nis_of_singular_covariance_is_nan);
    RUN_TEST(test_push_honest_noise_for_a_day_never_alarms);
    RUN_TEST(test_push_one_outstanding_window_is_held_back_only);
    RUN_TEST(test_push_two_outstanding_windows_are_a_change_and_alarm_repeats);
    RUN_TEST(test_push_small_lasting_change_is_noticed);
    RUN_TEST(test_push_nan_is_no_change);
    return UNITY_END();
}
