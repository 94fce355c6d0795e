// SPDX-License-Identifier: Apache-2.0
#include "align.h"

#include "robot.h"

#define MS 1000000LL

static ipe_config_t config;
static ipe_align_t align;
static ipe_row_t row;

void setUp(void)
{
    config = cogiro();
    config.max_wait = 0.02;
    for (int i = 0; i < IPE_SENSOR_COUNT; ++i) { config.max_age[i] = 0.006; }
    ipe_align_init(&align, &config);
    memset(&row, 0, sizeof row);
}

void tearDown(void)
{
}

static double quadratic(double t)
{
    return 3.0 - 20.0 * t + 700.0 * t * t;
}

static ipe_status_t push_imu(int64_t t_ns)
{
    const double value[10] = {1.0, 2.0, 3.0, 0.1, 0.2, 1e-9 * (double)t_ns, 0.0, 0.0, 0.0, 1.0};
    return ipe_align_push(&align, IPE_IMU, t_ns, value);
}

static ipe_status_t push_force(int64_t t_ns)
{
    double value[IPE_CABLES_MAX] = {0.0};
    for (int i = 0; i < 8; ++i) { value[i] = i * quadratic(1e-9 * (double)t_ns); }
    return ipe_align_push(&align, IPE_FORCE, t_ns, value);
}

static ipe_status_t push_position(int64_t t_ns)
{
    const double t = 1e-9 * (double)t_ns;
    const double value[3] = {t, quadratic(t), -quadratic(t)};
    return ipe_align_push(&align, IPE_POSITION, t_ns, value);
}

static void assert_row_is_of(double t)
{
    for (int i = 0; i < 8; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, i * quadratic(t), row.f[i]); }
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, t, row.position[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -quadratic(t), row.position[2]);
    TEST_ASSERT_EQUAL_DOUBLE(t, row.gyro[2]);
}

/// Rows with force and position.
static int pop_all(void)
{
    int n = 0;
    while (ipe_align_pop(&align, &row) == IPE_OK) {
        if (!row.has_force || !row.has_position) { continue; }
        assert_row_is_of(1e-9 * (double)row.t_ns);
        ++n;
    }
    return n;
}

static void test_pop_quadratic_signals_of_other_rates_are_interpolated_exactly(void)
{
    int n = 0;                                         // given: IMU at 1 kHz, forces every 3 ms, position
    for (int64_t t = 0; t < 500 * MS; t += MS / 10) {  // every 4.2 ms, of a signal without third derivative
        if (t % (3 * MS) == 0) { (void)push_force(t); }
        if (t % (42 * MS / 10) == 0) { (void)push_position(t); }
        if (t % MS == 0 && t >= 10 * MS) { (void)push_imu(t); }
        n += pop_all();  // when, then: see assert_row_is_of()
    }
    TEST_ASSERT_GREATER_THAN_INT(475, n);
    TEST_ASSERT_EQUAL_UINT64((uint64_t)n, align.n_rows);
    TEST_ASSERT_EQUAL_UINT64(0, align.n_missing[IPE_FORCE] + align.n_late[IPE_FORCE] + align.n_late[IPE_POSITION]);
}

static void test_pop_uneven_sampling_is_interpolated_exactly(void)
{
    uint64_t seed = 5;  // given: gaps of 1 .. 5 ms
    for (int64_t t = 0; t < 100 * MS; t += MS + (int64_t)(4e6 * uniform(&seed))) {
        (void)push_force(t);
        (void)push_position(t + MS / 3);
    }
    for (int64_t t = 10 * MS; t < 80 * MS; t += MS) { (void)push_imu(t); }
    TEST_ASSERT_EQUAL_INT(70, pop_all());  // when, then
}

static void test_pop_same_instant_takes_sample_as_it_is(void)
{
    (void)push_force(5 * MS);  // given: one sample each, same instant
    (void)push_position(5 * MS);
    (void)push_imu(5 * MS);

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_pop(&align, &row));  // when

    TEST_ASSERT_EQUAL_DOUBLE(7.0 * quadratic(0.005), row.f[7]);  // then
    TEST_ASSERT_EQUAL_DOUBLE(quadratic(0.005), row.position[1]);
    TEST_ASSERT_EQUAL_INT64(5 * MS, row.t_ns);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, row.q[3]);
    TEST_ASSERT_EQUAL_DOUBLE(2.0, row.acc[1]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, row.f[8]);
}

