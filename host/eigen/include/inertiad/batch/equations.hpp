// SPDX-License-Identifier: Apache-2.0
/// Equations of a run's windows, and the columns that systematic.h does not have.
#pragma once

#include "run_windows.hpp"

#include <Eigen/QR>

#include <stdexcept>
#include <vector>

namespace inertiad::detail {

/// Equations of a run's windows: rows [A, b], six each, and d(b)/d(drift) of each window.
struct Equations {
    Eigen::MatrixXd rows;
    std::vector<Eigen::MatrixXd> by_drift;

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

/// The tensions nearest to a window's that pull as its residual [6] says they should.
inline SmoothWindow reproducing(const Eigen::MatrixXd& W, const Column6& residual, SmoothWindow a)
{
    Eigen::Map<Eigen::VectorXd>(a.average.f, W.cols()) -= W.completeOrthogonalDecomposition().solve(residual);
    return a;
}

}  // namespace inertiad::detail
