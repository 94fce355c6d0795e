// SPDX-License-Identifier: Apache-2.0
#include "pipeline.h"

#include "counter_table.h"
#include "parameter_gate.h"

#include "robot.h"

#define MS 1000000LL
#define START 1760000000000000000LL  // ns, host time of the first sample

enum { N_SAMPLES = 20000 };          // of one millisecond

static ipe_config_t config;
static ipe_pipeline_t pipeline, other;
static ideal_t sample[N_SAMPLES];
static double truth[IPE_NP];
static bool is_simulated;
static char message[256];
static uint64_t seed;

static void simulate_once(void)
{
    if (is_simulated) { return; }
    for (int k = 0; k < N_SAMPLES; ++k) { sample[k] = ideal_at(&config, 1e-3 * k, truth); }
    is_simulated = true;
}

static void init(ipe_pipeline_t* p)
{
    TEST_ASSERT_EQUAL_INT_MESSAGE(IPE_OK, ipe_pipeline_init(p, &config, message, sizeof message), message);
}

void setUp(void)
{
    seed = 1234;
    config = cogiro();
    for (int i = 0; i < 8; ++i) { config.cable[i].weight_per_length = 0.0; }  // the samples know no inertia of cables
    nominal_theta(truth);
    simulate_once();
    init(&pipeline);
}

void tearDown(void)
{
}

static ipe_frame_t frame_of(uint32_t can_id, int length, int k)
{
    ipe_frame_t f;
    memset(&f, 0, sizeof f);
    f.t_ns = START + k * MS;
    f.can_id = can_id;
    f.flags = IPE_FRAME_FD;
    f.length = (uint8_t)length;
    return f;
}

static ipe_frame_t imu_a_of(const ideal_t* x, int k)
{
    ipe_frame_t f = frame_of(ID_IMU_A, LENGTH_IMU_A, k);
    const uint16_t counter = (uint16_t)k;
    const uint32_t time_us = (uint32_t)(4294000000U + 1000U * (unsigned)k);  // wraps after one second
    memcpy(f.data, x->acc, 24);
    memcpy(f.data + 24, x->gyro, 24);
    memcpy(f.data + 48, &counter, 2);
    memcpy(f.data + 52, &time_us, 4);
    return f;
}

static ipe_frame_t imu_b_of(const ideal_t* x, int k)
{
    ipe_frame_t f = frame_of(ID_IMU_B, LENGTH_IMU_B, k);
    memcpy(f.data, x->q, 32);
    return f;
}

static ipe_frame_t force_of(const ideal_t* x, int k)
{
    ipe_frame_t f = frame_of(ID_FORCE, LENGTH_FORCE, k);
    memcpy(f.data, x->f, 64);
    return f;
}

static ipe_frame_t imu_a(int k)
{
    return imu_a_of(&sample[k], k);
}

static ipe_frame_t imu_b(int k)
{
    return imu_b_of(&sample[k], k);
}

static ipe_frame_t force(int k)
{
    return force_of(&sample[k], k);
}

static bool is_finite(const ipe_estimate_t* e)
{
    const ipe_body_t* b = &e->body;
    return isfinite(b->mass) && isfinite(b->mass_std) && all_finite(b->cog, 3) && all_finite(b->cog_std, 3) &&
           all_finite(b->inertia_cog, 6) && all_finite(b->inertia_cog_std, 6) && all_finite(e->theta, IPE_NP) &&
           all_finite(&e->covariance[0][0], IPE_NP * IPE_NP) && isfinite(e->nis) &&
           all_finite(e->systematic, (size_t)e->n_systematic) && all_finite(e->systematic_std, (size_t)e->n_systematic);
}

/// Step until nothing is ready; the number of new estimates, each of them finite.
static int drain(ipe_pipeline_t* p)
{
    int n = 0;
    ipe_row_t row;
    ipe_estimate_t estimate;
    for (ipe_status_t s; (s = ipe_pipeline_step(p, &row, &estimate)) != IPE_NOT_READY;) {
        if (s != IPE_OK) { continue; }
        TEST_ASSERT_TRUE(is_finite(&estimate));
        TEST_ASSERT_EQUAL_MEMORY(&p->estimator.estimate, &estimate, sizeof estimate);
        ++n;
    }
    return n;
}

/// Everything of one sample, the position every 4 ms.
static void push_ideal(ipe_pipeline_t* p, const ideal_t* x, int k)
{
    const ipe_frame_t frames[] = {imu_a_of(x, k), imu_b_of(x, k), force_of(x, k)};
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_pipeline_push_frame(p, &frames[i])); }
    if (k % 4 == 0) { (void)ipe_pipeline_push_position(p, START + k * MS, x->position); }
}

static void push_sample(ipe_pipeline_t* p, int k)
{
    push_ideal(p, &sample[k], k);
}

static int run(ipe_pipeline_t* p, int first, int end)
{
    int n = 0;
    for (int k = first; k < end; ++k) {
        push_sample(p, k);
        n += drain(p);
    }
    ipe_pipeline_flush(p);
    return n + drain(p);
}

static uint64_t counter(const char* name)
{
    uint64_t value = 0;
    for (unsigned i = 0;; ++i) {
        const char* found = ipe_pipeline_counter(&pipeline, i, &value);
        TEST_ASSERT_NOT_NULL_MESSAGE(found, name);
        if (strcmp(found, name) == 0) { return value; }
    }
}

static void test_step_ideal_sensors_find_the_body(void)
{
    const int n = run(&pipeline, 0, N_SAMPLES);              // given, when: 20 s of an exact simulation

    const ipe_estimate_t* e = &pipeline.estimator.estimate;  // then
    const double cog[3] = {-0.001, -0.077, -0.118}, J[6] = {94.955, 88.859, 31.635, 4.136, -0.085, -0.393};
    TEST_ASSERT_GREATER_THAN_INT(180, n);
    TEST_ASSERT_DOUBLE_WITHIN(1e-5 * 161.058, 161.058, e->body.mass);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(50e-6, cog[i], e->body.cog[i]); }
    for (int i = 0; i < 6; ++i) { TEST_ASSERT_DOUBLE_WITHIN(0.05, J[i], e->body.inertia_cog[i]); }
    TEST_ASSERT_TRUE(e->consistent);
    TEST_ASSERT_TRUE(ipe_pipeline_invariants_hold(&pipeline));
}

static void test_step_slow_forces_and_position_still_find_the_body(void)
{
    for (int k = 0; k < N_SAMPLES; ++k) {  // given: forces at 100 Hz, position at 250 Hz
        const ipe_frame_t a = imu_a(k), b = imu_b(k), f = force(k);
        (void)ipe_pipeline_push_frame(&pipeline, &a);
        (void)ipe_pipeline_push_frame(&pipeline, &b);
        if (k % 10 == 3) { (void)ipe_pipeline_push_frame(&pipeline, &f); }
        if (k % 4 == 1) { (void)ipe_pipeline_push_position(&pipeline, START + k * MS, sample[k].position); }
        (void)drain(&pipeline);                               // when
    }
    const ipe_body_t* b = &pipeline.estimator.estimate.body;  // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-4 * 161.058, 161.058, b->mass);
    TEST_ASSERT_DOUBLE_WITHIN(0.2e-3, -0.077, b->cog[1]);
    TEST_ASSERT_DOUBLE_WITHIN(0.3, 94.955, b->inertia_cog[0]);
}

static void test_step_payload_picked_up_is_noticed_and_followed(void)
{
    double loaded[IPE_NP], load[IPE_NP] = {50.0};  // given: 50 kg more from 10 s on, at (0.2, 0.1, 0.3)
    const double at[3] = {0.2, 0.1, 0.3};
    ipe_body_shift(at, load, NULL);
    for (int i = 0; i < IPE_NP; ++i) { loaded[i] = truth[i] + load[i]; }
    for (int k = 0; k < 10000; ++k) {
        push_sample(&pipeline, k);
        (void)drain(&pipeline);
    }
    TEST_ASSERT_EQUAL_UINT64(0, pipeline.estimator.estimate.n_changes);
    for (int k = 10000; k < N_SAMPLES; ++k) {  // when
        const ideal_t x = ideal_at(&config, 1e-3 * k, loaded);
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
        if (k == 11000) { TEST_ASSERT_DOUBLE_WITHIN(5.0, 211.058, pipeline.estimator.estimate.body.mass); }  // then
    }
    TEST_ASSERT_TRUE(pipeline.estimator.estimate.n_changes > 0);
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 211.058, pipeline.estimator.estimate.body.mass);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, loaded[3] / loaded[0], pipeline.estimator.estimate.body.cog[2]);
}

/// 20 s; from `first` to `end` the sensor of cable 2 reads what `broken` makes of it. The mass at the end.
static double mass_with_broken_sensor(int first, int end, double (*broken)(double f, double f_first))
{
    for (int k = 0; k < N_SAMPLES; ++k) {
        ideal_t x = sample[k];
        for (int i = 0; i < 8; ++i) { x.f[i] += 0.5 * normal(&seed); }
        if (k >= first && k < end) { x.f[1] = broken(x.f[1], sample[first].f[1]); }
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
    }
    return pipeline.estimator.estimate.body.mass;
}

