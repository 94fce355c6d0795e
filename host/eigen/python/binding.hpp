// SPDX-License-Identifier: Apache-2.0
/// Shared by the parts of the Python module: numpy arrays in and out, rows, a pipeline that keeps its rows.
#pragma once

#include <inertiad/body.hpp>
#include <inertiad/config.hpp>
#include <inertiad/derived.hpp>
#include <inertiad/pipeline.hpp>

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

extern "C" {
#include "counter_table.h"
#include "systematic.h"
}

#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

/// Adds batch identification and what reads whole runs to the module.
void bind_batch(nb::module_& m);
/// Adds forward dynamics, tension distribution and bus arbitration to the module.
void bind_plant(nb::module_& m);
/// Adds the parameter gate and the control loop to the module.
void bind_control(nb::module_& m);

namespace binding {

template <typename... Shape>
using In = nb::ndarray<const double, nb::numpy, nb::c_contig, nb::device::cpu, nb::shape<Shape::value...>>;
template <nb::ssize_t N>
using Dim = std::integral_constant<nb::ssize_t, N>;
using InN3 = In<Dim<-1>, Dim<3>>;
using InN33 = In<Dim<-1>, Dim<3>, Dim<3>>;

/// A new numpy array of the given shape, zero-filled, that owns its memory.
template <std::size_t Rank>
struct Out {
    explicit Out(const std::size_t (&shape_)[Rank])
    {
        std::size_t n = 1;
        for (std::size_t i = 0; i < Rank; ++i) { n *= shape[i] = shape_[i]; }
        data = new double[n]();
    }
    nb::ndarray<nb::numpy, double> release() const
    {
        nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
        return {data, Rank, shape, owner};
    }
    std::size_t shape[Rank];
    double* data;
};

/// Of what was measured at each of some instants, [N, m]: has the cable's force sensor failed?
template <class Measured>
nb::ndarray<nb::numpy, bool> failed_sensors(const std::vector<Measured>& measured, int n_cables)
{
    const auto m = static_cast<std::size_t>(n_cables);
    bool* data = new bool[measured.size() * m];
    const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<bool*>(p); });
    for (std::size_t k = 0; k < measured.size(); ++k) {
        for (std::size_t i = 0; i < m; ++i) { data[m * k + i] = (measured[k].unknown_force >> i & 1U) != 0; }
    }
    const std::size_t shape[]{measured.size(), m};
    return {data, 2, shape, owner};
}

inline void require_rows(std::size_t n, std::size_t other, const char* name)
{
    if (n != other) { throw std::invalid_argument(std::string(name) + ": needs as many rows as the first argument"); }
}

inline void require(bool is_good, const std::string& reason)
{
    if (!is_good) { throw std::invalid_argument(reason); }
}

constexpr int64_t EARLIEST_NS = INT64_C(-100000000000000000);  // three years before 0: recorded time may begin anywhere

/// Host times [n], ns, of a range whose differences fit.
inline void require_times(const int64_t* t_ns, std::size_t n, const char* name)
{
    for (std::size_t k = 0; k < n; ++k) {
        require(t_ns[k] >= EARLIEST_NS && t_ns[k] <= IPE_TIME_MAX_NS,
                std::string(name) + ": allowed: -1e8 .. 8999999999 s, in ns");
    }
}

inline void require_finite(const double* value, std::size_t n, const char* name)
{
    for (std::size_t k = 0; k < n; ++k) { require(std::isfinite(value[k]), std::string(name) + ": NaN or Inf"); }
}

inline void require_cables(int n_cables)
{
    require(n_cables >= 1 && n_cables <= IPE_CABLES_MAX, "n_cables: allowed: 1 .. 16");
}

/// Systematic parameters xi of a robot.
inline void require_xi(const inertiad::Config& config, const Eigen::VectorXd& xi)
{
    require(xi.size() == ipe_systematic_count(config.n_cables()), "xi: needs one entry per systematic parameter");
    require_finite(xi.data(), static_cast<std::size_t>(xi.size()), "xi");
}

