// SPDX-License-Identifier: Apache-2.0
#include "parameter_gate.h"

#include "consistency.h"

#include "robot.h"

#include <pthread.h>

#define MS 1000000LL
#define SECOND 1000000000LL
#define START (1000 * SECOND)

static double nominal[IPE_NP];
static ipe_gate_limits_t limits;
static ipe_parameter_gate_t gate;
static ipe_gate_parameters_t now;
static uint64_t seed;

void setUp(void)
{
    seed = 97;
    nominal_theta(nominal);
    limits = ipe_parameter_gate_default();
    TEST_ASSERT_EQUAL(IPE_OK, ipe_parameter_gate_init(&gate, &limits, nominal));
}

void tearDown(void)
{
}

/// A good estimate at a time, of the nominal body with its mass, first moment and inertia times a factor.
static ipe_gate_estimate_t estimate(int64_t sequence, int64_t t_ns, double factor)
{
    ipe_gate_estimate_t e = {.sequence = sequence, .t_ns = t_ns, .verdict = 1};
    for (int i = 0; i < IPE_NP; ++i) {
        e.theta[i] = factor * nominal[i];
        e.covariance[i][i] = 1e-3;
        e.observable[i] = true;
    }
    return e;
}

/// Offers an estimate after an announced change, and that of the next window, which is taken.
static void settle(ipe_gate_estimate_t* e)
{
    TEST_ASSERT_EQUAL(IPE_GATE_WAITS, ipe_parameter_gate_offer(&gate, e, e->t_ns));
    e->sequence += 1, e->t_ns += 100 * MS;
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, e, e->t_ns));
}

static ipe_gate_reason_t offer(int64_t sequence, int64_t t_ns, double factor)
{
    const ipe_gate_estimate_t e = estimate(sequence, t_ns, factor);
    return ipe_parameter_gate_offer(&gate, &e, t_ns);
}

/// Offers every 100 ms from START on until the gate is live; the time of the last one.
static int64_t go_live(double factor)
{
    for (int k = 0;; ++k) {
        if (offer(k, START + k * 100 * MS, factor) == IPE_GATE_TAKEN) { return START + k * 100 * MS; }
        TEST_ASSERT_LESS_THAN_INT(20, k);
    }
}

static void test_start_is_nominal_and_the_first_estimates_wait(void)
{
    ipe_parameter_gate_read(&gate, START, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_NOMINAL, now.source);
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(nominal, now.theta, IPE_NP);
    TEST_ASSERT_EQUAL_INT64(-1, now.sequence);
    for (int k = 0; k < limits.n_return - 1; ++k) { TEST_ASSERT_EQUAL(IPE_GATE_WAITS, offer(k, START + k * MS, 1.5)); }
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, offer(10, START + 10 * MS, 1.5));
    ipe_parameter_gate_read(&gate, START + 10 * MS + SECOND, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_LIVE, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(1.5 * nominal[0], now.theta[0]);
}

static void test_transition_has_no_jump_and_every_body_on_it_can_exist(void)
{
    const double inertia[6] = {0.3, 0.4, 0.5, 0.0, 0.0, 0.0};  // a body of another kind: light, far from P
    double other[IPE_NP] = {2.0, 1.0, -0.6, 0.4};
    for (int i = 0; i < 6; ++i) { other[4 + i] = inertia[i] + (i < 3 ? 1.0 : 0.1); }
    TEST_ASSERT_TRUE(ipe_consistency_check(other));
    const int64_t live = go_live(1.0);
    ipe_gate_estimate_t e = estimate(100, live + 600 * MS, 1.0);
    memcpy(e.theta, other, sizeof other);
    for (int i = 0; i < IPE_NP; ++i) { e.covariance[i][i] = 1e-6; }
    e.n_changes = 1;
    settle(&e);
    double before = nominal[0];
    for (int64_t t = e.t_ns; t <= e.t_ns + 500 * MS; t += MS) {
        ipe_parameter_gate_read(&gate, t, &now);
        TEST_ASSERT_TRUE(ipe_consistency_check(now.theta));
        TEST_ASSERT_TRUE(fabs(now.theta[0] - before) <= 1.01 * fabs(nominal[0] - other[0]) / 500.0);
        before = now.theta[0];
    }
    TEST_ASSERT_EQUAL_DOUBLE(other[0], before);
    TEST_ASSERT_FALSE(now.is_moving);
}

