// SPDX-License-Identifier: Apache-2.0
#include "pipeline.h"

#include "consistency.h"
#include "regressor.h"
#include "smallmat.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

#define REST_NIS 50.0  // at rest only this is news: what is not followed wanders for many windows, a CUSUM would sum it
#define REST_WINDOWS 50            // more a pose has told what it can: the next would only be taken for new evidence
#define LEARNING_WINDOWS 50        // of the noise, before an innovation can be called too large
#define PRIOR_INTERVAL 50          // excited windows between two foldings of the prior
#define CHANGE_SHARE (1.0 / 12.0)  // of what the cables can lift: sigma of a new payload

static_assert(sizeof(ipe_pipeline_t) <= 512 * 1024, "the state's budget in firmware/DESIGN.md");

/// Inverse of the lower Cholesky factor of P [10][10], so that rows h = inverse, variance 1, are the prior again.
static bool prior_rows(const double P[IPE_NP][IPE_NP], double rows[IPE_NP][IPE_NP])
{
    double L[IPE_NP][IPE_NP];
    memcpy(L, P, sizeof L);
    if (!cholesky(&L[0][0], IPE_NP)) { return false; }
    memset(rows, 0, sizeof L);
    for (int j = 0; j < IPE_NP; ++j) {
        rows[j][j] = 1.0 / L[j][j];
        for (int i = j + 1; i < IPE_NP; ++i) {
            for (int k = j; k < i; ++k) { rows[i][j] -= L[i][k] * rows[k][j]; }
            rows[i][j] /= L[i][i];
        }
    }
    return true;
}

/// What a payload that the robot can carry adds to theta about the IMU, from the cables' strength and the platform's size.
static void change_std(const ipe_config_t* k, double std[IPE_NP])
{
    double strength = 0.0, size2 = 0.0;
    for (int i = 0; i < k->n_cables; ++i) {
        strength += k->cable[i].tension_max;
        size2 += vec3_dot(k->cable[i].attachment, k->cable[i].attachment) / k->n_cables;
    }
    const double mass = CHANGE_SHARE * strength / fmax(k->gravity, 1.0);
    for (int i = 0; i < IPE_NP; ++i) {
        std[i] = i == 0 ? mass : i < 4 ? mass * sqrt(size2) : i < 7 ? mass * size2 : mass * size2 / 3.0;
    }
}

/// The configured prior, about P there, about the IMU.
static void prior_at_imu(const ipe_config_t* k, double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    const double to_imu[3] = {-k->imu_position[0], -k->imu_position[1], -k->imu_position[2]};
    memcpy(theta, k->prior_theta, sizeof k->prior_theta);
    memcpy(P, k->prior_covariance, sizeof k->prior_covariance);
    ipe_body_shift(to_imu, theta, P);
}

/// States: theta about the IMU, then what filter_states.h has, all zero so far.
static ipe_status_t init_filter(ipe_pipeline_t* p)
{
    const ipe_config_t* k = &p->config;
    double theta[IPE_NP], P[IPE_NP][IPE_NP], std[IPE_NX_MAX - IPE_NP];
    prior_at_imu(k, theta, P);
    ipe_filter_states_init(&p->states);
    ipe_filter_states_std(k, std);
    ipe_change_detector_init(&p->detect);
    memset(&p->attenuation, 0, sizeof p->attenuation);
    if (ipe_noise_init(&p->noise, k->residual_covariance) != IPE_OK) { return IPE_ERR_CONFIG; }
    return ipe_rls_init(&p->rls, theta, P, ipe_filter_states_count(k->n_cables) - IPE_NP, std);
}

