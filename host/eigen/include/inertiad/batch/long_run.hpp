// SPDX-License-Identifier: Apache-2.0
/// Long-run variance of a series of residuals: what the sum of N correlated values varies by, over N.
///
///   v = r_0 + 2 sum_{k=1..L} (1 - k/(L+1)) r_k                    Bartlett weights
///   L + 1 = 1.1447 (4 rho^2 / (1 - rho^2)^2 N)^(1/3)              bandwidth for a series like AR(1) with rho = r_1 / r_0
/// L is at least the platform's (noise.h), so that healthy windows, which overlap, are weighted as there, at most 20 s and a
/// third of the series: beyond that too few products are left to average.
/// Source: Newey, West, Econometrica 55(3), 1987; Andrews, Econometrica 59(3), 1991, (6.2) and (6.4).
/// No state, any thread; N times L products.
#pragma once

#include "../derived.hpp"
#include "../windows.hpp"

extern "C" {
#include "noise.h"
}

#include <algorithm>
#include <cmath>
#include <vector>

namespace inertiad::detail {

constexpr double BANDWIDTH_MAX = 20.0;  // s

template <int N>
using Series = std::vector<Eigen::Matrix<double, N, 1>>;

/// Bandwidth L for a series of residuals of windows that follow each other.
template <int N>
double bandwidth(const std::vector<ipe_average_t>& window, const Series<N>& e)
{
    constexpr double LEAST = IPE_NOISE_LAGS;
    if (e.size() < 3) { return LEAST; }
    Eigen::Array<double, N, 1> r0 = Eigen::Array<double, N, 1>::Constant(1e-300), r1 = r0;
    for (std::size_t k = 1; k < e.size(); ++k) {
        if (!follows(window, k, 1)) { continue; }
        r0 += e[k].array().square();
        r1 += e[k].array() * e[k - 1].array();
    }
    const double rho = std::clamp((r1 / r0).maxCoeff(), 0.0, 0.999);
    const double alpha = 4.0 * rho * rho / std::pow(1.0 - rho * rho, 2);
    const double best = 1.1447 * std::cbrt(alpha * static_cast<double>(e.size()));
    const double hop = 0.25 * window.front().length;
    const double most = std::min(BANDWIDTH_MAX / std::max(hop, 1e-3), static_cast<double>(e.size()) / 3.0);
    return std::max(LEAST, std::min(best, most));
}

/// Long-run second moment with bandwidth L, products across gaps left out; a sum over windows.
template <int N>
Eigen::Matrix<double, N, N> long_run_sum(const std::vector<ipe_average_t>& window, const Series<N>& e, double L)
{
    Eigen::Matrix<double, N, N> sum = Eigen::Matrix<double, N, N>::Zero();
    for (std::size_t k = 0; k < e.size(); ++k) {
        Eigen::Matrix<double, N, 1> past = 0.5 * e[k];
        for (std::size_t lag = 1; lag <= k; ++lag) {
            const double weight = 1.0 - static_cast<double>(lag) / (L + 1.0);
            if (weight <= 0.0 || !follows(window, k, lag)) { break; }
            past += weight * e[k - lag];
        }
        sum += e[k] * past.transpose() + past * e[k].transpose();
    }
    return sum;
}

}  // namespace inertiad::detail
