// SPDX-License-Identifier: Apache-2.0
#include "sample_assembler.h"

#include "robot.h"

#define MS 1000000LL

static ipe_config_t config;
static ipe_sample_assembler_t group;
static ipe_reading_t reading;

void setUp(void)
{
    config = cogiro();
    memset(&reading, 0, sizeof reading);
}

void tearDown(void)
{
}

/// An IMU of four frames as on CoGiRo's classical bus: time and counter, acceleration and counter, rate and counter,
/// quaternion without. Values tell which sample they belong to.
typedef enum { TIME, ACC, RATE, QUAT } part_t;

static ipe_sample_t imu_part(part_t part, int k, int64_t t_ns)
{
    static const int first[] = {IPE_Q_IMU_TIME, IPE_Q_ACC_X, IPE_Q_GYRO_X, IPE_Q_QUAT_W};
    static const int n[] = {1, 3, 3, 4};
    ipe_sample_t s = {.t_ns = t_ns};
    for (int i = 0; i < n[part]; ++i) {
        s.item[s.n].quantity = (uint8_t)(first[part] + i);
        s.item[s.n++].value = k;
    }
    if (part != QUAT) {
        s.item[s.n].quantity = IPE_Q_IMU_COUNTER;
        s.item[s.n++].value = k % 65536;
    }
    return s;
}

static ipe_status_t push_imu(part_t part, int k)
{
    const ipe_sample_t s = imu_part(part, k, 1000 * MS + k * MS + part * MS / 8);
    return ipe_sample_assembler_push(&group, &s, &reading);
}

/// Forces f_first .. f_first + 3 of sample k, without a counter.
static ipe_status_t push_force(int first, int k, int64_t t_ns)
{
    ipe_sample_t s = {.t_ns = t_ns, .n = 4};
    for (int i = 0; i < 4; ++i) {
        s.item[i].quantity = (uint8_t)(IPE_Q_F_1 + first - 1 + i);
        s.item[i].value = k;
    }
    return ipe_sample_assembler_push(&group, &s, &reading);
}

static void assert_whole(int k, int n)
{
    for (int i = 0; i < n; ++i) { TEST_ASSERT_EQUAL_DOUBLE(k, reading.value[i]); }
}

static void test_push_all_frames_completes_sample(void)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);      // given

    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, push_imu(TIME, 7));  // when
    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, push_imu(ACC, 7));
    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, push_imu(RATE, 7));
    TEST_ASSERT_EQUAL_INT(IPE_OK, push_imu(QUAT, 7));

    assert_whole(7, 10);  // then: stamp of the first frame, device time too
    TEST_ASSERT_EQUAL_INT64(1007 * MS, reading.t_ns);
    TEST_ASSERT_TRUE(reading.has_device_time);
    TEST_ASSERT_EQUAL_DOUBLE(7.0, reading.device_time);
    TEST_ASSERT_EQUAL_UINT64(1, group.n_complete);
    TEST_ASSERT_EQUAL_UINT64(0, group.n_incomplete + group.n_duplicate);
}

static void test_push_values_keep_their_places(void)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given: one frame with everything, shuffled
    const uint8_t order[] = {9, 3, 0, 6, 1, 8, 2, 7, 5, 4, IPE_Q_IMU_TIME, IPE_Q_IMU_COUNTER};
    ipe_sample_t s = {.n = sizeof order};
    for (int i = 0; i < s.n; ++i) {
        s.item[i].quantity = order[i];
        s.item[i].value = order[i];
    }

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_sample_assembler_push(&group, &s, &reading));  // when

    for (int i = 0; i < 10; ++i) { TEST_ASSERT_EQUAL_DOUBLE(i, reading.value[i]); }  // then
}

