// SPDX-License-Identifier: Apache-2.0
/// Slow changes during a run, filtered out of its equations.
#pragma once

#include "run_windows.hpp"

extern "C" {
#include "filter_states.h"
#include "noise.h"
}

#include <Eigen/Cholesky>

#include <cmath>

namespace inertiad::detail {

constexpr double SHORTEST_WANDER = 0.1;  // s, as in filter_states.c

/// Slow changes, taken out of equations window by window: the attitude's wander, 3, W axes, and the random walk of the
/// force offsets about where they begin, m. A Kalman filter whose measurements are all columns of the equations at once,
/// since its estimate is linear in them. The offsets walk in the platform's steps: windows overlap and share their noise,
/// so a walk from each window to the next would take what they share for drift, and what is left for all their noise.
/// A window whose last column stands out counts for less, if wanted (ipe_noise_weight()).
class Drift {
public:
    Drift(const ipe_config_t& config, bool is_modelled, bool is_robust, Eigen::Index n_columns)
        : config_(config), is_modelled_(is_modelled), is_robust_(is_robust),
          P_(Eigen::MatrixXd::Zero(3 + config.n_cables, 3 + config.n_cables)),
          estimate_(Eigen::MatrixXd::Zero(3 + config.n_cables, n_columns))
    {
    }

    /// Of a window's innovations: the covariance of drift's part, of the rest, and the weight by which that is enlarged.
    struct Spread {
        Square6 drift, noise;
        double weight;
    };

    /// Equations [6][n_columns] of a window, of which drift makes by_drift [6][3 + m] times itself, become innovations;
    /// returns their spread. V: covariance of all but drift. They say nothing along by_unknown [6][n], the columns of failed
    /// sensors' forces.
    Spread take_out(const ipe_average_t& window, const Eigen::MatrixXd& by_drift, const Eigen::MatrixXd& by_unknown,
                    const Square6& V, Eigen::Ref<Eigen::MatrixXd> rows)
    {
        Spread spread{Square6::Zero(), V, 1.0};
        if (is_modelled_) {
            predict(window);
            spread.drift = by_drift * P_ * by_drift.transpose();
            rows -= by_drift * estimate_;
        }
        Eigen::MatrixXd known = by_drift;
        if (by_unknown.cols() > 0) {
            const Square6 left = without(by_unknown, Eigen::LLT<Square6>(Square6(spread.drift + V)));
            rows = (left * rows).eval();
            known = left * by_drift;
        }
        if (is_robust_) {
            const Column6 e = rows.col(rows.cols() - 1);
            spread.weight = ipe_noise_weight(e.dot(Square6(spread.drift + V).llt().solve(e)));
            spread.noise /= spread.weight;
        }
        if (is_modelled_) {
            const Eigen::LLT<Square6> A(Square6(spread.drift + spread.noise));
            const Eigen::MatrixXd PH = P_ * known.transpose();
            const Eigen::MatrixXd gain = A.solve(PH.transpose()).transpose();
            estimate_ += gain * rows;
            P_ -= gain * PH.transpose();
        }
        return spread;
    }

private:
    /// Projection along columns W [6][n], in the metric of A.
    static Square6 without(const Eigen::MatrixXd& W, const Eigen::LLT<Square6>& A)
    {
        const Eigen::MatrixXd along = A.solve(W);
        const Eigen::MatrixXd information = W.transpose() * along;
        return Square6::Identity() - W * information.ldlt().solve(along.transpose());
    }

    void predict(const ipe_average_t& window)
    {
        const bool is_first = t_ns_ == 0;
        const double elapsed = is_first ? 0.0 : 1e-9 * static_cast<double>(window.t_ns - t_ns_);
        const double drift = config_.std_force_offset_drift;
        t_ns_ = window.t_ns;
        for (int i = 0; i < 3; ++i) {
            const double time = std::max(window.error.attitude_time[i], SHORTEST_WANDER);
            const double std = window.error.attitude_std[i], kept = is_first ? 0.0 : std::exp(-elapsed / time);
            const double fade = wander_std_[i] > 0.0 ? kept * std / wander_std_[i] : 0.0;
            estimate_.row(i) *= fade;
            P_.row(i) *= fade;
            P_.col(i) *= fade;
            P_(i, i) += std * std * (1.0 - kept * kept);
            wander_std_[i] = std;
        }
        since_step_ += elapsed;
        if (since_step_ >= IPE_DRIFT_INTERVAL) {
            P_.diagonal().tail(config_.n_cables).array() += drift * drift * since_step_;
            since_step_ = 0.0;
        }
    }

    const ipe_config_t& config_;
    bool is_modelled_, is_robust_;
    int64_t t_ns_ = 0;
    double since_step_ = 0.0;                               ///< s, since the last step of the offsets' random walk
    Eigen::Vector3d wander_std_ = Eigen::Vector3d::Zero();  ///< rad, of the last window
    Eigen::MatrixXd P_, estimate_;
};

}  // namespace inertiad::detail
