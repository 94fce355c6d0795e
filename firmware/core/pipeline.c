// SPDX-License-Identifier: Apache-2.0
#include "pipeline.h"

#include "cable_inertia.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

static_assert(sizeof(ipe_pipeline_t) <= IPE_STATE_MAX, "the state's budget in dims.h");

ipe_status_t ipe_pipeline_init(ipe_pipeline_t* p, const ipe_config_t* config, char* message, size_t size)
{
    const ipe_status_t status = ipe_config_check(config, message, size);
    if (status != IPE_OK) { return status; }
    memset(p, 0, sizeof *p);
    p->config = *config;
    ipe_decode_init(&p->decode, &p->config);
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        ipe_sample_assembler_init(&p->sample_assembler[s], (ipe_sensor_t)s, &p->config);
        ipe_clock_init(&p->clock[s], ipe_config_wrap(&p->config, IPE_Q_IMU_TIME + s), IPE_CLOCK_RATE_SPAN);
        ipe_sample_timing_init(&p->sample_timing[s]);
    }
    ipe_stuck_sensor_init(&p->stuck_sensor, &p->config);
    ipe_align_init(&p->align, &p->config);
    ipe_motion_init(&p->motion, &p->config);
    ipe_wrench_init(&p->wrench, &p->config);
    ipe_window_init(&p->window, &p->config);
    if (ipe_estimator_init(&p->estimator, &p->config) != IPE_OK) {
        (void)snprintf(message, size, "prior_covariance shifted to the IMU: must be positive definite");
        return IPE_ERR_CONFIG;
    }
    return IPE_OK;
}

/// Not used, but the sensor counted it: the timing of the samples after it must include it.
static ipe_status_t refuse(ipe_pipeline_t* p, ipe_sensor_t sensor, const ipe_reading_t* reading, ipe_status_t why)
{
    p->n_untimed[sensor] += reading->step;
    return why;
}

/// A sample without device time: its instant comes from the timing of those around it.
static ipe_status_t push_untimed(ipe_pipeline_t* p, ipe_sensor_t sensor, const ipe_reading_t* reading)
{
    int64_t t_ns[IPE_SAMPLE_TIMING_HOLD];
    const ipe_status_t status = ipe_align_hold(&p->align, sensor, reading->t_ns, reading->value);
    if (status != IPE_OK) { return refuse(p, sensor, reading, status); }
    const uint64_t step = reading->step > 0 ? reading->step + p->n_untimed[sensor] : 0;
    p->n_untimed[sensor] = 0;
    const int n = ipe_sample_timing_push(&p->sample_timing[sensor], &p->clock[sensor], reading->t_ns, step);
    for (int i = 0; i < n; ++i) {
        t_ns[i] = ipe_sample_timing_instant(&p->sample_timing[sensor], &p->clock[sensor], n - 1 - i);
    }
    if (n > 0) { ipe_align_settle(&p->align, sensor, n, t_ns); }
    return IPE_OK;
}

static ipe_status_t push_reading(ipe_pipeline_t* p, ipe_sensor_t sensor, const ipe_reading_t* reading)
{
    if (ipe_stuck_sensor_push(&p->stuck_sensor, sensor, reading->t_ns, reading->value)) {
        return refuse(p, sensor, reading, IPE_ERR_RANGE);
    }
    if (sensor == IPE_FORCE) { ipe_align_set_unknown_force(&p->align, p->stuck_sensor.unknown); }
    if (!reading->has_device_time) { return push_untimed(p, sensor, reading); }
    const int64_t t_ns = ipe_clock_map(&p->clock[sensor], reading->device_time, reading->t_ns);
    return ipe_align_push(&p->align, sensor, t_ns, reading->value);
}

static bool is_time(int64_t t_ns)
{
    return t_ns >= 0 && t_ns <= IPE_TIME_MAX_NS;
}

