// SPDX-License-Identifier: Apache-2.0
#include "sample_timing.h"

#include "robot.h"

#define HOST_0 1760000000000000000LL  // ns

static ipe_clock_t clock_;
static ipe_sample_timing_t pace;
static uint64_t seed;

void setUp(void)
{
    seed = 3;
    ipe_sample_timing_init(&pace);
    ipe_clock_init(&clock_, 0.0, 0.0);
}

void tearDown(void)
{
}

/// What a sensor and its host do to sample k: is it lost, how late is it stamped.
typedef struct {
    bool is_lost;
    double late;
} fate_t;

typedef fate_t (*fault_t)(int k, double period);

static double prompt(void)
{
    return between(&seed, 5e-6, 150e-6);
}

static struct {
    int n_sent, n_settled, n_wrong;
    double largest;  ///< s, error of the instants from `settled` on
} result;

/// Feed `seconds` of samples, stamps never before the one before, and compare what is settled with the truth.
static void feed(double period, double seconds, double settled, bool has_counter, fault_t fault)
{
    static double held[IPE_SAMPLE_TIMING_HOLD + 1];
    int n_held = 0, last = -1;
    double newest = 0.0;
    memset(&result, 0, sizeof result);
    for (int k = 0; k * period < seconds; ++k) {
        const fate_t fate = fault(k, period);
        if (fate.is_lost) { continue; }
        ++result.n_sent;
        newest = fmax(newest + 20e-6, k * period + fate.late + prompt());
        memmove(&held[1], &held[0], sizeof held - sizeof held[0]);
        held[0] = k * period;
        ++n_held;
        const int64_t stamp = HOST_0 + (int64_t)llround(1e9 * newest);
        const int n =
            ipe_sample_timing_push(&pace, &clock_, stamp, has_counter && last >= 0 ? (uint64_t)(k - last) : 0);
        last = k;
        TEST_ASSERT_TRUE(n <= n_held && n <= IPE_SAMPLE_TIMING_HOLD);
        for (int i = 0; i < n; ++i) {
            const double error = fabs(1e-9 * (double)(ipe_sample_timing_instant(&pace, &clock_, i) - HOST_0) - held[i]);
            if (held[i] >= settled) { result.largest = fmax(result.largest, error); }
            result.n_wrong += held[i] >= settled && error > 0.4 * period;
        }
        result.n_settled += n;
        if (n > 0) { n_held = 0; }
    }
    TEST_ASSERT_EQUAL_UINT64(result.n_sent, (unsigned)result.n_settled + pace.n_dropped + (unsigned)pace.n_waiting);
}

static fate_t nothing(int k, double period)
{
    (void)k, (void)period;
    return (fate_t){false, 0.0};
}

static void test_push_regular_samples_are_all_settled_near_their_instants(void)
{
    static const double period[] = {0.5e-3, 1e-3, 5e-3, 0.02, 0.04};
    for (int i = 0; i < 5; ++i) {
        setUp();                                              // given
        feed(period[i], 60.0, 2.0, false, nothing);           // when
        ASSERT_BELOW(5.0, result.n_sent - result.n_settled);  // then: but for the first, while the period is measured
        ASSERT_BELOW(150e-6, result.largest);
        TEST_ASSERT_EQUAL_UINT64(0, pace.n_lost + pace.n_restarts);
        TEST_ASSERT_DOUBLE_WITHIN(1e-4 * period[i], period[i], pace.period * clock_.rate);
    }
}

/// Every 5 s the host stands still for 0.3 s and then stamps what came in one burst.
static fate_t stalls(int k, double period)
{
    const double t = fmod(k * period, 5.0);
    return (fate_t){false, t > 4.0 && t < 4.3 ? 4.3 - t : 0.0};
}

static void test_push_bursts_after_stalls_are_retimed_or_dropped(void)
{
    static const double period[] = {1e-3, 5e-3, 0.02};
    for (int i = 0; i < 3; ++i) {
        setUp();                                    // given
        feed(period[i], 60.0, 1.0, false, stalls);  // when
        TEST_ASSERT_EQUAL_INT(0, result.n_wrong);   // then
        ASSERT_BELOW(250e-6, result.largest);
        TEST_ASSERT_EQUAL_UINT64(0, pace.n_lost);
        TEST_ASSERT_GREATER_THAN_INT(result.n_sent * 9 / 10, result.n_settled);
    }
}

/// One sample in a hundred, and every 5 s a stretch of 30.
static fate_t losses(int k, double period)
{
    (void)period;
    return (fate_t){k > 500 && (uniform(&seed) < 0.01 || k % 5000 < 30), 0.0};
}

