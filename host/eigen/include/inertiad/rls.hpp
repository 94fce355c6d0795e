// SPDX-License-Identifier: Apache-2.0
/// View of the recursive estimator. Same verbs as firmware/core/rls.h.
#pragma once

#include "types.hpp"

extern "C" {
#include "rls.h"
}

namespace inertiad {

/// View of a C estimator: same verbs, no copies, no logic. The ipe_rls_t must outlive it.
class Rls {
public:
    using Rows = Eigen::Matrix<double, IPE_NY, Eigen::Dynamic, Eigen::RowMajor, IPE_NY, IPE_NX_MAX>;

    explicit Rls(ipe_rls_t& s) noexcept : s_(&s) {}
    ipe_status_t init(const Theta& theta, const Covariance& P, const Eigen::VectorXd& xi_std) noexcept
    {
        return ipe_rls_init(s_, theta.data(), as_array(P), static_cast<int>(xi_std.size()), xi_std.data());
    }
    /// H [6][n()], whitened on return.
    ipe_status_t update(Rows& H, const Vector6& y, const Matrix6& L, double& nis) noexcept
    {
        return ipe_rls_update(s_, H.data(), y.data(), as_array(L), &nis);
    }
    int n() const noexcept { return s_->n; }
    Eigen::Map<const Eigen::VectorXd> x() const noexcept { return Eigen::Map<const Eigen::VectorXd>(s_->x, s_->n); }
    Eigen::MatrixXd P() const
    {
        Eigen::MatrixXd P(s_->n, s_->n);  // symmetric: its order of storage does not matter
        ipe_rls_covariance(s_, s_->n, P.data());
        return P;
    }

private:
    ipe_rls_t* s_;
};

}  // namespace inertiad
