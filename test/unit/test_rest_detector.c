// SPDX-License-Identifier: Apache-2.0
#include "rest_detector.h"

#include "smallmat.h"

#include <string.h>
#include <unity.h>

static const int64_t MS = 1000000;
static const double BIAS[3] = {0.1, -0.2, 0.03};  // far above what a rate-based gate would let through
static ipe_rest_detector_t rest;
static int64_t t_ns;
static double rate[3];

void setUp(void)
{
    ipe_rest_detector_init(&rest);
    t_ns = 0;
}

void tearDown(void)
{
}

/// n rows at 100 Hz of a platform that turns about z at rate w, shaken with amplitude a, with sensor noise.
static void push(int n, double w, double a, int64_t gap_ns)
{
    static unsigned noise = 1;
    t_ns += gap_ns;
    for (int i = 0; i < n; ++i) {
        const double t = 1e-9 * (double)t_ns, swing = a * sin(40.0 * t);
        ipe_row_t row = {.t_ns = t_ns, .acc = {swing, 0.0, 9.81}, .gyro = {BIAS[0], BIAS[1], BIAS[2] + w}};
        quat_from_rpy((const double[3]){0.1, 0.0, w * t}, row.q);
        for (int k = 0; k < 3; ++k) {
            noise = noise * 1664525U + 1013904223U;
            row.gyro[k] += 1e-3 * ((double)(noise >> 16U) / 32768.0 - 1.0);
        }
        for (int k = 0; i % 2 == 1 && k < 4; ++k) { row.q[k] = -row.q[k]; }  // the same attitude
        ipe_rest_detector_push(&rest, &row);
        t_ns += 10 * MS;
    }
}

static void test_rest_gives_the_bias_of_a_resting_gyro(void)
{
    push(250, 0.0, 0.0, 0);
    TEST_ASSERT_NULL(ipe_rest_detector_read(&rest, t_ns, rate));
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(2e-4, BIAS[i], rate[i]); }
}

static void test_rest_needs_two_seconds(void)
{
    push(190, 0.0, 0.0, 0);
    TEST_ASSERT_EQUAL_STRING("fewer than 2 s of rows in a row", ipe_rest_detector_read(&rest, t_ns, rate));
}

static void test_rest_slow_steady_turn_is_seen_by_the_attitude(void)
{
    push(250, 5e-3, 0.0, 0);
    TEST_ASSERT_EQUAL_STRING("moving: the attitude changes", ipe_rest_detector_read(&rest, t_ns, rate));
}

static void test_rest_shaking_is_no_rest_and_writes_nothing(void)
{
    push(250, 0.0, 1.0, 0);
    rate[0] = 7.0;
    TEST_ASSERT_EQUAL_STRING("moving: the specific force varies", ipe_rest_detector_read(&rest, t_ns, rate));
    TEST_ASSERT_EQUAL_DOUBLE(7.0, rate[0]);
}

static void test_rest_motion_before_is_forgotten(void)
{
    push(250, 0.3, 1.0, 0);
    push(320, 0.0, 0.0, 0);
    TEST_ASSERT_NULL(ipe_rest_detector_read(&rest, t_ns, rate));
}

static void test_rest_gap_starts_again(void)
{
    push(150, 0.0, 0.0, 0);
    push(150, 0.0, 0.0, 600 * MS);
    TEST_ASSERT_NOT_NULL(ipe_rest_detector_read(&rest, t_ns, rate));
}

static void test_rest_of_the_past_does_not_count(void)
{
    push(250, 0.0, 0.0, 0);
    TEST_ASSERT_EQUAL_STRING("no rows now", ipe_rest_detector_read(&rest, t_ns + 2000 * MS, rate));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_rest_gives_the_bias_of_a_resting_gyro);
    RUN_TEST(test_rest_needs_two_seconds);
    RUN_TEST(test_rest_slow_steady_turn_is_seen_by_the_attitude);
    RUN_TEST(test_rest_shaking_is_no_rest_and_writes_nothing);
    RUN_TEST(test_rest_motion_before_is_forgotten);
    RUN_TEST(test_rest_gap_starts_again);
    RUN_TEST(test_rest_of_the_past_does_not_count);
    return UNITY_END();
}
