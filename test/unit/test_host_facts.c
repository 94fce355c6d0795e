// SPDX-License-Identifier: Apache-2.0
#include "host_facts.h"

#include <stdio.h>
#include <string.h>
#include <sys/utsname.h>
#include <unity.h>

static ipe_host_facts_t facts;

void setUp(void)
{
    memset(&facts, 0, sizeof facts);
}

void tearDown(void)
{
}

static const char* fact(const char* name)
{
    for (unsigned i = 0; i < facts.n; ++i) {
        if (strcmp(facts.fact[i].name, name) == 0) { return facts.fact[i].value; }
    }
    return NULL;
}

static void test_facts_tell_the_kernel_and_the_clock(void)
{
    struct utsname u;
    TEST_ASSERT_EQUAL(0, uname(&u));
    ipe_host_facts_read(&facts);
    TEST_ASSERT_NOT_NULL(strstr(fact("kernel"), u.release));
    TEST_ASSERT_NOT_NULL(fact("clock.synchronised"));
    TEST_ASSERT_EQUAL_STRING("SCHED_OTHER", fact("scheduling"));
    TEST_ASSERT_NOT_NULL(fact("memory.locked"));
}

static void test_facts_of_the_loopback_interface_have_no_bit_timing(void)
{
    ipe_host_facts_read_interface(&facts, "lo");
    TEST_ASSERT_NOT_NULL(strstr(fact("lo.stamps"), "hardware no"));
    TEST_ASSERT_NULL(fact("lo.bit_timing"));
}

static void test_facts_of_no_interface_say_unknown(void)
{
    ipe_host_facts_read_interface(&facts, "nosuch0");
    TEST_ASSERT_EQUAL_STRING("unknown", fact("nosuch0.stamps"));
    TEST_ASSERT_EQUAL(1, facts.n);
}

static void test_facts_beyond_their_room_are_left_out_or_cut(void)
{
    for (int i = 0; i < IPE_FACTS_MAX + 5; ++i) { ipe_host_facts_add(&facts, "name", "%0300d", i); }
    TEST_ASSERT_EQUAL(IPE_FACTS_MAX, facts.n);
    TEST_ASSERT_EQUAL(IPE_FACT_VALUE_MAX - 1, strlen(facts.fact[0].value));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_facts_tell_the_kernel_and_the_clock);
    RUN_TEST(test_facts_of_the_loopback_interface_have_no_bit_timing);
    RUN_TEST(test_facts_of_no_interface_say_unknown);
    RUN_TEST(test_facts_beyond_their_room_are_left_out_or_cut);
    return UNITY_END();
}