static void test_push_lost_samples_do_not_shift_the_others(void)
{
    feed(1e-3, 60.0, 1.0, false, losses);      // given, when
    TEST_ASSERT_EQUAL_INT(0, result.n_wrong);  // then
    ASSERT_BELOW(150e-6, result.largest);
    TEST_ASSERT_GREATER_THAN_INT(result.n_sent * 99 / 100, result.n_settled);
    TEST_ASSERT_EQUAL_UINT64(60000 - result.n_sent, pace.n_lost);
    TEST_ASSERT_EQUAL_UINT64(0, pace.n_restarts);
}

/// A stall during which the buffer overflows: the last two thirds of its samples are lost.
static fate_t overflows(int k, double period)
{
    const double t = fmod(k * period, 5.0);
    return (fate_t){t > 4.1 && t < 4.3, t > 4.0 && t <= 4.1 ? 4.3 - t : 0.0};
}

static void test_push_stall_with_losses_is_never_believed(void)
{
    feed(1e-3, 60.0, 1.0, false, overflows);   // given, when
    TEST_ASSERT_EQUAL_INT(0, result.n_wrong);  // then
    ASSERT_BELOW(150e-6, result.largest);
    TEST_ASSERT_UINT64_WITHIN(24, 12 * 200, pace.n_lost);
    TEST_ASSERT_GREATER_THAN_UINT64(12 * 80, pace.n_dropped);
}

static void test_push_with_counter_needs_no_guess(void)
{
    feed(1e-3, 60.0, 1.0, true, overflows);    // given, when
    TEST_ASSERT_EQUAL_INT(0, result.n_wrong);  // then: everything is used
    ASSERT_BELOW(150e-6, result.largest);
    TEST_ASSERT_EQUAL_INT(result.n_sent, result.n_settled);
    TEST_ASSERT_EQUAL_UINT64(0, pace.n_lost + pace.n_dropped);
}

/// The record starts in a burst.
static fate_t starts_late(int k, double period)
{
    return (fate_t){false, k * period < 0.1 ? 0.1 - k * period : 0.0};
}

static void test_push_burst_at_the_start_does_not_lock_the_sensor_out(void)
{
    feed(1e-3, 10.0, 0.3, false, starts_late);  // given, when
    TEST_ASSERT_EQUAL_INT(0, result.n_wrong);   // then
    TEST_ASSERT_GREATER_THAN_INT(9700, result.n_settled);
}

/// Half a period later from 3 s on, as after a sensor's restart.
static fate_t phase_shift(int k, double period)
{
    return (fate_t){false, k * period > 3.0 ? 2.5 * period : 0.0};
}

static void test_push_new_phase_is_learnt_anew(void)
{
    feed(0.02, 10.0, 9.9, false, phase_shift);     // given, when
    TEST_ASSERT_EQUAL_UINT64(1, pace.n_restarts);  // then: 2.5 periods later, all of them
    ASSERT_BELOW(2.51 * 0.02, result.largest);
    ASSERT_BELOW(-2.49 * 0.02, -result.largest);
    TEST_ASSERT_LESS_OR_EQUAL_UINT64(IPE_SAMPLE_TIMING_HOLD + 8, pace.n_dropped);
}

static void test_push_new_period_is_measured_again(void)
{
    feed(0.01, 5.0, 1.0, false, nothing);        // given: 100 Hz
    int n = 0, n_pushed = 0;
    for (int k = 0; k < 500; ++k, ++n_pushed) {  // when: then 40 Hz
        const double t = 5.0 + 0.025 * k;
        n += ipe_sample_timing_push(&pace, &clock_, HOST_0 + (int64_t)llround(1e9 * (t + prompt())), 0);
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 0.025, pace.period * clock_.rate);  // then
    TEST_ASSERT_GREATER_OR_EQUAL_UINT64(1, pace.n_restarts);
    TEST_ASSERT_GREATER_THAN_INT(n_pushed - IPE_SAMPLE_TIMING_HOLD - 8, n);
}

static void test_end_counts_what_still_waits(void)
{
    feed(0.02, 5.0, 1.0, false, nothing);  // given: two samples that are late
    (void)ipe_sample_timing_push(&pace, &clock_, HOST_0 + 5100000000LL, 0);
    (void)ipe_sample_timing_push(&pace, &clock_, HOST_0 + 5180000000LL, 0);
    ipe_sample_timing_end(&pace);                 // when
    TEST_ASSERT_EQUAL_UINT64(2, pace.n_dropped);  // then
    TEST_ASSERT_EQUAL_INT(0, pace.n_waiting);
}

static fate_t ragged(int k, double period)
{
    (void)k;
    return (fate_t){false, between(&seed, 0.0, 0.6 * period)};
}

