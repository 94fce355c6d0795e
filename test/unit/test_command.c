// SPDX-License-Identifier: Apache-2.0
#include "command.h"

#include "inertiad_lcm_expectation_t.h"

#include <string.h>
#include <unity.h>

static const int64_t S = 1000000000;
static uint8_t bytes[512];
static ipe_expectation_t expectation;

void setUp(void)
{
    memset(&expectation, 0, sizeof expectation);
}

void tearDown(void)
{
}

/// An EXPECT with its content.
static ipe_command_t expect(int64_t t_ns, double mass, double last)
{
    inertiad_lcm_expectation_t e = {.t_ns = t_ns, .mass = mass};
    e.inertia_cog_std[5] = last;
    const int n = inertiad_lcm_expectation_t_encode(bytes, 0, sizeof bytes, &e);
    TEST_ASSERT_GREATER_THAN(0, n);
    return (ipe_command_t){.kind = IPE_COMMAND_EXPECT, .config = bytes, .n_config = (size_t)n};
}

static void test_expectation_is_read_whole(void)
{
    const ipe_command_t c = expect(7 * S, -30.0, 0.25);                   // given
    TEST_ASSERT_EQUAL_INT(0, ipe_command_expectation(&c, &expectation));  // when
    TEST_ASSERT_EQUAL_INT64(7 * S, expectation.t_ns);                     // then
    TEST_ASSERT_EQUAL_DOUBLE(-30.0, expectation.number[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, expectation.number[IPE_ANNOUNCEMENT_NUMBERS - 1]);
}

static void test_expectation_cut_long_or_of_another_version_is_refused(void)
{
    const ipe_command_t whole = expect(S, 1.0, 0.0);
    for (size_t n = 0; n <= whole.n_config + 1; ++n) {
        ipe_command_t c = whole;
        c.n_config = n;
        TEST_ASSERT_EQUAL_INT(n == whole.n_config ? 0 : -1, ipe_command_expectation(&c, &expectation));
    }
    bytes[0] ^= 1U;
    TEST_ASSERT_EQUAL_INT(-1, ipe_command_expectation(&whole, &expectation));
}

static void test_contact_is_as_long_after_sending_as_the_sender_says(void)
{
    int64_t t_ns = 0;
    const ipe_command_t sent = {.t_ns = 1100 * S};  // given: the clock was set 100 s ahead since the daemon began
    expectation.t_ns = 1102 * S;
    TEST_ASSERT_EQUAL_INT(0, ipe_command_contact(&sent, &expectation, 1000 * S, &t_ns));  // when
    TEST_ASSERT_EQUAL_INT64(1002 * S, t_ns);                                              // then
}

static void test_contact_at_times_that_are_none_is_refused(void)
{
    const int64_t BAD[][3] = {{-1, 0, 0},
                              {INT64_MIN, INT64_MIN, 5 * S},  // 0 s after sending: the sum would overflow
                              {INT64_MAX, INT64_MAX, 5 * S},
                              {0, -1, 0},
                              {0, 0, -1},
                              {0, IPE_TIME_MAX_NS, 1},
                              {2, 0, 1}};
    for (size_t i = 0; i < sizeof BAD / sizeof BAD[0]; ++i) {
        int64_t t_ns = 7;
        const ipe_command_t sent = {.t_ns = BAD[i][0]};
        expectation.t_ns = BAD[i][1];
        TEST_ASSERT_EQUAL_INT(-1, ipe_command_contact(&sent, &expectation, BAD[i][2], &t_ns));
        TEST_ASSERT_EQUAL_INT64(7, t_ns);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_expectation_is_read_whole);
    RUN_TEST(test_expectation_cut_long_or_of_another_version_is_refused);
    RUN_TEST(test_contact_is_as_long_after_sending_as_the_sender_says);
    RUN_TEST(test_contact_at_times_that_are_none_is_refused);
    return UNITY_END();
}
