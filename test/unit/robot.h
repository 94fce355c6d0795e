// SPDX-License-Identifier: Apache-2.0
/// What several unit tests start from: the CoGiRo robot, a body that moves, and random numbers that repeat.
#ifndef TEST_ROBOT_H
#define TEST_ROBOT_H

#include "config.h"
#include "regressor.h"
#include "smallmat.h"
#include "wrench.h"

#include <stdio.h>
#include <string.h>
#include <unity.h>

#define PI 3.14159265358979323846

/// actual < limit, or both in the failure's message; NaN fails.
#define ASSERT_BELOW(limit, actual) assert_below((limit), (actual), __LINE__)

static inline void assert_below(double limit, double actual, int line)
{
    char message[80];
    (void)snprintf(message, sizeof message, "expected below %g, was %g", limit, actual);
    UNITY_TEST_ASSERT(actual < limit, line, message);
}

/// Uniform on 0 .. 1 by xorshift64*; the state is the seed, not 0.
static inline double uniform(uint64_t* state)
{
    *state ^= *state >> 12;
    *state ^= *state << 25;
    *state ^= *state >> 27;
    return (double)((*state * 2685821657736338717ULL) >> 11) * 0x1p-53;
}

static inline double between(uint64_t* state, double low, double high)
{
    return low + (high - low) * uniform(state);
}

static inline double normal(uint64_t* state)
{
    return sqrt(-2.0 * log(1.0 - uniform(state))) * cos(2.0 * PI * uniform(state));
}

static inline void fill_normal(uint64_t* state, double* v, int n)
{
    for (int i = 0; i < n; ++i) { v[i] = normal(state); }
}

/// A float64 signal of an FD frame, little endian, at the byte.
static inline ipe_signal_t wide_signal(int quantity, uint32_t can_id, int frame_length, int byte)
{
    return (ipe_signal_t){.quantity = quantity,
                          .can_id = can_id,
                          .frame_length = frame_length,
                          .start = 8 * byte,
                          .length = 64,
                          .kind = IPE_FLOAT64,
                          .scale = 1.0,
                          .mux_start = -1};
}

enum { ID_IMU_A = 0x10, ID_IMU_B = 0x11, ID_FORCE = 0x20, LENGTH_IMU_A = 64, LENGTH_IMU_B = 32, LENGTH_FORCE = 64 };

/// IMU_A: acc, gyro, counter (u16), time (u32, us). IMU_B: quaternion. FORCE: 8 forces.
static inline void bind_wide_signals(ipe_config_t* k)
{
    int n = 0;
    for (int i = 0; i < 6; ++i) { k->signal[n++] = wide_signal(IPE_Q_ACC_X + i, ID_IMU_A, LENGTH_IMU_A, 8 * i); }
    k->signal[n] = wide_signal(IPE_Q_IMU_COUNTER, ID_IMU_A, LENGTH_IMU_A, 48);
    k->signal[n].length = 16;
    k->signal[n++].kind = IPE_INTEGER;
    k->signal[n] = wide_signal(IPE_Q_IMU_TIME, ID_IMU_A, LENGTH_IMU_A, 52);
    k->signal[n].length = 32;
    k->signal[n].scale = 1e-6;
    k->signal[n++].kind = IPE_INTEGER;
    for (int i = 0; i < 4; ++i) { k->signal[n++] = wide_signal(IPE_Q_QUAT_W + i, ID_IMU_B, LENGTH_IMU_B, 8 * i); }
    for (int i = 0; i < 8; ++i) { k->signal[n++] = wide_signal(IPE_Q_F_1 + i, ID_FORCE, LENGTH_FORCE, 8 * i); }
    k->n_signals = n;
}

