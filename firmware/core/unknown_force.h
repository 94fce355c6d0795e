// SPDX-License-Identifier: Apache-2.0
/// A cable whose force sensor has failed pulls with a force that is an unknown of every window:
///   y = H x + sum_j w_j d_j + e      w_j: cable j's column of the wrench matrix, d_j: its force less what was read
/// so the noise's covariance becomes C + sum_j sigma_j^2 w_j w_j^T with a sigma_j so large that nothing is said along w_j any
/// more: one of the window's 6 equations is given up for each such cable, whatever their number. Within a window W turns by
/// some mrad, which leaves less than 0.1 N of d_j, so the column of the window's middle is used.
/// Source: firmware/DESIGN.md, "Failed force sensors". No state, 1 us per cable, any thread.
#ifndef IPE_UNKNOWN_FORCE_H
#define IPE_UNKNOWN_FORCE_H

#include "types.h"

/// Take the unknown forces of a window out of its equations.
///
///   unknown     in      bit j: cable j's
///   X           in      systematic columns, systematic.h
///   S           in      covariance of the innovation from the states [6][6]
///   innovation  in/out  [6]; out: less w_j times the most probable d_j, with 6 minus their number degrees of freedom
///   y           in/out  [6]; out: likewise
///   excess      out     -d_j of the unknown ones as the sensor would read it, N; [IPE_CABLES_MAX], 0 for the others
///   L           in/out  factor of the noise's covariance [6][6]; out: of that with the unknown forces
///
/// IPE_OK; IPE_ERR_NONFINITE: a covariance is not positive definite, nothing changed.
ipe_status_t ipe_unknown_force_take_out(uint32_t unknown, const double X[IPE_NY][IPE_XI_MAX],
                                        const double S[IPE_NY][IPE_NY], double innovation[IPE_NY], double y[IPE_NY],
                                        double excess[IPE_CABLES_MAX], double L[IPE_NY][IPE_NY]);

/// How many cables.
int ipe_unknown_force_count(uint32_t unknown);

#endif
