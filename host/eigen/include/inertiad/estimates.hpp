// SPDX-License-Identifier: Apache-2.0
/// The daemon's estimates for a C++ controller: the newest ESTIMATE message. What a control loop should use of them is
/// decided by parameter_gate.hpp, what it feeds forward with them is in feed_forward.hpp.
/// One thread: handle() takes in what has come; ready within the time given or not at all. liblcm allocates per message.
#pragma once

#include "parameter_gate.hpp"

#include <lcm/lcm.h>

#include <algorithm>
#include <stdexcept>
#include <string>

extern "C" {
#include "inertiad_lcm_estimate_t.h"
}

namespace inertiad {

/// Subscribes to PREFIX + "ESTIMATE". Neither copied nor moved: LCM knows its address.
class Estimates {
public:
    explicit Estimates(const std::string& url, const std::string& prefix = "INERTIAD_") : lcm_(lcm_create(url.c_str()))
    {
        if (lcm_ == nullptr) { throw std::runtime_error(url + ": cannot open this LCM URL"); }
        (void)inertiad_lcm_estimate_t_subscribe(lcm_, (prefix + "ESTIMATE").c_str(), &Estimates::on_message, this);
    }
    ~Estimates() { lcm_destroy(lcm_); }
    Estimates(const Estimates&) = delete;
    Estimates& operator=(const Estimates&) = delete;

    /// Wait at most timeout_ms for messages. False once a log has ended.
    bool handle(int timeout_ms) { return lcm_handle_timeout(lcm_, timeout_ms) >= 0; }
    /// Messages so far.
    int count() const noexcept { return count_; }
    /// The newest, as a gate takes it.
    const ipe_gate_estimate_t& newest() const noexcept { return newest_; }

private:
    static void on_message(const lcm_recv_buf_t*, const char*, const inertiad_lcm_estimate_t* message, void* user)
    {
        auto* self = static_cast<Estimates*>(user);
        ipe_gate_estimate_t& e = self->newest_;
        e.sequence = message->sequence, e.t_ns = message->t_ns, e.n_changes = message->n_changes;
        e.verdict = message->verdict, e.is_provisional = message->provisional != 0;
        std::copy(message->theta, message->theta + IPE_NP, e.theta);
        std::copy(&message->covariance[0][0], &message->covariance[0][0] + IPE_NP * IPE_NP, &e.covariance[0][0]);
        for (int i = 0; i < IPE_NP; ++i) { e.observable[i] = message->observable[i] != 0; }
        ++self->count_;
    }

    lcm_t* lcm_;
    ipe_gate_estimate_t newest_{};
    int count_ = 0;
};

}  // namespace inertiad
