// SPDX-License-Identifier: Apache-2.0
/// White noise of accelerometer and gyro as windows have it: averaged by the kernel, and by its slope. Windows that overlap
/// have noise in common. The same numbers every time.
/// Source: window.h; the kernel at steps of an eighth of its length. No heap beside the generator, one thread.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <random>

namespace inertiad::detail {

class WindowNoise {
public:
    /// Noise of unit variance of the next window, a quarter of its length later: specific force [3], angular acceleration [3].
    std::array<double, 6> next()
    {
        std::array<double, 6> found{};
        for (std::size_t i = 0; i < found.size(); ++i) {
            auto& step = step_[i];
            step = {step[2], step[3], step[4], step[5], step[6], draw(), draw()};
            const auto& kernel = i < 3 ? KERNEL : SLOPE;
            double sum = 0.0, square = 0.0;
            for (std::size_t j = 0; j < step.size(); ++j) {
                sum += kernel[j] * step[j], square += kernel[j] * kernel[j];
            }
            found[i] = sum / std::sqrt(square);
        }
        return found;
    }

private:
    static constexpr std::array<double, 7> KERNEL = {1.0,  8.0, 23.0, 32.0,
                                                     23.0, 8.0, 1.0};  // of the cubic B-spline, times 48
    static constexpr std::array<double, 7> SLOPE = {1.0, 4.0, 5.0, 0.0, -5.0, -4.0, -1.0};  // of its slope, times 8

    double draw() { return normal_(generator_); }

    std::mt19937_64 generator_{1};
    std::normal_distribution<double> normal_;
    std::array<std::array<double, 7>, 6> step_{};  ///< white noise of the last steps
};

}  // namespace inertiad::detail
