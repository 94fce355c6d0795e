// SPDX-License-Identifier: Apache-2.0
/// Can a body with these ten parameters exist? No state, any thread.
///
/// It can if and only if its pseudo-inertia is positive definite:
///   Pi = [ tr(J)/2 E - J , h ; h^T , m ]
/// Source: Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018; firmware/DESIGN.md, "Consistency".
#ifndef IPE_CONSISTENCY_H
#define IPE_CONSISTENCY_H

#include "types.h"

/// Pi [4][4] of theta = [m, h, J about the same point].
void ipe_consistency_pseudo_inertia(const double theta[IPE_NP], double Pi[4][4]);

/// True if Pi is positive definite, by its Cholesky factor. False for NaN. 0.1 us.
bool ipe_consistency_check(const double theta[IPE_NP]);

#endif
