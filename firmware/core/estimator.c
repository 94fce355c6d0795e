// SPDX-License-Identifier: Apache-2.0
#include "estimator.h"

#include "prior.h"
#include "regressor.h"
#include "smallmat.h"
#include "systematic.h"
#include "unknown_force.h"

#include <string.h>

#define REST_WINDOWS 50   // at rest, 5 s at a window of 0.4 s: chosen so that the pose's noise is averaged out
#define LEARNING_WINDOWS \
    50                    // of noise, twice IPE_NOISE_LAGS: chosen so that NIS has a meaning before it decides anything
#define NIS_WINDOWS 100   // after which the mean NIS has forgotten its start: chosen twice those it is the mean of
#define LONGEST_STEP 0.5  // s between windows over which a force changes linearly
#define WIDEN_INTERVAL 50  // windows between two looks at implausible states: chosen so that it costs next to nothing
#define DELAY_LINEAR 4e-3  // s, error (w tau)^2/2 of a linear delay: 0.2 % of a motion of 2.5 Hz
#define DELAY_SURE 4.0     // sigma: chosen so that healthy forces never move
#define DELAYS_MAX 4       // chosen so that it always ends: each is what the last one left
#define PRIOR_INTERVAL \
    50                 // excited windows between two foldings of the prior: chosen so that it costs 1 % of an update
#define PRIOR_ROWS 20  // of it in one part of an update: chosen so that no part costs more than the publication

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
    ipe_pose_dwell_restart(&e->pose_dwell);
    ipe_estimator_restart_windows(e);
}

void ipe_estimator_restart_windows(ipe_estimator_t* e)
{
    ipe_noise_restart(&e->noise);
    ipe_change_detector_restart(&e->change_detector);
    ipe_misfit_score_restart(&e->misfit_score);
}

void ipe_estimator_predict(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average)
{
    ipe_filter_states_predict(&e->filter_states, config, average, &e->rls);
}

/// Equations y = H x + noise of one window, H [6][rls.n], and the force offsets' columns as in systematic.h.
static ipe_status_t build_equations(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average,
                                    double* H, double by_offset[IPE_NY][IPE_CABLES_MAX])
{
    double Y[IPE_NY][IPE_NP], X[IPE_NY][IPE_XI_MAX];
    ipe_regressor(average->s, average->ww, average->alpha, Y);
    if (ipe_systematic_columns(config, average, e->rls.x, X) != IPE_OK) { return IPE_ERR_GEOMETRY; }
    ipe_filter_states_rows(&e->filter_states, config, (const double (*)[3])average->R, (const double (*)[IPE_NP])Y,
                           (const double (*)[IPE_XI_MAX])X, H);
    for (int i = 0; i < IPE_NY; ++i) { memcpy(by_offset[i], X[i] + IPE_XI_FORCE, sizeof by_offset[i]); }
    return IPE_OK;
}

/// A failed sensor should have read f [N] in this window. By how much that grew per second since the last, 0: no last one.
static double restored_slope(ipe_estimator_t* e, int cable, int64_t t_ns, double f)
{
    const double elapsed = 1e-9 * (double)(t_ns - e->restored_ns[cable]);
    const bool follows = elapsed > 0.0 && elapsed < LONGEST_STEP;
    const double slope = follows ? (f - e->restored[cable]) / elapsed : 0.0;
    e->restored[cable] = f;
    e->restored_ns[cable] = t_ns;
    return slope;
}

/// The most probable readings [u->n] beyond those that are, and the innovation less what makes them.
static ipe_status_t find_excess(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average,
                                const ipe_unknown_force_t* u, double y[IPE_NY], double excess[IPE_UNKNOWN_FORCE_MAX])
{
    double H[IPE_NY * IPE_NX_MAX], by_offset[IPE_NY][IPE_CABLES_MAX];
    double innovation[IPE_NY], S[IPE_NY][IPE_NY], L[IPE_NY][IPE_NY];
    const ipe_status_t status = build_equations(e, config, average, H, by_offset);
    if (status != IPE_OK) { return status; }
    ipe_rls_innovation(&e->rls, H, y, innovation, S);
    memcpy(L, e->noise.L, sizeof L);
    return ipe_unknown_force_take_out(u, (const double (*)[IPE_NY])S, innovation, y, excess, L);
}

