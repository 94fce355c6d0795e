// SPDX-License-Identifier: Apache-2.0
/// Recursive least squares in factored form: P = U D U^T, Bierman's measurement update, no square root.
///
///   y = H x + e,  e ~ N(0, 1) per whitened scalar row.   Per row (h, y):
///   f = U^T h,  g = D f,  a_0 = 1;  for j:  a_j = a_{j-1} + f_j g_j,  d_j *= a_{j-1}/a_j,
///       lambda = -f_j/a_{j-1},  for i < j: (U_ij, b_i) = (U_ij + b_i lambda, b_i + g_j U_ij old),  b_j = g_j
///   x += b (y - h x)/a_n.   a_n is the innovation's variance.
/// Equals batch least squares with the prior as extra rows; stays positive definite in double over 1e7 updates.
/// Source: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. V; firmware/DESIGN.md, "Filter".
/// 0.7 KB of state, 0.1 us per row of 10 parameters, no heap, one thread.
#ifndef IPE_RLS_H
#define IPE_RLS_H

#include "types.h"

enum { IPE_NU = IPE_NP * (IPE_NP - 1) / 2 };

typedef struct {
    double x[IPE_NP];       ///< the parameters
    double U[IPE_NU];       ///< unit upper triangle of P's factor by columns: U_ij (i < j) at j (j - 1)/2 + i
    double D[IPE_NP];       ///< its diagonal, > 0

    uint64_t n_updates;     ///< blocks of rows folded in
    uint64_t n_nonfinite;   ///< blocks refused: NaN or Inf
} ipe_rls_t;

/// Start from the prior x [10], P [10][10].
///
/// IPE_OK; IPE_ERR_CONFIG: P is not positive definite, state not usable.
ipe_status_t ipe_rls_init(ipe_rls_t* s, const double x[IPE_NP], const double P[IPE_NP][IPE_NP]);

/// Fold in one block of 6 equations y = Y x + e, e ~ N(0, C), C = L L^T.
///
///   Y    in   [6][10]
///   y    in   [6]
///   L    in   [6][6] lower Cholesky factor of C
///   nis  out  sum of squared normalised innovations: chi-squared with 6 degrees of freedom
///
/// IPE_OK, or IPE_ERR_NONFINITE: an input is NaN or Inf, state untouched but for the counter. About 1 us.
ipe_status_t ipe_rls_update(ipe_rls_t* s, const double Y[IPE_NY][IPE_NP], const double y[IPE_NY],
                            const double L[IPE_NY][IPE_NY], double* nis);

/// P [10][10] = U D U^T, symmetric.
void ipe_rls_covariance(const ipe_rls_t* s, double P[IPE_NP][IPE_NP]);

/// True unless the state was corrupted: D positive, everything finite.
bool ipe_rls_invariants_hold(const ipe_rls_t* s);

#endif
