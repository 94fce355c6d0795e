// SPDX-License-Identifier: Apache-2.0
#include "change_detector.h"

#include "smallmat.h"

#include <string.h>

#define LEVEL_START 10     // windows that a NIS of 6 counts for at the start: chosen so that 1 s of data outweighs it
#define LEVEL_WINDOWS 50   // that the level is the mean of: chosen as many as the noise is learnt from before it counts
#define LEVEL_MIN 0.5      // NIS: chosen as the level of overlapping windows whose noise outlasts them, the lowest seen
#define LEVEL_SAFE 3.0     // NIS: chosen as half of what honest noise gives
#define DRIFT 2.0          // levels: chosen so that noise underrated by a factor of 1.4 raises no suspicion
#define CUSUM_LIMIT 6.0    // levels: chosen so that 1 % of the mass raises it before the filter has absorbed it
#define UNKNOWN_NOISE 4.0  // NIS limits: chosen so that declared noise may be too small by a factor of 2 to 6
#define CALM_WINDOWS 5     // chosen as one more than share an instant
#define CONTEST_WINDOWS 50  // 5 s at a window of 0.4 s: chosen longer than people lean on a platform
#define MOVING 0.25  // of the misfit of all windows: chosen so that a ramp of the load restarts it, noise does not
#define MISFIT_MAX \
    0.5  // chosen over what payloads leave once they are at rest on the platform, 0.3; pushes leave 1 to 1000
#define INEXACT 1e-4  // of the NIS: chosen as the square of the columns' errors under a load as heavy as the body
#define REMAINING_SHARE 0.03  // of the NIS, beside what noise leaves: chosen over a load's 3 %, under friction's 14 %
#define FARTHEST 2.0       // rms distances of the attachments that a load is away: chosen so that pushes pass for none
#define EVIDENCE_MIN 20.0  // of log-likelihood: chosen so that noise reaches it once in 5e8 contests
#define EVIDENCE 1000.0    // log-likelihood times windows: chosen so that a small step must stay for longer
#define SUDDEN_EVIDENCE \
    100.0                  // of log-likelihood, of each of two windows that alone show a step: chosen over most pushes
#define SUDDEN_MASS \
    0.025  // of the mass, of such a step: chosen so that 6 %, picked up within 0.5 s, are found in 0.6 s
#define LASTING_WINDOWS 6       // that show any other step together: chosen longer than the peak of a push, under 1 s
#define FIRST_MOMENTS_MIN 40.0  // chi-squared with 4 degrees of freedom exceeds it once in 2e7 contests
#define LEAST_MASS 0.005        // of the mass: chosen as half of the smallest change to be found
#define SAME_CHANGE 10          // windows: chosen so that a load that is picked up within 1 s is one change
#define SHIFT_WINDOWS 30        // a load that only moves on the platform: chosen longer than most pushes,
#define SHIFT_EVIDENCE 300.0    // and so that friction does not pass for it
#define SCALES 5  // down to 1/256 of what the cables carry: chosen so that 0.1 % of the mass is among them
#define SCALE_STEP 4.0
#define SCALE_SHARE (1.0 / SCALE_STEP)  // of its std that a step must have, so that it is of this scale

void ipe_change_detector_init(ipe_change_detector_t* d)
{
    memset(d, 0, sizeof *d);
    d->level = IPE_NY;
    d->n_level = LEVEL_START;
    d->n_since_change = SAME_CHANGE + 1;
}

void ipe_change_detector_restart(ipe_change_detector_t* d)
{
    d->n_contest = d->n_restless = d->n_calm = d->n_steps = 0;
    d->contest_square = d->cusum = 0.0;
}

double ipe_change_detector_nis(const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                               const double L[IPE_NY][IPE_NY])
{
    double A[IPE_NY][IPE_NY], z[IPE_NY], nis = 0.0;
    if (!cholesky_of_sum(&S[0][0], &L[0][0], IPE_NY, &A[0][0])) { return NAN; }
    memcpy(z, innovation, sizeof z);
    substitute_forward(&A[0][0], IPE_NY, z);
    for (int i = 0; i < IPE_NY; ++i) { nis += z[i] * z[i]; }
    return nis;
}

/// Learnt, or as declared and plainly not too small.
static bool is_level_safe(const ipe_change_detector_t* d)
{
    return d->n_level >= LEVEL_WINDOWS && d->level < LEVEL_SAFE;
}

static bool knows_noise(const ipe_change_detector_t* d, const ipe_change_detector_window_t* w)
{
    return w->is_noise_known || is_level_safe(d);
}

/// Mean NIS of late; more where the noise is not known.
static double level_of(const ipe_change_detector_t* d, bool is_noise_known)
{
    return is_noise_known || is_level_safe(d) ? d->level : fmax(d->level, UNKNOWN_NOISE);
}

static double restless_nis(const ipe_change_detector_t* d, const ipe_change_detector_window_t* w)
{
    return knows_noise(d, w) ? DRIFT * fmax(d->level, LEVEL_MIN) : DRIFT * IPE_NY;
}