/// Forces of failed sensors u become the most probable ones. is_next: the window follows the last one of the filter's own.
static ipe_status_t restore(ipe_estimator_t* e, const ipe_config_t* config, const ipe_unknown_force_t* u, bool is_next,
                            ipe_average_t* average)
{
    double y[IPE_NY], excess[IPE_UNKNOWN_FORCE_MAX];
    if (u->n == 0) { return IPE_OK; }
    memcpy(y, average->y, sizeof y);
    const ipe_status_t status = find_excess(e, config, average, u, y, excess);
    if (status != IPE_OK) { return status; }
    for (int k = 0; k < u->n; ++k) {
        const int j = u->cable[k];
        const double f = average->f[j] - excess[k] / (1.0 + config->force_gain[j]);
        const double slope = is_next ? restored_slope(e, j, average->t_ns, f) : 0.0;
        for (int i = 0; i < IPE_NY; ++i) { y[i] += slope * (1.0 + config->force_gain[j]) * u->turned[k][i]; }
        average->f[j] = f;
    }
    memcpy(average->y, y, sizeof y);
    return IPE_OK;
}

ipe_status_t ipe_estimator_restore_forces(ipe_estimator_t* e, const ipe_config_t* config, ipe_average_t* average)
{
    ipe_unknown_force_t u;
    const ipe_status_t status = ipe_unknown_force_columns(config, average, &u);
    return status == IPE_OK ? restore(e, config, &u, true, average) : status;
}

bool ipe_estimator_is_noise_learnt(const ipe_estimator_t* e)
{
    return e->noise.n_summed >= LEARNING_WINDOWS;
}

/// Use the window, hold it back, or take it as a change of payload.
static ipe_change_detector_verdict_t judge(ipe_estimator_t* e, const ipe_config_t* config, const double* H,
                                           const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                                           const double L[IPE_NY][IPE_NY])
{
    double Y[IPE_NY][IPE_NP], payload_std[IPE_NP];
    for (int i = 0; i < IPE_NY; ++i) { memcpy(Y[i], H + i * e->rls.n, sizeof Y[i]); }
    ipe_prior_payload_std(config, payload_std);
    const ipe_change_detector_window_t window = {.Y = (const double (*)[IPE_NP])Y,
                                                 .innovation = innovation,
                                                 .S = S,
                                                 .L = L,
                                                 .nis = e->nis,
                                                 .mass = e->rls.x[0],
                                                 .is_noise_known = ipe_estimator_is_noise_learnt(e)};
    return ipe_change_detector_push(&e->change_detector, &window, payload_std);
}

/// A window that stands out counts for less, once the noise is known.
static void weigh(ipe_estimator_t* e, double L[IPE_NY][IPE_NY])
{
    const double weight = ipe_noise_weight(e->nis), scale = 1.0 / sqrt(weight);
    if (e->noise.n_summed < LEARNING_WINDOWS || !(weight < 1.0)) { return; }
    for (int i = 0; i < IPE_NY; ++i) {
        for (int k = 0; k <= i; ++k) { L[i][k] *= scale; }
    }
    ++e->n_weighted;
}

/// The noise learns from a window's innovation. A direction lost to an unknown force is missing in it, so the rest is scaled.
static void learn_noise(ipe_estimator_t* e, int n_unknown, double innovation[IPE_NY], const double S[IPE_NY][IPE_NY])
{
    const double scale = sqrt((double)IPE_NY / (IPE_NY - n_unknown));
    for (int i = 0; i < IPE_NY; ++i) { innovation[i] *= scale; }
    ipe_noise_push(&e->noise, innovation, S);
}

/// The least share of what is known of n parameters from the first on that is left once they are loosened by std.
static double known_share(const ipe_estimator_t* e, const double* std, int first, int n)
{
    double share = 1.0;
    for (int i = first; i < first + n; ++i) {
        const double known = ipe_rls_std(&e->rls, i);
        share = fmin(share, known * known / (known * known + std[i] * std[i]));
    }
    return share;
}

