// SPDX-License-Identifier: Apache-2.0
#include "window.h"

#include "robot.h"

static ipe_config_t config;
static ipe_window_t window;
static ipe_average_t average;
static uint64_t seed;

void setUp(void)
{
    seed = 31;
    config = cogiro();
    config.sample_rate = 1000.0;
    config.max_age[IPE_IMU] = 0.05;
    ipe_window_init(&window, &config);
}

void tearDown(void)
{
}

/// One row at t: every channel by a function of time.
static ipe_status_t push(double t, double (*signal)(double t, int channel))
{
    ipe_motion_t motion;
    ipe_wrench_t wrench;
    memset(&motion, 0, sizeof motion);
    memset(&wrench, 0, sizeof wrench);
    for (int i = 0; i < 3; ++i) {
        motion.s[i] = signal(t, i);
        motion.w[i] = signal(t, 3 + i);
        motion.p[i] = signal(t, 6 + i);
    }
    const double turn[3] = {0.0, 0.0, t};
    mat3_exp(turn, motion.R);
    for (int i = 0; i < IPE_NY; ++i) { wrench.y[i] = signal(t, 9 + i); }
    for (int i = 0; i < 8; ++i) { wrench.f[i] = signal(t, 15 + i); }
    return ipe_window_push(&window, (int64_t)llround(1e9 * t), &motion, &wrench, &average);
}

static double constant(double t, int channel)
{
    return t < 0.0 ? NAN : 1.0 + channel;
}

static double linear(double t, int channel)
{
    return 1.0 + channel + (0.1 * channel - 0.4) * t;
}

static double jumps_at_2s(double t, int channel)
{
    return channel + (t < 2.0 ? 1.0 : 2.0);
}

static const double omega = 2.0 * PI * 1.3;

static double sinusoid(double t, int channel)
{
    return sin(omega * t + channel);
}

static void test_push_first_window_ends_after_its_length_and_next_each_quarter(void)
{
    int n = 0;                         // given: 1 kHz, windows of 0.4 s
    double first = 0.0;
    for (int k = 0; k <= 2000; ++k) {  // when
        if (push(1e-3 * k, constant) != IPE_OK) { continue; }
        if (n++ == 0) { first = 1e-3 * k; }
        TEST_ASSERT_INT64_WITHIN(1, (int64_t)llround(1e9 * (0.2 + 0.1 * (n - 1))), average.t_ns);  // then: middles
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.4, first);
    TEST_ASSERT_EQUAL_INT(17, n);
    TEST_ASSERT_EQUAL_UINT64(17, window.n_windows);
    TEST_ASSERT_EQUAL_UINT64(2001, window.n_rows);
}

static void test_push_constant_signals_average_to_themselves(void)
{
    uint64_t n = 0;                                     // given: uneven rows
    for (double t = 0.0; t < 3.0; t += 1e-3 * between(&seed, 0.4, 1.6)) {
        if (push(t, constant) != IPE_OK) { continue; }  // when
        ++n;
        for (int i = 0; i < 3; ++i) {                   // then
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0 + i, average.s[i]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0 + i, average.w[i]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, (4.0 + i) * (4.0 + i), average.ww[i]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-10, 0.0, average.alpha[i]);
        }
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 5.0 * 6.0, average.ww[3]);
        for (int i = 0; i < IPE_NY; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, 10.0 + i, average.y[i]); }
        for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, 7.0 + i, average.p[i]); }
        for (int i = 0; i < 8; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, 16.0 + i, average.f[i]); }
    }
    TEST_ASSERT_GREATER_THAN_UINT64(24, n);
}

static void test_push_linear_rate_gives_exact_acceleration_on_any_grid(void)
{
    uint64_t n = 0;                                   // given: spacings of 0.4 .. 1.6 ms
    for (double t = 0.0; t < 3.0; t += 1e-9 * round(1e6 * between(&seed, 0.4, 1.6))) {
        if (push(t, linear) != IPE_OK) { continue; }  // when
        ++n;
        for (int i = 0; i < 3; ++i) {                 // then
            TEST_ASSERT_DOUBLE_WITHIN(1e-10, 0.1 * (3 + i) - 0.4, average.alpha[i]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-10, 0.1 * (6 + i) - 0.4, average.velocity[i]);
        }
        for (int i = 0; i < 8; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-10, 0.1 * (15 + i) - 0.4, average.f_slope[i]); }
        TEST_ASSERT_DOUBLE_WITHIN(2e-3, 1e-9 * (double)average.t_ns, atan2(average.R[1][0], average.R[0][0]));
    }
    TEST_ASSERT_GREATER_THAN_UINT64(24, n);
}

