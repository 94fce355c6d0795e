// SPDX-License-Identifier: Apache-2.0
/// The step of theta that explains innovations best: how much better than no step, and how well at all.
///
///   e_k = Y_k d + noise,  noise ~ N(0, s V_k),  d ~ N(0, diag(std^2)),  V_k = S_k + L L^T
/// e_k is the innovation of window k under the body before the step, Y_k the regressor; std is what the cables can carry.
/// The sums A = sum Y^T V^-1 Y, b = sum Y^T V^-1 e and sum e^T V^-1 e hold all that the windows say about d. With the
/// normalised innovation squared as the sum of an explained and a remaining part, D + Q, the scale s = Q/(6 K - 10), but
/// at least a given one, is what the noise would be if the model with the step were right (Birge), and
///   log-likelihood ratio = (D - ln det(1 + A diag(std^2)/s)) / 2,   D taken with s
/// compares a body with this step and one without; the determinant is the penalty for ten more unknowns.
/// Source: Willsky, Jones, IEEE Trans. Automatic Control 21(1), 1976; firmware/DESIGN.md, "Change". 0.9 KB, 2 us per window.
#ifndef IPE_BODY_STEP_H
#define IPE_BODY_STEP_H

#include "types.h"

/// Sums over the windows since the onset.
typedef struct {
    double information[IPE_NP][IPE_NP];  ///< sum Y^T V^-1 Y, lower triangle
    double projected[IPE_NP];            ///< sum Y^T V^-1 e
    double square;                       ///< sum e^T V^-1 e
    int n_windows;
} ipe_body_step_t;

/// The best step.
typedef struct {
    double theta[IPE_NP];         ///< about the IMU
    double log_likelihood_ratio;  ///< of the body with it against that without
    double remaining;             ///< Q
    double misfit;                ///< Q over its degrees of freedom: at most about 1 where the step explains all
    double first_moments;         ///< squared Mahalanobis length of its mass and first moments, 4 degrees of freedom
} ipe_body_step_fit_t;

/// No window yet.
void ipe_body_step_start(ipe_body_step_t* s);

/// Add a window: regressor Y [6][10], innovation [6], covariances of the states' part S [6][6] and, as L L^T, of the noise.
/// False, s as it was, if a value is not finite or the covariance singular.
bool ipe_body_step_add(ipe_body_step_t* s, const double Y[IPE_NY][IPE_NP], const double innovation[IPE_NY],
                       const double S[IPE_NY][IPE_NY], const double L[IPE_NY][IPE_NY]);

/// The best step, with one sigma std [10] of its entries beforehand, > 0, and noise of at least this scale, > 0. Needs a
/// window.
void ipe_body_step_solve(const ipe_body_step_t* s, const double std[IPE_NP], double scale, ipe_body_step_fit_t* fit);

/// The same for a step of known direction d [10] and unknown size: share times d, share ~ N(0, 1) beforehand. first_moments
/// is then the squared Mahalanobis length of the whole step.
///
///   share, share_std  out  0 and 1 where the windows say nothing about d
void ipe_body_step_along(const ipe_body_step_t* s, const double d[IPE_NP], double scale, ipe_body_step_fit_t* fit,
                         double* share, double* share_std);

#endif