/// A new payload, of which this much is not known; what is known of the sensors stays. A known pose is new again.
static void loosen_theta(ipe_estimator_t* e, const double std[IPE_NP])
{
    ipe_eiv_correction_loosen(&e->eiv_correction, known_share(e, std, 0, 4), known_share(e, std, 4, 6));
    for (int i = 0; i < IPE_NP; ++i) { ipe_rls_loosen(&e->rls, i, std[i] * std[i]); }
    ipe_noise_restart(&e->noise);
    ipe_misfit_score_restart(&e->misfit_score);
    ipe_pose_dwell_restart(&e->pose_dwell);
}

/// Theta may be anything the robot can carry.
static void loosen_to_any_payload(ipe_estimator_t* e, const ipe_config_t* config)
{
    double std[IPE_NP];
    ipe_prior_payload_std(config, std);
    loosen_theta(e, std);
    memset(&e->eiv_correction, 0, sizeof e->eiv_correction);
}

void ipe_estimator_move(ipe_estimator_t* e, const ipe_config_t* config, const double step[IPE_NP],
                        const double std[IPE_NP])
{
    for (int i = 0; i < IPE_NP; ++i) { e->rls.x[i] += step[i]; }
    if (std == NULL) {
        loosen_to_any_payload(e, config);
    } else {
        loosen_theta(e, std);
    }
    ipe_change_detector_restart_after_change(&e->change_detector);
}

/// Neither body explains the window: the noise is larger than learnt, but one window says only so much about it.
static void learn_noise_of_misfit(ipe_estimator_t* e, const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY])
{
    double clipped[IPE_NY];
    const double share = sqrt(fmin(1.0, IPE_CHANGE_DETECTOR_NIS_LIMIT / e->nis));
    for (int i = 0; i < IPE_NY; ++i) { clipped[i] = share * innovation[i]; }
    ipe_noise_push(&e->noise, clipped, S);
}

/// The share of older data's weight that is left after the time `hop` [s] of an excited window.
static double memory_kept(const ipe_config_t* config, double hop)
{
    return exp(-hop / config->memory);
}

/// Forget over the time `hop` [s] of an excited window; at rest nothing would replace what is forgotten.
static void forget(ipe_estimator_t* e, const ipe_config_t* config, double hop)
{
    if (config->memory == 0.0) { return; }
    const double lambda = memory_kept(config, hop);
    ipe_rls_forget(&e->rls, lambda);
    ipe_eiv_correction_forget(&e->eiv_correction, lambda);
}

/// Innovation of a window shorter than the filter's own, and the factor of its noise; forces of failed sensors are in neither.
static ipe_status_t find_innovation(const ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average,
                                    const ipe_unknown_force_t* u, const double* H, double innovation[IPE_NY],
                                    double S[IPE_NY][IPE_NY], double L[IPE_NY][IPE_NY])
{
    double y[IPE_NY], excess[IPE_UNKNOWN_FORCE_MAX];
    const double shorter = fmax(1.0, config->window_length / average->length);
    ipe_rls_innovation(&e->rls, H, average->y, innovation, S);
    for (int i = 0; i < IPE_NY; ++i) {
        // an average's white noise by 1 / length, that of a slope by 1 / length^3
        const double scale = sqrt(i < 3 ? shorter : shorter * shorter * shorter);
        for (int k = 0; k <= i; ++k) { L[i][k] = scale * e->noise.L[i][k]; }
    }
    memcpy(y, average->y, sizeof y);
    return ipe_unknown_force_take_out(u, (const double (*)[IPE_NY])S, innovation, y, excess, L);
}

static __attribute__((noinline)) bool add_to_sums(const ipe_estimator_t* e, const double* H,
                                                  const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                                                  const double L[IPE_NY][IPE_NY], ipe_body_step_t* sums)
{
    double Y[IPE_NY][IPE_NP];
    for (int i = 0; i < IPE_NY; ++i) { memcpy(Y[i], H + i * e->rls.n, sizeof Y[i]); }
    ipe_body_step_start(sums);
    return ipe_body_step_add(sums, (const double (*)[IPE_NP])Y, innovation, S, L);
}