static double dead(double f, double f_first)
{
    (void)f, (void)f_first;
    return 0.0;
}

static double frozen(double f, double f_first)
{
    (void)f;
    return f_first;
}

static double saturated(double f, double f_first)
{
    return fmin(f, f_first);
}

static void assert_goes_on_without_a_sensor(double (*broken)(double f, double f_first))
{
    const double well = mass_with_broken_sensor(0, 0, broken), std_well = pipeline.estimator.estimate.body.mass_std;
    init(&pipeline);
    const double mass = mass_with_broken_sensor(6000, N_SAMPLES, broken);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3 * 161.058, 161.058, well);
    TEST_ASSERT_DOUBLE_WITHIN(2e-3 * 161.058, 161.058, mass);
    TEST_ASSERT_TRUE(pipeline.estimator.estimate.body.mass_std > std_well);
    TEST_ASSERT_EQUAL_UINT64(0, counter("detect.changes"));
    TEST_ASSERT_EQUAL_UINT64(0, counter("stuck.force.refused"));
    TEST_ASSERT_GREATER_THAN_UINT64(50, counter("rls.unknown_force"));
}

static void test_step_dead_force_sensor_is_done_without(void)
{
    assert_goes_on_without_a_sensor(dead);
}

static void test_step_frozen_force_sensor_is_done_without(void)
{
    assert_goes_on_without_a_sensor(frozen);
}

static void test_step_saturated_force_sensor_is_done_without(void)
{
    assert_goes_on_without_a_sensor(saturated);
}

static void test_step_force_sensor_that_is_well_again_is_used(void)
{
    (void)mass_with_broken_sensor(6000, 12000, dead);
    TEST_ASSERT_LESS_THAN_UINT64(67, counter("rls.unknown_force"));
    TEST_ASSERT_GREATER_THAN_UINT64(58, counter("rls.unknown_force"));
    TEST_ASSERT_EQUAL_UINT32(0, pipeline.stuck_sensor.unknown);
}

static void test_step_spikes_change_nothing_but_their_counters(void)
{
    for (int is_spiked = 0; is_spiked < 2; ++is_spiked) {
        static double mass[2], std;
        init(&pipeline);
        seed = 99;
        for (int k = 0; k < N_SAMPLES; ++k) {
            ideal_t x = sample[k];
            for (int i = 0; i < 8; ++i) { x.f[i] += 0.5 * normal(&seed); }
            if (is_spiked && k % 1700 == 1000) { x.f[k % 8] += 1500.0; }
            if (is_spiked && k % 1700 == 1200) { x.position[k % 3] += 8.0; }
            push_ideal(&pipeline, &x, k);
            (void)drain(&pipeline);
        }
        mass[is_spiked] = pipeline.estimator.estimate.body.mass;
        std = pipeline.estimator.estimate.body.mass_std;
        if (is_spiked) { TEST_ASSERT_DOUBLE_WITHIN(0.1 * std, mass[0], mass[1]); }
        TEST_ASSERT_EQUAL_UINT64(is_spiked ? 12 : 0, counter("align.force.spikes"));
        TEST_ASSERT_EQUAL_UINT64(is_spiked ? 12 : 0,
                                 counter("align.position.spikes") + counter("align.position.unreachable"));
        TEST_ASSERT_EQUAL_UINT64(0, counter("detect.changes") + counter("motion.position_refused"));
    }
}

static void test_step_window_that_stands_out_weighs_less(void)
{
    uint64_t n_weighted = 0;
    for (double push = 1.0; push < 1e3 && n_weighted == 0; push *= 1.15) {  // given: 30 ms of a push, ever stronger,
        init(&pipeline);
        seed = 77;
        for (int k = 0; k < N_SAMPLES; ++k) {
            ideal_t x = sample[k];
            for (int i = 0; i < 8; ++i) { x.f[i] += 0.5 * normal(&seed) + (k >= 15000 && k < 15030 ? push : 0.0); }
            if (k == 15000) {
                pipeline.estimator.change_detector.level = IPE_NY;
            }  // among restless windows: no suspicion
            push_ideal(&pipeline, &x, k);
            (void)drain(&pipeline);
        }
        n_weighted = counter("rls.weighted");  // when: until a window stands out
        TEST_ASSERT_EQUAL_UINT64(0, counter("detect.changes"));
    }
    const ipe_body_t* b = &pipeline.estimator.estimate.body;
    TEST_ASSERT_GREATER_THAN_UINT64(0, n_weighted);  // then
    TEST_ASSERT_LESS_THAN_UINT64(5, n_weighted);
    ASSERT_BELOW(1e-3 * 161.058, fabs(b->mass - 161.058));
}

static void test_step_window_that_stands_out_of_calm_ones_is_held(void)
{
    for (int k = 0; k < N_SAMPLES; ++k) {
        ideal_t x = sample[k];
        for (int i = 0; i < 8; ++i) { x.f[i] += 0.5 * normal(&seed) + (k >= 15000 && k < 15030 ? 100.0 : 0.0); }
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
    }
    TEST_ASSERT_GREATER_THAN_UINT64(0, counter("detect.held"));
    TEST_ASSERT_LESS_THAN_UINT64(20, counter("detect.held"));
    TEST_ASSERT_EQUAL_UINT64(0, counter("detect.changes"));
    ASSERT_BELOW(1e-3 * 161.058, fabs(pipeline.estimator.estimate.body.mass - 161.058));
}

/// The sample of the motion at k while somebody pushes the platform at its CoG: force [3], P axes, N.
static ideal_t pushed_at(int k, const double force[3])
{
    const double zero[3] = {0.0};
    double R[3][3], s[3], pushed[8], alone[8];
    ideal_t x = sample[k];
    mat3_from_quat(x.q, R);
    for (int i = 0; i < 3; ++i) { s[i] = -force[i] / truth[0]; }
    tensions(&config, x.position, R, s, zero, zero, truth, pushed);
    tensions(&config, x.position, R, zero, zero, zero, truth, alone);
    for (int i = 0; i < 8; ++i) { x.f[i] += pushed[i] - alone[i]; }
    return x;
}

/// Samples from first to end, pushed from t to t + duration [samples] by a half sine squared of this force.
static void run_pushed(int first, int end, int start, int duration, const double force[3])
{
    for (int k = first; k < end; ++k) {
        const bool is_pushed = k >= start && k < start + duration;
        const double share = is_pushed ? pow(sin(3.14159265358979 * (k - start) / duration), 2.0) : 0.0;
        const double now[3] = {share * force[0], share * force[1], share * force[2]};
        const ideal_t x = pushed_at(k, now);
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
    }
}

static void test_step_push_leaves_the_estimate_alone(void)
{
    const double force[3] = {60.0, -40.0, 20.0};
    run_pushed(0, N_SAMPLES, 12000, 1500, force);             // given, when: 1.5 s
    const ipe_body_t* b = &pipeline.estimator.estimate.body;  // then
    TEST_ASSERT_EQUAL_UINT64(0, counter("detect.changes") + counter("detect.misfit"));
    TEST_ASSERT_EQUAL_UINT64(1, counter("detect.rejected"));
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 161.058, b->mass);
    TEST_ASSERT_DOUBLE_WITHIN(0.3, 94.955, b->inertia_cog[0]);
}

static void test_step_force_that_stays_holds_and_marks_the_estimate_until_it_ends(void)
{
    const double force[3] = {60.0, -40.0, 20.0};
    run_pushed(0, 10000, 0, 0, force);
    const ipe_estimate_t before = pipeline.estimator.estimate;
    for (int k = 10000; k < 17000; ++k) {  // given: 7 s
        const ideal_t x = pushed_at(k, force);
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
    }
    const ipe_estimate_t held = pipeline.estimator.estimate;  // then
    TEST_ASSERT_FALSE(before.is_misfit);
    TEST_ASSERT_TRUE(held.is_misfit);
    TEST_ASSERT_GREATER_THAN_INT64(before.t_ns + 6000 * MS, held.t_ns);
    TEST_ASSERT_DOUBLE_WITHIN(0.05, before.body.mass, held.body.mass);
    TEST_ASSERT_TRUE(held.body.mass_std > 1.5 * before.body.mass_std);
    for (int k = 17000; k < N_SAMPLES; ++k) {
        push_sample(&pipeline, k);
        (void)drain(&pipeline);
    }
    TEST_ASSERT_FALSE(pipeline.estimator.estimate.is_misfit);
    TEST_ASSERT_EQUAL_UINT64(0, counter("detect.changes"));
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 161.058, pipeline.estimator.estimate.body.mass);
}

