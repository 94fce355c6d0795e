// SPDX-License-Identifier: Apache-2.0
#include "noise_density.h"

#include "robot.h"

static ipe_noise_density_t white;
static uint64_t seed;

static const double PERIOD = 0.005, STD = 0.01;
enum { BLOCK = 4 };

void setUp(void)
{
    seed = 29;
    memset(&white, 0, sizeof white);
}

void tearDown(void)
{
}

/// n samples, at 200 Hz, of a 1 Hz motion of the given size and white noise in every channel.
static void push(int n, double size, double std)
{
    for (int k = 0; k < n; ++k) {
        double x[IPE_NOISE_DENSITY_CHANNELS];
        fill_normal(&seed, x, IPE_NOISE_DENSITY_CHANNELS);
        for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) {
            x[i] = 9.81 + size * sin(6.28318 * PERIOD * k + i) + std * x[i];
        }
        ipe_noise_density_push(&white, x, BLOCK);
    }
}

static void check_density(double std, double relative)
{
    double density[IPE_NOISE_DENSITY_CHANNELS];
    ipe_noise_density_density(&white, BLOCK * PERIOD, density);
    const double expected = std * std * PERIOD;
    for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(relative * expected, expected, density[i]);
    }
}

static void test_push_noise_under_a_motion_gives_its_density(void)
{
    push(20000, 1.0, STD);    // given, when
    check_density(STD, 0.3);  // then
}

static void test_push_motion_alone_is_no_noise(void)
{
    push(20000, 1.0, 0.0);  // given, when
    double density[IPE_NOISE_DENSITY_CHANNELS];
    ipe_noise_density_density(&white, BLOCK * PERIOD, density);
    const double noise = STD * STD * PERIOD;
    for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) { TEST_ASSERT_TRUE(density[i] < 0.01 * noise); }  // then
}

static void test_push_glitch_counts_for_little(void)
{
    push(4000, 0.0, STD);                           // given
    const double glitch[IPE_NOISE_DENSITY_CHANNELS] = {1e6, 1e6, 1e6, 1e30, -1e30, 1e300};
    ipe_noise_density_push(&white, glitch, BLOCK);  // when
    push(4000, 0.0, STD);
    check_density(STD, 0.5);                        // then
}

static void test_restart_differences_nothing_across_a_gap(void)
{
    push(4000, 0.0, STD);            // given
    ipe_noise_density_restart(&white);
    for (int k = 0; k < 100; ++k) {  // when: still there, a thousand times as far
        const double far[IPE_NOISE_DENSITY_CHANNELS] = {1e4, 1e4, 1e4, 1e4, 1e4, 1e4};
        ipe_noise_density_push(&white, far, BLOCK);
    }
    ipe_noise_density_restart(&white);
    push(4000, 0.0, STD);
    check_density(STD, 0.3);  // then
}

static void test_density_of_nothing_is_zero(void)
{
    push(3 * BLOCK, 1.0, STD);                                   // given: too few blocks for one difference
    double density[IPE_NOISE_DENSITY_CHANNELS];
    ipe_noise_density_density(&white, BLOCK * PERIOD, density);  // when
    for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) { TEST_ASSERT_EQUAL_DOUBLE(0.0, density[i]); }  // then
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_push_noise_under_a_motion_gives_its_density);
    RUN_TEST(test_push_motion_alone_is_no_noise);
    RUN_TEST(test_push_glitch_counts_for_little);
    RUN_TEST(test_restart_differences_nothing_across_a_gap);
    RUN_TEST(test_density_of_nothing_is_zero);
    return UNITY_END();
}
