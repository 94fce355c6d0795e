// SPDX-License-Identifier: Apache-2.0
/// Eigen types of the C core's arrays, and views of them. The core's arrays are row-major; so are these types.
#pragma once

#include <Eigen/Core>

extern "C" {
#include "types.h"
}

namespace inertiad {

using Vector3 = Eigen::Vector3d;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Theta = Eigen::Matrix<double, IPE_NP, 1>;  ///< m, h, J: kg, kg m, kg m2
using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Matrix6 = Eigen::Matrix<double, IPE_NY, IPE_NY, Eigen::RowMajor>;
using Covariance = Eigen::Matrix<double, IPE_NP, IPE_NP, Eigen::RowMajor>;  ///< of Theta
using Regressor = Eigen::Matrix<double, IPE_NY, IPE_NP, Eigen::RowMajor>;   ///< wrench = Regressor * Theta
using PseudoInertia = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

/// A row-major Eigen matrix as the C array double[Rows][Cols] it is.
template <int Rows, int Cols>
auto as_array(Eigen::Matrix<double, Rows, Cols, Eigen::RowMajor>& m) noexcept
{
    return reinterpret_cast<double (*)[Cols]>(m.data());
}

template <int Rows, int Cols>
auto as_array(const Eigen::Matrix<double, Rows, Cols, Eigen::RowMajor>& m) noexcept
{
    return reinterpret_cast<const double (*)[Cols]>(m.data());
}

}  // namespace inertiad
