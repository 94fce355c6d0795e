// SPDX-License-Identifier: Apache-2.0
/// Part of inertiad_core: the parameter gate, and a platform under a controller that takes its parameters through it.
#include "motion.hpp"

#include <inertiad/control_loop.hpp>
#include <inertiad/feed_forward.hpp>

#include <nanobind/stl/optional.h>

#include <algorithm>

using namespace binding;

namespace {

/// An ESTIMATE as a gate takes it.
ipe_gate_estimate_t estimate_of(int64_t sequence, int64_t t_ns, int64_t n_changes, const inertiad::Theta& theta,
                                const inertiad::Covariance& covariance, const std::vector<bool>& observable,
                                int verdict, bool provisional)
{
    require(observable.size() == IPE_NP, "observable: needs 10 entries");
    ipe_gate_estimate_t e{};
    e.sequence = sequence, e.t_ns = t_ns, e.n_changes = n_changes, e.verdict = verdict;
    e.is_provisional = provisional;
    std::copy_n(theta.data(), IPE_NP, e.theta);
    std::copy_n(covariance.data(), IPE_NP * IPE_NP, &e.covariance[0][0]);
    std::copy(observable.begin(), observable.end(), e.observable);
    return e;
}

std::vector<inertiad::Vector3> vectors(const InN3& x)
{
    std::vector<inertiad::Vector3> out(x.shape(0));
    for (std::size_t k = 0; k < out.size(); ++k) { out[k] = Eigen::Map<const inertiad::Vector3>(x.data() + 3 * k); }
    return out;
}

inertiad::PoseSensors sensors_of(const std::vector<double>& imu_t, const std::vector<double>& imu_arrival,
                                 const InN3& attitude_error, const InN3& gyro_error, const InN3& acc_error,
                                 const inertiad::Matrix3& alignment, double yaw, const std::vector<double>& tracker_t,
                                 const InN3& tracker_error, double tracker_delay, const inertiad::Vector3& target,
                                 double observer_rate)
{
    inertiad::PoseSensors s;
    s.imu_t = imu_t, s.imu_arrival = imu_arrival, s.tracker_t = tracker_t, s.tracker_arrival = tracker_t;
    s.attitude_error = vectors(attitude_error), s.gyro_error = vectors(gyro_error), s.acc_error = vectors(acc_error);
    s.tracker_error = vectors(tracker_error);
    s.alignment = alignment, s.yaw = yaw, s.tracker_delay = tracker_delay, s.target = target;
    s.observer_rate = observer_rate;
    for (const auto* other : {&s.attitude_error, &s.gyro_error, &s.acc_error}) {
        require_rows(s.imu_t.size(), other->size(), "imu");
    }
    require_rows(s.imu_t.size(), s.imu_arrival.size(), "imu_arrival");
    require_rows(s.tracker_t.size(), s.tracker_error.size(), "tracker_error");
    return s;
}

std::vector<inertiad::Reference> list_of(const References& wanted)
{
    wanted.check();
    std::vector<inertiad::Reference> out;
    for (std::size_t k = 0; k < wanted.size(); ++k) { out.push_back(wanted.at(k)); }
    return out;
}

/// inertiad::ControlLoop with everything that happened.
class Loop {
public:
    Loop(const inertiad::Config& truth, const inertiad::Config& believed, const inertiad::PlantSettings& settings,
         const inertiad::Theta& theta, const inertiad::Theta& nominal, const Table& payload, const References& wanted,
         int arm, const ipe_gate_limits_t& limits, int64_t start_ns, std::optional<inertiad::PoseSensors> sensors,
         const inertiad::Tilt& tilt)
        : m_(static_cast<std::size_t>(truth.n_cables())),
          loop_(truth, believed, settings, theta, nominal, changes_of(payload), list_of(wanted),
                static_cast<inertiad::Arm>(arm), limits, start_ns, std::move(sensors), tilt)
    {
    }

    bool advance(std::size_t n)
    {
        const nb::gil_scoped_release without;
        loop_.advance(n, rows_, [this](std::size_t, inertiad::PlantState& x, const inertiad::PlantForces& forces) {
            state_.insert(state_.end(), x.x.data(), x.x.data() + 13);
            for (const auto* v : {&forces.a, &forces.alpha}) { state_.insert(state_.end(), v->data(), v->data() + 3); }
            state_.insert(state_.end(), forces.f.data(), forces.f.data() + forces.f.size());
        });
        return loop_.done() < loop_.size();
    }

    int offer(const ipe_gate_estimate_t& estimate, int64_t now_ns) { return loop_.gate().offer(estimate, now_ns); }

    /// Rows [first, last) of the integration: p, v, q, omega, a, alpha, f.
    nb::ndarray<nb::numpy, double> states(std::size_t first, std::size_t last) const
    {
        const std::size_t width = 19 + m_, n = state_.size() / width;
        last = std::min(last, n), first = std::min(first, last);
        Out<2> out({last - first, width});
        std::copy(state_.begin() + static_cast<std::ptrdiff_t>(first * width),
                  state_.begin() + static_cast<std::ptrdiff_t>(last * width), out.data);
        return out.release();
    }