static void test_estimate_in_mid_transition_starts_from_where_theta_is(void)
{
    const int64_t live = go_live(1.0);
    ipe_gate_estimate_t e = estimate(100, live + SECOND, 2.0);
    e.n_changes = 1;
    settle(&e);
    const int64_t middle = e.t_ns + 250 * MS;
    ipe_parameter_gate_read(&gate, middle, &now);
    const double halfway = now.theta[0];
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.5 * nominal[0], halfway);
    e.sequence = 102, e.t_ns = middle;
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &e, middle));
    ipe_parameter_gate_read(&gate, middle, &now);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, halfway, now.theta[0]);
}

/// 20 % more within 0.2 s, provisional, all sharp, verdict care; every `interval`. Its time after the last one.
static int64_t follow_contact(int64_t t, int64_t interval)
{
    for (int k = 0; k <= 200 * MS / interval; ++k, t += interval) {
        ipe_gate_estimate_t e = estimate(100 + k, t, 1.0 + 0.02 * k * (double)interval / (20.0 * MS));
        for (int i = 0; i < IPE_NP; ++i) { e.covariance[i][i] = 1e-5 * nominal[0] * nominal[0]; }
        e.n_changes = 1, e.verdict = 2, e.is_provisional = true;
        const ipe_gate_reason_t reason = ipe_parameter_gate_offer(&gate, &e, t);
        TEST_ASSERT_EQUAL_MESSAGE(IPE_GATE_TAKEN, reason, ipe_parameter_gate_text(reason));
        ipe_parameter_gate_read(&gate, t + 20 * MS, &now);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, e.theta[0], now.theta[0]);
    }
    return t;
}

static void test_announced_contact_is_followed_within_change_time(void)
{
    for (int verdict_max = 1; verdict_max <= 2; ++verdict_max) {
        for (int64_t interval = 20 * MS; interval <= 200 * MS; interval += 180 * MS) {
            limits.verdict_max = verdict_max;
            TEST_ASSERT_EQUAL(IPE_OK, ipe_parameter_gate_init(&gate, &limits, nominal));
            const int64_t t = follow_contact(go_live(1.0) + SECOND, interval);
            ipe_gate_estimate_t e = estimate(200, t, 1.21);  // contact over: the last of it as fast,
            e.n_changes = 1;
            TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &e, t));
            ipe_parameter_gate_read(&gate, t + 20 * MS, &now);
            TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.21 * nominal[0], now.theta[0]);
            e.sequence = 201, e.t_ns += 20 * MS, e.theta[0] *= 1.001;  // small corrections in transition_time again
            TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
            ipe_parameter_gate_read(&gate, e.t_ns + 250 * MS, &now);
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, 1.21 * 1.0005 * nominal[0], now.theta[0]);
        }
    }
}

static void test_contact_that_is_broken_off_is_left_within_change_time(void)
{
    const int64_t t = follow_contact(go_live(1.0) + SECOND, 20 * MS);
    ipe_gate_estimate_t e = estimate(200, t, 1.0);  // the body before again
    e.n_changes = 2;
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &e, t));
    ipe_parameter_gate_read(&gate, t + 20 * MS, &now);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, nominal[0], now.theta[0]);
}

static void test_care_that_stays_after_a_change_is_no_contact(void)
{
    ipe_gate_estimate_t e = estimate(100, go_live(1.0) + SECOND, 1.4);
    e.n_changes = 1, e.verdict = 2;  // such as a failed sensor
    settle(&e);
    e.sequence += 1, e.t_ns += SECOND / 2, e.theta[0] *= 1.0001;
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
    ipe_parameter_gate_read(&gate, e.t_ns + 250 * MS, &now);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 1.4 * 1.00005 * nominal[0], now.theta[0]);
}

