// SPDX-License-Identifier: Apache-2.0
/// A sensor that is constantly late by less than max_wait gives the rows and the estimate of one on time, at any rate.
#include "pipeline.h"

#include "robot.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define START 1760000000000000000LL  // ns, host time of the first sample
#define NS 1000000000LL

enum { SAMPLES_MAX = 12000 };

/// What happens in one run: rates, which sensor is late, by how much.
typedef struct {
    int imu_hz, position_hz;
    int64_t position_late_ns, force_late_ns;
} scene_t;

/// What came out of it.
typedef struct {
    int n_rows;
    uint64_t digest;  ///< of all rows, FNV-1a
    ipe_estimate_t estimate;
    ipe_lateness_t position, force;
    uint64_t n_carried;
} outcome_t;

static ipe_config_t config;
static ipe_pipeline_t pipeline;
static ideal_t sample[SAMPLES_MAX];
static double truth[IPE_NP];
static char message[256];

void setUp(void)
{
    config = cogiro();
    nominal_theta(truth);
    config.max_wait = 0.25;
    config.max_age[IPE_IMU] = config.max_age[IPE_FORCE] = 0.1;
    config.max_age[IPE_POSITION] = 0.25;
    config.max_carry = 2.0;
    config.window_length = 1.6;  // 40 samples at 25 Hz
}

void tearDown(void)
{
}

static ipe_frame_t frame_of(uint32_t can_id, int length, int64_t t_ns)
{
    ipe_frame_t f;
    memset(&f, 0, sizeof f);
    f.t_ns = START + t_ns;
    f.can_id = can_id;
    f.flags = IPE_FRAME_FD;
    f.length = (uint8_t)length;
    return f;
}

static void push_imu(const ideal_t* x, int k, int64_t t_ns)
{
    ipe_frame_t a = frame_of(ID_IMU_A, LENGTH_IMU_A, t_ns), b = frame_of(ID_IMU_B, LENGTH_IMU_B, t_ns);
    const uint16_t counter = (uint16_t)k;
    const uint32_t time_us = (uint32_t)(t_ns / 1000);
    memcpy(a.data, x->acc, 24);
    memcpy(a.data + 24, x->gyro, 24);
    memcpy(a.data + 48, &counter, 2);
    memcpy(a.data + 52, &time_us, 4);
    memcpy(b.data, x->q, 32);
    (void)ipe_pipeline_push_frame(&pipeline, &a);
    (void)ipe_pipeline_push_frame(&pipeline, &b);
}

/// Forces are stamped when they arrive; the configured delay takes that back to the measured instant.
static void push_force(const ideal_t* x, int64_t t_ns, int64_t late_ns)
{
    ipe_frame_t f = frame_of(ID_FORCE, LENGTH_FORCE, t_ns + late_ns);
    memcpy(f.data, x->f, 64);
    (void)ipe_pipeline_push_frame(&pipeline, &f);
}

static void drain(outcome_t* o)
{
    ipe_row_t row;
    for (ipe_status_t s; (s = ipe_pipeline_step(&pipeline, &row, NULL)) != IPE_NOT_READY;) {
        if (s < IPE_OK) { continue; }
        ++o->n_rows;
        const unsigned char* byte = (const unsigned char*)&row;
        for (size_t i = 0; i < sizeof row; ++i) { o->digest = (o->digest ^ byte[i]) * 1099511628211ULL; }
    }
}

/// Every sample in the order of arrival: IMU at its instant, the others late.
static outcome_t play(const scene_t* scene, int n)
{
    outcome_t o = {.digest = 14695981039346656037ULL};
    const int64_t dt = NS / scene->imu_hz, dp = NS / scene->position_hz;
    const int per_position = scene->imu_hz / scene->position_hz;
    config.sample_rate = scene->imu_hz;
    config.delay[IPE_FORCE] = 1e-9 * (double)scene->force_late_ns;
    TEST_ASSERT_EQUAL_INT_MESSAGE(IPE_OK, ipe_pipeline_init(&pipeline, &config, message, sizeof message), message);
    int next_force = 0, next_position = 0;
    for (int k = 0; k < n; ++k) {
        const int64_t now = k * dt;
        for (; next_position * dp + scene->position_late_ns <= now; ++next_position) {
            const double* p = sample[next_position * per_position].position;
            (void)ipe_pipeline_push_position(&pipeline, START + next_position * dp, p);
            drain(&o);
        }
        for (; next_force * dt + scene->force_late_ns <= now; ++next_force) {
            push_force(&sample[next_force], next_force * dt, scene->force_late_ns);
            drain(&o);
        }
        push_imu(&sample[k], k, now);
        drain(&o);
    }
    for (; next_force < n; ++next_force) { push_force(&sample[next_force], next_force * dt, scene->force_late_ns); }
    for (; next_position * per_position < n; ++next_position) {
        (void)ipe_pipeline_push_position(&pipeline, START + next_position * dp,
                                         sample[next_position * per_position].position);
    }
    drain(&o);
    ipe_pipeline_flush(&pipeline);
    drain(&o);
    o.estimate = pipeline.estimator.estimate;
    o.position = ipe_align_lateness(&pipeline.align, IPE_POSITION);
    o.force = ipe_align_lateness(&pipeline.align, IPE_FORCE);
    o.n_carried = pipeline.motion.n_carried;
    return o;
}