/// CoGiRo: ICRA 2017 paper, Table II, 8 cables over swivelling pulleys; IMU beside P, FD frames with wide signals.
static inline ipe_config_t cogiro(void)
{
    static const double anchor[8][3] = {
        {-7.1967, -5.4398, 5.3928}, {-7.4786, -5.1544, 5.4009}, {-7.4083, 5.1914, 5.3987}, {-7.1197, 5.4726, 5.4106},
        {7.2243, 5.3689, 5.4080},   {7.5056, 5.0789, 5.4182},   {7.4288, -5.2613, 5.3878}, {7.1435, -5.5416, 5.3975},
    };
    static const double attachment[8][3] = {
        {0.5032, -0.4928, 0.0}, {-0.5097, 0.3508, 0.9976}, {-0.5032, -0.27, 0.0},    {0.4961, 0.3561, 0.9996},
        {-0.5032, 0.4928, 0.0}, {0.4998, -0.3404, 0.9991}, {0.5021, 0.275, -0.0007}, {-0.5045, -0.3463, 0.9977},
    };
    ipe_config_t k;
    memset(&k, 0, sizeof k);
    strcpy(k.name, "CoGiRo");
    k.gravity = 9.81;
    k.n_cables = 8;
    for (int i = 0; i < 8; ++i) {
        memcpy(k.cable[i].anchor, anchor[i], sizeof anchor[i]);
        memcpy(k.cable[i].attachment, attachment[i], sizeof attachment[i]);
        k.cable[i].pulley_radius = 0.05;
        k.cable[i].swivel_axis[2] = 1.0;
        k.cable[i].weight_per_length = 0.628;
        k.cable[i].tension_min = 100.0;
        k.cable[i].tension_max = 5000.0;
    }
    k.imu_position[0] = 0.1, k.imu_position[1] = -0.2, k.imu_position[2] = 0.3;
    k.imu_orientation[0] = 1.0;
    k.attitude_source = IPE_ATTITUDE_QUATERNION;
    k.position_source = IPE_POSITION_TRACKER;
    bind_wide_signals(&k);
    k.max_wait = 0.05;
    for (int i = 0; i < IPE_SENSOR_COUNT; ++i) { k.max_age[i] = 0.05; }
    k.window_length = 0.4;
    for (int i = 0; i < IPE_NY; ++i) { k.residual_covariance[i][i] = i < 3 ? 4.0 : 1.0; }
    k.prior_theta[0] = 100.0;
    for (int i = 0; i < 3; ++i) { k.prior_theta[4 + i] = 50.0; }
    for (int i = 0; i < IPE_NP; ++i) {
        const double std = i == 0 ? 100.0 : i < 4 ? 100.0 : i < 7 ? 100.0 : 50.0;
        k.prior_covariance[i][i] = std * std;
    }
    k.estimate_rate = 50.0;
    return k;
}

/// Nominal body of Table III as theta = m, h, J about P.
static inline void nominal_theta(double theta[IPE_NP])
{
    static const double J_C[6] = {94.955, 88.859, 31.635, 4.136, -0.085, -0.393};
    const double m = 161.058, c[3] = {-0.001, -0.077, -0.118};
    theta[0] = m;
    for (int i = 0; i < 3; ++i) { theta[1 + i] = m * c[i]; }
    theta[4] = J_C[0] + m * (c[1] * c[1] + c[2] * c[2]);
    theta[5] = J_C[1] + m * (c[0] * c[0] + c[2] * c[2]);
    theta[6] = J_C[2] + m * (c[0] * c[0] + c[1] * c[1]);
    theta[7] = J_C[3] - m * c[1] * c[2];
    theta[8] = J_C[4] - m * c[0] * c[2];
    theta[9] = J_C[5] - m * c[0] * c[1];
}

/// A smooth motion: sums of sines in position and roll, pitch, yaw. Returns the pose at t.
static inline void pose_at(double t, double p[3], double rpy[3])
{
    p[0] = 0.5 * sin(1.9 * t), p[1] = 0.4 * sin(2.3 * t + 1.0), p[2] = 2.0 + 0.3 * sin(2.9 * t + 2.0);
    rpy[0] = 0.35 * sin(3.1 * t), rpy[1] = 0.3 * sin(2.7 * t + 0.5), rpy[2] = 0.4 * sin(3.7 * t + 1.5);
}

/// Body rate of the motion by central differences of the attitude, error about 1e-12.
static inline void rate_at(double t, double w[3])
{
    static const double weight[4] = {1.0 / 280.0, -4.0 / 105.0, 0.2, -0.8};
    const double h = 4e-3;
    double p[3], rpy[3], d[3] = {0.0, 0.0, 0.0};
    for (int k = 0; k < 4; ++k) {
        const double step = (4 - k) * h;
        double before[3], after[3];
        pose_at(t - step, p, before);
        pose_at(t + step, p, after);
        for (int i = 0; i < 3; ++i) { d[i] += weight[k] * (before[i] - after[i]) / h; }
    }
    pose_at(t, p, rpy);
    w[0] = d[0] - d[2] * sin(rpy[1]);
    w[1] = d[1] * cos(rpy[0]) + d[2] * cos(rpy[1]) * sin(rpy[0]);
    w[2] = -d[1] * sin(rpy[0]) + d[2] * cos(rpy[1]) * cos(rpy[0]);
}