ipe_status_t ipe_pipeline_init(ipe_pipeline_t* p, const ipe_config_t* config, char* message, size_t size)
{
    const ipe_status_t status = ipe_config_check(config, message, size);
    if (status != IPE_OK) { return status; }
    memset(p, 0, sizeof *p);
    p->config = *config;
    ipe_decode_init(&p->decode, &p->config);
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        ipe_sample_assembler_init(&p->group[s], (ipe_sensor_t)s, &p->config);
        ipe_clock_init(&p->clock[s], ipe_config_wrap(&p->config, IPE_Q_IMU_TIME + s), IPE_CLOCK_RATE_SPAN);
        ipe_sample_timing_init(&p->pace[s]);
    }
    ipe_stuck_sensor_init(&p->stuck, &p->config);
    ipe_align_init(&p->align, &p->config);
    ipe_wrench_init(&p->wrench, &p->config);
    ipe_window_init(&p->window, &p->config);
    if (init_filter(p) != IPE_OK) {
        (void)snprintf(message, size, "prior_covariance shifted to the IMU: must be positive definite");
        return IPE_ERR_CONFIG;
    }
    return IPE_OK;
}

/// Not used, but the sensor counted it: the pace of what follows goes on past it.
static ipe_status_t refuse(ipe_pipeline_t* p, ipe_sensor_t sensor, const ipe_reading_t* reading, ipe_status_t why)
{
    p->n_unpaced[sensor] += reading->step;
    return why;
}

/// A sample without device time: its instant comes from the pace of those around it.
static ipe_status_t push_untimed(ipe_pipeline_t* p, ipe_sensor_t sensor, const ipe_reading_t* reading)
{
    int64_t t_ns[IPE_SAMPLE_TIMING_HOLD];
    const ipe_status_t status = ipe_align_hold(&p->align, sensor, reading->t_ns, reading->value);
    if (status != IPE_OK) { return refuse(p, sensor, reading, status); }
    const uint64_t step = reading->step > 0 ? reading->step + p->n_unpaced[sensor] : 0;
    p->n_unpaced[sensor] = 0;
    const int n = ipe_sample_timing_push(&p->pace[sensor], &p->clock[sensor], reading->t_ns, step);
    for (int i = 0; i < n; ++i) { t_ns[i] = ipe_sample_timing_instant(&p->pace[sensor], &p->clock[sensor], n - 1 - i); }
    if (n > 0) { ipe_align_settle(&p->align, sensor, n, t_ns); }
    return IPE_OK;
}

static ipe_status_t push_reading(ipe_pipeline_t* p, ipe_sensor_t sensor, const ipe_reading_t* reading)
{
    if (ipe_stuck_sensor_push(&p->stuck, sensor, reading->t_ns, reading->value)) {
        return refuse(p, sensor, reading, IPE_ERR_RANGE);
    }
    if (!reading->has_device_time) { return push_untimed(p, sensor, reading); }
    const int64_t t_ns = ipe_clock_map(&p->clock[sensor], reading->device_time, reading->t_ns);
    return ipe_align_push(&p->align, sensor, t_ns, reading->value);
}

ipe_status_t ipe_pipeline_push_frame(ipe_pipeline_t* p, const ipe_frame_t* frame)
{
    ipe_sample_t sample;
    ipe_reading_t reading;
    ipe_status_t status = ipe_decode_frame(&p->decode, frame, &sample);  // CAN frame -> values
    if (status != IPE_OK) { return status; }
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        if (ipe_sample_assembler_push(&p->group[s], &sample, &reading) != IPE_OK) {
            continue;
        }                                                                        // values -> whole sample
        const ipe_status_t pushed = push_reading(p, (ipe_sensor_t)s, &reading);  // device -> host time, ring
        if (pushed != IPE_OK) { status = pushed; }
    }
    return status;
}

ipe_status_t ipe_pipeline_push_position(ipe_pipeline_t* p, int64_t t_ns, const double position[3])
{
    if (ipe_stuck_sensor_push(&p->stuck, IPE_POSITION, t_ns, position)) { return IPE_ERR_RANGE; }
    return ipe_align_push(&p->align, IPE_POSITION, t_ns, position);
}

