// SPDX-License-Identifier: Apache-2.0
/// Aligned rows -> motion of the platform: position, velocity and attitude by an error-state Kalman filter.
///
/// An AHRS takes the accelerometer for the vertical, so its tilt follows the platform's acceleration. Here the tracker
/// measures that acceleration, and the accelerometer minus it gives the tilt. State and error (true = estimate + error):
///   p, v   6   IMU point in W                 m, m/s
///   phi    3   R_true = exp(phi) R, W axes    rad        R: I to W
///   b      3   gyro bias, I axes              rad/s      w = (gyro - gyro_bias - b)(1 - kappa)
///   beta   3   scales of the accelerometer, I axes       s = (acc - acc_bias)(1 - beta)
///   kappa  3   scales of the gyro, I axes
///   p' = v    v' = R s - g z    R' = R [w]x    x = p + R l      l: from the IMU to the tracked point, I axes
/// The mean advances with every row, by the parabola through the readings of three rows (Adams and Moulton, order 3). With
/// straight lines between rows a platform that swings at 1 Hz, sampled at 25 Hz, would seem to accelerate 0.5 % less than it
/// does. A rate w whose axis turns adds dt^2/12 w x w_next to the turn of a step (coning: Savage, Strapdown Analytics, 2000,
/// ch. 7). The covariance advances once per epoch of 40 ms, with the mean of the positions since then as its measurement, and
/// the yaw of the AHRS as a weak one: its error is a bias and a slow wander. The tilt of the AHRS serves as the start only.
/// beta takes the accelerometer bias along the vertical with it.
/// The effect of the parameters of ipe_attitude_error_t on the state is carried exactly, by the filter's own F, K and H
/// (Schmidt 1966, consider parameters): S <- F S + G, S <- (I - K H) S - K H_c. So an estimator that has them as states
/// takes no information twice.
/// With [attitude] estimate "ahrs", or without a tracker, R, s and w are the calibrated sensors' own; p and v still come
/// from here, and bridge the tracker's gaps up to max_carry.
/// Source: firmware/DESIGN.md, "Motion". 13 KB of state; 0.2 us per row at 1 kHz, an epoch included. One thread.
#ifndef IPE_MOTION_H
#define IPE_MOTION_H

#include "config.h"
#include "noise_density.h"
#include "types.h"

enum { IPE_MOTION_STATES = 18 };

/// The states' order, and the parameters'.
enum {
    IPE_MOTION_P = 0,
    IPE_MOTION_V = 3,
    IPE_MOTION_PHI = 6,
    IPE_MOTION_BIAS = 9,
    IPE_MOTION_BETA = 12,
    IPE_MOTION_KAPPA = 15
};
enum { IPE_MOTION_BY_ACC_BIAS = 0, IPE_MOTION_BY_LEVER = 3, IPE_MOTION_BY_DELAY = 6, IPE_MOTION_BY_YAW = 7 };

/// Covariance and sensitivity of the state error.
typedef struct {
    double P[IPE_MOTION_STATES][IPE_MOTION_STATES];
    double S[IPE_MOTION_STATES][IPE_MOTION_NP];
} ipe_motion_spread_t;

/// How the last epoch went, for a smoother: errors at its begin -> predicted -> corrected.
typedef struct {
    double Phi[IPE_MOTION_STATES][IPE_MOTION_STATES];
    ipe_motion_spread_t predicted;
    double correction[IPE_MOTION_STATES];  ///< added to the state at its end
} ipe_motion_epoch_t;