    nb::dict trace() const
    {
        const std::size_t n = rows_.size();
        Out<2> e_p({n, 3}), theta({n, 10});
        Out<1> e_R({n}), norm({n}), step({n}), beyond({n}), cut({n}), source({n}), sequence({n});
        for (std::size_t k = 0; k < n; ++k) {
            const inertiad::ControlRow& row = rows_[k];
            std::copy_n(row.e_p.data(), 3, e_p.data + 3 * k);
            std::copy_n(row.theta.data(), 10, theta.data + 10 * k);
            e_R.data[k] = row.e_R, norm.data[k] = row.tension_norm, step.data[k] = row.tension_step;
            beyond.data[k] = row.beyond, cut.data[k] = row.is_cut ? 1.0 : 0.0, source.data[k] = row.source;
            sequence.data[k] = static_cast<double>(row.sequence);
        }
        nb::dict d;
        d["e_p"] = e_p.release(), d["e_R"] = e_R.release(), d["tension_norm"] = norm.release();
        d["tension_step"] = step.release(), d["beyond"] = beyond.release(), d["theta"] = theta.release();
        d["source"] = source.release(), d["sequence"] = sequence.release();
        d["is_cut"] = cut.release();
        return d;
    }

private:
    std::size_t m_;
    inertiad::ControlLoop loop_;
    std::vector<inertiad::ControlRow> rows_;
    std::vector<double> state_;
};

void bind_gate(nb::module_& m)
{
    nb::class_<ipe_gate_limits_t>(m, "GateLimits", "What a gate demands of an estimate. parameter_gate.h")
        .def("__init__", [](ipe_gate_limits_t* l) { new (l) ipe_gate_limits_t(ipe_parameter_gate_default()); })
        .def_rw("mass_std", &ipe_gate_limits_t::mass_std)
        .def_rw("cog_std", &ipe_gate_limits_t::cog_std)
        .def_rw("inertia_std", &ipe_gate_limits_t::inertia_std)
        .def_rw("verdict_max", &ipe_gate_limits_t::verdict_max)
        .def_rw("age_max", &ipe_gate_limits_t::age_max)
        .def_rw("transition_time", &ipe_gate_limits_t::transition_time)
        .def_rw("change_time", &ipe_gate_limits_t::change_time)
        .def_rw("step_sigmas", &ipe_gate_limits_t::step_sigmas)
        .def_rw("n_return", &ipe_gate_limits_t::n_return)
        .def_rw("keep_last_good", &ipe_gate_limits_t::keep_last_good);
    m.def(
        "gate_reason",
        [](int reason) { return std::string(ipe_parameter_gate_text(static_cast<ipe_gate_reason_t>(reason))); },
        "reason"_a, "What an offer's outcome means, in words; 0: taken. parameter_gate.h");
    nb::class_<inertiad::ParameterGate>(m, "ParameterGate",
                                        "The parameters that a control loop may use. parameter_gate.h")
        .def(nb::init<const inertiad::Theta&, const ipe_gate_limits_t&>(), "nominal"_a,
             "limits"_a = ipe_parameter_gate_default())
        .def(
            "offer",
            [](inertiad::ParameterGate& gate, int64_t sequence, int64_t t_ns, int64_t n_changes,
               const inertiad::Theta& theta, const inertiad::Covariance& covariance,
               const std::vector<bool>& observable, int verdict, bool provisional, int64_t now_ns) {
                return static_cast<int>(gate.offer(
                    estimate_of(sequence, t_ns, n_changes, theta, covariance, observable, verdict, provisional),
                    now_ns));
            },
            "sequence"_a, "t_ns"_a, "n_changes"_a, "theta"_a, "covariance"_a, "observable"_a, "verdict"_a,
            "provisional"_a, "now_ns"_a,
            "Offer an estimate, the fields of ESTIMATE, at host time now_ns; what became of it: gate_reason()")
        .def(
            "read",
            [](inertiad::ParameterGate& gate, int64_t now_ns) {
                const auto p = gate.read(now_ns);
                static const char* const SOURCE[] = {"nominal", "live", "last good", "falling back"};
                nb::dict d;
                d["theta"] = p.theta, d["source"] = SOURCE[p.source], d["sequence"] = p.sequence;
                d["age"] = p.age, d["is_moving"] = p.is_moving;
                return d;
            },
            "now_ns"_a, "dict of theta [10], source, sequence, age [s], is_moving at host time now_ns");
}

}  // namespace