/// Everything an ideal sensor set reads at t, and the cable forces that drive a body theta (about P) along the motion.
typedef struct {
    double acc[3], gyro[3], q[4], position[3], f[8];
} ideal_t;

/// x of the symmetric positive definite A x = y; A is spoiled.
static inline void solve_6(double A[6][6], double y[6])
{
    (void)cholesky(&A[0][0], 6);
    for (int i = 0; i < 6; ++i) {
        for (int j = 0; j < i; ++j) { y[i] -= A[i][j] * y[j]; }
        y[i] /= A[i][i];
    }
    for (int i = 5; i >= 0; --i) {
        for (int j = i + 1; j < 6; ++j) { y[i] -= A[j][i] * y[j]; }
        y[i] /= A[i][i];
    }
}

/// Least forces f [8] that make the body theta (about P) move with s, w, alpha at P in the pose p, R.
static inline void tensions(const ipe_config_t* k, const double p[3], double R[3][3], const double s[3],
                            const double w[3], const double alpha[3], const double theta[IPE_NP], double f[8])
{
    const double zero[3] = {0.0, 0.0, 0.0};
    double ww[6], Y[IPE_NY][IPE_NP], W[IPE_NY][IPE_CABLES_MAX], sag[IPE_NY], y[IPE_NY], A[6][6];
    ipe_rate_products(w, ww);
    ipe_regressor(s, ww, alpha, Y);
    (void)ipe_wrench_matrix(k, p, (const double (*)[3])R, zero, W, sag);
    for (int i = 0; i < IPE_NY; ++i) {
        y[i] = -sag[i];
        for (int j = 0; j < IPE_NP; ++j) { y[i] += Y[i][j] * theta[j]; }
        for (int j = 0; j < IPE_NY; ++j) {
            A[i][j] = 0.0;
            for (int c = 0; c < 8; ++c) { A[i][j] += W[i][c] * W[j][c]; }
        }
    }
    solve_6(A, y);
    for (int c = 0; c < 8; ++c) {
        f[c] = 0.0;
        for (int i = 0; i < 6; ++i) { f[c] += W[i][c] * y[i]; }
    }
}

/// The motion at t.
static inline ideal_t ideal_at(const ipe_config_t* k, double t, const double theta[IPE_NP])
{
    ideal_t out;
    const double h = 1e-3;
    double rpy[3], R[3][3], a[3], s[3], w[3], w_before[3], w_after[3], alpha[3], p[5][3], unused[3];
    for (int i = 0; i < 5; ++i) { pose_at(t + (i - 2) * 4.0 * h, p[i], unused); }
    for (int i = 0; i < 3; ++i) {
        a[i] = (-p[0][i] + 16.0 * p[1][i] - 30.0 * p[2][i] + 16.0 * p[3][i] - p[4][i]) / (12.0 * 16.0 * h * h);
    }
    a[2] += k->gravity;
    pose_at(t, out.position, rpy);
    quat_from_rpy(rpy, out.q);
    mat3_from_quat(out.q, R);
    rate_at(t, w);
    rate_at(t - h, w_before);
    rate_at(t + h, w_after);
    for (int i = 0; i < 3; ++i) { alpha[i] = (w_after[i] - w_before[i]) / (2.0 * h); }
    mat3_tmul_vec(R, a, s);
    tensions(k, out.position, R, s, w, alpha, theta, out.f);
    double turn[3], inward[3], centripetal[3];  // specific force at the IMU
    vec3_cross(alpha, k->imu_position, turn);
    vec3_cross(w, k->imu_position, inward);
    vec3_cross(w, inward, centripetal);
    for (int i = 0; i < 3; ++i) { out.acc[i] = s[i] + turn[i] + centripetal[i]; }
    memcpy(out.gyro, w, sizeof w);
    return out;
}

/// The same robot at rest in the pose of the motion at t.
static inline ideal_t rest_at(const ipe_config_t* k, double t, const double theta[IPE_NP])
{
    ideal_t out;
    const double up[3] = {0.0, 0.0, k->gravity}, zero[3] = {0.0, 0.0, 0.0};
    double rpy[3], R[3][3];
    pose_at(t, out.position, rpy);
    quat_from_rpy(rpy, out.q);
    mat3_from_quat(out.q, R);
    mat3_tmul_vec(R, up, out.acc);
    memset(out.gyro, 0, sizeof out.gyro);
    tensions(k, out.position, R, out.acc, zero, zero, theta, out.f);
    return out;
}

#endif