static void test_pop_waits_for_slow_sensor(void)
{
    for (int k = 0; k <= 10; ++k) {  // given: forces missing after 5 ms
        (void)push_imu(k * MS);
        (void)push_position(k * MS);
        if (k <= 5) { (void)push_force(k * MS); }
    }
    TEST_ASSERT_EQUAL_INT(6, pop_all());  // when, then
    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, ipe_align_pop(&align, &row));
    TEST_ASSERT_EQUAL_UINT64(0, align.n_late[IPE_FORCE]);

    for (int k = 6; k <= 10; ++k) { (void)push_force(k * MS); }  // when they come
    TEST_ASSERT_EQUAL_INT(5, pop_all());
}

static void test_pop_waits_no_longer_than_max_wait(void)
{
    int n = 0;  // given: forces end at 5 ms
    for (int k = 0; k <= 50; ++k) {
        (void)push_imu(k * MS);
        (void)push_position(k * MS);
        if (k <= 5) { (void)push_force(k * MS); }
        n += pop_all();           // when
    }
    TEST_ASSERT_EQUAL_INT(6, n);  // then: rows 6 .. 27 given up, 28 .. 50 still wait: 20 ms and two periods
    TEST_ASSERT_EQUAL_UINT64(22, align.n_late[IPE_FORCE]);
    TEST_ASSERT_EQUAL_UINT64(28, align.ring[IPE_IMU].cursor);
}

static void test_pop_across_gap_rows_lack_the_sensor_and_are_counted(void)
{
    for (int k = 0; k <= 30; ++k) {  // given: forces absent from 11 to 19 ms, max_age 6 ms
        (void)push_imu(k * MS);
        (void)push_position(k * MS);
        if (k <= 10 || k >= 20) { (void)push_force(k * MS); }
    }
    TEST_ASSERT_EQUAL_INT(31 - 9, pop_all());  // when, then
    TEST_ASSERT_EQUAL_UINT64(9, align.n_missing[IPE_FORCE]);
    TEST_ASSERT_EQUAL_UINT64(0, align.n_missing[IPE_POSITION]);
}

static void test_pop_before_first_sample_of_a_sensor_rows_lack_it(void)
{
    for (int k = 0; k <= 30; ++k) {  // given: position starts at 10 ms
        (void)push_imu(k * MS);
        (void)push_force(k * MS);
        if (k >= 10) { (void)push_position(k * MS); }
    }
    TEST_ASSERT_EQUAL_INT(21, pop_all());  // when, then
    TEST_ASSERT_EQUAL_UINT64(10, align.n_missing[IPE_POSITION]);
}

static void test_pop_fixed_position_needs_no_position_sensor(void)
{
    config.position_source = IPE_POSITION_FIXED;  // given
    config.fixed_position[1] = 4.5;
    ipe_align_init(&align, &config);
    (void)push_imu(MS);
    (void)push_force(MS);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_pop(&align, &row));  // when
    TEST_ASSERT_EQUAL_DOUBLE(4.5, row.position[1]);              // then
}

static void test_pop_delays_are_taken_off_the_stamps(void)
{
    config.delay[IPE_FORCE] = 0.002, config.delay[IPE_POSITION] = 0.005, config.delay[IPE_IMU] = 0.001;  // given
    ipe_align_init(&align, &config);
    for (int k = 0; k < 40; ++k) {
        double f[IPE_CABLES_MAX] = {0.0};
        const double t = 1e-3 * k;
        for (int i = 0; i < 8; ++i) { f[i] = i * quadratic(t); }
        const double p[3] = {t, quadratic(t), -quadratic(t)};
        const double imu[10] = {1.0, 2.0, 3.0, 0.1, 0.2, 1e-9 * (double)(k * MS), 0.0, 0.0, 0.0, 1.0};
        (void)ipe_align_push(&align, IPE_FORCE, (k + 2) * MS, f);
        (void)ipe_align_push(&align, IPE_POSITION, (k + 5) * MS, p);
        (void)ipe_align_push(&align, IPE_IMU, (k + 1) * MS, imu);
    }
    TEST_ASSERT_EQUAL_INT(40, pop_all());  // when, then
}

