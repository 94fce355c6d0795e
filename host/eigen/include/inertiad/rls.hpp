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
    explicit Rls(ipe_rls_t& s) noexcept : s_(&s) {}
    ipe_status_t init(const Theta& x, const Covariance& P) noexcept { return ipe_rls_init(s_, x.data(), as_array(P)); }
    ipe_status_t update(const Regressor& Y, const Vector6& y, const Matrix6& L, double& nis) noexcept
    {
        return ipe_rls_update(s_, as_array(Y), y.data(), as_array(L), &nis);
    }
    Eigen::Map<const Theta> x() const noexcept { return Eigen::Map<const Theta>(s_->x); }
    Covariance P() const noexcept
    {
        Covariance P;
        ipe_rls_covariance(s_, as_array(P));
        return P;
    }

private:
    ipe_rls_t* s_;
};

}  // namespace inertiad
