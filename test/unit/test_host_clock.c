// SPDX-License-Identifier: Apache-2.0
/// Clocks that the test sets: every reading takes 100 ns.
#include "host_clock.h"

#include <unity.h>

static const int64_t S = 1000000000, MS = 1000000, US = 1000;
static ipe_host_clock_t c;
static int64_t monotonic_ns, offset_ns;
static int64_t interruption_ns;  // in the reading of CLOCK_REALTIME, once

static int read_clock(clockid_t clock, struct timespec* t)
{
    monotonic_ns += 100;
    if (clock == CLOCK_REALTIME) {
        monotonic_ns += interruption_ns;
        interruption_ns = 0;
    }
    const int64_t ns = monotonic_ns + (clock == CLOCK_REALTIME ? offset_ns : 0);
    *t = (struct timespec){.tv_sec = ns / 1000000000, .tv_nsec = ns % 1000000000};
    return 0;
}

/// What the kernel would stamp now.
static int64_t stamp(void)
{
    return monotonic_ns + offset_ns;
}

void setUp(void)
{
    monotonic_ns = 5000 * S;
    offset_ns = 1700000000 * S;
    interruption_ns = 0;
    ipe_host_clock_init(&c, read_clock);
}

void tearDown(void)
{
}

static void test_map_without_a_step_is_the_stamp_itself(void)
{
    monotonic_ns += 3 * S;
    TEST_ASSERT_FALSE(ipe_host_clock_refresh(&c));
    TEST_ASSERT_EQUAL_INT64(stamp() - 20 * US, ipe_host_clock_map(&c, stamp() - 20 * US));
    TEST_ASSERT_INT64_WITHIN(US, stamp(), ipe_host_clock_now(&c));
}

/// Stamps every millisecond, read 5 ms late in batches; the clock is stepped in the middle of a batch.
static void check_step(int64_t step_ns)
{
    int64_t stamped[5], last_ns = 0;
    for (int batch = 0; batch < 40; ++batch) {
        for (int i = 0; i < 5; ++i) {
            monotonic_ns += MS;
            if (batch == 20 && i == 3) { offset_ns += step_ns; }
            stamped[i] = stamp();
        }
        TEST_ASSERT_EQUAL(batch == 20, ipe_host_clock_refresh(&c));
        for (int i = 0; i < 5; ++i) {
            const int64_t t_ns = ipe_host_clock_map(&c, stamped[i]);
            if (last_ns != 0) { TEST_ASSERT_INT64_WITHIN(US, MS, t_ns - last_ns); }
            last_ns = t_ns;
        }
    }
    TEST_ASSERT_EQUAL_UINT64(1, c.n_steps);
    TEST_ASSERT_INT64_WITHIN(US, step_ns, c.step_ns);
    setUp();
}

static void test_map_steps_of_any_size_make_no_jump(void)
{
    check_step(3600 * S);
    check_step(-3600 * S);
    check_step(10 * MS);
    check_step(-10 * MS);
}

static void test_map_two_steps_add_up(void)
{
    const int64_t first_ns = ipe_host_clock_now(&c);
    offset_ns += 3600 * S;
    TEST_ASSERT_TRUE(ipe_host_clock_refresh(&c));
    offset_ns -= 7200 * S;
    TEST_ASSERT_TRUE(ipe_host_clock_refresh(&c));
    TEST_ASSERT_INT64_WITHIN(5 * US, first_ns, ipe_host_clock_map(&c, stamp()));
    TEST_ASSERT_INT64_WITHIN(5 * US, first_ns, ipe_host_clock_now(&c));
}

static void test_map_late_reading_long_after_a_step_is_not_taken_for_an_old_stamp(void)
{
    offset_ns += 10 * MS;
    TEST_ASSERT_TRUE(ipe_host_clock_refresh(&c));
    monotonic_ns += 2 * S;
    const int64_t stamped = stamp(), was_ns = ipe_host_clock_now(&c);
    monotonic_ns += 15 * MS;
    TEST_ASSERT_FALSE(ipe_host_clock_refresh(&c));
    TEST_ASSERT_INT64_WITHIN(US, was_ns, ipe_host_clock_map(&c, stamped));
}

static void test_refresh_interrupted_reading_is_no_step(void)
{
    interruption_ns = 10 * MS;
    TEST_ASSERT_FALSE(ipe_host_clock_refresh(&c));
    TEST_ASSERT_EQUAL_UINT64(0, c.n_steps);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_map_without_a_step_is_the_stamp_itself);
    RUN_TEST(test_map_steps_of_any_size_make_no_jump);
    RUN_TEST(test_map_two_steps_add_up);
    RUN_TEST(test_map_late_reading_long_after_a_step_is_not_taken_for_an_old_stamp);
    RUN_TEST(test_refresh_interrupted_reading_is_no_step);
    return UNITY_END();
}