/// Rows of 100 ms pushed in the order that interleave() gives; their bytes.
static int rows_pushed_in_blocks(int block_ms, ipe_row_t* rows)
{
    int n = 0;
    ipe_align_init(&align, &config);
    for (int start = 0; start < 100; start += block_ms) {
        for (int k = start; k < start + block_ms; ++k) { (void)push_position(k * MS + MS / 7); }
        for (int k = start; k < start + block_ms; ++k) { (void)push_imu(k * MS); }
        for (int k = start; k < start + block_ms; ++k) { (void)push_force(k * MS + MS / 3); }
        while (ipe_align_pop(&align, &rows[n]) == IPE_OK) { ++n; }
    }
    ipe_align_t* a = &align;
    a->is_ending = true;
    while (ipe_align_pop(&align, &rows[n]) == IPE_OK) { ++n; }
    return n;
}

static void test_pop_result_does_not_depend_on_order_of_pushing(void)
{
    static ipe_row_t one_by_one[100], in_blocks[100];    // given
    const int n = rows_pushed_in_blocks(1, one_by_one);  // when
    const int m = rows_pushed_in_blocks(10, in_blocks);
    TEST_ASSERT_EQUAL_INT(100, n);                       // then
    TEST_ASSERT_EQUAL_INT(n, m);
    TEST_ASSERT_EQUAL_MEMORY(one_by_one, in_blocks, sizeof one_by_one[0] * (size_t)n);
}

static void test_pop_after_end_lets_last_rows_out(void)
{
    for (int k = 0; k <= 10; ++k) {  // given: forces between the IMU's instants
        if (k > 0) { (void)push_imu(k * MS + MS / 2); }
        (void)push_force(k * MS);
        (void)push_position(k * MS);
    }
    TEST_ASSERT_EQUAL_INT(8, pop_all());                         // two samples wanted past a row's instant

    align.is_ending = true;                                      // when

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_pop(&align, &row));  // then: one will do, none will not
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 7.0 * quadratic(0.0095), row.f[7]);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_pop(&align, &row));
    TEST_ASSERT_FALSE(row.has_force);
    TEST_ASSERT_FALSE(row.has_position);
    TEST_ASSERT_EQUAL_UINT64(1, align.n_late[IPE_FORCE]);
    TEST_ASSERT_EQUAL_INT(IPE_NOT_READY, ipe_align_pop(&align, &row));
}

static void test_push_time_backwards_is_refused_and_counted(void)
{
    (void)push_force(10 * MS);                                 // given
    const ipe_align_t before = align;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME, push_force(10 * MS));  // when, then: same stamp, earlier stamp
    TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME, push_force(2 * MS));
    TEST_ASSERT_EQUAL_UINT64(1, align.n_duplicate[IPE_FORCE]);
    TEST_ASSERT_EQUAL_UINT64(1, align.n_backwards[IPE_FORCE]);
    align.n_duplicate[IPE_FORCE] = align.n_backwards[IPE_FORCE] = 0;
    TEST_ASSERT_EQUAL_MEMORY(&before, &align, sizeof align);
}

static void test_push_reordered_samples_find_their_place(void)
{
    static const int order[] = {0, 1, 3, 2, 4, 5, 9, 6, 7, 8, 10, 12, 11, 13, 14, 15};  // given
    for (int i = 0; i < 16; ++i) {
        const int64_t t = order[i] * MS;
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_imu(t));  // when
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_force(t));
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_position(t));
        if (i == 1) { (void)pop_all(); }
    }
    TEST_ASSERT_EQUAL_INT(14, pop_all());  // then: two rows before, the rest now, each of its own instant
    TEST_ASSERT_EQUAL_UINT64(5, align.n_reordered[IPE_IMU]);
    TEST_ASSERT_EQUAL_UINT64(5, align.n_reordered[IPE_FORCE]);
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) { TEST_ASSERT_EQUAL_UINT64(16, align.n_samples[s]); }
}

static void test_push_sample_behind_rows_that_are_out_is_refused(void)
{
    for (int k = 0; k < 20; ++k) {  // given: all rows are out, 12 of the IMU lost
        if (k != 12) { (void)push_imu(k * MS); }
        (void)push_force(k * MS);
        (void)push_position(k * MS);
    }
    TEST_ASSERT_EQUAL_INT(19, pop_all());
    TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME, push_imu(12 * MS));  // when, then
    TEST_ASSERT_EQUAL_UINT64(1, align.n_backwards[IPE_IMU]);
}

