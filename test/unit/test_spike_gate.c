// SPDX-License-Identifier: Apache-2.0
#include "spike_gate.h"

#include "robot.h"

static ipe_spike_gate_t gate;
static uint64_t seed;
static double before[2][2];  ///< two channels: sample a, sample b

static double motion(int k, int i)
{
    return 400.0 + (i == 0 ? 40.0 : -25.0) * sin(0.02 * k);
}

/// The next noisy sample of a motion, off by `off` in channel 1. True: suspect.
static bool feed(int k, double off, double x[2])
{
    for (int i = 0; i < 2; ++i) { x[i] = motion(k, i) + 0.5 * normal(&seed) + (i == 1 ? off : 0.0); }
    const bool is_suspect = k > 1 && ipe_spike_gate_is_suspect(&gate, before[0], before[1], x, 1.0);
    return is_suspect;
}

static void keep(const double x[2])
{
    memcpy(before[0], before[1], sizeof before[0]);
    memcpy(before[1], x, sizeof before[1]);
}

void setUp(void)
{
    const double least[2] = {0.0, 0.0};
    double x[2];
    seed = 3;
    ipe_spike_gate_init(&gate, 2, least, 0.02);
    for (int k = 0; k < 300; ++k) {
        (void)feed(k, 0.0, x);
        keep(x);
    }
}

void tearDown(void)
{
}

static void test_is_suspect_noise_and_motion_are_none(void)
{
    double x[2];
    for (int k = 300; k < 100000; ++k) {
        TEST_ASSERT_FALSE(feed(k, 0.0, x));
        keep(x);
    }
}

static void test_stepped_a_sample_that_leaves_and_comes_back_is_a_spike(void)
{
    double x[2], next[2];
    TEST_ASSERT_TRUE(feed(300, 50.0, x));  // given: 100 sigma
    (void)feed(301, 0.0, next);
    TEST_ASSERT_EQUAL_UINT32(0, ipe_spike_gate_stepped(&gate, before[0], before[1], x, 1.0, next, 2.0));  // when, then
}

static void test_stepped_names_the_channel_that_stays_away(void)
{
    double x[2], next[2];
    TEST_ASSERT_TRUE(feed(300, -50.0, x));
    (void)feed(301, -50.0, next);
    TEST_ASSERT_EQUAL_UINT32(2, ipe_spike_gate_stepped(&gate, before[0], before[1], x, 1.0, next, 2.0));
}

static void test_is_suspect_smaller_than_least_is_none(void)
{
    double x[2];
    TEST_ASSERT_FALSE(feed(300, 7.0, x));  // 14 sigma, but under 2 % of the mean
    TEST_ASSERT_TRUE(feed(300, 20.0, x));
}

static void test_is_suspect_spikes_do_not_teach_the_noise(void)
{
    double x[2];
    const float noise = gate.noise[1];
    for (int k = 300; k < 1300; ++k) {                                    // given: a spike every 50 samples, when
        const bool is_spike = k % 50 == 0;
        TEST_ASSERT_EQUAL(is_spike, feed(k, is_spike ? 300.0 : 0.0, x));  // then
        if (!is_spike) { keep(x); }
    }
    ASSERT_BELOW(1.5 * (double)noise, (double)gate.noise[1]);
}

static void test_is_suspect_after_a_gap_is_none(void)
{
    const double x[2] = {1e3, 1e3};
    TEST_ASSERT_FALSE(ipe_spike_gate_is_suspect(&gate, before[0], before[1], x, 4.0));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_is_suspect_noise_and_motion_are_none);
    RUN_TEST(test_stepped_a_sample_that_leaves_and_comes_back_is_a_spike);
    RUN_TEST(test_stepped_names_the_channel_that_stays_away);
    RUN_TEST(test_is_suspect_smaller_than_least_is_none);
    RUN_TEST(test_is_suspect_spikes_do_not_teach_the_noise);
    RUN_TEST(test_is_suspect_after_a_gap_is_none);
    return UNITY_END();
}