/// Not inlined, so that restoring forces, which needs equations of its own, does not stand on these.
static __attribute__((noinline)) ipe_status_t contrast(ipe_estimator_t* e, const ipe_config_t* config,
                                                       const ipe_average_t* average, const ipe_unknown_force_t* u,
                                                       ipe_body_step_t* sums)
{
    double H[IPE_NY * IPE_NX_MAX], by_offset[IPE_NY][IPE_CABLES_MAX];
    double innovation[IPE_NY], S[IPE_NY][IPE_NY], L[IPE_NY][IPE_NY] = {{0.0}};
    ipe_status_t status = build_equations(e, config, average, H, by_offset);
    if (status == IPE_OK) { status = find_innovation(e, config, average, u, H, innovation, S, L); }
    if (status != IPE_OK) { return status; }
    const bool is_good = add_to_sums(e, H, innovation, (const double (*)[IPE_NY])S, (const double (*)[IPE_NY])L, sums);
    return is_good ? IPE_OK : IPE_ERR_NONFINITE;
}

ipe_status_t ipe_estimator_contrast(ipe_estimator_t* e, const ipe_config_t* config, ipe_average_t* average,
                                    ipe_body_step_t* sums)
{
    ipe_unknown_force_t u;
    if (e->estimate.n_windows == 0) { return IPE_NOT_READY; }
    ipe_status_t status = ipe_unknown_force_columns(config, average, &u);
    if (status == IPE_OK) { status = restore(e, config, &u, false, average); }
    return status == IPE_OK ? contrast(e, config, average, &u, sums) : status;
}

/// Excited windows: the prior's rows are due after so many of them, with the weight that forgetting took from it.
static double due_prior_weight(ipe_estimator_t* e, const ipe_config_t* config, double hop)
{
    if (config->memory == 0.0 || ++e->n_excited % PRIOR_INTERVAL != 0) { return 0.0; }
    return sqrt(1.0 - pow(memory_kept(config, hop), PRIOR_INTERVAL));
}

ipe_status_t ipe_estimator_begin(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average,
                                 ipe_update_t* update)
{
    double by_offset[IPE_NY][IPE_CABLES_MAX];
    double innovation[IPE_NY], S[IPE_NY][IPE_NY], L[IPE_NY][IPE_NY], y[IPE_NY], excess[IPE_UNKNOWN_FORCE_MAX];
    ipe_unknown_force_t u;
    const double hop = average->length / IPE_WINDOWS_OPEN;
    double* H = update->H;
    const int n_rest = ipe_pose_dwell_push(&e->pose_dwell, config, average);
    ipe_status_t status = build_equations(e, config, average, H, by_offset);  // averages -> rows of the states
    if (status != IPE_OK) { return status; }
    ipe_rls_innovation(&e->rls, H, average->y, innovation, S);
    memcpy(L, e->noise.L, sizeof L);
    memcpy(y, average->y, sizeof y);
    status = ipe_unknown_force_columns(config, average, &u);
    if (status != IPE_OK) { return status; }
    status = ipe_unknown_force_take_out(&u, (const double (*)[IPE_NY])S, innovation, y, excess, L);
    if (status != IPE_OK) { return status; }
    e->unknown_force = average->unknown_force;
    e->n_unknown_force += u.n > 0;
    e->nis = ipe_change_detector_nis(innovation, S, e->noise.L);
    if (n_rest > REST_WINDOWS && !(e->nis > IPE_CHANGE_DETECTOR_NIS_LIMIT) &&
        !ipe_change_detector_is_contested(&e->change_detector)) {
        return IPE_OK;
    }
    const ipe_change_detector_verdict_t verdict = judge(e, config, H, innovation, (const double (*)[IPE_NY])S,
                                                        (const double (*)[IPE_NY])L);  // innovation -> same payload?
    if (verdict == IPE_CHANGE_DETECTOR_HOLD) { return IPE_NOT_READY; }
    if (verdict == IPE_CHANGE_DETECTOR_MISFIT) {
        learn_noise_of_misfit(e, innovation, (const double (*)[IPE_NY])S);
        return IPE_OK;
    }
    if (verdict == IPE_CHANGE_DETECTOR_CHANGE) { loosen_to_any_payload(e, config); }
    if (n_rest == 0) { forget(e, config, hop); }
    ipe_filter_states_denoise_gain_columns(&e->filter_states, (const double (*)[IPE_CABLES_MAX])by_offset, average->f,
                                           innovation, (const double (*)[IPE_NY])S,
                                           (const double (*)[IPE_NY])e->noise.L, H);
    if (verdict == IPE_CHANGE_DETECTOR_USE) { weigh(e, L); }
    status = ipe_rls_whiten(&e->rls, H, y, (const double (*)[IPE_NY])L, update->z);
    if (status != IPE_OK) { return status; }
    update->t_ns = average->t_ns;
    update->prior_weight = n_rest == 0 ? due_prior_weight(e, config, hop) : 0.0;
    update->n_prior = 0;
    update->is_scored = e->noise.n_summed >= LEARNING_WINDOWS;
    update->is_folded = false;
    ipe_eiv_correction_add(&e->eiv_correction, average, ipe_noise_level(&e->noise));
    if (verdict == IPE_CHANGE_DETECTOR_USE) { learn_noise(e, u.n, innovation, (const double (*)[IPE_NY])S); }
    return IPE_UNFINISHED;
}

