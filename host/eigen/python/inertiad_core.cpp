// SPDX-License-Identifier: Apache-2.0
/// Python module inertiad_core: the C core through its C++ layer. Arrays are numpy float64, C order; N is any number of
/// samples, m the number of cables. Units and frames as in the C headers named at each function.
#include "binding.hpp"

#include <inertiad/body.hpp>
#include <inertiad/calibrated.hpp>
#include <inertiad/cable.hpp>
#include <inertiad/config.hpp>
#include <inertiad/estimate.hpp>
#include <inertiad/pipeline.hpp>
#include <inertiad/rls.hpp>
#include <inertiad/windows.hpp>

#include <algorithm>
#include <functional>
#include <string>
#include <tuple>
#include <vector>

extern "C" {
#include "estimator.h"
#include "window.h"
}

namespace {

using namespace binding;

nb::tuple cable_geometry(const inertiad::Config& config, const InN3& p, const InN33& R)
{
    const std::size_t n = p.shape(0), m = static_cast<std::size_t>(config.n_cables());
    require_rows(n, R.shape(0), "R");
    Out<3> u({n, m, 3});
    Out<2> free({n, m}), length({n, m});
    for (std::size_t k = 0; k < n; ++k) {
        const Eigen::Map<const inertiad::Matrix3> R_k(R.data() + 9 * k);
        const Eigen::Map<const inertiad::Vector3> p_k(p.data() + 3 * k);
        for (std::size_t i = 0; i < m; ++i) {
            const ipe_cable_t& cable = config.c().cable[i];
            const inertiad::Vector3 B = p_k + R_k * Eigen::Map<const inertiad::Vector3>(cable.attachment);
            try {
                const ipe_cable_line_t line = inertiad::cable_line(cable, B);
                std::copy(line.u, line.u + 3, u.data + 3 * (m * k + i));
                free.data[m * k + i] = line.free;
                length.data[m * k + i] = line.length;
            } catch (const std::domain_error& e) {
                throw std::domain_error("cable " + std::to_string(i + 1) + ", sample " + std::to_string(k) + ": " +
                                        e.what());
            }
        }
    }
    return nb::make_tuple(u.release(), free.release(), length.release());
}

nb::tuple wrench_matrix(const inertiad::Config& config, const InN3& p, const InN33& R, const inertiad::Vector3& point)
{
    const std::size_t n = p.shape(0), m = static_cast<std::size_t>(config.n_cables());
    require_rows(n, R.shape(0), "R");
    Out<3> W({n, 6, m});
    Out<2> sag({n, 6});
    for (std::size_t k = 0; k < n; ++k) {
        const Eigen::Map<const inertiad::Matrix3> R_k(R.data() + 9 * k);
        const auto w =
            inertiad::wrench_matrix(config, Eigen::Map<const inertiad::Vector3>(p.data() + 3 * k), R_k, point);
        for (std::size_t j = 0; j < 6; ++j) {
            sag.data[6 * k + j] = w.sag[static_cast<Eigen::Index>(j)];
            for (std::size_t i = 0; i < m; ++i) {
                W.data[(6 * k + j) * m + i] = w.W(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(i));
            }
        }
    }
    return nb::make_tuple(W.release(), sag.release());
}

/// What the cables' inertia adds to the wrench of windows that saw nothing but one instant each.
nb::ndarray<nb::numpy, double> cable_inertia(const inertiad::Config& config, const InN3& s, const InN3& w,
                                             const InN3& alpha, const InN3& p, const InN33& R)
{
    const std::size_t n = s.shape(0);
    require_rows(n, w.shape(0), "w");
    require_rows(n, alpha.shape(0), "alpha");
    require_rows(n, p.shape(0), "p");
    require_rows(n, R.shape(0), "R");
    Out<2> wrench({n, 6});
    for (std::size_t k = 0; k < n; ++k) {
        ipe_average_t average{};
        std::copy_n(s.data() + 3 * k, 3, average.s);
        std::copy_n(alpha.data() + 3 * k, 3, average.alpha);
        std::copy_n(p.data() + 3 * k, 3, average.p);
        std::copy_n(R.data() + 9 * k, 9, &average.R[0][0]);
        ipe_rate_products(w.data() + 3 * k, average.ww);
        if (ipe_cable_inertia_add(&config.c(), &average) != IPE_OK) {
            throw std::domain_error("a cable has no direction in sample " + std::to_string(k));
        }
        std::copy_n(average.cable_inertia, 6, wrench.data + 6 * k);
    }
    return wrench.release();
}

nb::ndarray<nb::numpy, double> regressor(const InN3& s, const InN3& w, const InN3& alpha)
{
    const std::size_t n = s.shape(0);
    require_rows(n, w.shape(0), "w");
    require_rows(n, alpha.shape(0), "alpha");
    Out<3> Y({n, 6, 10});
    for (std::size_t k = 0; k < n; ++k) {
        const auto at = [k](const InN3& v) { return Eigen::Map<const inertiad::Vector3>(v.data() + 3 * k); };
        Eigen::Map<inertiad::Regressor>(Y.data + 60 * k) = inertiad::regressor(at(s), at(w), at(alpha));
    }
    return Y.release();
}

/// The weak equations of a run's rows.
struct Windows {
    Windows(const inertiad::Config& config_, const OwnedPipeline& run) : Windows(config_, run.rows) {}
    Windows(const inertiad::Config& config_, const Rows& run) : Windows(inertiad::usable(config_, run.derived), run.row)
    {
    }
    Windows(const inertiad::Config& config_, const std::vector<ipe_row_t>& rows)
        : config(config_), window(inertiad::windows_of(config_, rows))
    {
    }

