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

constexpr double DELAY_STEP = 1e-4;    // s: chosen far below the sampling period
constexpr double LOWPASS_STEP = 1e-6;  // s2: forces are linear in it

/// The windows of one run under one calibration, and the same ones beside it, whose differences are columns: slopes of
/// windows show neither how an attitude that follows from the positions turns when these come later, nor how the tensions
/// bend within a window.
struct RunWindows {
    std::vector<ipe_average_t> window;
    std::vector<bool> is_rest;
    std::vector<ipe_average_t> later;    ///< positions later by DELAY_STEP; empty: these only move the pose
    std::vector<ipe_average_t> sharper;  ///< forces before a low-pass that is larger by LOWPASS_STEP; empty: not wanted
};

/// At rest, as the platform has it (pose_dwell.h), rate and acceleration are sensor noise: taken as they are they would wear
/// the inertia down. Only where rest prevails: few such windows do no harm, and a slow start taken for rest would.
inline void gate_rest(const Config& config, RunWindows& run)
{
    ipe_pose_dwell_t dwell;
    ipe_pose_dwell_restart(&dwell);
    run.is_rest.clear();
    for (const ipe_average_t& a : run.window) {
        run.is_rest.push_back(ipe_pose_dwell_push(&dwell, &config.c(), &a) > 0);
    }
    const auto n_rest = static_cast<std::size_t>(std::count(run.is_rest.begin(), run.is_rest.end(), true));
    for (std::size_t k = 0; k < run.window.size() && 2 * n_rest > run.window.size(); ++k) {
        if (!run.is_rest[k]) { continue; }
        std::fill_n(run.window[k].w, 3, 0.0);
        std::fill_n(run.window[k].ww, 6, 0.0);
        std::fill_n(run.window[k].alpha, 3, 0.0);
    }
}

/// The windows under xi, beside it where the position delay (is_later) or the low-pass (is_sharper) is unknown.
inline RunWindows windows_under(const Config& config, const Config& corrected, const BatchRun& run,
                                const Eigen::VectorXd& xi, bool is_later, bool is_sharper)
{
    const auto rows_under = [&](int i, double step) {
        Eigen::VectorXd beside = xi;
        beside[i] += step;
        return corrected_rows(config, corrected, beside, *run.rows, run.derived);
    };
    const std::vector<ipe_row_t> rows = corrected_rows(config, corrected, xi, *run.rows, run.derived);
    const std::vector<RowMotion> motion = smoothed_motion(corrected, rows);
    RunWindows found{windows_of(corrected, rows, motion), {}, {}, {}};
    const auto only_same = [&found](std::vector<ipe_average_t> beside) {
        const auto is_same = [](const ipe_average_t& a, const ipe_average_t& b) { return a.t_ns == b.t_ns; };
        const auto& window = found.window;
        const bool are_same = std::equal(window.begin(), window.end(), beside.begin(), beside.end(), is_same);
        return are_same ? beside : std::vector<ipe_average_t>{};
    };
    if (is_later && ipe_motion_is_fused(&corrected.c())) {
        found.later = only_same(windows_of(corrected, rows_under(IPE_XI_POSITION_DELAY, DELAY_STEP)));
    }
    if (is_sharper) {
        found.sharper = only_same(windows_of(corrected, rows_under(IPE_XI_FORCE_LOWPASS, LOWPASS_STEP), motion));
    }
    return found;
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