static void test_push_sinusoidal_rate_gives_its_filtered_derivative(void)
{
    uint64_t n = 0;                                            // given: a sine sampled at 1 kHz
    for (int k = 0; k < 3000; ++k) {
        if (push(1e-3 * k, sinusoid) != IPE_OK) { continue; }  // when
        ++n;
        const double half = 0.5 * omega * 0.1;                 // then: the kernel's four boxes of 0.1 s
        const double gain = pow(sin(half) / half, 4.0), t = 1e-9 * (double)average.t_ns;
        for (int i = 0; i < 3; ++i) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, gain * omega * cos(omega * t + 3 + i), average.alpha[i]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, gain * sin(omega * t + i), average.s[i]);
        }
    }
    TEST_ASSERT_EQUAL_UINT64(26, n);
}

static void test_push_sinusoid_on_an_uneven_grid_is_averaged_by_time_not_by_row(void)
{
    uint64_t n = 0;                                     // given: spacings of 0.4 .. 1.6 ms
    for (double t = 0.0; t < 3.0; t += 1e-9 * round(1e6 * between(&seed, 0.4, 1.6))) {
        if (push(t, sinusoid) != IPE_OK) { continue; }  // when
        ++n;
        const double half = 0.5 * omega * 0.1, middle = 1e-9 * (double)average.t_ns;  // then
        const double gain = pow(sin(half) / half, 4.0);
        for (int i = 0; i < 3; ++i) {
            TEST_ASSERT_DOUBLE_WITHIN(3e-5, gain * sin(omega * middle + i), average.s[i]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-3, gain * omega * cos(omega * middle + 3 + i), average.alpha[i]);
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT64(24, n);
}

static void check_measured_period(double rate)
{
    config.sample_rate = 0.0;       // given: rate not told, stamps with jitter of 5 %
    ipe_window_init(&window, &config);
    for (int k = 0; k < 60; ++k) {  // when: and three rows missing
        if (k % 20 == 15) { continue; }
        (void)push((k + 0.05 * uniform(&seed)) / rate, constant);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.02 / rate, 1.0 / rate, window.period);  // then
    const double quarter = fmax(2.0, round(0.1 / window.period));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0 * quarter * window.period, window.length);
    TEST_ASSERT_TRUE(window.is_running);
}

static void test_push_unknown_rate_is_measured(void)
{
    check_measured_period(1000.0);
    check_measured_period(200.0);
    check_measured_period(25.0);
    check_measured_period(4.0);
}

static void test_push_gap_restarts_windows(void)
{
    uint64_t n = 0;  // given: signals jump during a gap of 60 ms
    for (int k = 0; k < 4000; ++k) {
        if (k >= 1970 && k < 2030) { continue; }
        if (push(1e-3 * k, jumps_at_2s) != IPE_OK) { continue; }          // when
        ++n;
        const double expected = average.t_ns < 2000000000LL ? 1.0 : 2.0;  // then: no window knows both sides
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, expected, average.s[0]);
    }
    TEST_ASSERT_EQUAL_UINT64(1, window.n_restarts);
    TEST_ASSERT_EQUAL_UINT64(16 + 16, n);
}

static void test_push_one_lost_row_does_no_harm(void)
{
    uint64_t n = 0;                                                         // given: one row in 50 missing
    for (int k = 0; k < 3000; ++k) {
        if (k % 50 == 7 || push(1e-3 * k, linear) != IPE_OK) { continue; }  // when
        ++n;
        TEST_ASSERT_DOUBLE_WITHIN(1e-10, -0.1, average.alpha[0]);           // then
    }
    TEST_ASSERT_EQUAL_UINT64(0, window.n_restarts);
    TEST_ASSERT_EQUAL_UINT64(26, n);
}