ipe_status_t ipe_pipeline_push_frame(ipe_pipeline_t* p, const ipe_frame_t* frame)
{
    ipe_sample_t sample;
    ipe_reading_t reading;
    if (!is_time(frame->t_ns)) { return IPE_ERR_TIME; }
    ipe_status_t status = ipe_decode_frame(&p->decode, frame, &sample);  // CAN frame -> values
    if (status != IPE_OK) { return status; }
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        // values -> whole sample
        if (ipe_sample_assembler_push(&p->sample_assembler[s], &sample, &reading) != IPE_OK) { continue; }
        const ipe_status_t pushed = push_reading(p, (ipe_sensor_t)s, &reading);  // device -> host time, ring
        if (pushed != IPE_OK) { status = pushed; }
    }
    return status;
}

ipe_status_t ipe_pipeline_push_position(ipe_pipeline_t* p, int64_t t_ns, const double position[3])
{
    if (!is_time(t_ns)) { return IPE_ERR_TIME; }
    if (ipe_stuck_sensor_push(&p->stuck_sensor, IPE_POSITION, t_ns, position)) { return IPE_ERR_RANGE; }
    return ipe_align_push(&p->align, IPE_POSITION, t_ns, position);
}

/// A clock that has seen few stamps may have seen late ones only: where it puts a sample of t_ns is not known yet.
static bool clocks_are_settled(const ipe_pipeline_t* p, int64_t t_ns)
{
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        const ipe_clock_t* c = &p->clock[s];
        const int64_t settled_ns = c->settled_ns - p->align.delay_ns[s];  // a stamp -> the measured instant
        if (c->is_started && (!c->is_settled || t_ns < settled_ns)) { return false; }
    }
    return true;
}

/// The next row, and its motion, as ipe_motion_push() returns them. A position that it lacks or that was refused is the
/// estimated one. IPE_UNFINISHED: a row without forces, which only the motion needs.
static ipe_status_t next_motion(ipe_pipeline_t* p, ipe_row_t* row, ipe_motion_t* motion)
{
    ipe_status_t status = ipe_align_pop(&p->align, row);  // samples -> row
    if (status != IPE_OK) { return status; }
    if (clocks_are_settled(p, row->t_ns)) {
        const uint64_t refused = p->motion.n_positions_refused;
        status = ipe_motion_push(&p->motion, row, motion);  // row -> motion of the platform
        row->has_position &= p->motion.n_positions_refused == refused;
    } else if (row->has_force) {
        ++p->n_unsettled;
        return IPE_ERR_TIME;
    }
    if (status == IPE_IGNORED || !row->has_force) { return IPE_UNFINISHED; }
    if (!row->has_position) { ipe_motion_target(&p->motion, row->position); }
    return status == IPE_NOT_READY ? IPE_IGNORED : status;
}

static void restart_windows(ipe_pipeline_t* p)
{
    ipe_window_restart(&p->window);
    ipe_estimator_restart_windows(&p->estimator);
}

/// Take the forces' estimated delay out of the rows to come.
static void undelay_forces(ipe_pipeline_t* p)
{
    ipe_align_set_force_delay(&p->align, p->estimator.force_delay);
    restart_windows(p);
}

static bool is_in_contact(const ipe_pipeline_t* p)
{
    return p->announcement != NULL && p->announcement->state == IPE_ANNOUNCEMENT_CONTACT;
}

/// The announced payload has come, or will not: the windows begin anew where those open are of two bodies.
static void end_announcement(ipe_pipeline_t* p)
{
    const ipe_announcement_t* a = p->announcement;
    if (a->state == IPE_ANNOUNCEMENT_WAITS || a->state == IPE_ANNOUNCEMENT_CONTACT) { return; }
    p->n_announced_taken += a->state == IPE_ANNOUNCEMENT_TAKEN;
    p->n_announced_other += a->state == IPE_ANNOUNCEMENT_OTHER;
    p->n_announced_failed += a->state == IPE_ANNOUNCEMENT_FAILED;
    p->n_announced_missed += a->state == IPE_ANNOUNCEMENT_MISSED;
    if (p->is_of_two_bodies) { restart_windows(p); }
    p->announcement = NULL;
}

