// SPDX-License-Identifier: Apache-2.0
/// Has the payload changed? Two tests on the normalised innovation squared (NIS) of each window, 6 degrees of freedom.
///
///   NIS > 50                              a sudden change
///   c = max(0, c + NIS - 12) > 60         a small one that stays (CUSUM)
/// The first window that stands out is held back, unused: a disturbance that is over by the next one is no payload. A
/// second in a row is a change. The alarm repeats while the load moves; each time the caller loosens the parameters.
/// Source: firmware/DESIGN.md, "Change"; Page, Biometrika 41, 1954. 32 B of state, 0.1 us, one thread.
#ifndef IPE_CHANGE_DETECTOR_H
#define IPE_CHANGE_DETECTOR_H

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
    double cusum;
    int n_outstanding;   ///< windows in a row with NIS over its limit
    uint64_t n_held;     ///< windows held back
    uint64_t n_changes;  ///< alarms
} ipe_change_detector_t;

void ipe_change_detector_init(ipe_change_detector_t* d);

/// NIS of an innovation [6] with covariance S [6][6] from the states and L L^T from the noise. NaN if that is singular.
double ipe_change_detector_nis(const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                               const double L[IPE_NY][IPE_NY]);

/// What to do with a window of this NIS. NaN tells nothing: the filter will refuse that window.
ipe_change_detector_verdict_t ipe_change_detector_push(ipe_change_detector_t* d, double nis);

#endif
