// SPDX-License-Identifier: Apache-2.0
/// The weak equations of a whole run, from its aligned rows: input of the batch solvers on the host.
/// Same stages, same order as ipe_pipeline_step(): motion (smoothed), wrench, window, cable inertia, regressor.
#pragma once

#include "body.hpp"
#include "config.hpp"
#include "smoothed_motion.hpp"

#include <vector>

extern "C" {
#include "cable_inertia.h"
#include "filter_states.h"
#include "systematic.h"
#include "unknown_force.h"
#include "window.h"
#include "wrench.h"
}

namespace inertiad {

using SystematicColumns = Eigen::Matrix<double, IPE_NY, IPE_XI_MAX, Eigen::RowMajor>;

constexpr double SMOOTHED_REST_SPEED = 5e-3;  // m/s: a third of the platform's, as the error of smoothed speeds

/// Windows of rows under a configuration. Rows that a stage refuses are left out, as on the platform.
inline std::vector<ipe_average_t> windows_of(const Config& config, const std::vector<ipe_row_t>& rows)
{
    std::vector<ipe_average_t> found;
    ipe_wrench_stage_t wrench_stage;
    ipe_window_t window;
    ipe_wrench_init(&wrench_stage, &config.c());
    if (ipe_motion_is_fused(&config.c())) { wrench_stage.rest_speed = SMOOTHED_REST_SPEED; }
    ipe_window_init(&window, &config.c());
    const std::vector<RowMotion> motion = smoothed_motion(config, rows);
    for (std::size_t k = 0; k < rows.size(); ++k) {
        ipe_wrench_t wrench;
        ipe_average_t average;
        ipe_unknown_force_t unknown;
        const ipe_motion_t* of_row = &motion[k].motion;
        if (!motion[k].is_known || !rows[k].has_force) { continue; }
        if (ipe_wrench_from_row(&wrench_stage, &rows[k], of_row, &wrench) != IPE_OK) { continue; }
        if (ipe_window_push(&window, rows[k].t_ns, of_row, &wrench, &average) != IPE_OK) { continue; }
        if (ipe_unknown_force_columns(&config.c(), &average, &unknown) != IPE_OK) { continue; }
        if (ipe_cable_inertia_add(&config.c(), &average) == IPE_OK) { found.push_back(average); }
    }
    return found;
}

/// Y [6][10] of a window.
inline Regressor regressor(const ipe_average_t& average) noexcept
{
    Regressor Y;
    ipe_regressor(average.s, average.ww, average.alpha, as_array(Y));
    return Y;
}

/// X [6][72], the first ipe_systematic_count() columns used. Throws std::domain_error where a cable has no direction.
inline SystematicColumns systematic_columns(const Config& config, const ipe_average_t& average, const Theta& theta)
{
    SystematicColumns X;
    if (ipe_systematic_columns(&config.c(), &average, theta.data(), as_array(X)) != IPE_OK) {
        throw std::domain_error("a cable has no direction near a window's pose");
    }
    return X;
}

}  // namespace inertiad
