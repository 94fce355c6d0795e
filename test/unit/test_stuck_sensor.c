// SPDX-License-Identifier: Apache-2.0
#include "stuck_sensor.h"

#include "robot.h"

#define MS 1000000LL

static ipe_config_t config;
static ipe_stuck_sensor_t stuck;
static uint64_t seed;

void setUp(void)
{
    config = cogiro();
    seed = 11;
    ipe_stuck_sensor_init(&stuck, &config);
}

void tearDown(void)
{
}

/// What stands still, and from when on; the platform moves from 1 s on.
typedef struct {
    bool imu, force_3, position, everything, is_noisy;
    double resolution;  ///< of the forces, N
} still_t;

static double rounded(double value, double step)
{
    return step > 0.0 ? step * round(value / step) : value;
}

/// 100 Hz for 10 s; what `still` says repeats from 5 s to 8 s. Refused samples of each sensor are counted.
static void feed(still_t still, double amplitude)
{
    double imu[10], f[IPE_CABLES_MAX] = {0.0}, position[3];
    for (int k = 0; k < 1000; ++k) {
        const double t = 0.01 * k, motion = still.everything ? 0.0 : amplitude * sin(2.0 * t);
        const bool is_still = t >= 5.0 && t < 8.0;
        const double noise = still.is_noisy ? 1e-3 : 0.0;
        if (!(still.imu && is_still)) {
            for (int i = 0; i < 10; ++i) { imu[i] = (i == 2 ? 9.81 + motion : 0.1 * motion) + noise * normal(&seed); }
        }
        for (int i = 0; i < 8; ++i) {
            if (still.force_3 && is_still && i == 2) { continue; }
            f[i] = rounded(400.0 + 40.0 * motion + 20.0 * noise * normal(&seed), still.resolution);
        }
        if (!(still.position && is_still)) {
            for (int i = 0; i < 3; ++i) { position[i] = 0.25 * motion + 1e-3 * noise * normal(&seed); }
        }
        (void)ipe_stuck_sensor_push(&stuck, IPE_IMU, k * 10 * MS, imu);
        (void)ipe_stuck_sensor_push(&stuck, IPE_FORCE, k * 10 * MS, f);
        (void)ipe_stuck_sensor_push(&stuck, IPE_POSITION, k * 10 * MS, position);
    }
}

static void assert_refused(int least, int most, ipe_sensor_t sensor)
{
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        TEST_ASSERT_GREATER_OR_EQUAL_UINT64(s == (int)sensor ? least : 0, stuck.n_stuck[s]);
        TEST_ASSERT_LESS_OR_EQUAL_UINT64(s == (int)sensor ? most : 0, stuck.n_stuck[s]);
    }
}

static void test_push_moving_sensors_are_not_stuck(void)
{
    feed((still_t){.is_noisy = true}, 1.0);  // given, when
    assert_refused(0, 0, IPE_SENSOR_COUNT);  // then
}

static void test_push_all_at_rest_without_noise_is_not_stuck(void)
{
    feed((still_t){.everything = true}, 1.0);
    assert_refused(0, 0, IPE_SENSOR_COUNT);
}

static void test_push_vibration_at_rest_does_not_make_coarse_signals_stuck(void)
{
    for (int k = 0; k < 3000; ++k) {  // given: 100 Hz, 0.1 m/s2 of noise, one sigma, positions and forces that repeat
        double imu[10], f[IPE_CABLES_MAX] = {400.0, 400.0, 400.0, 400.0, 400.0, 400.0, 400.0, 400.0};
        const double position[3] = {1.0, 2.0, 3.0};
        for (int i = 0; i < 10; ++i) { imu[i] = (i == 2 ? 9.81 : 0.0) + 0.1 * normal(&seed); }
        (void)ipe_stuck_sensor_push(&stuck, IPE_IMU, k * 10 * MS, imu);  // when
        (void)ipe_stuck_sensor_push(&stuck, IPE_FORCE, k * 10 * MS, f);
        (void)ipe_stuck_sensor_push(&stuck, IPE_POSITION, k * 10 * MS, position);
    }
    assert_refused(0, 0, IPE_SENSOR_COUNT);  // then
}

