// SPDX-License-Identifier: Apache-2.0
/// The ten linear parameters <-> a body: mass, centre of gravity, inertia about it. No state, any thread.
///
///   theta = [m, h = m rho, J xx yy zz yz xz xy] about a reference point; rho from that point to C.
///   Shift of the point by d (new point to old):  h' = h + m d,
///     J' = J + 2 (d.h) E - h d^T - d h^T + m (|d|^2 E - d d^T)            linear in theta
///   J_C = J - (|h|^2 E - h h^T)/m
/// Source: firmware/DESIGN.md, "Body".
#ifndef IPE_BODY_H
#define IPE_BODY_H

#include "types.h"

typedef struct {
    double mass, mass_std;                      ///< kg
    double cog[3], cog_std[3];                  ///< from the reference point, m
    double inertia_cog[6], inertia_cog_std[6];  ///< about C, xx yy zz yz xz xy, matrix entries, kg m2
} ipe_body_t;

/// T [10][10] of the shift: theta about (old - d) = T theta about old; covariance T P T^T.
void ipe_body_shift_matrix(const double d[3], double T[IPE_NP][IPE_NP]);

/// x' = T x and, where P is not NULL, P' = T P T^T. In place.
void ipe_body_shift(const double d[3], double theta[IPE_NP], double P[IPE_NP][IPE_NP]);

/// Body of theta; its standard deviations from P [10][10] by the first-order Jacobian.
///
/// IPE_OK; IPE_ERR_RANGE: mass not positive, body untouched.
ipe_status_t ipe_body_from_theta(const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], ipe_body_t* body);

/// Derivative [10][10] of (m, rho, J_C) with respect to theta, m > 0.
void ipe_body_jacobian(const double theta[IPE_NP], double G[IPE_NP][IPE_NP]);

#endif
