// SPDX-License-Identifier: Apache-2.0
/// The windows of one run under one calibration, and the covariance of their residuals.
#pragma once

#include "../calibrated.hpp"
#include "../windows.hpp"
#include "data.hpp"

extern "C" {
#include "pose_dwell.h"
}

#include <algorithm>
#include <cmath>
#include <vector>

namespace inertiad::detail {

constexpr double PRIOR_WINDOWS =
    3.0;  // the configured covariance counts for; fewer than on the platform: all data are there
constexpr double LEAST_NOISE = 0.1;   // of the innovations' variance, however much of it drift explains: chosen
constexpr double NOISE_FLOOR = 1e-4;  // of the configured variance, as in firmware/core/noise.c

using Square6 = Eigen::Matrix<double, 6, 6>;
using Column6 = Eigen::Matrix<double, 6, 1>;

/// The windows of one run under one calibration.
struct RunWindows {
    std::vector<ipe_average_t> window;
    std::vector<bool> is_rest;
};

/// At rest rate and acceleration are zero. Only where rest prevails: few such windows do no harm, and a slow start taken for
/// rest would.
inline void hold_rest(RunWindows& run)
{
    const auto n_rest = static_cast<std::size_t>(std::count(run.is_rest.begin(), run.is_rest.end(), true));
    for (std::size_t k = 0; k < run.window.size() && 2 * n_rest > run.window.size(); ++k) {
        if (!run.is_rest[k]) { continue; }
        std::fill_n(run.window[k].w, 3, 0.0);
        std::fill_n(run.window[k].ww, 6, 0.0);
        std::fill_n(run.window[k].alpha, 3, 0.0);
    }
}

/// At rest, as the platform has it (pose_dwell.h), rate and acceleration are sensor noise: taken as they are they would wear
/// the inertia down.
inline void gate_rest(const Config& config, RunWindows& run)
{
    ipe_pose_dwell_t dwell;
    ipe_pose_dwell_restart(&dwell);
    run.is_rest.clear();
    for (const ipe_average_t& a : run.window) {
        run.is_rest.push_back(ipe_pose_dwell_push(&dwell, &config.c(), &a) > 0);
    }
    hold_rest(run);
}

/// The same windows as of another run are at rest.
inline void hold_rest_of(const RunWindows& other, RunWindows& run)
{
    run.is_rest.clear();
    std::size_t k = 0;
    for (const ipe_average_t& a : run.window) {
        while (k < other.window.size() && other.window[k].t_ns < a.t_ns) { ++k; }
        run.is_rest.push_back(k < other.window.size() && other.window[k].t_ns == a.t_ns && other.is_rest[k]);
    }
    hold_rest(run);
}

inline RunWindows windows_under(const Config& config, const Config& corrected, const BatchRun& run,
                                const Eigen::VectorXd& xi)
{
    return {windows_of(corrected, corrected_rows(config, corrected, xi, *run.rows, run.derived)), {}};
}

/// V_run from the innovations' long-run sum, the part of their variance that drift explains [6], as a sum, and, counting
/// for 3 windows, the configured covariance.
inline Square6 run_covariance(const Config& config, const Square6& sum, std::size_t n_windows, const Column6& explained)
{
    const Square6 C = Eigen::Map<const Matrix6>(&config.c().residual_covariance[0][0]);
    Square6 V = C;
    for (int i = 0; i < 6; ++i) {
        const double left = std::max({sum(i, i) - explained[i], LEAST_NOISE * sum(i, i), 0.0});
        const double learnt = (PRIOR_WINDOWS * C(i, i) + left) / (PRIOR_WINDOWS + static_cast<double>(n_windows));
        const double scale = std::sqrt(std::max(learnt / C(i, i), NOISE_FLOOR));
        V.row(i) *= scale;
        V.col(i) *= scale;
    }
    return V;
}

}  // namespace inertiad::detail
