// SPDX-License-Identifier: Apache-2.0
#include "../../firmware/ports/cortex_m7/fdcan.c"
#include "../../firmware/ports/cortex_m7/frame_ring.c"

#include "unity.h"

static ipe_frame_ring_t ring;

void setUp(void)
{
    ring = (ipe_frame_ring_t){0};
}

void tearDown(void)
{
}

static void test_frame_standard_identifier_and_data(void)
{
    const uint32_t element[4] = {0x123U << 18, 5U << 16, 0x04030201U, 0x00000005U};
    const ipe_frame_t frame = ipe_fdcan_frame(element);
    TEST_ASSERT_EQUAL_HEX32(0x123, frame.can_id);
    TEST_ASSERT_EQUAL(5, frame.length);
    TEST_ASSERT_EQUAL(0, frame.flags);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(((uint8_t[]){1, 2, 3, 4, 5, 0, 0, 0}), frame.data, 8);
}

static void test_frame_extended_and_remote_are_marked_as_socketcan_does(void)
{
    const uint32_t element[4] = {(1U << 30) | (1U << 29) | 0x1ABCDEF0U, 8U << 16, 0xFFFFFFFFU, 0xFFFFFFFFU};
    const ipe_frame_t frame = ipe_fdcan_frame(element);
    TEST_ASSERT_EQUAL_HEX32((1U << 31) | (1U << 30) | 0x1ABCDEF0U, frame.can_id);
    TEST_ASSERT_EQUAL(0, frame.data[0]);
}

static void test_frame_long_code_is_8_bytes_unless_fd(void)
{
    uint32_t element[18] = {0x7FFU << 18, 15U << 16};
    element[17] = 0x40000000U;
    TEST_ASSERT_EQUAL(8, ipe_fdcan_frame(element).length);
    element[0] |= 1U << 31;
    element[1] |= (1U << 21) | (1U << 20);
    const ipe_frame_t frame = ipe_fdcan_frame(element);
    TEST_ASSERT_EQUAL(64, frame.length);
    TEST_ASSERT_EQUAL(IPE_FRAME_FD | IPE_FRAME_BRS | IPE_FRAME_ESI, frame.flags);
    TEST_ASSERT_EQUAL_HEX8(0x40, frame.data[63]);
}

static void test_ring_keeps_order_and_refuses_when_full(void)
{
    for (uint32_t i = 0; i < IPE_FRAME_RING + 3U; ++i) {
        const ipe_frame_t frame = {.can_id = i};
        TEST_ASSERT_EQUAL(i < IPE_FRAME_RING, ipe_frame_ring_put(&ring, &frame));
    }
    TEST_ASSERT_EQUAL(3, ring.n_lost);
    for (uint32_t i = 0; i < IPE_FRAME_RING; ++i) {
        TEST_ASSERT_EQUAL(i, ipe_frame_ring_oldest(&ring)->can_id);
        ipe_frame_ring_drop(&ring);
    }
    TEST_ASSERT_NULL(ipe_frame_ring_oldest(&ring));
    TEST_ASSERT_EQUAL(IPE_FRAME_RING, ring.n_most);
}

static void test_ring_works_where_its_counters_overflow(void)
{
    ring.head = ring.tail = UINT32_MAX - 1U;
    for (uint32_t i = 0; i < 5; ++i) {
        const ipe_frame_t frame = {.can_id = i};
        TEST_ASSERT_TRUE(ipe_frame_ring_put(&ring, &frame));
        TEST_ASSERT_EQUAL(i, ipe_frame_ring_oldest(&ring)->can_id);
        ipe_frame_ring_drop(&ring);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_frame_standard_identifier_and_data);
    RUN_TEST(test_frame_extended_and_remote_are_marked_as_socketcan_does);
    RUN_TEST(test_frame_long_code_is_8_bytes_unless_fd);
    RUN_TEST(test_ring_keeps_order_and_refuses_when_full);
    RUN_TEST(test_ring_works_where_its_counters_overflow);
    return UNITY_END();
}
