// SPDX-License-Identifier: Apache-2.0
/// What a controller feeds forward for a wanted motion: the wrench, and the cables' tensions. Same verb as
/// firmware/core/feed_forward.h; the distribution of the tensions is that of `inertiactl simulate`.
#pragma once

#include "distribution.hpp"

extern "C" {
#include "feed_forward.h"
}

namespace inertiad {

/// Force and moment about P that give a body theta the acceleration a of P (W, m/s2), at rate w and angular acceleration
/// alpha (P axes), in attitude R (P to W), with gravity g along -z of W. N, N m, platform axes. Y: its derivative to theta.
inline Vector6 feed_forward(const Theta& theta, const Matrix3& R, const Vector3& a, const Vector3& w,
                            const Vector3& alpha, double g, Regressor* Y = nullptr)
{
    Vector6 wrench;
    ipe_feed_forward(theta.data(), as_array(R), a.data(), w.data(), alpha.data(), g, wrench.data(),
                     Y != nullptr ? as_array(*Y) : nullptr);
    return wrench;
}

/// Tensions f [m] that give a wrench at the pose p (W, m), R, closest to an even pull of twice the weight's share and within
/// the limits of the configuration; mass: kg, of the body. False: there are none, f is cut off at the limits. Throws
/// std::domain_error as cable_line() does.
inline bool feed_forward_tensions(const Config& config, const Vector6& wrench, double mass, const Vector3& p,
                                  const Matrix3& R, Tensions& f)
{
    return distribute(config, TensionBand(config, mass), wrench, p, R, f);
}

}  // namespace inertiad
