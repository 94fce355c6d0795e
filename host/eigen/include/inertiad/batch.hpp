// SPDX-License-Identifier: Apache-2.0
/// Batch identification: theta of one or more bodies and, if wanted, the systematic parameters xi of the sensors they share.
///
///   y(xi) - Y(xi) theta_g = e,   e ~ N(0, V_run);   theta_g ~ N(theta_0, P_0),  xi ~ N(0, diag(std^2))
/// Gauss-Newton: each step runs rows -> wrench -> window again under the corrected calibration, so the residual is exact, and
/// takes [Y, -X] of systematic.h as its derivative. X is taken at the tensions nearest to the measured ones that leave no
/// residual: with the measured ones a common gain gets its column from the noise which it then makes smaller, and the body
/// with it (errors in variables; the mass 0.14 % low on the paper's motion with modern sensors). Steps are solved by QR of
/// the whitened, prior-scaled rows. What of the motion was derived instead of measured is smoothed for Y, X (derived.hpp). V_run, the residuals' long-run covariance (Newey, West 1987; noise.h has the idea), is
/// renewed during the first steps.
/// As soon as xi is estimated two more errors are modelled: where the attachments really are, known to std_geometry, is
/// unknown too, else a millimetre of it would pass for newtons of offset; and the attitude wanders about its bias, see
/// filter_states.h: a Kalman filter of that alone takes it out of the rows, which then are as independent as their noise. Known
/// differences of mass between groups are rows of their own, and so is what a gyro's mean says of its bias beside the
/// attitude. Heap: as much as the data need. No state, any thread.
#pragma once

#include "batch/data.hpp"
#include "batch/publish.hpp"

#include <cmath>
#include <stdexcept>
#include <vector>

namespace inertiad {

namespace detail {
constexpr double CONVERGED = 1e-3;  // posterior sigmas: chosen so that the last step is invisible in what is published
}

/// Solve. Throws std::domain_error with the reason where there is nothing to solve or no body comes out.
inline BatchResult solve(const Config& config, const std::vector<BatchRun>& runs, const BatchSettings& settings)
{
    Config used = config;
    for (const BatchRun& run : runs) { used = usable(used, run.derived); }
    detail::Problem problem(used, runs, settings);
    BatchResult result{};
    for (result.n_steps = 1; result.n_steps <= settings.n_steps_max; ++result.n_steps) {
        const int step = result.n_steps;
        const int n_weight_steps = settings.n_weight_steps + (settings.n_weight_steps > 0 ? problem.widened_at : 0);
        result.last_step = problem.step(step > 1 && step <= 1 + n_weight_steps);
        if (!std::isfinite(result.last_step)) { throw std::domain_error("the equations have no finite solution"); }
        if (step > n_weight_steps && step > problem.widened_at && result.last_step < detail::CONVERGED) { break; }
    }
    std::size_t n_windows = 0;
    for (const BatchFit& f : problem.fit) { n_windows += f.n_windows; }
    if (n_windows == 0) { throw std::domain_error("no whole window in the data"); }
    for (int g = 0; g < problem.n_groups; ++g) { result.body.push_back(detail::publish_body(problem, g)); }
    result.fit = problem.fit;
    result.free = problem.free;
    result.prior_std = problem.scale;
    result.P = problem.P;
    problem.add_common_gain(result.P);
    result.xi = problem.xi;
    result.xi_std = problem.std_xi;
    for (std::size_t i = 0; i < problem.free.size(); ++i) {
        const Eigen::Index at = IPE_NP * problem.n_groups + static_cast<Eigen::Index>(i);
        result.xi_std[problem.free[i]] = std::sqrt(result.P(at, at));
    }
    return result;
}

}  // namespace inertiad
