// SPDX-License-Identifier: Apache-2.0
#include "estimator.h"

#include "prior.h"
#include "regressor.h"
#include "smallmat.h"
#include "systematic.h"

#include <string.h>

#define REST_WINDOWS 50  // at rest, 5 s at a window of 0.4 s: chosen so that the pose's noise is averaged out
#define LEARNING_WINDOWS \
    50                   // of noise, twice IPE_NOISE_LAGS: chosen so that NIS has a meaning before it decides anything
#define WIDEN_INTERVAL 50  // windows between two looks at implausible states: chosen so that it costs next to nothing
#define PRIOR_INTERVAL \
    50  // excited windows between two foldings of the prior: chosen so that it costs 1 % of an update

ipe_status_t ipe_estimator_init(ipe_estimator_t* e, const ipe_config_t* config)
{
    memset(e, 0, sizeof *e);
    ipe_filter_states_init(&e->filter_states, config);
    ipe_change_detector_init(&e->change_detector);
    const ipe_status_t status = ipe_noise_init(&e->noise, config->residual_covariance);
    return status == IPE_OK ? ipe_prior_start(config, &e->filter_states, &e->rls) : status;
}

void ipe_estimator_reset(ipe_estimator_t* e, const ipe_config_t* config)
{
    const uint64_t n_rows = e->n_rows, n_refused = e->n_refused;
    (void)ipe_estimator_init(e, config);  // did not fail with the same configuration
    e->n_rows = n_rows;
    e->n_refused = n_refused;
}

void ipe_estimator_continue(ipe_estimator_t* e, const ipe_estimator_t* from)
{
    *e = *from;
    e->change_detector.n_outstanding = 0;
    ipe_pose_dwell_restart(&e->pose_dwell);
    ipe_estimator_restart_windows(e);
}

void ipe_estimator_restart_windows(ipe_estimator_t* e)
{
    ipe_noise_restart(&e->noise);
}

void ipe_estimator_predict(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average)
{
    ipe_filter_states_predict(&e->filter_states, config, average, &e->rls);
}

/// Equations y = H x + noise of one window; X [6][xi] are the systematic columns, H [6][rls.n].
static ipe_status_t build_equations(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average,
                                    double X[IPE_NY][IPE_XI_MAX], double* H)
{
    double Y[IPE_NY][IPE_NP];
    ipe_regressor(average->s, average->ww, average->alpha, Y);
    if (ipe_systematic_columns(config, average, e->rls.x, X) != IPE_OK) { return IPE_ERR_GEOMETRY; }
    ipe_filter_states_rows(&e->filter_states, config, (const double (*)[3])average->R, (const double (*)[IPE_NP])Y,
                           (const double (*)[IPE_XI_MAX])X, H);
    return IPE_OK;
}

/// Use the window, hold it back, or take it as a change of payload. Until the noise is known, every window is used.
static ipe_change_detector_verdict_t judge(ipe_estimator_t* e)
{
    if (e->noise.n_summed < LEARNING_WINDOWS) { return IPE_CHANGE_DETECTOR_USE; }
    return ipe_change_detector_push(&e->change_detector, e->nis);
}

/// A new payload: theta may be anything the robot can carry; what is known of the sensors stays. A known pose is new again.
static void loosen_theta(ipe_estimator_t* e, const ipe_config_t* config)
{
    double std[IPE_NP];
    ipe_prior_payload_std(config, std);
    for (int i = 0; i < IPE_NP; ++i) { ipe_rls_loosen(&e->rls, i, std[i] * std[i]); }
    memset(&e->eiv_correction, 0, sizeof e->eiv_correction);
    ipe_noise_restart(&e->noise);
    ipe_pose_dwell_restart(&e->pose_dwell);
}

/// Forget over the time `hop` [s] of an excited window; at rest nothing would replace what is forgotten.
static void forget(ipe_estimator_t* e, const ipe_config_t* config, double hop)
{
    if (config->memory == 0.0) { return; }
    const double lambda = exp(-hop / config->memory);
    ipe_rls_forget(&e->rls, lambda);
    ipe_eiv_correction_forget(&e->eiv_correction, lambda);
    if (++e->n_excited % PRIOR_INTERVAL == 0) {
        ipe_prior_fold(config, &e->filter_states, sqrt(1.0 - pow(lambda, PRIOR_INTERVAL)), &e->rls);
    }
}