typedef struct {
    // settings
    bool is_fused;                              ///< R, s, w are the filter's; else the sensors'
    bool is_fixed;                              ///< position is fixed: no filter
    double gravity;                             ///< m/s2
    double R_PI[3][3];                          ///< I axes to P axes
    double ahrs_to_imu[3][3];                   ///< I axes: R(q) ahrs_to_imu is calibrated
    double ahrs_to_platform[3][3];
    double yaw[3][3];                           ///< Rz(world_yaw)
    double delay_attitude;                      ///< s that the AHRS lies behind the gyro of its sample
    double acc_bias[3], gyro_bias[3];           ///< I axes
    double lever[3];                            ///< l, I axes, m
    double imu_position[3], tracker_target[3];  ///< P, m
    double std_tilt, std_yaw, std_gyro_bias, std_acc_scale, std_gyro_scale;  ///< at the start
    int64_t max_gap_ns;                                                      ///< between rows
    int64_t max_carry_ns;                                                    ///< without a position

    // state
    bool is_running;                           ///< all of it holds
    int64_t t_ns;                              ///< of the last row
    int64_t seen_ns;                           ///< of the last row with a position
    int64_t epoch_ns;                          ///< begin of the epoch
    int64_t settled_ns;                        ///< of the last row with tilt and scale known, or of the first
    double p[3], v[3], R[3][3], b[3], beta[3], kappa[3];
    ipe_motion_spread_t spread;                ///< at the epoch's begin
    double position_variance;                  ///< of one tracker sample, learnt from innovations, m2
    int n_learnt;                              ///< epochs that taught it
    double acc[3], gyro[3], q[4], s[3], a[3];  ///< last row's, s calibrated, a = R s - g z
    double step;                               ///< s to it from the row before, 0: none
    double a_slope[3], gyro_slope[3];          ///< over that step, m/s3, rad/s2
    ipe_noise_density_t noise;                 ///< of acc and gyro
    int block_length;                          ///< rows of an epoch, 0: no row followed another yet
    double acc_density, gyro_density;          ///< (m/s2)^2/Hz, (rad/s)^2/Hz
    double decay[3];                           ///< 1/s, of the attitude's error by measurements, W axes
    double gate2;                              ///< m2: a position further off contradicts

    // sums over the epoch
    double sum_R[3][3], sum_turn[3][3], sum_force[3][3];                ///< integrals of R, R diag(w), R diag(s)
    double sum_e[3], sum_R_position[3][3], sum_velocity[3], sum_since;  ///< over its positions
    int n_positions;
    int n_refused_row;  ///< positions refused one after another, none further from the one before than a platform moves
    double refused[3];  ///< the last of them, W, m
    int64_t refused_at_ns;         ///< and its row
    int64_t refused_ns;            ///< the first of them
    ipe_motion_epoch_t* epoch;     ///< where a smoother reads them; NULL: none does
    ipe_attitude_error_t error;    ///< as of the last epoch

    bool is_epoch_new;             ///< the last row ended an epoch: epoch and spread are new
    double std_wander;             ///< rad, of the sensors' own attitude

    uint64_t n_rows;               ///< rows handed on, with attitude, velocity and position
    uint64_t n_carried;            ///< of these: position carried on through a gap of the tracker
    uint64_t n_no_position;        ///< rows with forces refused: no position, and none carried
    uint64_t n_unsettled;          ///< rows refused: tilt not known yet
    uint64_t n_positions_refused;  ///< positions refused: they contradict the motion
    uint64_t n_starts;             ///< starts of position and velocity: the first, and after gaps and jumps
    uint64_t n_epochs;
} ipe_motion_stage_t;

/// Is the attitude of a robot with this configuration estimated here ([attitude] estimate = "fused", positions tracked)?
bool ipe_motion_is_fused(const ipe_config_t* config);

/// The error that a settled attitude has at R (P to W): for motions that are only planned.
void ipe_motion_nominal_error(const ipe_config_t* config, const double R[3][3], ipe_attitude_error_t* error);

/// Start from a checked configuration; no epoch is kept. A smoother sets m->epoch afterwards.
void ipe_motion_init(ipe_motion_stage_t* m, const ipe_config_t* config);

/// The tracked point at the last row, W, m, by the filter.
void ipe_motion_target(const ipe_motion_stage_t* m, double x[3]);

/// From the next row on use this gyro bias [3], I axes, rad/s.
void ipe_motion_set_gyro_bias(ipe_motion_stage_t* m, const double bias[3]);

/// Take one row: t_ns, acc, gyro, q, and position if it has one.
///
/// IPE_OK           motion is written
/// IPE_NOT_READY    too early: tilt or scale not known well enough yet, counted; motion is written (a smoother uses it)
/// IPE_IGNORED      no position and none carried so far, counted if the row has forces; motion not to be used
/// IPE_ERR_TIME     t_ns not after the row before by less than a second: refused, nothing changed
ipe_status_t ipe_motion_push(ipe_motion_stage_t* m, const ipe_row_t* row, ipe_motion_t* motion);

#endif
