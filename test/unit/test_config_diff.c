// SPDX-License-Identifier: Apache-2.0
#include "config_diff.h"

#include "robot.h"

static ipe_config_t a, b;
static char names[256];

void setUp(void)
{
    memset(&a, 0, sizeof a);
    const ipe_config_t config = cogiro();
    memcpy(&a, &config, sizeof a);
    memcpy(&b, &a, sizeof b);
}

void tearDown(void)
{
}

static void test_settings_equal_configurations_are_the_same(void)
{
    TEST_ASSERT_EQUAL(IPE_CONFIG_DIFF_SAME, ipe_config_diff_compare(&a, &b, names, sizeof names));
    TEST_ASSERT_EQUAL_STRING("", names);
}

static void test_settings_that_do_not_touch_what_was_learnt_are_named(void)
{
    b.memory += 1.0;
    b.max_age[2] += 0.01;
    b.max_carry += 0.1;
    b.estimate_rate += 1.0;
    TEST_ASSERT_EQUAL(IPE_CONFIG_DIFF_LEARNT_HOLDS, ipe_config_diff_compare(&a, &b, names, sizeof names));
    TEST_ASSERT_EQUAL_STRING("max_age, max_carry, memory, estimate_rate", names);
}

static void test_settings_geometry_among_them_means_a_new_start(void)
{
    b.memory += 1.0;
    b.cable[7].anchor[2] += 1e-9;
    b.signal[3].scale *= 2.0;
    TEST_ASSERT_EQUAL(IPE_CONFIG_DIFF_NEW, ipe_config_diff_compare(&a, &b, names, sizeof names));
    TEST_ASSERT_EQUAL_STRING("cable, signal, memory", names);
}

/// A field that the table forgets would be changed without anyone being told.
static void test_settings_every_byte_but_the_holes_is_compared(void)
{
    enum { HOLES = 12 };  // after n_cables, position_source and n_signals
    int n_unseen = 0;
    for (size_t i = 0; i < sizeof a; ++i) {
        ((unsigned char*)&b)[i] ^= 1;
        n_unseen += ipe_config_diff_compare(&a, &b, names, sizeof names) == IPE_CONFIG_DIFF_SAME;
        ((unsigned char*)&b)[i] ^= 1;
    }
    TEST_ASSERT_LESS_OR_EQUAL(HOLES, n_unseen);
}

static void test_settings_names_are_cut_to_their_room(void)
{
    char few[8];
    memset(&b, 1, sizeof b);
    TEST_ASSERT_EQUAL(IPE_CONFIG_DIFF_NEW, ipe_config_diff_compare(&a, &b, few, sizeof few));
    TEST_ASSERT_EQUAL_STRING("name, g", few);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_settings_equal_configurations_are_the_same);
    RUN_TEST(test_settings_that_do_not_touch_what_was_learnt_are_named);
    RUN_TEST(test_settings_geometry_among_them_means_a_new_start);
    RUN_TEST(test_settings_every_byte_but_the_holes_is_compared);
    RUN_TEST(test_settings_names_are_cut_to_their_room);
    return UNITY_END();
}
