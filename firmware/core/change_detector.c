// SPDX-License-Identifier: Apache-2.0
#include "change_detector.h"

#include "smallmat.h"

#include <string.h>

#define CUSUM_DRIFT \
    12.0  // NIS, twice its mean of 6: chosen so that noise underrated by a factor of 1.4 raises no alarm
#define CUSUM_LIMIT 60.0  // NIS: chosen so that five windows at twice the drift raise the alarm (Page 1954)
void ipe_change_detector_init(ipe_change_detector_t* d)
{
    memset(d, 0, sizeof *d);
}

double ipe_change_detector_nis(const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                               const double L[IPE_NY][IPE_NY])
{
    double A[IPE_NY][IPE_NY];
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j <= i; ++j) {
            A[i][j] = S[i][j];
            for (int k = 0; k <= j; ++k) { A[i][j] += L[i][k] * L[j][k]; }
        }
    }
    if (!cholesky(&A[0][0], IPE_NY)) { return NAN; }
    double z[IPE_NY], nis = 0.0;
    for (int i = 0; i < IPE_NY; ++i) {
        z[i] = innovation[i];
        for (int k = 0; k < i; ++k) { z[i] -= A[i][k] * z[k]; }
        z[i] /= A[i][i];
        nis += z[i] * z[i];
    }
    return nis;
}

ipe_change_detector_verdict_t ipe_change_detector_push(ipe_change_detector_t* d, double nis)
{
    if (isnan(nis)) { return IPE_CHANGE_DETECTOR_USE; }
    d->n_outstanding = nis > IPE_CHANGE_DETECTOR_NIS_LIMIT ? d->n_outstanding + 1 : 0;
    if (d->n_outstanding == 1) {
        ++d->n_held;
        return IPE_CHANGE_DETECTOR_HOLD;
    }
    d->cusum = fmax(0.0, d->cusum + fmin(nis, IPE_CHANGE_DETECTOR_NIS_LIMIT) - CUSUM_DRIFT);
    if (d->n_outstanding == 0 && d->cusum <= CUSUM_LIMIT) { return IPE_CHANGE_DETECTOR_USE; }
    d->cusum = 0.0;
    ++d->n_changes;
    return IPE_CHANGE_DETECTOR_CHANGE;
}
