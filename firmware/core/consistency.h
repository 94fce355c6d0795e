// SPDX-License-Identifier: Apache-2.0
/// Can a body with these ten parameters exist? No state, any thread.
///
/// It can if and only if its pseudo-inertia is positive definite:
///   Pi = [ tr(J)/2 E - J , h ; h^T , m ]
/// Source: Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018; firmware/DESIGN.md, "Consistency".
#ifndef IPE_CONSISTENCY_H
#define IPE_CONSISTENCY_H

#include "types.h"

enum {
    IPE_CONSISTENCY_CUTS_MAX = 40
};  ///< measured: of 52,486 impossible estimates 13 need more than 24, none more than 40

/// A search for the nearest consistent parameters, between two parts of it.
typedef struct {
    double q[IPE_NP];                             ///< the nearest so far
    double length, margin;                        ///< m, radius of gyration; kg m2, smallest eigenvalue aimed at
    double v[IPE_CONSISTENCY_CUTS_MAX][4];        ///< cut k: v_k^T Pi(q) v_k >= margin,
    double multiplier[IPE_CONSISTENCY_CUTS_MAX];  ///< and its multiplier
    int n, n_sweeps;                              ///< cuts; sweeps over them since the last was added
    bool is_sweeping;                             ///< the multipliers do not stand still yet
} ipe_projection_t;

/// Pi [4][4] of theta = [m, h, J about the same point].
void ipe_consistency_pseudo_inertia(const double theta[IPE_NP], double Pi[4][4]);

/// True if Pi is positive definite, by its Cholesky factor. False for NaN and Inf. 0.1 us.
bool ipe_consistency_check(const double theta[IPE_NP]);

/// The nearest parameters, in the metric of P, of a body that can exist.
///
/// Minimises (q - theta)^T P^-1 (q - theta) subject to v^T Pi(q) v >= eps for the eigenvectors v that violate it, cut by
/// cut (Hildreth), until Pi(q), with lengths in radii of gyration, has no eigenvalue below half of eps, 0.002 of its trace.
///
///   distance  out  Mahalanobis distance squared moved: over 21.7 (99 % of 10 degrees of freedom) data and model disagree
///
/// True: q [10] is consistent (theta itself, distance 0, if it was already). False: no such q found in 40 cuts or theta is
/// not finite; q is theta. About 2 us per cut. Source: Hildreth 1957; firmware/DESIGN.md, "Consistency".
bool ipe_consistency_project(const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], double q[IPE_NP],
                             double* distance);

/// The same in parts. IPE_OK: theta is consistent, and is search->q; IPE_UNFINISHED: ipe_consistency_go_on(); IPE_ERR_NONFINITE.
ipe_status_t ipe_consistency_begin(const double theta[IPE_NP], ipe_projection_t* search);

/// IPE_UNFINISHED: call again; IPE_OK: search->q and distance are as of ipe_consistency_project(); IPE_ERR_NONFINITE: no such q found.
ipe_status_t ipe_consistency_go_on(const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], ipe_projection_t* search,
                                   double* distance);

#endif
