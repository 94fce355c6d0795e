// SPDX-License-Identifier: Apache-2.0
/// The motion of a whole run: the platform's motion stage forward, its epochs smoothed backward.
///
///   C = P_k Phi^T P-_k+1^-1                      e_k: error of the forward estimate at epoch k, given the whole run
///   e_k|N = C (d_k+1 + e_k+1|N)                  d: correction by the measurements at the epoch's end
///   P_k|N = P_k + C (P_k+1|N - P-_k+1) C^T       S_k|N = S_k + C (S_k+1|N - S-_k+1)
/// Rauch, Tung, Striebel 1965; the sensitivities S are errors too and go the same way. Between epochs e is interpolated.
/// Heap: 5 KB per epoch of 40 ms. No state, any thread.
#pragma once

#include "config.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

extern "C" {
#include "motion.h"
}

namespace inertiad {

/// Motion at one row, and whether there is one.
struct RowMotion {
    ipe_motion_t motion;
    bool is_known;
    bool has_position;  ///< of the tracker, and not refused
};

namespace detail {

constexpr double LONGEST_TIME = 1e4;  // s, of an attitude error's correlation, as in firmware/core/motion.c

using MotionVector = Eigen::Matrix<double, IPE_MOTION_STATES, 1>;
using MotionSquare = Eigen::Matrix<double, IPE_MOTION_STATES, IPE_MOTION_STATES, Eigen::RowMajor>;
using MotionBy = Eigen::Matrix<double, IPE_MOTION_STATES, IPE_MOTION_NP, Eigen::RowMajor>;

/// The filter at the end of an epoch, or at a start.
struct MotionNode {
    std::size_t row;
    bool is_start;  ///< nothing leads here from the node before
    MotionSquare Phi, P, P_predicted;
    MotionBy S, S_predicted;
    MotionVector correction;
    Eigen::Vector3d beta, kappa;
    MotionVector error;           ///< e of the whole run
    Eigen::Vector3d correlation;  ///< of the attitude's error with that at the next node, given the whole run
};

inline MotionNode node_of(const ipe_motion_stage_t& m, std::size_t row, bool is_start)
{
    const auto square = [](const auto& a) { return MotionSquare(Eigen::Map<const MotionSquare>(&a[0][0])); };
    const auto by = [](const auto& a) { return MotionBy(Eigen::Map<const MotionBy>(&a[0][0])); };
    return {row,
            is_start,
            square(m.epoch->Phi),
            square(m.spread.P),
            square(m.epoch->predicted.P),
            by(m.spread.S),
            by(m.epoch->predicted.S),
            MotionVector(Eigen::Map<const MotionVector>(m.epoch->correction)),
            Eigen::Vector3d(m.beta),
            Eigen::Vector3d(m.kappa),
            MotionVector::Zero(),
            Eigen::Vector3d::Ones()};
}

/// P, S and error of the nodes, given the whole run.
inline void smooth(std::vector<MotionNode>& node)
{
    for (std::size_t k = node.size(); k-- > 0;) {
        MotionNode& a = node[k];
        if (k + 1 == node.size() || node[k + 1].is_start) { continue; }
        const MotionNode& b = node[k + 1];
        const MotionVector scale = b.P_predicted.diagonal().cwiseSqrt().cwiseInverse();
        const MotionSquare unit = scale.asDiagonal() * b.P_predicted * scale.asDiagonal();
        const MotionSquare scaled = scale.asDiagonal() * b.Phi * a.P;
        const MotionSquare C = (scale.asDiagonal() * unit.ldlt().solve(scaled)).transpose();
        a.error = C * (b.correction + b.error);
        const MotionSquare with_next = C * b.P;
        a.P += C * (b.P - b.P_predicted) * C.transpose();
        for (int i = 0; i < 3; ++i) {
            const int k = IPE_MOTION_PHI + i;
            a.correlation[i] = with_next(k, k) / std::sqrt(a.P(k, k) * b.P(k, k));
        }
        a.S += C * (b.S - b.S_predicted);
    }
}

/// Take the error [14] out of a motion of the forward filter.
inline void correct(const ipe_config_t& c, const Eigen::Matrix3d& R_PI, const MotionNode& at, const MotionVector& e,
                    bool has_position, ipe_motion_t& m)
{
    const Eigen::Map<const Eigen::Vector3d> target(c.tracker_target), imu(c.imu_position);
    Eigen::Map<Eigen::Vector3d> s(m.s), w(m.w), p(m.p), v(m.v);
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> R(&m.R[0][0]);
    const Eigen::Vector3d phi = e.segment<3>(IPE_MOTION_PHI), fixed = has_position ? target : imu;
    const Eigen::Vector3d kept = p + R * fixed, kept_v = v + R * w.cross(imu);
    const double angle = phi.norm();
    if (angle > 0.0) { R = (Eigen::AngleAxisd(angle, phi / angle).toRotationMatrix() * R).eval(); }
    const Eigen::Array3d beta = 1.0 - at.beta.array(), kappa = 1.0 - at.kappa.array();
    const Eigen::Array3d s_I = (R_PI.transpose() * s).array(), w_I = (R_PI.transpose() * w).array();
    s = R_PI * (s_I * (1.0 - e.segment<3>(IPE_MOTION_BETA).array() / beta)).matrix();
    w = R_PI *
        ((w_I - kappa * e.segment<3>(IPE_MOTION_BIAS).array()) * (1.0 - e.segment<3>(IPE_MOTION_KAPPA).array() / kappa))
            .matrix();
    p = kept - R * fixed + (has_position ? Eigen::Vector3d::Zero().eval() : e.segment<3>(IPE_MOTION_P).eval());
    v = kept_v + e.segment<3>(IPE_MOTION_V) - R * w.cross(imu);
}

/// The error of a node's attitude, whose next node is `step` [s] away. The forward filter's time is how fast
/// measurements reduce its error. Given the whole run, the error changes only as the gyro drifts.
inline void set_error(const MotionNode& at, double step, ipe_attitude_error_t& error)
{
    for (int i = 0; i < 3; ++i) {
        const double variance = at.P(IPE_MOTION_PHI + i, IPE_MOTION_PHI + i);
        const double loss = -std::log(std::clamp(at.correlation[i], 1e-9, 1.0));
        error.attitude_time[i] = std::min(step / std::max(loss, 1e-9), LONGEST_TIME);
        for (int k = 0; k < IPE_MOTION_NP; ++k) {
            error.attitude[i][k] = at.S(IPE_MOTION_PHI + i, k);
            error.force_scale[i][k] = at.S(IPE_MOTION_BETA + i, k);
            error.rate_scale[i][k] = at.S(IPE_MOTION_KAPPA + i, k);
        }
        error.attitude_std[i] = std::sqrt(std::max(variance, 0.0));
    }
}

}  // namespace detail

/// Motion of each row under a configuration; with [attitude] estimate "ahrs" as on the platform, else smoothed.
inline std::vector<RowMotion> smoothed_motion(const Config& config, const std::vector<ipe_row_t>& rows)
{
    const ipe_config_t& c = config.c();
    const auto stage = std::make_unique<ipe_motion_stage_t>();
    std::vector<RowMotion> found(rows.size());
    std::vector<detail::MotionNode> node;
    const auto epoch = std::make_unique<ipe_motion_epoch_t>();
    ipe_motion_init(stage.get(), &c);
    stage->epoch = epoch.get();
    for (std::size_t k = 0; k < rows.size(); ++k) {
        const uint64_t starts = stage->n_starts, refused = stage->n_positions_refused;
        const ipe_status_t status = ipe_motion_push(stage.get(), &rows[k], &found[k].motion);
        found[k].is_known = status == IPE_OK || status == IPE_NOT_READY;
        found[k].has_position = rows[k].has_position && stage->n_positions_refused == refused;
        if (stage->n_starts != starts) {
            node.push_back(detail::node_of(*stage, k, true));
        } else if (stage->is_epoch_new) {
            node.push_back(detail::node_of(*stage, k, node.empty()));
        }
        stage->is_epoch_new = false;
    }
    if (!ipe_motion_is_fused(&c)) { return found; }
    detail::smooth(node);
    const double* q = c.imu_orientation;
    const Eigen::Matrix3d R_PI = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
    for (std::size_t i = 0; i < node.size(); ++i) {
        const detail::MotionNode& a = node[i];
        const std::size_t end = i + 1 < node.size() ? node[i + 1].row : rows.size();
        const bool leads_on = i + 1 < node.size() && !node[i + 1].is_start;
        const double step = 1e-9 * static_cast<double>(rows[std::min(end, rows.size() - 1)].t_ns - rows[a.row].t_ns);
        const detail::MotionVector after = leads_on ? (node[i + 1].correction + node[i + 1].error).eval() : a.error;
        for (std::size_t k = a.row; k < end; ++k) {
            if (!found[k].is_known) { continue; }
            const double share = static_cast<double>(k - a.row) / static_cast<double>(end - a.row);
            detail::correct(c, R_PI, a, a.error + share * (after - a.error), found[k].has_position, found[k].motion);
            detail::set_error(a, step, found[k].motion.error);
        }
    }
    return found;
}

/// Rows as the platform passes them on: those with forces, with a position that was measured or carried.
inline std::vector<ipe_row_t> complete_rows(const Config& config, const std::vector<ipe_row_t>& rows)
{
    const auto stage = std::make_unique<ipe_motion_stage_t>();
    std::vector<ipe_row_t> found;
    ipe_motion_init(stage.get(), &config.c());
    for (ipe_row_t row : rows) {
        ipe_motion_t motion;
        const uint64_t refused = stage->n_positions_refused;
        const ipe_status_t status = ipe_motion_push(stage.get(), &row, &motion);
        row.has_position = row.has_position && stage->n_positions_refused == refused;
        if (!row.has_force || (status != IPE_OK && status != IPE_NOT_READY)) { continue; }
        if (!row.has_position) { ipe_motion_target(stage.get(), row.position); }
        found.push_back(row);
    }
    return found;
}

}  // namespace inertiad
