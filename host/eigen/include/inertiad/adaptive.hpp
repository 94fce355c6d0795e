// SPDX-License-Identifier: Apache-2.0
/// Adaptive control of a rigid body whose parameters stay those of a body that can exist: the best known alternative to
/// identification.
///
///   v_r = v_d + k e         s = v_r - v         wrench = Y(v, v_r, v_r') theta + k M_0 s         twists of P, P axes
///   Phi' = gamma Phi B Phi,     tr(B Phi(theta)) = (Y^T s) . theta                     Phi: pseudo-inertia of theta
/// Slotine, Li, "On the adaptive control of robot manipulators", IJRR 6(3), 1987; the metric of the law is that of Lee, Kwon,
/// Park, "A natural adaptive control law for robot manipulators", IROS 2018. Y is built so that the Coriolis terms do no
/// work on s. The step is L exp(dt gamma L^T B L) L^T with Phi = L L^T, so Phi stays positive definite.
#pragma once

#include "plant.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace inertiad {

/// Rate at which a wrong mass is learnt, of the controller's: as fast as the error of the pose decays. Faster, the two would
/// be one loop of third order.
inline constexpr double ADAPTATION_SHARE = 1.0;

/// Learns theta while it controls.
class AdaptiveLaw {
public:
    /// theta: the body at the start; control_rate: k, rad/s.
    AdaptiveLaw(const Theta& theta, double control_rate, double gravity)
        : gravity_(gravity), k_(control_rate), mass_(detail::mass_matrix(theta)), phi_(pseudo_inertia(theta)),
          gain_(ADAPTATION_SHARE * k_ * k_ / (theta[0] * gravity * gravity))
    {
    }

    /// The wrench about P, P axes, for a state that should be as the reference; learns for `period` s.
    Vector6 wrench(PlantState& x, const Reference& wanted, double period)
    {
        const Matrix3 R = x.R(), away = R.transpose() * wanted.R;
        const Eigen::AngleAxisd turn{Eigen::Matrix3d(away)};
        const Vector3 e_R = turn.angle() * turn.axis(), w = x.w(), w_d = away * wanted.w;
        const Vector3 s_v = R.transpose() * (wanted.v + k_ * (wanted.p - x.p()) - x.v());
        const Vector3 w_r = w_d + k_ * e_R, s_w = w_r - w;
        const Vector3 a_r = wanted.a + k_ * (wanted.v - x.v()) + gravity_ * Vector3::UnitZ();
        const Vector3 alpha_r = away * wanted.alpha + k_ * (w_d - w);
        const Regressor Y = regressor_of(R.transpose() * a_r, w, w_r, alpha_r);
        Vector6 s;
        s << s_v, s_w;
        const Vector6 out = Y * theta() + k_ * mass_ * s;
        learn(Y.transpose() * s, period);
        return out;
    }

    /// m, h, J about P: always a body that can exist.
    Theta theta() const
    {
        const Matrix3 sigma = phi_.topLeftCorner<3, 3>();
        const double trace = sigma.trace();
        Theta t;
        t << phi_(3, 3), phi_.topRightCorner<3, 1>(), trace - sigma(0, 0), trace - sigma(1, 1), trace - sigma(2, 2),
            -sigma(1, 2), -sigma(0, 2), -sigma(0, 1);
        return t;
    }

private:
    /// L(w) of J w = L(w) [xx yy zz yz xz xy].
    static Eigen::Matrix<double, 3, 6> inertia_columns(const Vector3& w)
    {
        Eigen::Matrix<double, 3, 6> L;
        L << w[0], 0.0, 0.0, 0.0, w[2], w[1], 0.0, w[1], 0.0, w[2], 0.0, w[0], 0.0, 0.0, w[2], w[1], w[0], 0.0;
        return L;
    }

    /// [m s + alpha x h + w x (w_r x h); h x s + J alpha + w_r x J w]
    static Regressor regressor_of(const Vector3& s, const Vector3& w, const Vector3& w_r, const Vector3& alpha)
    {
        Regressor Y = Regressor::Zero();
        Y.block<3, 1>(0, 0) = s;
        Y.block<3, 3>(0, 1) = detail::cross_matrix(alpha) + detail::cross_matrix(w) * detail::cross_matrix(w_r);
        Y.block<3, 3>(3, 1) = -detail::cross_matrix(s);
        Y.block<3, 6>(3, 4) = inertia_columns(alpha) + detail::cross_matrix(w_r) * inertia_columns(w);
        return Y;
    }

    void learn(const Theta& b, double period)
    {
        PseudoInertia B;
        B << b[5] + b[6], -0.5 * b[9], -0.5 * b[8], 0.5 * b[1],  //
            -0.5 * b[9], b[4] + b[6], -0.5 * b[7], 0.5 * b[2],   //
            -0.5 * b[8], -0.5 * b[7], b[4] + b[5], 0.5 * b[3],   //
            0.5 * b[1], 0.5 * b[2], 0.5 * b[3], b[0];
        const PseudoInertia L = phi_.llt().matrixL();
        const Eigen::SelfAdjointEigenSolver<PseudoInertia> eigen(period * gain_ * L.transpose() * B * L);
        const PseudoInertia V = L * eigen.eigenvectors();
        phi_ = V * eigen.eigenvalues().array().exp().matrix().asDiagonal() * V.transpose();
    }

    double gravity_, k_;
    Matrix6 mass_;
    PseudoInertia phi_;
    double gain_;
};

}  // namespace inertiad
