// SPDX-License-Identifier: Apache-2.0
/// Slow changes during a run, filtered out of its equations.
#pragma once

#include "run_windows.hpp"

#include <cmath>

namespace inertiad::detail {

constexpr double SHORTEST_WANDER = 0.1;  // s, as in filter_states.c

/// Slow changes, taken out of equations window by window: the attitude's wander, 3, W axes, and the random walk of the
/// force offsets about where they begin, m. A Kalman filter whose measurements are all columns of the equations at once,
/// since its estimate is linear in them.
class Drift {
public:
    Drift(const ipe_config_t& config, bool is_modelled, Eigen::Index n_columns)
        : config_(config), is_modelled_(is_modelled),
          P_(Eigen::MatrixXd::Zero(3 + config.n_cables, 3 + config.n_cables)),
          estimate_(Eigen::MatrixXd::Zero(3 + config.n_cables, n_columns))
    {
    }

    /// Equations [6][n_columns] of a window, of which drift makes by_drift [6][3 + m] times itself, become innovations;
    /// returns the covariance of drift's part in them. V: of the rest.
    Square6 take_out(const ipe_average_t& window, const Eigen::MatrixXd& by_drift, const Square6& V,
                     Eigen::Ref<Eigen::MatrixXd> rows)
    {
        if (!is_modelled_) { return Square6::Zero(); }
        predict(window);
        const Eigen::MatrixXd PH = P_ * by_drift.transpose();
        const Square6 part = by_drift * PH;
        const Eigen::MatrixXd gain = Square6(part + V).llt().solve(PH.transpose()).transpose();
        rows -= by_drift * estimate_;
        estimate_ += gain * rows;
        P_ -= gain * PH.transpose();
        return part;
    }

private:
    void predict(const ipe_average_t& window)
    {
        const bool is_first = t_ns_ == 0;
        const double elapsed = is_first ? 0.0 : 1e-9 * static_cast<double>(window.t_ns - t_ns_);
        const double drift = config_.std_force_offset_drift;
        t_ns_ = window.t_ns;
        for (int i = 0; i < 3; ++i) {
            const double time = std::max(window.error.attitude_time[i], SHORTEST_WANDER);
            const double std = window.error.attitude_std[i], fade = is_first ? 0.0 : std::exp(-elapsed / time);
            estimate_.row(i) *= fade;
            P_.row(i) *= fade;
            P_.col(i) *= fade;
            P_(i, i) += std * std * (1.0 - fade * fade);
        }
        P_.diagonal().tail(config_.n_cables).array() += drift * drift * elapsed;
    }

    const ipe_config_t& config_;
    bool is_modelled_;
    int64_t t_ns_ = 0;
    Eigen::MatrixXd P_, estimate_;
};

}  // namespace inertiad::detail
