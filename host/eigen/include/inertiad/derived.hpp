// SPDX-License-Identifier: Apache-2.0
/// Runs in which no sensor measured the specific force, or the rate: they were derived from positions and attitude.
///
///   s = R^T (x'' + g z)      w from q, in the axes that q turns
/// A derived motion errs as its sources do: with the attitude's bias, yaw and wander, and with the tracker's delay; a bias
/// of its own it has none. Noise of positions and attitude, differentiated, is large: regressors are taken from smoothed motion, else
/// noise wears the body down (errors in variables), while the residual stays as measured.
#pragma once

#include "calibrated.hpp"
#include "windows.hpp"

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

namespace inertiad {

/// Which parts of a run's motion were derived.
struct Derived {
    bool force = false;
    bool rate = false;
};

/// The configuration under which a run can be used: without a measured rate or specific force the attitude is the AHRS's.
inline Config usable(const Config& config, Derived derived)
{
    ipe_config_t c = config.c();
    if (derived.force || derived.rate) { c.attitude_estimate = IPE_ATTITUDE_AHRS; }
    return Config::from(c);
}

namespace detail {

/// How I axes, P axes and W lie to each other under a configuration.
struct Axes {
    explicit Axes(const ipe_config_t& c)
        : R_PI(
              Eigen::Quaterniond(c.imu_orientation[0], c.imu_orientation[1], c.imu_orientation[2], c.imu_orientation[3])
                  .toRotationMatrix()),
          attitude(R_PI.transpose() * rotation(Eigen::Map<const Vector3>(c.attitude_bias))),
          yaw(rotation(Vector3(0.0, 0.0, c.world_yaw))), acc_bias(c.acc_bias), gyro_bias(c.gyro_bias)
    {
    }

    Eigen::Matrix3d to_world(const ipe_row_t& row) const
    {
        return yaw * Eigen::Quaterniond(row.q[0], row.q[1], row.q[2], row.q[3]).toRotationMatrix() * attitude;
    }

