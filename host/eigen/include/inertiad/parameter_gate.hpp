// SPDX-License-Identifier: Apache-2.0
/// parameter_gate.h for C++: the parameters that a control loop may use.
#pragma once

#include "types.hpp"

#include <cstdint>
#include <stdexcept>

extern "C" {
#include "parameter_gate.h"
}

namespace inertiad {

/// Neither copied nor moved: two threads know its address. One offers, one reads; read() is wait-free, nothing allocates.
class ParameterGate {
public:
    struct Parameters {
        Theta theta;               ///< m, h, J about P, P axes; always a body that can exist
        ipe_gate_source_t source;  ///< nominal, live, last good, falling back
        std::int64_t sequence;     ///< of the estimate that theta is or moves to; -1: none
        double age;                ///< s since an estimate was taken; -1: none was
        bool is_moving;
    };

    /// Throws std::invalid_argument if a limit is not positive or no body with the nominal parameters can exist.
    explicit ParameterGate(const Theta& nominal, const ipe_gate_limits_t& limits = ipe_parameter_gate_default())
    {
        if (ipe_parameter_gate_init(&gate_, &limits, nominal.data()) != IPE_OK) {
            throw std::invalid_argument(
                "gate: a limit is not positive, or no body with the nominal parameters can exist");
        }
    }
    ParameterGate(const ParameterGate&) = delete;
    ParameterGate& operator=(const ParameterGate&) = delete;

    /// Offer an estimate at host time now_ns; what became of it.
    ipe_gate_reason_t offer(const ipe_gate_estimate_t& estimate, std::int64_t now_ns) noexcept
    {
        return ipe_parameter_gate_offer(&gate_, &estimate, now_ns);
    }

    /// The parameters at host time now_ns.
    Parameters read(std::int64_t now_ns) noexcept
    {
        ipe_gate_parameters_t p;
        ipe_parameter_gate_read(&gate_, now_ns, &p);
        return {Eigen::Map<const Theta>(p.theta), p.source, p.sequence, p.age, p.is_moving};
    }

    /// Estimates offered so far with this outcome. For the thread that offers.
    std::uint64_t count(ipe_gate_reason_t reason) const noexcept { return gate_.n[reason]; }

private:
    ipe_parameter_gate_t gate_{};
};

}  // namespace inertiad