static void test_push_subtracts_time_on_the_wire_from_stamp(void)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given
    ipe_sample_t s = imu_part(TIME, 0, 5 * MS);
    s.wire_time = 111e-6;

    (void)ipe_sample_assembler_push(&group, &s, &reading);  // when
    (void)push_imu(ACC, 0);
    (void)push_imu(RATE, 0);
    TEST_ASSERT_EQUAL_INT(IPE_OK, push_imu(QUAT, 0));

    TEST_ASSERT_EQUAL_INT64(5 * MS - 111000, reading.t_ns);  // then
}

static void test_push_other_sensors_frame_is_ignored(void)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given
    (void)push_imu(TIME, 0);

    TEST_ASSERT_EQUAL_INT(IPE_IGNORED, push_force(1, 0, 0));  // when, then
    TEST_ASSERT_EQUAL_HEX64(1ULL << IPE_Q_IMU_TIME, group.present);
}

static void test_push_rpy_attitude_needs_three_angles(void)
{
    config.attitude_source = IPE_ATTITUDE_RPY;  // given
    config.n_signals = 0;
    ipe_sample_assembler_init(&group, IPE_IMU, &config);
    ipe_sample_t s = {.n = 9};
    for (int i = 0; i < 9; ++i) {
        s.item[i].quantity = (uint8_t)(i < 6 ? i : IPE_Q_ROLL + i - 6);
        s.item[i].value = i;
    }
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_sample_assembler_push(&group, &s, &reading));  // when
    for (int i = 0; i < 9; ++i) { TEST_ASSERT_EQUAL_DOUBLE(i, reading.value[i]); }   // then
    TEST_ASSERT_FALSE(reading.has_device_time);
}

/// Push samples 0 .. 19, leaving out what lost(part, k) says. Every reading must be of one instant.
static int complete_with_losses(bool (*lost)(part_t part, int k))
{
    int n = 0;
    for (int k = 0; k < 20; ++k) {
        for (int part = TIME; part <= QUAT; ++part) {
            if (lost((part_t)part, k) || push_imu((part_t)part, k) != IPE_OK) { continue; }
            assert_whole(k, 10);
            ++n;
        }
    }
    return n;
}

static bool first_lost(part_t part, int k)
{
    return k == 9 && part == TIME;
}

static bool middle_lost(part_t part, int k)
{
    return k == 9 && part == RATE;
}

static bool last_lost(part_t part, int k)
{
    return k == 9 && part == QUAT;
}

static bool all_but_last_lost(part_t part, int k)
{
    return k == 9 && part != QUAT;
}

static bool last_and_next_ones_counters_lost(part_t part, int k)
{
    return (k == 9 && part == QUAT) || (k == 10 && part != QUAT);
}

static bool started_in_the_middle(part_t part, int k)
{
    return k == 0 && part != QUAT;
}

static void check_one_sample_lost(bool (*lost)(part_t part, int k), int expected)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given

    const int n = complete_with_losses(lost);             // when

    TEST_ASSERT_EQUAL_INT(expected, n);                   // then
    TEST_ASSERT_EQUAL_UINT64((uint64_t)expected, group.n_complete);
    TEST_ASSERT_EQUAL_UINT64(20U - (unsigned)expected, group.n_incomplete);
    TEST_ASSERT_EQUAL_UINT64(0, group.n_duplicate);
}

static void test_push_first_frame_lost_drops_that_sample_only(void)
{
    check_one_sample_lost(first_lost, 19);
}

static void test_push_middle_frame_lost_drops_that_sample_only(void)
{
    check_one_sample_lost(middle_lost, 19);
}

static void test_push_last_frame_lost_drops_that_sample_only(void)
{
    check_one_sample_lost(last_lost, 19);
}

static void test_push_frame_without_counter_left_alone_does_not_join_next_sample(void)
{
    check_one_sample_lost(all_but_last_lost, 19);
}

static void test_push_started_in_the_middle_does_not_shift_samples(void)
{
    check_one_sample_lost(started_in_the_middle, 19);
}

static void test_push_burst_loss_does_not_mix_samples(void)
{
    check_one_sample_lost(last_and_next_ones_counters_lost, 18);
}