    Eigen::Matrix3d R_PI;
    Eigen::Matrix3d attitude;  ///< P axes to those that q turns
    Eigen::Matrix3d yaw;
    Eigen::Vector3d acc_bias, gyro_bias;
};

/// Derived motion out of its rows: specific force in W, rate in the axes that q turns.
inline void as_derived(const Axes& axes, Derived derived, std::vector<ipe_row_t>& rows)
{
    for (ipe_row_t& row : rows) {
        Eigen::Map<Eigen::Vector3d> acc(row.acc), gyro(row.gyro);
        if (derived.force) { acc = (axes.to_world(row) * axes.R_PI * (acc - axes.acc_bias)).eval(); }
        if (derived.rate) { gyro = (axes.attitude * axes.R_PI * (gyro - axes.gyro_bias)).eval(); }
    }
}

/// The way back, to what an IMU would have measured.
inline void as_measured(const Axes& axes, Derived derived, std::vector<ipe_row_t>& rows)
{
    for (ipe_row_t& row : rows) {
        Eigen::Map<Eigen::Vector3d> acc(row.acc), gyro(row.gyro);
        if (derived.force) { acc = ((axes.to_world(row) * axes.R_PI).transpose() * acc).eval() + axes.acc_bias; }
        if (derived.rate) { gyro = ((axes.attitude * axes.R_PI).transpose() * gyro).eval() + axes.gyro_bias; }
    }
}

/// -d(Y theta)/d(turn) [6][3]: derived motion as it looks from a body turned by a small rotation vector, P axes.
inline Eigen::Matrix<double, 6, 3> turned_motion(Derived derived, const ipe_average_t& a, const Theta& theta)
{
    const Eigen::Map<const Vector3> s(a.s), w(a.w), alpha(a.alpha);
    Eigen::Matrix<double, 6, 3> columns;
    for (int k = 0; k < 3; ++k) {
        const Vector3 axis = -Vector3::Unit(k);
        Eigen::Matrix3d ww = Eigen::Matrix3d::Zero();
        Vector3 ds = Vector3::Zero(), dalpha = Vector3::Zero();
        if (derived.force) { ds = axis.cross(s); }
        if (derived.rate) {
            const Vector3 dw = axis.cross(w);
            ww = w * dw.transpose() + dw * w.transpose();
            dalpha = axis.cross(alpha);
        }
        const double dww[6] = {ww(0, 0), ww(1, 1), ww(2, 2), ww(1, 2), ww(0, 2), ww(0, 1)};
        Regressor Y;
        ipe_regressor(ds.data(), dww, dalpha.data(), as_array(Y));
        columns.col(k) = -Y * theta;
    }
    return columns;
}

/// True where window k follows window k - lag without a gap.
inline bool follows(const std::vector<ipe_average_t>& window, std::size_t k, std::size_t lag)
{
    const double hop = 0.25 * window[k].length;
    return 1e-9 * static_cast<double>(window[k].t_ns - window[k - lag].t_ns) < (static_cast<double>(lag) + 0.5) * hop;
}

}  // namespace detail

/// Rows of a run under config as they would be under corrected = calibrated(config, xi), its delays and low-pass taken out.
inline std::vector<ipe_row_t> corrected_rows(const Config& config, const Config& corrected, const Eigen::VectorXd& xi,
                                             std::vector<ipe_row_t> rows, Derived derived)
{
    const int m = config.n_cables();
    const double position_delay = xi[IPE_XI_POSITION_DELAY], force_delay = xi[IPE_XI_FORCE_DELAY];
    detail::as_derived(detail::Axes(config.c()), derived, rows);
    const std::vector<ipe_row_t> sharp = sharpened(rows, m, xi[IPE_XI_FORCE_LOWPASS]);
    std::vector<ipe_row_t> moved = undelayed(sharp, m, position_delay, force_delay, derived.force);
    detail::as_measured(detail::Axes(corrected.c()), derived, moved);
    return moved;
}

/// A window whose derived motion is free of noise, and what of its neighbours its columns need.
struct SmoothWindow {
    ipe_average_t average;
    Eigen::Vector3d jerk;  ///< change of the specific force in W, P axes, m/s3; zero where it was measured
    std::array<double, IPE_CABLES_MAX> f_curvature;  ///< of the tensions, N/s2; zero until set_force_curvature()
};

namespace detail {

/// Windows k - reach to k + reach with nothing missing between them.
inline std::size_t reach_around(const std::vector<ipe_average_t>& window, std::size_t k)
{
    std::size_t reach = std::min({std::size_t{4}, k, window.size() - 1 - k});
    while (reach > 0 && !follows(window, k + reach, 2 * reach)) { --reach; }
    return reach;
}

/// Value at its middle, and slope per step, of the parabola through a member [n] of windows k - reach to k + reach.
template <int N, typename Read>
std::pair<Eigen::Matrix<double, N, 1>, Eigen::Matrix<double, N, 1>>
parabola(const std::vector<ipe_average_t>& window, std::size_t k, std::size_t reach, Read read)
{
    const double r = static_cast<double>(reach), count = 2.0 * r + 1.0;
    Eigen::Matrix<double, N, 1> value = Eigen::Matrix<double, N, 1>::Zero(), slope = value;
    for (std::size_t i = k - reach; i <= k + reach; ++i) {
        const double j = static_cast<double>(i) - static_cast<double>(k);
        const Eigen::Map<const Eigen::Matrix<double, N, 1>> x(read(window[i]));
        value += 3.0 * (3.0 * r * r + 3.0 * r - 1.0 - 5.0 * j * j) / ((2.0 * r - 1.0) * count * (2.0 * r + 3.0)) * x;
        if (reach > 0) { slope += 3.0 * j / (r * (r + 1.0) * count) * x; }
    }
    return {value, slope};
}

}  // namespace detail

/// Windows with derived motion smoothed: a parabola through each one and up to four on either side. Its noise, twice
/// differentiated, is mostly above 2 Hz and goes; what is left of the motion makes a regressor free of noise.
inline std::vector<SmoothWindow> smoothed(Derived derived, const std::vector<ipe_average_t>& window)
{
    std::vector<SmoothWindow> found;
    for (std::size_t k = 0; k < window.size(); ++k) {
        SmoothWindow x{window[k], Eigen::Vector3d::Zero(), {}};
        ipe_average_t& a = x.average;
        const std::size_t reach = detail::reach_around(window, k);
        if (derived.rate) {
            const auto part = [&](auto read) { return detail::parabola<3>(window, k, reach, read).first; };
            Eigen::Map<Eigen::Vector3d>(a.w) = part([](const ipe_average_t& i) { return i.w; });
            Eigen::Map<Eigen::Vector3d>(a.alpha) = part([](const ipe_average_t& i) { return i.alpha; });
            const auto ww = detail::parabola<6>(window, k, reach, [](const ipe_average_t& i) { return i.ww; });
            Eigen::Map<Eigen::Matrix<double, 6, 1>>(a.ww) = ww.first;
        }
        if (derived.force) {
            const auto [s, slope] = detail::parabola<3>(window, k, reach, [](const ipe_average_t& i) { return i.s; });
            Eigen::Map<Eigen::Vector3d>(a.s) = s;
            x.jerk = slope / (0.25 * a.length) + Eigen::Map<const Vector3>(a.w).cross(s);
        }
        found.push_back(x);
    }
    return found;
}

/// How tensions f [windows][m] bend, from each window as measured and the one on either side; zero beside a gap.
inline void set_force_curvature(const std::vector<ipe_average_t>& measured, const std::vector<Eigen::VectorXd>& f,
                                std::vector<SmoothWindow>& window)
{
    for (std::size_t k = 1; k + 1 < window.size(); ++k) {
        if (!detail::follows(measured, k + 1, 2)) { continue; }
        const double since = 1e-9 * static_cast<double>(measured[k].t_ns - measured[k - 1].t_ns);
        const double until = 1e-9 * static_cast<double>(measured[k + 1].t_ns - measured[k].t_ns);
        const Eigen::VectorXd rise = (f[k + 1] - f[k]) / until, fall = (f[k] - f[k - 1]) / since;
        Eigen::Map<Eigen::VectorXd>(window[k].f_curvature.data(), rise.size()) = 2.0 * (rise - fall) / (since + until);
    }
}

/// systematic_columns() of a window whose motion was derived, and with that of the forces' low-pass.
inline SystematicColumns systematic_columns(const Config& config, Derived derived, const SmoothWindow& window,
                                            const Theta& theta)
{
    const ipe_average_t& a = window.average;
    SystematicColumns X = systematic_columns(config, a, theta);
    for (int i = 0; i < config.n_cables(); ++i) {  // minus the column of a force offset is that of the measured force
        const auto at = static_cast<std::size_t>(i);
        X.col(IPE_XI_FORCE_LOWPASS) +=
            (1.0 + config.c().force_gain[i]) * window.f_curvature[at] * X.col(IPE_XI_FORCE + i);
    }
    X.middleCols<3>(IPE_XI_ATTITUDE) += detail::turned_motion(derived, a, theta);
    if (derived.force) {
        X.col(IPE_XI_YAW) += detail::turned_motion({true, false}, a, theta) * Eigen::Map<const Vector3>(a.R[2]);
        const double none[6] = {0.0};
        Regressor Y;
        ipe_regressor(window.jerk.data(), none, none, as_array(Y));
        X.col(IPE_XI_POSITION_DELAY) -= Y * theta;
        X.middleCols<3>(IPE_XI_ACC_BIAS).setZero();
        X.col(IPE_XI_ACC_SCALE).setZero();
    }
    if (derived.rate) {
        X.middleCols<3>(IPE_XI_GYRO_BIAS).setZero();
        X.col(IPE_XI_GYRO_SCALE).setZero();
    }
    return X;
}

}  // namespace inertiad