/// Not at the start, where there is nothing to compare with.
static bool is_suspicious(ipe_change_detector_t* d, const ipe_change_detector_window_t* w)
{
    if (!knows_noise(d, w) && d->n_level < LEVEL_WINDOWS) { return false; }
    const double limit = (knows_noise(d, w) ? 1.0 : UNKNOWN_NOISE) * IPE_CHANGE_DETECTOR_NIS_LIMIT;
    d->cusum = knows_noise(d, w) ? fmax(0.0, d->cusum + w->nis - restless_nis(d, w)) : 0.0;
    return w->nis > limit || d->cusum > CUSUM_LIMIT * fmax(d->level, LEVEL_MIN);
}

static void learn_level(ipe_change_detector_t* d, double nis)
{
    d->n_level += d->n_level < LEVEL_WINDOWS;
    d->level += (fmin(nis, IPE_CHANGE_DETECTOR_NIS_LIMIT) - d->level) / d->n_level;
}

/// What a step may leave, over what the noise explains.
static double misfit_limit(const ipe_body_step_t* step, double level)
{
    return fmax(MISFIT_MAX, DRIFT * level / IPE_NY) + INEXACT * step->square / step->n_windows;
}

/// The body after, with this window. Anew from it where the load still moves: alone the window is a step of a body, with
/// those before it is none; and where 5 s of them are none. The states err alike in all windows of a contest: of n windows
/// their part of the covariance counts n times.
///
///   last  out  the same from this window alone
static void follow_step(ipe_change_detector_t* d, const ipe_change_detector_window_t* w, const double std[IPE_NP],
                        ipe_body_step_t* last)
{
    ipe_body_step_fit_t fit, alone;
    double shared[IPE_NY][IPE_NY];
    for (int i = 0; i < IPE_NY * IPE_NY; ++i) {
        shared[i / IPE_NY][i % IPE_NY] = (d->step.n_windows + 1) * w->S[i / IPE_NY][i % IPE_NY];
    }
    ipe_body_step_start(last);
    if (!ipe_body_step_add(last, w->Y, w->innovation, w->S, w->L)) { return; }
    (void)ipe_body_step_add(&d->step, w->Y, w->innovation, (const double (*)[IPE_NY])shared, w->L);
    ipe_body_step_solve(last, std, 1.0, &alone);
    ipe_body_step_solve(&d->step, std, 1.0, &fit);
    const bool is_new = alone.misfit < MOVING * fit.misfit || d->step.n_windows >= CONTEST_WINDOWS;
    if (fit.misfit > misfit_limit(&d->step, d->level) && is_new) { d->step = *last; }
}

/// What a step has to show.
typedef struct {
    double mass;        ///< kg, at least
    double evidence;    ///< log-likelihood ratio, at least
    bool may_be_shift;  ///< of a load that only moves on the platform
} demand_t;

/// Is the step one of a load: of this scale, no further away than loads are?
static bool is_load(const ipe_body_step_fit_t* fit, const double std[IPE_NP], const demand_t* demand)
{
    const double m = fabs(fit->theta[0]), arm = std[1] / std[0], moment = vec3_norm(fit->theta + 1) / arm;
    double inertia = 0.0;  // as the mass that has it at the attachments' distance
    for (int i = 4; i < IPE_NP; ++i) { inertia = fmax(inertia, fabs(fit->theta[i]) / std[i] * std[0]); }
    const bool is_added =
        m > fmax(demand->mass, SCALE_SHARE * std[0]) && moment < FARTHEST * m && inertia < FARTHEST * FARTHEST * m;
    const bool is_moved = moment > fmax(demand->mass, SCALE_SHARE * std[0]) && demand->may_be_shift &&
                          fit->log_likelihood_ratio > SHIFT_EVIDENCE;
    return is_added || is_moved;
}

/// Does the step explain these windows, and far better than none?
static bool is_evident(const ipe_body_step_fit_t* fit, const ipe_body_step_t* step, double level, double evidence)
{
    return fit->misfit < misfit_limit(step, level) && fit->first_moments > FIRST_MOMENTS_MIN &&
           fit->remaining < level * step->n_windows + REMAINING_SHARE * step->square &&
           fit->log_likelihood_ratio > evidence;
}

/// Loads of all scales are tried: under the prior of a load as heavy as the cables carry, its moments of inertia explain
/// whatever its mass and first moments do not.
static bool is_step(const ipe_body_step_t* step, double level, const double payload_std[IPE_NP], const demand_t* demand)
{
    double std[IPE_NP];
    ipe_body_step_fit_t fit;
    memcpy(std, payload_std, sizeof std);
    for (int k = 0; k < SCALES && step->n_windows > 0; ++k) {
        ipe_body_step_solve(step, std, fmax(1.0, level), &fit);
        if (is_evident(&fit, step, level, demand->evidence) && is_load(&fit, std, demand)) { return true; }
        for (int i = 0; i < IPE_NP; ++i) { std[i] /= SCALE_STEP; }
    }
    return false;
}