static void check_same(const outcome_t* on_time, const outcome_t* late, const char* name)
{
    TEST_ASSERT_EQUAL_INT_MESSAGE(on_time->n_rows, late->n_rows, name);
    TEST_ASSERT_EQUAL_UINT64_MESSAGE(on_time->digest, late->digest, name);
    TEST_ASSERT_EQUAL_UINT64_MESSAGE(on_time->estimate.n_windows, late->estimate.n_windows, name);
    for (int i = 0; i < IPE_NP; ++i) {
        const double theta = on_time->estimate.theta[i], std = sqrt(on_time->estimate.covariance[i][i]);
        TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(1e-9 * fabs(theta), theta, late->estimate.theta[i], name);
        TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(1e-9 * std, std, sqrt(late->estimate.covariance[i][i]), name);
    }
}

static const struct {
    int imu_hz, position_hz;
} RATE[] = {{25, 25}, {100, 25}, {250, 250}, {500, 25}, {1000, 250}, {1000, 1000}, {2000, 25}, {2000, 1000}};

static void check_rates(double max_wait, const double* share, int n_shares)
{
    config.max_wait = max_wait;
    for (size_t r = 0; r < sizeof RATE / sizeof RATE[0]; ++r) {
        const int hz = RATE[r].imu_hz, n = hz * 6 < 500 ? 500 : hz * 6;
        for (int k = 0; k < n; ++k) { sample[k] = ideal_at(&config, (double)k / hz, truth); }
        const scene_t prompt = {hz, RATE[r].position_hz, 0, 0};
        const outcome_t on_time = play(&prompt, n);
        TEST_ASSERT_GREATER_THAN_INT(n / 2, on_time.n_rows);
        TEST_ASSERT_GREATER_THAN_UINT64(0, on_time.estimate.n_windows);
        for (int i = 0; i < n_shares; ++i) {
            char name[120];
            const int64_t late_ns = (int64_t)(1e3 * share[i] * max_wait) * (NS / 1000);
            const scene_t position = {hz, RATE[r].position_hz, late_ns, 0},
                          force = {hz, RATE[r].position_hz, 0, late_ns};
            (void)snprintf(name, sizeof name, "IMU %d Hz, position %d Hz, late by %g s of %g s", hz,
                           RATE[r].position_hz, 1e-9 * (double)late_ns, max_wait);
            const outcome_t late = play(&position, n), late_force = play(&force, n);
            check_same(&on_time, &late, name);
            check_same(&on_time, &late_force, name);
            TEST_ASSERT_EQUAL_UINT64_MESSAGE(0, late.position.n_too_late + late_force.force.n_too_late, name);
            TEST_ASSERT_INT64_WITHIN_MESSAGE((uint64_t)(2 * NS / hz), late_ns, late.position.largest_ns, name);
            const int64_t held_ns = IPE_SAMPLE_TIMING_HOLD * NS / hz;  // until the timing of untimed samples is known
            TEST_ASSERT_TRUE_MESSAGE(late_force.force.largest_ns >= late_ns - NS / hz, name);
            TEST_ASSERT_TRUE_MESSAGE(late_force.force.largest_ns <= late_ns + held_ns, name);
            config.delay[IPE_FORCE] = 0.0;
            if (getenv("TABLE") != NULL) {
                (void)fprintf(stderr, "| %d | %d | %.3f | %d | %.12g | %.12g |\n", hz, RATE[r].position_hz,
                              1e-9 * (double)late_ns, late.n_rows, late.estimate.body.mass,
                              late_force.estimate.body.mass);
            }
        }
    }
}

static void test_late_by_less_than_max_wait_gives_the_same_rows_and_estimate(void)
{
    const double share[] = {0.04, 0.36, 0.48, 0.8, 0.996};
    check_rates(0.25, share, 5);
}

static void test_late_by_less_than_the_longest_max_wait_gives_the_same_rows_and_estimate(void)
{
    const double share[] = {0.5, 0.998};
    check_rates(0.5, share, 2);
}

static void test_later_than_max_wait_is_counted_with_its_lateness(void)
{
    const scene_t scene = {1000, 250, 400 * (NS / 1000), 0};
    for (int k = 0; k < 6000; ++k) { sample[k] = ideal_at(&config, 1e-3 * k, truth); }
    const outcome_t o = play(&scene, 6000);                        // given: 0.4 s late at a max_wait of 0.25 s; when
    TEST_ASSERT_GREATER_THAN_UINT64(1000, o.position.n_too_late);  // then: nothing is silent
    TEST_ASSERT_INT64_WITHIN(2 * NS / 1000, 400 * (NS / 1000), o.position.largest_ns);
    TEST_ASSERT_EQUAL_UINT64(0, o.force.n_too_late);
}

static void test_max_wait_beyond_the_buffers_is_refused_where_the_rate_is_known(void)
{
    config.sample_rate = 2000.0;
    config.max_wait = 0.5;
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_config_check(&config, message, sizeof message));
    config.max_wait = 0.51;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_config_check(&config, message, sizeof message));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(message, "max_wait"), message);
    config.sample_rate = 0.0;  // not known
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_config_check(&config, message, sizeof message));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_late_by_less_than_max_wait_gives_the_same_rows_and_estimate);
    RUN_TEST(test_late_by_less_than_the_longest_max_wait_gives_the_same_rows_and_estimate);
    RUN_TEST(test_later_than_max_wait_is_counted_with_its_lateness);
    RUN_TEST(test_max_wait_beyond_the_buffers_is_refused_where_the_rate_is_known);
    return UNITY_END();
}