/// Use, hold back or take as a change of payload. Until the noise is known nothing can be told from it.
static ipe_change_detector_verdict_t judge(ipe_pipeline_t* p, double nis)
{
    return p->noise.n_summed < LEARNING_WINDOWS ? IPE_CHANGE_DETECTOR_USE : ipe_change_detector_push(&p->detect, nis);
}

/// Equations of one window in the filter's states, and those states at its time.
static ipe_status_t build_equations(ipe_pipeline_t* p, const ipe_average_t* average, double* H)
{
    double Y[IPE_NY][IPE_NP], X[IPE_NY][IPE_XI_MAX];
    ipe_regressor(average->s, average->ww, average->alpha, Y);
    if (ipe_systematic_columns(&p->config, average, p->rls.x, X) != IPE_OK) { return IPE_ERR_GEOMETRY; }
    ipe_filter_states_rows(&p->states, &p->config, Y, X, H);
    ipe_filter_states_advance(&p->states, &p->config, average->t_ns, &p->rls);
    return IPE_OK;
}

/// A new payload: theta may be anything the robot can carry; what is known of the sensors stays. Rest tells anew.
static void loosen_theta(ipe_pipeline_t* p)
{
    double std[IPE_NP];
    change_std(&p->config, std);
    for (int i = 0; i < IPE_NP; ++i) { ipe_rls_loosen(&p->rls, i, std[i] * std[i]); }
    memset(&p->attenuation, 0, sizeof p->attenuation);
    ipe_noise_restart(&p->noise);
    ipe_pose_dwell_restart(&p->still);
}

/// Fold the prior in again with the weight that forgetting took from it, so that P never exceeds it.
static void fold_prior(ipe_pipeline_t* p, double weight)
{
    double row[IPE_NX_MAX], std[IPE_NX_MAX - IPE_NP], theta[IPE_NP], P[IPE_NP][IPE_NP], rows[IPE_NP][IPE_NP];
    prior_at_imu(&p->config, theta, P);
    if (!prior_rows(P, rows)) { return; }
    ipe_filter_states_std(&p->config, std);
    for (int i = 0; i < p->rls.n; ++i) {
        double y = 0.0;
        memset(row, 0, sizeof row);
        if (i < IPE_NP) {
            for (int j = 0; j <= i; ++j) {
                row[j] = weight * rows[i][j];
                y += row[j] * theta[j];
            }
        } else {
            row[i] = weight / std[i - IPE_NP];
        }
        ipe_rls_update_row(&p->rls, row, y);
    }
}

/// Forgetting, in excited windows only: at rest nothing is learnt that could replace what is forgotten.
static void forget(ipe_pipeline_t* p, double hop)
{
    if (p->config.memory == 0.0) { return; }
    const double lambda = exp(-hop / p->config.memory);
    ipe_rls_forget(&p->rls, lambda);
    ipe_eiv_correction_forget(&p->attenuation, lambda);
    if (++p->n_excited % PRIOR_INTERVAL == 0) { fold_prior(p, sqrt(1.0 - pow(lambda, PRIOR_INTERVAL))); }
}

static void read_systematic(const ipe_pipeline_t* p, ipe_estimate_t* e)
{
    e->n_systematic = ipe_systematic_filter_count(p->config.n_cables);
    for (int i = 0; i < e->n_systematic; ++i) {
        e->systematic[i] = p->rls.x[IPE_NP + i];
        e->systematic_std[i] = ipe_rls_std(&p->rls, IPE_NP + i);
    }
}

/// Where the attachments really are is known to std_geometry: their common part moves the CoG as it is measured from P.
static void add_geometry(const ipe_pipeline_t* p, ipe_estimate_t* e)
{
    const double std = e->theta[0] * p->config.std_geometry;
    for (int i = 1; i < 4; ++i) { e->covariance[i][i] += std * std / p->config.n_cables; }
}