ipe_status_t ipe_estimator_go_on(ipe_estimator_t* e, const ipe_config_t* config, ipe_update_t* u)
{
    if (u->prior_weight > 0.0 && u->n_prior < e->rls.n) {
        ipe_prior_fold(config, &e->filter_states, u->prior_weight, u->n_prior, PRIOR_ROWS, &e->rls);
        u->n_prior += PRIOR_ROWS;
        return IPE_UNFINISHED;
    }
    if (!u->is_folded) {
        ipe_misfit_score_before(&e->misfit_score, &e->rls);
        (void)ipe_rls_update_whitened(&e->rls, u->H, u->z);  // rows -> states, P
        if (u->is_scored) { ipe_misfit_score_after(&e->misfit_score, &e->rls, u->t_ns); }
        u->is_folded = true;
        return e->rls.n_updates % WIDEN_INTERVAL == 0 ? IPE_UNFINISHED : IPE_OK;
    }
    ipe_filter_states_widen(&e->filter_states, &e->rls);
    return IPE_OK;
}

ipe_status_t ipe_estimator_update(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average)
{
    ipe_update_t u;
    ipe_status_t status = ipe_estimator_begin(e, config, average, &u);
    while (status == IPE_UNFINISHED) { status = ipe_estimator_go_on(e, config, &u); }
    return status;
}

bool ipe_estimator_move_force_delay(ipe_estimator_t* e, const ipe_config_t* config)
{
    const int i = e->filter_states.layout.first[IPE_BLOCK_FORCE_DELAY];
    const bool is_state = e->filter_states.layout.count[IPE_BLOCK_FORCE_DELAY] > 0;
    if (!is_state || e->n_delays == DELAYS_MAX || e->rls.n_updates % WIDEN_INTERVAL != 0) { return false; }
    const double rest = e->rls.x[i];
    if (!(fabs(rest) > fmax(DELAY_LINEAR, DELAY_SURE * ipe_rls_std(&e->rls, i)))) { return false; }
    const double delay = e->force_delay + rest;
    const int n_delays = e->n_delays + 1;
    const uint64_t n_changes = e->change_detector.n_changes;
    const ipe_estimate_t estimate = e->estimate;
    ipe_estimator_reset(e, config);
    e->estimate = estimate;
    e->force_delay = delay;
    e->n_delays = n_delays;
    e->change_detector.n_changes = n_changes;
    return true;
}

/// By what misfit widens the published sigmas. The mean NIS needs some time to forget that it was unknown.
static double sigma_factor(const ipe_estimator_t* e)
{
    const bool is_nis_known = e->rls.n_updates > NIS_WINDOWS;
    return ipe_misfit_score_factor(&e->misfit_score, &e->noise, is_nis_known ? e->change_detector.level : 0.0);
}

