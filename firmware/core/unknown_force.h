// SPDX-License-Identifier: Apache-2.0
/// A cable whose force sensor has failed pulls with a force that is an unknown of every window.
///
/// What is read is held at r, the cable pulls with r + d(t), so the window's wrench lacks the mean of phi d w, w: cable j's
/// column of the wrench matrix. With d = d_0 + d_1 (t - middle) over the window:
///   y = H x + d_0 wbar + d_1 v wdot + e,    v = length^2/48: variance of the kernel (window.h)
/// d_1 comes from the forces of this window and the last; d_0 is unknown: the noise's covariance becomes
/// C + sum_j sigma_j^2 wbar_j wbar_j^T with a sigma_j so large that the window says nothing along wbar. Each such cable costs
/// one of the window's 6 equations. wbar and wdot by two wrench matrices, one deviation of the kernel to either
/// side of the mean pose.
/// Source: firmware/DESIGN.md, "Failed force sensors". No state, 3 us, any thread.
#ifndef IPE_UNKNOWN_FORCE_H
#define IPE_UNKNOWN_FORCE_H

#include "config.h"
#include "window.h"

enum { IPE_UNKNOWN_FORCE_MAX = 4 };  ///< cables: chosen so that a third of the equations is left

/// The columns of one window, for forces as the sensors read them, gains included.
typedef struct {
    int n;
    int cable[IPE_UNKNOWN_FORCE_MAX];
    double mean[IPE_UNKNOWN_FORCE_MAX][IPE_NY];    ///< wbar
    double turned[IPE_UNKNOWN_FORCE_MAX][IPE_NY];  ///< v wdot
} ipe_unknown_force_t;

/// Columns of a window's unknown forces; none where average->unknown_force is 0.
///
/// IPE_OK; IPE_ERR_RANGE: more than IPE_UNKNOWN_FORCE_MAX; IPE_ERR_GEOMETRY: a cable has no direction. u not usable then.
ipe_status_t ipe_unknown_force_columns(const ipe_config_t* config, const ipe_average_t* average,
                                       ipe_unknown_force_t* u);

/// Take the unknown forces of a window out of its equations.
///
///   S           in      covariance of the innovation from the states [6][6]
///   innovation  in/out  [6]; out: less wbar times the most probable d_0, with 6 - u->n degrees of freedom
///   y           in/out  [6]; out: likewise
///   excess      out     [u->n] what was read beyond the most probable, -d_0, N
///   L           in/out  factor of the noise's covariance [6][6]; out: of that with the unknown forces
///
/// IPE_OK; IPE_ERR_NONFINITE: a covariance is not positive definite, the outputs are not usable.
ipe_status_t ipe_unknown_force_take_out(const ipe_unknown_force_t* u, const double S[IPE_NY][IPE_NY],
                                        double innovation[IPE_NY], double y[IPE_NY],
                                        double excess[IPE_UNKNOWN_FORCE_MAX], double L[IPE_NY][IPE_NY]);

#endif