    nb::ndarray<nb::numpy, double> t() const
    {
        Out<1> out({window.size()});
        for (std::size_t k = 0; k < window.size(); ++k) {
            out.data[k] = 1e-9 * static_cast<double>(window[k].t_ns - window[0].t_ns);
        }
        return out.release();
    }

    nb::ndarray<nb::numpy, double> Y() const
    {
        Out<3> out({window.size(), 6, 10});
        for (std::size_t k = 0; k < window.size(); ++k) {
            Eigen::Map<inertiad::Regressor>(out.data + 60 * k) = inertiad::regressor(window[k]);
        }
        return out.release();
    }

    nb::ndarray<nb::numpy, double> y() const
    {
        Out<2> out({window.size(), 6});
        for (std::size_t k = 0; k < window.size(); ++k) { std::copy_n(window[k].y, 6, out.data + 6 * k); }
        return out.release();
    }

    nb::ndarray<nb::numpy, double> R() const
    {
        Out<3> out({window.size(), 3, 3});
        for (std::size_t k = 0; k < window.size(); ++k) { std::copy_n(&window[k].R[0][0], 9, out.data + 9 * k); }
        return out.release();
    }

    nb::ndarray<nb::numpy, bool> has_failed() const { return failed_sensors(window, config.n_cables()); }

    nb::ndarray<nb::numpy, double> X(const inertiad::Theta& theta) const
    {
        const auto n_xi = static_cast<std::size_t>(ipe_systematic_count(config.n_cables()));
        Out<3> out({window.size(), 6, n_xi});
        for (std::size_t k = 0; k < window.size(); ++k) {
            const inertiad::SystematicColumns X = inertiad::systematic_columns(config, window[k], theta);
            for (std::size_t j = 0; j < 6; ++j) {
                std::copy_n(&X(static_cast<Eigen::Index>(j), 0), n_xi, out.data + (6 * k + j) * n_xi);
            }
        }
        return out.release();
    }

    inertiad::Config config;
    std::vector<ipe_average_t> window;
};

/// A recursive estimator with its own state.
struct OwnedRls {
    OwnedRls(const inertiad::Theta& theta, const inertiad::Covariance& P, const Eigen::VectorXd& xi_std) : view(state)
    {
        if (view.init(theta, P, xi_std) != IPE_OK) {
            throw std::invalid_argument("P, xi_std: must be positive definite");
        }
    }
    OwnedRls(const OwnedRls&) = delete;

    double update(const Eigen::MatrixXd& H, const inertiad::Vector6& y, const inertiad::Matrix6& L)
    {
        if (H.rows() != IPE_NY || H.cols() != view.n()) {
            throw std::invalid_argument("H: must be 6 x " + std::to_string(view.n()));
        }
        inertiad::Rls::Rows rows = H;
        double nis = 0.0;
        if (view.update(rows, y, L, nis) != IPE_OK) { throw std::invalid_argument("H, y or L: NaN or Inf"); }
        return nis;
    }