static void test_push_late_copy_of_a_sample_is_a_duplicate(void)
{
    for (int k = 0; k < 10; ++k) { (void)push_force(k * MS); }          // given
    TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME, push_force(7 * MS + MS / 20));  // when, then: by a line that moved meanwhile
    TEST_ASSERT_EQUAL_UINT64(1, align.n_duplicate[IPE_FORCE]);
}

static void test_hold_rows_wait_until_samples_are_settled(void)
{
    int64_t instant[4];  // given: forces 6 .. 9 without an instant
    double value[IPE_CABLES_MAX] = {0.0};
    for (int k = 0; k < 12; ++k) {
        (void)push_imu(k * MS);
        (void)push_position(k * MS);
        if (k < 5) { (void)push_force(k * MS); }
        if (k < 5 || k > 9) { continue; }
        for (int i = 0; i < 8; ++i) { value[i] = i * quadratic(1e-3 * k); }
        TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_hold(&align, IPE_FORCE, 20 * MS, value));
    }
    TEST_ASSERT_EQUAL_INT(5, pop_all());
    for (int k = 6; k < 10; ++k) { instant[k - 6] = k * MS; }
    ipe_align_settle(&align, IPE_FORCE, 4, instant);  // when: the oldest of five cannot be told
    TEST_ASSERT_EQUAL_INT(5, pop_all());              // then: 5 is interpolated
    TEST_ASSERT_EQUAL_UINT64(9, align.n_samples[IPE_FORCE]);
}

static void test_settle_between_samples_in_place_is_refused_and_counted(void)
{
    const double value[IPE_CABLES_MAX] = {0.0};  // given
    const int64_t instant[2] = {2 * MS + MS / 2, 5 * MS};
    for (int k = 0; k < 5; ++k) { (void)push_force(k * MS); }
    for (int k = 0; k < 2; ++k) { (void)ipe_align_hold(&align, IPE_FORCE, 6 * MS, value); }
    ipe_align_settle(&align, IPE_FORCE, 2, instant);          // when
    TEST_ASSERT_EQUAL_UINT64(6, align.n_samples[IPE_FORCE]);  // then
    TEST_ASSERT_EQUAL_UINT64(1, align.n_backwards[IPE_FORCE]);
    TEST_ASSERT_EQUAL_UINT64(0, align.n_reordered[IPE_FORCE]);
}

static void test_hold_keeps_no_more_than_it_should(void)
{
    const double value[IPE_CABLES_MAX] = {0.0};  // given
    int64_t instant[IPE_SAMPLE_TIMING_HOLD];
    (void)push_force(0);
    for (int k = 1; k <= 200; ++k) { (void)ipe_align_hold(&align, IPE_FORCE, k * MS, value); }  // when
    for (int k = 0; k < IPE_SAMPLE_TIMING_HOLD; ++k) { instant[k] = (200 - IPE_SAMPLE_TIMING_HOLD + 1 + k) * MS; }
    ipe_align_settle(&align, IPE_FORCE, IPE_SAMPLE_TIMING_HOLD, instant);
    TEST_ASSERT_EQUAL_UINT64(IPE_SAMPLE_TIMING_HOLD + 1, align.n_samples[IPE_FORCE]);  // then
    TEST_ASSERT_EQUAL_UINT64(IPE_SAMPLE_TIMING_HOLD + 1, align.ring[IPE_FORCE].head);
}

static void test_push_big_step_back_restarts_sensor(void)
{
    for (int k = 0; k < 20; ++k) {  // given: stamps at 100 s
        (void)push_imu(100000 * MS + k * MS);
        (void)push_force(100000 * MS + k * MS);
        (void)push_position(100000 * MS + k * MS);
    }
    (void)pop_all();
    for (int k = 0; k < 20; ++k) {  // when: then from 10 s on
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_imu(10000 * MS + k * MS));
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_force(10000 * MS + k * MS));
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_position(10000 * MS + k * MS));
    }
    TEST_ASSERT_EQUAL_INT(20, pop_all());  // then
    TEST_ASSERT_EQUAL_UINT64(1, align.n_restarts[IPE_IMU]);
    TEST_ASSERT_EQUAL_UINT64(1, align.n_restarts[IPE_FORCE]);
    TEST_ASSERT_EQUAL_UINT64(1, align.n_restarts[IPE_POSITION]);
}

