// SPDX-License-Identifier: Apache-2.0
#include "pose_dwell.h"

#include "robot.h"
#include "smallmat.h"

static ipe_config_t config;
static ipe_pose_dwell_t still;
static ipe_average_t window;

void setUp(void)
{
    const double none[3] = {0.0, 0.0, 0.0};
    config = cogiro();
    config.std_attitude_wander = 1e-3;
    memset(&window, 0, sizeof window);
    window.p[2] = 2.0;
    mat3_exp(none, window.R);
    ipe_pose_dwell_restart(&still);
}

void tearDown(void)
{
}

static int push(int n)
{
    int n_rest = 0;
    for (int i = 0; i < n; ++i) { n_rest = ipe_pose_dwell_push(&still, &config, &window); }
    return n_rest;
}

static void test_push_counts_from_the_sixth_window_of_a_pose_on(void)
{
    TEST_ASSERT_EQUAL_INT(0, push(5));
    TEST_ASSERT_EQUAL_INT(1, push(1));
    TEST_ASSERT_EQUAL_INT(95, push(94));
}

static void test_push_noise_within_the_pose_is_rest(void)
{
    uint64_t seed = 5;
    (void)push(100);     // given
    for (int i = 0; i < 10000; ++i) {
        double turn[3];  // when: wander, a noisy tracker, a noisy gyro of 25 Hz
        fill_normal(&seed, turn, 3);
        fill_normal(&seed, window.p, 3);
        fill_normal(&seed, window.alpha, 3);
        for (int j = 0; j < 3; ++j) { turn[j] *= 1e-3, window.p[j] *= 1.2e-3, window.alpha[j] *= 0.1; }
        window.p[2] += 2.0;
        mat3_exp(turn, window.R);
        TEST_ASSERT_EQUAL_INT(96 + i, push(1));  // then
    }
}

static void test_push_a_knock_is_motion_but_the_pose_stays_told(void)
{
    (void)push(100);                    // given
    window.w[0] = 0.03;                 // when
    TEST_ASSERT_EQUAL_INT(0, push(3));  // then
    window.w[0] = 0.0;
    TEST_ASSERT_EQUAL_INT(96, push(1));
}

static void test_push_creeping_away_is_a_new_pose(void)
{
    (void)push(100);       // given
    window.p[0] += 0.009;  // when, then: not yet
    TEST_ASSERT_EQUAL_INT(96, push(1));
    window.p[0] += 0.002;
    TEST_ASSERT_EQUAL_INT(0, push(5));
    TEST_ASSERT_EQUAL_INT(1, push(1));
}

static void test_push_turned_by_more_than_wander_is_a_new_pose(void)
{
    double turn[3] = {0.0, 0.025, 0.0};
    (void)push(100);           // given
    mat3_exp(turn, window.R);  // when, then: 0.02 rad and six sigma are 0.026
    TEST_ASSERT_EQUAL_INT(96, push(1));
    turn[1] = 0.027;
    mat3_exp(turn, window.R);
    TEST_ASSERT_EQUAL_INT(0, push(5));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_push_counts_from_the_sixth_window_of_a_pose_on);
    RUN_TEST(test_push_noise_within_the_pose_is_rest);
    RUN_TEST(test_push_a_knock_is_motion_but_the_pose_stays_told);
    RUN_TEST(test_push_creeping_away_is_a_new_pose);
    RUN_TEST(test_push_turned_by_more_than_wander_is_a_new_pose);
    return UNITY_END();
}
