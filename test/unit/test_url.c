// SPDX-License-Identifier: Apache-2.0
#include "url.h"

#include <stdio.h>
#include <string.h>
#include <unity.h>

static ipe_url_t url;
static char text[128];
static char message[256];

void setUp(void)
{
}

void tearDown(void)
{
}

static bool parse(const char* address)
{
    (void)snprintf(text, sizeof text, "%s", address);
    return ipe_url_parse(&url, text, "file socketcan", "speed interface", message, sizeof message);
}

static void test_url_parts_are_cut_out(void)
{
    TEST_ASSERT_TRUE(parse("file:a:b/can.log?speed=1&interface=can0"));
    TEST_ASSERT_EQUAL_STRING("file", url.scheme);
    TEST_ASSERT_EQUAL_STRING("a:b/can.log", url.path);
    TEST_ASSERT_EQUAL_STRING("1", ipe_url_option(&url, "speed"));
    TEST_ASSERT_EQUAL_STRING("can0", ipe_url_option(&url, "interface"));
    TEST_ASSERT_NULL(ipe_url_option(&url, "filter"));
}

static void test_url_without_scheme_or_name_is_refused_whole(void)
{
    static const char* const BAD[] = {
        "can0", "", ":", "file:", "file:?speed=1", "fil:x", "files:x", "file socketcan:x"};
    for (size_t i = 0; i < sizeof BAD / sizeof BAD[0]; ++i) {
        TEST_ASSERT_FALSE_MESSAGE(parse(BAD[i]), BAD[i]);
        char quoted[64];
        (void)snprintf(quoted, sizeof quoted, "\"%s\"", BAD[i]);
        TEST_ASSERT_NOT_NULL_MESSAGE(strstr(message, quoted), message);
    }
}

static void test_url_unknown_or_bare_option_is_named(void)
{
    TEST_ASSERT_FALSE(parse("file:x?sped=1"));
    TEST_ASSERT_NOT_NULL(strstr(message, "file:x: option \"sped\""));
    TEST_ASSERT_FALSE(parse("file:x?speed"));
    TEST_ASSERT_FALSE(parse("file:x?"));
    TEST_ASSERT_FALSE(parse("file:x?speed=1&speed=1&speed=1&speed=1&speed=1"));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_url_parts_are_cut_out);
    RUN_TEST(test_url_without_scheme_or_name_is_refused_whole);
    RUN_TEST(test_url_unknown_or_bare_option_is_named);
    return UNITY_END();
}
