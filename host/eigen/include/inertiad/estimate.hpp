// SPDX-License-Identifier: Apache-2.0
/// From a solution about the IMU to the published estimate. Same rules, same verbs as firmware/core/estimate.h.
#pragma once

#include "config.hpp"

#include <stdexcept>

extern "C" {
#include "estimate.h"
#include "prior.h"
}

namespace inertiad {

/// Theta and P about the IMU under the configured prior; no spurious information, std_geometry as configured.
inline ipe_solution_t solution(const Config& config, const Theta& theta, const Covariance& P) noexcept
{
    ipe_solution_t s{};
    Eigen::Map<Theta>(s.theta) = theta;
    Eigen::Map<Covariance>(&s.covariance[0][0]) = P;
    ipe_prior_at_imu(&config.c(), s.prior_theta, s.prior_covariance);
    s.std_geometry = config.c().std_geometry;
    s.inflation = 1.0;
    s.std_common_gain = ipe_filter_states_common_gain_std(&config.c());
    return s;
}

/// Publish under the configured prior, or under another body's standard deviations; measured: theta about P, unprojected.
/// Throws std::domain_error where no physically consistent body is near.
inline ipe_estimate_t publish(const Config& config, const ipe_solution_t& s, const ipe_body_t* prior_body = nullptr,
                              double* measured = nullptr)
{
    ipe_body_t configured;
    ipe_estimate_prior_body(&config.c(), &configured);
    ipe_estimate_t e{};
    if (ipe_estimate_publish(&config.c(), &s, prior_body != nullptr ? prior_body : &configured, measured, &e) !=
        IPE_OK) {
        throw std::domain_error("no physically consistent body is near the estimate");
    }
    return e;
}

}  // namespace inertiad