/// A step that lasts; or one so large that two windows in a row show it, each alone, while the load still moves. In a misfit
/// the noise is learnt from a disturbance, so one window shows nothing, and a step has to last for longer.
static bool is_won(ipe_change_detector_t* d, const ipe_change_detector_window_t* w, const ipe_body_step_t* last,
                   const double payload_std[IPE_NP])
{
    const int n = d->step.n_windows;
    const demand_t sudden = {.mass = SUDDEN_MASS * w->mass, .evidence = SUDDEN_EVIDENCE};
    const demand_t lasting = {
        .mass = LEAST_MASS * w->mass, .evidence = fmax(EVIDENCE_MIN, EVIDENCE / n), .may_be_shift = n >= SHIFT_WINDOWS};
    const int least = ipe_change_detector_is_misfit(d) ? SHIFT_WINDOWS : LASTING_WINDOWS;
    const bool is_sudden = !ipe_change_detector_is_misfit(d) && is_step(last, d->level, payload_std, &sudden);
    d->n_steps = is_sudden ? d->n_steps + 1 : 0;
    return d->n_steps >= IPE_CHANGE_DETECTOR_SUDDEN_WINDOWS ||
           (n >= least && is_step(&d->step, d->level, payload_std, &lasting));
}

static ipe_change_detector_verdict_t compete(ipe_change_detector_t* d, const ipe_change_detector_window_t* w,
                                             const double payload_std[IPE_NP])
{
    ipe_body_step_t last;
    if (d->n_contest == 0) { ipe_body_step_start(&d->step); }
    const bool is_calm = w->nis <= restless_nis(d, w);
    if (!ipe_change_detector_is_misfit(d)) {
        ++d->n_contest;
        d->contest_square += fmin(w->nis, IPE_CHANGE_DETECTOR_NIS_LIMIT);
    }
    d->n_restless += !is_calm && d->n_restless < CALM_WINDOWS;
    d->n_calm = is_calm ? d->n_calm + 1 : 0;
    follow_step(d, w, payload_std, &last);
    if (knows_noise(d, w) && is_won(d, w, &last, payload_std)) {
        ++d->n_changes;
        ipe_change_detector_restart_after_change(d);
        return IPE_CHANGE_DETECTOR_CHANGE;
    }
    if (d->n_calm >= d->n_restless) {
        ++d->n_rejected;
        ipe_change_detector_restart(d);
        return IPE_CHANGE_DETECTOR_USE;
    }
    ++d->n_held;
    if (!ipe_change_detector_is_misfit(d)) { return IPE_CHANGE_DETECTOR_HOLD; }
    ++d->n_misfit;
    learn_level(d, w->nis);
    return IPE_CHANGE_DETECTOR_MISFIT;
}

ipe_change_detector_verdict_t ipe_change_detector_push(ipe_change_detector_t* d, const ipe_change_detector_window_t* w,
                                                       const double payload_std[IPE_NP])
{
    if (isnan(w->nis)) { return IPE_CHANGE_DETECTOR_USE; }
    d->n_since_change += d->n_since_change <= SAME_CHANGE;
    const bool is_suspected = d->n_contest == 0 && is_suspicious(d, w);
    if (is_suspected && d->n_since_change <= SAME_CHANGE) {
        d->cusum = 0.0;
        return IPE_CHANGE_DETECTOR_CHANGE;
    }
    if (is_suspected || d->n_contest > 0) { return compete(d, w, payload_std); }
    learn_level(d, w->nis);
    return IPE_CHANGE_DETECTOR_USE;
}

bool ipe_change_detector_is_evident(const ipe_change_detector_t* d, bool is_noise_known, const ipe_body_step_t* step,
                                    const ipe_body_step_fit_t* fit)
{
    const bool is_known = is_noise_known || is_level_safe(d);
    return is_evident(fit, step, level_of(d, is_noise_known), is_known ? SUDDEN_EVIDENCE : EVIDENCE_MIN);
}

double ipe_change_detector_scale(const ipe_change_detector_t* d, bool is_noise_known)
{
    return fmax(1.0, level_of(d, is_noise_known));
}

void ipe_change_detector_restart_after_change(ipe_change_detector_t* d)
{
    d->n_since_change = 0;
    ipe_change_detector_restart(d);
}

bool ipe_change_detector_is_contested(const ipe_change_detector_t* d)
{
    return d->n_contest > 0;
}

bool ipe_change_detector_is_misfit(const ipe_change_detector_t* d)
{
    return d->n_contest > CONTEST_WINDOWS;
}

double ipe_change_detector_inflation(const ipe_change_detector_t* d)
{
    const double of_contest = ipe_change_detector_is_misfit(d) ? d->contest_square / d->n_contest : 0.0;
    return fmax(1.0, fmax(d->level, of_contest) / IPE_NY);
}