inline nb::dict body_dict(const ipe_body_t& b)
{
    nb::dict d;
    d["mass"] = b.mass, d["mass_std"] = b.mass_std;
    const auto list = [](const double* v, std::size_t n) {
        nb::list l;
        for (std::size_t i = 0; i < n; ++i) { l.append(v[i]); }
        return l;
    };
    d["cog"] = list(b.cog, 3), d["cog_std"] = list(b.cog_std, 3);
    d["inertia_cog"] = list(b.inertia_cog, 6), d["inertia_cog_std"] = list(b.inertia_cog_std, 6);
    return d;
}

/// Aligned rows of a run, as measured.
struct Rows {
    std::vector<ipe_row_t> row;
    int n_cables = 0;
    inertiad::Derived derived;
};

/// A pipeline with its own state, on the heap of the host.
struct OwnedPipeline {
    explicit OwnedPipeline(const inertiad::Config& config) : state(std::make_unique<ipe_pipeline_t>()), view(*state)
    {
        view.init(config);
    }

    int push_frame(int64_t t_ns, int bus, uint32_t can_id, const nb::bytes& data, int flags)
    {
        if (data.size() > IPE_DATA_MAX) { throw std::invalid_argument("data: more than 64 bytes"); }
        if (bus < 0 || bus >= IPE_BUSES_MAX) { throw std::invalid_argument("bus: allowed 0 .. 7"); }
        ipe_frame_t frame{};
        frame.t_ns = t_ns;
        frame.bus = static_cast<uint8_t>(bus);
        frame.can_id = can_id;
        frame.flags = static_cast<uint8_t>(flags);
        frame.length = static_cast<uint8_t>(data.size());
        std::memcpy(frame.data, data.c_str(), data.size());
        return view.push_frame(frame);
    }

    /// ValueError: numbers that no body has, or a payload is in contact.
    void expect(int64_t t_ns, const Eigen::Matrix<double, IPE_ANNOUNCEMENT_NUMBERS, 1>& numbers)
    {
        char message[256];
        if (ipe_pipeline_expect(state.get(), announcement.get(), numbers.data(), t_ns, message, sizeof message) !=
            IPE_OK) {
            throw std::invalid_argument(message);
        }
    }

    nb::dict counters() const
    {
        nb::dict d;
        uint64_t value = 0;
        for (unsigned i = 0; const char* name = ipe_pipeline_counter(state.get(), i, &value); ++i) { d[name] = value; }
        return d;
    }

    nb::dict estimate() const
    {
        const ipe_estimate_t& e = view.estimate();
        nb::dict d = body_dict(e.body);
        d["t_ns"] = e.t_ns, d["n_windows"] = e.n_windows, d["n_rows"] = e.n_rows;
        d["systematic"] = Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(e.systematic, e.n_systematic));
        d["systematic_std"] = Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(e.systematic_std, e.n_systematic));
        nb::list observable;
        for (const bool o : e.observable) { observable.append(o); }
        d["observable"] = observable, d["n_changes"] = e.n_changes, d["distance"] = e.distance;
        d["consistent"] = e.consistent, d["nis"] = e.nis;
        d["theta"] = inertiad::Theta(view.theta());
        d["covariance"] = inertiad::Covariance(view.covariance());
        return d;
    }

    /// Step until no row is ready, keeping the rows.
    void drain()
    {
        ipe_row_t row;
        for (int status; (status = view.step(row)) != IPE_NOT_READY;) {
            if (status >= IPE_OK) { rows.push_back(row); }
        }
    }

    std::unique_ptr<ipe_pipeline_t> state;
    std::unique_ptr<ipe_announcement_t> announcement = std::make_unique<ipe_announcement_t>();
    inertiad::Pipeline view;
    std::vector<ipe_row_t> rows;
};

}  // namespace binding