static void test_contest_ends_with_a_freeze_a_reset_and_a_restart(void)
{
    const double force[3] = {60.0, -40.0, 20.0};
    run_pushed(0, 11000, 10000, 2000, force);
    ipe_change_detector_t* d = &pipeline.estimator.change_detector;
    TEST_ASSERT_TRUE(ipe_change_detector_is_contested(d));                          // given
    init(&other);
    ipe_pipeline_continue(&other, &pipeline.estimator, pipeline.config.gyro_bias);  // when, then
    TEST_ASSERT_FALSE(ipe_change_detector_is_contested(&other.estimator.change_detector));
    ipe_pipeline_freeze(&pipeline, true);
    TEST_ASSERT_FALSE(ipe_change_detector_is_contested(d));
    ipe_pipeline_freeze(&pipeline, false);
    run_pushed(11000, 12000, 10000, 3000, force);
    TEST_ASSERT_TRUE(ipe_change_detector_is_contested(d));
    ipe_pipeline_reset(&pipeline);
    TEST_ASSERT_FALSE(ipe_change_detector_is_contested(d));
}

static void test_step_rest_does_not_wear_the_estimate(void)
{
    config.memory = 600.0;  // given: identified, and older data count less
    init(&pipeline);
    for (int k = 0; k < 10000; ++k) {
        push_sample(&pipeline, k);
        (void)drain(&pipeline);
    }
    const ipe_estimate_t before = pipeline.estimator.estimate;
    const ideal_t still = rest_at(&config, 10.0, truth);
    uint64_t excited = 0;
    const int pause = 200;                          // so that stopping is no jump within a window
    for (int k = 10000 + pause; k < 310000; ++k) {  // when: five minutes at rest with sensor noise
        ideal_t x = still;
        for (int i = 0; i < 3; ++i) { x.gyro[i] += 3e-3 * normal(&seed), x.acc[i] += 0.02 * normal(&seed); }
        for (int i = 0; i < 8; ++i) { x.f[i] += normal(&seed); }
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
        if (k == 13000) { excited = pipeline.estimator.n_excited; }
    }
    const ipe_body_t *a = &before.body, *b = &pipeline.estimator.estimate.body;  // then
    TEST_ASSERT_DOUBLE_WITHIN(0.1, a->mass, b->mass);
    for (int i = 0; i < 6; ++i) { TEST_ASSERT_DOUBLE_WITHIN(0.5, a->inertia_cog[i], b->inertia_cog[i]); }
    TEST_ASSERT_GREATER_THAN_UINT64(0, excited);
    TEST_ASSERT_UINT64_WITHIN(30, excited,
                              pipeline.estimator.n_excited);  // 3000 windows of rest, hardly one forgotten
}

static void test_step_payload_laid_on_at_rest_is_noticed_and_weighed(void)
{
    double loaded[IPE_NP], load[IPE_NP] = {30.0};  // given: identified, then 20 s of rest, of which the first are used
    const double on_top[3] = {0.1, 0.0, 0.3};
    ipe_body_shift(on_top, load, NULL);
    for (int i = 0; i < IPE_NP; ++i) { loaded[i] = truth[i] + load[i]; }
    uint64_t used = 0;
    for (int k = 10000; k < 50000; ++k) {
        if (k == 20000) { k += 200; }  // so that stopping is no jump within a window
        const bool is_loaded = k >= 40000;
        ideal_t x = k < 20000 ? sample[k] : rest_at(&config, 20.0, is_loaded ? loaded : truth);
        for (int i = 0; i < 3; ++i) { x.gyro[i] += 3e-3 * normal(&seed), x.acc[i] += 0.02 * normal(&seed); }
        for (int i = 0; i < 8; ++i) { x.f[i] += normal(&seed); }
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
        if (k == 30000) { used = counter("rls.updates"); }
        if (k == 39999) {
            TEST_ASSERT_EQUAL_UINT64(used, counter("rls.updates"));
            TEST_ASSERT_EQUAL_UINT64(0, counter("detect.changes"));
        }
    }  // when: 30 kg more for 10 s
    TEST_ASSERT_GREATER_THAN_UINT64(0, counter("detect.changes"));  // then
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 191.058, pipeline.estimator.estimate.body.mass);
    TEST_ASSERT_UINT64_WITHIN(15, used + 55, counter("rls.updates"));
}

static void test_freeze_keeps_the_estimate_until_it_is_lifted(void)
{
    (void)run(&pipeline, 0, 3000);  // given
    const ipe_estimate_t before = pipeline.estimator.estimate;
    ipe_pipeline_freeze(&pipeline, true);
    TEST_ASSERT_EQUAL_INT(0, run(&pipeline, 3000, 5000));  // when
    TEST_ASSERT_EQUAL_MEMORY(&before, &pipeline.estimator.estimate, sizeof before);
    TEST_ASSERT_EQUAL_UINT64(counter("window.windows") - counter("rls.updates"), counter("estimate.frozen"));
    TEST_ASSERT_GREATER_THAN_UINT64(15, counter("estimate.frozen"));
    ipe_pipeline_freeze(&pipeline, false);
    TEST_ASSERT_GREATER_THAN_INT(15, run(&pipeline, 5000, 7000));  // then: it goes on
}

static void test_reset_learns_again_from_the_prior(void)
{
    (void)run(&pipeline, 0, 6000);  // given: the clock settles in the first second
    const ipe_estimate_t first = pipeline.estimator.estimate;
    init(&other);
    ipe_pipeline_reset(&pipeline);  // when
    TEST_ASSERT_EQUAL_UINT64(0, pipeline.estimator.estimate.n_windows);
    TEST_ASSERT_EQUAL_MEMORY(&other.estimator.rls, &pipeline.estimator.rls, sizeof other.estimator.rls);
    TEST_ASSERT_EQUAL_MEMORY(&other.estimator.noise, &pipeline.estimator.noise, sizeof other.estimator.noise);
    (void)run(&pipeline, 6000, 11000);  // then: as sure as after the first five seconds
    TEST_ASSERT_UINT64_WITHIN(5, first.n_windows, pipeline.estimator.estimate.n_windows);
    TEST_ASSERT_DOUBLE_WITHIN(0.5 * first.body.mass_std, first.body.mass_std,
                              pipeline.estimator.estimate.body.mass_std);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 161.058, pipeline.estimator.estimate.body.mass);
}

static void test_continue_goes_on_where_the_other_stopped(void)
{
    (void)run(&pipeline, 0, 5000);  // given
    config.estimate_rate = 7.0;
    init(&other);
    ipe_pipeline_continue(&other, &pipeline.estimator, pipeline.config.gyro_bias);  // when
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.estimate, &other.estimator.estimate, sizeof other.estimator.estimate);
    (void)run(&other, 5000, 7000);                                                  // then: its clock settles first
    TEST_ASSERT_GREATER_THAN_UINT64(pipeline.estimator.estimate.n_windows, other.estimator.estimate.n_windows);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, pipeline.estimator.estimate.body.mass, other.estimator.estimate.body.mass);
}

static void check_same_learnt(const ipe_pipeline_t* a, const ipe_pipeline_t* b)
{
    TEST_ASSERT_EQUAL_MEMORY(&a->estimator.filter_states, &b->estimator.filter_states,
                             sizeof a->estimator.filter_states);
    TEST_ASSERT_EQUAL_MEMORY(&a->estimator.rls, &b->estimator.rls, sizeof a->estimator.rls);
    TEST_ASSERT_EQUAL_MEMORY(&a->estimator.noise, &b->estimator.noise, sizeof a->estimator.noise);
    TEST_ASSERT_EQUAL_MEMORY(&a->estimator.eiv_correction, &b->estimator.eiv_correction,
                             sizeof a->estimator.eiv_correction);
    TEST_ASSERT_EQUAL_MEMORY(&a->estimator.change_detector, &b->estimator.change_detector,
                             sizeof a->estimator.change_detector);
    TEST_ASSERT_EQUAL_MEMORY(&a->estimator.estimate, &b->estimator.estimate, sizeof a->estimator.estimate);
    TEST_ASSERT_EQUAL_MEMORY(a->config.gyro_bias, b->config.gyro_bias, sizeof a->config.gyro_bias);
    TEST_ASSERT_EQUAL_UINT64(a->estimator.n_excited, b->estimator.n_excited);
    TEST_ASSERT_EQUAL_UINT64(a->estimator.n_rows, b->estimator.n_rows);
    TEST_ASSERT_EQUAL_UINT64(a->estimator.n_refused, b->estimator.n_refused);
}

static void test_continue_takes_over_all_that_was_learnt(void)
{
    const double bias[3] = {3e-3, -2e-3, 1e-3};
    (void)run(&pipeline, 0, 5000);  // given: nothing is as at the start
    ipe_pipeline_set_gyro_bias(&pipeline, bias);
    pipeline.estimator.n_refused = 3;
    pipeline.estimator.n_excited = 4;
    pipeline.estimator.change_detector.n_changes = 2;
    init(&other);
    TEST_ASSERT_TRUE(memcmp(&pipeline.estimator.filter_states, &other.estimator.filter_states,
                            sizeof other.estimator.filter_states) != 0);
    TEST_ASSERT_TRUE(memcmp(&pipeline.estimator.noise, &other.estimator.noise, sizeof other.estimator.noise) != 0);
    TEST_ASSERT_TRUE(memcmp(&pipeline.estimator.eiv_correction, &other.estimator.eiv_correction,
                            sizeof other.estimator.eiv_correction) != 0);
    ipe_pipeline_continue(&other, &pipeline.estimator, pipeline.config.gyro_bias);  // when
    check_same_learnt(&pipeline, &other);                                           // then
}

