// SPDX-License-Identifier: Apache-2.0
#include "unbound.h"

#include <string.h>
#include <unity.h>

static ipe_unbound_t u;
static ipe_config_t config;
static char text[512];

void setUp(void)
{
    memset(&u, 0, sizeof u);
    memset(&config, 0, sizeof config);
    config.n_signals = 3;
    config.signal[0].can_id = 0x100;
    config.signal[1].can_id = 0x100;
    config.signal[2].can_id = IPE_CAN_EFF | 0x18FF10;
    config.signal[2].bus = 1;
}

void tearDown(void)
{
}

static void note(uint32_t can_id, uint8_t bus)
{
    const ipe_frame_t frame = {.can_id = can_id, .bus = bus};
    ipe_unbound_note(&u, &frame);
}

static void test_unbound_names_each_identifier_once_beside_those_expected(void)
{
    note(0x123, 0);
    note(0x123, 0);
    note(0x123, 1);
    note(IPE_CAN_EFF | 0x123, 0);
    note(IPE_CAN_RTR | 0x7F, 0);
    ipe_unbound_describe(&u, &config, text, sizeof text);
    TEST_ASSERT_EQUAL_STRING("received 123 on bus 0, 123 on bus 1, 00000123 on bus 0, 07F on bus 0 (remote); "
                             "expected 100 on bus 0, 0018FF10 on bus 1",
                             text);
}

static void test_unbound_passes_over_error_frames(void)
{
    note(IPE_CAN_ERR | 0x4, 0);
    TEST_ASSERT_EQUAL(0, u.n);
}

static void test_unbound_keeps_a_dozen_and_says_that_there_are_more(void)
{
    for (uint32_t i = 0; i < 2 * IPE_UNBOUND_MAX; ++i) { note(0x200 + i, 0); }
    TEST_ASSERT_EQUAL(IPE_UNBOUND_MAX, u.n);
    ipe_unbound_describe(&u, &config, text, sizeof text);
    TEST_ASSERT_NOT_NULL(strstr(text, "20B on bus 0, ...; expected 100 on bus 0"));
}

static void test_unbound_text_ends_within_its_size(void)
{
    for (uint32_t i = 0; i < IPE_UNBOUND_MAX; ++i) { note(0x200 + i, 0); }
    memset(text, 'x', sizeof text);
    ipe_unbound_describe(&u, &config, text, 40);
    TEST_ASSERT_EQUAL('\0', text[39]);
    TEST_ASSERT_EQUAL('x', text[40]);
    TEST_ASSERT_EQUAL(39, strlen(text));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_unbound_names_each_identifier_once_beside_those_expected);
    RUN_TEST(test_unbound_passes_over_error_frames);
    RUN_TEST(test_unbound_keeps_a_dozen_and_says_that_there_are_more);
    RUN_TEST(test_unbound_text_ends_within_its_size);
    return UNITY_END();
}
