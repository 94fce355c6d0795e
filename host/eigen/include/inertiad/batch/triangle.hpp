// SPDX-License-Identifier: Apache-2.0
/// Least squares of any number of rows in little memory.
#pragma once

#include <Eigen/Dense>

namespace inertiad::detail {

/// Rows of a least-squares problem, kept as the triangle of their QR factors: any number of rows in little memory.
class Triangle {
public:
    explicit Triangle(Eigen::Index n) : n_(n), R_(Eigen::MatrixXd::Zero(n + 1, n + 1)) {}
    /// Fold in rows [A, b] of unit variance.
    void add(const Eigen::MatrixXd& Ab)
    {
        Eigen::MatrixXd stacked(R_.rows() + Ab.rows(), n_ + 1);
        stacked << R_, Ab;
        const Eigen::HouseholderQR<Eigen::Ref<Eigen::MatrixXd>> qr(stacked);
        R_ = stacked.topRows(n_ + 1).template triangularView<Eigen::Upper>();
    }
    Eigen::VectorXd solve() const { return factor().solve(R_.col(n_).head(n_)); }
    Eigen::MatrixXd covariance() const
    {
        const Eigen::MatrixXd inverse = factor().solve(Eigen::MatrixXd::Identity(n_, n_));
        return inverse * inverse.transpose();
    }

private:
    Eigen::TriangularView<const Eigen::Block<const Eigen::MatrixXd>, Eigen::Upper> factor() const
    {
        return R_.topLeftCorner(n_, n_).template triangularView<Eigen::Upper>();
    }
    Eigen::Index n_;
    Eigen::MatrixXd R_;
};

}  // namespace inertiad::detail
