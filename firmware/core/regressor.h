// SPDX-License-Identifier: Apache-2.0
/// The rigid body's equations of motion, linear in its ten inertial parameters.
///
///   theta = [m, h = m rho, J_xx J_yy J_zz J_yz J_xz J_xy], all about the point I, matrix entries of J
///   F   = m s + ([alpha]x + [w]x[w]x) h
///   tau = h x s + L(alpha) J + w x L(w) J,      L(w) J = J w
/// with s the specific force at I (what an ideal accelerometer there reads), w the rate, alpha its derivative, F and tau
/// the cables' force and moment at I; everything in platform axes. Gravity needs no attitude: it is in s.
/// Y is linear in s, alpha and the products w w^T, so it may be built from weighted averages of them.
/// Source: Atkeson, An, Hollerbach, IJRR 5(3), 1986; firmware/DESIGN.md, "Body". No state, any thread, 10 ns.
#ifndef IPE_REGRESSOR_H
#define IPE_REGRESSOR_H

#include "types.h"

/// Y [6][10] from s [3], ww = w w^T as xx yy zz yz xz xy [6], alpha [3].
void ipe_regressor(const double s[3], const double ww[6], const double alpha[3], double Y[IPE_NY][IPE_NP]);

/// ww [6] of a rate w [3].
void ipe_rate_products(const double w[3], double ww[6]);

#endif
