// SPDX-License-Identifier: Apache-2.0
/// Some seconds of what ideal sensors read of the unit tests' robot, as frames and positions.
#ifndef TEST_FUZZ_MOTION_H
#define TEST_FUZZ_MOTION_H

#include "fuzz.h"
#include "pipeline.h"
#include "robot.h"

enum { MOTION_SAMPLES = 2000 };
#define MOTION_STEP_NS INT64_C(2000000)
#define MOTION_BEGIN_NS INT64_C(1000000000)

static ideal_t motion[MOTION_SAMPLES];
static ipe_config_t motion_config;

static inline void motion_prepare(void)
{
    double truth[IPE_NP];
    motion_config = cogiro();
    nominal_theta(truth);
    for (int k = 0; k < MOTION_SAMPLES; ++k) {
        motion[k] = ideal_at(&motion_config, 1e-9 * (double)(k * MOTION_STEP_NS), truth);
    }
}

static inline void motion_step(ipe_pipeline_t* p)
{
    ipe_row_t row;
    ipe_estimate_t estimate;
    while (ipe_pipeline_step(p, &row, &estimate) != IPE_NOT_READY) {}
}

static inline void motion_push_frame(ipe_pipeline_t* p, uint32_t can_id, int64_t t_ns, const void* data, size_t n_data,
                                     const uint8_t* tail, uint8_t n)
{
    ipe_frame_t f = {.t_ns = t_ns, .can_id = can_id, .flags = IPE_FRAME_FD, .length = n};
    memcpy(f.data, data, n_data);
    memcpy(f.data + n_data, tail, n - n_data);
    (void)ipe_pipeline_push_frame(p, &f);
}

/// A sample as read at t_ns, the number-th of the IMU.
static inline void motion_push(ipe_pipeline_t* p, const ideal_t* x, unsigned number, int64_t t_ns)
{
    uint8_t imu[LENGTH_IMU_A] = {0};
    const uint8_t none[LENGTH_FORCE] = {0};
    const uint16_t counter = (uint16_t)number;
    const uint32_t time_us = (uint32_t)(number * (MOTION_STEP_NS / 1000));
    memcpy(imu, x->acc, sizeof x->acc);
    memcpy(imu + 24, x->gyro, sizeof x->gyro);
    memcpy(imu + 48, &counter, sizeof counter);
    memcpy(imu + 52, &time_us, sizeof time_us);
    motion_push_frame(p, ID_IMU_A, t_ns, imu, sizeof imu, none, LENGTH_IMU_A);
    motion_push_frame(p, ID_IMU_B, t_ns, x->q, sizeof x->q, none, LENGTH_IMU_B);
    motion_push_frame(p, ID_FORCE, t_ns, x->f, sizeof x->f, none, LENGTH_FORCE);
    (void)ipe_pipeline_push_position(p, t_ns, x->position);
}

/// A pipeline that has seen the first n samples.
static inline void motion_warm(ipe_pipeline_t* p, unsigned n)
{
    char message[256];
    REQUIRE(ipe_pipeline_init(p, &motion_config, message, sizeof message) == IPE_OK);
    for (unsigned k = 0; k < n; ++k) {
        motion_push(p, &motion[k], k, MOTION_BEGIN_NS + k * MOTION_STEP_NS);
        motion_step(p);
    }
}

#endif