static void test_gyro_bias_is_used_from_the_next_row_on(void)
{
    const double bias[3] = {0.3, -0.2, 0.1};
    (void)run(&pipeline, 0, 2000);       // given
    for (int k = 2000; k < 4000; ++k) {  // when: the gyro and the bias move together
        ideal_t x = sample[k];
        if (k == 2000) { ipe_pipeline_set_gyro_bias(&pipeline, bias); }
        for (int i = 0; i < 3; ++i) { x.gyro[i] += bias[i]; }
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
    }
    TEST_ASSERT_EQUAL_UINT64(0, counter("detect.held") + counter("detect.changes"));  // then: nothing is noticed
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 161.058, pipeline.estimator.estimate.body.mass);
}

static void test_step_same_input_gives_the_same_bytes(void)
{
    init(&other);                                                                                            // given
    (void)run(&pipeline, 0, 5000);                                                                           // when
    (void)run(&other, 0, 5000);
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.rls, &other.estimator.rls, sizeof pipeline.estimator.rls);  // then
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.estimate, &other.estimator.estimate,
                             sizeof pipeline.estimator.estimate);
}

/// One part; a new estimate is added to the sum of them all.
static ipe_status_t take_part(ipe_pipeline_t* p, double* sum)
{
    ipe_row_t row;
    ipe_estimate_t estimate;
    const ipe_status_t status = ipe_pipeline_step_part(p, &row, &estimate);
    for (int i = 0; i < IPE_NP && status == IPE_OK; ++i) {
        *sum = 0.9 * *sum + estimate.theta[i] + estimate.covariance[i][i];  // so that each bit of each estimate counts
    }
    return status;
}

static void test_step_in_parts_gives_the_same_bytes(void)
{
    double whole = 0.0, parts = 0.0;
    int n_unfinished = 0;
    config.memory = 60.0;             // given: the prior's rows come back
    init(&pipeline), init(&other);
    for (int k = 0; k < 8000; ++k) {  // when: one done at once, of the other two parts after each sample, as they come
        push_sample(&pipeline, k), push_sample(&other, k);
        while (take_part(&pipeline, &whole) != IPE_NOT_READY) {}
        for (int i = 0; i < 2; ++i) { n_unfinished += take_part(&other, &parts) == IPE_UNFINISHED; }
    }
    ipe_pipeline_flush(&pipeline), ipe_pipeline_flush(&other);
    while (take_part(&pipeline, &whole) != IPE_NOT_READY) {}
    while (take_part(&other, &parts) != IPE_NOT_READY) {}
    TEST_ASSERT_GREATER_THAN_UINT64(50, other.estimator.n_excited);  // then
    TEST_ASSERT_GREATER_THAN_INT(3 * (int)other.estimator.rls.n_updates, n_unfinished);
    TEST_ASSERT_EQUAL_MEMORY(&whole, &parts, sizeof whole);
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.rls, &other.estimator.rls, sizeof pipeline.estimator.rls);
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.estimate, &other.estimator.estimate,
                             sizeof pipeline.estimator.estimate);
}

static void test_freeze_and_reset_between_two_parts_let_the_row_finish(void)
{
    double sum = 0.0;
    ipe_row_t row;
    int k = 4000;
    (void)run(&pipeline, 0, k);  // given: a window has ended, its rows wait
    for (; pipeline.part != IPE_PART_UPDATE; ++k) {
        push_sample(&pipeline, k);
        (void)take_part(&pipeline, &sum);
    }
    other = pipeline;
    other.decode.config = &other.config;
    const uint64_t n_updates = pipeline.estimator.rls.n_updates;
    (void)ipe_pipeline_step(&pipeline, &row, NULL);
    ipe_pipeline_freeze(&other, true);                                       // when
    TEST_ASSERT_EQUAL_UINT64(n_updates + 1, other.estimator.rls.n_updates);  // then
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.estimate, &other.estimator.estimate, sizeof other.estimator.estimate);
    TEST_ASSERT_EQUAL_INT(IPE_PART_ROW, other.part);
    for (; pipeline.part != IPE_PART_UPDATE; ++k) {
        push_sample(&pipeline, k);
        (void)take_part(&pipeline, &sum);
    }
    ipe_pipeline_reset(&pipeline);                       // when
    TEST_ASSERT_EQUAL_INT(IPE_PART_ROW, pipeline.part);  // then: nothing of the window gets into the new filter
    TEST_ASSERT_EQUAL_UINT64(0, pipeline.estimator.rls.n_updates);
}

static void test_step_order_of_sensors_on_the_bus_changes_nothing(void)
{
    init(&other);                     // given: forces before and after the IMU
    (void)run(&pipeline, 0, 3000);
    for (int k = 0; k < 3000; ++k) {  // when
        const ipe_frame_t frames[] = {force(k), imu_a(k), imu_b(k)};
        if (k % 4 == 0) { (void)ipe_pipeline_push_position(&other, START + k * MS, sample[k].position); }
        for (int i = 0; i < 3; ++i) { (void)ipe_pipeline_push_frame(&other, &frames[i]); }
        (void)drain(&other);
    }
    ipe_pipeline_flush(&other);
    (void)drain(&other);
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.estimate, &other.estimator.estimate,
                             sizeof other.estimator.estimate);  // then
}

static void test_init_bad_configuration_is_refused_with_reason(void)
{
    config.n_cables = 17;                                                                                   // given
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_pipeline_init(&pipeline, &config, message, sizeof message));  // when
    TEST_ASSERT_EQUAL_STRING("n_cables = 17: allowed 1 .. 16 ", message);                                   // then
}

/// A frame as it may come from a broken device or bus; hits[] counts which cause it should be counted under.
enum { UNKNOWN, SHORT, REMOTE, ERROR, FAULTS };

static ipe_frame_t faulty_frame(int fault, int k)
{
    ipe_frame_t f = force(k);
    f.can_id = fault == UNKNOWN  ? 0x7FF
               : fault == REMOTE ? ID_FORCE | IPE_CAN_RTR
               : fault == ERROR  ? IPE_CAN_ERR | 4U
                                 : ID_FORCE;
    if (fault == SHORT) { f.length = 48; }
    return f;
}

static void test_push_faulty_frames_are_counted_and_change_nothing(void)
{
    uint64_t n[FAULTS] = {0};  // given
    init(&other);
    (void)run(&other, 0, 3000);
    for (int k = 0; k < 3000; ++k) {  // when
        for (int i = 0; i < 3; ++i) {
            const int fault = (int)(FAULTS * uniform(&seed));
            const ipe_frame_t bad = faulty_frame(fault, k);
            TEST_ASSERT_NOT_EQUAL(IPE_OK, ipe_pipeline_push_frame(&pipeline, &bad));
            ++n[fault];
        }
        push_sample(&pipeline, k);
        (void)drain(&pipeline);
    }
    ipe_pipeline_flush(&pipeline);
    (void)drain(&pipeline);
    TEST_ASSERT_EQUAL_MEMORY(&other.estimator.estimate, &pipeline.estimator.estimate,
                             sizeof other.estimator.estimate);  // then
    TEST_ASSERT_EQUAL_UINT64(n[UNKNOWN], counter("decode.unknown_id"));
    TEST_ASSERT_EQUAL_UINT64(n[SHORT], counter("decode.bad_length"));
    TEST_ASSERT_EQUAL_UINT64(n[REMOTE], counter("decode.remote"));
    TEST_ASSERT_EQUAL_UINT64(n[ERROR], counter("decode.error_frame"));
    TEST_ASSERT_EQUAL_UINT64(9000, counter("decode.decoded"));
    TEST_ASSERT_EQUAL_UINT64(18000, counter("decode.frames"));
}

static uint64_t of(const char* stage, const char* sensor, const char* cause)
{
    char name[64];
    (void)snprintf(name, sizeof name, "%s.%s.%s", stage, sensor, cause);
    return counter(name);
}