static void judge_observability(const ipe_config_t* config, ipe_estimate_t* e)
{
    ipe_body_t prior = {.mass = 0.0};
    (void)ipe_body_from_theta(config->prior_theta, config->prior_covariance, &prior);
    e->observable[0] = 2.0 * e->body.mass_std <= prior.mass_std;
    for (int i = 0; i < 3; ++i) { e->observable[1 + i] = 2.0 * e->body.cog_std[i] <= prior.cog_std[i]; }
    for (int i = 0; i < 6; ++i) { e->observable[4 + i] = 2.0 * e->body.inertia_cog_std[i] <= prior.inertia_cog_std[i]; }
}

/// What noise in the regressors made of theta and P, about the IMU, taken out.
static void undo_attenuation(const ipe_pipeline_t* p, double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    double C[IPE_NP][IPE_NP] = {{0.0}}, prior_theta[IPE_NP], prior[IPE_NP][IPE_NP];
    prior_at_imu(&p->config, prior_theta, prior);
    ipe_eiv_correction_information(&p->attenuation, p->noise.L, ipe_noise_level(&p->noise), C);
    ipe_eiv_correction_undo((const double (*)[IPE_NP])C, prior_theta, (const double (*)[IPE_NP])prior, theta, P);
}

/// The estimate about P from the filter's state about the IMU. False, estimate untouched, if it is no number or no body.
static bool make_estimate(const ipe_pipeline_t* p, const ipe_average_t* average, double nis, ipe_estimate_t* estimate)
{
    double theta[IPE_NP];
    ipe_estimate_t e = {.t_ns = average->t_ns,
                        .n_windows = p->rls.n_updates,
                        .n_rows = p->n_rows,
                        .nis = nis,
                        .n_changes = p->detect.n_changes};
    memcpy(theta, p->rls.x, sizeof theta);
    ipe_rls_covariance(&p->rls, IPE_NP, &e.covariance[0][0]);
    undo_attenuation(p, theta, e.covariance);
    ipe_body_shift(p->config.imu_position, theta, e.covariance);
    e.consistent = ipe_consistency_check(theta);
    if (!ipe_consistency_project(theta, e.covariance, e.theta, &e.distance)) { return false; }
    add_geometry(p, &e);
    if (ipe_body_from_theta(e.theta, e.covariance, &e.body) != IPE_OK) { return false; }
    if (!all_finite(e.theta, IPE_NP) || !all_finite(&e.covariance[0][0], IPE_NP * IPE_NP) || !isfinite(nis)) {
        return false;
    }
    if (!all_finite(&e.body.mass, sizeof e.body / sizeof(double))) { return false; }
    judge_observability(&p->config, &e);
    read_systematic(p, &e);
    *estimate = e;
    return true;
}

/// One window's equations into the filter. IPE_NOT_READY: held back as an outlier.
static ipe_status_t update_filter(ipe_pipeline_t* p, const ipe_average_t* average, double* nis)
{
    double H[IPE_NY * IPE_NX_MAX], innovation[IPE_NY], S[IPE_NY][IPE_NY], unused;
    const int n_rest = ipe_pose_dwell_push(&p->still, &p->config, average);
    ipe_status_t status = build_equations(p, average, H);  // averages -> rows of the states
    if (status != IPE_OK) { return status; }
    ipe_rls_innovation(&p->rls, H, average->y, innovation, S);
    *nis = ipe_change_detector_nis(innovation, S, p->noise.L);
    if (n_rest > REST_WINDOWS && !(*nis > REST_NIS)) { return IPE_OK; }
    const ipe_change_detector_verdict_t verdict = judge(p, *nis);  // innovation -> same payload?
    if (verdict == IPE_CHANGE_DETECTOR_HOLD) { return IPE_NOT_READY; }
    if (verdict == IPE_CHANGE_DETECTOR_CHANGE) { loosen_theta(p); }
    if (n_rest == 0) { forget(p, 0.25 * average->length); }
    ipe_filter_states_denoise_gain_columns(&p->config, average->f, innovation, S, p->noise.L, H);
    status = ipe_rls_update(&p->rls, H, average->y, p->noise.L, &unused);  // rows -> states, P
    if (status != IPE_OK) { return status; }
    ipe_eiv_correction_add(&p->attenuation, average, ipe_noise_level(&p->noise));
    if (verdict == IPE_CHANGE_DETECTOR_USE) { ipe_noise_push(&p->noise, innovation, S); }
    return IPE_OK;
}

