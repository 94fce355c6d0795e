// SPDX-License-Identifier: Apache-2.0
/// The pose that a controller gets from a tracker and a strapped IMU, each as late as it arrives.
///
///   p' = v + 3 k e     v' = R f - g z + b + 3 k^2 e     b' = k^3 e      e: tracked target - R target - p, m
/// f: accelerometer, m/s2; b: what it lacks, W, m/s2; gains 3 k in 1/s, 3 k^2 in 1/s2, k^3 in 1/s3. The attitude is that of the
/// newest IMU sample, turned on by its gyro. A triple pole at k: the observer of a known-acceleration double integrator with a
/// bias (Luenberger, 1964). No heap; one thread.
#pragma once

#include "types.hpp"

#include <Eigen/Geometry>

#include <algorithm>

namespace inertiad {

/// One IMU sample as measured, P axes.
struct ImuSample {
    double arrival;  ///< s
    Matrix3 R;       ///< P to W
    Vector3 w, f;    ///< rad/s; specific force at P, m/s2
};

class PoseObserver {
public:
    /// rate: k, rad/s; gravity: m/s2; target: of the tracker, P, m; p, v (W), R (P to W): the start, known.
    PoseObserver(double rate, double gravity, const Vector3& target, const Vector3& p, const Vector3& v,
                 const Matrix3& R)
        : rate_(rate), gravity_(gravity), target_(target), p_(p), v_(v), R_(R)
    {
    }

    void take(const ImuSample& sample) { R_ = sample.R, w_ = sample.w, f_ = sample.f, has_imu_ = true; }

    /// A tracked position, `since` s after the one before it.
    void take(const Vector3& tracked, double since)
    {
        const Vector3 e = tracked - R_ * target_ - p_;
        const double x = std::min(rate_ * since, 0.3);  // k since: beyond it a sampled observer would be unstable
        p_ += 3.0 * x * e;
        v_ += 3.0 * x * rate_ * e;
        b_ += x * rate_ * rate_ * e;
    }

    /// Go on by `step` s.
    void advance(double step)
    {
        const Vector3 a = has_imu_ ? Vector3(R_ * f_ - gravity_ * Vector3::UnitZ() + b_) : Vector3::Zero();
        p_ += step * v_ + 0.5 * step * step * a;
        v_ += step * a;
        const double angle = step * w_.norm();
        if (angle > 0.0) { R_ = R_ * Eigen::AngleAxisd(angle, w_.normalized()).toRotationMatrix(); }
    }

    const Vector3& p() const { return p_; }
    const Vector3& v() const { return v_; }
    const Matrix3& R() const { return R_; }
    const Vector3& w() const { return w_; }

private:
    double rate_, gravity_;
    Vector3 target_, p_, v_, b_ = Vector3::Zero(), f_ = Vector3::Zero(), w_ = Vector3::Zero();
    Matrix3 R_;
    bool has_imu_ = false;
};

}  // namespace inertiad