static void test_push_ragged_host_still_gets_most_samples(void)
{
    feed(1e-3, 10.0, 1.0, false, ragged);      // given: a host as late as 0.6 of the period, when
    TEST_ASSERT_EQUAL_INT(0, result.n_wrong);  // then
    TEST_ASSERT_GREATER_THAN_INT(9000, result.n_settled);
}

/// Late by half a period on average, and now and then by several, as on a busy machine.
static fate_t busy(int k, double period)
{
    (void)k;
    return (fate_t){false, -0.5 * period * log(1.0 - uniform(&seed))};
}

static void test_push_busy_host_costs_few_samples(void)
{
    for (uint64_t trial = 1; trial <= 50; ++trial) {
        setUp();                                                                // given
        seed = trial;
        feed(0.02, 30.0, 30.0, false, busy);                                    // when
        TEST_ASSERT_GREATER_THAN_INT(result.n_sent * 3 / 4, result.n_settled);  // then
    }
}

/// Frames that wait for those of other sensors, so stamps scatter over three quarters of the period; 1 % are lost.
static fate_t loaded_bus(int k, double period)
{
    (void)k;
    return (fate_t){uniform(&seed) < 0.01, 0.6 * period * uniform(&seed)};
}

static void test_push_losses_on_a_loaded_bus_cost_few_samples_beside(void)
{
    feed(0.001, 60.0, 2.0, false, loaded_bus);    // given, when
    const uint64_t lost = 60000 - (uint64_t)result.n_sent;
    TEST_ASSERT_EQUAL_UINT64(lost, pace.n_lost);  // then: a second loss before the first is known locks nobody out
    TEST_ASSERT_EQUAL_UINT64(0, pace.n_restarts);
    TEST_ASSERT_LESS_THAN_UINT64(2 * lost, pace.n_dropped);
    TEST_ASSERT_LESS_THAN_INT(result.n_sent / 200, result.n_wrong);
}

/// The same, and a quarter of what the first 0.4 s bring is lost: the period is measured too long.
static fate_t lossy_start(int k, double period)
{
    const fate_t fate = loaded_bus(k, period);
    return (fate_t){fate.is_lost || (k * period < 0.4 && uniform(&seed) < 0.25), fate.late};
}

static void test_push_period_measured_over_lost_samples_is_measured_again(void)
{
    int n_right = 0;
    for (uint64_t trial = 1; trial <= 20; ++trial) {
        setUp();                                                            // given
        seed = trial;
        feed(0.001, 20.0, 10.0, false, lossy_start);                        // when
        TEST_ASSERT_GREATER_OR_EQUAL_UINT64(1, pace.n_restarts);            // then
        TEST_ASSERT_LESS_THAN_INT(result.n_sent * 3 / 20, result.n_wrong);  // not healed: a third
        n_right += result.n_wrong < result.n_sent / 200;
    }
    TEST_ASSERT_GREATER_OR_EQUAL_INT(14, n_right);
}

/// One of a sample's two frames is lost more often, and the stamps lie evenly in their part of the period.
static fate_t lossy_bus(int k, double period)
{
    (void)k;
    return (fate_t){uniform(&seed) < 0.02, 0.55 * period * uniform(&seed)};
}

static void test_push_line_that_is_too_fast_is_paced_by_the_intervals(void)
{
    for (uint64_t trial = 1; trial <= 40; ++trial) {
        setUp();                                                            // given
        seed = trial;
        feed(0.001, 30.0, 30.0, false, lossy_bus);                          // when
        TEST_ASSERT_LESS_THAN_UINT64(result.n_sent / 8, pace.n_dropped);    // then: not healed, a quarter
        TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.001, pace.period * clock_.rate);  // 4 %
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_push_line_that_is_too_fast_is_paced_by_the_intervals);
    RUN_TEST(test_push_period_measured_over_lost_samples_is_measured_again);
    RUN_TEST(test_push_busy_host_costs_few_samples);
    RUN_TEST(test_push_regular_samples_are_all_settled_near_their_instants);
    RUN_TEST(test_push_bursts_after_stalls_are_retimed_or_dropped);
    RUN_TEST(test_push_lost_samples_do_not_shift_the_others);
    RUN_TEST(test_push_stall_with_losses_is_never_believed);
    RUN_TEST(test_push_with_counter_needs_no_guess);
    RUN_TEST(test_push_burst_at_the_start_does_not_lock_the_sensor_out);
    RUN_TEST(test_push_new_phase_is_learnt_anew);
    RUN_TEST(test_push_new_period_is_measured_again);
    RUN_TEST(test_end_counts_what_still_waits);
    RUN_TEST(test_push_ragged_host_still_gets_most_samples);
    RUN_TEST(test_push_losses_on_a_loaded_bus_cost_few_samples_beside);
    return UNITY_END();
}
