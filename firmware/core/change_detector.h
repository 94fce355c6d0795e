// SPDX-License-Identifier: Apache-2.0
/// Has the payload changed? The body before a suspected change and the one after it compete until one wins.
///
///   suspicion   normalised innovation squared (NIS, 6 degrees of freedom) of a window > 50: sudden;
///               c = max(0, c + NIS - 12) > 60: a small one that stays (CUSUM)
///   contest     windows are held back, so the body before stays as it was; body_step.h finds the body after
///   change      the body after explains the windows, clearly better, over long enough: the caller loosens the parameters
///   rejected    the body before explains them again, or neither did for 5 s
/// While the load moves the body after begins anew with each window. Where neither body explains the windows, the noise
/// is larger than learnt: a while without contests follows, in which the caller learns it.
/// Source: firmware/DESIGN.md, "Change"; Page, Biometrika 41, 1954. 1 KB of state, 0.1 us, in a contest 5 us; one thread.
#ifndef IPE_CHANGE_DETECTOR_H
#define IPE_CHANGE_DETECTOR_H

#include "body_step.h"
#include "types.h"

/// NIS of a window that a change of payload explains better than noise: chi-squared with 6 degrees of freedom exceeds it
/// once in 2e8 windows. At rest it is the only test: unmodelled drift would accumulate in the CUSUM.
#define IPE_CHANGE_DETECTOR_NIS_LIMIT 50.0

typedef enum {
    IPE_CHANGE_DETECTOR_USE = 0,
    IPE_CHANGE_DETECTOR_HOLD = 1,
    IPE_CHANGE_DETECTOR_CHANGE = 2
} ipe_change_detector_verdict_t;

typedef struct {
    double level;          ///< mean NIS of late
    int n_level;
    double cusum;
    int n_contest;         ///< windows of the contest that runs, 0: none
    int n_restless;        ///< those that the body before does not explain
    int n_calm;            ///< those in a row, up to now, that it explains
    int n_settling;        ///< windows left in which no contest begins
    ipe_body_step_t step;  ///< the body after
    uint64_t n_held;       ///< windows held back
    uint64_t n_changes;    ///< contests that the body after won
    uint64_t n_rejected;   ///< contests that it lost
} ipe_change_detector_t;

void ipe_change_detector_init(ipe_change_detector_t* d);

/// A gap, or a new filter: the contest that runs is over, undecided.
void ipe_change_detector_restart(ipe_change_detector_t* d);

/// NIS of an innovation [6] with covariance S [6][6] from the states and L L^T from the noise. NaN if that is singular.
double ipe_change_detector_nis(const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                               const double L[IPE_NY][IPE_NY]);

/// A window under the body before.
typedef struct {
    const double (*Y)[IPE_NP];      ///< regressor [6][10]
    const double* innovation;       ///< [6]
    const double (*S)[IPE_NY];      ///< its covariance by the states [6][6]
    const double (*L)[IPE_NY];      ///< factor of the noise's covariance [6][6]
    double nis, mass;
} ipe_change_detector_window_t;

/// What to do with this window; payload_std [10] is one sigma of a payload's parameters about the IMU. A NIS of NaN tells
/// nothing: the filter will refuse that window.
ipe_change_detector_verdict_t ipe_change_detector_push(ipe_change_detector_t* d, const ipe_change_detector_window_t* w,
                                                       const double payload_std[IPE_NP]);

#endif
