// SPDX-License-Identifier: Apache-2.0
/// Tension distribution: which of all tensions with the same wrench.
///
///   minimise |f - pull|^2   subject to   W f = wrench,   low <= f <= high
/// Without a limit in the way f = pull + W^T (W W^T)^-1 (wrench - W pull), the closed form of Pott, Bruckmann, Mikelsons,
/// "Closed-form force distribution for parallel wire robots", 2009. Else f = that + N z, N the null space of W, z the
/// shortest that keeps the limits: least distance programming by non-negative least squares, Lawson, Hanson, "Solving
/// Least Squares Problems", 1974, ch. 23.
#pragma once

#include "cable.hpp"

#include <Eigen/Cholesky>
#include <Eigen/QR>

#include <algorithm>
#include <vector>

namespace inertiad {

using Tensions = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, IPE_CABLES_MAX, 1>;  ///< [m] N
using WrenchColumns = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, IPE_CABLES_MAX>;

namespace detail {

using Tall = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, IPE_CABLES_MAX, 2 * IPE_CABLES_MAX>;
using Weights = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 2 * IPE_CABLES_MAX, 1>;
using Short = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, IPE_CABLES_MAX, 1>;

/// Least squares of E u = d over the columns that are in use; the others stay 0.
inline Weights solve_used(const Tall& E, const Short& d, const std::vector<Eigen::Index>& used)
{
    Eigen::MatrixXd columns(E.rows(), static_cast<Eigen::Index>(used.size()));
    for (std::size_t j = 0; j < used.size(); ++j) { columns.col(static_cast<Eigen::Index>(j)) = E.col(used[j]); }
    const Eigen::VectorXd s = columns.colPivHouseholderQr().solve(Eigen::VectorXd(d));
    Weights u = Weights::Zero(E.cols());
    for (std::size_t j = 0; j < used.size(); ++j) { u[used[j]] = s[static_cast<Eigen::Index>(j)]; }
    return u;
}

/// u >= 0 with the least |E u - d|.
inline Weights non_negative(const Tall& E, const Short& d)
{
    Weights u = Weights::Zero(E.cols());
    std::vector<Eigen::Index> used;
    for (int round = 0; round < 6 * IPE_CABLES_MAX; ++round) {
        Weights gain = E.transpose() * (d - E * u);
        for (const Eigen::Index j : used) { gain[j] = 0.0; }
        Eigen::Index best;
        if (!(gain.maxCoeff(&best) > 1e-12)) { break; }
        used.push_back(best);
        for (Weights s = solve_used(E, d, used);; s = solve_used(E, d, used)) {
            double part = 1.0;
            for (const Eigen::Index j : used) {
                if (s[j] <= 0.0) { part = std::min(part, u[j] / (u[j] - s[j])); }
            }
            u += part * (s - u);
            if (part == 1.0) { break; }
            used.erase(std::remove_if(used.begin(), used.end(), [&](Eigen::Index j) { return u[j] <= 1e-14; }),
                       used.end());
        }
    }
    return u;
}

/// The shortest z with G z >= h; false: there is none.
inline bool least_distance(const Tall& G_transposed, const Weights& h, Short& z)
{
    const Eigen::Index n = G_transposed.rows();
    Tall E(n + 1, h.size());
    E << G_transposed, h.transpose();
    const Short d = Short::Unit(n + 1, n);
    const Short r = E * non_negative(E, d) - d;
    if (!(r.norm() > 1e-7)) { return false; }
    z = -r.head(n) / r[n];
    return true;
}

}  // namespace detail

/// f [m] for W [6][m], 6 <= m <= 16, and its limits [m], N.
///
/// False where no tensions within the limits give the wrench: f is then the even pull, cut off at the limits.
/// About 1 us for 8 cables; where limits are in the way 10 us, with heap.
inline bool distribute(const WrenchColumns& W, const Vector6& wrench, const Tensions& pull, const Tensions& low,
                       const Tensions& high, Tensions& f)
{
    const Eigen::Index m = W.cols(), n = m - 6;
    const double size = high.maxCoeff(), tolerance = 1e-9 * size;
    const Eigen::LDLT<Eigen::Matrix<double, 6, 6>> gram(W * W.transpose());
    const bool has_rank = gram.vectorD().minCoeff() > 1e-12 * gram.vectorD().maxCoeff();
    f = pull + W.transpose() * gram.solve(wrench - W * pull);
    const auto is_inside = [&] { return (f - low).minCoeff() >= -tolerance && (high - f).minCoeff() >= -tolerance; };
    if (has_rank && is_inside()) { return true; }
    if (has_rank && n > 0) {
        const Eigen::MatrixXd Q = Eigen::HouseholderQR<Eigen::MatrixXd>(W.transpose()).householderQ();
        detail::Tall G_transposed(n, 2 * m);
        G_transposed << Q.rightCols(n).transpose(), -Q.rightCols(n).transpose();
        detail::Weights h(2 * m);
        h << (low - f) / size, (f - high) / size;
        detail::Short z;
        if (detail::least_distance(G_transposed, h, z)) {
            f += size * (Q.rightCols(n) * z);
            if (is_inside()) { return true; }
        }
    }
    f = f.cwiseMax(low).cwiseMin(high);
    return false;
}

/// What a controller distributes between and around: the limits of the configuration, and an even pull of twice the weight's
/// share within them, chosen so that cables stay taut in a motion; N.
struct TensionBand {
    /// mass: kg, of the body
    TensionBand(const Config& config, double mass)
        : pull(config.n_cables()), low(config.n_cables()), high(config.n_cables())
    {
        const double share = 2.0 * mass * config.c().gravity / config.n_cables();
        for (int i = 0; i < config.n_cables(); ++i) {
            low[i] = config.c().cable[i].tension_min, high[i] = config.c().cable[i].tension_max;
            pull[i] = std::clamp(share, low[i], high[i]);
        }
    }

    Tensions pull, low, high;
};

/// Tensions f [m] that give a wrench (P axes) at the pose p (W, m), R (P to W). False: cut off at the limits. Throws
/// std::domain_error as cable_line() does.
inline bool distribute(const Config& config, const TensionBand& band, const Vector6& wrench, const Vector3& p,
                       const Matrix3& R, Tensions& f)
{
    const WrenchMatrix matrix = wrench_matrix(config, p, R, Vector3::Zero());
    return distribute(matrix.W, wrench - matrix.sag, band.pull, band.low, band.high, f);
}

}  // namespace inertiad
