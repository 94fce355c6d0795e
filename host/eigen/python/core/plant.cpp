// SPDX-License-Identifier: Apache-2.0
/// Part of inertiad_core: forward dynamics under a controller, the cables' mass, tension distribution, bus arbitration.
#include "motion.hpp"

#include <inertiad/arbitration.hpp>
#include <inertiad/plant.hpp>

#include <algorithm>

using namespace binding;

namespace {

using inertiad::PlantState;

/// Growing arrays of what happened, one row per integration step.
struct Log {
    Log(std::size_t n, std::size_t m)
        : p({n, 3}), v({n, 3}), a({n, 3}), R({n, 3, 3}), w({n, 3}), alpha({n, 3}), f({n, m})
    {
    }

    void put(std::size_t k, PlantState& x, const inertiad::PlantForces& forces) const
    {
        const inertiad::Matrix3 turn = x.R();
        Eigen::Map<inertiad::Vector3>(p.data + 3 * k) = x.p();
        Eigen::Map<inertiad::Vector3>(v.data + 3 * k) = x.v();
        Eigen::Map<inertiad::Vector3>(w.data + 3 * k) = x.w();
        std::copy_n(turn.data(), 9, R.data + 9 * k);
        std::copy_n(forces.a.data(), 3, a.data + 3 * k);
        std::copy_n(forces.alpha.data(), 3, alpha.data + 3 * k);
        std::copy_n(forces.f.data(), forces.f.size(), f.data + static_cast<std::size_t>(forces.f.size()) * k);
    }

    Out<2> p, v, a;
    Out<3> R;
    Out<2> w, alpha, f;
};

using inertiad::PlantState;

PlantState start(const inertiad::Reference& wanted, const Table& tilt, Eigen::Index m)
{
    PlantState x(m);
    const Eigen::Quaterniond q{Eigen::Matrix3d(wanted.R)};
    x.p() = wanted.p, x.v() = wanted.v, x.w() = wanted.w;
    x.q() << q.w(), q.x(), q.y(), q.z();
    for (Eigen::Index i = 0; i < m; ++i) { x.tilt().col(i) << tilt(0, i), tilt(1, i); }
    return x;
}

/// A platform in free motion or under control; the loop itself.
class Experiment {
public:
    Experiment(const inertiad::Config& truth, const inertiad::Config& believed, const inertiad::PlantSettings& settings,
               const inertiad::Theta& theta, const inertiad::Theta& theta_believed,
               std::vector<inertiad::PayloadChange> changes, const Table& lengths)
        : settings_(settings), plant_(truth, settings, theta, std::move(changes)), holder_(truth, settings, theta),
          controller_(believed, settings, theta_believed), lengths_(lengths)
    {
    }

    /// Rests in the first reference, in balance. False: it cannot.
    bool prepare(PlantState& x, const inertiad::Reference& wanted, double gravity, const inertiad::Theta& theta,
                 const inertiad::Theta& theta_believed, const inertiad::Config& believed)
    {
        if (settings_.holds_length) {
            for (Eigen::Index i = 0; i < x.n_cables; ++i) { x.cable()[i] = lengths_(0, i); }
            return true;
        }
        const inertiad::Vector3 s = wanted.R.transpose() * (wanted.a + gravity * inertiad::Vector3::UnitZ());
        const inertiad::Regressor Y = inertiad::regressor(s, wanted.w, wanted.alpha);
        inertiad::Tensions f;
        const bool is_held = holder_.hold(x, Y * theta, f);
        plant_.tension(x, f);
        const auto matrix = inertiad::wrench_matrix(believed, wanted.p, wanted.R, inertiad::Vector3::Zero());
        controller_.integral = matrix.W * f + matrix.sag - Y * theta_believed;
        return is_held;
    }

    inertiad::Command command(std::size_t k, PlantState& x, const inertiad::Reference& wanted)
    {
        const double period = settings_.steps_per_control * settings_.step;
        if (!settings_.holds_length) { return controller_.command(x, wanted, period); }
        inertiad::Command out{inertiad::Tensions::Zero(x.n_cables), inertiad::Tensions::Zero(x.n_cables)};
        if (k + 1 < lengths_.shape(0)) {
            for (Eigen::Index i = 0; i < x.n_cables; ++i) {
                out.reel[i] = (lengths_(k + 1, i) - lengths_(k, i)) / period;
            }
        }
        return out;
    }

    /// First control instant whose command was cut off at the limits; -1: none.
    long first_infeasible = -1;
    long n_infeasible() const { return controller_.n_infeasible; }

