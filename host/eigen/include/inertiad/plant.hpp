// SPDX-License-Identifier: Apache-2.0
/// A platform on its cables, moving by its own dynamics, and the controller that drives the winches.
///
///   M [s; alpha] = W f + sag + C - [w x (w x h); w x J w]  M = [m E, -[h]x; [h]x, J]     platform axes, about P
///   a = R s - g z     q' = q (0, w)/2
/// Cable i, length l (cable.h), true tension f, one of
///   rigid     f' = omega_w (f_c - f)                                        the winch makes the tension
///   elastic   l_0 (1 + f/EA) = l + w_p^2 L^3/(24 f^2), + (EA/l_0) T (l' - l_0')        T: damping time
///             l_0' = l_d' + (f - f_c) omega_w l_0/EA   the winch reels to make the tension, or l_0' = l_0d'
/// with w_p the weight per length across the line: the parabola that a taut cable hangs in is longer than its chord.
/// Swing: the first mode of each cable as a taut string, in two directions e across it, tilts its end by beta:
///   beta'' + 2 zeta omega beta' + omega^2 beta = -2 (a_B + c).e/L        omega = (pi/L) sqrt(f g/w),  u + beta e for u
/// driven by its end B, a_B with the Coriolis acceleration c of cable that is paid out. C: the mass of the cables without
/// that mode, cable_mass.hpp. The drives go from one command to the next in a line over a period of control: a reel that
/// jumped would jerk the damped cable at the very instants of sampling. Runge-Kutta of fourth order.
#pragma once

#include "body.hpp"
#include "cable.hpp"
#include "cable_mass.hpp"
#include "distribution.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <array>
#include <cmath>
#include <vector>

namespace inertiad {

/// Every time constant and stiffness of cables, winches and controller.
struct PlantSettings {
    double step = 1e-3;          ///< s of integration
    int steps_per_control = 1;   ///< steps between commands
    double EA = 0.0;             ///< N, stiffness of a cable of 1 m times 1 m; 0: rigid
    double damping_time = 0.0;   ///< s, T
    double winch_rate = 0.0;     ///< rad/s, omega_w
    double control_rate = 0.0;   ///< rad/s, double pole of the pose error; the integral's is ten times slower
    double swing_damping = 0.0;  ///< zeta
    bool swings = true;          ///< cables with weight do
    bool holds_length = false;   ///< winches follow lengths, not tensions
};

/// theta moves by `change` in a ramp of `ramp` s from `t` s on.
struct PayloadChange {
    double t, ramp;
    Theta change;
};

/// What the platform should do at an instant.
struct Reference {
    Vector3 p, v, a;   ///< of P, W
    Matrix3 R;         ///< P to W
    Vector3 w, alpha;  ///< P axes
};

/// Commands to the winches: tensions [m], and l_d' or l_0d' [m], m/s.
struct Command {
    Tensions f, reel;
};

/// The drives' way from one command to the next over a period of control.
struct Ramp {
    Command from, to;
    double begin, period;  ///< s

    Command at(double t) const
    {
        const double share = std::clamp((t - begin) / period, 0.0, 1.0);
        return {from.f + share * (to.f - from.f), from.reel + share * (to.reel - from.reel)};
    }
};

using Tilt = Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, IPE_CABLES_MAX>;

/// Everything that changes: pose, rates, per cable a tension (rigid) or an unstrained length, and two tilts.
struct PlantState {
    static constexpr Eigen::Index BODY = 13, PER_CABLE = 5;
    using Flat = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, BODY + PER_CABLE * IPE_CABLES_MAX, 1>;

    explicit PlantState(Eigen::Index m) : n_cables(m), x(Flat::Zero(BODY + PER_CABLE * m)) {}
    auto p() { return x.segment<3>(0); }
    auto v() { return x.segment<3>(3); }
    auto q() { return x.segment<4>(6); }                ///< unit quaternion w x y z, P to W
    auto w() { return x.segment<3>(10); }
    auto cable() { return x.segment(BODY, n_cables); }  ///< N or m
    auto tilt()
    {
        return Eigen::Map<Eigen::Matrix<double, 2, Eigen::Dynamic>>(x.data() + BODY + n_cables, 2, n_cables);
    }
    auto tilt_rate()
    {
        return Eigen::Map<Eigen::Matrix<double, 2, Eigen::Dynamic>>(x.data() + BODY + 3 * n_cables, 2, n_cables);
    }
    Matrix3 R() { return Eigen::Quaterniond(x[6], x[7], x[8], x[9]).toRotationMatrix(); }

