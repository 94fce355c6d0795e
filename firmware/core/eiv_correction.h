// SPDX-License-Identifier: Apache-2.0
/// Correction of the estimate for noise in the regressor.
///
/// Y is measured, too: white noise of the accelerometer and, through the kernel's slope, of the gyro stands in the columns of
/// h and J. Least squares takes it for excitation, draws the parameters towards zero and is sure of it (errors in variables:
/// the inertia of a slow 5 t platform 30 % small at ten times its sigma, of one that never turns anything but its own). The
/// information that the noise pretends,
///   C = sum over windows and noise channels k of var_k (dY/dk)^T V^-1 (dY/dk)
/// is known, so at publication it is taken back:
///   theta -> T theta,  P -> T P T^T,  T = (P^-1 - C)^-1 P^-1
/// along the eigenvectors of C in the metric of P. Where that leaves less than was known before the data, what was known
/// before is published. C is known to a tenth; what that makes of the correction is added to P. The filter's own state
/// stays least squares.
/// What shakes the platform, such as a motor or a stiff cable, looks like noise to noise_density.h, and is none: the cables
/// pull with it. Noise of channel k leaves residuals, (dY/dk) theta, so var_k is at most what leaves as much as V says.
/// Source: Fuller, Measurement Error Models, 1987, section 2.2 (corrected normal equations). 28 B of state, 20 us.
#ifndef IPE_EIV_CORRECTION_H
#define IPE_EIV_CORRECTION_H

#include "types.h"
#include "window.h"

typedef struct {
    float sum
        [IPE_NOISE_DENSITY_CHANNELS];  ///< over windows: variance of their s, m2/s4, and of their alpha, rad2/s4, over level
    float n;                           ///< windows, over level
} ipe_eiv_correction_t;

/// The window's equations have been used, whitened with a covariance that is `level` times some fixed one.
void ipe_eiv_correction_add(ipe_eiv_correction_t* a, const ipe_average_t* average, double level);

/// Older windows count less by factor lambda.
void ipe_eiv_correction_forget(ipe_eiv_correction_t* a, double lambda);

/// Theta has been loosened: the filter knows the share `mass` of what it knew of m and h, and the share `inertia` of J; so
/// much is left of what the noise pretends. The channels of s act on m and h, those of alpha on J; both 0 .. 1.
void ipe_eiv_correction_loosen(ipe_eiv_correction_t* a, double mass, double inertia);

/// Add what the noise pretended to know of theta about the IMU, to C.
///
///   L      factor of the equations' covariance, which is `level` times that fixed one
///   theta  about the IMU, as the filter has it
void ipe_eiv_correction_information(const ipe_eiv_correction_t* a, const double L[IPE_NY][IPE_NY], double level,
                                    const double theta[IPE_NP], double C[IPE_NP][IPE_NP]);

/// Correct theta and its covariance P, both in place, for C.
///
///   prior_theta, prior  mean and covariance before the data
void ipe_eiv_correction_undo(const double C[IPE_NP][IPE_NP], const double prior_theta[IPE_NP],
                             const double prior[IPE_NP][IPE_NP], double theta[IPE_NP], double P[IPE_NP][IPE_NP]);

#endif