ipe_status_t ipe_estimator_update(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average)
{
    double X[IPE_NY][IPE_XI_MAX], H[IPE_NY * IPE_NX_MAX], innovation[IPE_NY], S[IPE_NY][IPE_NY], unused;
    const int n_rest = ipe_pose_dwell_push(&e->pose_dwell, config, average);
    ipe_status_t status = build_equations(e, config, average, X, H);  // averages -> rows of the states
    if (status != IPE_OK) { return status; }
    ipe_rls_innovation(&e->rls, H, average->y, innovation, S);
    e->nis = ipe_change_detector_nis(innovation, S, e->noise.L);
    if (n_rest > REST_WINDOWS && !(e->nis > IPE_CHANGE_DETECTOR_NIS_LIMIT)) { return IPE_OK; }
    const ipe_change_detector_verdict_t verdict = judge(e);  // innovation -> same payload?
    if (verdict == IPE_CHANGE_DETECTOR_HOLD) { return IPE_NOT_READY; }
    if (verdict == IPE_CHANGE_DETECTOR_CHANGE) { loosen_theta(e, config); }
    if (n_rest == 0) { forget(e, config, average->length / IPE_WINDOWS_OPEN); }
    ipe_filter_states_denoise_gain_columns(&e->filter_states, (const double (*)[IPE_XI_MAX])X, average->f, innovation,
                                           (const double (*)[IPE_NY])S, (const double (*)[IPE_NY])e->noise.L, H);
    status = ipe_rls_update(&e->rls, H, average->y, e->noise.L, &unused);  // rows -> states, P
    if (status != IPE_OK) { return status; }
    ipe_eiv_correction_add(&e->eiv_correction, average, ipe_noise_level(&e->noise));
    if (verdict == IPE_CHANGE_DETECTOR_USE) { ipe_noise_push(&e->noise, innovation, S); }
    if (e->rls.n_updates % WIDEN_INTERVAL == 0) { ipe_filter_states_widen(&e->filter_states, &e->rls); }
    return IPE_OK;
}

void ipe_estimator_solution(const ipe_estimator_t* e, const ipe_config_t* config, ipe_solution_t* solution)
{
    memset(solution, 0, sizeof *solution);
    memcpy(solution->theta, e->rls.x, sizeof solution->theta);
    ipe_rls_covariance(&e->rls, IPE_NP, &solution->covariance[0][0]);
    ipe_prior_at_imu(config, solution->prior_theta, solution->prior_covariance);
    ipe_eiv_correction_information(&e->eiv_correction, e->noise.L, ipe_noise_level(&e->noise), solution->spurious);
    solution->std_geometry = config->std_geometry;
    solution->std_common_gain = ipe_filter_states_common_gain_std(config);
}

static void read_systematic(const ipe_estimator_t* e, const ipe_config_t* config, ipe_estimate_t* estimate)
{
    estimate->n_systematic = ipe_systematic_count(config->n_cables);
    ipe_filter_states_systematic(&e->filter_states, config, &e->rls, estimate->systematic, estimate->systematic_std);
}

ipe_status_t ipe_estimator_publish(ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns)
{
    ipe_solution_t solution;
    ipe_body_t prior;
    ipe_estimate_t found = {.t_ns = t_ns,
                            .n_windows = e->rls.n_updates,
                            .n_rows = e->n_rows,
                            .nis = e->nis,
                            .n_changes = e->change_detector.n_changes};
    ipe_estimator_solution(e, config, &solution);
    ipe_estimate_prior_body(config, &prior);
    const ipe_status_t status = ipe_estimate_publish(config, &solution, &prior, NULL, &found);
    if (status != IPE_OK || !isfinite(e->nis)) {
        ++e->n_refused;
        return IPE_ERR_NONFINITE;
    }
    read_systematic(e, config, &found);
    e->estimate = found;
    return IPE_OK;
}
