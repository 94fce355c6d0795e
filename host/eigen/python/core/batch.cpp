// SPDX-License-Identifier: Apache-2.0
/// Part of inertiad_core: whole runs into rows, and batch identification on them.
#include "../binding.hpp"

#include <inertiad/batch.hpp>
#include <inertiad/windows.hpp>

#include <nanobind/stl/unique_ptr.h>

#include <algorithm>
#include <poll.h>

extern "C" {
#include "align.h"
#include "stuck_sensor.h"
#include "replay.h"
}

using namespace binding;

namespace {

constexpr double DELAY_MAX = 1000.0;  // s

using Times = nb::ndarray<const int64_t, nb::numpy, nb::c_contig, nb::device::cpu, nb::ndim<1>>;
using Table = nb::ndarray<const double, nb::numpy, nb::c_contig, nb::device::cpu, nb::ndim<2>>;

void require_columns(const Table& table, std::size_t n, const char* name)
{
    if (table.shape(1) != n) {
        throw std::invalid_argument(std::string(name) + ": needs " + std::to_string(n) + " columns");
    }
}

/// Closes what it opened, whatever happens in between.
struct Replay {
    Replay() : state(std::make_unique<ipe_replay_t>()) {}
    Replay(const Replay&) = delete;
    ~Replay() { ipe_replay_close(state.get()); }
    std::unique_ptr<ipe_replay_t> state;
};

/// Everything in the logs and the tracker file through a pipeline, in the order of the stamps; no log line is an error.
void play(ipe_replay_t& replay, OwnedPipeline& pipeline)
{
    ipe_replay_item_t item;
    for (;;) {
        const ipe_replay_status_t status = ipe_replay_next(&replay, &item);
        if (status == IPE_REPLAY_END) { break; }
        if (status == IPE_REPLAY_WAIT) {
            pollfd input{item.fd, POLLIN, 0};
            (void)poll(&input, 1, -1);
            ipe_replay_fill(&replay);
            continue;
        }
        if (status == IPE_REPLAY_FRAME) {
            (void)ipe_pipeline_push_frame(pipeline.state.get(), item.frame);
        } else {
            (void)ipe_pipeline_push_position(pipeline.state.get(), item.position->t_ns, item.position->position);
        }
        pipeline.drain();
    }
    pipeline.view.flush();
    pipeline.drain();
}

/// A run's files through a pipeline. interfaces: of each bus, "" for all frames of its log.
std::unique_ptr<OwnedPipeline> read_run(const inertiad::Config& config, const std::vector<std::string>& logs,
                                        const std::vector<std::string>& interfaces, const std::string& tracker)
{
    if (logs.size() > IPE_BUSES_MAX || interfaces.size() != logs.size()) {
        throw std::invalid_argument("logs: at most 8 buses");
    }
    auto pipeline = std::make_unique<OwnedPipeline>(config);
    Replay replay;
    for (std::size_t i = 0; i < logs.size(); ++i) {
        const char* interface = interfaces[i].empty() ? nullptr : interfaces[i].c_str();
        if (ipe_source_file_open(&replay.state->bus[i], logs[i].c_str(), static_cast<uint8_t>(i), interface) != 0) {
            throw std::invalid_argument(logs[i] + ": cannot open");
        }
        ++replay.state->n_buses;
    }
    if (!tracker.empty()) {
        char message[256] = "";
        if (ipe_source_tracker_file_open(&replay.state->tracker, tracker.c_str(), -1, message, sizeof message) != 0) {
            throw std::invalid_argument(message);
        }
        replay.state->has_tracker = true;
    }
    play(*replay.state, *pipeline);
    return pipeline;
}

Rows rows_of(const OwnedPipeline& pipeline)
{
    return {pipeline.rows, pipeline.state->config.n_cables, {}};
}

/// Next row that is ready, until there is none.
void pop_all(ipe_align_t& align, std::vector<ipe_row_t>& rows)
{
    ipe_row_t row;
    while (ipe_align_pop(&align, &row) == IPE_OK) { rows.push_back(row); }
}

/// Signals and positions aligned as on the platform.
Rows align_signals(const inertiad::Config& config, const Times& t_ns, const Table& imu, const Table& f,
                   const Times& position_t_ns, const Table& position, bool derives_force, bool derives_rate)
{
    ipe_config_t c = config.c();
    c.attitude_source = IPE_ATTITUDE_QUATERNION;
    require_columns(imu, 10, "imu");
    require_columns(f, static_cast<std::size_t>(c.n_cables), "f");
    require_columns(position, 3, "position");
    require_rows(t_ns.shape(0), imu.shape(0), "imu");
    require_rows(t_ns.shape(0), f.shape(0), "f");
    require(position.shape(0) == position_t_ns.shape(0), "position: needs as many rows as position_t_ns");
    require_times(t_ns.data(), t_ns.shape(0), "t_ns");
    require_times(position_t_ns.data(), position_t_ns.shape(0), "position_t_ns");
    auto align = std::make_unique<ipe_align_t>();
    ipe_stuck_sensor_t stuck;
    ipe_align_init(align.get(), &c);
    ipe_stuck_sensor_init(&stuck, &c);
    Rows rows{{}, c.n_cables, {derives_force, derives_rate}};
    rows.row.reserve(t_ns.shape(0));
    std::size_t j = 0;
    const auto push_positions = [&](int64_t until) {
        for (; j < position_t_ns.shape(0) && position_t_ns.data()[j] <= until; ++j) {
            (void)ipe_align_push(align.get(), IPE_POSITION, position_t_ns.data()[j], position.data() + 3 * j);
            pop_all(*align, rows.row);
        }
    };
    for (std::size_t k = 0; k < t_ns.shape(0); ++k) {
        push_positions(t_ns.data()[k]);
        (void)ipe_align_push(align.get(), IPE_IMU, t_ns.data()[k], imu.data() + 10 * k);
        const double* force = f.data() + f.shape(1) * k;
        (void)ipe_stuck_sensor_push(&stuck, IPE_IMU, t_ns.data()[k], imu.data() + 10 * k);
        if (!ipe_stuck_sensor_push(&stuck, IPE_FORCE, t_ns.data()[k], force)) {
            ipe_align_set_unknown_force(align.get(), stuck.unknown);
            (void)ipe_align_push(align.get(), IPE_FORCE, t_ns.data()[k], force);
        }
        pop_all(*align, rows.row);
    }
    push_positions(INT64_MAX);
    align->is_ending = true;
    pop_all(*align, rows.row);
    rows.row = inertiad::complete_rows(config, rows.row);
    return rows;
}

/// What the platform's filter makes of aligned rows, estimate by estimate.
nb::dict track(const inertiad::Config& config, const Rows& rows)
{
    require(config.n_cables() == rows.n_cables, "rows: needs the configuration's cables");
    OwnedPipeline pipeline(config);
    ipe_align_t& align = pipeline.state->align;
    std::fill_n(align.delay_ns, IPE_SENSOR_COUNT, 0);  // rows are stamped with the measured instant
    align.has_rpy = false;
    std::vector<ipe_estimate_t> found;
    std::vector<double> restored;
    const auto add_restored = [&] {
        for (int i = 0; i < config.n_cables(); ++i) {
            const bool is_unknown = (found.back().unknown_force >> static_cast<unsigned>(i) & 1U) != 0;
            restored.push_back(is_unknown ? pipeline.state->estimator.restored[i] : std::nan(""));
        }
    };
    for (const ipe_row_t& row : rows.row) {
        double imu[10];
        std::copy_n(row.acc, 3, imu), std::copy_n(row.gyro, 3, imu + 3), std::copy_n(row.q, 4, imu + 6);
        ipe_align_set_unknown_force(&align, row.unknown_force);
        (void)ipe_align_push(&align, IPE_FORCE, row.t_ns, row.f);
        if (row.has_position) { (void)ipe_align_push(&align, IPE_POSITION, row.t_ns, row.position); }
        (void)ipe_align_push(&align, IPE_IMU, row.t_ns, imu);
        ipe_row_t again;
        for (int status; (status = pipeline.view.step(again)) != IPE_NOT_READY;) {
            if (status == IPE_OK) { found.push_back(pipeline.view.estimate()), add_restored(); }
        }
    }
    const std::size_t n = found.size();
    Out<1> t({n}), nis({n}), changes({n}), factor({n}), misfit({n});
    Out<2> value({n, 10}), std({n, 10}), force({n, static_cast<std::size_t>(config.n_cables())});
    std::copy(restored.begin(), restored.end(), force.data);
    for (std::size_t k = 0; k < n; ++k) {
        const ipe_body_t& b = found[k].body;
        t.data[k] = 1e-9 * static_cast<double>(found[k].t_ns);
        nis.data[k] = found[k].nis, changes.data[k] = static_cast<double>(found[k].n_changes);
        factor.data[k] = found[k].sigma_factor, misfit.data[k] = found[k].is_misfit ? 1.0 : 0.0;
        value.data[10 * k] = b.mass, std.data[10 * k] = b.mass_std;
        std::copy_n(b.cog, 3, value.data + 10 * k + 1), std::copy_n(b.cog_std, 3, std.data + 10 * k + 1);
        std::copy_n(b.inertia_cog, 6, value.data + 10 * k + 4);
        std::copy_n(b.inertia_cog_std, 6, std.data + 10 * k + 4);
    }
    nb::dict d;
    d["t"] = t.release(), d["value"] = value.release(), d["std"] = std.release();
    d["nis"] = nis.release(), d["n_changes"] = changes.release();
    d["sigma_factor"] = factor.release(), d["is_misfit"] = misfit.release(), d["restored_force"] = force.release();
    return d;
}

/// A member of all rows as [N, n].
template <typename Read>
nb::ndarray<nb::numpy, double> column(const Rows& rows, std::size_t n, Read read)
{
    Out<2> out({rows.row.size(), n});
    for (std::size_t k = 0; k < rows.row.size(); ++k) { std::copy_n(read(rows.row[k]), n, out.data + n * k); }
    return out.release();
}

nb::ndarray<nb::numpy, double> times(const Rows& rows)
{
    Out<1> out({rows.row.size()});
    for (std::size_t k = 0; k < rows.row.size(); ++k) { out.data[k] = 1e-9 * static_cast<double>(rows.row[k].t_ns); }
    return out.release();
}

Rows make_rows(const Times& t_ns, const Table& acc, const Table& gyro, const Table& q, const Table& position,
               const Table& f, bool derives_force, bool derives_rate)
{
    require_columns(acc, 3, "acc");
    require_columns(gyro, 3, "gyro");
    require_columns(q, 4, "q");
    require_columns(position, 3, "position");
    const std::size_t n = t_ns.shape(0), m = f.shape(1);
    if (m > IPE_CABLES_MAX) { throw std::invalid_argument("f: at most 16 columns"); }
    for (const Table* table : {&acc, &gyro, &q, &position, &f}) {
        if (table->shape(0) != n) { throw std::invalid_argument("all arguments need as many rows as t_ns"); }
    }
    require_times(t_ns.data(), n, "t_ns");
    Rows rows{std::vector<ipe_row_t>(n), static_cast<int>(m), {derives_force, derives_rate}};
    for (std::size_t k = 0; k < n; ++k) {
        ipe_row_t& row = rows.row[k];
        row.t_ns = t_ns.data()[k];
        std::copy_n(acc.data() + 3 * k, 3, row.acc);
        std::copy_n(gyro.data() + 3 * k, 3, row.gyro);
        std::copy_n(q.data() + 4 * k, 4, row.q);
        std::copy_n(position.data() + 3 * k, 3, row.position);
        std::copy_n(f.data() + m * k, m, row.f);
        row.has_force = row.has_position = row.is_position_new = true;
    }
    return rows;
}

nb::dict body_result(const inertiad::BatchBody& b)
{
    nb::dict d = body_dict(b.body);
    d["theta"] = b.theta, d["theta_possible"] = b.theta_possible, d["covariance"] = b.P;
    d["consistent"] = b.is_consistent, d["distance"] = b.distance;
    d["prior"] = body_dict(b.prior);
    nb::list observable;
    for (const bool o : b.observable) { observable.append(o); }
    d["observable"] = observable;
    return d;
}

nb::dict fit_result(const inertiad::BatchFit& f)
{
    nb::dict d;
    d["n_rows"] = f.n_rows, d["n_windows"] = f.n_windows, d["n_rest"] = f.n_rest;
    d["rms"] = f.rms, d["noise_std"] = f.noise_std, d["correlation_time"] = f.correlation_time;
    return d;
}

nb::dict block_result(const inertiad::BatchBlock& b)
{
    nb::dict d;
    d["run"] = b.run, d["begin"] = b.begin, d["end"] = b.end, d["n_windows"] = b.n_windows;
    d["H"] = b.H, d["g"] = b.g;
    return d;
}

nb::dict solve(const inertiad::Config& config, const std::vector<const Rows*>& runs, const std::vector<int>& group,
               const std::vector<double>& payload, bool is_payload_known, double payload_std,
               const std::vector<bool>& is_free, double theta_prior, bool is_weight_learnt)
{
    std::vector<inertiad::BatchRun> batch;
    if (group.size() != runs.size()) { throw std::invalid_argument("group: needs one entry per run"); }
    for (std::size_t i = 0; i < runs.size(); ++i) {
        if (group[i] < 0 || group[i] >= static_cast<int>(payload.size())) {
            throw std::invalid_argument("group: out of range");
        }
        require(runs[i]->n_cables == config.n_cables(), "runs: need the configuration's cables");
        batch.push_back({&runs[i]->row, group[i], runs[i]->derived});
    }
    inertiad::BatchSettings settings;
    settings.payload = payload, settings.is_payload_known = is_payload_known, settings.payload_std = payload_std;
    settings.is_free = is_free, settings.theta_prior = theta_prior, settings.is_weight_learnt = is_weight_learnt;
    if (!is_free.empty() && is_free.size() != static_cast<std::size_t>(ipe_systematic_count(config.n_cables()))) {
        throw std::invalid_argument("is_free: needs one entry per systematic parameter");
    }
    inertiad::BatchResult r;
    {
        const nb::gil_scoped_release unlocked;
        r = inertiad::solve(config, batch, settings);
    }
    nb::dict d;
    nb::list bodies, fits, blocks;
    for (const auto& b : r.body) { bodies.append(body_result(b)); }
    for (const auto& f : r.fit) { fits.append(fit_result(f)); }
    for (const auto& b : r.block) { blocks.append(block_result(b)); }
    d["body"] = bodies, d["fit"] = fits, d["xi"] = r.xi, d["xi_std"] = r.xi_std, d["free"] = r.free;
    d["covariance"] = r.P, d["prior_std"] = r.prior_std, d["n_steps"] = r.n_steps, d["last_step"] = r.last_step;
    d["slowest"] = r.slowest, d["weight_change"] = r.weight_change;
    d["converged"] = r.is_converged, d["refused"] = r.refused;
    d["blocks"] = blocks, d["prior_information"] = r.H_prior;
    return d;
}

}  // namespace

