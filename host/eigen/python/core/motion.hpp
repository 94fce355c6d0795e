// SPDX-License-Identifier: Apache-2.0
/// Motions and payloads as numpy hands them over, for what moves a platform.
#pragma once

#include "../binding.hpp"

#include <inertiad/plant.hpp>

namespace binding {

using Table = In<Dim<-1>, Dim<-1>>;

/// Views of what the platform should do at the K instants of control.
struct References {
    InN3 p, v, a;
    InN33 R;
    InN3 w, alpha;

    std::size_t size() const { return p.shape(0); }

    void check() const
    {
        const std::pair<std::size_t, const char*> rows[] = {
            {v.shape(0), "v"}, {a.shape(0), "a"}, {R.shape(0), "R"}, {w.shape(0), "w"}, {alpha.shape(0), "alpha"}};
        for (const auto& [n, name] : rows) { require_rows(size(), n, name); }
        if (size() == 0) { throw std::invalid_argument("p: needs a row"); }
    }

    inertiad::Reference at(std::size_t k) const
    {
        const auto row = [k](const InN3& x) { return Eigen::Map<const inertiad::Vector3>(x.data() + 3 * k); };
        return {row(p), row(v), row(a), Eigen::Map<const inertiad::Matrix3>(R.data() + 9 * k), row(w), row(alpha)};
    }
};

inline std::vector<inertiad::PayloadChange> changes_of(const Table& payload)
{
    std::vector<inertiad::PayloadChange> out;
    if (payload.shape(0) > 0 && payload.shape(1) != 12) { throw std::invalid_argument("payload: needs 12 columns"); }
    for (std::size_t k = 0; k < payload.shape(0); ++k) {
        const double* row = payload.data() + 12 * k;
        out.push_back({row[0], row[1], Eigen::Map<const inertiad::Theta>(row + 2)});
    }
    return out;
}

}  // namespace binding
