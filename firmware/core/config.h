// SPDX-License-Identifier: Apache-2.0
/// The robot, its sensors and the estimator's settings: one plain struct, checked once, then read-only.
///
/// Filled from the compiled configuration (lcm_types/robot_config_t.lcm, field for field); the meaning and unit of a
/// field is stated there and here alike. 1 to 16 cables. One config may serve any number of pipelines and threads.
#ifndef IPE_CONFIG_H
#define IPE_CONFIG_H

#include "types.h"

#include <stddef.h>

/// s, correlation time of std_attitude_wander. A third of it, or three times it, changes no error by a tenth (simulated
/// CoGiRo, firmware/DESIGN.md, "States").
#define IPE_WANDER_TIME 20.0

typedef struct {
    double anchor[3];          ///< pulley entry point or point anchor, W, m
    double attachment[3];      ///< P, m
    double pulley_radius;      ///< to the cable's centre line, m; 0: point anchor
    double swivel_axis[3];     ///< unit, W: cable travel direction at the anchor, winch to pulley
    double weight_per_length;  ///< N/m
    double tension_min;        ///< N
    double tension_max;        ///< N
    int32_t force_at;          ///< ipe_force_at_t
} ipe_cable_t;

/// Where a cable's force sensor sits: at its platform's end, or behind the pulley at the winch.
typedef enum { IPE_FORCE_AT_PLATFORM = 0, IPE_FORCE_AT_WINCH = 1 } ipe_force_at_t;

typedef enum { IPE_INTEGER = 0, IPE_FLOAT32 = 1, IPE_FLOAT64 = 2 } ipe_signal_kind_t;

/// One CAN signal bound to one quantity: value [SI] = raw * scale + offset.
typedef struct {
    int32_t quantity;      ///< ipe_quantity_t
    int32_t bus;           ///< 0..7
    uint32_t can_id;       ///< with IPE_CAN_EFF for 29 bits
    int32_t frame_length;  ///< bytes
    int32_t start;         ///< DBC start bit: LSB for Intel, MSB for Motorola
    int32_t length;        ///< bits, 1..64
    bool big_endian, mux_big_endian;
    bool is_signed;
    int32_t kind;             ///< ipe_signal_kind_t
    double scale, offset;
    double minimum, maximum;  ///< SI; equal: no limits
    int32_t mux_start;        ///< -1: not multiplexed
    int32_t mux_length;
    int64_t mux_value;
} ipe_signal_t;

#define IPE_MAX_WAIT 10.0  // s, largest max_wait

typedef enum { IPE_ATTITUDE_QUATERNION = 1, IPE_ATTITUDE_RPY = 2 } ipe_attitude_source_t;
/// Whose attitude is used: the AHRS's, or the motion stage's own of gyro, accelerometer and tracked position.
typedef enum { IPE_ATTITUDE_AHRS = 0, IPE_ATTITUDE_FUSED = 1 } ipe_attitude_estimate_t;
typedef enum { IPE_POSITION_TRACKER = 0, IPE_POSITION_FIXED = 1, IPE_POSITION_CAN = 2 } ipe_position_source_t;

typedef struct {
    char name[64];
    double gravity;    ///< m/s2, along -z of W
    int32_t n_cables;  ///< 1..16
    ipe_cable_t cable[IPE_CABLES_MAX];

    double imu_position[3];     ///< P, m
    double imu_orientation[4];  ///< unit quaternion, I to P
    double tracker_target[3];   ///< P, m
    double sample_rate;         ///< Hz of the IMU, 0: measured

    int32_t attitude_source;    ///< ipe_attitude_source_t
    int32_t attitude_estimate;  ///< ipe_attitude_estimate_t; fused needs a measured position
    int32_t position_source;    ///< ipe_position_source_t
    double fixed_position[3];   ///< of the tracked point, W, m

    int32_t n_signals;
    ipe_signal_t signal[IPE_SIGNALS_MAX];
    double bus_bitrate[IPE_BUSES_MAX];       ///< bit/s, 0: unknown
    double bus_data_bitrate[IPE_BUSES_MAX];  ///< bit/s of an FD frame's data phase, 0: does not switch

    double max_wait;                         ///< s a row waits for the slowest sensor
    double max_age[IPE_SENSOR_COUNT];        ///< s between samples that interpolation may bridge
    double max_carry;                     ///< s that attitude and IMU carry the position through a gap; 0: not at all
    double delay[IPE_SENSOR_COUNT];       ///< s from the measured instant to its stamp
    double delay_attitude;                ///< s the attitude lies behind the gyro of its sample

    double acc_bias[3], gyro_bias[3];     ///< I axes, m/s2, rad/s
    double attitude_bias[3];              ///< rad, P axes: true = measured exp(bias)
    double world_yaw;                     ///< rad: true = Rz(yaw) measured
    double force_offset[IPE_CABLES_MAX];  ///< N
    double force_gain[IPE_CABLES_MAX];    ///< measured = (1 + gain) true + offset

    double std_acc_bias, std_gyro_bias, std_attitude, std_world_yaw, std_imu_alignment, std_imu_position;
    double std_force_offset, std_force_gain, std_force_delay, std_position_delay, std_geometry, std_attitude_wander;
    double std_tracker_target, std_attitude_delay, std_friction, std_force_offset_drift, std_acc_scale, std_gyro_scale;
    double std_external_force, std_external_stiffness;  ///< N, N/m, each axis of W; 0: there is none

    double external_attachment[3];                      ///< P, m: where a hose or energy chain pulls
    double external_reference[3];                       ///< W, m: the attachment's place where its spring adds no force

    double window_length;                               ///< s
    double memory;                                      ///< s of excited time after which data count 1/e; 0: for ever
    double residual_covariance[IPE_NY][IPE_NY];         ///< of one window at the IMU, P axes
    double prior_theta[IPE_NP];                         ///< about P
    double prior_covariance[IPE_NP][IPE_NP];
    double estimate_rate;                               ///< Hz
} ipe_config_t;

/// Check every field's range, that axes and quaternions are unit and covariances positive definite.
///
///   message  out  one line "field = value: allowed range" on failure, else untouched; size bytes, always terminated
///
/// IPE_OK or IPE_ERR_CONFIG. The only function of the core that formats text. No state.
ipe_status_t ipe_config_check(const ipe_config_t* config, char* message, size_t size);

/// Value after which an integer signal bound to this quantity starts again at 0, in the quantity's unit; 0: never, or unbound.
double ipe_config_wrap(const ipe_config_t* config, int quantity);

#endif
