// SPDX-License-Identifier: Apache-2.0
#include "candump.h"

#include <stdlib.h>
#include <string.h>
#include <unity.h>

static ipe_frame_t frame;
static ipe_candump_name_t name;
static uint64_t n_dropped;

void setUp(void)
{
    memset(&frame, 0x55, sizeof frame);
    n_dropped = 0;
}

void tearDown(void)
{
}

/// From a heap copy of just the line's size, so that the sanitizer sees any step past its end.
static ipe_candump_t parse_bytes(const void* line, size_t n)
{
    char* copy = malloc(n > 0 ? n : 1);
    memcpy(copy, line, n);
    const ipe_candump_t result = ipe_candump_parse(copy, n, &frame, &name, &n_dropped);
    free(copy);
    return result;
}

static ipe_candump_t parse(const char* line)
{
    return parse_bytes(line, strlen(line));
}

static void check_frame(const char* line, uint32_t can_id, int flags, int length)
{
    TEST_ASSERT_EQUAL_MESSAGE(IPE_CANDUMP_FRAME, parse(line), line);
    TEST_ASSERT_EQUAL_HEX32_MESSAGE(can_id, frame.can_id, line);
    TEST_ASSERT_EQUAL_MESSAGE(flags, frame.flags, line);
    TEST_ASSERT_EQUAL_MESSAGE(length, frame.length, line);
}

static void test_candump_classical_frame_is_read_to_the_last_bit(void)
{
    check_frame("(1436509052.249713) can0 123#00FF1a2B", 0x123, 0, 4);
    const uint8_t data[8] = {0x00, 0xFF, 0x1A, 0x2B};
    TEST_ASSERT_EQUAL_HEX8_ARRAY(data, frame.data, 8);
    TEST_ASSERT_EQUAL_INT64(1436509052249713000, frame.t_ns);
    TEST_ASSERT_EQUAL_INT64(0, frame.t_hw_ns);
    TEST_ASSERT_EQUAL_HEX8(0x55, frame.bus);
}

static void test_candump_every_kind_of_frame_is_known(void)
{
    check_frame("(1.5) can0 7FF#", 0x7FF, 0, 0);
    check_frame("(1.5) can0 00000123#01", 0x123 | IPE_CAN_EFF, 0, 1);
    check_frame("(1.5) can0 1FFFFFFF#0102030405060708", 0x1FFFFFFF | IPE_CAN_EFF, 0, 8);
    check_frame("(1.5) can0 123#0102030405060708_B", 0x123, 0, 8);
    check_frame("(1.5) can0 123#R", 0x123 | IPE_CAN_RTR, 0, 0);
    check_frame("(1.5) can0 1FFFFFFF#R8", 0x1FFFFFFF | IPE_CAN_EFF | IPE_CAN_RTR, 0, 8);
    check_frame("(1.5) can0 123##0", 0x123, IPE_FRAME_FD, 0);
    check_frame("(1.5) can0 123##1AA", 0x123, IPE_FRAME_FD | IPE_FRAME_BRS, 1);
    check_frame("(1.5) can0 123##3000102030405060708090A0B", 0x123, IPE_FRAME_FD | IPE_FRAME_BRS | IPE_FRAME_ESI, 12);
    check_frame("(1.5) can0 20000004#0001000000000000", 0x4 | IPE_CAN_ERR, 0, 8);
}

static void test_candump_longest_frame_fills_64_bytes(void)
{
    char line[200] = "(1.5) can0 123##1";
    for (int i = 0; i < 64; ++i) { strcat(line, "C3"); }
    check_frame(line, 0x123, IPE_FRAME_FD | IPE_FRAME_BRS, 64);
    TEST_ASSERT_EACH_EQUAL_HEX8(0xC3, frame.data, 64);
    strcat(line, "C3");
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_DATA, parse(line));
}

static void test_candump_direction_and_spaces_after_the_data_are_passed_over(void)
{
    check_frame("(1.5) can0 123#01 R", 0x123, 0, 1);
    check_frame("(1.5) can0 123#01 T\r", 0x123, 0, 1);
    check_frame("  (1.5)  can0  123#01  ", 0x123, 0, 1);
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_TAIL, parse("(1.5) can0 123#01 X"));
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_TAIL, parse("(1.5) can0 123#01 R R"));
}

static void test_candump_fraction_of_one_to_nine_digits_is_nanoseconds(void)
{
    TEST_ASSERT_EQUAL(IPE_CANDUMP_FRAME, parse("(0000000001.5) can0 123#"));
    TEST_ASSERT_EQUAL_INT64(1500000000, frame.t_ns);
    TEST_ASSERT_EQUAL(IPE_CANDUMP_FRAME, parse("(8999999999.123456789) can0 123#"));
    TEST_ASSERT_EQUAL_INT64(8999999999123456789, frame.t_ns);
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_STAMP, parse("(9000000000.0) can0 123#"));
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_STAMP, parse("(1.1234567890) can0 123#"));
}