/// What goes into each stage comes out of it, is refused by a counted cause or still waits.
static void assert_counters_add_up(void)
{
    const ipe_align_t* a = &pipeline.align;
    const ipe_ring_t* imu = &a->ring[IPE_IMU];
    TEST_ASSERT_EQUAL_UINT64(counter("decode.frames"), counter("decode.decoded") + counter("decode.unknown_id") +
                                                           counter("decode.remote") + counter("decode.error_frame") +
                                                           counter("decode.bad_length"));
    static const char* const sensor[] = {"imu", "force"};
    for (int s = 0; s < 2; ++s) {
        TEST_ASSERT_EQUAL_UINT64(of("group", sensor[s], "complete"),
                                 of("stuck", sensor[s], "refused") + of("align", sensor[s], "not_finite") +
                                     (s == IPE_IMU ? counter("align.imu.bad_quaternion") : 0) +
                                     of("align", sensor[s], "samples") + of("align", sensor[s], "duplicate") +
                                     of("align", sensor[s], "backwards") + of("pace", sensor[s], "dropped") +
                                     (uint64_t)pipeline.sample_timing[s].n_waiting);
    }
    uint64_t n_frames = 0;
    for (int s = 0; s < 2; ++s) {
        n_frames += of("group", sensor[s], "used_frames") + of("group", sensor[s], "dropped_frames") +
                    of("group", sensor[s], "duplicate_frames") +
                    (pipeline.sample_assembler[s].is_open ? pipeline.sample_assembler[s].n_open_frames : 0);
    }
    TEST_ASSERT_EQUAL_UINT64(counter("decode.decoded"), n_frames);
    TEST_ASSERT_EQUAL_UINT64(counter("align.imu.samples"),
                             counter("align.rows") + counter("align.overrun") + imu->head - imu->cursor);
    TEST_ASSERT_EQUAL_UINT64(counter("align.rows"), counter("align.force.missing") + counter("align.force.late") +
                                                        counter("clock.unsettled") + counter("motion.no_position") +
                                                        counter("motion.unsettled") + counter("wrench.rows") +
                                                        counter("wrench.bad_geometry"));
    TEST_ASSERT_EQUAL_UINT64(counter("wrench.rows"), counter("window.rows") + counter("window.backwards"));
    TEST_ASSERT_TRUE(ipe_pipeline_invariants_hold(&pipeline));
}

static void test_step_lossy_bus_counters_add_up_and_estimate_stays_good(void)
{
    for (int k = 0; k < N_SAMPLES; ++k) {  // given: 1 % of frames lost, 1 % doubled, 1 % NaN
        const ipe_frame_t frames[] = {imu_a(k), imu_b(k), force(k)};
        for (int i = 0; i < 3; ++i) {
            const double fate = uniform(&seed);
            ipe_frame_t f = frames[i];
            if (fate < 0.01) { continue; }
            if (fate > 0.99) { memcpy(f.data, &(const double){NAN}, sizeof(double)); }
            (void)ipe_pipeline_push_frame(&pipeline, &f);
            if (fate > 0.98) { (void)ipe_pipeline_push_frame(&pipeline, &f); }
        }
        if (k % 4 == 0) { (void)ipe_pipeline_push_position(&pipeline, START + k * MS, sample[k].position); }
        (void)drain(&pipeline);                           // when
        if (k % 1000 == 0) { assert_counters_add_up(); }  // then
    }
    TEST_ASSERT_GREATER_THAN_UINT64(100, counter("group.imu.incomplete"));
    TEST_ASSERT_GREATER_THAN_UINT64(100, counter("decode.signal_not_finite"));
    TEST_ASSERT_DOUBLE_WITHIN(1e-3 * 161.058, 161.058, pipeline.estimator.estimate.body.mass);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 94.955, pipeline.estimator.estimate.body.inertia_cog[0]);
}

static void test_step_rows_of_a_clock_that_saw_late_stamps_only_are_not_used(void)
{
    for (int k = 0; k < 8000; ++k) {  // given: the IMU's first 0.9 s are stamped together, the forces are not
        ipe_frame_t frames[] = {imu_a(k), imu_b(k), force(k)};
        const int64_t late = k < 900 ? (900 - k) * MS : 0;
        frames[0].t_ns += late, frames[1].t_ns += late;
        for (int i = 0; i < 3; ++i) { (void)ipe_pipeline_push_frame(&pipeline, &frames[i]); }
        if (k % 4 == 0) { (void)ipe_pipeline_push_position(&pipeline, START + k * MS, sample[k].position); }
        (void)drain(&pipeline);  // when
    }
    const uint64_t unsettled = counter("clock.unsettled");
    TEST_ASSERT_TRUE(unsettled > 950 && unsettled < 1050);  // then: until a second after the burst
    TEST_ASSERT_EQUAL_UINT64(0, counter("clock.imu.steps"));
    TEST_ASSERT_DOUBLE_WITHIN(1e-4 * 161.058, 161.058, pipeline.estimator.estimate.body.mass);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, -0.077, pipeline.estimator.estimate.body.cog[1]);
    assert_counters_add_up();
}

static void test_step_random_bits_never_publish_nonfinite(void)
{
    for (int k = 0; k < 6000; ++k) {  // given: one frame in 20 holds random bits
        ipe_frame_t frames[] = {imu_a(k), imu_b(k), force(k)};
        for (int i = 0; i < 3; ++i) {
            if (uniform(&seed) < 0.05) {
                for (int b = 0; b < frames[i].length; ++b) { frames[i].data[b] = (uint8_t)(256.0 * uniform(&seed)); }
            }
            (void)ipe_pipeline_push_frame(&pipeline, &frames[i]);
        }
        const double p[3] = {sample[k].position[0], uniform(&seed) < 0.05 ? NAN : sample[k].position[1],
                             sample[k].position[2]};
        (void)ipe_pipeline_push_position(&pipeline, START + k * MS, p);
        (void)drain(&pipeline);  // when, then: see drain()
    }
    assert_counters_add_up();
    TEST_ASSERT_GREATER_THAN_UINT64(100, counter("align.position.not_finite"));
}

static void test_step_vanishing_mass_is_not_published(void)
{
    config.prior_theta[0] = 1e-300;  // given: a mass so small that h/m overflows
    config.prior_theta[1] = 10.0;
    config.prior_covariance[0][0] = 1e-290;
    memset(config.imu_position, 0, sizeof config.imu_position);
    init(&pipeline);
    TEST_ASSERT_EQUAL_INT(0, run(&pipeline, 0, 3000));  // when, then
    TEST_ASSERT_GREATER_THAN_UINT64(0, counter("estimate.refused"));
}

static void test_push_time_backwards_is_counted_and_changes_nothing(void)
{
    init(&other);                     // given: a log with a second of it pasted again
    (void)run(&other, 0, 3000);
    for (int k = 0; k < 3000; ++k) {  // when
        push_sample(&pipeline, k);
        (void)drain(&pipeline);
        if (k != 1999) { continue; }
        for (int again = 1500; again < 2000; ++again) {
            const ipe_frame_t f = force(again);
            TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME, ipe_pipeline_push_frame(&pipeline, &f));
            if (again % 4 != 0) { continue; }
            TEST_ASSERT_EQUAL_INT(IPE_ERR_TIME,
                                  ipe_pipeline_push_position(&pipeline, START + again * MS, sample[again].position));
        }
        (void)drain(&pipeline);
    }
    ipe_pipeline_flush(&pipeline);
    (void)drain(&pipeline);
    TEST_ASSERT_EQUAL_MEMORY(&other.estimator.estimate, &pipeline.estimator.estimate,
                             sizeof other.estimator.estimate);  // then
    TEST_ASSERT_EQUAL_UINT64(500, counter("align.force.backwards"));
    TEST_ASSERT_EQUAL_UINT64(125, counter("align.position.backwards") + counter("align.position.duplicate"));
}

static void test_step_without_forces_gives_rows_up_and_says_so(void)
{
    for (int k = 0; k < 1000; ++k) {  // given
        const ipe_frame_t a = imu_a(k), b = imu_b(k);
        (void)ipe_pipeline_push_frame(&pipeline, &a);
        (void)ipe_pipeline_push_frame(&pipeline, &b);
        (void)ipe_pipeline_push_position(&pipeline, START + k * MS, sample[k].position);
        TEST_ASSERT_EQUAL_INT(0, drain(&pipeline));  // when, then
    }
    TEST_ASSERT_EQUAL_UINT64(0, counter("wrench.rows"));
    TEST_ASSERT_EQUAL_UINT64(849, counter("align.force.late"));
    assert_counters_add_up();
}

static void test_flush_lets_the_last_rows_out(void)
{
    for (int k = 0; k <= 3001; ++k) {
        push_sample(&pipeline, k);
        (void)drain(&pipeline);
    }  // given
    const uint64_t before = counter("window.rows");
    ipe_pipeline_flush(&pipeline);                                    // when
    (void)drain(&pipeline);
    TEST_ASSERT_GREATER_THAN_UINT64(before, counter("window.rows"));  // then: up to the last position, at 3000 ms
    TEST_ASSERT_EQUAL_UINT64(3001, counter("clock.unsettled") + counter("window.rows"));
    TEST_ASSERT_EQUAL_UINT64(1, counter("align.position.late"));
}

static void test_counter_names_are_unique_and_end_with_null(void)
{
    uint64_t value = 7;                                                  // given
    unsigned n = 0;
    while (ipe_pipeline_counter(&pipeline, n, &value) != NULL) { ++n; }  // when
    TEST_ASSERT_GREATER_THAN_UINT(30, n);                                // then
    TEST_ASSERT_NULL(ipe_pipeline_counter(&pipeline, n + 1000, &value));
    for (unsigned i = 0; i < n; ++i) {
        const char* name = ipe_pipeline_counter(&pipeline, i, &value);
        TEST_ASSERT_NOT_NULL(strchr(name, '.'));
        for (unsigned j = 0; j < i; ++j) {
            TEST_ASSERT_NOT_EQUAL(0, strcmp(name, ipe_pipeline_counter(&pipeline, j, &value)));
        }
    }
}