/// A clock that has seen few stamps may have seen late ones only: where it puts a sample of t_ns is not known yet.
static bool clocks_are_settled(const ipe_pipeline_t* p, int64_t t_ns)
{
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        const ipe_clock_t* c = &p->clock[s];
        if (c->is_started && (!c->is_settled || t_ns < c->settled_ns)) { return false; }
    }
    return true;
}

ipe_status_t ipe_pipeline_step(ipe_pipeline_t* p, ipe_row_t* row, ipe_estimate_t* estimate)
{
    ipe_motion_t motion;
    ipe_wrench_t wrench;
    ipe_average_t average;
    double nis;
    const uint64_t restarts = p->window.n_restarts;

    ipe_status_t status = ipe_align_pop(&p->align, row);  // samples -> row
    if (status != IPE_OK) { return status; }
    if (!clocks_are_settled(p, row->t_ns)) {
        ++p->n_unsettled;
        return IPE_ERR_TIME;
    }
    status = ipe_wrench_from_row(&p->wrench, row, &motion, &wrench);              // row -> motion, cable wrench
    if (status != IPE_OK) { return status; }
    status = ipe_window_push(&p->window, row->t_ns, &motion, &wrench, &average);  // rows -> weak form
    p->n_rows += status >= IPE_OK;
    if (p->window.n_restarts != restarts) { ipe_noise_restart(&p->noise); }
    if (status != IPE_OK) { return status == IPE_NOT_READY ? IPE_IGNORED : status; }
    if (p->is_frozen) {
        ++p->n_frozen;
        return IPE_IGNORED;
    }
    status = update_filter(p, &average, &nis);             // equations -> theta, xi, P
    if (status != IPE_OK) { return status == IPE_NOT_READY ? IPE_IGNORED : status; }
    if (!make_estimate(p, &average, nis, &p->estimate)) {  // theta -> body, consistency
        ++p->n_refused;
        return IPE_ERR_NONFINITE;
    }
    if (estimate != NULL) { *estimate = p->estimate; }
    return IPE_OK;
}

void ipe_pipeline_flush(ipe_pipeline_t* p)
{
    p->align.is_ending = true;
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        ipe_sample_timing_end(&p->pace[s]);
        ipe_align_settle(&p->align, (ipe_sensor_t)s, 0, NULL);
    }
}

void ipe_pipeline_freeze(ipe_pipeline_t* p, bool is_frozen)
{
    p->is_frozen = is_frozen;
    ipe_noise_restart(&p->noise);
}

void ipe_pipeline_reset(ipe_pipeline_t* p)
{
    (void)init_filter(p);  // cannot fail: it did not with the same configuration
    memset(&p->estimate, 0, sizeof p->estimate);
    p->n_excited = 0;
    ipe_pose_dwell_restart(&p->still);
}

void ipe_pipeline_set_gyro_bias(ipe_pipeline_t* p, const double bias[3])
{
    memcpy(p->config.gyro_bias, bias, sizeof p->config.gyro_bias);
    ipe_window_restart(&p->window);
    ipe_noise_restart(&p->noise);
}