static void test_push_one_stamp_far_ahead_costs_no_more_than_itself(void)
{
    for (int k = 0; k < 40; ++k) {  // given: one force sample stamped an hour ahead
        (void)push_imu(k * MS);
        (void)push_position(k * MS);
        (void)push_force(k == 10 ? 3600000 * MS : k * MS);
        (void)pop_all();  // when, then
    }
    TEST_ASSERT_EQUAL_UINT64(1, align.n_restarts[IPE_FORCE]);
    TEST_ASSERT_GREATER_THAN_UINT64(37, align.n_rows);
}

/// A position stamped 0.9 s ahead, under the second that starts the sensor again: those after it are in place, not copies.
static void test_push_one_stamp_less_than_a_second_ahead_costs_no_more_than_itself(void)
{
    int n_refused = 0, n = 0;
    for (int64_t t = 0; t < 3000 * MS; t += MS / 5) {
        if (t % (3 * MS) == 0) { (void)push_force(t); }
        if (t % (21 * MS / 5) == 0) { n_refused += push_position(t) != IPE_OK; }
        if (t == 1000 * MS) { (void)push_position(t + 900 * MS); }
        if (t % MS == 0 && t >= 10 * MS) { (void)push_imu(t); }
        while (ipe_align_pop(&align, &row) == IPE_OK) { n += row.has_position; }
    }
    TEST_ASSERT_LESS_OR_EQUAL_INT(1, n_refused);
    TEST_ASSERT_EQUAL_UINT64(0, align.n_backwards[IPE_POSITION]);
    TEST_ASSERT_GREATER_THAN_INT(2950, n);
}

static void test_push_nonfinite_value_is_refused_and_counted(void)
{
    double f[IPE_CABLES_MAX] = {0.0}, imu[10] = {0.0, 0.0, 9.81, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0};  // given
    f[7] = NAN;
    imu[4] = INFINITY;
    const double p[3] = {0.0, -INFINITY, 0.0};
    TEST_ASSERT_EQUAL_INT(IPE_ERR_NONFINITE, ipe_align_push(&align, IPE_FORCE, 0, f));  // when, then
    TEST_ASSERT_EQUAL_INT(IPE_ERR_NONFINITE, ipe_align_push(&align, IPE_IMU, 0, imu));
    TEST_ASSERT_EQUAL_INT(IPE_ERR_NONFINITE, ipe_align_push(&align, IPE_POSITION, 0, p));
    for (int i = 0; i < IPE_SENSOR_COUNT; ++i) {
        TEST_ASSERT_EQUAL_UINT64(1, align.n_nonfinite[i]);
        TEST_ASSERT_EQUAL_UINT64(0, align.ring[i].head);
    }
}

static void test_push_quaternion_is_normalised_and_bad_one_refused(void)
{
    double imu[10] = {0.0, 0.0, 9.81, 0.0, 0.0, 0.0, 0.0, 1.05, 0.0, 0.0};   // given
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_push(&align, IPE_IMU, 1, imu));  // when, then
    TEST_ASSERT_EQUAL_DOUBLE(1.0, align.imu[0][7]);
    imu[7] = 0.0;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_align_push(&align, IPE_IMU, 2, imu));
    imu[7] = 1.2;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_align_push(&align, IPE_IMU, 3, imu));
    TEST_ASSERT_EQUAL_UINT64(2, align.n_bad_quaternion);
    TEST_ASSERT_EQUAL_UINT64(1, align.ring[IPE_IMU].head);
}

static void test_push_bad_quaternion_with_old_stamp_changes_nothing(void)
{
    (void)push_imu(100000 * MS);                                                    // given
    const double imu[10] = {0.0};
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_align_push(&align, IPE_IMU, 0, imu));  // when
    TEST_ASSERT_EQUAL_UINT64(1, align.ring[IPE_IMU].head);                          // then
    TEST_ASSERT_EQUAL_UINT64(0, align.n_restarts[IPE_IMU]);
}

