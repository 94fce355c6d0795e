// SPDX-License-Identifier: Apache-2.0
/// Equations of a run's windows, and the columns that systematic.h does not have.
#pragma once

#include "run_windows.hpp"

extern "C" {
#include "unknown_force.h"
}

#include <Eigen/QR>

#include <array>
#include <stdexcept>
#include <vector>

namespace inertiad::detail {

/// Equations of a run's windows: rows [A, b], six each, and d(b)/d(drift) of each window.
struct Equations {
    Eigen::MatrixXd rows;
    std::vector<Eigen::MatrixXd> by_drift;
    std::vector<Eigen::MatrixXd> by_unknown;  ///< [6][n] of each window's n failed force sensors
    std::vector<SmoothWindow> at;             ///< windows whose tensions the model makes; none if no xi is free
    std::vector<Eigen::MatrixXd> W;           ///< [6][m] of each

    Column6 residual(std::size_t k) const
    {
        return rows.col(rows.cols() - 1).segment<6>(6 * static_cast<Eigen::Index>(k));
    }
};

/// W [6][m] at a window's pose: wrench = W f + weight. Throws where a cable has no direction.
inline Eigen::MatrixXd wrench_matrix(const ipe_config_t& c, const ipe_average_t& a)
{
    double W[IPE_NY][IPE_CABLES_MAX], sag[IPE_NY];
    if (ipe_wrench_matrix(&c, a.p, a.R, c.imu_position, W, sag) != IPE_OK) {
        throw std::domain_error("a cable has no direction near a window's pose");
    }
    return Eigen::Map<const Eigen::Matrix<double, 6, IPE_CABLES_MAX, Eigen::RowMajor>>(&W[0][0]).leftCols(c.n_cables);
}

/// d(wrench)/d(attachment) [6][3 m] of a window: a force that acts elsewhere.
inline Eigen::MatrixXd geometry_columns(const Eigen::MatrixXd& W, const ipe_average_t& a)
{
    Eigen::MatrixXd G = Eigen::MatrixXd::Zero(6, 3 * W.cols());
    for (Eigen::Index i = 0; i < W.cols(); ++i) {
        const Vector3 force = a.f[i] * W.col(i).head<3>();
        for (int k = 0; k < 3; ++k) { G.block<3, 1>(3, 3 * i + k) = Vector3::Unit(k).cross(force); }
    }
    return G;
}

/// Failed sensors read the most probable forces, one window after the other, as ipe_estimator_restore_forces() makes them.
class RestoredForces {
public:
    explicit RestoredForces(const ipe_config_t& config) : config_(config) {}

    /// Forces of the window and its wrench y, by its residual. Returns the columns [6][n] of its n failed sensors. Throws where
    /// a cable has no direction.
    Eigen::MatrixXd restore(Column6 residual, SmoothWindow& window, Column6& y)
    {
        ipe_average_t& a = window.average;
        ipe_unknown_force_t u;
        if (ipe_unknown_force_columns(&config_, &a, &u) != IPE_OK) {
            throw std::domain_error("a cable has no direction near a window's pose");
        }
        Eigen::MatrixXd columns(6, u.n);
        for (int k = 0; k < u.n; ++k) {
            const auto j = static_cast<std::size_t>(u.cable[k]);
            const Eigen::Map<const Column6> mean(u.mean[k]), turned(u.turned[k]);
            const double excess = mean.dot(residual) / mean.squaredNorm(), gain = 1.0 + config_.force_gain[j];
            const double elapsed = 1e-9 * static_cast<double>(a.t_ns - last_ns_[j]);
            a.f[j] -= excess / gain;
            residual -= excess * mean;
            y -= excess * mean;
            if (last_ns_[j] != 0 && elapsed < LONGEST_STEP) { y += (a.f[j] - last_[j]) / elapsed * gain * turned; }
            last_[j] = a.f[j];
            last_ns_[j] = a.t_ns;
            columns.col(k) = mean;
        }
        return columns;
    }

private:
    static constexpr double LONGEST_STEP = 0.5;  // s, as in firmware/core/estimator.c

    const ipe_config_t& config_;
    std::array<double, IPE_CABLES_MAX> last_{};
    std::array<int64_t, IPE_CABLES_MAX> last_ns_{};
};

/// A window's tensions become the nearest ones that pull as its residual [6] says they should.
inline void reproduce(const Eigen::MatrixXd& W, const Column6& residual, ipe_average_t& a)
{
    Eigen::Map<Eigen::VectorXd>(a.f, W.cols()) -= W.completeOrthogonalDecomposition().solve(residual);
}

}  // namespace inertiad::detail
