// SPDX-License-Identifier: Apache-2.0
/// Batch identification: theta of one or more bodies and, if wanted, the systematic parameters xi of the sensors they share.
///
///   y(xi) - Y(xi) theta_g = e,   e ~ N(0, V_run);   theta_g ~ N(theta_0, P_0),  xi ~ N(0, diag(std^2))
/// Damped Gauss-Newton: each step runs rows -> wrench -> window again under the corrected calibration, so the residual is
/// exact, and takes [Y, -X] of systematic.h as its derivative. X is taken at the tensions nearest to the measured ones that
/// leave no residual: with the measured ones a common gain gets its column from the noise which it then makes smaller, and
/// the body with it (errors in variables; the mass 0.14 % low on the paper's motion with modern sensors). What of the motion
/// was derived instead of measured is smoothed for Y and X (derived.hpp). The model's tensions have the noise of accelerometer
/// and gyro, and so has the attitude. The correction for noise in Y (eiv_correction.h) therefore counts what noise, drawn into
/// the rows, does to whole equations.
/// The forces' low-pass is an unknown only where the data tell it: a fit that always has it finds one in noise. The first
/// descent ends without it. Then its size is read from a column of measured tensions, which gives too little, and from one of
/// the model's, which gives too much. Where both tell one, a second descent has it as an unknown. Elsewhere its prior is part
/// of P.
/// Steps are solved by QR of the whitened, prior-scaled rows (least_squares.hpp). The first one moves theta alone. A step is
/// taken if the cost falls, or if the next step, in the present metric, is shorter (the natural level function of Deuflhard,
/// Newton Methods for Nonlinear Problems, 3.3: an instrument-like derivative has no cost whose minimum it leads to); else it
/// is damped more. V_run, the residuals' long-run covariance (long_run.hpp), starts from the residuals of theta alone, which
/// are the widest, and is renewed until it stays; once it is learnt, windows that stand out count for less
/// (ipe_noise_weight()). Converged: weights at rest, and the way left, a short step of a creeping series being a long way,
/// below 0.001 posterior sigmas of every unknown, or below 0.05 and no longer shrinking (rows at a gap come and go with a
/// delay).
/// As soon as xi is estimated two more errors are modelled: where the attachments really are, known to std_geometry, is
/// unknown too, else a millimetre of it would pass for newtons of offset; and the attitude wanders about its bias, see
/// filter_states.h: a Kalman filter of that alone takes it out of the rows, which then are as independent as their noise. Known
/// differences of mass between groups are rows of their own, and so is what a gyro's mean says of its bias beside the
/// attitude. Heap: as much as the data need. No state, any thread.
#pragma once

#include "batch/data.hpp"
#include "batch/descent.hpp"
#include "batch/publish.hpp"

#include <cmath>
#include <stdexcept>
#include <vector>

namespace inertiad {

/// The equations have a solution which no body is near.
struct NoBody : std::runtime_error {
    using std::runtime_error::runtime_error;
};

namespace detail {

constexpr double NOISE_FALLS = 0.5;  // product of all channels', to this share: chosen so that chance does not choose

/// The problem at its nearest minimum, or at that beside it where another delay leaves less. Forces that are late by much more
/// than stated have theirs there.
inline Problem descend_from_delay(const Config& config, const std::vector<BatchRun>& runs,
                                  const BatchSettings& settings, bool is_low_pass_free, BatchResult& result)
{
    Problem near(config, runs, settings, is_low_pass_free), far(config, runs, settings, is_low_pass_free);
    Descent(near, settings).run(result);
    const double delay = near.better_force_delay();
    if (delay == 0.0) { return near; }
    BatchResult there{};
    far.start_with_force_delay(delay);
    Descent(far, settings).run(there);
    if (!there.is_converged || near.cost_at(far) > near.cost_at(near)) { return near; }
    result = there;
    return far;
}

/// Weights and the attitude's wander have two solutions at times: residuals that have the wander in them teach weights under
/// which it is not followed. Where residuals last, a second descent looks for the solution that follows it. It is taken if its
/// weights are smaller, or the first descent found none, and its residuals do not last.
inline Problem descend(const Config& config, const std::vector<BatchRun>& runs, const BatchSettings& settings,
                       bool is_low_pass_free, BatchResult& result)
{
    Problem first = descend_from_delay(config, runs, settings, is_low_pass_free, result);
    if (!settings.is_weight_learnt || !first.has_lasting_residuals()) { return first; }
    Problem second(config, runs, settings, is_low_pass_free);
    BatchResult there{};
    try {
        second.start_as_if_wander_lasts(first);
        Descent(second, settings).run(there);
    } catch (const std::logic_error&) {
        return first;
    }
    const bool is_sharper = second.log_noise() - first.log_noise() < std::log(NOISE_FALLS);
    const bool is_followed = there.is_converged && !second.has_lasting_residuals();
    if (!is_followed || (result.is_converged && !is_sharper)) { return first; }
    result = there;
    return second;
}

/// With a low-pass of the forces as an unknown where the data tell one. Elsewhere there is none, and what is not known of it is
/// in P.
inline Problem low_pass_told(const Config& config, const std::vector<BatchRun>& runs, const BatchSettings& settings,
                             BatchResult& result)
{
    Problem without = descend(config, runs, settings, false, result), with(config, runs, settings, true);
    if (with.n != without.n + 1) { return without; }  // not wanted, or nothing else is
    const Problem::LowPass seen = with.low_pass(without);
    if (seen.is_told) { return descend(config, runs, settings, true, result); }
    without.P += seen.effect * seen.effect.transpose();
    return without;
}

}  // namespace detail

/// Solve. result.is_converged says whether it is a solution. Throws std::domain_error with the reason where there is nothing
/// to solve, NoBody where the data contradict every body.
inline BatchResult solve(const Config& config, const std::vector<BatchRun>& runs, const BatchSettings& settings)
{
    Config used = config;
    for (const BatchRun& run : runs) { used = usable(used, run.derived); }
    BatchResult result{};
    detail::Problem problem = detail::low_pass_told(used, runs, settings, result);
    std::size_t n_windows = 0;
    for (const BatchFit& f : problem.fit) { n_windows += f.n_windows; }
    if (n_windows == 0) { throw std::domain_error("no whole window in the data"); }
    problem.blocks(result.block, result.H_prior);
    for (int g = 0; g < problem.n_groups; ++g) {
        try {
            result.body.push_back(detail::publish_body(problem, g));
        } catch (const std::domain_error& error) {
            throw NoBody(error.what());
        }
    }
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