static void test_invariants_broken_filter_is_noticed(void)
{
    (void)run(&pipeline, 0, 1000);                               // given
    TEST_ASSERT_TRUE(ipe_pipeline_invariants_hold(&pipeline));
    pipeline.estimator.rls.D[2] = -1.0;                          // when
    TEST_ASSERT_FALSE(ipe_pipeline_invariants_hold(&pipeline));  // then
}

// ---- announced payloads ---------------------------------------------------------------------------------------------

enum { LEARNT = 10000, ANNOUNCED = 11000, LOADED = 500, ENDED = 16000 };  // ms

static const double LOAD_AT[3] = {0.2, 0.1, 0.3};

static ipe_announcement_t announcement;

/// Numbers of a point mass at LOAD_AT with sigmas of 2 %, 1 cm and 0.1 kg m2.
static void announce_point(double mass, double number[IPE_ANNOUNCEMENT_NUMBERS])
{
    memset(number, 0, IPE_ANNOUNCEMENT_NUMBERS * sizeof number[0]);
    number[0] = mass, number[1] = 0.02 * fabs(mass);
    for (int i = 0; i < 3; ++i) { number[2 + i] = LOAD_AT[i], number[5 + i] = 0.01; }
    for (int i = 0; i < 6; ++i) { number[14 + i] = 0.1; }
}

static void expect_point(double mass)
{
    double number[IPE_ANNOUNCEMENT_NUMBERS];
    announce_point(mass, number);
    const ipe_status_t status =
        ipe_pipeline_expect(&pipeline, &announcement, number, START + ANNOUNCED * MS, message, sizeof message);
    TEST_ASSERT_EQUAL_INT_MESSAGE(IPE_OK, status, message);
}

/// Sample k with share times the mass at LOAD_AT.
static ideal_t loaded(int k, double share, double mass)
{
    double load[IPE_NP] = {share * mass};
    ipe_body_shift(LOAD_AT, load, NULL);
    for (int i = 0; i < IPE_NP; ++i) { load[i] += truth[i]; }
    return share > 0.0 ? ideal_at(&config, 1e-3 * k, load) : sample[k];
}

static double share_at(int k, int contact)
{
    return fmin(1.0, fmax(0.0, (double)(k - contact) / LOADED));
}

/// From sample `first` on, until `end`; `mass` is taken up at LOAD_AT within LOADED ms from sample `contact` on. The time in
/// ms at which the published mass is within 3 % of the true one and stays there.
static int carry(int first, int end, double mass, int contact)
{
    int right = end;
    for (int k = first; k < end; ++k) {
        const double share = share_at(k, contact), body = 161.058 + share * mass;
        const ideal_t x = loaded(k, share, mass);
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
        const bool is_right = fabs(pipeline.estimator.estimate.body.mass - body) < 0.03 * body;
        right = is_right ? (right == end ? k : right) : end;
    }
    return right;
}

static void test_expect_right_payload_is_followed_from_its_contact_on(void)
{
    (void)carry(0, LEARNT, 0.0, ENDED);  // given
    expect_point(50.0);
    (void)carry(LEARNT, ANNOUNCED, 0.0, ENDED);
    TEST_ASSERT_EQUAL_UINT64(0, pipeline.estimator.estimate.n_changes);

    const int right = carry(ANNOUNCED, ENDED, 50.0, ANNOUNCED);  // when

    const ipe_estimate_t* e = &pipeline.estimator.estimate;      // then
    TEST_ASSERT_LESS_THAN_INT(ANNOUNCED + LOADED + 100, right);
    TEST_ASSERT_EQUAL_UINT64(1, e->n_changes);
    TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_TAKEN, announcement.state);
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.taken"));
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 211.058, e->body.mass);
    for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_TRUE(e->observable[i]); }
    TEST_ASSERT_FALSE(e->is_provisional);
}

static void test_expect_load_that_is_set_down_is_followed(void)
{
    (void)carry(0, LEARNT, 0.0, ENDED);                          // given
    expect_point(-30.0);
    const int right = carry(LEARNT, ENDED, -30.0, ANNOUNCED);    // when
    TEST_ASSERT_LESS_THAN_INT(ANNOUNCED + LOADED + 100, right);  // then
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.taken"));
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 131.058, pipeline.estimator.estimate.body.mass);
}

/// The same payload without announcement: when is the mass right?
static int right_without_announcement(double mass, int contact)
{
    init(&pipeline);
    (void)carry(0, LEARNT, 0.0, ENDED);
    return carry(LEARNT, ENDED, mass, contact);
}

static void test_expect_wrong_by_a_factor_of_2_is_no_worse_than_none(void)
{
    const int without = right_without_announcement(50.0, ANNOUNCED);
    const double mass = pipeline.estimator.estimate.body.mass;
    for (int k = 0; k < 2; ++k) {
        init(&pipeline);  // given
        (void)carry(0, LEARNT, 0.0, ENDED);
        expect_point(k == 0 ? 100.0 : 25.0);
        const int with = carry(LEARNT, ENDED, 50.0, ANNOUNCED);  // when
        TEST_ASSERT_LESS_OR_EQUAL_INT(without, with);            // then
        TEST_ASSERT_EQUAL_UINT64(0, counter("expect.taken"));
        TEST_ASSERT_EQUAL_UINT64(1, counter("expect.other"));
        TEST_ASSERT_DOUBLE_WITHIN(0.1, mass, pipeline.estimator.estimate.body.mass);
    }
}

static void test_expect_payload_that_never_comes_changes_nothing(void)
{
    (void)carry(0, LEARNT, 0.0, ENDED);  // given
    expect_point(50.0);
    announcement.from_ns -= 27000 * MS;  // so that its 30 s end at 14 s
    (void)carry(LEARNT, ENDED - 2100, 0.0, ENDED);
    TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_WAITS, announcement.state);
    (void)carry(ENDED - 2100, ENDED, 0.0, ENDED);  // when
    const ipe_estimate_t with = pipeline.estimator.estimate;
    TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_MISSED, announcement.state);
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.missed"));
    TEST_ASSERT_TRUE(announcement.has_looked);
    TEST_ASSERT_NULL(pipeline.announcement);
    init(&pipeline);
    (void)carry(0, ENDED, 0.0, ENDED);
    TEST_ASSERT_EQUAL_MEMORY(&pipeline.estimator.estimate, &with, sizeof with);  // then
}

static void test_expect_payload_that_comes_late_is_followed(void)
{
    (void)carry(0, LEARNT, 0.0, ENDED);                                 // given
    expect_point(50.0);
    const int right = carry(LEARNT, ENDED, 50.0, ANNOUNCED + 2000);     // when
    TEST_ASSERT_LESS_THAN_INT(ANNOUNCED + 2000 + LOADED + 100, right);  // then
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.taken"));
}

/// What the daemon would publish of the present estimate, verdict good.
static ipe_gate_estimate_t gate_estimate(int64_t sequence)
{
    const ipe_estimate_t* e = &pipeline.estimator.estimate;
    ipe_gate_estimate_t g = {.sequence = sequence,
                             .t_ns = e->t_ns,
                             .n_changes = (int64_t)e->n_changes,
                             .verdict = e->is_provisional ? 2 : 1,
                             .is_provisional = e->is_provisional};
    memcpy(g.theta, e->theta, sizeof g.theta);
    memcpy(g.covariance, e->covariance, sizeof g.covariance);
    memcpy(g.observable, e->observable, sizeof g.observable);
    return g;
}

static void test_expect_push_of_the_same_weight_that_ends_leaves_the_body_before(void)
{
    enum { PUSH = 250 };  // ms
    ipe_parameter_gate_t gate;
    ipe_gate_parameters_t used;
    const ipe_gate_limits_t limits = ipe_parameter_gate_default();
    (void)carry(0, LEARNT, 0.0, ENDED);  // given
    TEST_ASSERT_EQUAL(IPE_OK, ipe_parameter_gate_init(&gate, &limits, truth));
    expect_point(50.0);
    const double std = pipeline.estimator.estimate.body.mass_std;
    double largest = 0.0;
    for (int k = LEARNT; k < ENDED; k += 20) {  // when: half of it, and gone again
        const bool is_pushed = k >= ANNOUNCED && k < ANNOUNCED + PUSH;
        (void)carry(k, k + 20, is_pushed ? 50.0 : 0.0, is_pushed ? ANNOUNCED : ENDED);
        const ipe_gate_estimate_t g = gate_estimate(k);
        (void)ipe_parameter_gate_offer(&gate, &g, START + k * MS);
        const ipe_estimate_t* e = &pipeline.estimator.estimate;
        largest = fmax(largest, e->body.mass);
        if (k < ANNOUNCED + PUSH + 150) { continue; }
        TEST_ASSERT_FALSE(e->is_provisional);  // then
        TEST_ASSERT_DOUBLE_WITHIN(0.01 * 161.058, 161.058, e->body.mass);
        TEST_ASSERT_TRUE(e->body.mass_std < 1.5 * std);
        if (k < ANNOUNCED + PUSH + 200) { continue; }
        ipe_parameter_gate_read(&gate, START + k * MS, &used);
        TEST_ASSERT_EQUAL_INT(IPE_GATE_LIVE, used.source);
        TEST_ASSERT_DOUBLE_WITHIN(0.01 * 161.058, 161.058, used.theta[0]);
    }
    TEST_ASSERT_TRUE(largest > 1.05 * 161.058);
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.failed"));
    TEST_ASSERT_EQUAL_UINT64(2, pipeline.estimator.estimate.n_changes);  // there and back
}