void bind_control(nb::module_& m)
{
    bind_gate(m);
    m.def(
        "feed_forward",
        [](const inertiad::Theta& theta, const inertiad::Matrix3& R, const inertiad::Vector3& a,
           const inertiad::Vector3& w, const inertiad::Vector3& alpha,
           double gravity) { return inertiad::feed_forward(theta, R, a, w, alpha, gravity); },
        "theta"_a, "R"_a, "a"_a, "omega"_a, "alpha"_a, "gravity"_a,
        "Wrench [6] about P, P axes, N and N m, that gives a body theta [10] the acceleration a (W, m/s2) at rate omega "
        "and angular acceleration alpha (P axes), in attitude R [3,3] (P to W). feed_forward.hpp");
    nb::class_<inertiad::PoseSensors>(m, "PoseSensors",
                                      "The pose that a controller gets from sensors. pose_observer.hpp")
        .def(
            "__init__",
            [](inertiad::PoseSensors* self, const std::vector<double>& imu_t, const std::vector<double>& imu_arrival,
               const InN3& attitude_error, const InN3& gyro_error, const InN3& acc_error,
               const inertiad::Matrix3& alignment, double yaw, const std::vector<double>& tracker_t,
               const InN3& tracker_error, double tracker_delay, const inertiad::Vector3& target, double observer_rate) {
                new (self) inertiad::PoseSensors(sensors_of(imu_t, imu_arrival, attitude_error, gyro_error, acc_error,
                                                            alignment, yaw, tracker_t, tracker_error, tracker_delay,
                                                            target, observer_rate));
            },
            "imu_t"_a, "imu_arrival"_a, "attitude_error"_a, "gyro_error"_a, "acc_error"_a, "alignment"_a, "yaw"_a,
            "tracker_t"_a, "tracker_error"_a, "tracker_delay"_a, "target"_a, "observer_rate"_a);
    nb::class_<Loop>(
        m, "ControlLoop",
        "A platform under a controller with parameters of a source: arm 0 nominal, 1 live through the gate, "
        "2 exact, 3 adaptive. control_loop.hpp")
        .def(
            "__init__",
            [](Loop* self, const inertiad::Config& truth, const inertiad::Config& believed,
               const inertiad::Theta& theta, const inertiad::Theta& nominal, const Table& payload, const InN3& p,
               const InN3& v, const InN3& a, const InN33& R, const InN3& w, const InN3& alpha, const Table& tilt,
               int arm, const ipe_gate_limits_t& limits, int64_t start_ns, const inertiad::PoseSensors* sensors,
               double step, int steps_per_control, double EA, double damping_time, double winch_rate,
               double control_rate, double swing_damping, bool swings) {
                require(truth.n_cables() >= 6 && believed.n_cables() == truth.n_cables(),
                        "control needs 6 cables or more, the same in both configurations");
                require(arm >= 0 && arm <= 3, "arm: allowed: 0 to 3");
                require(steps_per_control >= 1 && step > 0.0, "step, steps_per_control: must be positive");
                const inertiad::PlantSettings settings{
                    step, steps_per_control, EA, damping_time, winch_rate, control_rate, swing_damping, swings, false};
                std::optional<inertiad::PoseSensors> pose;
                if (sensors != nullptr) { pose = *sensors; }
                require(tilt.shape(0) == 2 && tilt.shape(1) == static_cast<std::size_t>(truth.n_cables()),
                        "tilt: needs 2 rows, a column per cable");
                inertiad::Tilt start(2, truth.n_cables());
                for (Eigen::Index i = 0; i < start.cols(); ++i) { start.col(i) << tilt(0, i), tilt(1, i); }
                new (self) Loop(truth, believed, settings, theta, nominal, payload, References{p, v, a, R, w, alpha},
                                arm, limits, start_ns, std::move(pose), start);
            },
            "truth"_a, "believed"_a, "theta"_a, "nominal"_a, "payload"_a, "p"_a, "v"_a, "a"_a, "R"_a, "omega"_a,
            "alpha"_a, "tilt"_a, "arm"_a, "limits"_a, "start_ns"_a, "sensors"_a.none(), "step"_a, "steps_per_control"_a,
            "EA"_a, "damping_time"_a, "winch_rate"_a, "control_rate"_a, "swing_damping"_a, "swings"_a,
            nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>())
        .def("advance", &Loop::advance, "n"_a, "Go on by n periods of control; False: the motion is over")
        .def(
            "offer",
            [](Loop& loop, int64_t sequence, int64_t t_ns, int64_t n_changes, const inertiad::Theta& theta,
               const inertiad::Covariance& covariance, const std::vector<bool>& observable, int verdict,
               bool provisional, int64_t now_ns) {
                return loop.offer(
                    estimate_of(sequence, t_ns, n_changes, theta, covariance, observable, verdict, provisional),
                    now_ns);
            },
            "sequence"_a, "t_ns"_a, "n_changes"_a, "theta"_a, "covariance"_a, "observable"_a, "verdict"_a,
            "provisional"_a, "now_ns"_a, "As ParameterGate.offer()")
        .def("states", &Loop::states, "first"_a, "last"_a,
             "Rows [N, 19 + m] of the integration: p, v, q (w x y z), omega, a, alpha, f")
        .def(
            "trace", &Loop::trace,
            "dict of a row per control instant: e_p [K,3] m, e_R rad, tension_norm, tension_step and beyond N, theta [K,10], "
            "source, sequence, is_cut (1: the command is cut off at the limits). control_loop.hpp");
}
