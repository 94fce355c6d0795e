// SPDX-License-Identifier: Apache-2.0
/// Anderson's acceleration of a fixed-point iteration x <- G(x), f = G(x) - x.
///
///   x_next = G_k - sum_j gamma_j (G_j+1 - G_j),   gamma = argmin |f_k - sum_j gamma_j (f_j+1 - f_j)|,   j = k - 3 .. k - 1
/// Source: Walker, Ni, SIAM Journal on Numerical Analysis 49(4), 2011, (2.1).
/// Heap: eight vectors of x and a QR of three columns. No state beside it, any thread.
#pragma once

#include <Eigen/QR>

#include <deque>

namespace inertiad::detail {

constexpr std::size_t ANDERSON_DEPTH = 3;  // differences kept: chosen, more would reach back to other points
constexpr double ANDERSON_RANK = 1e-3;     // of the largest difference: smaller ones are rounding and curvature
constexpr double ANDERSON_NEAR = 0.3;      // of x: a longer way from x to G is no place to extrapolate from,
constexpr double ANDERSON_REACH = 5.0;     // and an extrapolation so many times that way is a failed one

class Anderson {
public:
    /// The next x after G = G(x): G itself far from the fixed point and where extrapolation fails.
    Eigen::VectorXd next(const Eigen::VectorXd& x, const Eigen::VectorXd& G)
    {
        const double length = (G - x).cwiseAbs().maxCoeff();
        if (length > ANDERSON_NEAR) {
            restart();
            return G;
        }
        G_.push_back(G);
        f_.push_back(G - x);
        if (G_.size() > ANDERSON_DEPTH + 1) { G_.pop_front(), f_.pop_front(); }
        const auto k = static_cast<Eigen::Index>(G_.size()) - 1;
        if (k == 0) { return G; }
        Eigen::MatrixXd by_f(x.size(), k), by_G(x.size(), k);
        for (Eigen::Index j = 0; j < k; ++j) {
            const auto at = static_cast<std::size_t>(j);
            by_f.col(j) = f_[at + 1] - f_[at];
            by_G.col(j) = G_[at + 1] - G_[at];
        }
        Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(x.size(), k);
        qr.setThreshold(ANDERSON_RANK);
        const Eigen::VectorXd step = by_G * qr.compute(by_f).solve(f_.back());
        return step.cwiseAbs().maxCoeff() < ANDERSON_REACH * length ? Eigen::VectorXd(G - step) : G;
    }

    /// Forget the past: G is another one.
    void restart() { G_.clear(), f_.clear(); }

private:
    std::deque<Eigen::VectorXd> G_, f_;
};

}  // namespace inertiad::detail
