// SPDX-License-Identifier: Apache-2.0
/// The compiled configuration of the unit tests' robot, as inertiactl compile would write it. Fields that robot.h leaves at
/// zero stay zero.
#ifndef TEST_FUZZ_WIRE_H
#define TEST_FUZZ_WIRE_H

#include "config_file.h"
#include "robot.h"

#include "inertiad_lcm_robot_config_t.h"

enum { WIRE_HASH_BYTES = 8 };

static inline void wire_put(uint8_t* to, uint64_t value, int n)
{
    for (int i = n - 1; i >= 0; --i, value >>= 8) { to[i] = (uint8_t)value; }
}

static inline void wire_put_hash(uint8_t* bytes)
{
    wire_put(bytes, (uint64_t)__inertiad_lcm_robot_config_t_get_hash(), WIRE_HASH_BYTES);
}

/// CRC of a file of n bytes, into its last four.
static inline void wire_put_crc(uint8_t* bytes, size_t n)
{
    const size_t n_wire = n - IPE_CONFIG_CRC_BYTES;
    wire_put(bytes + n_wire, ipe_config_crc(bytes, n_wire), IPE_CONFIG_CRC_BYTES);
}

static inline void wire_cable(inertiad_lcm_cable_config_t* to, const ipe_cable_t* from)
{
    memcpy(to->anchor, from->anchor, sizeof to->anchor);
    memcpy(to->attachment, from->attachment, sizeof to->attachment);
    memcpy(to->swivel_axis, from->swivel_axis, sizeof to->swivel_axis);
    to->pulley_radius = from->pulley_radius;
    to->weight_per_length = from->weight_per_length;
    to->tension_min = from->tension_min;
    to->tension_max = from->tension_max;
}

static inline void wire_signal(inertiad_lcm_signal_config_t* to, const ipe_signal_t* from)
{
    to->quantity = from->quantity;
    to->can_id = (int32_t)from->can_id;
    to->frame_length = (int8_t)from->frame_length;
    to->start = (int16_t)from->start;
    to->length = (int8_t)from->length;
    to->kind = (int8_t)from->kind;
    to->scale = from->scale;
    to->mux_start = (int16_t)from->mux_start;
}

/// The whole file; its length.
static inline size_t wire_encode(const ipe_config_t* k, uint8_t file[IPE_CONFIG_FILE_MAX])
{
    static inertiad_lcm_robot_config_t wire;
    memset(&wire, 0, sizeof wire);
    memcpy(wire.name, k->name, sizeof wire.name);
    wire.gravity = k->gravity;
    wire.n_cables = k->n_cables;
    for (int i = 0; i < k->n_cables; ++i) { wire_cable(&wire.cable[i], &k->cable[i]); }
    memcpy(wire.imu_position, k->imu_position, sizeof wire.imu_position);
    memcpy(wire.imu_orientation, k->imu_orientation, sizeof wire.imu_orientation);
    wire.attitude_source = k->attitude_source;
    wire.position_source = k->position_source;
    wire.n_signals = k->n_signals;
    for (int i = 0; i < k->n_signals; ++i) { wire_signal(&wire.signal[i], &k->signal[i]); }
    wire.max_wait = k->max_wait;
    memcpy(wire.max_age, k->max_age, sizeof wire.max_age);
    wire.window_length = k->window_length;
    memcpy(wire.residual_covariance, k->residual_covariance, sizeof wire.residual_covariance);
    memcpy(wire.prior_theta, k->prior_theta, sizeof wire.prior_theta);
    memcpy(wire.prior_covariance, k->prior_covariance, sizeof wire.prior_covariance);
    wire.estimate_rate = k->estimate_rate;
    const size_t n =
        (size_t)inertiad_lcm_robot_config_t_encode(file, 0, IPE_CONFIG_FILE_MAX, &wire) + IPE_CONFIG_CRC_BYTES;
    wire_put_crc(file, n);
    return n;
}

#endif
