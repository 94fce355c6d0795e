// SPDX-License-Identifier: Apache-2.0
/// View of the whole pipeline. Same verbs as firmware/core/pipeline.h.
#pragma once

#include "config.hpp"

extern "C" {
#include "pipeline.h"
}

namespace inertiad {

/// View of a C pipeline: same verbs, no copies, no logic. The ipe_pipeline_t must outlive it.
class Pipeline {
public:
    explicit Pipeline(ipe_pipeline_t& p) noexcept : p_(&p) {}
    void init(const Config& config)
    {
        char message[256] = "";
        if (ipe_pipeline_init(p_, &config.c(), message, sizeof message) != IPE_OK) {
            throw std::invalid_argument(message);
        }
    }
    ipe_status_t push_frame(const ipe_frame_t& frame) noexcept { return ipe_pipeline_push_frame(p_, &frame); }
    ipe_status_t push_position(int64_t t_ns, const Vector3& position) noexcept
    {
        return ipe_pipeline_push_position(p_, t_ns, position.data());
    }
    ipe_status_t step(ipe_row_t& row) noexcept { return ipe_pipeline_step(p_, &row, nullptr); }
    void flush() noexcept { ipe_pipeline_flush(p_); }
    void freeze(bool is_frozen) noexcept { ipe_pipeline_freeze(p_, is_frozen); }
    void reset() noexcept { ipe_pipeline_reset(p_); }
    void set_gyro_bias(const Vector3& bias) noexcept { ipe_pipeline_set_gyro_bias(p_, bias.data()); }
    const ipe_estimate_t& estimate() const noexcept { return p_->estimator.estimate; }
    Eigen::Map<const Theta> theta() const noexcept { return Eigen::Map<const Theta>(p_->estimator.estimate.theta); }
    Eigen::Map<const Covariance> covariance() const noexcept
    {
        return Eigen::Map<const Covariance>(&p_->estimator.estimate.covariance[0][0]);
    }

private:
    ipe_pipeline_t* p_;
};

}  // namespace inertiad
