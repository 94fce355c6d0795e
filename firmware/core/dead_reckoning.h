// SPDX-License-Identifier: Apache-2.0
/// Where the tracked point is while its tracker is silent: carried on by attitude and specific force of the IMU.
///
///   x = p + R l     p'' = R (s + b) - g z      R: I to W, calibrated; l: from the IMU to the tracked point, I axes
/// p, v = p' and b, what accelerometer and attitude have wrong together, are estimated by a Kalman filter as long as the
/// tracker is seen, and run on without it. Attitude error and accelerometer bias turn with the IMU, so b is kept in its
/// axes; noise is alike in all directions, so all three share one 3 x 3 covariance. b starts from std_attitude,
/// std_imu_alignment and std_acc_bias and is driven by std_attitude_wander; what std_world_yaw and std_imu_alignment do to
/// an acceleration is noise of p''.
/// Source: firmware/DESIGN.md, "Tracker gaps". 0.4 KB of state, about 60 ns per IMU sample, one thread.
#ifndef IPE_DEAD_RECKONING_H
#define IPE_DEAD_RECKONING_H

#include "config.h"
#include "types.h"

typedef struct {
    double gravity;                    ///< m/s2
    int64_t max_carry_ns;              ///< without the tracker, as configured
    int64_t max_gap_ns;                ///< without the IMU
    double correction[3][3];           ///< I axes: R(q) correction is calibrated
    double yaw[2];                     ///< cos, sin of world_yaw
    double lever[3];                   ///< I axes, m
    double acc_bias[3];                ///< I axes, m/s2
    double std_turn;                   ///< rad: share of an acceleration that may point elsewhere
    double bias_variance, bias_drive;  ///< of b at the start, (m/s2)2, and per s

    bool is_known;                     ///< p, v, b, P hold
    int64_t t_ns;                      ///< of the last IMU sample
    int64_t seen_ns;                   ///< of the last one that the tracker saw
    uint64_t learnt_from;              ///< tracker sample, each is learnt from once
    double R[3][3];                    ///< at t_ns
    double a[3];                       ///< R s - g z at t_ns, b left out
    double p[3], v[3], b[3];
    double P[6];                       ///< of one axis: pp pv pb vv vb bb
} ipe_dead_reckoning_t;

void ipe_dead_reckoning_init(ipe_dead_reckoning_t* c, const ipe_config_t* config);

/// Go on to the next IMU sample: t_ns host time, acc [3] and unit quaternion q [4] as in ipe_row_t. Samples further apart
/// than max_age of the IMU, or back in time, forget the position.
void ipe_dead_reckoning_advance(ipe_dead_reckoning_t* c, int64_t t_ns, const double acc[3], const double q[4]);

/// The tracker saw the point at x [3], W, m, at the instant of the last IMU sample; sample: number of the tracker's sample
/// at or before it. A position that contradicts what is known starts it anew.
void ipe_dead_reckoning_learn(ipe_dead_reckoning_t* c, uint64_t sample, const double x[3]);

/// The tracked point x [3], W, m, at the instant of the last IMU sample. False, x as it was: the tracker has been silent for
/// longer than max_carry, or too little was seen of it before to tell x to 30 mm.
bool ipe_dead_reckoning_read(const ipe_dead_reckoning_t* c, double x[3]);

#endif