    void run(PlantState& x, const References& wanted, const Log& log)
    {
        const auto per = static_cast<std::size_t>(settings_.steps_per_control);
        const double period = settings_.steps_per_control * settings_.step;
        PlantState dx(x.n_cables);
        inertiad::Command before = command(0, x, wanted.at(0));
        for (std::size_t k = 0; k < wanted.size(); ++k) {
            const inertiad::Command next = k == 0 ? before : command(k, x, wanted.at(k));
            const inertiad::Ramp now{before, next, static_cast<double>(k) * period, period};
            before = next;
            if (first_infeasible < 0 && controller_.n_infeasible > 0) { first_infeasible = static_cast<long>(k); }
            const bool is_last = k + 1 == wanted.size();
            for (std::size_t j = 0; j < (is_last ? 1 : per); ++j) {
                const double t = static_cast<double>(k * per + j) * settings_.step;
                log.put(k * per + j, x, plant_.derivative(t, x, now, dx));
                if (!is_last) { plant_.step(t, now, dx, x); }
            }
            if (!(x.x.allFinite() && x.p().norm() < 1e4)) { throw std::domain_error("the motion is unstable"); }
        }
    }

private:
    inertiad::PlantSettings settings_;
    inertiad::Plant plant_;
    inertiad::Controller holder_, controller_;
    const Table& lengths_;
};

nb::dict forward(const inertiad::Config& truth, const inertiad::Config& believed, const inertiad::Theta& theta,
                 const inertiad::Theta& theta_believed, const Table& payload, const References& wanted,
                 const Table& lengths, const Table& tilt, const inertiad::PlantSettings& settings)
{
    const auto m = static_cast<std::size_t>(truth.n_cables());
    wanted.check();
    if (believed.n_cables() != truth.n_cables()) { throw std::invalid_argument("believed: needs the same cables"); }
    if (tilt.shape(0) != 2 || tilt.shape(1) != m) {
        throw std::invalid_argument("tilt: needs 2 rows, a column per cable");
    }
    if (settings.holds_length && (lengths.shape(0) != wanted.size() || lengths.shape(1) != m)) {
        throw std::invalid_argument("lengths: needs a row per reference, a column per cable");
    }
    if (!settings.holds_length && m < 6) { throw std::invalid_argument("tensions need 6 cables or more"); }
    require(settings.steps_per_control >= 1 && settings.step > 0.0, "step, steps_per_control: must be positive");
    const std::size_t n = (wanted.size() - 1) * static_cast<std::size_t>(settings.steps_per_control) + 1;
    const Log log(n, m);
    PlantState x = start(wanted.at(0), tilt, static_cast<Eigen::Index>(m));
    Experiment experiment(truth, believed, settings, theta, theta_believed, changes_of(payload), lengths);
    const bool is_held = experiment.prepare(x, wanted.at(0), truth.c().gravity, theta, theta_believed, believed);
    std::string stopped;
    if (is_held) {
        const nb::gil_scoped_release without;
        try {
            experiment.run(x, wanted, log);
        } catch (const std::domain_error& e) {
            stopped = e.what();
        }
    } else {
        stopped = "no tensions within the limits hold the platform at the start";
    }
    nb::dict d;
    d["p"] = log.p.release(), d["v"] = log.v.release(), d["a"] = log.a.release(), d["R"] = log.R.release();
    d["omega"] = log.w.release(), d["alpha"] = log.alpha.release(), d["f"] = log.f.release();
    d["n_infeasible"] = experiment.n_infeasible(), d["first_infeasible"] = experiment.first_infeasible;
    d["stopped"] = stopped;
    return d;
}

nb::ndarray<nb::numpy, double> cable_mass_wrench(const inertiad::Config& config, const References& motion)
{
    motion.check();
    Out<2> wrench({motion.size(), 6});
    for (std::size_t k = 0; k < motion.size(); ++k) {
        const inertiad::Reference at = motion.at(k);
        Eigen::Map<inertiad::Vector6>(wrench.data + 6 * k) =
            inertiad::cable_mass_wrench(config, at.p, at.v, at.a, at.R, at.w, at.alpha);
    }
    return wrench.release();
}

nb::tuple distribute(const In<Dim<-1>, Dim<6>, Dim<-1>>& W, const In<Dim<-1>, Dim<6>>& wrench,
                     const Eigen::VectorXd& pull, const Eigen::VectorXd& low, const Eigen::VectorXd& high)
{
    const std::size_t n = W.shape(0), m = W.shape(2);
    require_rows(n, wrench.shape(0), "wrench");
    for (const Eigen::VectorXd* v : {&pull, &low, &high}) {
        if (static_cast<std::size_t>(v->size()) != m || m < 6 || m > IPE_CABLES_MAX) {
            throw std::invalid_argument("pull, low, high: need one entry per cable, 6 to 16 cables");
        }
    }
    Out<2> f({n, m});
    nb::list broken;
    for (std::size_t k = 0; k < n; ++k) {
        using RowMajor = Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::RowMajor>;
        const inertiad::WrenchColumns W_k =
            Eigen::Map<const RowMajor>(W.data() + 6 * m * k, 6, static_cast<Eigen::Index>(m));
        inertiad::Tensions f_k;
        const Eigen::Map<const inertiad::Vector6> wrench_k(wrench.data() + 6 * k);
        if (!inertiad::distribute(W_k, wrench_k, pull, low, high, f_k)) { broken.append(k); }
        std::copy_n(f_k.data(), m, f.data + m * k);
    }
    return nb::make_tuple(f.release(), broken);
}

}  // namespace

