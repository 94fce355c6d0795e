// SPDX-License-Identifier: Apache-2.0
#include "presence.h"

#include <string.h>
#include <unity.h>

static const int64_t MS = 1000000;
static ipe_presence_t p;
static uint64_t n_samples;
static int64_t newest_ns, now_ns;

void setUp(void)
{
    memset(&p, 0, sizeof p);
    n_samples = 0;
    newest_ns = 0;
    now_ns = 1000 * MS;
}

void tearDown(void)
{
}

/// A look every 100 ms for so long, samples at this period, 0: none. Number of looks until the change came, 0: never.
static int look(int64_t duration_ms, int64_t period_ms, ipe_presence_change_t change)
{
    int found = 0;
    for (int i = 1; i <= duration_ms / 100; ++i) {
        now_ns += 100 * MS;
        for (; period_ms > 0 && newest_ns + period_ms * MS <= now_ns; ++n_samples) {
            newest_ns = newest_ns == 0 ? now_ns : newest_ns + period_ms * MS;
        }
        if (ipe_presence_look(&p, n_samples, newest_ns, now_ns) == change && found == 0) { found = i; }
    }
    return found;
}

static void test_presence_silence_of_ten_periods_is_a_loss_told_once(void)
{
    TEST_ASSERT_EQUAL(0, look(3000, 50, IPE_PRESENCE_LOST));
    TEST_ASSERT_EQUAL(6, look(3000, 0, IPE_PRESENCE_LOST));
    TEST_ASSERT_EQUAL_UINT64(1, p.n_lost);
    TEST_ASSERT_TRUE(p.is_lost);
    TEST_ASSERT_EQUAL(1, look(1000, 50, IPE_PRESENCE_BACK));
    TEST_ASSERT_INT64_WITHIN(200 * MS, 3000 * MS, p.silence_ns);
    TEST_ASSERT_EQUAL(0, look(1000, 50, IPE_PRESENCE_BACK));
}

static void test_presence_fast_sensor_may_be_silent_for_a_fifth_of_a_second(void)
{
    TEST_ASSERT_EQUAL(0, look(1000, 1, IPE_PRESENCE_LOST));
    TEST_ASSERT_EQUAL(3, look(1000, 0, IPE_PRESENCE_LOST));
}

static void test_presence_sensor_that_never_came_is_lost_after_five_seconds(void)
{
    TEST_ASSERT_EQUAL(52, look(6000, 0, IPE_PRESENCE_LOST));
    TEST_ASSERT_EQUAL(1, look(200, 10, IPE_PRESENCE_BACK));
}

static void test_presence_time_that_goes_back_is_no_loss(void)
{
    (void)look(1000, 10, IPE_PRESENCE_LOST);
    now_ns = 100 * MS;
    newest_ns = 100 * MS;
    TEST_ASSERT_EQUAL(0, look(2000, 10, IPE_PRESENCE_LOST));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_presence_silence_of_ten_periods_is_a_loss_told_once);
    RUN_TEST(test_presence_fast_sensor_may_be_silent_for_a_fifth_of_a_second);
    RUN_TEST(test_presence_sensor_that_never_came_is_lost_after_five_seconds);
    RUN_TEST(test_presence_time_that_goes_back_is_no_loss);
    return UNITY_END();
}