void ipe_estimator_solution(const ipe_estimator_t* e, const ipe_config_t* config, ipe_solution_t* solution)
{
    memset(solution, 0, sizeof *solution);
    memcpy(solution->theta, e->rls.x, sizeof solution->theta);
    ipe_rls_covariance(&e->rls, IPE_NP, &solution->covariance[0][0]);
    const double factor = sigma_factor(e);
    solution->inflation = fmax(ipe_change_detector_inflation(&e->change_detector), factor * factor);
    ipe_prior_at_imu(config, solution->prior_theta, solution->prior_covariance);
    ipe_eiv_correction_information(&e->eiv_correction, e->noise.L, ipe_noise_level(&e->noise), e->rls.x,
                                   solution->spurious);
    solution->std_geometry = config->std_geometry;
    solution->std_common_gain = ipe_filter_states_common_gain_std(config);
}

static void read_systematic(const ipe_estimator_t* e, const ipe_config_t* config, ipe_estimate_t* estimate)
{
    estimate->n_systematic = ipe_systematic_count(config->n_cables);
    ipe_filter_states_systematic(&e->filter_states, config, &e->rls, estimate->systematic, estimate->systematic_std);
    estimate->systematic[IPE_XI_FORCE_DELAY] += e->force_delay;
}

void ipe_estimator_begin_publication(const ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns,
                                     const double* step, const double* std, ipe_publication_t* p)
{
    ipe_solution_t solution;
    ipe_estimator_solution(e, config, &solution);
    for (int i = 0; i < IPE_NP && step != NULL; ++i) {
        solution.theta[i] += step[i];
        solution.covariance[i][i] += std[i] * std[i];
    }
    p->t_ns = t_ns;
    p->is_provisional = step != NULL;
    p->sigma_factor = sqrt(solution.inflation);
    p->distance = 0.0;
    ipe_estimate_correct(config, &solution, p->theta, p->covariance);
    p->searched = ipe_consistency_begin(p->theta, &p->search);
    p->is_consistent = p->searched == IPE_OK;
}

static ipe_status_t end_publication(ipe_estimator_t* e, const ipe_config_t* config, const ipe_publication_t* p)
{
    ipe_body_t prior;
    ipe_estimate_t found = {.t_ns = p->t_ns,
                            .n_windows = e->rls.n_updates,
                            .n_rows = e->n_rows,
                            .consistent = p->is_consistent,
                            .distance = p->distance,
                            .nis = e->nis,
                            .n_changes = e->change_detector.n_changes,
                            .sigma_factor = p->sigma_factor,
                            .is_provisional = p->is_provisional,
                            .is_misfit = ipe_change_detector_is_misfit(&e->change_detector),
                            .unknown_force = e->unknown_force};
    memcpy(found.theta, p->search.q, sizeof found.theta);
    memcpy(found.covariance, p->covariance, sizeof found.covariance);
    ipe_estimate_prior_body(config, &prior);
    const double std_common_gain = ipe_filter_states_common_gain_std(config);
    if (ipe_estimate_finish(config, config->std_geometry, std_common_gain, &prior, &found) != IPE_OK) {
        return IPE_ERR_NONFINITE;
    }
    read_systematic(e, config, &found);
    e->estimate = found;
    return IPE_OK;
}

ipe_status_t ipe_estimator_go_on_publication(ipe_estimator_t* e, const ipe_config_t* config, ipe_publication_t* p)
{
    if (p->searched == IPE_UNFINISHED) {
        const double (*P)[IPE_NP] = (const double (*)[IPE_NP])p->covariance;
        p->searched = ipe_consistency_go_on(p->theta, P, &p->search, &p->distance);
        return IPE_UNFINISHED;
    }
    const bool is_good = p->searched == IPE_OK && isfinite(e->nis) && end_publication(e, config, p) == IPE_OK;
    e->n_refused += !is_good;
    return is_good ? IPE_OK : IPE_ERR_NONFINITE;
}

ipe_status_t ipe_estimator_publish(ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns)
{
    ipe_publication_t p;
    ipe_status_t status = IPE_UNFINISHED;
    ipe_estimator_begin_publication(e, config, t_ns, NULL, NULL, &p);
    while (status == IPE_UNFINISHED) { status = ipe_estimator_go_on_publication(e, config, &p); }
    return status;
}
