// SPDX-License-Identifier: Apache-2.0
/// Linear least squares min |A u - b| whose rows arrive in pieces, and its damped steps.
///
///   (R^T R + lambda D^2) u = R^T z,  D = diag of R^T R's root       Levenberg-Marquardt with Marquardt's scaling
/// R, z is the triangle of the rows' QR factors. Source: Nocedal, Wright, Numerical Optimization, 2nd ed., 10.3.
/// Heap: (n + 1)^2 numbers, however many rows. No state beside it, any thread.
#pragma once

#include <Eigen/QR>

#include <cmath>

namespace inertiad::detail {

/// Rows [A, b] of a least-squares problem, kept as the triangle of their QR factors.
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

    /// Minimum over the first k unknowns, the others zero.
    Eigen::VectorXd solve_leading(Eigen::Index k) const
    {
        Eigen::VectorXd u = Eigen::VectorXd::Zero(n_);
        u.head(k) = R_.topLeftCorner(k, k).template triangularView<Eigen::Upper>().solve(R_.col(n_).head(k));
        return u;
    }

    /// The step under damping lambda; 0: the minimum.
    Eigen::VectorXd solve(double lambda) const
    {
        if (lambda == 0.0) { return factor().solve(R_.col(n_).head(n_)); }
        Triangle damped(*this);
        Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(n_, n_ + 1);
        rows.leftCols(n_).diagonal() = std::sqrt(lambda) * R_.leftCols(n_).colwise().norm();
        damped.add(rows);
        return damped.solve(0.0);
    }

    /// (A^T A)^-1.
    Eigen::MatrixXd covariance() const
    {
        const Eigen::MatrixXd inverse = factor().solve(Eigen::MatrixXd::Identity(n_, n_));
        return inverse * inverse.transpose();
    }

    /// A^T b: minus the gradient of half the cost.
    Eigen::VectorXd gradient() const { return R_.topLeftCorner(n_, n_).transpose() * R_.col(n_).head(n_); }

    /// Length of a gradient's undamped step in standard deviations: |R^-T g|.
    double step_in_sigmas(const Eigen::VectorXd& g) const
    {
        return R_.topLeftCorner(n_, n_).template triangularView<Eigen::Upper>().transpose().solve(g).norm();
    }

    /// |b|^2.
    double cost() const { return R_.col(n_).squaredNorm(); }

    /// |A u - b|^2 at the minimum.
    double least_cost() const { return R_(n_, n_) * R_(n_, n_); }

private:
    Eigen::TriangularView<const Eigen::Block<const Eigen::MatrixXd>, Eigen::Upper> factor() const
    {
        return R_.topLeftCorner(n_, n_).template triangularView<Eigen::Upper>();
    }
    Eigen::Index n_;
    Eigen::MatrixXd R_;
};

}  // namespace inertiad::detail
