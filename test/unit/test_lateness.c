// SPDX-License-Identifier: Apache-2.0
#include "lateness.h"

#include <string.h>
#include <unity.h>

static const int64_t MS = 1000000, MAX_WAIT = 250 * 1000000LL;
static ipe_lateness_t l;
static uint64_t n_samples, n_lost;
static int64_t imu_ns;

void setUp(void)
{
    memset(&l, 0, sizeof l);
    n_samples = n_lost = 0;
    imu_ns = 0;
}

void tearDown(void)
{
}

/// Samples every period_ms, each late_ms after its instant, the IMU at 1 kHz; rows are lost if more is needed than max_wait.
static void run(int64_t duration_ms, int64_t period_ms, int64_t late_ms)
{
    for (int64_t i = 0; i < duration_ms; ++i) {
        imu_ns += MS;
        const int64_t t_ms = imu_ns / MS - late_ms;
        if (t_ms > 0 && t_ms % period_ms == 0) { ipe_lateness_push(&l, ++n_samples, t_ms * MS, imu_ns); }
        n_lost += late_ms + period_ms > MAX_WAIT / MS;
    }
}

static void test_lateness_beyond_max_wait_begins_once_and_recommends_enough(void)
{
    run(1000, 40, 310);
    TEST_ASSERT_EQUAL(IPE_LATENESS_BEGAN, ipe_lateness_look(&l, n_lost, MAX_WAIT));
    TEST_ASSERT_EQUAL_INT64(310 * MS, l.worst_ns);
    TEST_ASSERT_EQUAL_DOUBLE(0.35, ipe_lateness_advice(&l));
    run(1000, 40, 310);
    TEST_ASSERT_EQUAL(IPE_LATENESS_SAME, ipe_lateness_look(&l, n_lost, MAX_WAIT));
}

static void test_lateness_ends_when_samples_are_in_time_and_the_advice_stays(void)
{
    run(1000, 10, 400);
    TEST_ASSERT_EQUAL(IPE_LATENESS_BEGAN, ipe_lateness_look(&l, n_lost, MAX_WAIT));
    run(1000, 10, 100);
    TEST_ASSERT_EQUAL(IPE_LATENESS_ENDED, ipe_lateness_look(&l, n_lost, MAX_WAIT));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.45, ipe_lateness_advice(&l));
}

static void test_lateness_within_max_wait_is_no_event_and_no_advice(void)
{
    run(1000, 40, 200);
    n_lost += 3;  // rows lost for another cause
    TEST_ASSERT_EQUAL(IPE_LATENESS_SAME, ipe_lateness_look(&l, n_lost, MAX_WAIT));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, ipe_lateness_advice(&l));
    TEST_ASSERT_EQUAL_INT64(200 * MS, l.worst_ns);
}

static void test_lateness_gap_of_a_prompt_sensor_is_no_lateness(void)
{
    run(500, 10, 5);
    imu_ns += 2000 * MS;  // when: silent for 2 s
    n_lost += 2000;
    run(500, 10, 5);
    TEST_ASSERT_EQUAL(IPE_LATENESS_SAME, ipe_lateness_look(&l, n_lost, MAX_WAIT));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_lateness_beyond_max_wait_begins_once_and_recommends_enough);
    RUN_TEST(test_lateness_ends_when_samples_are_in_time_and_the_advice_stays);
    RUN_TEST(test_lateness_within_max_wait_is_no_event_and_no_advice);
    RUN_TEST(test_lateness_gap_of_a_prompt_sensor_is_no_lateness);
    return UNITY_END();
}