    Eigen::Index n_cables;
    Flat x;
};

/// What follows from a state: accelerations and tensions.
struct PlantForces {
    Vector3 a, alpha;  ///< of P in W; P axes
    Tensions f;
};

namespace detail {

inline Matrix3 cross_matrix(const Vector3& v)
{
    Matrix3 m;
    m << 0.0, -v[2], v[1], v[2], 0.0, -v[0], -v[1], v[0], 0.0;
    return m;
}

inline Matrix3 inertia_of(const Theta& theta)
{
    Matrix3 J;
    J << theta[4], theta[9], theta[8], theta[9], theta[5], theta[7], theta[8], theta[7], theta[6];
    return J;
}

inline Matrix6 mass_matrix(const Theta& theta)
{
    Matrix6 M;
    const Matrix3 h = cross_matrix(theta.segment<3>(1));
    M << theta[0] * Matrix3::Identity(), -h, h, inertia_of(theta);
    return M;
}

/// w_p^2 L^3/24 of a line: what the parabola adds to its length, times f^2.
inline double parabola(const ipe_cable_t& cable, const ipe_cable_line_t& line)
{
    const double across = cable.weight_per_length * std::hypot(line.u[0], line.u[1]);
    return across * across * line.free * line.free * line.free / 24.0;
}

/// Unstrained length of a cable that carries f > 0.
inline double unstrained(double length, double sag, double f, double EA)
{
    return (length + sag / (f * f)) / (1.0 + f / EA);
}

/// Tension of a cable of unstrained length l_0 on a line of this length; 0 where it is slack and weighs nothing.
/// Newton from the left of a convex falling function: every step stays on that side.
inline double stretched(double length, double sag, double l_0, double EA)
{
    const double straight = EA * (length / l_0 - 1.0);
    if (!(sag > 0.0)) { return std::max(straight, 0.0); }
    double f = straight;
    if (!(straight > 0.0)) {
        const double slack = l_0 - length, balance = std::cbrt(0.5 * sag * EA / l_0);
        f = slack > 0.0 ? std::min(balance, 0.7 * std::sqrt(sag / slack)) : balance;
    }
    for (int i = 0; i < 30; ++i) {
        const double g = length + sag / (f * f) - l_0 * (1.0 + f / EA);
        const double step = g / (2.0 * sag / (f * f * f) + l_0 / EA);
        f += step;
        if (std::abs(step) < 1e-12 * f) { break; }
    }
    return f;
}

}  // namespace detail

/// The true robot. Keeps the configuration by reference.
class Plant {
public:
    Plant(const Config& config, const PlantSettings& settings, const Theta& theta, std::vector<PayloadChange> changes)
        : config_(config), settings_(settings), theta_(theta), changes_(std::move(changes))
    {
        set_body(theta);
    }

    /// theta about P at time t [s].
    Theta theta(double t) const
    {
        Theta sum = theta_;
        for (const PayloadChange& c : changes_) {
            sum += (c.ramp > 0.0 ? std::clamp((t - c.t) / c.ramp, 0.0, 1.0) : t >= c.t ? 1.0 : 0.0) * c.change;
        }
        return sum;
    }

