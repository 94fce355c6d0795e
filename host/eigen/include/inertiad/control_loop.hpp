// SPDX-License-Identifier: Apache-2.0
/// A platform under a model-based controller whose parameters come from somewhere: nominal, live through the gate, exact, or
/// adapted. Advances step by step, so that a daemon can be asked between the steps.
#pragma once

#include "adaptive.hpp"
#include "parameter_gate.hpp"
#include "plant.hpp"
#include "pose_observer.hpp"

#include <functional>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

namespace inertiad {

/// Where the controller's parameters come from.
enum class Arm { nominal, live, oracle, adaptive };

/// The pose that the controller gets: the true one, or what sensors make of it. Times are those of the motion, s.
struct PoseSensors {
    std::vector<double> imu_t, imu_arrival, tracker_t, tracker_arrival;
    std::vector<Vector3> attitude_error;                        ///< rad, P axes: measured R = Rz(-yaw) R exp(-this)
    std::vector<Vector3> gyro_error, acc_error, tracker_error;  ///< P axes; the tracker's W, m
    double yaw = 0.0;                                           ///< rad
    double tracker_delay = 0.0;                                 ///< s, the position is that much older than its time
    Matrix3 alignment = Matrix3::Identity();  ///< of the IMU: turns true P axes into those it measures in
    Vector3 target = Vector3::Zero();         ///< of the tracker, P
    double observer_rate = 0.0;               ///< rad/s
};

/// A row per control instant.
struct ControlRow {
    Vector3 e_p;            ///< m, wanted - true place of P
    double e_R;             ///< rad
    double tension_norm;    ///< N, of the true tensions
    double tension_step;    ///< N, greatest change of a commanded tension by this instant's change of parameters alone
    double beyond;          ///< N, by which the worst true tension breaks its limit; 0: none does
    bool is_cut;            ///< no tensions within the limits give the wrench: the command is cut off at them
    Theta theta;            ///< in use
    ipe_gate_source_t source;
    std::int64_t sequence;  ///< of the estimate in use; -1: none
};

class ControlLoop {
public:
    /// Configurations are kept by reference. start_ns: host time of the motion's beginning; tilt: swing of the cables then,
    /// rad.
    ControlLoop(const Config& truth, const Config& believed, const PlantSettings& settings, const Theta& theta,
                const Theta& nominal, std::vector<PayloadChange> changes, std::vector<Reference> wanted, Arm arm,
                const ipe_gate_limits_t& limits, std::int64_t start_ns, std::optional<PoseSensors> sensors,
                const Tilt& tilt)
        : truth_(truth), believed_(believed), settings_(settings), plant_(truth, settings, theta, std::move(changes)),
          holder_(truth, settings, theta), controller_(believed, settings, arm == Arm::oracle ? theta : nominal),
          law_(nominal, settings.control_rate, truth.c().gravity), gate_(nominal, limits), arm_(arm),
          start_ns_(start_ns), wanted_(std::move(wanted)), x_(truth.n_cables()), dx_(truth.n_cables())
    {
        if (wanted_.empty()) { throw std::invalid_argument("no references"); }
        start(theta);
        x_.tilt() = tilt;
        if (sensors) {
            sensors_ = std::move(sensors);
            const Reference& first = wanted_.front();
            observer_.emplace(sensors_->observer_rate, truth.c().gravity, sensors_->target, first.p, first.v, first.R);
        }
    }

    std::size_t size() const { return wanted_.size(); }
    std::size_t done() const { return k_; }
    int steps_per_control() const { return settings_.steps_per_control; }
    ParameterGate& gate() { return gate_; }

    /// Called at every step of integration with its number, the state and the forces.
    using Observer = std::function<void(std::size_t, PlantState&, const PlantForces&)>;

    /// Go on by n periods of control, or to the end. Throws std::domain_error where the motion is unstable.
    void advance(std::size_t n, std::vector<ControlRow>& rows, const Observer& log)
    {
        const auto per = static_cast<std::size_t>(settings_.steps_per_control);
        const double period = settings_.steps_per_control * settings_.step;
        for (const std::size_t end = std::min(k_ + n, wanted_.size()); k_ < end; ++k_) {
            const double t = static_cast<double>(k_) * period;
            ControlRow row{};
            const long n_cut = controller_.n_infeasible;
            const Command next = command(t, period, row);
            row.is_cut = controller_.n_infeasible > n_cut;
            if (k_ == 0) { before_ = next; }
            const Ramp now{before_, next, t, period};
            before_ = next;
            for (std::size_t j = 0; j < (k_ + 1 == wanted_.size() ? 1 : per); ++j) {
                const double at = static_cast<double>(k_ * per + j) * settings_.step;
                const PlantForces forces = plant_.derivative(at, x_, now, dx_);
                if (j == 0) { judge(forces, row); }
                log(k_ * per + j, x_, forces);
                if (k_ + 1 < wanted_.size()) { plant_.step(at, now, dx_, x_); }
            }
            rows.push_back(row);
            if (!(x_.x.allFinite() && x_.p().norm() < 1e4)) { throw std::domain_error("the motion is unstable"); }
        }
    }

private:
    struct Instant {
        Vector3 p, w, f;  ///< f: specific force at P, P axes
        Matrix3 R;
    };

