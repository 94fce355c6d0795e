// SPDX-License-Identifier: Apache-2.0
/// How noisy the weak equations really are: the long-run variance of their innovations, learnt while running.
///
/// Windows overlap and slow errors (attitude wander, cable swing) last over many of them, so their residuals are far from
/// independent. What a sum of N correlated residuals varies by is N times the long-run variance
///   v = r_0 + 2 sum_{k=1..25} (1 - k/26) r_k                                 (Bartlett weights)
/// and a filter that assumes independent rows is honest when it is given v instead of r_0. v is averaged over the windows
/// whose innovation says something about the noise (its variance from the states is the smaller part), together with the
/// configured covariance, which counts for 10 windows and gives the channels' correlation.
/// Source: Newey, West, Econometrica 55(3), 1987; firmware/DESIGN.md, "Noise". 1.6 KB of state, 0.1 us per window.
#ifndef IPE_NOISE_H
#define IPE_NOISE_H

#include "types.h"

typedef struct {
    double prior[IPE_NY];                ///< diagonal of the configured covariance
    double factor[IPE_NY][IPE_NY];       ///< its Cholesky factor
    double sum[IPE_NY];                  ///< of the windows' contributions to v
    uint64_t n_summed;
    float past[IPE_NOISE_LAGS][IPE_NY];  ///< innovations, window k at k % IPE_NOISE_LAGS
    uint64_t n_past;
    double L[IPE_NY][IPE_NY];            ///< factor of the covariance to whiten with
} ipe_noise_t;

/// Start from the configured covariance C [6][6]. IPE_OK, or IPE_ERR_CONFIG: not positive definite.
ipe_status_t ipe_noise_init(ipe_noise_t* s, const double C[IPE_NY][IPE_NY]);

/// Learn from a window's innovation [6], of whose covariance S [6][6] comes from the states; L is up to date afterwards.
void ipe_noise_push(ipe_noise_t* s, const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY]);

/// Weight in (0, 1] of a window whose innovation has the normalised square nis, by 6 degrees of freedom: one that stands out
/// counts for less, as if its noise covariance were 1 / weight times larger (Huber 1964). Only for a noise that is learnt.
double ipe_noise_weight(double nis);

/// Geometric mean over the channels of the variance to whiten with, in units of the configured one.
double ipe_noise_level(const ipe_noise_t* s);

/// A gap: the next window does not follow the last.
void ipe_noise_restart(ipe_noise_t* s);

#endif