void bind_plant(nb::module_& m)
{
    m.def(
        "forward",
        [](const inertiad::Config& truth, const inertiad::Config& believed, const inertiad::Theta& theta,
           const inertiad::Theta& theta_believed, const Table& payload, const InN3& p, const InN3& v, const InN3& a,
           const InN33& R, const InN3& w, const InN3& alpha, const Table& lengths, const Table& tilt, double step,
           int steps_per_control, double EA, double damping_time, double winch_rate, double control_rate,
           double swing_damping, bool swings, bool holds_length) {
            const inertiad::PlantSettings settings{step,         steps_per_control, EA,     damping_time, winch_rate,
                                                   control_rate, swing_damping,     swings, holds_length};
            return forward(truth, believed, theta, theta_believed, payload, References{p, v, a, R, w, alpha}, lengths,
                           tilt, settings);
        },
        "truth"_a, "believed"_a, "theta"_a, "theta_believed"_a, "payload"_a, "p"_a, "v"_a, "a"_a, "R"_a, "omega"_a,
        "alpha"_a, "lengths"_a, "tilt"_a, "step"_a, "steps_per_control"_a, "EA"_a, "damping_time"_a, "winch_rate"_a,
        "control_rate"_a, "swing_damping"_a, "swings"_a, "holds_length"_a,
        "dict of p, v, a, R, omega, alpha, f [N,..] at every step, n_infeasible, first_infeasible (control instant) and "
        "stopped (why it ended early, \"\"), of the robot `truth` with theta [10] about P, whose controller believes other "
        "things, along references [K,..] at the instants of control; payload [J,12]: t, ramp, change of theta; lengths "
        "[K,m] unstrained, where held; tilt [2,m] rad, swing at the start. plant.hpp");
    m.def(
        "cable_mass_wrench",
        [](const inertiad::Config& config, const InN3& p, const InN3& v, const InN3& a, const InN33& R, const InN3& w,
           const InN3& alpha) { return cable_mass_wrench(config, References{p, v, a, R, w, alpha}); },
        "config"_a, "p"_a, "v"_a, "a"_a, "R"_a, "omega"_a, "alpha"_a,
        "Wrench [N,6] about P, P axes, of the mass of straight cables on a platform in motion: p, v, a [N,3] in W, R [N,3,3] "
        "P to W, omega, alpha [N,3] in P. ValueError where a cable has no direction. cable_mass.hpp");
    m.def("distribute", &distribute, "W"_a, "wrench"_a, "pull"_a, "low"_a, "high"_a,
          "(f [N,m] closest to pull [m] with W [N,6,m] f = wrench [N,6] and low <= f <= high, list of k where there is "
          "none). distribution.hpp");
    m.def(
        "arbitrate",
        [](const std::vector<double>& release, const std::vector<int64_t>& priority, const std::vector<double>& took) {
            require_rows(release.size(), priority.size(), "priority");
            require_rows(release.size(), took.size(), "took");
            require_finite(release.data(), release.size(), "release");
            require_finite(took.data(), took.size(), "took");
            return inertiad::arbitrate(release, priority, took);
        },
        "release"_a, "priority"_a, "took"_a,
        "Ends [N] s of frames on a bus, from when they wait [N] s, priority [N] (less is first), how long they take [N] "
        "s. arbitration.hpp");
}