static void test_every_refusal_has_its_reason_and_changes_nothing(void)
{
    const int64_t t = go_live(1.0) + 100 * MS;
    ipe_gate_estimate_t bad[IPE_GATE_REASONS];
    for (int i = 0; i < IPE_GATE_REASONS; ++i) { bad[i] = estimate(100 + i, t, 1.001); }
    bad[IPE_GATE_NOT_FINITE].theta[7] = NAN;
    bad[IPE_GATE_OLD_SEQUENCE].sequence = 1, bad[IPE_GATE_OLD_SEQUENCE].t_ns = START;
    bad[IPE_GATE_TOO_OLD].t_ns = t - 1100 * MS;
    bad[IPE_GATE_VERDICT].verdict = 2;
    bad[IPE_GATE_UNOBSERVABLE].observable[6] = false;
    bad[IPE_GATE_SIGMA].covariance[0][0] = 16.0 + 0.0004 * nominal[0] * nominal[0];
    bad[IPE_GATE_INCONSISTENT].theta[4] = -1.0;
    bad[IPE_GATE_CONTRADICTION].theta[0] *= 1.1;
    ipe_gate_parameters_t before;
    ipe_parameter_gate_read(&gate, t, &before);
    for (int i = IPE_GATE_NOT_FINITE; i < IPE_GATE_REASONS; ++i) {
        TEST_ASSERT_EQUAL_INT_MESSAGE(i, ipe_parameter_gate_offer(&gate, &bad[i], t),
                                      ipe_parameter_gate_text((ipe_gate_reason_t)i));
        TEST_ASSERT_EQUAL_UINT64(1, gate.n[i]);
        ipe_parameter_gate_read(&gate, t, &now);
        TEST_ASSERT_EQUAL_MEMORY(&before, &now, sizeof now);
    }
}

static void test_each_sigma_has_its_limit(void)
{
    const int64_t t = go_live(1.0) + 100 * MS;
    const double m = nominal[0],
                 over[IPE_NP] = {0.021 * m, 0.021 * m, 0.021 * m, 0.021 * m, 16.0, 16.0, 16.0, 16.0, 16.0, 16.0};
    for (int i = 0; i < IPE_NP; ++i) {  // 2 % of the mass, 20 mm, 20 % of a third of the trace: 14.4 kg m2
        ipe_gate_estimate_t e = estimate(100 + i, t, 1.0);
        e.covariance[i][i] = over[i] * over[i];
        TEST_ASSERT_EQUAL_INT_MESSAGE(IPE_GATE_SIGMA, ipe_parameter_gate_offer(&gate, &e, t), "sigma over its limit");
    }
}

static void test_each_number_may_contradict_the_last_estimate(void)
{
    const int64_t t = go_live(1.0) + 100 * MS;
    for (int i = 0; i < IPE_NP; ++i) {
        ipe_gate_estimate_t e = estimate(100 + i, t, 1.0);
        e.theta[i] += 1.0;  // 22 of its sigmas
        TEST_ASSERT_EQUAL_INT(IPE_GATE_CONTRADICTION, ipe_parameter_gate_offer(&gate, &e, t));
    }
}

static void test_stamp_ahead_of_the_clock_is_refused(void)
{
    const ipe_gate_estimate_t e = estimate(1, START, 1.0);
    TEST_ASSERT_EQUAL(IPE_GATE_TOO_OLD, ipe_parameter_gate_offer(&gate, &e, START - 20 * MS));
}