static void test_push_rest_after_braking_is_not_stuck_while_the_mean_catches_up(void)
{
    for (int k = 0; k < 1000; ++k) {  // given: no noise; 3 s of motion, 0.3 s of braking, then nothing changes by a bit
        const double t = 0.01 * k, braking = 2.0 * fmax(0.0, fmin(1.0, fmin(10.0 * (t - 3.0), 10.0 * (3.3 - t))));
        const double motion = t < 3.0 ? 0.1 * sin(2.0 * t) : braking;
        const double level = t < 3.3 ? 1e-3 * t : 0.0;
        double imu[10] = {0.5 * motion, 0.0, 9.81 + motion, level, 0.0, 0.0, 1.0, level, 0.0, 0.0};
        double f[IPE_CABLES_MAX];
        for (int i = 0; i < 8; ++i) { f[i] = 400.0 + 40.0 * motion + level; }
        const double position[3] = {level, 2.0 * level, 1.0};
        (void)ipe_stuck_sensor_push(&stuck, IPE_IMU, k * 10 * MS, imu);  // when
        (void)ipe_stuck_sensor_push(&stuck, IPE_FORCE, k * 10 * MS, f);
        (void)ipe_stuck_sensor_push(&stuck, IPE_POSITION, k * 10 * MS, position);
    }
    assert_refused(0, 0, IPE_SENSOR_COUNT);  // then
}

static void test_push_one_stuck_force_is_unknown_until_it_moves_again(void)
{
    feed((still_t){.force_3 = true, .is_noisy = true}, 1.0);  // given: 300 samples, when
    assert_refused(0, 0, IPE_SENSOR_COUNT);                   // then: from 0.25 s and a visible motion on
    TEST_ASSERT_GREATER_OR_EQUAL_UINT64(240, stuck.n_unknown_of[2]);
    TEST_ASSERT_LESS_OR_EQUAL_UINT64(295, stuck.n_unknown_of[2]);
    TEST_ASSERT_EQUAL_UINT64(stuck.n_unknown, stuck.n_unknown_of[2]);
    TEST_ASSERT_EQUAL_UINT32(0, stuck.unknown);
}

/// 200 Hz, 1 N of noise, nothing moves; from sample `from` on channels 0 .. n - 1 repeat `value`.
static void feed_rest(int n_samples, int from, int n, double value)
{
    for (int k = 0; k < n_samples; ++k) {
        double f[IPE_CABLES_MAX];
        for (int i = 0; i < 8; ++i) { f[i] = k >= from && i < n ? value : 400.0 + normal(&seed); }
        (void)ipe_stuck_sensor_push(&stuck, IPE_FORCE, k * 5 * MS, f);
    }
}

static void test_push_noisy_force_that_falls_silent_is_unknown_after_8_samples(void)
{
    feed_rest(2000, 1000, 1, 0.0);
    assert_refused(0, 0, IPE_SENSOR_COUNT);
    TEST_ASSERT_EQUAL_UINT64(1000 - 7, stuck.n_unknown_of[0]);
    TEST_ASSERT_EQUAL_UINT32(1, stuck.unknown);
}

static void test_push_value_it_was_stuck_at_is_unknown_at_once(void)
{
    feed_rest(2000, 1000, 1, 433.25);  // given: saturated once
    double f[IPE_CABLES_MAX] = {400.0, 401.0, 402.0, 403.0, 404.0, 405.0, 406.0, 407.0};
    TEST_ASSERT_FALSE(ipe_stuck_sensor_push(&stuck, IPE_FORCE, 2000 * 5 * MS, f));
    TEST_ASSERT_EQUAL_UINT32(0, stuck.unknown);  // then: well at once,
    f[0] = 433.25;
    TEST_ASSERT_FALSE(ipe_stuck_sensor_push(&stuck, IPE_FORCE, 2001 * 5 * MS, f));
    TEST_ASSERT_EQUAL_UINT32(1, stuck.unknown);  // and saturated at once
}

