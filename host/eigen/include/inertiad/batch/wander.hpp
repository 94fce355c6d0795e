// SPDX-License-Identifier: Apache-2.0
/// The attitude's wander, filtered out of a run's equations.
#pragma once

#include "run_windows.hpp"

#include <cmath>

namespace inertiad::detail {

constexpr double SHORTEST_WANDER = 0.1;  // s, as in filter_states.c

/// The attitude's wander, taken out of equations window by window: a Kalman filter whose measurements are all columns of the
/// equations at once, since what it would estimate is linear in them.
class Wander {
public:
    Wander(bool is_modelled, Eigen::Index n_columns)
        : is_modelled_(is_modelled), estimate_(Eigen::MatrixXd::Zero(3, n_columns))
    {
    }

    /// Equations [6][n_columns] of a window, of which wander makes turn [6][3] times itself, become innovations; returns the
    /// covariance of wander's part in them. V: of the rest.
    Square6 take_out(const ipe_average_t& window, const Eigen::Matrix<double, 6, 3>& turn, const Square6& V,
                     Eigen::Ref<Eigen::MatrixXd> rows)
    {
        if (!is_modelled_) { return Square6::Zero(); }
        const double elapsed = t_ns_ == 0 ? HUGE_VAL : 1e-9 * static_cast<double>(window.t_ns - t_ns_);
        Eigen::Vector3d fade, drive;
        for (int i = 0; i < 3; ++i) {
            fade[i] = std::exp(-elapsed / std::max(window.error.attitude_time[i], SHORTEST_WANDER));
            drive[i] = window.error.attitude_std[i] * window.error.attitude_std[i] * (1.0 - fade[i] * fade[i]);
        }
        t_ns_ = window.t_ns;
        estimate_ = (fade.asDiagonal() * estimate_).eval();
        P_ = (fade.asDiagonal() * P_ * fade.asDiagonal()).eval();
        P_.diagonal() += drive;
        const Square6 part = turn * P_ * turn.transpose();
        const Eigen::Matrix<double, 3, 6> gain = Square6(part + V).llt().solve(turn * P_).transpose();
        rows -= turn * estimate_;
        estimate_ += gain * rows;
        P_ -= (gain * turn * P_).eval();
        return part;
    }

private:
    bool is_modelled_;
    int64_t t_ns_ = 0;
    Eigen::Matrix3d P_ = Eigen::Matrix3d::Zero();
    Eigen::MatrixXd estimate_;
};

}  // namespace inertiad::detail