void ipe_pipeline_learnt(const ipe_pipeline_t* p, ipe_learnt_t* learnt)
{
    memset(learnt, 0, sizeof *learnt);
    learnt->states = p->states;
    learnt->rls = p->rls;
    learnt->noise = p->noise;
    learnt->attenuation = p->attenuation;
    learnt->detect = p->detect;
    memcpy(learnt->gyro_bias, p->config.gyro_bias, sizeof learnt->gyro_bias);
    learnt->n_excited = p->n_excited;
    learnt->n_rows = p->n_rows;
    learnt->n_refused = p->n_refused;
    learnt->estimate = p->estimate;
}

void ipe_pipeline_continue(ipe_pipeline_t* p, const ipe_learnt_t* learnt)
{
    p->states = learnt->states;
    p->rls = learnt->rls;
    p->noise = learnt->noise;
    p->attenuation = learnt->attenuation;
    p->detect = learnt->detect;
    p->detect.n_outstanding = 0;
    ipe_pipeline_set_gyro_bias(p, learnt->gyro_bias);
    p->n_excited = learnt->n_excited;
    p->n_rows = learnt->n_rows;
    p->n_refused = learnt->n_refused;
    p->estimate = learnt->estimate;
}

const char* ipe_pipeline_counter(const ipe_pipeline_t* p, unsigned index, uint64_t* value)
{
    const struct {
        const char* name;
        uint64_t value;
    } counter[] = {
        {"decode.frames", p->decode.n_frames},
        {"decode.decoded", p->decode.n_decoded},
        {"decode.unknown_id", p->decode.n_unknown},
        {"decode.remote", p->decode.n_remote},
        {"decode.error_frame", p->decode.n_error},
        {"decode.bad_length", p->decode.n_bad_length},
        {"decode.signal_not_finite", p->decode.n_nonfinite},
        {"decode.signal_out_of_range", p->decode.n_out_of_range},
        {"group.imu.complete", p->group[IPE_IMU].n_complete},
        {"group.imu.incomplete", p->group[IPE_IMU].n_incomplete},
        {"group.imu.lost", p->group[IPE_IMU].n_lost},
        {"group.imu.counter_jumps", p->group[IPE_IMU].n_jumps},
        {"group.imu.used_frames", p->group[IPE_IMU].n_used},
        {"group.imu.dropped_frames", p->group[IPE_IMU].n_dropped},
        {"group.imu.duplicate_frames", p->group[IPE_IMU].n_duplicate},
        {"group.force.complete", p->group[IPE_FORCE].n_complete},
        {"group.force.incomplete", p->group[IPE_FORCE].n_incomplete},
        {"group.force.lost", p->group[IPE_FORCE].n_lost},
        {"group.force.counter_jumps", p->group[IPE_FORCE].n_jumps},
        {"group.force.used_frames", p->group[IPE_FORCE].n_used},
        {"group.force.dropped_frames", p->group[IPE_FORCE].n_dropped},
        {"group.force.duplicate_frames", p->group[IPE_FORCE].n_duplicate},
        {"group.position.complete", p->group[IPE_POSITION].n_complete},
        {"group.position.incomplete", p->group[IPE_POSITION].n_incomplete},
        {"group.position.lost", p->group[IPE_POSITION].n_lost},
        {"group.position.counter_jumps", p->group[IPE_POSITION].n_jumps},
        {"group.position.used_frames", p->group[IPE_POSITION].n_used},
        {"group.position.dropped_frames", p->group[IPE_POSITION].n_dropped},
        {"group.position.duplicate_frames", p->group[IPE_POSITION].n_duplicate},
        {"stuck.imu.refused", p->stuck.n_stuck[IPE_IMU]},
        {"stuck.force.refused", p->stuck.n_stuck[IPE_FORCE]},
        {"stuck.position.refused", p->stuck.n_stuck[IPE_POSITION]},
        {"clock.imu.steps", p->clock[IPE_IMU].n_steps},
        {"clock.force.steps", p->clock[IPE_FORCE].n_steps},
        {"clock.position.steps", p->clock[IPE_POSITION].n_steps},
        {"clock.unsettled", p->n_unsettled},
        {"pace.imu.lost", p->pace[IPE_IMU].n_lost},
        {"pace.imu.dropped", p->pace[IPE_IMU].n_dropped},
        {"pace.imu.restarts", p->pace[IPE_IMU].n_restarts},
        {"pace.force.lost", p->pace[IPE_FORCE].n_lost},
        {"pace.force.dropped", p->pace[IPE_FORCE].n_dropped},
        {"pace.force.restarts", p->pace[IPE_FORCE].n_restarts},
        {"pace.position.lost", p->pace[IPE_POSITION].n_lost},
        {"pace.position.dropped", p->pace[IPE_POSITION].n_dropped},
        {"pace.position.restarts", p->pace[IPE_POSITION].n_restarts},
        {"align.imu.samples", p->align.n_samples[IPE_IMU]},
        {"align.imu.reordered", p->align.n_reordered[IPE_IMU]},
        {"align.imu.duplicate", p->align.n_duplicate[IPE_IMU]},
        {"align.imu.backwards", p->align.n_backwards[IPE_IMU]},
        {"align.imu.restarts", p->align.n_restarts[IPE_IMU]},
        {"align.imu.not_finite", p->align.n_nonfinite[IPE_IMU]},
        {"align.imu.bad_quaternion", p->align.n_bad_quaternion},
        {"align.force.samples", p->align.n_samples[IPE_FORCE]},
        {"align.force.reordered", p->align.n_reordered[IPE_FORCE]},
        {"align.force.duplicate", p->align.n_duplicate[IPE_FORCE]},
        {"align.force.backwards", p->align.n_backwards[IPE_FORCE]},
        {"align.force.restarts", p->align.n_restarts[IPE_FORCE]},
        {"align.force.not_finite", p->align.n_nonfinite[IPE_FORCE]},
        {"align.position.samples", p->align.n_samples[IPE_POSITION]},
        {"align.position.reordered", p->align.n_reordered[IPE_POSITION]},
        {"align.position.duplicate", p->align.n_duplicate[IPE_POSITION]},
        {"align.position.backwards", p->align.n_backwards[IPE_POSITION]},
        {"align.position.restarts", p->align.n_restarts[IPE_POSITION]},
        {"align.position.not_finite", p->align.n_nonfinite[IPE_POSITION]},
        {"align.rows", p->align.n_rows},
        {"align.position.carried", p->align.n_carried},
        {"align.overrun", p->align.n_overrun},
        {"align.force.missing", p->align.n_missing[IPE_FORCE]},
        {"align.force.late", p->align.n_late[IPE_FORCE]},
        {"align.position.missing", p->align.n_missing[IPE_POSITION]},
        {"align.position.late", p->align.n_late[IPE_POSITION]},
        {"wrench.rows", p->wrench.n_rows},
        {"wrench.bad_geometry", p->wrench.n_geometry},
        {"wrench.slack", p->wrench.n_slack},
        {"wrench.overload", p->wrench.n_overload},
        {"window.rows", p->n_rows},
        {"window.windows", p->window.n_windows},
        {"window.restarts", p->window.n_restarts},
        {"window.backwards", p->window.n_backwards},
        {"detect.held", p->detect.n_held},
        {"detect.changes", p->detect.n_changes},
        {"rls.updates", p->rls.n_updates},
        {"rls.not_finite", p->rls.n_nonfinite},
        {"estimate.refused", p->n_refused},
        {"estimate.frozen", p->n_frozen},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].name;
}

bool ipe_pipeline_invariants_hold(const ipe_pipeline_t* p)
{
    const ipe_decode_t* d = &p->decode;
    const uint64_t frames = d->n_decoded + d->n_unknown + d->n_remote + d->n_error + d->n_bad_length;
    return d->n_frames == frames && p->window.first <= p->window.n_windows && ipe_rls_invariants_hold(&p->rls);
}