static void test_push_value_it_was_stuck_at_is_well_once_more_was_read(void)
{
    feed_rest(2000, 1000, 1, 400.5);  // given: frozen once,
    double f[IPE_CABLES_MAX] = {401.0, 401.0, 402.0, 403.0, 404.0, 405.0, 406.0, 407.0};
    (void)ipe_stuck_sensor_push(&stuck, IPE_FORCE, 2000 * 5 * MS, f);
    f[0] = 400.5;
    (void)ipe_stuck_sensor_push(&stuck, IPE_FORCE, 2001 * 5 * MS, f);
    TEST_ASSERT_EQUAL_UINT32(0, stuck.unknown);
}

static void test_push_end_of_the_range_is_unknown_at_once(void)
{
    for (int i = 0; i < config.n_signals; ++i) {  // given: 12 bits of 1 N
        if (config.signal[i].quantity != IPE_Q_F_1 + 5) { continue; }
        config.signal[i].kind = IPE_INTEGER;
        config.signal[i].length = 12;
    }
    ipe_stuck_sensor_init(&stuck, &config);
    double f[IPE_CABLES_MAX] = {400.0, 401.0, 402.0, 403.0, 404.0, 4095.0, 4095.0, 407.0};
    TEST_ASSERT_FALSE(ipe_stuck_sensor_push(&stuck, IPE_FORCE, 0, f));
    TEST_ASSERT_EQUAL_UINT32(1U << 5, stuck.unknown);
}

static void test_push_three_stuck_forces_are_refused(void)
{
    feed_rest(2000, 1000, 3, 0.0);
    assert_refused(1000 - 7, 1000 - 7, IPE_FORCE);
    TEST_ASSERT_EQUAL_UINT64(0, stuck.n_unknown);
}

static void test_push_samples_that_a_gateway_repeats_are_not_stuck(void)
{
    double f[IPE_CABLES_MAX] = {0.0};
    for (int k = 0; k < 20000; ++k) {  // given: each channel is new every 10 samples, each at its own
        for (int i = 0; i < 8; ++i) {
            if (k % 10 == i) { f[i] = 400.0 + normal(&seed); }
        }
        (void)ipe_stuck_sensor_push(&stuck, IPE_FORCE, k * MS, f);
    }
    assert_refused(0, 0, IPE_SENSOR_COUNT);
    TEST_ASSERT_EQUAL_UINT64(0, stuck.n_unknown);
}

static void test_push_stuck_position_is_refused(void)
{
    feed((still_t){.position = true, .is_noisy = true}, 1.0);
    assert_refused(220, 275, IPE_POSITION);
}

static void test_push_stuck_imu_is_refused(void)
{
    feed((still_t){.imu = true, .is_noisy = true}, 1.0);
    assert_refused(220, 275, IPE_IMU);
}

static void test_push_coarse_force_that_repeats_is_not_stuck(void)
{
    for (int i = 0; i < config.n_signals; ++i) {  // given: steps of 50 N, a motion worth 16 N
        config.signal[i].kind = IPE_INTEGER;
        config.signal[i].scale = 50.0;
    }
    ipe_stuck_sensor_init(&stuck, &config);
    feed((still_t){.resolution = 50.0, .is_noisy = true}, 0.4);  // when
    assert_refused(0, 0, IPE_SENSOR_COUNT);                      // then
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_push_moving_sensors_are_not_stuck);
    RUN_TEST(test_push_all_at_rest_without_noise_is_not_stuck);
    RUN_TEST(test_push_vibration_at_rest_does_not_make_coarse_signals_stuck);
    RUN_TEST(test_push_rest_after_braking_is_not_stuck_while_the_mean_catches_up);
    RUN_TEST(test_push_one_stuck_force_is_unknown_until_it_moves_again);
    RUN_TEST(test_push_noisy_force_that_falls_silent_is_unknown_after_8_samples);
    RUN_TEST(test_push_value_it_was_stuck_at_is_unknown_at_once);
    RUN_TEST(test_push_value_it_was_stuck_at_is_well_once_more_was_read);
    RUN_TEST(test_push_end_of_the_range_is_unknown_at_once);
    RUN_TEST(test_push_three_stuck_forces_are_refused);
    RUN_TEST(test_push_samples_that_a_gateway_repeats_are_not_stuck);
    RUN_TEST(test_push_stuck_position_is_refused);
    RUN_TEST(test_push_stuck_imu_is_refused);
    RUN_TEST(test_push_coarse_force_that_repeats_is_not_stuck);
    return UNITY_END();
}