/// An announced payload comes into contact, or did.
///
/// IPE_UNFINISHED: to be published; IPE_NOT_READY: no contact, a window that ended with this row is one body's; IPE_IGNORED: it
/// would be one of two.
static ipe_status_t follow_contact(ipe_pipeline_t* p, int64_t t_ns, const ipe_motion_t* motion,
                                   const ipe_wrench_t* wrench)
{
    const bool was_in_contact = is_in_contact(p);
    const ipe_status_t status = ipe_announcement_push(p->announcement, &p->estimator, &p->config, t_ns, motion, wrench);
    p->is_of_two_bodies = was_in_contact || is_in_contact(p);
    if (status == IPE_OK) {
        p->part = IPE_PART_CORRECT;
        p->is_contact = true;
        return IPE_UNFINISHED;
    }
    end_announcement(p);
    return p->is_of_two_bodies ? IPE_IGNORED : IPE_NOT_READY;
}

/// One row, up to the averages of the window that it ends.
static ipe_status_t take_row(ipe_pipeline_t* p, ipe_row_t* row)
{
    ipe_motion_t motion;
    ipe_wrench_t wrench;
    const uint64_t restarts = p->window.n_restarts;

    ipe_status_t status = next_motion(p, row, &motion);  // samples -> row, motion
    if (status != IPE_OK) { return status; }
    ipe_row_t undelayed = *row;
    ipe_align_undelay_forces(&p->align, undelayed.f);
    status = ipe_wrench_from_row(&p->wrench, &undelayed, &motion, &wrench);          // tensions -> cable wrench
    if (status != IPE_OK) { return status; }
    status = ipe_window_push(&p->window, row->t_ns, &motion, &wrench, &p->average);  // rows -> weak form
    p->estimator.n_rows += status >= IPE_OK;
    if (p->window.n_restarts != restarts) { ipe_estimator_restart_windows(&p->estimator); }
    if (status < IPE_OK) { return status; }
    if (p->announcement != NULL && !p->is_frozen) {
        const ipe_status_t followed = follow_contact(p, row->t_ns, &motion, &wrench);
        if (followed != IPE_NOT_READY) { return followed; }
    }
    if (status == IPE_NOT_READY) { return IPE_IGNORED; }
    p->part = IPE_PART_WINDOW;
    return IPE_UNFINISHED;
}

/// The window's equations; they wait for IPE_PART_UPDATE.
static ipe_status_t take_window(ipe_pipeline_t* p)
{
    ipe_average_t average = p->average;
    p->part = IPE_PART_ROW;
    ipe_status_t status = ipe_cable_inertia_add(&p->config, &average);  // the cables' own inertia
    if (status != IPE_OK) { return status; }
    if (p->is_frozen) {
        ++p->n_frozen;
        return IPE_IGNORED;
    }
    p->window_ns = average.t_ns;
    p->is_contact = false;
    ipe_estimator_predict(&p->estimator, &p->config, &average);                     // states -> now
    status = ipe_estimator_restore_forces(&p->estimator, &p->config, &average);     // of failed sensors
    if (status != IPE_OK) { return status; }
    status = ipe_estimator_begin(&p->estimator, &p->config, &average, &p->update);  // window -> equations
    if (status < IPE_OK) { return status; }
    if (status == IPE_NOT_READY) { return IPE_IGNORED; }
    p->part = status == IPE_UNFINISHED ? IPE_PART_UPDATE : IPE_PART_CORRECT;
    return IPE_UNFINISHED;
}

static void correct(ipe_pipeline_t* p)
{
    if (p->is_contact) {
        ipe_announcement_begin_publication(p->announcement, &p->estimator, &p->config, &p->publication);
    } else {
        ipe_estimator_begin_publication(&p->estimator, &p->config, p->window_ns, NULL, NULL, &p->publication);
    }
    p->part = IPE_PART_PUBLISH;
}

static ipe_status_t publish(ipe_pipeline_t* p)
{
    const ipe_status_t status = ipe_estimator_go_on_publication(&p->estimator, &p->config, &p->publication);
    if (status == IPE_UNFINISHED) { return status; }
    p->part = IPE_PART_ROW;
    if (p->is_contact) {
        end_announcement(p);
    } else if (ipe_estimator_move_force_delay(&p->estimator, &p->config)) {
        undelay_forces(p);  // states -> rows
    }
    return status;
}

