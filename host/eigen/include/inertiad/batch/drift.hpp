// SPDX-License-Identifier: Apache-2.0
/// What changes slowly during a run, filtered out of its equations.
#pragma once

#include "run_windows.hpp"

#include <cmath>

namespace inertiad::detail {

/// What changes slowly during a run, taken out of equations window by window: the attitude's wander, 3, and the random walk
/// of the force offsets about where they begin, m. A Kalman filter whose measurements are all columns of the equations at
/// once, since what it would estimate is linear in them.
class Drift {
public:
    Drift(const ipe_config_t& config, Eigen::Index n_columns)
        : config_(config), P_(Eigen::MatrixXd::Zero(3 + config.n_cables, 3 + config.n_cables)),
          estimate_(Eigen::MatrixXd::Zero(3 + config.n_cables, n_columns))
    {
    }

    /// Equations [6][n_columns] at t_ns, of which drift makes by_drift [6][3 + m] times itself, become innovations;
    /// returns the covariance of drift's part in them. V: of the rest.
    Square6 take_out(int64_t t_ns, const Eigen::MatrixXd& by_drift, const Square6& V, Eigen::Ref<Eigen::MatrixXd> rows)
    {
        predict(t_ns);
        const Eigen::MatrixXd PH = P_ * by_drift.transpose();
        const Square6 part = by_drift * PH;
        const Eigen::MatrixXd gain = Square6(part + V).llt().solve(PH.transpose()).transpose();
        rows -= by_drift * estimate_;
        estimate_ += gain * rows;
        P_ -= gain * PH.transpose();
        return part;
    }

private:
    void predict(int64_t t_ns)
    {
        const bool is_first = t_ns_ == 0;
        const double elapsed = is_first ? 0.0 : 1e-9 * static_cast<double>(t_ns - t_ns_);
        const double fade = is_first ? 0.0 : std::exp(-elapsed / IPE_WANDER_TIME);
        const double wander = config_.std_attitude_wander, drift = config_.std_force_offset_drift;
        t_ns_ = t_ns;
        estimate_.topRows<3>() *= fade;
        P_.topRows<3>() *= fade;
        P_.leftCols<3>() *= fade;
        P_.diagonal().head<3>().array() += wander * wander * (1.0 - fade * fade);
        P_.diagonal().tail(config_.n_cables).array() += drift * drift * elapsed;
    }

    const ipe_config_t& config_;
    int64_t t_ns_ = 0;
    Eigen::MatrixXd P_, estimate_;
};

}  // namespace inertiad::detail
