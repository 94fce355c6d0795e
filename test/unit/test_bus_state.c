// SPDX-License-Identifier: Apache-2.0
#include "bus_state.h"

#include <linux/can/error.h>
#include <string.h>
#include <unity.h>

static ipe_bus_state_t state;

void setUp(void)
{
    memset(&state, 0, sizeof state);
}

void tearDown(void)
{
}

static const char* push(uint32_t class, uint8_t status)
{
    const ipe_frame_t frame = {.can_id = IPE_CAN_ERR | class, .length = 8, .data = {0, status}};
    return ipe_bus_state_push(&state, &frame);
}

static void test_bus_state_follows_a_controller_down_and_back(void)
{
    TEST_ASSERT_EQUAL_STRING("error-warning", push(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_WARNING));
    TEST_ASSERT_EQUAL_STRING("error-passive", push(CAN_ERR_CRTL, CAN_ERR_CRTL_TX_PASSIVE | CAN_ERR_CRTL_TX_WARNING));
    TEST_ASSERT_EQUAL_STRING("bus-off", push(CAN_ERR_BUSOFF, 0));
    TEST_ASSERT_EQUAL(IPE_BUS_OFF, state.condition);
    TEST_ASSERT_EQUAL_STRING("restarted", push(CAN_ERR_RESTARTED, 0));
    TEST_ASSERT_EQUAL(IPE_BUS_ACTIVE, state.condition);
    TEST_ASSERT_EQUAL_STRING("error-passive", push(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_PASSIVE));
    TEST_ASSERT_EQUAL_STRING("error-active", push(CAN_ERR_CRTL, CAN_ERR_CRTL_ACTIVE));
    const uint64_t expected[] = {1, 2, 1, 1};
    uint64_t value;
    for (unsigned i = 0; i < 4; ++i) {
        TEST_ASSERT_NOT_NULL(ipe_bus_state_counter(&state, i, &value));
        TEST_ASSERT_EQUAL_UINT64(expected[i], value);
    }
    TEST_ASSERT_NULL(ipe_bus_state_counter(&state, 4, &value));
}

static void test_bus_state_open_after_bus_off_is_active_and_counts_stay(void)
{
    TEST_ASSERT_EQUAL_STRING("bus-off", push(CAN_ERR_BUSOFF, 0));
    ipe_bus_state_open(&state);
    TEST_ASSERT_EQUAL(IPE_BUS_ACTIVE, state.condition);
    TEST_ASSERT_EQUAL_UINT64(1, state.n_off);
    TEST_ASSERT_EQUAL_STRING("bus-off", push(CAN_ERR_BUSOFF, 0));
}

static void test_bus_state_a_storm_of_the_same_is_told_once(void)
{
    TEST_ASSERT_NOT_NULL(push(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_WARNING));
    for (int i = 0; i < 1000; ++i) { TEST_ASSERT_NULL(push(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_WARNING)); }
    TEST_ASSERT_EQUAL_UINT64(1, state.n_warning);
}

static void test_bus_state_other_errors_say_nothing_of_it(void)
{
    TEST_ASSERT_NULL(push(CAN_ERR_PROT | CAN_ERR_BUSERROR | CAN_ERR_ACK, 0xFF));
    TEST_ASSERT_NULL(push(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_OVERFLOW));
    const ipe_frame_t empty = {.can_id = IPE_CAN_ERR | CAN_ERR_CRTL, .length = 1, .data = {0, 0xFF}};
    TEST_ASSERT_NULL(ipe_bus_state_push(&state, &empty));
    TEST_ASSERT_EQUAL(IPE_BUS_ACTIVE, state.condition);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_bus_state_follows_a_controller_down_and_back);
    RUN_TEST(test_bus_state_open_after_bus_off_is_active_and_counts_stay);
    RUN_TEST(test_bus_state_a_storm_of_the_same_is_told_once);
    RUN_TEST(test_bus_state_other_errors_say_nothing_of_it);
    return UNITY_END();
}
