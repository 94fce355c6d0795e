// SPDX-License-Identifier: Apache-2.0
/// Systematic corrections xi applied exactly: to the configuration, and to rows where a sensor is late.
///
///   attitude    R_true = R exp(xi)                  attitude_bias = log(exp(bias) exp(xi))
///   yaw         R_true = Rz(xi) R                   world_yaw += xi
///   alignment   R_PI_true = exp(align) R_PI         imu_orientation = exp(align) imu_orientation
///   delays      a value stamped t was measured at t - delay: the row at t gets what is stamped t + delay
///   low-pass    forces are those before it, to second order: f - xi f''
///   target, attitude delay          added to the configuration
///   biases, force offsets and gains added to the calibration
/// IMU position, scales, cable inertia, external force and friction are left out: the equations are linear in them
/// (systematic.h), and their columns are added to the residual instead, batch.hpp.
/// The order of xi is that of systematic.h.
#pragma once

#include "config.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <vector>

extern "C" {
#include "systematic.h"
}

namespace inertiad {

inline Eigen::Matrix3d rotation(const Vector3& v)
{
    const double angle = v.norm();
    return angle < 1e-12 ? Eigen::Matrix3d::Identity() : Eigen::AngleAxisd(angle, v / angle).toRotationMatrix();
}

inline Vector3 rotation_vector(const Eigen::Matrix3d& R)
{
    const Eigen::AngleAxisd a(R);
    return a.angle() * a.axis();
}

/// The configuration with xi [ipe_systematic_count()] in its calibration. Throws if a value leaves its range.
inline Config calibrated(const Config& config, const Eigen::VectorXd& xi)
{
    ipe_config_t c = config.c();
    const int m = c.n_cables;
    const Vector3 align = xi.segment<3>(IPE_XI_ALIGNMENT);
    const Eigen::Map<const Vector3> bias(config.c().attitude_bias);
    const double* q = config.c().imu_orientation;
    const Eigen::Matrix3d turned = rotation(bias) * rotation(xi.segment<3>(IPE_XI_ATTITUDE));
    Eigen::Map<Vector3>{c.attitude_bias} = rotation_vector(turned);
    const Eigen::Quaterniond o = Eigen::Quaterniond(rotation(align)) * Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
    Eigen::Map<Eigen::Vector4d>{c.imu_orientation} = Eigen::Vector4d(o.w(), o.x(), o.y(), o.z()).normalized();
    c.world_yaw += xi[IPE_XI_YAW];
    Eigen::Map<Vector3>{c.acc_bias} += xi.segment<3>(IPE_XI_ACC_BIAS);
    Eigen::Map<Vector3>{c.gyro_bias} += xi.segment<3>(IPE_XI_GYRO_BIAS);
    Eigen::Map<Vector3>{c.tracker_target} += xi.segment<3>(IPE_XI_TRACKER_TARGET);
    c.delay_attitude += xi[IPE_XI_ATTITUDE_DELAY];
    for (int i = 0; i < m; ++i) {
        c.force_offset[i] += xi[IPE_XI_FORCE + i];
        c.force_gain[i] += xi[IPE_XI_FORCE + m + i];
    }
    return Config::from(c);
}

/// Indices of xi in which the equations are linear, and which calibrated() leaves out.
inline std::vector<int> linear_parameters(int n_cables)
{
    std::vector<int> found{IPE_XI_IMU_POSITION, IPE_XI_IMU_POSITION + 1, IPE_XI_IMU_POSITION + 2,
                           IPE_XI_ACC_SCALE,    IPE_XI_GYRO_SCALE,       IPE_XI_CABLE_INERTIA};
    for (int i = IPE_XI_EXTERNAL_FORCE; i < IPE_XI_FORCE_LOWPASS; ++i) { found.push_back(i); }
    for (int i = 0; i < n_cables; ++i) { found.push_back(IPE_XI_FORCE + 2 * n_cables + i); }
    return found;
}

namespace detail {

inline double seconds(const ipe_row_t& a, const ipe_row_t& b) noexcept
{
    return 1e-9 * static_cast<double>(b.t_ns - a.t_ns);
}

constexpr double GAP = 0.25;  // s between rows that interpolation does not bridge

/// Cubic through the rows around a + share (b - a), tangents by finite differences; before and after may be null.
template <typename Read>
double cubic(const ipe_row_t* before, const ipe_row_t& a, const ipe_row_t& b, const ipe_row_t* after, double share,
             Read read)
{
    const double h = seconds(a, b), ya = read(a), yb = read(b);
    const double ma = before != nullptr ? (yb - read(*before)) / seconds(*before, b) : (yb - ya) / h;
    const double mb = after != nullptr ? (read(*after) - ya) / seconds(a, *after) : (yb - ya) / h;
    const double u = share, v = 1.0 - share;
    return v * v * ((1.0 + 2.0 * u) * ya + u * h * ma) + u * u * ((1.0 + 2.0 * v) * yb - v * h * mb);
}

/// Index of the row before row k's time plus delay, and the share of the interval; false outside the rows or in a gap.
inline bool locate(const std::vector<ipe_row_t>& rows, std::size_t k, double delay, std::size_t& at, double& share)
{
    at = k;
    double rest = delay;
    while (rest < 0.0 && at > 0) { --at, rest += seconds(rows[at], rows[at + 1]); }
    while (at + 1 < rows.size() && rest >= seconds(rows[at], rows[at + 1])) {
        rest -= seconds(rows[at], rows[at + 1]), ++at;
    }
    if (rest < 0.0 || at + 1 >= rows.size()) { return false; }
    const double h = seconds(rows[at], rows[at + 1]);
    share = rest / h;
    return h > 0.0 && h < GAP;
}

/// True where neither position nor forces differ from a neighbour's in the same stretch: a pose given as equal rows.
inline bool is_constant(const std::vector<ipe_row_t>& rows, std::size_t k, int n_cables)
{
    const auto equals = [&](std::size_t i) {
        return std::abs(seconds(rows[k], rows[i])) < GAP && std::equal(rows[k].f, rows[k].f + n_cables, rows[i].f) &&
               std::equal(rows[k].position, rows[k].position + 3, rows[i].position);
    };
    return (k > 0 && equals(k - 1)) || (k + 1 < rows.size() && equals(k + 1));
}

}  // namespace detail

namespace detail {

constexpr double CURVATURE_STEP = 0.02;  // s on either side: long enough for noise, short enough for motion of 2 Hz

/// Row nearest to CURVATURE_STEP or more before (step -1) or after (step +1) row k; k itself: there is none without a gap.
inline std::size_t beside(const std::vector<ipe_row_t>& rows, std::size_t k, int step)
{
    std::size_t at = k;
    while (std::abs(seconds(rows[k], rows[at])) < CURVATURE_STEP) {
        if ((step < 0 && at == 0) || (step > 0 && at + 1 == rows.size())) { return k; }
        const std::size_t next = step < 0 ? at - 1 : at + 1;
        if (std::abs(seconds(rows[at], rows[next])) >= GAP) { return k; }
        at = next;
    }
    return at;
}

}  // namespace detail

/// Rows with forces as they were before a low-pass of which lowpass [s2] is IPE_XI_FORCE_LOWPASS; as they are where no row
/// lies on either side.
inline std::vector<ipe_row_t> sharpened(const std::vector<ipe_row_t>& rows, int n_cables, double lowpass)
{
    if (lowpass == 0.0) { return rows; }
    std::vector<ipe_row_t> sharp = rows;
    for (std::size_t k = 0; k < rows.size(); ++k) {
        const std::size_t a = detail::beside(rows, k, -1), b = detail::beside(rows, k, 1);
        if (a == k || b == k) { continue; }
        const double before = detail::seconds(rows[a], rows[k]), after = detail::seconds(rows[k], rows[b]);
        for (int i = 0; i < n_cables; ++i) {
            const double rise = (rows[b].f[i] - rows[k].f[i]) / after, fall = (rows[k].f[i] - rows[a].f[i]) / before;
            sharp[k].f[i] -= lowpass * 2.0 * (rise - fall) / (before + after);
        }
    }
    return sharp;
}

/// Rows with position and forces as they would be, had they come delay seconds earlier; what stands in acc with the position,
/// if it was derived from that. Rows at the ends and at gaps, where nothing lies on both sides, are dropped unless they are
/// constant there: a pose at rest has no delay.
inline std::vector<ipe_row_t> undelayed(const std::vector<ipe_row_t>& rows, int n_cables, double position_delay,
                                        double force_delay, bool is_acc_moved = false)
{
    if (position_delay == 0.0 && force_delay == 0.0) { return rows; }
    std::vector<ipe_row_t> moved;
    moved.reserve(rows.size());
    for (std::size_t k = 0; k < rows.size(); ++k) {
        std::size_t p = k, f = k;
        double p_share = 0.0, f_share = 0.0;
        if (!detail::locate(rows, k, position_delay, p, p_share) || !detail::locate(rows, k, force_delay, f, f_share)) {
            if (detail::is_constant(rows, k, n_cables)) { moved.push_back(rows[k]); }
            continue;
        }
        const auto at = [&rows](std::size_t i, double share, auto read) {
            const bool has_before = i > 0 && detail::seconds(rows[i - 1], rows[i]) < detail::GAP;
            const bool has_after = i + 2 < rows.size() && detail::seconds(rows[i + 1], rows[i + 2]) < detail::GAP;
            return detail::cubic(has_before ? &rows[i - 1] : nullptr, rows[i], rows[i + 1],
                                 has_after ? &rows[i + 2] : nullptr, share, read);
        };
        ipe_row_t row = rows[k];
        for (int i = 0; i < 3; ++i) {
            row.position[i] = at(p, p_share, [i](const ipe_row_t& r) { return r.position[i]; });
            if (is_acc_moved) {
                row.acc[i] = at(p, p_share, [i](const ipe_row_t& r) { return r.acc[i]; });
            }
        }
        row.unknown_force = rows[f].unknown_force | rows[f + 1].unknown_force;
        for (int i = 0; i < n_cables; ++i) {
            row.f[i] = at(f, f_share, [i](const ipe_row_t& r) { return r.f[i]; });
        }
        if (position_delay != 0.0) {
            row.has_position = rows[p].has_position && rows[std::min(p + 1, rows.size() - 1)].has_position;
        }
        moved.push_back(row);
    }
    return moved;
}

}  // namespace inertiad
