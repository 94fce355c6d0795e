// SPDX-License-Identifier: Apache-2.0
/// Regressor, parameters and bodies. Same verbs as firmware/core/regressor.h, body.h and consistency.h.
#pragma once

#include "types.hpp"

#include <stdexcept>

extern "C" {
#include "body.h"
#include "consistency.h"
#include "regressor.h"
}

namespace inertiad {

/// Y with wrench = Y theta: s specific force, w rate, alpha angular acceleration at the reference point, P axes.
inline Regressor regressor(const Vector3& s, const Vector3& w, const Vector3& alpha) noexcept
{
    double ww[6];
    Regressor Y;
    ipe_rate_products(w.data(), ww);
    ipe_regressor(s.data(), ww, alpha.data(), as_array(Y));
    return Y;
}

/// theta about the point old - d.
inline Theta shift(Theta theta, const Vector3& d) noexcept
{
    ipe_body_shift(d.data(), theta.data(), nullptr);
    return theta;
}

/// Mass, CoG, inertia about it and their standard deviations. Throws std::domain_error if the mass is not positive.
inline ipe_body_t body(const Theta& theta, const Covariance& P)
{
    ipe_body_t out;
    if (ipe_body_from_theta(theta.data(), as_array(P), &out) != IPE_OK) {
        throw std::domain_error("mass is not positive");
    }
    return out;
}

inline PseudoInertia pseudo_inertia(const Theta& theta) noexcept
{
    PseudoInertia Pi;
    ipe_consistency_pseudo_inertia(theta.data(), as_array(Pi));
    return Pi;
}

/// Nearest parameters in the metric of P that a body can have, and the Mahalanobis distance squared to them. Throws
/// std::domain_error where the core finds none.
inline Theta nearest_body(const Theta& theta, const Covariance& P, double& distance)
{
    Theta q;
    if (!ipe_consistency_project(theta.data(), as_array(P), q.data(), &distance)) {
        throw std::domain_error("no body that can exist is near");
    }
    return q;
}

/// Can a body with these parameters exist?
inline bool is_consistent(const Theta& theta) noexcept
{
    return ipe_consistency_check(theta.data());
}

}  // namespace inertiad
