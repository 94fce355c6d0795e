// SPDX-License-Identifier: Apache-2.0
/// Status codes and the values that pass between stages.
///
/// Frames of reference: W world (z up), P platform, I IMU; S sensor axes as measured. SI units throughout; host time is
/// int64 nanoseconds of the host's real-time clock, always an argument. No stage reads a clock, allocates or does I/O.
#ifndef IPE_TYPES_H
#define IPE_TYPES_H

#include "dims.h"

#include <stdbool.h>
#include <stdint.h>

/// Host times lie in 0 .. this, so that their differences and small sums fit. Seconds; the year 2255.
#define IPE_SECONDS_MAX 8999999999
#define IPE_TIME_MAX_NS (IPE_SECONDS_MAX * INT64_C(1000000000))

/// < 0: refused, state unchanged but for a counter.  0: done.  > 0: normal, but nothing to pass on yet.
typedef enum {
    IPE_OK = 0,
    IPE_NOT_READY = 1,       ///< more input needed
    IPE_IGNORED = 2,         ///< not for this stage: an ID that no signal is bound to
    IPE_UNFINISHED = 3,      ///< a part is done: call again for the rest
    IPE_ERR_CONFIG = -1,     ///< a setting out of range
    IPE_ERR_LENGTH = -2,     ///< frame shorter or longer than its message
    IPE_ERR_NONFINITE = -3,  ///< NaN or Inf
    IPE_ERR_RANGE = -4,      ///< value outside its limits
    IPE_ERR_TIME = -5,       ///< time did not advance
    IPE_ERR_GEOMETRY = -6,   ///< a cable with no direction: platform point inside the pulley
} ipe_status_t;

/// Quantity that a CAN signal measures. Vectors are consecutive. The numbers are part of the compiled configuration.
typedef enum {
    IPE_Q_ACC_X = 0,           ///< specific force, I axes, m/s2 (3)
    IPE_Q_GYRO_X = 3,          ///< angular rate, I axes, rad/s (3)
    IPE_Q_QUAT_W = 6,          ///< unit quaternion w x y z, I to W (4)
    IPE_Q_ROLL = 10,           ///< roll, pitch, yaw, R = Rz(yaw) Ry(pitch) Rx(roll), I to W, rad (3)
    IPE_Q_POS_X = 13,          ///< tracked point, W, m (3)
    IPE_Q_F_1 = 16,            ///< cable forces, N (16)
    IPE_Q_IMU_COUNTER = 32,    ///< sample counter of the IMU's messages
    IPE_Q_FORCE_COUNTER = 33,  ///< sample counter of the force messages
    IPE_Q_POS_COUNTER = 34,
    IPE_Q_IMU_TIME = 35,       ///< device time of the IMU's sample, s, wraps
    IPE_Q_FORCE_TIME = 36,
    IPE_Q_POS_TIME = 37,
    IPE_Q_COUNT = 38,
} ipe_quantity_t;

/// Where quantities come from. Each has its own rate, clock and delay.
typedef enum { IPE_IMU = 0, IPE_FORCE = 1, IPE_POSITION = 2, IPE_SENSOR_COUNT = 3 } ipe_sensor_t;

/// A CAN frame as received.
typedef struct {
    int64_t t_ns;     ///< host stamp, CLOCK_REALTIME
    int64_t t_hw_ns;  ///< controller's own stamp, 0: none
    uint32_t can_id;  ///< SocketCAN layout: bit 31 extended, bit 30 remote, bit 29 error frame
    uint8_t bus;      ///< index in the order of the buses
    uint8_t flags;    ///< IPE_FRAME_*
    uint8_t length;   ///< bytes, 0..64
    uint8_t data[IPE_DATA_MAX];
} ipe_frame_t;

enum { IPE_FRAME_FD = 1, IPE_FRAME_BRS = 2, IPE_FRAME_ESI = 4 };
#define IPE_CAN_EFF 0x80000000U
#define IPE_CAN_RTR 0x40000000U
#define IPE_CAN_ERR 0x20000000U

/// All sensors at one instant of the IMU, as measured, before calibration.
typedef struct {
    int64_t t_ns;
    double acc[3];             ///< specific force, I axes, m/s2
    double gyro[3];            ///< I axes, rad/s
    double q[4];               ///< unit quaternion w x y z, I to W
    double position[3];        ///< tracked point, W, m
    double f[IPE_CABLES_MAX];  ///< N
    uint32_t unknown_force;    ///< bit i: cable i's sensor has failed, f[i] is no measurement
    bool has_force;            ///< f holds
    bool has_position;         ///< position holds
    bool is_position_new;      ///< the tracker measured since the last row that has a position
} ipe_row_t;

/// The error of an attitude: d(error)/d(parameter) and one sigma of the rest, which is independent of the parameters.
/// Parameters: accelerometer bias 3 [m/s2, I axes], lever 3 [tracker target minus IMU position, m, P axes], position delay
/// 1 [s], yaw of the AHRS 1 [rad]; each is the true value minus the configured one.
typedef struct {
    double attitude[3][IPE_MOTION_NP];  ///< R_true = exp(attitude parameter) R, rad per unit, W axes
    double force_scale[3]
                      [IPE_MOTION_NP];  ///< s_true = (1 - force_scale parameter) s, each I axis, beside the bias itself
    double rate_scale[3][IPE_MOTION_NP];  ///< w_true = (1 - rate_scale parameter) w, each I axis
    double attitude_std[3];               ///< rad, W axes: the rest,
    double attitude_time[3];              ///< s: and its correlation time
} ipe_attitude_error_t;

/// Calibrated motion of the IMU point, P axes, and the pose of P.
typedef struct {
    double s[3];     ///< specific force at the IMU, P axes, m/s2
    double w[3];     ///< angular rate, P axes, rad/s
    double R[3][3];  ///< P to W
    double p[3];     ///< position of P in W, m
    double v[3];     ///< velocity of P in W, m/s
    ipe_attitude_error_t error;
} ipe_motion_t;

/// Force and moment of the cables on the platform at the IMU point, P axes: fx fy fz [N], tx ty tz [N m].
typedef struct {
    double y[IPE_NY];
    double f[IPE_CABLES_MAX];         ///< the tensions at the platform it was made from, calibrated, N
    double friction[IPE_CABLES_MAX];  ///< f sgn(cable travel), N: added to f by a friction of 1
    uint32_t unknown_force;           ///< as in the row
} ipe_wrench_t;

#endif
