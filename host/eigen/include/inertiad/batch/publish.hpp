// SPDX-License-Identifier: Apache-2.0
/// The published body of each group: the rules of firmware/core/estimate.h.
#pragma once

#include "../estimate.hpp"
#include "problem.hpp"

namespace inertiad::detail {

/// What noise of its runs' motion sensors does to a group's theta.
inline Problem::Pretended pretended(const Problem& problem, int group)
{
    Problem::Pretended sum;
    for (std::size_t r = 0; r < problem.runs.size(); ++r) {
        if (problem.runs[r].group != group) { continue; }
        sum.information += problem.spurious[r].information;
        sum.pull += problem.spurious[r].pull;
    }
    return sum;
}

/// One group's published body. The plain fit of theta alone is published without the errors-in-variables correction.
inline BatchBody publish_body(const Problem& problem, int group)
{
    const auto g = static_cast<std::size_t>(group);
    const Covariance F = problem.prior_rows[g].inverse(), prior = F * F.transpose();
    const Covariance P = problem.P.block<IPE_NP, IPE_NP>(IPE_NP * group, IPE_NP * group);
    const Problem::Pretended noise = pretended(problem, group);
    ipe_solution_t s = solution(problem.config, problem.theta[g] - P * noise.pull, P);
    Eigen::Map<Theta>(s.prior_theta) = problem.prior_mean[g];
    Eigen::Map<Covariance>(&s.prior_covariance[0][0]) = prior;
    Eigen::Map<Covariance>(&s.spurious[0][0]) = noise.information;
    if (problem.n_geometry > 0) { s.std_geometry = 0.0; }
    s.std_common_gain = problem.common_gain_std();
    BatchBody b{};
    const ipe_estimate_t e = publish(problem.config, s, &problem.prior_std_body[g], b.theta.data());
    b.theta_possible = Eigen::Map<const Theta>(e.theta);
    b.P = Eigen::Map<const Covariance>(&e.covariance[0][0]);
    b.body = e.body;
    b.prior = problem.prior_std_body[g];
    b.is_consistent = e.consistent;
    b.distance = e.distance;
    std::copy_n(e.observable, IPE_NP, b.observable);
    return b;
}

}  // namespace inertiad::detail