    /// dx of a state, and the forces behind it. Throws std::domain_error where a cable has no direction.
    PlantForces derivative(double t, PlantState& x, const Ramp& ramp, PlantState& dx)
    {
        const Command command = ramp.at(t);
        const Eigen::Index m = x.n_cables;
        const Matrix3 R = x.R();
        PlantForces out;
        out.f.resize(m);
        Lines lines;
        Vector6 wrench = Vector6::Zero();
        for (Eigen::Index i = 0; i < m; ++i) {
            const Line& line = lines[static_cast<std::size_t>(i)] = line_of(i, x, R);
            out.f[i] = pull(i, line, x, command, dx);
            Vector3 weight;
            ipe_cable_sag(&cable(i), &line.line, weight.data());
            const Vector3 F = out.f[i] * (line.u + line.across * x.tilt().col(i)) + weight;
            wrench.head<3>() += F;
            wrench.tail<3>() += line.arm.cross(F);
        }
        accelerate(t, R, lines, wrench, x, out);
        dx.p() = x.v();
        dx.v() = out.a;
        const Eigen::Quaterniond q(x.x[6], x.x[7], x.x[8], x.x[9]);
        const Eigen::Quaterniond dq = q * Eigen::Quaterniond(0.0, 0.5 * x.w()[0], 0.5 * x.w()[1], 0.5 * x.w()[2]);
        dx.q() << dq.w(), dq.x(), dq.y(), dq.z();
        dx.w() = out.alpha;
        for (Eigen::Index i = 0; i < m; ++i) { swing(i, lines[static_cast<std::size_t>(i)], R, x, out, dx); }
        return out;
    }

    /// One step of Runge-Kutta; k1 is the derivative at its beginning.
    void step(double t, const Ramp& ramp, const PlantState& k1, PlantState& x)
    {
        const double h = settings_.step;
        PlantState k2(x.n_cables), k3(x.n_cables), k4(x.n_cables), at(x.n_cables);
        at.x = x.x + 0.5 * h * k1.x;
        derivative(t + 0.5 * h, at, ramp, k2);
        at.x = x.x + 0.5 * h * k2.x;
        derivative(t + 0.5 * h, at, ramp, k3);
        at.x = x.x + h * k3.x;
        derivative(t + h, at, ramp, k4);
        x.x += h / 6.0 * (k1.x + 2.0 * k2.x + 2.0 * k3.x + k4.x);
        x.q().normalize();
    }

    /// Gives the cables of a resting state the tensions f [m] > 0.
    void tension(PlantState& x, const Tensions& f) const
    {
        const Matrix3 R = x.R();
        for (Eigen::Index i = 0; i < x.n_cables; ++i) {
            const Line line = line_of(i, x, R);
            const double sag = detail::parabola(cable(i), line.line);
            x.cable()[i] = is_elastic() ? detail::unstrained(line.line.length, sag, f[i], settings_.EA) : f[i];
        }
    }

private:
    struct Line {
        ipe_cable_line_t line;
        Vector3 u, arm, velocity;            ///< velocity: of the attachment; W
        Eigen::Matrix<double, 3, 2> across;  ///< two unit vectors across u, the first level
        double speed;                        ///< l'
    };
    using Lines = std::array<Line, IPE_CABLES_MAX>;

    bool is_elastic() const { return settings_.EA > 0.0; }
    const ipe_cable_t& cable(Eigen::Index i) const { return config_.c().cable[i]; }

    Line line_of(Eigen::Index i, PlantState& x, const Matrix3& R) const
    {
        Line out;
        const Eigen::Map<const Vector3> b(cable(i).attachment);
        out.arm = R * b;
        out.line = cable_line(cable(i), x.p() + out.arm);
        out.u = Eigen::Map<const Vector3>(out.line.u);
        out.velocity = x.v() + R * x.w().cross(b);
        out.speed = -out.u.dot(out.velocity);
        const Vector3 level = out.u.cross(Vector3::UnitZ());
        out.across.col(0) = level.norm() > 1e-9 ? Vector3(level.normalized()) : Vector3::UnitX();
        out.across.col(1) = out.u.cross(out.across.col(0));
        return out;
    }

    /// Tension of cable i, and the derivative of what its winch does.
    double pull(Eigen::Index i, const Line& line, PlantState& x, const Command& command, PlantState& dx) const
    {
        const double own = x.cable()[i], rate = settings_.winch_rate;
        if (!is_elastic()) {
            dx.cable()[i] = rate * (command.f[i] - own);
            return own;
        }
        const double sag = detail::parabola(cable(i), line.line);
        const double f = detail::stretched(line.line.length, sag, own, settings_.EA);
        const double reel = command.reel[i];
        dx.cable()[i] = settings_.holds_length ? reel : reel + (f - command.f[i]) * rate * own / settings_.EA;
        const double damping = settings_.EA / own * settings_.damping_time * (line.speed - dx.cable()[i]);
        return std::max(f + (f > 0.0 ? damping : 0.0), 0.0);
    }