static void test_expect_contact_is_followed_though_rows_are_lost(void)
{
    (void)carry(0, LEARNT, 0.0, ENDED);  // given
    expect_point(50.0);
    int right = 0;
    for (int k = LEARNT; k < ENDED && right == 0; ++k) {
        const ideal_t x = loaded(k, share_at(k, ANNOUNCED), 50.0);
        if (k % 25 != 0) { push_ideal(&pipeline, &x, k); }  // when: no 40 ms are whole
        (void)drain(&pipeline);
        if (k > ANNOUNCED + LOADED && fabs(pipeline.estimator.estimate.body.mass - 211.058) < 6.0) { right = k; }
    }
    TEST_ASSERT_INT_WITHIN(100, ANNOUNCED + LOADED, right);  // then
}

static void test_expect_payload_is_followed_without_a_force_sensor(void)
{
    int right = 0;
    for (int k = 0; k < ANNOUNCED + 1000; ++k) {
        const double share = share_at(k, ANNOUNCED);
        ideal_t x = loaded(k, share, 50.0);
        if (k >= 6000) { x.f[1] = 0.0; }  // given
        if (k == LEARNT) { expect_point(50.0); }
        push_ideal(&pipeline, &x, k);     // when
        (void)drain(&pipeline);
        const bool is_right = fabs(pipeline.estimator.estimate.body.mass - 161.058 - share * 50.0) < 6.0;
        right = is_right && right > 0 ? right : is_right ? k : 0;
    }
    TEST_ASSERT_EQUAL_UINT32(2, pipeline.stuck_sensor.unknown);
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.taken"));  // then
    TEST_ASSERT_LESS_THAN_INT(ANNOUNCED + LOADED + 100, right);
}

static void test_expect_noise_of_the_regressor_is_corrected_as_far_as_theta_stays_known(void)
{
    const double step[IPE_NP] = {0.0};
    for (int k = 0; k < LEARNT; ++k) {  // given: a noisy IMU
        ideal_t x = sample[k];
        for (int i = 0; i < 3; ++i) { x.acc[i] += 0.05 * normal(&seed), x.gyro[i] += 0.005 * normal(&seed); }
        push_ideal(&pipeline, &x, k);
        (void)drain(&pipeline);
    }
    const ipe_estimator_t before = pipeline.estimator;
    const float* was = before.eiv_correction.sum;
    TEST_ASSERT_TRUE(was[0] > 0.0F && was[3] > 0.0F);
    for (int n_sigmas = 0; n_sigmas < 3; ++n_sigmas) {  // when: theta is loosened by as many of its sigmas
        double std[IPE_NP];
        for (int i = 0; i < IPE_NP; ++i) { std[i] = (i < 4 ? 0 : n_sigmas) * ipe_rls_std(&before.rls, i); }
        pipeline.estimator = before;
        ipe_estimator_move(&pipeline.estimator, &config, step, std);
        const float* is = pipeline.estimator.eiv_correction.sum;
        TEST_ASSERT_FLOAT_WITHIN(1e-6F * was[0], was[0], is[0]);  // then
        TEST_ASSERT_FLOAT_WITHIN(1e-3F * was[3], was[3] / (float)(1 + n_sigmas * n_sigmas), is[3]);
    }
    ipe_estimator_move(&pipeline.estimator, &config, step, NULL);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, pipeline.estimator.eiv_correction.sum[3]);
}

/// A contact that began at ANNOUNCED and is not over, 350 ms later.
static void begin_contact(void)
{
    (void)carry(0, LEARNT, 0.0, ENDED);
    expect_point(50.0);
    announcement.from_ns -= (announcement.from_ns - pipeline.window.origin_ns) % (10 * MS);  // windows end together
    (void)carry(LEARNT, ANNOUNCED + 350, 50.0, ANNOUNCED);
    TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_CONTACT, announcement.state);
    TEST_ASSERT_TRUE(pipeline.estimator.estimate.is_provisional);
}

static void assert_is_broken_off(void)
{
    TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_FAILED, announcement.state);
    TEST_ASSERT_NULL(pipeline.announcement);
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.failed"));
    TEST_ASSERT_FALSE(pipeline.estimator.estimate.is_provisional);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 161.058, pipeline.estimator.estimate.body.mass);
}

static void test_expect_contact_without_windows_ends_after_3_s(void)
{
    begin_contact();  // given
    for (int k = ANNOUNCED + 350; k < ANNOUNCED + 3150; ++k) {
        const ideal_t x = loaded(k, 0.7, 50.0);
        if (k % 40 < 20) { push_ideal(&pipeline, &x, k); }  // when: gaps of 20 ms
        (void)drain(&pipeline);
        if (k < ANNOUNCED + 3000) { TEST_ASSERT_NOT_NULL(pipeline.announcement); }
    }
    assert_is_broken_off();  // then
}

static void test_expect_load_that_never_rests_ends_the_contact_after_3_s(void)
{
    begin_contact();  // given
    for (int k = ANNOUNCED + 350; k < ANNOUNCED + 3150; ++k) {
        const ideal_t x = loaded(k, 0.7 + 0.3e-3 * (k - ANNOUNCED - 350), 50.0);
        push_ideal(&pipeline, &x, k);  // when
        (void)drain(&pipeline);
        if (k < ANNOUNCED + 3000) { TEST_ASSERT_NOT_NULL(pipeline.announcement); }
    }
    assert_is_broken_off();  // then
}

/// Windows that reached the filter or a contest.
static uint64_t n_reached(void)
{
    return pipeline.estimator.rls.n_updates + pipeline.estimator.change_detector.n_held;
}

static void test_expect_frozen_contact_is_not_followed_and_is_broken_off_after_3_s(void)
{
    begin_contact();  // given
    ipe_pipeline_freeze(&pipeline, true);
    const ipe_estimate_t frozen = pipeline.estimator.estimate;
    (void)carry(ANNOUNCED + 350, ANNOUNCED + 3500, 50.0, ANNOUNCED);  // when
    TEST_ASSERT_EQUAL_MEMORY(&frozen, &pipeline.estimator.estimate, sizeof frozen);
    TEST_ASSERT_GREATER_THAN_UINT64(25, pipeline.n_frozen);
    TEST_ASSERT_EQUAL_UINT64(0, counter("expect.failed"));
    ipe_pipeline_freeze(&pipeline, false);
    (void)carry(ANNOUNCED + 3500, ANNOUNCED + 3501, 50.0, ANNOUNCED);
    assert_is_broken_off();                                                          // then
    (void)carry(ANNOUNCED + 3501, ENDED, 50.0, ANNOUNCED);
    TEST_ASSERT_DOUBLE_WITHIN(2.0, 211.058, pipeline.estimator.estimate.body.mass);  // found by its windows
}

static void test_expect_contact_goes_on_after_a_gap(void)
{
    begin_contact();                                                  // given
    (void)carry(ANNOUNCED + 800, ANNOUNCED + 1500, 50.0, ANNOUNCED);  // when: 450 ms are lost
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.taken"));             // then
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 211.058, pipeline.estimator.estimate.body.mass);
}

enum { EARLY = 2000, EARLY_CONTACT = 2500 };  // ms: after 17 windows

/// An announcement that comes while the noise is not learnt.
static void expect_early(void)
{
    (void)carry(0, EARLY, 0.0, ENDED);
    TEST_ASSERT_FALSE(ipe_estimator_is_noise_learnt(&pipeline.estimator));
    expect_point(50.0);
    announcement.from_ns = START + EARLY_CONTACT * MS;
}

static void test_expect_before_the_first_estimate_is_not_looked_for(void)
{
    expect_point(50.0);                          // given
    announcement.from_ns = START + 200 * MS;
    (void)carry(0, 350, 0.0, ENDED);             // when
    TEST_ASSERT_FALSE(announcement.has_looked);  // then
    TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_WAITS, announcement.state);
}

static void test_expect_contact_before_the_noise_is_learnt_is_followed(void)
{
    expect_early();                                                  // given
    const int right = carry(EARLY, ENDED, 50.0, EARLY_CONTACT);      // when
    TEST_ASSERT_LESS_THAN_INT(EARLY_CONTACT + LOADED + 100, right);  // then
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.taken"));
    TEST_ASSERT_DOUBLE_WITHIN(0.5, 211.058, pipeline.estimator.estimate.body.mass);
}