static void test_candump_interface_name_is_a_view_into_the_line(void)
{
    const char* line = "(1.5) vcan12 123#";
    TEST_ASSERT_EQUAL(IPE_CANDUMP_FRAME, ipe_candump_parse(line, strlen(line), &frame, &name, &n_dropped));
    TEST_ASSERT_EQUAL(6, name.length);
    TEST_ASSERT_EQUAL_PTR(line + 6, name.text);
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_NAME, parse("(1.5) sixteen_letters_ 123#"));
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_NAME, parse("(1.5)"));
}

static void test_candump_comment_blank_and_drop_lines_are_told_apart(void)
{
    TEST_ASSERT_EQUAL(IPE_CANDUMP_COMMENT, parse(""));
    TEST_ASSERT_EQUAL(IPE_CANDUMP_COMMENT, parse(" \t\r"));
    TEST_ASSERT_EQUAL(IPE_CANDUMP_COMMENT, parse("# (1.5) can0 123#01"));
    TEST_ASSERT_EQUAL(IPE_CANDUMP_COMMENT, parse(" ; note"));
    TEST_ASSERT_EQUAL(IPE_CANDUMP_DROPS, parse("DROPCOUNT: dropped 12 CAN frames on 'can0' socket (total drops 40)"));
    TEST_ASSERT_EQUAL_UINT64(12, n_dropped);
    TEST_ASSERT_EQUAL(IPE_CANDUMP_BAD_STAMP, parse("DROPCOUNT: dropped some"));
}

static void test_candump_bad_lines_say_what_is_bad(void)
{
    static const struct {
        ipe_candump_t result;
        const char* line;
    } BAD[] = {
        {IPE_CANDUMP_BAD_STAMP, "garbage"},
        {IPE_CANDUMP_BAD_STAMP, "(1.5 can0 123#"},
        {IPE_CANDUMP_BAD_STAMP, "(-1.5) can0 123#"},
        {IPE_CANDUMP_BAD_STAMP, "(.5) can0 123#"},
        {IPE_CANDUMP_BAD_STAMP, "(1.) can0 123#"},
        {IPE_CANDUMP_BAD_ID, "(1.5) can0"},
        {IPE_CANDUMP_BAD_ID, "(1.5) can0 123"},
        {IPE_CANDUMP_BAD_ID, "(1.5) can0 12#"},
        {IPE_CANDUMP_BAD_ID, "(1.5) can0 1234#"},
        {IPE_CANDUMP_BAD_ID, "(1.5) can0 800#"},
        {IPE_CANDUMP_BAD_ID, "(1.5) can0 123456789#"},
        {IPE_CANDUMP_BAD_ID, "(1.5) can0 40000000#"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123#0"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123#0G"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123#010203040506070809"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123#0102_B"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123#0102030405060708_8"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123#R9"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123##"},
        {IPE_CANDUMP_BAD_DATA, "(1.5) can0 123##1010203040506070809"},
    };
    for (size_t i = 0; i < sizeof BAD / sizeof BAD[0]; ++i) {
        TEST_ASSERT_EQUAL_MESSAGE(BAD[i].result, parse(BAD[i].line), BAD[i].line);
    }
}

static void test_candump_line_cut_anywhere_is_never_another_frame_of_full_length(void)
{
    const char* line = "(1436509052.249713) can0 123#1122334455667788";
    for (size_t n = 0; n < strlen(line); ++n) {
        const ipe_candump_t result = parse_bytes(line, n);
        TEST_ASSERT_TRUE(result != IPE_CANDUMP_FRAME || frame.length < 8);
    }
}

static void test_candump_random_bytes_are_survived(void)
{
    uint64_t seed = 1;
    for (int i = 0; i < 300000; ++i) {
        char line[96] = "(1436509052.249713) can0 123##1122334455667788 R";
        const int n_changes = i % 3 == 0 ? 96 : 3;
        for (int k = 0; k < n_changes; ++k) {
            seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
            line[(seed >> 33) % sizeof line] = (char)(seed >> 56);
        }
        if (parse_bytes(line, (seed >> 20) % sizeof line) != IPE_CANDUMP_FRAME) { continue; }
        TEST_ASSERT_LESS_OR_EQUAL(64, frame.length);
        TEST_ASSERT_LESS_OR_EQUAL(15, name.length);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_candump_classical_frame_is_read_to_the_last_bit);
    RUN_TEST(test_candump_every_kind_of_frame_is_known);
    RUN_TEST(test_candump_longest_frame_fills_64_bytes);
    RUN_TEST(test_candump_direction_and_spaces_after_the_data_are_passed_over);
    RUN_TEST(test_candump_fraction_of_one_to_nine_digits_is_nanoseconds);
    RUN_TEST(test_candump_interface_name_is_a_view_into_the_line);
    RUN_TEST(test_candump_comment_blank_and_drop_lines_are_told_apart);
    RUN_TEST(test_candump_bad_lines_say_what_is_bad);
    RUN_TEST(test_candump_line_cut_anywhere_is_never_another_frame_of_full_length);
    RUN_TEST(test_candump_random_bytes_are_survived);
    return UNITY_END();
}