static void test_change_of_payload_may_contradict(void)
{
    ipe_gate_estimate_t e = estimate(100, go_live(1.0) + 100 * MS, 1.4);
    TEST_ASSERT_EQUAL(IPE_GATE_CONTRADICTION, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
    e.sequence = 101, e.t_ns += 100 * MS, e.n_changes = 1;
    TEST_ASSERT_EQUAL(IPE_GATE_WAITS, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
    e.sequence = 102;                                         // of the same window: says nothing more
    TEST_ASSERT_EQUAL(IPE_GATE_WAITS, ipe_parameter_gate_offer(&gate, &e, e.t_ns + 20 * MS));
    e.sequence = 103, e.t_ns += 100 * MS, e.theta[0] *= 1.1;  // the payload is still being taken up
    TEST_ASSERT_EQUAL(IPE_GATE_WAITS, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
    e.sequence = 104, e.t_ns += 100 * MS;
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
}

static void test_after_a_change_the_mass_must_be_sharp_until_all_is(void)
{
    ipe_gate_estimate_t e = estimate(100, go_live(1.0) + 100 * MS, 1.4);
    e.n_changes = 1, e.verdict = 2;
    for (int i = 1; i < IPE_NP; ++i) { e.observable[i] = false, e.covariance[i][i] = 900.0; }
    ipe_gate_estimate_t bad = e;
    bad.verdict = 3;
    TEST_ASSERT_EQUAL(IPE_GATE_VERDICT, ipe_parameter_gate_offer(&gate, &bad, bad.t_ns));
    bad = e, bad.sequence = 101, bad.observable[0] = false;
    TEST_ASSERT_EQUAL(IPE_GATE_UNOBSERVABLE, ipe_parameter_gate_offer(&gate, &bad, bad.t_ns));
    bad = e, bad.sequence = 102, bad.covariance[0][0] = 25.0;
    TEST_ASSERT_EQUAL(IPE_GATE_SIGMA, ipe_parameter_gate_offer(&gate, &bad, bad.t_ns));
    e.sequence = 103;
    settle(&e);
    ipe_gate_estimate_t other = e;
    other.sequence = 105, other.t_ns += 50 * MS, other.theta[4] += 10.0, other.theta[9] += 5.0;  // within sigma
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &other, other.t_ns));
    ipe_gate_parameters_t kept;
    ipe_parameter_gate_read(&gate, other.t_ns + 900 * MS, &kept);
    const double covariance[IPE_NP][IPE_NP] = {{0.0}};
    ipe_body_t body, known;
    (void)ipe_body_from_theta(nominal, covariance, &known);
    (void)ipe_body_from_theta(kept.theta, covariance, &body);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.4 * known.mass, body.mass);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, known.cog[i], body.cog[i]); }
    for (int i = 0; i < 6; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, known.inertia_cog[i], body.inertia_cog[i]); }
    e.sequence = 106, e.t_ns += 100 * MS;  // still so
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
    ipe_gate_estimate_t whole = estimate(107, e.t_ns + 100 * MS, 1.4);
    whole.n_changes = 1;
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, ipe_parameter_gate_offer(&gate, &whole, whole.t_ns));
    e.sequence = 108, e.t_ns += 200 * MS;  // all was sharp: from now on all must be
    TEST_ASSERT_EQUAL(IPE_GATE_VERDICT, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
}