void bind_batch(nb::module_& m)
{
    nb::class_<Rows>(m, "Rows", "Aligned rows of a run, as measured: ipe_row_t in types.h.")
        .def(
            "__init__",
            [](Rows* self, const Times& t_ns, const Table& acc, const Table& gyro, const Table& q,
               const Table& position, const Table& f, bool derives_force, bool derives_rate) {
                new (self) Rows(make_rows(t_ns, acc, gyro, q, position, f, derives_force, derives_rate));
            },
            "t_ns"_a, "acc"_a, "gyro"_a, "q"_a, "position"_a, "f"_a, "derives_force"_a = false,
            "derives_rate"_a = false)
        .def("__len__", [](const Rows& r) { return r.row.size(); })
        .def_prop_ro("t", &times, nb::rv_policy::move, "[N] s")
        .def_prop_ro(
            "acc", [](const Rows& r) { return column(r, 3, [](const ipe_row_t& x) { return x.acc; }); },
            nb::rv_policy::move, "[N,3] I axes, m/s2")
        .def_prop_ro(
            "gyro", [](const Rows& r) { return column(r, 3, [](const ipe_row_t& x) { return x.gyro; }); },
            nb::rv_policy::move, "[N,3] I axes, rad/s")
        .def_prop_ro(
            "q", [](const Rows& r) { return column(r, 4, [](const ipe_row_t& x) { return x.q; }); },
            nb::rv_policy::move, "[N,4] w x y z, I to W")
        .def_prop_ro(
            "position", [](const Rows& r) { return column(r, 3, [](const ipe_row_t& x) { return x.position; }); },
            nb::rv_policy::move, "[N,3] tracked point, W, m")
        .def_prop_ro(
            "f",
            [](const Rows& r) {
                return column(r, static_cast<std::size_t>(r.n_cables), [](const ipe_row_t& x) { return x.f; });
            },
            nb::rv_policy::move, "[N,m] N")
        .def_prop_ro(
            "has_failed", [](const Rows& r) { return failed_sensors(r.row, r.n_cables); }, nb::rv_policy::move,
            "[N,m] bool: the cable's force sensor has failed, f is no measurement")
        .def_prop_ro(
            "derives_force", [](const Rows& r) { return r.derived.force; },
            "True: acc comes from positions and attitude, derived.hpp")
        .def_prop_ro("derives_rate", [](const Rows& r) { return r.derived.rate; }, "True: gyro comes from attitude");

    m.def(
        "read_run", &read_run, "config"_a, "logs"_a, "interfaces"_a, "tracker"_a,
        "Pipeline that has read candump logs, one per bus (interface name, or \"\" for all), and a tracker CSV (or \"\").",
        nb::call_guard<nb::gil_scoped_release>());
    m.def("rows_of", &rows_of, "pipeline"_a, "The rows a Pipeline kept.");
    m.def(
        "align_signals", &align_signals, "config"_a, "t_ns"_a, "imu"_a, "f"_a, "position_t_ns"_a, "position"_a,
        "derives_force"_a = false, "derives_rate"_a = false,
        "Rows of imu [N,10] (acc, gyro, q w x y z), f [N,m] at t_ns [N] and position [K,3] at position_t_ns [K]. align.h");
    m.def("track", &track, "config"_a, "rows"_a,
          "dict of t [K] s, value and std [K,10] of mass, CoG, inertia, nis [K], n_changes [K], sigma_factor [K] and "
          "is_misfit [K] (estimate.h), restored_force [K,m] N of failed sensors, else NaN: every estimate that the "
          "platform's filter makes of the rows. pipeline.h");
    m.def(
        "undelayed",
        [](const Rows& r, double position, double force) {
            require(std::abs(position) <= DELAY_MAX && std::abs(force) <= DELAY_MAX, "delay: allowed: up to 1000 s");
            return Rows{inertiad::undelayed(r.row, r.n_cables, position, force), r.n_cables, r.derived};
        },
        "rows"_a, "position_delay"_a, "force_delay"_a,
        "Rows as if position and forces had come that much [s] earlier.");
    m.def(
        "corrected_rows",
        [](const inertiad::Config& config, const Rows& r, const Eigen::VectorXd& xi) {
            require_xi(config, xi);
            require(config.n_cables() == r.n_cables, "rows: needs the configuration's cables");
            const inertiad::Config corrected = inertiad::calibrated(config, xi);
            return Rows{inertiad::corrected_rows(config, corrected, xi, r.row, r.derived), r.n_cables, r.derived};
        },
        "config"_a, "rows"_a, "xi"_a,
        "Rows for the configuration with corrections xi [32+3m]: delays taken out, derived motion as attitude has it.");
    m.def(
        "calibrated",
        [](const inertiad::Config& config, const Eigen::VectorXd& xi) {
            require_xi(config, xi);
            return inertiad::calibrated(config, xi);
        },
        "config"_a, "xi"_a, "The configuration with corrections xi [32+3m].");
    m.def(
        "batch", &solve, "config"_a, "runs"_a, "group"_a, "payload"_a, "is_payload_known"_a = false,
        "payload_std"_a = 0.01, "is_free"_a = std::vector<bool>{}, "theta_prior"_a = 1.0, "is_weight_learnt"_a = true,
        "Damped Gauss-Newton over theta of each group and the free systematic parameters. ValueError: no solution. batch.hpp");
}