static void test_push_rpy_becomes_quaternion(void)
{
    config.attitude_source = IPE_ATTITUDE_RPY;  // given
    ipe_align_init(&align, &config);
    const double imu[9] = {0.0, 0.0, 9.81, 0.0, 0.0, 0.0, 0.3, -0.2, 2.0};
    (void)push_force(0);
    (void)push_position(0);

    (void)ipe_align_push(&align, IPE_IMU, 0, imu);  // when
    (void)ipe_align_pop(&align, &row);

    double R[3][3];  // then: R = Rz(2) Ry(-0.2) Rx(0.3)
    mat3_from_quat(row.q, R);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, -sin(-0.2), R[2][0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, cos(-0.2) * sin(0.3), R[2][1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, sin(2.0) * cos(-0.2), R[1][0]);
}

/// IMU and forces every ms at rest, positions every 4 ms but for a gap of some ms after 2 s; rows that were made.
static int rest_with_gap(int64_t gap_ms)
{
    const double imu[10] = {0.0, 0.0, config.gravity, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0};
    const double position[3] = {1.0, 2.0, 3.0}, force[IPE_CABLES_MAX] = {100.0};
    int n = 0;
    ipe_align_init(&align, &config);
    for (int64_t t = 0; t <= 4000; ++t) {
        (void)ipe_align_push(&align, IPE_IMU, t * MS, imu);
        (void)ipe_align_push(&align, IPE_FORCE, t * MS, force);
        if (t % 4 == 0 && (t <= 2000 || t >= 2000 + gap_ms)) {
            (void)ipe_align_push(&align, IPE_POSITION, t * MS, position);
        }
        for (; ipe_align_pop(&align, &row) == IPE_OK; ++n) {
            TEST_ASSERT_EQUAL_DOUBLE(row.has_position ? 3.0 : 0.0, row.position[2]);
        }
    }
    return n;
}

static void test_pop_gap_of_the_tracker_leaves_rows_without_position(void)
{
    for (int64_t gap = 4; gap <= 1000; gap += 8) {  // given, when
        const int n = rest_with_gap(gap);
        const uint64_t waiting = align.ring[IPE_IMU].head - align.ring[IPE_IMU].cursor;
        const uint64_t expected = gap <= 6 ? 0 : (uint64_t)gap - (gap % 4 == 0 ? 1 : 0);
        TEST_ASSERT_EQUAL_UINT64((uint64_t)n, align.n_rows);  // then
        TEST_ASSERT_EQUAL_UINT64(align.n_samples[IPE_IMU], align.n_rows + waiting);
        TEST_ASSERT_EQUAL_UINT64(expected, align.n_missing[IPE_POSITION] + align.n_late[IPE_POSITION]);
    }
}

static void test_pop_position_is_new_once_per_tracker_sample(void)
{
    int n_new = 0, n = 0;
    for (int k = 0; k <= 400; ++k) {  // given: tracker every 4 ms
        (void)push_imu(k * MS);
        (void)push_force(k * MS);
        if (k % 4 == 0) { (void)push_position(k * MS); }
        for (; ipe_align_pop(&align, &row) == IPE_OK; ++n) { n_new += row.is_position_new; }  // when
    }
    TEST_ASSERT_EQUAL_INT((n + 3) / 4, n_new);                                                // then
}

static void test_pop_full_ring_waits_no_longer(void)
{
    config.max_wait = 10.0;  // given: longer than the ring
    (void)rest_with_gap(1500);
    TEST_ASSERT_EQUAL_UINT64(0, align.n_overrun);
    TEST_ASSERT_EQUAL_UINT64(1499, align.n_missing[IPE_POSITION] + align.n_late[IPE_POSITION]);
}

static void test_push_imu_alone_overruns_and_counts(void)
{
    config.max_wait = 10.0;                                              // given: nothing else ever comes
    ipe_align_init(&align, &config);
    for (int k = 0; k < IPE_RING + 30; ++k) { (void)push_imu(k * MS); }  // when
    TEST_ASSERT_EQUAL_INT(0, pop_all());
    TEST_ASSERT_EQUAL_UINT64(30, align.n_overrun);                       // then
    TEST_ASSERT_EQUAL_UINT64(IPE_RING + 30, align.n_samples[IPE_IMU]);
}

/// Forces and positions every 5 ms with some noise, IMU every 1 ms between them; sample `at` is off by `off`, in the x of
/// position or in the force of cable 4; from_on: and all after it. Rows are compared with the undisturbed motion.
static double worst_row(int at, double off, ipe_sensor_t sensor, bool from_on)
{
    uint64_t seed = 9;
    double worst = 0.0;
    for (int k = 0; k < 2000; ++k) {
        const int64_t t_ns = k * MS;
        const int n = k / 5;
        const bool is_off = n == at || (from_on && n > at);
        if (k % 5 == 0) {
            double f[IPE_CABLES_MAX] = {0.0}, x[3] = {1.0 + 0.1 * sin(0.005 * k), 2.0, 1.0};
            for (int i = 0; i < 8; ++i) { f[i] = 400.0 + 30.0 * sin(0.004 * k) + 0.5 * normal(&seed); }
            for (int i = 0; i < 3; ++i) { x[i] += 1e-3 * normal(&seed); }
            f[3] += is_off && sensor == IPE_FORCE ? off : 0.0;
            x[0] += is_off && sensor == IPE_POSITION ? off : 0.0;
            (void)ipe_align_push(&align, IPE_FORCE, t_ns, f);
            (void)ipe_align_push(&align, IPE_POSITION, t_ns, x);
        }
        (void)push_imu(t_ns);
        while (ipe_align_pop(&align, &row) == IPE_OK) {
            const double t = 1e-6 * (double)row.t_ns;
            if (row.has_force) { worst = fmax(worst, fabs(row.f[3] - 400.0 - 30.0 * sin(0.004 * t))); }
            if (row.has_position) { worst = fmax(worst, 1e3 * fabs(row.position[0] - 1.0 - 0.1 * sin(0.005 * t))); }
        }
    }
    return worst;
}

static void test_pop_force_spike_touches_no_row(void)
{
    config.max_age[IPE_FORCE] = config.max_age[IPE_POSITION] = 0.1;
    ipe_align_init(&align, &config);
    ASSERT_BELOW(8.0, worst_row(200, 900.0, IPE_FORCE, false));  // given, when, then: N, and mm
    TEST_ASSERT_EQUAL_UINT64(1, align.n_spikes[IPE_FORCE]);
    TEST_ASSERT_EQUAL_UINT64(0, align.n_spikes[IPE_POSITION]);
    TEST_ASSERT_EQUAL_UINT64(0, align.n_late[IPE_FORCE] + align.n_missing[IPE_FORCE]);
}

static void test_pop_position_spike_touches_no_row(void)
{
    config.max_age[IPE_FORCE] = config.max_age[IPE_POSITION] = 0.1;
    ipe_align_init(&align, &config);
    ASSERT_BELOW(8.0, worst_row(200, 8.0, IPE_POSITION, false));
    TEST_ASSERT_EQUAL_UINT64(1, align.n_spikes[IPE_POSITION]);
}

static void test_pop_force_step_is_passed_on_and_doubted(void)
{
    config.max_age[IPE_FORCE] = config.max_age[IPE_POSITION] = 0.1;
    ipe_align_init(&align, &config);
    ASSERT_BELOW(450.0, worst_row(200, -400.0, IPE_FORCE, true));  // given: the sensor dies
    TEST_ASSERT_EQUAL_UINT64(0, align.n_spikes[IPE_FORCE]);
    const uint64_t end = align.ring[IPE_FORCE].head;
    int n_doubted = 0;
    for (uint64_t i = 0; i < end; ++i) { n_doubted += align.unknown[i] == 1U << 3; }
    TEST_ASSERT_EQUAL_INT(11, n_doubted);
    TEST_ASSERT_EQUAL_UINT16(1U << 3, align.unknown[200]);
    TEST_ASSERT_EQUAL_UINT16(0, align.unknown[199]);
}

static void test_push_position_out_of_reach_is_refused(void)
{
    const double inside[3] = {3.0, -2.0, 1.0}, aside[3] = {60.0, 0.0, 1.0}, above[3] = {0.0, 0.0, 40.0};
    const double in_mm[3] = {3000.0, -2000.0, 1000.0}, deep[3] = {20.0, 0.0, -30.0};
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_push(&align, IPE_POSITION, 1 * MS, inside));
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_align_push(&align, IPE_POSITION, 5 * MS, aside));
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_align_push(&align, IPE_POSITION, 5 * MS, above));
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_align_push(&align, IPE_POSITION, 5 * MS, in_mm));
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_align_push(&align, IPE_POSITION, 5 * MS, deep));
    TEST_ASSERT_EQUAL_UINT64(3, align.n_unreachable);
    TEST_ASSERT_EQUAL_UINT64(2, align.n_samples[IPE_POSITION]);
}