static void test_push_counter_of_16_bits_may_wrap(void)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given
    int n = 0;
    for (int k = 65530; k < 65545; ++k) {                 // when
        for (int part = TIME; part <= QUAT; ++part) { n += push_imu((part_t)part, k) == IPE_OK; }
    }
    TEST_ASSERT_EQUAL_INT(15, n);  // then
    TEST_ASSERT_EQUAL_UINT64(0, group.n_incomplete);
}

static void check_duplicate(part_t repeated)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given: one frame of sample 9 comes twice
    int n = 0;
    for (int k = 0; k < 20; ++k) {                        // when
        for (int part = TIME; part <= QUAT; ++part) {
            for (int copy = 0; copy < (k == 9 && part == (int)repeated ? 2 : 1); ++copy) {
                if (push_imu((part_t)part, k) != IPE_OK) { continue; }
                assert_whole(k, 10);
                ++n;
            }
        }
    }
    TEST_ASSERT_EQUAL_INT(20, n);  // then: every sample once, the copy counted
    TEST_ASSERT_EQUAL_UINT64(1, group.n_duplicate);
    TEST_ASSERT_EQUAL_UINT64(0, group.n_incomplete);
}

static void test_push_duplicate_first_frame_is_counted_once(void)
{
    check_duplicate(TIME);
}

static void test_push_duplicate_middle_frame_is_counted_once(void)
{
    check_duplicate(ACC);
}

static void test_push_duplicate_last_frame_is_counted_once(void)
{
    check_duplicate(QUAT);
}

static void test_push_late_duplicate_of_complete_sample_is_counted(void)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given: sample 3 complete
    for (int part = TIME; part <= QUAT; ++part) { (void)push_imu((part_t)part, 3); }

    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, push_imu(ACC, 3));  // when: one of its frames again

    TEST_ASSERT_EQUAL_UINT64(1, group.n_duplicate);          // then
    TEST_ASSERT_FALSE(group.is_open);
}

static void test_push_without_counter_repeated_value_starts_next_sample(void)
{
    ipe_sample_assembler_init(&group, IPE_FORCE, &config);       // given: period not known yet, f_5..8 of 0 lost
    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, push_force(1, 0, 0));
    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, push_force(1, 1, MS));  // when
    TEST_ASSERT_EQUAL_INT(IPE_OK, push_force(5, 1, MS + MS / 8));

    assert_whole(1, 8);  // then
    TEST_ASSERT_EQUAL_INT64(MS, reading.t_ns);
    TEST_ASSERT_EQUAL_UINT64(1, group.n_incomplete);
}

/// Samples 0 .. 99 of two frames without counters, the second `after` behind the first.
static int complete_forces(int64_t after, bool (*is_lost)(int first, int k))
{
    int n = 0;
    for (int k = 0; k < 100; ++k) {
        for (int first = 1; first <= 5; first += 4) {
            if (is_lost(first, k) || push_force(first, k, k * MS + (first == 5 ? after : 0)) != IPE_OK) { continue; }
            assert_whole(k, 8);
            ++n;
        }
    }
    return n;
}

static bool every_tenth_lost(int first, int k)
{
    return k > 5 && k % 10 == 0 && first == (k % 20 ? 5 : 1);
}

static bool last_and_next_first_lost(int first, int k)
{
    return (k == 50 && first == 5) || (k == 51 && first == 1);
}

static void test_push_without_counter_lost_frames_never_mix_samples(void)
{
    ipe_sample_assembler_init(&group, IPE_FORCE, &config);                 // given
    TEST_ASSERT_EQUAL_INT(91, complete_forces(MS / 8, every_tenth_lost));  // when, then
    TEST_ASSERT_EQUAL_UINT64(9, group.n_incomplete);
    ipe_sample_assembler_init(&group, IPE_FORCE, &config);
    TEST_ASSERT_EQUAL_INT(98, complete_forces(MS / 8, last_and_next_first_lost));
    TEST_ASSERT_EQUAL_UINT64(2, group.n_incomplete);
}