    void start(const Theta& theta)
    {
        const Reference& first = wanted_.front();
        const Eigen::Quaterniond q{Eigen::Matrix3d(first.R)};
        x_.p() = first.p, x_.v() = first.v, x_.w() = first.w;
        x_.q() << q.w(), q.x(), q.y(), q.z();
        const Vector3 s = first.R.transpose() * (first.a + truth_.c().gravity * Vector3::UnitZ());
        const Regressor Y = regressor(s, first.w, first.alpha);
        Tensions f;
        if (!holder_.hold(x_, Y * theta, f)) {
            throw std::domain_error("no tensions within the limits hold the platform at the start");
        }
        plant_.tension(x_, f);
        const auto matrix = wrench_matrix(believed_, first.p, first.R, Vector3::Zero());
        controller_.integral = matrix.W * f + matrix.sag - Y * controller_.body();
    }

    Command command(double t, double period, ControlRow& row)
    {
        const Reference& wanted = wanted_[k_];
        PlantState seen = observed(t, period);
        row.source = IPE_GATE_NOMINAL, row.sequence = -1;
        if (arm_ == Arm::adaptive) {
            const Command out = controller_.give(seen, wanted, law_.wrench(seen, wanted, period));
            row.theta = law_.theta();
            return out;
        }
        const Vector6 integral = controller_.integral;
        const Theta before = controller_.body();
        if (arm_ == Arm::oracle) { controller_.hand_over(plant_.theta(t), seen.R()); }
        if (arm_ == Arm::live) {
            const ParameterGate::Parameters p =
                gate_.read(start_ns_ + static_cast<std::int64_t>(std::llround(1e9 * t)));
            controller_.hand_over(p.theta, seen.R());
            row.source = p.source, row.sequence = p.sequence;
        }
        row.theta = controller_.body();
        const Command out = controller_.command(seen, wanted, period);
        if (row.theta != before) {
            Controller other(believed_, settings_, before);
            other.integral = integral;
            row.tension_step = (out.f - other.command(seen, wanted, period).f).cwiseAbs().maxCoeff();
        }
        return out;
    }

    /// The state as the controller knows it at time t.
    PlantState observed(double t, double period)
    {
        if (past_.empty()) { return x_; }
        const PoseSensors& s = *sensors_;
        observer_->advance(period);
        for (; imu_ < s.imu_t.size() && s.imu_arrival[imu_] <= t; ++imu_) {
            const Instant at = at_time(s.imu_t[imu_]);
            const Matrix3 yaw = Eigen::AngleAxisd(-s.yaw, Vector3::UnitZ()).toRotationMatrix();
            const Vector3& e = s.attitude_error[imu_];
            const Matrix3 off = Eigen::AngleAxisd(-e.norm(), e.stableNormalized()).toRotationMatrix();
            observer_->take(ImuSample{s.imu_arrival[imu_], yaw * at.R * off, s.alignment * at.w + s.gyro_error[imu_],
                                      s.alignment * at.f + s.acc_error[imu_]});
        }
        for (; tracked_ < s.tracker_t.size() && s.tracker_arrival[tracked_] <= t; ++tracked_) {
            const Instant at = at_time(s.tracker_t[tracked_] - s.tracker_delay);
            const double since = tracked_ > 0 ? s.tracker_t[tracked_] - s.tracker_t[tracked_ - 1] : 0.0;
            observer_->take(at.p + at.R * s.target + s.tracker_error[tracked_], since);
        }
        PlantState seen = x_;
        const Eigen::Quaterniond q{Eigen::Matrix3d(observer_->R())};
        seen.p() = observer_->p(), seen.v() = observer_->v(), seen.w() = observer_->w();
        seen.q() << q.w(), q.x(), q.y(), q.z();
        return seen;
    }

    /// The control instant at or before t, within what is remembered.
    const Instant& at_time(double t) const
    {
        const double period = settings_.steps_per_control * settings_.step;
        const auto last = static_cast<std::ptrdiff_t>(past_.size()) - 1;
        const auto k = static_cast<std::ptrdiff_t>(std::floor(t / period + 1e-6));
        return past_[static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(k, 0, last))];
    }

    void judge(const PlantForces& forces, ControlRow& row)
    {
        const Reference& wanted = wanted_[k_];
        row.e_p = wanted.p - x_.p();
        row.e_R = Eigen::AngleAxisd{Eigen::Matrix3d(x_.R().transpose() * wanted.R)}.angle();
        row.tension_norm = forces.f.norm();
        for (Eigen::Index i = 0; i < forces.f.size(); ++i) {
            const ipe_cable_t& cable = truth_.c().cable[i];
            row.beyond = std::max({row.beyond, cable.tension_min - forces.f[i], forces.f[i] - cable.tension_max});
        }
        if (!observer_) { return; }
        const Matrix3 R = x_.R();
        past_.push_back({x_.p(), x_.w(), R.transpose() * (forces.a + truth_.c().gravity * Vector3::UnitZ()), R});
    }

    const Config &truth_, &believed_;
    PlantSettings settings_;
    Plant plant_;
    Controller holder_, controller_;
    AdaptiveLaw law_;
    ParameterGate gate_;
    Arm arm_;
    std::int64_t start_ns_;
    std::vector<Reference> wanted_;
    PlantState x_, dx_;
    Command before_;
    std::size_t k_ = 0, imu_ = 0, tracked_ = 0;
    std::optional<PoseSensors> sensors_;
    std::optional<PoseObserver> observer_;
    std::vector<Instant> past_;
};

}  // namespace inertiad