    void set_body(const Theta& theta)
    {
        body_ = theta;
        mass_ = detail::mass_matrix(theta);
    }

    bool swings(Eigen::Index i) const { return settings_.swings && cable(i).weight_per_length > 0.0; }

    /// Cable i's mass, to that of the body and to the forces that do not follow from accelerations.
    void add_cable(Eigen::Index i, const Line& line, const Matrix3& R, const Vector3& w, Matrix6& mass,
                   Vector6& rest) const
    {
        const CableMass moved = cable_mass(cable(i), line.line, config_.c().gravity, line.velocity, swings(i));
        const Eigen::Map<const Vector3> b(cable(i).attachment);
        const Matrix3 m = R.transpose() * moved.mass * R, arm = detail::cross_matrix(b);
        const Vector3 falling =
            config_.c().gravity * R.row(2).transpose();  // s is relative to it, the cable's mass is not
        const Vector3 force = m * (w.cross(w.cross(b)) - falling) + R.transpose() * moved.rest;
        mass.topLeftCorner<3, 3>() += m;
        mass.topRightCorner<3, 3>() -= m * arm;
        mass.bottomLeftCorner<3, 3>() += arm * m;
        mass.bottomRightCorner<3, 3>() -= arm * m * arm;
        rest.head<3>() -= force;
        rest.tail<3>() -= b.cross(force);
    }

    void accelerate(double t, const Matrix3& R, const Lines& lines, const Vector6& wrench, PlantState& x,
                    PlantForces& out)
    {
        if (!changes_.empty()) {
            const Theta now = theta(t);
            if (now != body_) { set_body(now); }
        }
        const Vector3 w = x.w(), h = body_.segment<3>(1);
        Vector6 rest;
        rest << R.transpose() * wrench.head<3>() - w.cross(w.cross(h)),
            R.transpose() * wrench.tail<3>() - w.cross(detail::inertia_of(body_) * w);
        Matrix6 mass = mass_;
        for (Eigen::Index i = 0; i < x.n_cables; ++i) {
            if (cable(i).weight_per_length > 0.0) {
                add_cable(i, lines[static_cast<std::size_t>(i)], R, w, mass, rest);
            }
        }
        const Vector6 solved = mass.llt().solve(rest);
        out.a = R * solved.head<3>() - config_.c().gravity * Vector3::UnitZ();
        out.alpha = solved.tail<3>();
    }

    /// Second derivative of cable i's tilts.
    void swing(Eigen::Index i, const Line& line, const Matrix3& R, PlantState& x, const PlantForces& forces,
               PlantState& dx) const
    {
        dx.tilt().col(i) = x.tilt_rate().col(i);
        if (!swings(i)) { return; }
        const Eigen::Map<const Vector3> b(cable(i).attachment);
        const Vector3 w = x.w(), a_B = forces.a + R * (forces.alpha.cross(b) + w.cross(w.cross(b)));
        const Vector3 end = a_B + 2.0 * line.speed / line.line.free * line.velocity;  // c, along the line as well
        const double per_mass = config_.c().gravity / cable(i).weight_per_length;
        const double omega = static_cast<double>(EIGEN_PI) / line.line.free * std::sqrt(forces.f[i] * per_mass);
        dx.tilt_rate().col(i) = -2.0 * settings_.swing_damping * omega * x.tilt_rate().col(i) -
                                omega * omega * x.tilt().col(i) - 2.0 / line.line.free * line.across.transpose() * end;
    }

    const Config& config_;
    PlantSettings settings_;
    Theta theta_;
    std::vector<PayloadChange> changes_;
    Theta body_;
    Matrix6 mass_;
};

/// Computed torque with an integral, tensions distributed within their limits. Knows a body and a geometry, which may not
/// be the true ones. Keeps the configuration by reference.
class Controller {
public:
    Controller(const Config& config, const PlantSettings& settings, const Theta& theta)
        : config_(config), settings_(settings), theta_(theta), mass_(detail::mass_matrix(theta)),
          band_(config, theta[0])
    {
    }

