// SPDX-License-Identifier: Apache-2.0
/// White noise of accelerometer and gyro: what it does to a window, and to rows into which it is drawn.
/// Source: window.h, eiv_correction.h. Heap: a copy of the rows. One thread.
#pragma once

#include "../derived.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

namespace inertiad::detail {

constexpr std::size_t NOISE_CHANNELS = IPE_NOISE_DENSITY_CHANNELS;  // accelerometer [3], gyro [3], P axes
constexpr double KERNEL_SQUARE =
    151.0 / 315.0;                          // integral of the kernel squared, quarters, as in firmware/core/window.c
constexpr double SLOPE_SQUARE = 2.0 / 3.0;  // of its derivative squared, per quarter cubed

using NoiseShares = std::array<double, NOISE_CHANNELS>;  ///< of the standard deviation of each channel

inline bool is_derived(Derived derived, std::size_t channel)
{
    return channel < 3 ? derived.force : derived.rate;
}

/// What one sigma of its noise in each channel does to a window's Y. Zero where the channel was derived: Y is smoothed there.
inline std::array<Regressor, NOISE_CHANNELS> regressor_noise(const ipe_average_t& a, Derived derived)
{
    std::array<Regressor, NOISE_CHANNELS> found;
    for (std::size_t i = 0; i < NOISE_CHANNELS; ++i) {
        ipe_average_t noisy = a;
        if (i < 3) {
            noisy.s[i] += std::sqrt(a.s_variance[i]);
        } else {
            noisy.alpha[i - 3] += std::sqrt(a.alpha_variance[i - 3]);
        }
        found[i] = is_derived(derived, i) ? Regressor(Regressor::Zero()) : Regressor(regressor(noisy) - regressor(a));
    }
    return found;
}

/// Standard deviation of each channel's samples, `period` [s] apart, by what the window says of its own noise.
inline NoiseShares sample_noise(const ipe_average_t& a, double period)
{
    const double quarter = 0.25 * a.length;
    NoiseShares found;
    for (std::size_t i = 0; i < 3; ++i) {
        found[i] = std::sqrt(a.s_variance[i] * quarter / (KERNEL_SQUARE * period));
        found[3 + i] = std::sqrt(a.alpha_variance[i] * quarter * quarter * quarter / (SLOPE_SQUARE * period));
    }
    return found;
}

/// Rows with as much noise again as their windows say they have, `share` [windows] of it.
inline std::vector<ipe_row_t> noisy_rows(const Config& config, const std::vector<ipe_row_t>& rows, Derived derived,
                                         const std::vector<ipe_average_t>& window,
                                         const std::vector<NoiseShares>& share, std::mt19937_64& generator)
{
    const Eigen::Matrix3d R_PI = Axes(config.c()).R_PI;
    std::normal_distribution<double> normal;
    std::vector<ipe_row_t> found = rows;
    for (std::size_t i = 1, k = 0; i < rows.size(); ++i) {
        while (k + 1 < window.size() && window[k + 1].t_ns <= rows[i].t_ns) { ++k; }
        const NoiseShares std = sample_noise(window[k], 1e-9 * static_cast<double>(rows[i].t_ns - rows[i - 1].t_ns));
        Eigen::Matrix<double, NOISE_CHANNELS, 1> noise;
        for (std::size_t c = 0; c < NOISE_CHANNELS; ++c) {
            noise[static_cast<Eigen::Index>(c)] =
                is_derived(derived, c) ? 0.0 : share[k][c] * std[c] * normal(generator);
        }
        Eigen::Map<Eigen::Vector3d>(found[i].acc) += R_PI.transpose() * noise.head<3>();
        Eigen::Map<Eigen::Vector3d>(found[i].gyro) += R_PI.transpose() * noise.tail<3>();
    }
    return found;
}

}  // namespace inertiad::detail