static void test_expect_push_before_the_noise_is_learnt_leaves_the_body_before(void)
{
    enum { PUSH = 250 };  // ms
    expect_early();       // given
    (void)carry(EARLY, EARLY_CONTACT + PUSH, 50.0, EARLY_CONTACT);
    TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_CONTACT, announcement.state);
    (void)carry(EARLY_CONTACT + PUSH, ENDED, 0.0, ENDED);  // when: half of it, and gone again
    TEST_ASSERT_EQUAL_UINT64(1, counter("expect.failed"));
    TEST_ASSERT_DOUBLE_WITHIN(0.01 * 161.058, 161.058, pipeline.estimator.estimate.body.mass);  // then
}

static void test_expect_no_window_of_two_bodies_is_used_where_none_can_be_published(void)
{
    begin_contact();  // given
    other = pipeline;
    const ipe_announcement_t begun = announcement;
    for (int shift = 0; shift < 100; shift += 10) {  // at each phase of the windows of 0.4 s
        pipeline = other, announcement = begun;
        const int end = ANNOUNCED + 350 + shift;
        int left = ENDED;
        const uint64_t used = n_reached();
        for (int k = ANNOUNCED + 350; k < end + 400; ++k) {
            const ideal_t x = loaded(k, k < end ? 0.7 : 0.0, 50.0);
            push_ideal(&pipeline, &x, k);  // when
            pipeline.estimator.nis = NAN;
            (void)drain(&pipeline);
            if (pipeline.announcement == NULL && left == ENDED) { left = k; }
            if (k < left + 350) { TEST_ASSERT_EQUAL_UINT64(used, n_reached()); }  // then
        }
        TEST_ASSERT_EQUAL_INT(IPE_ANNOUNCEMENT_FAILED, announcement.state);
    }
}

static void test_expect_in_a_contact_is_refused_and_changes_nothing(void)
{
    double number[IPE_ANNOUNCEMENT_NUMBERS];
    begin_contact();  // given
    const ipe_announcement_t before = announcement;
    announce_point(20.0, number);
    const ipe_status_t status = ipe_pipeline_expect(&pipeline, &announcement, number, START + ENDED * MS, message,
                                                    sizeof message);  // when
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, status);                     // then
    TEST_ASSERT_EQUAL_STRING("the payload announced before is coming into contact", message);
    TEST_ASSERT_EQUAL_MEMORY(&before, &announcement, sizeof before);
}

static void test_expect_contact_is_broken_off_where_another_pipeline_goes_on(void)
{
    const double no_bias[3] = {0.0};
    begin_contact();  // given
    const uint64_t n_changes = pipeline.estimator.change_detector.n_changes;
    init(&other);
    ipe_pipeline_continue(&other, &pipeline.estimator, no_bias);  // when
    const ipe_estimate_t* e = &other.estimator.estimate;          // then
    TEST_ASSERT_FALSE(e->is_provisional);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, 161.058, e->body.mass);
    TEST_ASSERT_EQUAL_UINT64(n_changes + 1, e->n_changes);
}

static void test_reset_forgets_what_is_expected(void)
{
    expect_point(50.0);                       // given
    TEST_ASSERT_EQUAL_PTR(&announcement, pipeline.announcement);
    ipe_pipeline_reset(&pipeline);            // when
    TEST_ASSERT_NULL(pipeline.announcement);  // then
}

static void test_announcement_odd_numbers_are_refused_with_a_reason(void)
{
    const struct {
        int at;
        double value;
        const char* reason;
    } ODD[] = {{0, 0.0, "mass: must not be 0"},
               {0, NAN, "a number is not finite"},
               {1, -0.1, "a standard deviation is negative"},
               {6, -0.1, "a standard deviation is negative"},
               {19, -0.1, "a standard deviation is negative"},
               {1, 30.0, "mass_std: must be at most half of the mass"},
               {8, 5.0, "inertia_cog: no body has these moments"},
               {9, -1.0, "inertia_cog: no body has these moments"},
               {3, INFINITY, "a number is not finite"},
               {11, 0.5, "inertia_cog: no body has these moments"}};
    for (size_t i = 0; i < sizeof ODD / sizeof ODD[0]; ++i) {
        double number[IPE_ANNOUNCEMENT_NUMBERS];
        announce_point(50.0, number);  // given
        number[ODD[i].at] = ODD[i].value;
        const ipe_status_t status =
            ipe_announcement_init(&announcement, &config, number, START, 0.0, message, sizeof message);  // when
        TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, status);                                                    // then
        TEST_ASSERT_EQUAL_STRING(ODD[i].reason, message);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_step_ideal_sensors_find_the_body);
    RUN_TEST(test_step_slow_forces_and_position_still_find_the_body);
    RUN_TEST(test_step_payload_picked_up_is_noticed_and_followed);
    RUN_TEST(test_step_dead_force_sensor_is_done_without);
    RUN_TEST(test_step_frozen_force_sensor_is_done_without);
    RUN_TEST(test_step_saturated_force_sensor_is_done_without);
    RUN_TEST(test_step_force_sensor_that_is_well_again_is_used);
    RUN_TEST(test_step_spikes_change_nothing_but_their_counters);
    RUN_TEST(test_step_window_that_stands_out_weighs_less);
    RUN_TEST(test_step_window_that_stands_out_of_calm_ones_is_held);

    RUN_TEST(test_step_push_leaves_the_estimate_alone);
    RUN_TEST(test_step_force_that_stays_holds_and_marks_the_estimate_until_it_ends);
    RUN_TEST(test_contest_ends_with_a_freeze_a_reset_and_a_restart);
    RUN_TEST(test_step_rest_does_not_wear_the_estimate);
    RUN_TEST(test_step_payload_laid_on_at_rest_is_noticed_and_weighed);
    RUN_TEST(test_freeze_keeps_the_estimate_until_it_is_lifted);
    RUN_TEST(test_reset_learns_again_from_the_prior);
    RUN_TEST(test_continue_goes_on_where_the_other_stopped);
    RUN_TEST(test_continue_takes_over_all_that_was_learnt);
    RUN_TEST(test_gyro_bias_is_used_from_the_next_row_on);
    RUN_TEST(test_step_same_input_gives_the_same_bytes);
    RUN_TEST(test_step_in_parts_gives_the_same_bytes);
    RUN_TEST(test_freeze_and_reset_between_two_parts_let_the_row_finish);
    RUN_TEST(test_step_order_of_sensors_on_the_bus_changes_nothing);
    RUN_TEST(test_init_bad_configuration_is_refused_with_reason);
    RUN_TEST(test_push_faulty_frames_are_counted_and_change_nothing);
    RUN_TEST(test_step_lossy_bus_counters_add_up_and_estimate_stays_good);
    RUN_TEST(test_step_rows_of_a_clock_that_saw_late_stamps_only_are_not_used);
    RUN_TEST(test_step_random_bits_never_publish_nonfinite);
    RUN_TEST(test_step_vanishing_mass_is_not_published);
    RUN_TEST(test_push_time_backwards_is_counted_and_changes_nothing);
    RUN_TEST(test_step_without_forces_gives_rows_up_and_says_so);
    RUN_TEST(test_flush_lets_the_last_rows_out);
    RUN_TEST(test_counter_names_are_unique_and_end_with_null);
    RUN_TEST(test_invariants_broken_filter_is_noticed);
    RUN_TEST(test_expect_right_payload_is_followed_from_its_contact_on);
    RUN_TEST(test_expect_load_that_is_set_down_is_followed);
    RUN_TEST(test_expect_wrong_by_a_factor_of_2_is_no_worse_than_none);
    RUN_TEST(test_expect_payload_that_never_comes_changes_nothing);
    RUN_TEST(test_expect_payload_that_comes_late_is_followed);
    RUN_TEST(test_expect_push_of_the_same_weight_that_ends_leaves_the_body_before);
    RUN_TEST(test_expect_contact_is_followed_though_rows_are_lost);
    RUN_TEST(test_expect_payload_is_followed_without_a_force_sensor);
    RUN_TEST(test_expect_noise_of_the_regressor_is_corrected_as_far_as_theta_stays_known);
    RUN_TEST(test_expect_contact_without_windows_ends_after_3_s);
    RUN_TEST(test_expect_load_that_never_rests_ends_the_contact_after_3_s);
    RUN_TEST(test_expect_frozen_contact_is_not_followed_and_is_broken_off_after_3_s);
    RUN_TEST(test_expect_contact_goes_on_after_a_gap);
    RUN_TEST(test_expect_before_the_first_estimate_is_not_looked_for);
    RUN_TEST(test_expect_contact_before_the_noise_is_learnt_is_followed);
    RUN_TEST(test_expect_push_before_the_noise_is_learnt_leaves_the_body_before);
    RUN_TEST(test_expect_no_window_of_two_bodies_is_used_where_none_can_be_published);
    RUN_TEST(test_expect_in_a_contact_is_refused_and_changes_nothing);
    RUN_TEST(test_expect_contact_is_broken_off_where_another_pipeline_goes_on);
    RUN_TEST(test_reset_forgets_what_is_expected);
    RUN_TEST(test_announcement_odd_numbers_are_refused_with_a_reason);
    return UNITY_END();
}