    /// Use another body from now on, the platform in attitude R. The integral gives up what the new parameters explain of
    /// it at rest: it has learnt it already, and would have to unlearn it as slowly.
    ///
    ///   E = Y(R^T g z, 0, 0) (theta - theta_before)     I -= x E,   x = (I . E)/(E . E) within 0 .. 1, . by M^-1
    void hand_over(const Theta& theta, const Matrix3& R)
    {
        if (theta == theta_) { return; }
        const Vector3 s = config_.c().gravity * R.row(2).transpose();
        const Vector6 explained = regressor(s, Vector3::Zero(), Vector3::Zero()) * (theta - theta_);
        set_body(theta);
        const Vector6 weighted = mass_.llt().solve(explained);
        const double size = explained.dot(weighted);
        if (size > 0.0) { integral -= std::clamp(integral.dot(weighted) / size, 0.0, 1.0) * explained; }
    }

    const Theta& body() const { return theta_; }

    /// The integral part: what the body weighs beyond what the controller knows, P axes, N and N m.
    Vector6 integral = Vector6::Zero();
    long n_infeasible = 0;  ///< commands cut off at the limits

    /// Tensions and reference reel speeds for a state that should be as the reference. Every `period` s.
    Command command(PlantState& x, const Reference& wanted, double period)
    {
        return give(x, wanted, wrench(x, wanted, period));
    }

    /// The wrench about P, P axes, for the same, and the integral after another period [s].
    Vector6 wrench(PlantState& x, const Reference& wanted, double period)
    {
        const double k = settings_.control_rate;
        const Matrix3 R = x.R(), away = R.transpose() * wanted.R;
        const Eigen::AngleAxisd turn{Eigen::Matrix3d(away)};
        const Vector3 e_p = wanted.p - x.p(), e_R = turn.angle() * turn.axis();
        const Vector3 a = wanted.a + 2.0 * k * (wanted.v - x.v()) + k * k * e_p;
        const Vector3 alpha = away * wanted.alpha + 2.0 * k * (away * wanted.w - x.w()) + k * k * e_R;
        Vector6 error;
        error << R.transpose() * e_p, e_R;
        integral += period * 0.1 * k * k * k * (mass_ * error);
        const Vector3 s = R.transpose() * (a + config_.c().gravity * Vector3::UnitZ());
        return regressor(s, x.w(), alpha) * theta_ + integral;
    }

    /// Tensions for a wrench at the state's pose, and reel speeds.
    Command give(PlantState& x, const Reference& wanted, const Vector6& wrench)
    {
        Command out{Tensions(x.n_cables), reel(wanted)};
        if (!hold(x, wrench, out.f)) { ++n_infeasible; }
        return out;
    }

    /// Tensions for a wrench at the state's pose; false: cut off at the limits.
    bool hold(PlantState& x, const Vector6& wrench, Tensions& f) const
    {
        return distribute(config_, band_, wrench, x.p(), x.R(), f);
    }

private:
    void set_body(const Theta& theta)
    {
        theta_ = theta;
        mass_ = detail::mass_matrix(theta);
        band_ = TensionBand(config_, theta[0]);
    }

    /// l_d' [m] of the reference.
    Tensions reel(const Reference& wanted) const
    {
        Tensions out(config_.n_cables());
        for (int i = 0; i < config_.n_cables(); ++i) {
            const Eigen::Map<const Vector3> b(config_.c().cable[i].attachment);
            const ipe_cable_line_t line = cable_line(config_.c().cable[i], wanted.p + wanted.R * b);
            out[i] = -Eigen::Map<const Vector3>(line.u).dot(wanted.v + wanted.R * wanted.w.cross(b));
        }
        return out;
    }

    const Config& config_;
    PlantSettings settings_;
    Theta theta_;
    Matrix6 mass_;
    TensionBand band_;
};

}  // namespace inertiad
