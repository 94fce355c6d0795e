// SPDX-License-Identifier: Apache-2.0
/// The attitude's wander, filtered out of a run's equations.
#pragma once

#include "run_windows.hpp"

#include <cmath>

namespace inertiad::detail {

/// The attitude's wander, taken out of equations window by window: a Kalman filter whose measurements are all columns of the
/// equations at once, since what it would estimate is linear in them.
class Wander {
public:
    Wander(double std, Eigen::Index n_columns) : std_(std), estimate_(Eigen::MatrixXd::Zero(3, n_columns)) {}

    /// Equations [6][n_columns] at t_ns, of which wander makes turn [6][3] times itself, become innovations; returns the
    /// covariance of wander's part in them. V: of the rest.
    Square6 take_out(int64_t t_ns, const Eigen::Matrix<double, 6, 3>& turn, const Square6& V,
                     Eigen::Ref<Eigen::MatrixXd> rows)
    {
        const double elapsed = t_ns_ == 0 ? HUGE_VAL : 1e-9 * static_cast<double>(t_ns - t_ns_) / IPE_WANDER_TIME;
        const double fade = std::exp(-elapsed);
        t_ns_ = t_ns;
        estimate_ *= fade;
        P_ = fade * fade * P_ + std_ * std_ * (1.0 - fade * fade) * Eigen::Matrix3d::Identity();
        const Square6 part = turn * P_ * turn.transpose();
        const Eigen::Matrix<double, 3, 6> gain = Square6(part + V).llt().solve(turn * P_).transpose();
        rows -= turn * estimate_;
        estimate_ += gain * rows;
        P_ -= (gain * turn * P_).eval();
        return part;
    }

private:
    double std_;
    int64_t t_ns_ = 0;
    Eigen::Matrix3d P_ = Eigen::Matrix3d::Zero();
    Eigen::MatrixXd estimate_;
};

}  // namespace inertiad::detail