static void test_after_a_change_the_nominal_body_is_no_fall_back(void)
{
    ipe_gate_estimate_t e = estimate(100, go_live(1.0) + 100 * MS, 1.4);
    e.n_changes = 1;
    settle(&e);
    ipe_parameter_gate_read(&gate, e.t_ns + 3600 * SECOND, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_LAST_GOOD, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(1.4 * nominal[0], now.theta[0]);
}

static void test_announced_change_alone_ends_the_nominal_fall_back(void)
{
    const int64_t live = go_live(1.2);
    ipe_gate_estimate_t e = estimate(100, live + 100 * MS, 1.4);
    e.n_changes = 1, e.verdict = 3;  // the change is announced, and nothing more can be taken: the daemon is gone then
    TEST_ASSERT_EQUAL(IPE_GATE_VERDICT, ipe_parameter_gate_offer(&gate, &e, e.t_ns));
    ipe_parameter_gate_read(&gate, live + 3600 * SECOND, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_LAST_GOOD, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(1.2 * nominal[0], now.theta[0]);
}

static void test_change_announced_during_a_fall_back_makes_no_jump(void)
{
    const int64_t live = go_live(1.2), middle = live + 1250 * MS;
    ipe_parameter_gate_read(&gate, middle, &now);
    double before = now.theta[0];
    ipe_gate_estimate_t e = estimate(100, middle, 1.4);
    e.n_changes = 1, e.verdict = 3;
    (void)ipe_parameter_gate_offer(&gate, &e, middle);
    ipe_parameter_gate_read(&gate, middle, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_FALLING_BACK, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(before, now.theta[0]);
    for (int64_t t = middle; t <= middle + SECOND; t += MS) {  // 20 % within transition_time of 0.5 s
        ipe_parameter_gate_read(&gate, t, &now);
        TEST_ASSERT_TRUE(fabs(now.theta[0] - before) <= 1.01 * 0.2 * nominal[0] / 500.0);
        before = now.theta[0];
    }
    TEST_ASSERT_EQUAL(IPE_GATE_NOMINAL, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(nominal[0], now.theta[0]);
}

static void test_gate_that_begins_after_changes_does_not_fall_back_to_nominal(void)
{
    ipe_gate_estimate_t e = estimate(0, START, 1.4);
    e.n_changes = 2;  // the gate was not there when the payload was taken up
    for (; ipe_parameter_gate_offer(&gate, &e, e.t_ns) != IPE_GATE_TAKEN; ++e.sequence) {
        TEST_ASSERT_LESS_THAN_INT64(20, e.sequence);
        e.t_ns += 100 * MS;
    }
    ipe_parameter_gate_read(&gate, e.t_ns + 3600 * SECOND, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_LAST_GOOD, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(1.4 * nominal[0], now.theta[0]);
}

static void test_inertia_that_is_kept_is_that_of_the_parameters_in_use(void)
{
    const int64_t live = go_live(1.5);  // inertia 1.5 times the nominal one, before
    ipe_gate_estimate_t e = estimate(100, live + 100 * SECOND, 1.0);
    ipe_parameter_gate_read(&gate, e.t_ns, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_NOMINAL, now.source);  // given: the nominal body is in use again
    e.n_changes = 1;
    for (int i = 1; i < IPE_NP; ++i) { e.observable[i] = false, e.covariance[i][i] = 900.0; }
    for (; ipe_parameter_gate_offer(&gate, &e, e.t_ns) != IPE_GATE_TAKEN; ++e.sequence) {
        TEST_ASSERT_LESS_THAN_INT64(120, e.sequence);
        e.t_ns += 100 * MS;
    }
    ipe_parameter_gate_read(&gate, e.t_ns + 900 * MS, &now);
    const double covariance[IPE_NP][IPE_NP] = {{0.0}};
    ipe_body_t body, known;
    (void)ipe_body_from_theta(nominal, covariance, &known);
    (void)ipe_body_from_theta(now.theta, covariance, &body);
    for (int i = 0; i < 6; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, known.inertia_cog[i], body.inertia_cog[i]); }
}

static void test_silence_falls_back_without_a_jump_and_needs_several_to_return(void)
{
    const int64_t live = go_live(1.5);
    ipe_parameter_gate_read(&gate, live + 999 * MS, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_LIVE, now.source);
    ipe_parameter_gate_read(&gate, live + 1250 * MS, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_FALLING_BACK, now.source);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.25 * nominal[0], now.theta[0]);
    ipe_parameter_gate_read(&gate, live + 1500 * MS, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_NOMINAL, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(nominal[0], now.theta[0]);
    TEST_ASSERT_EQUAL(IPE_GATE_WAITS, offer(100, live + 2 * SECOND, 1.5));
    ipe_parameter_gate_read(&gate, live + 2 * SECOND, &now);
    TEST_ASSERT_EQUAL_DOUBLE(nominal[0], now.theta[0]);
}

static void test_last_good_parameters_are_kept_where_asked_for(void)
{
    limits.keep_last_good = true;
    TEST_ASSERT_EQUAL(IPE_OK, ipe_parameter_gate_init(&gate, &limits, nominal));
    const int64_t live = go_live(1.5);
    ipe_parameter_gate_read(&gate, live + 3600 * SECOND, &now);
    TEST_ASSERT_EQUAL(IPE_GATE_LAST_GOOD, now.source);
    TEST_ASSERT_EQUAL_DOUBLE(1.5 * nominal[0], now.theta[0]);
}

static void test_restarted_daemon_counts_anew(void)
{
    const int64_t live = go_live(1.0);
    TEST_ASSERT_EQUAL(IPE_GATE_TAKEN, offer(1000, live + 100 * MS, 1.0));
    for (int k = 0; k < limits.n_return; ++k) {  // numbers from 0 again, time goes on: another body
        const ipe_gate_reason_t expected = k < limits.n_return - 1 ? IPE_GATE_WAITS : IPE_GATE_TAKEN;
        TEST_ASSERT_EQUAL_INT(expected, offer(k, live + (200 + k * 100) * MS, 1.5));
    }
}

static void test_covariance_that_is_none_is_refused(void)
{
    const int64_t t = go_live(1.0) + 100 * MS;
    for (int i = 0; i < IPE_NP; ++i) {
        ipe_gate_estimate_t e = estimate(100 + i, t, 1.0);
        e.covariance[i][i] = -1.0;
        TEST_ASSERT_EQUAL_INT(IPE_GATE_NOT_FINITE, ipe_parameter_gate_offer(&gate, &e, t));
    }
}

static void test_wild_times_are_refused(void)
{
    const int64_t wild[] = {INT64_MIN, -1, INT64_MAX};
    for (int i = 0; i < 3; ++i) {
        const ipe_gate_estimate_t e = estimate(1, wild[i], 1.0);
        TEST_ASSERT_EQUAL_INT(IPE_GATE_TOO_OLD, ipe_parameter_gate_offer(&gate, &e, START));
    }
}

static void test_bad_limits_and_impossible_nominal_bodies_are_refused(void)
{
    ipe_gate_limits_t bad = limits;
    bad.age_max = 0.0;
    TEST_ASSERT_EQUAL(IPE_ERR_RANGE, ipe_parameter_gate_init(&gate, &bad, nominal));
    bad = limits, bad.mass_std = NAN;
    TEST_ASSERT_EQUAL(IPE_ERR_RANGE, ipe_parameter_gate_init(&gate, &bad, nominal));
    nominal[4] = -1.0;
    TEST_ASSERT_EQUAL(IPE_ERR_RANGE, ipe_parameter_gate_init(&gate, &limits, nominal));
}

static void test_random_estimates_never_move_theta_to_a_body_that_cannot_exist(void)
{
    limits.n_return = 1;
    TEST_ASSERT_EQUAL(IPE_OK, ipe_parameter_gate_init(&gate, &limits, nominal));
    int64_t t = START;
    double before[IPE_NP];
    for (int k = 0; k < 20000; ++k) {
        t += (int64_t)(between(&seed, 0.0, 300.0) * MS);
        ipe_gate_estimate_t e = estimate(k, t, between(&seed, 0.2, 3.0));
        for (int i = 0; i < IPE_NP; ++i) {
            e.theta[i] += 20.0 * normal(&seed);
            e.covariance[i][i] = 1e4;
        }
        e.covariance[0][0] = 1e-4 * nominal[0] * nominal[0];
        if (k % 2 > 0) { memcpy(e.theta, before, sizeof before); }  // a change is over
        memcpy(before, e.theta, sizeof before);
        e.n_changes = k / 2;
        (void)ipe_parameter_gate_offer(&gate, &e, t);
        ipe_parameter_gate_read(&gate, t + (int64_t)(between(&seed, 0.0, 2000.0) * MS), &now);
        TEST_ASSERT_TRUE(ipe_consistency_check(now.theta));
    }
    TEST_ASSERT_GREATER_THAN_UINT64(1000, gate.n[IPE_GATE_TAKEN]);
    TEST_ASSERT_GREATER_THAN_UINT64(1000, gate.n[IPE_GATE_INCONSISTENT]);
}

enum { OFFERS = 200000 };

static void* offer_all(void* is_over)
{
    for (int k = 0; k < OFFERS; ++k) {
        ipe_gate_estimate_t e = estimate(k, START + k * MS, 1.0 + k / 2 % 7);
        e.n_changes = k / 2;
        (void)ipe_parameter_gate_offer(&gate, &e, e.t_ns);
    }
    __atomic_store_n((bool*)is_over, true, __ATOMIC_RELEASE);
    return NULL;
}

static void test_reader_of_another_thread_never_sees_half_an_estimate(void)
{
    limits.transition_time = 0.0;  // so that theta is one estimate's: a multiple of the nominal one
    TEST_ASSERT_EQUAL(IPE_OK, ipe_parameter_gate_init(&gate, &limits, nominal));
    bool is_over = false;
    int64_t sequence = -1;
    pthread_t writer;
    TEST_ASSERT_EQUAL_INT(0, pthread_create(&writer, NULL, offer_all, &is_over));
    while (!__atomic_load_n(&is_over, __ATOMIC_ACQUIRE)) {
        ipe_parameter_gate_read(&gate, START, &now);
        TEST_ASSERT_TRUE(now.sequence >= sequence);  // and never an older one again
        sequence = now.sequence;
        const double factor = now.theta[0] / nominal[0];
        for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, factor * nominal[i], now.theta[i]); }
    }
    (void)pthread_join(writer, NULL);
    ipe_parameter_gate_read(&gate, START, &now);
    TEST_ASSERT_EQUAL_INT64(OFFERS - 1, now.sequence);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_start_is_nominal_and_the_first_estimates_wait);
    RUN_TEST(test_transition_has_no_jump_and_every_body_on_it_can_exist);
    RUN_TEST(test_estimate_in_mid_transition_starts_from_where_theta_is);
    RUN_TEST(test_announced_contact_is_followed_within_change_time);
    RUN_TEST(test_contact_that_is_broken_off_is_left_within_change_time);
    RUN_TEST(test_care_that_stays_after_a_change_is_no_contact);
    RUN_TEST(test_every_refusal_has_its_reason_and_changes_nothing);
    RUN_TEST(test_each_sigma_has_its_limit);
    RUN_TEST(test_each_number_may_contradict_the_last_estimate);
    RUN_TEST(test_stamp_ahead_of_the_clock_is_refused);
    RUN_TEST(test_change_of_payload_may_contradict);
    RUN_TEST(test_after_a_change_the_mass_must_be_sharp_until_all_is);
    RUN_TEST(test_after_a_change_the_nominal_body_is_no_fall_back);
    RUN_TEST(test_announced_change_alone_ends_the_nominal_fall_back);
    RUN_TEST(test_change_announced_during_a_fall_back_makes_no_jump);
    RUN_TEST(test_gate_that_begins_after_changes_does_not_fall_back_to_nominal);
    RUN_TEST(test_inertia_that_is_kept_is_that_of_the_parameters_in_use);
    RUN_TEST(test_silence_falls_back_without_a_jump_and_needs_several_to_return);
    RUN_TEST(test_last_good_parameters_are_kept_where_asked_for);
    RUN_TEST(test_restarted_daemon_counts_anew);
    RUN_TEST(test_covariance_that_is_none_is_refused);
    RUN_TEST(test_wild_times_are_refused);
    RUN_TEST(test_bad_limits_and_impossible_nominal_bodies_are_refused);
    RUN_TEST(test_random_estimates_never_move_theta_to_a_body_that_cannot_exist);
    RUN_TEST(test_reader_of_another_thread_never_sees_half_an_estimate);
    return UNITY_END();
}