    ipe_rls_t state{};
    inertiad::Rls view;
};

/// Finished windows of a stream of motions and wrenches, as one dict of arrays.
nb::dict averages(const inertiad::Config& config,
                  const nb::ndarray<const int64_t, nb::numpy, nb::c_contig, nb::ndim<1>>& t_ns, const InN3& s,
                  const InN3& w, const In<Dim<-1>, Dim<6>>& y)
{
    const std::size_t n = t_ns.shape(0);
    require_rows(n, s.shape(0), "s");
    require_rows(n, w.shape(0), "w");
    require_rows(n, y.shape(0), "y");
    require_times(t_ns.data(), n, "t_ns");
    ipe_window_t window;
    ipe_window_init(&window, &config.c());
    std::vector<ipe_average_t> found;
    for (std::size_t k = 0; k < n; ++k) {
        ipe_motion_t motion{};
        ipe_wrench_t wrench{};
        ipe_average_t average;
        std::copy_n(s.data() + 3 * k, 3, motion.s);
        std::copy_n(w.data() + 3 * k, 3, motion.w);
        std::copy_n(y.data() + 6 * k, 6, wrench.y);
        if (ipe_window_push(&window, t_ns.data()[k], &motion, &wrench, &average) == IPE_OK) {
            found.push_back(average);
        }
    }
    const std::size_t count = found.size();
    Out<2> out_s({count, 3}), out_w({count, 3}), out_ww({count, 6}), out_alpha({count, 3}), out_y({count, 6});
    Out<1> out_t({count});
    for (std::size_t k = 0; k < count; ++k) {
        std::copy_n(found[k].s, 3, out_s.data + 3 * k);
        std::copy_n(found[k].w, 3, out_w.data + 3 * k);
        std::copy_n(found[k].ww, 6, out_ww.data + 6 * k);
        std::copy_n(found[k].alpha, 3, out_alpha.data + 3 * k);
        std::copy_n(found[k].y, 6, out_y.data + 6 * k);
        out_t.data[k] = 1e-9 * static_cast<double>(found[k].t_ns);
    }
    nb::dict d;
    d["t"] = out_t.release(), d["s"] = out_s.release(), d["w"] = out_w.release(), d["ww"] = out_ww.release();
    d["alpha"] = out_alpha.release(), d["y"] = out_y.release(), d["length"] = window.length;
    return d;
}

constexpr double RATE_MIN = 1e-3, RATE_MAX = 1e6;  // Hz

/// Planned samples of a motion, in rows: what ipe_row_t is to a measured one.
struct Plan {
    const InN3 &s, &w, &p;
    const InN33& R;
    const In<Dim<-1>, Dim<-1>>& f;

