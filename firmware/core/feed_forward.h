// SPDX-License-Identifier: Apache-2.0
/// The wrench that a wanted motion takes, from the body's parameters: what a controller feeds forward.
///
///   wrench = Y(s, w, alpha) theta,   s = R^T (a + g z)         about P, platform axes; d(wrench)/d(theta) = Y
/// Source of Y: regressor.h. No state, any thread, 20 ns.
#ifndef IPE_FEED_FORWARD_H
#define IPE_FEED_FORWARD_H

#include "types.h"

/// Force and moment about P that the cables must give.
///
///   theta    in   m, h, J about P, P axes; as parameter_gate.h gives them
///   R        in   P to W
///   a        in   of P, W, m/s2
///   w, alpha in   rate and angular acceleration, P axes, rad/s, rad/s2
///   gravity  in   along -z of W, m/s2
///   wrench   out  [6] N, N m, platform axes
///   Y        out  [6][10] its derivative to theta; NULL: not wanted
void ipe_feed_forward(const double theta[IPE_NP], const double R[3][3], const double a[3], const double w[3],
                      const double alpha[3], double gravity, double wrench[IPE_NY], double Y[IPE_NY][IPE_NP]);

#endif