/// One frame, or a stretch of them, of every tenth sample is lost at a random place; the second comes `after` the first.
static void check_wide_spread(int64_t after)
{
    uint64_t seed = 7;
    int n = 0, n_lost = 0, n_frames = 0;
    ipe_sample_assembler_init(&group, IPE_FORCE, &config);  // given
    for (int k = 0; k < 2000; ++k) {                        // when
        for (int first = 1; first <= 5; first += 4) {
            n_lost += k > 50 && n_lost == 0 && uniform(&seed) < 0.05 ? 1 + (int)(3.0 * uniform(&seed)) : 0;
            if (n_lost > 0) {
                --n_lost;
                continue;
            }
            ++n_frames;
            if (push_force(first, k, k * MS + (first == 5 ? after : 0)) != IPE_OK) { continue; }
            assert_whole(k, 8);  // then: never of two instants
            ++n;
        }
    }
    TEST_ASSERT_GREATER_THAN_INT(1600, n);
    const uint64_t n_open = group.is_open ? group.n_open_frames : 0;
    TEST_ASSERT_EQUAL_UINT64(n_frames, group.n_used + group.n_dropped + group.n_duplicate + n_open);
    TEST_ASSERT_EQUAL_UINT64(2 * n, group.n_used);
}

static void test_push_without_counter_any_spread_never_mixes_samples(void)
{
    for (int tenths = 1; tenths <= 4; ++tenths) { check_wide_spread(tenths * MS / 10); }
}

static void check_counter(int lost_from, int n_lost, int jump, uint64_t expected_lost, uint64_t expected_jumps)
{
    ipe_sample_assembler_init(&group, IPE_IMU,
                              &config);  // given: samples 0 .. 199, some of them lost, then a jump of the counter
    for (int k = 0; k < 200; ++k) {
        if (k >= lost_from && k < lost_from + n_lost) { continue; }
        for (int part = TIME; part <= QUAT; ++part) {  // when
            const ipe_sample_t s = imu_part((part_t)part, k + (k >= 150 ? jump : 0), k * MS + part * MS / 8);
            if (ipe_sample_assembler_push(&group, &s, &reading) != IPE_OK || k == 0) { continue; }
            const uint64_t step = k == lost_from + n_lost ? (unsigned)n_lost + 1U : 1U;
            TEST_ASSERT_EQUAL_UINT64(k == 1 || (k == 150 && jump != 0) ? 0 : step, reading.step);
        }
    }
    TEST_ASSERT_EQUAL_UINT64(expected_lost, group.n_lost);  // then
    TEST_ASSERT_EQUAL_UINT64(expected_jumps, group.n_jumps);
    TEST_ASSERT_EQUAL_UINT64(200U - (unsigned)n_lost, group.n_complete);
}

static void test_push_counter_tells_samples_that_were_lost_whole(void)
{
    check_counter(50, 7, 0, 7, 0);
}

static void test_push_reordered_samples_are_not_lost(void)
{
    ipe_sample_assembler_init(&group, IPE_IMU, &config);  // given: 10 comes after 12, 65536 is 0 and comes before 65535
    for (int k = 65500; k < 65600; ++k) {
        const int j = k == 65510                ? 65512
                      : k > 65510 && k <= 65512 ? k - 1
                      : k == 65535              ? 65536
                      : k == 65536              ? 65535
                                                : k;
        for (int part = TIME; part <= QUAT; ++part) {
            const ipe_sample_t s = imu_part((part_t)part, j, k * MS + part * MS / 8);
            (void)ipe_sample_assembler_push(&group, &s, &reading);  // when
        }
    }
    TEST_ASSERT_EQUAL_UINT64(100, group.n_complete);  // then
    TEST_ASSERT_EQUAL_UINT64(0, group.n_lost + group.n_jumps + group.n_incomplete);
}