    void check(const inertiad::Config& config, std::size_t n) const
    {
        require_rows(n, s.shape(0), "s");
        require_rows(n, w.shape(0), "w");
        require_rows(n, p.shape(0), "p");
        require_rows(n, R.shape(0), "R");
        require_rows(n, f.shape(0), "f");
        if (f.shape(1) != static_cast<std::size_t>(config.n_cables())) {
            throw std::invalid_argument("f: needs a column per cable");
        }
    }
};

/// [Y, -X] of one window in the filter's states, row-major [6][n].
void filter_equations(const inertiad::Config& config, const ipe_average_t& average, const inertiad::Theta& theta,
                      double* H)
{
    const std::size_t n_xi = static_cast<std::size_t>(ipe_systematic_planned_count(config.n_cables()));
    const inertiad::Regressor Y = inertiad::regressor(average);
    const inertiad::SystematicColumns X = inertiad::systematic_columns(config, average, theta);
    for (Eigen::Index j = 0; j < IPE_NY; ++j) {
        H = std::copy_n(&Y(j, 0), IPE_NP, H);
        for (std::size_t i = 0; i < n_xi; ++i) { *H++ = -X(j, static_cast<Eigen::Index>(i)); }
    }
}

/// The windows that a planned motion, sampled at rate [Hz], will be averaged to, and their length [s].
std::vector<ipe_average_t> averages_of(const inertiad::Config& config, double rate, const Plan& plan, double& length)
{
    const std::size_t n = plan.s.shape(0), m = plan.f.shape(1);
    plan.check(config, n);
    require(rate >= RATE_MIN && rate <= RATE_MAX, "rate: allowed: 1e-3 .. 1e6 Hz");
    ipe_config_t sampled = config.c();
    sampled.sample_rate = rate;
    ipe_window_t window;
    ipe_window_init(&window, &sampled);
    std::vector<ipe_average_t> found;
    for (std::size_t k = 0; k < n; ++k) {
        ipe_motion_t motion{};
        ipe_wrench_t wrench{};
        ipe_average_t average;
        std::copy_n(plan.s.data() + 3 * k, 3, motion.s);
        std::copy_n(plan.w.data() + 3 * k, 3, motion.w);
        std::copy_n(plan.p.data() + 3 * k, 3, motion.p);
        std::copy_n(plan.R.data() + 9 * k, 9, &motion.R[0][0]);
        std::copy_n(plan.f.data() + m * k, m, wrench.f);
        ipe_motion_nominal_error(&config.c(), motion.R, &motion.error);
        const auto t_ns = static_cast<int64_t>(std::llround(1e9 * static_cast<double>(k + 1) / rate));
        if (ipe_window_push(&window, t_ns, &motion, &wrench, &average) == IPE_OK) { found.push_back(average); }
    }
    length = window.length;
    return found;
}

/// [Y, -X] of the windows that a planned motion will be averaged to.
nb::tuple planned_windows(const inertiad::Config& config, double rate, const InN3& s, const InN3& w, const InN3& p,
                          const InN33& R, const In<Dim<-1>, Dim<-1>>& f, const inertiad::Theta& theta)
{
    double length = 0.0;
    const std::vector<ipe_average_t> found = averages_of(config, rate, {s, w, p, R, f}, length);
    const auto n_x = static_cast<std::size_t>(IPE_NP + ipe_systematic_planned_count(config.n_cables()));
    Out<3> H({found.size(), IPE_NY, n_x});
    Out<2> motion({found.size(), 6});
    for (std::size_t k = 0; k < found.size(); ++k) {
        filter_equations(config, found[k], theta, H.data + IPE_NY * n_x * k);
        std::copy_n(found[k].w, 3, motion.data + 6 * k);
        std::copy_n(found[k].alpha, 3, motion.data + 6 * k + 3);
    }
    return nb::make_tuple(H.release(), motion.release(), length);
}

/// [Y, -X] as if a window saw nothing but the one instant.
nb::ndarray<nb::numpy, double> planned_instants(const inertiad::Config& config, const InN3& s, const InN3& w,
                                                const InN3& alpha, const InN3& p, const InN3& velocity, const InN33& R,
                                                const In<Dim<-1>, Dim<-1>>& f, const inertiad::Theta& theta)
{
    const std::size_t n = s.shape(0), m = f.shape(1);
    Plan{s, w, p, R, f}.check(config, n);
    require_rows(n, alpha.shape(0), "alpha");
    require_rows(n, velocity.shape(0), "velocity");
    const auto n_x = static_cast<std::size_t>(IPE_NP + ipe_systematic_planned_count(config.n_cables()));
    Out<3> H({n, IPE_NY, n_x});
    for (std::size_t k = 0; k < n; ++k) {
        ipe_average_t average{};
        std::copy_n(s.data() + 3 * k, 3, average.s);
        std::copy_n(w.data() + 3 * k, 3, average.w);
        std::copy_n(alpha.data() + 3 * k, 3, average.alpha);
        std::copy_n(p.data() + 3 * k, 3, average.p);
        std::copy_n(velocity.data() + 3 * k, 3, average.velocity);
        std::copy_n(R.data() + 9 * k, 9, &average.R[0][0]);
        ipe_motion_nominal_error(&config.c(), average.R, &average.error);
        std::copy_n(f.data() + m * k, m, average.f);
        ipe_rate_products(average.w, average.ww);
        filter_equations(config, average, theta, H.data + IPE_NY * n_x * k);
    }
    return H.release();
}

/// When the motion stage first passes rows of a planned motion on, ns from its start: it estimates an attitude by motion.
int64_t settled_ns(const inertiad::Config& config, double rate, const Plan& plan)
{
    ipe_config_t ideal = config.c();
    ideal.world_yaw = 0.0;
    for (double* value : {ideal.attitude_bias, ideal.acc_bias, ideal.gyro_bias}) { std::fill_n(value, 3, 0.0); }
    const double* q = ideal.imu_orientation;
    const inertiad::Matrix3 R_PI = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
    const auto stage = std::make_unique<ipe_motion_stage_t>();
    ipe_motion_init(stage.get(), &ideal);
    ipe_row_t row{};
    row.has_force = row.has_position = row.is_position_new = true;
    for (std::size_t k = 0; k < plan.s.shape(0); ++k) {
        const auto at = [k](const InN3& x) { return Eigen::Map<const inertiad::Vector3>(x.data() + 3 * k); };
        const Eigen::Map<const inertiad::Matrix3> R(plan.R.data() + 9 * k);
        const Eigen::Quaterniond turned{Eigen::Matrix3d(R * R_PI)};
        ipe_motion_t motion;
        row.t_ns = static_cast<int64_t>(std::llround(1e9 * static_cast<double>(k + 1) / rate));
        Eigen::Map<inertiad::Vector3>(row.acc) = R_PI.transpose() * at(plan.s);
        Eigen::Map<inertiad::Vector3>(row.gyro) = R_PI.transpose() * at(plan.w);
        Eigen::Map<Eigen::Vector4d>(row.q) << turned.w(), turned.x(), turned.y(), turned.z();
        Eigen::Map<inertiad::Vector3>(row.position) =
            at(plan.p) + R * Eigen::Map<const inertiad::Vector3>(ideal.tracker_target);
        if (ipe_motion_push(stage.get(), &row, &motion) == IPE_OK) { break; }
    }
    return row.t_ns;
}

/// Covariance [10,10] of mass, CoG and inertia that the estimator publishes after a planned motion whose windows' wrenches
/// are y [M,6]: the daemon's own cycle of predict, update and publish, its prior and the noise it learns from y.
inertiad::Covariance rehearse(const inertiad::Config& config, double rate, const InN3& s, const InN3& w, const InN3& p,
                              const InN33& R, const In<Dim<-1>, Dim<-1>>& f, const In<Dim<-1>, Dim<6>>& y)
{
    double length = 0.0;
    std::vector<ipe_average_t> window = averages_of(config, rate, {s, w, p, R, f}, length);
    if (y.shape(0) != window.size()) { throw std::invalid_argument("y: needs one row per window of the motion"); }
    const auto estimator = std::make_unique<ipe_estimator_t>();
    if (ipe_estimator_init(estimator.get(), &config.c()) != IPE_OK) {
        throw std::invalid_argument("config: the filter refuses its prior");
    }
    const int64_t begin_ns = settled_ns(config, rate, {s, w, p, R, f}), half_ns = std::llround(0.5e9 * length);
    for (std::size_t i = 0; i < window.size(); ++i) {
        if (window[i].t_ns - half_ns < begin_ns) { continue; }
        std::copy_n(y.data() + IPE_NY * i, IPE_NY, window[i].y);
        ipe_estimator_predict(estimator.get(), &config.c(), &window[i]);
        if (ipe_estimator_update(estimator.get(), &config.c(), &window[i]) < IPE_OK) {
            throw std::invalid_argument("motion, y: NaN, Inf or a cable without direction");
        }
    }
    const int64_t t_ns = window.empty() ? 0 : window.back().t_ns;
    if (ipe_estimator_publish(estimator.get(), &config.c(), t_ns) != IPE_OK) {
        throw std::domain_error("no physically consistent body is near the estimate");
    }
    inertiad::Covariance covariance;
    ipe_estimate_body_covariance(&estimator->estimate, inertiad::as_array(covariance));
    return covariance;
}

/// Covariance [10,10] of mass, CoG and inertia that is published for theta [10] known with P [10,10], both about the IMU.
inertiad::Covariance published_covariance(const inertiad::Config& config, const inertiad::Theta& theta,
                                          const inertiad::Covariance& P)
{
    const ipe_estimate_t e = inertiad::publish(config, inertiad::solution(config, theta, P));
    inertiad::Covariance covariance;
    ipe_estimate_body_covariance(&e, inertiad::as_array(covariance));
    return covariance;
}

/// The pipeline's counters and how they are judged.
nb::list counter_table()
{
    nb::list table;
    const ipe_counter_t* counter = nullptr;
    for (unsigned i = 0; (counter = ipe_counter_table(i)) != nullptr; ++i) {
        nb::dict d;
        d["name"] = counter->name;
        d["is_rejected"] = (counter->flags & IPE_COUNTER_REJECTED) != 0;
        d["is_bad"] = (counter->flags & IPE_COUNTER_BAD) != 0;
        table.append(d);
    }
    return table;
}

uint64_t decode_raw(const nb::bytes& data, int start, int length, bool big_endian, bool is_signed)
{
    uint8_t padded[72] = {0};
    if (data.size() > IPE_DATA_MAX) { throw std::invalid_argument("data: more than 64 bytes"); }
    require(start >= 0 && start < 8 * IPE_DATA_MAX && length >= 1 && length <= 64, "start, length: outside the data");
    std::memcpy(padded, data.c_str(), data.size());
    return ipe_decode_raw(padded, start, length, big_endian, is_signed);
}

/// Values of one frame by quantity number, through the config's table.
nb::dict decode_frame(const inertiad::Config& config, int bus, uint32_t can_id, const nb::bytes& data)
{
    ipe_decode_t decode;
    ipe_decode_init(&decode, &config.c());
    if (data.size() > IPE_DATA_MAX) { throw std::invalid_argument("data: more than 64 bytes"); }
    require(bus >= 0 && bus < IPE_BUSES_MAX, "bus: allowed 0 .. 7");
    ipe_frame_t frame{};
    ipe_sample_t sample;
    frame.can_id = can_id;
    frame.bus = static_cast<uint8_t>(bus);
    frame.length = static_cast<uint8_t>(data.size());
    std::memcpy(frame.data, data.c_str(), data.size());
    nb::dict d;
    if (ipe_decode_frame(&decode, &frame, &sample) != IPE_OK) { return d; }
    for (int i = 0; i < sample.n; ++i) { d[nb::int_(int(sample.item[i].quantity))] = sample.item[i].value; }
    return d;
}

nb::dict quantities()
{
    nb::dict d;
    const char* const axis[] = {"x", "y", "z"};
    const char* const q[] = {"q_w", "q_x", "q_y", "q_z"};
    for (int i = 0; i < 3; ++i) {
        d[(std::string("acc_") + axis[i]).c_str()] = IPE_Q_ACC_X + i;
        d[(std::string("gyro_") + axis[i]).c_str()] = IPE_Q_GYRO_X + i;
        d[(std::string("pos_") + axis[i]).c_str()] = IPE_Q_POS_X + i;
    }
    for (int i = 0; i < 4; ++i) { d[q[i]] = IPE_Q_QUAT_W + i; }
    d["roll"] = IPE_Q_ROLL + 0, d["pitch"] = IPE_Q_ROLL + 1, d["yaw"] = IPE_Q_ROLL + 2;
    for (int i = 0; i < IPE_CABLES_MAX; ++i) { d[("f_" + std::to_string(i + 1)).c_str()] = IPE_Q_F_1 + i; }
    d["imu_counter"] = int(IPE_Q_IMU_COUNTER), d["force_counter"] = int(IPE_Q_FORCE_COUNTER);
    d["pos_counter"] = int(IPE_Q_POS_COUNTER), d["imu_time"] = int(IPE_Q_IMU_TIME);
    d["force_time"] = int(IPE_Q_FORCE_TIME), d["pos_time"] = int(IPE_Q_POS_TIME);
    return d;
}

using SystematicKind = std::tuple<const char*, const char*, int, int, bool>;

/// Kinds of systematic parameters of a robot with n_cables, in the order of xi.
std::vector<SystematicKind> systematic_table(int n_cables)
{
    require_cables(n_cables);
    int n = 0, first = 0;
    const ipe_systematic_kind_t* kinds = ipe_systematic_table(&n);
    std::vector<SystematicKind> table;
    for (const ipe_systematic_kind_t* k = kinds; k < kinds + n; ++k) {
        const int count = k->count + k->count_per_cable * n_cables;
        table.emplace_back(k->name, k->unit, first, count, k->count_per_cable > 0);
        first += count;
    }
    return table;
}

}  // namespace