static void test_pop_row_near_an_unknown_force_names_it(void)
{
    for (int k = 0; k < 10; ++k) {  // given: samples 4 and 5 do not tell cable 3
        ipe_align_set_unknown_force(&align, k == 4 || k == 5 ? 1U << 2 : 0);
        (void)push_force(k * 4 * MS);
        (void)push_position(k * 4 * MS);
        (void)push_imu(k * 4 * MS + MS);
    }
    for (int k = 0; k < 8 && ipe_align_pop(&align, &row) == IPE_OK; ++k) {            // when
        TEST_ASSERT_EQUAL_UINT32(k >= 2 && k <= 6 ? 1U << 2 : 0, row.unknown_force);  // then: of the four around it
    }
}

static void test_a_delay_found_moves_the_forces_and_nothing_else(void)
{
    double f[IPE_CABLES_MAX];
    int n_rows = 0;
    ipe_align_set_force_delay(&align, 0.0035);
    for (int64_t t_ns = 0; t_ns < 60 * MS; t_ns += MS) {
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_imu(t_ns));
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_force(t_ns));
        TEST_ASSERT_EQUAL_INT(IPE_OK, push_position(t_ns));
        while (ipe_align_pop(&align, &row) == IPE_OK) {
            const double t = 1e-9 * (double)row.t_ns;
            assert_row_is_of(t);
            memcpy(f, row.f, sizeof f);
            ipe_align_undelay_forces(&align, f);
            for (int i = 0; i < 8; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, i * quadratic(t + 0.0035), f[i]); }
            ++n_rows;
        }
    }
    TEST_ASSERT_INT_WITHIN(6, 55, n_rows);
    ipe_align_set_force_delay(&align, 0.0);
    memcpy(f, row.f, sizeof f);
    ipe_align_undelay_forces(&align, f);
    TEST_ASSERT_EQUAL_DOUBLE(row.f[7], f[7]);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_pop_quadratic_signals_of_other_rates_are_interpolated_exactly);
    RUN_TEST(test_pop_uneven_sampling_is_interpolated_exactly);
    RUN_TEST(test_pop_same_instant_takes_sample_as_it_is);
    RUN_TEST(test_pop_gap_of_the_tracker_leaves_rows_without_position);
    RUN_TEST(test_pop_position_is_new_once_per_tracker_sample);
    RUN_TEST(test_pop_full_ring_waits_no_longer);
    RUN_TEST(test_pop_waits_for_slow_sensor);
    RUN_TEST(test_pop_waits_no_longer_than_max_wait);
    RUN_TEST(test_pop_across_gap_rows_lack_the_sensor_and_are_counted);
    RUN_TEST(test_pop_before_first_sample_of_a_sensor_rows_lack_it);
    RUN_TEST(test_pop_fixed_position_needs_no_position_sensor);
    RUN_TEST(test_pop_delays_are_taken_off_the_stamps);
    RUN_TEST(test_pop_result_does_not_depend_on_order_of_pushing);
    RUN_TEST(test_pop_after_end_lets_last_rows_out);
    RUN_TEST(test_push_time_backwards_is_refused_and_counted);
    RUN_TEST(test_push_reordered_samples_find_their_place);
    RUN_TEST(test_push_sample_behind_rows_that_are_out_is_refused);
    RUN_TEST(test_push_late_copy_of_a_sample_is_a_duplicate);
    RUN_TEST(test_hold_rows_wait_until_samples_are_settled);
    RUN_TEST(test_settle_between_samples_in_place_is_refused_and_counted);
    RUN_TEST(test_hold_keeps_no_more_than_it_should);
    RUN_TEST(test_push_big_step_back_restarts_sensor);
    RUN_TEST(test_push_one_stamp_far_ahead_costs_no_more_than_itself);
    RUN_TEST(test_push_one_stamp_less_than_a_second_ahead_costs_no_more_than_itself);
    RUN_TEST(test_push_nonfinite_value_is_refused_and_counted);
    RUN_TEST(test_push_quaternion_is_normalised_and_bad_one_refused);
    RUN_TEST(test_push_bad_quaternion_with_old_stamp_changes_nothing);
    RUN_TEST(test_push_rpy_becomes_quaternion);
    RUN_TEST(test_push_imu_alone_overruns_and_counts);
    RUN_TEST(test_pop_force_spike_touches_no_row);
    RUN_TEST(test_pop_position_spike_touches_no_row);
    RUN_TEST(test_pop_force_step_is_passed_on_and_doubted);
    RUN_TEST(test_push_position_out_of_reach_is_refused);
    RUN_TEST(test_pop_row_near_an_unknown_force_names_it);
    RUN_TEST(test_a_delay_found_moves_the_forces_and_nothing_else);
    return UNITY_END();
}
