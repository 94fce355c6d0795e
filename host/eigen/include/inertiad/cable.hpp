// SPDX-License-Identifier: Apache-2.0
/// Cable lines and the wrench matrix of a pose. Same verbs as firmware/core/cable.h and wrench.h.
#pragma once

#include "config.hpp"

extern "C" {
#include "cable.h"
#include "wrench.h"
}

namespace inertiad {

/// Line of one cable to the platform point B (W, m). Throws std::domain_error where it has no direction.
inline ipe_cable_line_t cable_line(const ipe_cable_t& cable, const Vector3& B)
{
    ipe_cable_line_t line;
    if (ipe_cable_line(&cable, B.data(), &line) != IPE_OK) {
        throw std::domain_error("platform point inside the pulley, on its swivel axis or on the anchor");
    }
    return line;
}

/// wrench = W f + sag at a body point, P axes.
struct WrenchMatrix {
    Eigen::Matrix<double, IPE_NY, Eigen::Dynamic, Eigen::RowMajor, IPE_NY, IPE_CABLES_MAX> W;
    Vector6 sag;
};

/// At the pose p (W, m), R (P to W), about point (P, m). Throws std::domain_error as cable_line() does.
inline WrenchMatrix wrench_matrix(const Config& config, const Vector3& p, const Matrix3& R, const Vector3& point)
{
    Eigen::Matrix<double, IPE_NY, IPE_CABLES_MAX, Eigen::RowMajor> W;
    WrenchMatrix out;
    if (ipe_wrench_matrix(&config.c(), p.data(), as_array(R), point.data(), as_array(W), out.sag.data()) != IPE_OK) {
        throw std::domain_error("a cable has no direction at this pose");
    }
    out.W = W.leftCols(config.n_cables());
    return out;
}

}  // namespace inertiad