static void test_push_counter_that_jumps_is_counted_and_loses_nothing(void)
{
    check_counter(0, 0, 20000, 0, 1);
    check_counter(0, 0, -100, 0, 1);
}

static void test_push_short_first_interval_does_not_lock_sensor_out(void)
{
    ipe_sample_assembler_init(&group, IPE_FORCE, &config);  // given: two samples stamped in one burst
    (void)push_force(1, 0, 0);
    (void)push_force(5, 0, 1000);
    (void)push_force(1, 1, 2000);
    TEST_ASSERT_EQUAL_INT(IPE_OK, push_force(5, 1, 3000));
    int n = 0;
    for (int k = 2; k < 100; ++k) {  // when: then one per ms
        (void)push_force(1, k, k * MS);
        n += push_force(5, k, k * MS + MS / 8) == IPE_OK;
    }
    TEST_ASSERT_GREATER_THAN_INT(85, n);  // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-4, 1e-3, group.period);
}

static void test_push_lost_samples_do_not_stretch_period(void)
{
    ipe_sample_assembler_init(&group, IPE_FORCE, &config);  // given: every third sample missing entirely
    for (int k = 0; k < 3000; ++k) {                        // when
        if (k % 3 == 2) { continue; }
        (void)push_force(1, k, k * MS);
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_force(5, k, k * MS + MS / 8));
    }
    ASSERT_BELOW(group.period, 0.9e-3);  // then: still tells apart what is a period apart
    ASSERT_BELOW(2e-3, group.period);
    TEST_ASSERT_EQUAL_UINT64(0, group.n_incomplete);
}

static void test_push_fewer_cables_need_fewer_forces(void)
{
    config.n_cables = 4;                                 // given
    ipe_sample_assembler_init(&group, IPE_FORCE, &config);
    TEST_ASSERT_EQUAL_INT(IPE_OK, push_force(1, 2, 0));  // when, then
    assert_whole(2, 4);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_push_all_frames_completes_sample);
    RUN_TEST(test_push_values_keep_their_places);
    RUN_TEST(test_push_subtracts_time_on_the_wire_from_stamp);
    RUN_TEST(test_push_other_sensors_frame_is_ignored);
    RUN_TEST(test_push_rpy_attitude_needs_three_angles);
    RUN_TEST(test_push_first_frame_lost_drops_that_sample_only);
    RUN_TEST(test_push_middle_frame_lost_drops_that_sample_only);
    RUN_TEST(test_push_last_frame_lost_drops_that_sample_only);
    RUN_TEST(test_push_frame_without_counter_left_alone_does_not_join_next_sample);
    RUN_TEST(test_push_started_in_the_middle_does_not_shift_samples);
    RUN_TEST(test_push_burst_loss_does_not_mix_samples);
    RUN_TEST(test_push_counter_of_16_bits_may_wrap);
    RUN_TEST(test_push_duplicate_first_frame_is_counted_once);
    RUN_TEST(test_push_duplicate_middle_frame_is_counted_once);
    RUN_TEST(test_push_duplicate_last_frame_is_counted_once);
    RUN_TEST(test_push_late_duplicate_of_complete_sample_is_counted);
    RUN_TEST(test_push_without_counter_repeated_value_starts_next_sample);
    RUN_TEST(test_push_without_counter_lost_frames_never_mix_samples);
    RUN_TEST(test_push_without_counter_any_spread_never_mixes_samples);
    RUN_TEST(test_push_counter_tells_samples_that_were_lost_whole);
    RUN_TEST(test_push_reordered_samples_are_not_lost);
    RUN_TEST(test_push_counter_that_jumps_is_counted_and_loses_nothing);
    RUN_TEST(test_push_short_first_interval_does_not_lock_sensor_out);
    RUN_TEST(test_push_lost_samples_do_not_stretch_period);
    RUN_TEST(test_push_fewer_cables_need_fewer_forces);
    return UNITY_END();
}