static void test_push_slow_rows_lost_restart_windows(void)
{
    config.sample_rate = 25.0;  // given: at 25 Hz a lost row is a gap
    config.max_age[IPE_IMU] = 0.2;
    ipe_window_init(&window, &config);
    for (int k = 0; k < 50; ++k) {
        if (k != 30) { (void)push(0.04 * k, linear); }  // when
    }
    TEST_ASSERT_EQUAL_UINT64(1, window.n_restarts);     // then
}

static void test_push_jitter_of_rows_slower_than_max_age_is_no_gap(void)
{
    config.sample_rate = 10.0;  // given: 10 Hz, stamps off by up to 20 ms
    config.max_age[IPE_IMU] = 0.1;
    ipe_window_init(&window, &config);
    for (int k = 0; k < 300; ++k) { (void)push(0.1 * k + between(&seed, -0.02, 0.02), linear); }  // when
    TEST_ASSERT_EQUAL_UINT64(0, window.n_restarts);                                               // then
    TEST_ASSERT_GREATER_THAN_UINT64(100, window.n_windows);
    (void)push(30.1, linear);                                                                     // a lost row is one
    TEST_ASSERT_EQUAL_UINT64(1, window.n_restarts);
}

static void test_push_time_backwards_is_refused_and_counted(void)
{
    for (int k = 0; k < 100; ++k) { (void)push(1e-3 * k, constant); }  // given
    const ipe_window_t before = window;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME, push(0.099, constant));        // when, then: same stamp, earlier stamp
    TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME, push(0.05, constant));
    TEST_ASSERT_EQUAL_UINT64(2, window.n_backwards);
    window.n_backwards = 0;
    TEST_ASSERT_EQUAL_MEMORY(&before, &window, sizeof window);
}

static void test_push_clock_stepped_back_restarts_windows(void)
{
    for (int k = 0; k < 100; ++k) { (void)push(100.0 + 1e-3 * k, constant); }           // given
    int n = 0;
    for (int k = 0; k <= 400; ++k) { n += push(50.0 + 1e-3 * k, constant) == IPE_OK; }  // when
    TEST_ASSERT_EQUAL_UINT64(1, window.n_restarts);                                     // then
    TEST_ASSERT_EQUAL_INT(1, n);
    TEST_ASSERT_EQUAL_INT64(50200000000LL, average.t_ns);
}

static void test_push_many_hours_keep_windows_exact(void)
{
    const double start = 36000.0;  // given: 10 hours after the first window
    (void)push(0.0, constant);
    window.origin_ns = 0;
    window.first = (uint64_t)(10.0 * start);
    window.previous.t_ns = (int64_t)(1e9 * start);
    int n = 0;
    for (int k = 1; k <= 1000; ++k) {                             // when
        if (push(start + 1e-3 * k, linear) != IPE_OK || n++ < 4) { continue; }
        TEST_ASSERT_DOUBLE_WITHIN(1e-8, -0.1, average.alpha[0]);  // then
    }
    TEST_ASSERT_EQUAL_INT(7, n);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_push_first_window_ends_after_its_length_and_next_each_quarter);
    RUN_TEST(test_push_constant_signals_average_to_themselves);
    RUN_TEST(test_push_linear_rate_gives_exact_acceleration_on_any_grid);
    RUN_TEST(test_push_sinusoidal_rate_gives_its_filtered_derivative);
    RUN_TEST(test_push_sinusoid_on_an_uneven_grid_is_averaged_by_time_not_by_row);
    RUN_TEST(test_push_unknown_rate_is_measured);
    RUN_TEST(test_push_gap_restarts_windows);
    RUN_TEST(test_push_one_lost_row_does_no_harm);
    RUN_TEST(test_push_slow_rows_lost_restart_windows);
    RUN_TEST(test_push_jitter_of_rows_slower_than_max_age_is_no_gap);
    RUN_TEST(test_push_time_backwards_is_refused_and_counted);
    RUN_TEST(test_push_clock_stepped_back_restarts_windows);
    RUN_TEST(test_push_many_hours_keep_windows_exact);
    return UNITY_END();
}