NB_MODULE(inertiad_core, m)
{
    nb::set_leak_warnings(false);
    m.doc() = "The inertiad C core: cable lines, wrench, regressor, weak form, filter, consistency, pipeline.";
    m.attr("QUANTITIES") = quantities();

    nb::class_<inertiad::Config>(m, "Config", "A checked robot configuration, from the bytes of robot.cfg.")
        .def(
            "__init__",
            [](inertiad::Config* self, const nb::bytes& data) {
                new (self) inertiad::Config(inertiad::Config::from_bytes(data.c_str(), data.size()));
            },
            "data"_a, "ValueError, with the reason, if the bytes are damaged, of another version or out of range.")
        .def_prop_ro("n_cables", &inertiad::Config::n_cables);

    m.def(
        "cable_geometry", &cable_geometry, "config"_a, "p"_a, "R"_a,
        "(u [N,m,3] unit vectors in W from the attachment to the leave point, free length [N,m], length with arc [N,m]), "
        "for positions p [N,3] in W and rotations R [N,3,3] P to W. ValueError where a cable has no direction. cable.h");
    m.def("wrench_matrix", &wrench_matrix, "config"_a, "p"_a, "R"_a, "point"_a,
          "(W [N,6,m], sag [N,6]) with wrench = W f + sag about the body point [3], P axes. wrench.h");
    m.def("regressor", &regressor, "s"_a, "w"_a, "alpha"_a,
          "Y [N,6,10] from specific force, rate and angular acceleration [N,3] at the reference point. regressor.h");
    m.def("cable_inertia", &cable_inertia, "config"_a, "s"_a, "w"_a, "alpha"_a, "p"_a, "R"_a,
          "Wrench [N,6] at the IMU, P axes, of the cables' own inertia in motions of the IMU point. cable_inertia.h");
    m.def("shift", &inertiad::shift, "theta"_a, "d"_a, "theta [10] about the point (old - d [3]). body.h");
    m.def(
        "body",
        [](const inertiad::Theta& theta, const inertiad::Covariance& P) { return body_dict(inertiad::body(theta, P)); },
        "theta"_a, "P"_a,
        "dict of mass, cog, inertia_cog and their _std. ValueError if the mass is not positive. body.h");
    m.def(
        "body_jacobian",
        [](const inertiad::Theta& theta) {
            inertiad::Covariance G;
            ipe_body_jacobian(theta.data(), inertiad::as_array(G));
            return G;
        },
        "theta"_a, "d(mass, cog, inertia_cog)/d(theta) [10,10]. body.h");
    m.def("pseudo_inertia", &inertiad::pseudo_inertia, "theta"_a, "[4,4]. consistency.h");
    m.def(
        "nearest_body",
        [](const inertiad::Theta& theta, const inertiad::Covariance& P) {
            double distance = 0.0;
            const inertiad::Theta q = inertiad::nearest_body(theta, P, distance);
            return nb::make_tuple(q, distance);
        },
        "theta"_a, "P"_a,
        "(q [10], Mahalanobis distance squared): the nearest that a body can have. ValueError: none found. consistency.h");
    m.def("is_consistent", &inertiad::is_consistent, "theta"_a,
          "Can a body with these parameters exist? consistency.h");
    m.def("averages", &averages, "config"_a, "t_ns"_a, "s"_a, "w"_a, "y"_a,
          "dict of t [M], s, w, alpha [M,3], ww, y [M,6] and length: the weak form's windows of N rows. window.h");
    m.def(
        "planned_windows", &planned_windows, "config"_a, "rate"_a, "s"_a, "w"_a, "p"_a, "R"_a, "f"_a, "theta"_a,
        "(H [M,6,21+2m], rate and angular acceleration [M,6], window length): the filter's equations [Y, -X] of the windows that a "
        "motion sampled at rate [Hz] will be averaged to; s, w [N,3] at the IMU, P axes; p [N,3], R [N,3,3] pose of P; tensions f "
        "[N,m]; theta [10] about the IMU. window.h, systematic.h");
    m.def("planned_instants", &planned_instants, "config"_a, "s"_a, "w"_a, "alpha"_a, "p"_a, "velocity"_a, "R"_a, "f"_a,
          "theta"_a, "[Y, -X] [N,6,34+2m] of single instants. systematic.h");
    m.def(
        "rehearse", &rehearse, "config"_a, "rate"_a, "s"_a, "w"_a, "p"_a, "R"_a, "f"_a, "y"_a,
        "Covariance [10,10] of mass, CoG and inertia that the daemon's estimator publishes after a motion given as to "
        "planned_windows(), whose windows' wrenches are y [M,6]; the first ones are lost while the attitude settles. "
        "estimator.h, motion.h");
    m.def(
        "published_covariance", &published_covariance, "config"_a, "theta"_a, "P"_a,
        "Covariance [10,10] of mass, CoG and inertia about P, as published for theta [10] with covariance P [10,10], both "
        "about the IMU. ValueError: no physically consistent body is near theta. estimate.h");
    m.def("counter_table", &counter_table,
          "[{name, is_rejected, is_bad}] of every counter of the pipeline, in its order. counter_table.h");
    m.def("decode_raw", &decode_raw, "data"_a, "start"_a, "length"_a, "big_endian"_a, "is_signed"_a,
          "Raw bits of a signal, extended to 64 bits. decode.h");
    m.def("decode_frame", &decode_frame, "config"_a, "bus"_a, "can_id"_a, "data"_a,
          "{quantity number: SI value}. decode.h");

    nb::class_<OwnedRls>(m, "Rls", "Recursive least squares, P = U D U^T. rls.h")
        .def(nb::init<const inertiad::Theta&, const inertiad::Covariance&, const Eigen::VectorXd&>(), "theta"_a, "P"_a,
             "xi_std"_a = Eigen::VectorXd(0))
        .def("update", &OwnedRls::update, "H"_a, "y"_a, "L"_a,
             "Fold in y [6] = H [6,n] x + e, cov(e) = L L^T; returns NIS.")
        .def_prop_ro(
            "x", [](const OwnedRls& r) { return Eigen::VectorXd(r.view.x()); }, "[n]")
        .def_prop_ro("P", [](const OwnedRls& r) { return r.view.P(); }, "[n,n]");

    nb::class_<ipe_clock_t>(m, "Clock", "A device's clock against the host's, by the lower convex hull. clock.h")
        .def(
            "__init__",
            [](ipe_clock_t* c, double wrap) {
                require(wrap >= 0.0 && std::isfinite(wrap), "wrap: must be 0 or more");
                ipe_clock_init(new (c) ipe_clock_t{}, wrap, IPE_CLOCK_RATE_SPAN);
            },
            "wrap"_a = 0.0, "wrap [s]: device time starts again at 0 after this; 0: never.")
        .def(
            "map",
            [](ipe_clock_t& c, double device, int64_t host_ns) {
                require_finite(&device, 1, "device");
                require_times(&host_ns, 1, "host_ns");
                return ipe_clock_map(&c, device, host_ns);
            },
            "device"_a, "host_ns"_a, "Learn from one pair; host time [ns] of the device's instant [s].")
        .def(
            "at", [](const ipe_clock_t& c, double device) { return ipe_clock_at(&c, device); }, "device"_a,
            "Host time [ns] of a device time [s] near the last one mapped, nothing learnt.")
        .def_ro("is_settled", &ipe_clock_t::is_settled)
        .def_ro("n_steps", &ipe_clock_t::n_steps);

    nb::class_<OwnedPipeline>(m, "Pipeline", "CAN frames and positions in, estimate out. pipeline.h")
        .def(nb::init<const inertiad::Config&>(), "config"_a)
        .def("push_frame", &OwnedPipeline::push_frame, "t_ns"_a, "bus"_a, "can_id"_a, "data"_a, "flags"_a = 0,
             "Status of one CAN frame: 0 taken, > 0 nothing for us, < 0 refused.")
        .def(
            "push_position",
            [](OwnedPipeline& p, int64_t t_ns, const inertiad::Vector3& x) {
                return int(p.view.push_position(t_ns, x));
            },
            "t_ns"_a, "position"_a)
        .def(
            "step",
            [](OwnedPipeline& p) {
                ipe_row_t row;
                const int status = p.view.step(row);
                if (status == IPE_OK || status == IPE_IGNORED) { p.rows.push_back(row); }
                return status;
            },
            "Use one aligned row: 0 new estimate, 2 used, 1 none ready, < 0 refused. A used row is kept for Windows.")
        .def("drain", &OwnedPipeline::drain, "Step until no row is ready; the rows are kept for Windows.")
        .def("flush", [](OwnedPipeline& p) { p.view.flush(); })
        .def(
            "freeze", [](OwnedPipeline& p, bool is_frozen) { p.view.freeze(is_frozen); }, "is_frozen"_a,
            "Stop learning from windows, or resume it.")
        .def(
            "reset", [](OwnedPipeline& p) { p.view.reset(); }, "Start the estimator again from its prior.")
        .def(
            "set_gyro_bias", [](OwnedPipeline& p, const inertiad::Vector3& bias) { p.view.set_gyro_bias(bias); },
            "bias"_a, "Use this gyro bias [3], I axes, rad/s, from the next row on.")
        .def("expect", &OwnedPipeline::expect, "t_ns"_a, "numbers"_a,
             "Expect a payload at a host time; numbers [20] of expectation_t. ValueError: no such body. announcement.h")
        .def_prop_ro("estimate", &OwnedPipeline::estimate)
        .def_prop_ro("counters", &OwnedPipeline::counters);

    nb::class_<Windows>(
        m, "Windows",
        "The weak equations y = Y theta - X xi + noise of the rows a Pipeline kept. window.h, systematic.h")
        .def(nb::init<const inertiad::Config&, const OwnedPipeline&>(), "config"_a, "run"_a)
        .def(nb::init<const inertiad::Config&, const Rows&>(), "config"_a, "run"_a)
        .def_prop_ro("t", &Windows::t, nb::rv_policy::move, "[M] s since the first")
        .def_prop_ro("Y", &Windows::Y, nb::rv_policy::move, "[M,6,10]")
        .def_prop_ro("y", &Windows::y, nb::rv_policy::move, "[M,6]")
        .def_prop_ro("R", &Windows::R, nb::rv_policy::move, "[M,3,3] P to W in the windows' middles")
        .def_prop_ro("has_failed", &Windows::has_failed, nb::rv_policy::move,
                     "[M,m] bool: the cable's force sensor has failed within the window")
        .def("X", &Windows::X, "theta"_a, "[M,6,32+3m]");
    m.def(
        "systematic_std",
        [](const inertiad::Config& config) {
            Out<1> out({static_cast<std::size_t>(ipe_systematic_count(config.n_cables()))});
            double std[IPE_XI_MAX];
            ipe_systematic_std(&config.c(), std);
            std::copy_n(std, out.shape[0], out.data);
            return out.release();
        },
        "config"_a, "One sigma [32+3m] of each systematic parameter. systematic.h");
    m.def(
        "systematic_table", systematic_table, "n_cables"_a,
        "(name, SI unit, first index, count, whether per cable) of each kind of systematic parameter, in the order of "
        "xi. systematic.h");
    m.def(
        "linear_parameters",
        [](int n_cables) {
            require_cables(n_cables);
            return inertiad::linear_parameters(n_cables);
        },
        "n_cables"_a,
        "Indices of xi in which the equations are linear: X xi adds to y, no calibration has them. calibrated.hpp");
    bind_batch(m);
    bind_plant(m);
    bind_control(m);
}
