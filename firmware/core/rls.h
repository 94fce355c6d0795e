// SPDX-License-Identifier: Apache-2.0
/// Recursive least squares in factored form: P = U D U^T, Bierman's measurement update, no square root.
///
///   y = H x + e,  e ~ N(0, C).   Rows are whitened by C = L L^T; then per scalar row (h, y) of unit variance:
///   f = U^T h,  g = D f,  a_0 = 1;  for j:  a_j = a_{j-1} + f_j g_j,  d_j *= a_{j-1}/a_j,
///       lambda = -f_j/a_{j-1},  for i < j: (U_ij, b_i) = (U_ij + b_i lambda, b_i + g_j U_ij old),  b_j = g_j
///   x += b (y - h x)/a_n.   a_n is the innovation's variance.
/// Equals batch least squares with the prior as extra rows; stays positive definite in double over 1e7 updates.
/// The first IPE_NP states are theta; filter_states.h names the others.
/// Source: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. V; firmware/DESIGN.md, "Filter".
/// n (n + 3) 4 bytes in use: 9.0 KB for 8 cables; 3/2 n^2 multiplications per row; no heap, one thread.
#ifndef IPE_RLS_H
#define IPE_RLS_H

#include "types.h"

typedef struct {
    int n;                 ///< states, IPE_NP .. IPE_NX_MAX
    double x[IPE_NX_MAX];  ///< the states
    double D[IPE_NX_MAX];  ///< diagonal of P's factor, > 0
    double U[IPE_NU_MAX];  ///< unit upper triangle by columns: U_ij (i < j) at j (j - 1)/2 + i

    uint64_t n_updates;    ///< blocks of rows folded in
    uint64_t n_nonfinite;  ///< blocks refused: NaN, Inf or absurdly large
} ipe_rls_t;

/// Start from the prior theta [10], P [10][10] and n_xi further states, 0 +- xi_std [n_xi], independent of all others.
///
/// IPE_OK; IPE_ERR_CONFIG: n_xi not 0 .. IPE_NX_MAX - IPE_NP, P not positive definite or a xi_std not positive; state not
/// usable.
ipe_status_t ipe_rls_init(ipe_rls_t* s, const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], int n_xi,
                          const double* xi_std);

/// Innovations y - H x [6] and their covariance from the states alone, S = H P H^T [6][6]. H [6][n]. State untouched.
void ipe_rls_innovation(const ipe_rls_t* s, const double* H, const double y[IPE_NY], double innovation[IPE_NY],
                        double S[IPE_NY][IPE_NY]);

/// Fold in one block of 6 equations y = H x + e, e ~ N(0, L L^T).
///
///   H    in   [6][n]; out: L^-1 H
///   y    in   [6]
///   L    in   [6][6] lower triangular, diagonal > 0
///   nis  out  sum of squared normalised innovations: chi-squared with 6 degrees of freedom
///
/// IPE_OK, or IPE_ERR_NONFINITE: an input is NaN, Inf or over 1e15 standard deviations; state untouched but for the
/// counter.
ipe_status_t ipe_rls_update(ipe_rls_t* s, double* H, const double y[IPE_NY], const double L[IPE_NY][IPE_NY],
                            double* nis);

/// The first half of ipe_rls_update(), which says what the arguments are: H becomes L^-1 H, z [6] = L^-1 y. Status as there.
ipe_status_t ipe_rls_whiten(ipe_rls_t* s, double* H, const double y[IPE_NY], const double L[IPE_NY][IPE_NY],
                            double z[IPE_NY]);

/// The second half: fold in the whitened equations z = H x. Returns nis.
double ipe_rls_update_whitened(ipe_rls_t* s, const double* H, const double z[IPE_NY]);

/// Fold in one scalar row h x = y of unit variance, h [n]. Costs less the fewer entries lie between the first that is not 0
/// and the end.
void ipe_rls_update_row(ipe_rls_t* s, const double* h, double y);

/// Older data counts less: P /= lambda, 0 < lambda <= 1.
void ipe_rls_forget(ipe_rls_t* s, double lambda);

/// State i may have moved: P_ii += variance. Source: Agee, Turner, 1972; cost i^2.
void ipe_rls_loosen(ipe_rls_t* s, int i, double variance);

/// The prior of state i was 0 +- std and should have been 0 +- wider: as if it had been from the start, exactly, by an
/// update with negative variance. Where the data say next to nothing about the state it is loosened instead.
void ipe_rls_widen_prior(ipe_rls_t* s, int i, double std, double wider);

/// State i fades: x_i *= factor, its row and column of P as well; factor > 0.
void ipe_rls_fade(ipe_rls_t* s, int i, double factor);

/// P [n][n] = U D U^T, symmetric; only the first rows x rows are computed and written, as [rows][rows].
void ipe_rls_covariance(const ipe_rls_t* s, int rows, double* P);

/// Covariance of states i and k.
double ipe_rls_covariance_of(const ipe_rls_t* s, int i, int k);

/// Standard deviation of state i.
double ipe_rls_std(const ipe_rls_t* s, int i);

/// True unless the state was corrupted: D positive, everything finite.
bool ipe_rls_invariants_hold(const ipe_rls_t* s);

#endif
