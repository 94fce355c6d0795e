// SPDX-License-Identifier: Apache-2.0
#include "command_guard.h"

#include <string.h>
#include <unity.h>

#define SECOND 1000000000LL
#define NOW (1000 * SECOND)
#define LISTENED (100 * SECOND)

static ipe_command_guard_t guard;

void setUp(void)
{
    memset(&guard, 0, sizeof guard);
}

void tearDown(void)
{
}

static ipe_command_novelty_t check_after(int64_t listened_ns, int64_t sequence, int64_t t_ns, int64_t now_ns)
{
    const ipe_command_t command = {.sender = 1, .sequence = sequence, .t_ns = t_ns};
    return ipe_command_guard_check(&guard, &command, now_ns, listened_ns);
}

static ipe_command_novelty_t check(int64_t sender, int64_t sequence, int64_t t_ns, int64_t now_ns)
{
    const ipe_command_t command = {.sender = sender, .sequence = sequence, .t_ns = t_ns};
    return ipe_command_guard_check(&guard, &command, now_ns, LISTENED);
}

static void test_command_is_new_once(void)
{
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(1, 1, NOW, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_REPEATED, check(1, 1, NOW, NOW + SECOND));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(1, 2, NOW, NOW + SECOND));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(2, 1, NOW, NOW + SECOND));
}

static void test_command_of_another_time_is_refused(void)
{
    TEST_ASSERT_EQUAL(IPE_COMMAND_OLD, check(1, 1, NOW - IPE_COMMAND_AGE_MAX - 1, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_AHEAD, check(1, 2, NOW + IPE_COMMAND_AGE_MAX + 1, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(1, 3, NOW - IPE_COMMAND_AGE_MAX, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(1, 4, NOW + IPE_COMMAND_AGE_MAX, NOW));
}

static void test_command_from_before_the_start_is_refused(void)
{
    TEST_ASSERT_EQUAL(IPE_COMMAND_EARLY, check_after(2 * SECOND, 1, NOW - 2 * SECOND - 1, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check_after(2 * SECOND, 2, NOW - 2 * SECOND, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_EARLY, check_after(0, 3, NOW - 1, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check_after(0, 3, NOW, NOW));  // what was refused is not kept
    TEST_ASSERT_EQUAL(IPE_COMMAND_OLD, check_after(SECOND, 4, NOW - IPE_COMMAND_AGE_MAX - 1, NOW));
}

static void test_clock_set_back_below_the_start_makes_no_command_early(void)
{
    const int64_t hour = 3600 * SECOND;  // the daemon began at NOW; the clock was then set an hour back
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check_after(5 * SECOND, 1, NOW - hour + 5 * SECOND, NOW - hour + 5 * SECOND));
}

static void test_stamp_ahead_is_remembered_until_it_is_old(void)
{
    const int64_t ahead = NOW + IPE_COMMAND_AGE_MAX;
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(1, 1, ahead, NOW));
    TEST_ASSERT_EQUAL(IPE_COMMAND_REPEATED, check(1, 1, ahead, ahead + IPE_COMMAND_AGE_MAX));
    TEST_ASSERT_EQUAL(IPE_COMMAND_OLD, check(1, 1, ahead, ahead + IPE_COMMAND_AGE_MAX + 1));
}

static void test_full_memory_refuses_until_commands_are_old(void)
{
    for (int i = 0; i < IPE_COMMANDS_KEPT; ++i) { TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(1, i, NOW, NOW)); }
    TEST_ASSERT_EQUAL(IPE_COMMAND_TOO_MANY, check(1, IPE_COMMANDS_KEPT, NOW, NOW));
    const int64_t later = NOW + IPE_COMMAND_AGE_MAX + 1;
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(1, IPE_COMMANDS_KEPT, later, later));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_command_is_new_once);
    RUN_TEST(test_command_of_another_time_is_refused);
    RUN_TEST(test_command_from_before_the_start_is_refused);
    RUN_TEST(test_clock_set_back_below_the_start_makes_no_command_early);
    RUN_TEST(test_stamp_ahead_is_remembered_until_it_is_old);
    RUN_TEST(test_full_memory_refuses_until_commands_are_old);
    return UNITY_END();
}
