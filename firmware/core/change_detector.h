// SPDX-License-Identifier: Apache-2.0
/// Detection of a change of payload: the body before a suspected change and the one after it compete until one wins.
///
///   suspicion  the normalised innovation squared (NIS, 6 degrees of freedom) of a window exceeds 50, or
///              c = max(0, c + NIS - 2 level) exceeds 6 level (CUSUM); level: mean NIS of late
///   contest    windows are held back, so the body before stays what it was; body_step.h finds the body after
///   change     the body after explains the windows, far better than the one before, over long enough, and its mass differs:
///              the caller loosens the parameters
///   rejected   the body before explains the windows again, as many in a row as it did not, at most 5
///   misfit     neither did for 5 s: the contest goes on, the caller learns the noise and marks the estimate
/// While the load moves, the body after begins anew with each window; within a second of a change, a suspicion is the same
/// change going on: the parameters are loosened again at once. A push or friction is no step of a body: a body
/// explains one of the three components of force and two of the moment's, and explains them window after window.
/// Source: firmware/DESIGN.md, "Change"; Page, Biometrika 41, 1954. 1 KB of state, 10 ns, in a contest 20 us; one thread.
#ifndef IPE_CHANGE_DETECTOR_H
#define IPE_CHANGE_DETECTOR_H

#include "body_step.h"
#include "types.h"

/// NIS of a window that a change of payload explains better than noise: chi-squared with 6 degrees of freedom exceeds it
/// once in 2e8 windows. At rest it is the only test: unmodelled drift would accumulate in the CUSUM.
#define IPE_CHANGE_DETECTOR_NIS_LIMIT 50.0

/// Windows in a row, each of which alone shows a sudden change: chosen so that one of 20 % is found within 0.6 s.
#define IPE_CHANGE_DETECTOR_SUDDEN_WINDOWS 2

typedef enum {
    IPE_CHANGE_DETECTOR_USE = 0,
    IPE_CHANGE_DETECTOR_HOLD = 1,    ///< do not use: a contest runs
    IPE_CHANGE_DETECTOR_CHANGE = 2,  ///< use, with theta loosened
    IPE_CHANGE_DETECTOR_MISFIT = 3,  ///< do not use: neither body explains the windows of 5 s; learn the noise
} ipe_change_detector_verdict_t;

/// A window under the body before the change.
typedef struct {
    const double (*Y)[IPE_NP];  ///< regressor [6][10]
    const double* innovation;   ///< [6]
    const double (*S)[IPE_NY];  ///< its covariance by the states [6][6]
    const double (*L)[IPE_NY];  ///< factor of the noise's covariance [6][6]
    double nis;                 ///< ipe_change_detector_nis() of these
    double mass;                ///< of the body before, kg
    bool is_noise_known;        ///< L is learnt; if not, a window is suspicious at four times the limit
} ipe_change_detector_window_t;

typedef struct {
    double level;           ///< mean NIS of the windows used of late
    int n_level;            ///< windows that it is the mean of
    double cusum;
    int n_contest;          ///< windows of the contest that runs, 0: none
    int n_restless;         ///< those that the body before does not explain
    int n_calm;             ///< those in a row, up to now, that it explains
    int n_steps;            ///< those in a row, up to now, each of which alone shows a step of a body
    int n_since_change;     ///< windows since the last change, counted up to a second
    double contest_square;  ///< sum of the contest's NIS, 50 at most of each window
    ipe_body_step_t step;   ///< the body after
    uint64_t n_held;        ///< windows held back while a suspected payload change is decided
    uint64_t n_misfit;   ///< held windows after 5 s in which neither body explained them; the noise is learnt from them
    uint64_t n_changes;  ///< payload changes: the body after explains the windows far better than the one before
    uint64_t n_rejected;  ///< suspected payload changes that were none: the body before explains the windows again
} ipe_change_detector_t;

void ipe_change_detector_init(ipe_change_detector_t* d);

/// A gap: the contest that runs is over, undecided.
void ipe_change_detector_restart(ipe_change_detector_t* d);

/// NIS of an innovation [6] with covariance S [6][6] from the states and L L^T from the noise. NaN if that is singular.
double ipe_change_detector_nis(const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                               const double L[IPE_NY][IPE_NY]);

/// What to do with this window. payload_std [10]: one sigma of a payload's parameters about the IMU. A NIS of NaN says
/// nothing: the filter will refuse that window.
ipe_change_detector_verdict_t ipe_change_detector_push(ipe_change_detector_t* d, const ipe_change_detector_window_t* w,
                                                       const double payload_std[IPE_NP]);

/// Does this step of a body explain its windows, and far better than none, as a sudden change must? fit: solved with the scale
/// below. is_noise_known as in ipe_change_detector_window_t: if not, that scale is larger and less evidence has to do. No state
/// is changed.
bool ipe_change_detector_is_evident(const ipe_change_detector_t* d, bool is_noise_known, const ipe_body_step_t* step,
                                    const ipe_body_step_fit_t* fit);

/// Noise scale that steps are solved with, ipe_body_step_solve(): mean NIS of late, at least 1; no unit. As long as the noise is
/// neither known nor plainly as declared, at least 4.
double ipe_change_detector_scale(const ipe_change_detector_t* d, bool is_noise_known);

/// A change was found elsewhere: the contest that runs is over, and a suspicion within the next second is the same change.
void ipe_change_detector_restart_after_change(ipe_change_detector_t* d);

/// A contest runs.
bool ipe_change_detector_is_contested(const ipe_change_detector_t* d);

/// A contest runs, and neither body explained the windows for 5 s.
bool ipe_change_detector_is_misfit(const ipe_change_detector_t* d);

/// By what the states' variances are too small, at least 1: mean NIS of the contest, or of late, over its expectation.
double ipe_change_detector_inflation(const ipe_change_detector_t* d);

#endif