/// The next part of what the last row has begun.
static ipe_status_t go_on(ipe_pipeline_t* p)
{
    if (p->part == IPE_PART_WINDOW) { return take_window(p); }
    if (p->part == IPE_PART_PUBLISH) { return publish(p); }  // theta, P -> body
    if (p->part == IPE_PART_CORRECT) {
        correct(p);
    } else if (ipe_estimator_go_on(&p->estimator, &p->config, &p->update) == IPE_OK) {  // equations -> theta, xi, P
        p->part = IPE_PART_CORRECT;
    }
    return IPE_UNFINISHED;
}

/// What changes the estimator from outside waits until the last row's work is done.
static void finish(ipe_pipeline_t* p)
{
    while (p->part != IPE_PART_ROW) { (void)go_on(p); }
}

ipe_status_t ipe_pipeline_step_part(ipe_pipeline_t* p, ipe_row_t* row, ipe_estimate_t* estimate)
{
    const ipe_status_t status = p->part == IPE_PART_ROW ? take_row(p, row) : go_on(p);
    if (status == IPE_OK && estimate != NULL) { *estimate = p->estimator.estimate; }
    return status;
}

ipe_status_t ipe_pipeline_step(ipe_pipeline_t* p, ipe_row_t* row, ipe_estimate_t* estimate)
{
    ipe_status_t status = ipe_pipeline_step_part(p, row, estimate);
    while (status == IPE_UNFINISHED) { status = ipe_pipeline_step_part(p, row, estimate); }
    return status;
}

void ipe_pipeline_flush(ipe_pipeline_t* p)
{
    p->align.is_ending = true;
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        ipe_sample_timing_end(&p->sample_timing[s]);
        ipe_align_settle(&p->align, (ipe_sensor_t)s, 0, NULL);
    }
}

void ipe_pipeline_freeze(ipe_pipeline_t* p, bool is_frozen)
{
    finish(p);
    p->is_frozen = is_frozen;
    ipe_estimator_restart_windows(&p->estimator);
}

void ipe_pipeline_reset(ipe_pipeline_t* p)
{
    finish(p);
    const bool had_delay = p->estimator.force_delay != 0.0;
    p->announcement = NULL;
    ipe_estimator_reset(&p->estimator, &p->config);
    if (had_delay) { undelay_forces(p); }
}

ipe_status_t ipe_pipeline_expect(ipe_pipeline_t* p, ipe_announcement_t* a, const double body[IPE_ANNOUNCEMENT_NUMBERS],
                                 int64_t from_ns, char* message, size_t size)
{
    finish(p);
    if (is_in_contact(p)) {
        (void)snprintf(message, size, "the payload announced before is coming into contact");
        return IPE_ERR_RANGE;
    }
    const ipe_status_t status = ipe_announcement_init(a, &p->config, body, from_ns, p->window.period, message, size);
    if (status == IPE_OK) { p->announcement = a; }
    return status;
}

void ipe_pipeline_set_gyro_bias(ipe_pipeline_t* p, const double bias[3])
{
    finish(p);
    memcpy(p->config.gyro_bias, bias, sizeof p->config.gyro_bias);
    ipe_motion_set_gyro_bias(&p->motion, bias);
    restart_windows(p);
}

void ipe_pipeline_continue(ipe_pipeline_t* p, const ipe_estimator_t* estimator, const double gyro_bias[3])
{
    finish(p);
    ipe_estimator_continue(&p->estimator, estimator);
    if (p->estimator.estimate.is_provisional) {  // nobody follows the contact any more: the body before again
        ++p->estimator.change_detector.n_changes;
        (void)ipe_estimator_publish(&p->estimator, &p->config, p->estimator.estimate.t_ns);
    }
    undelay_forces(p);
    ipe_pipeline_set_gyro_bias(p, gyro_bias);
}

bool ipe_pipeline_invariants_hold(const ipe_pipeline_t* p)
{
    const ipe_decode_t* d = &p->decode;
    const uint64_t frames = d->n_decoded + d->n_unknown + d->n_remote + d->n_error + d->n_bad_length;
    return d->n_frames == frames && p->window.first <= p->window.n_windows &&
           ipe_rls_invariants_hold(&p->estimator.rls);
}
