// SPDX-License-Identifier: Apache-2.0
#include "dead_reckoning.h"

#include "smallmat.h"

#include <string.h>

#define TRACKER_STD 2e-3  // m, of one sample: between the simulated trackers, 1 and 3 mm
#define START_STD 2.0     // m/s, velocity when first seen: chosen over what cable robots reach
#define ACC_DENSITY 5e-3  // m/s2/rtHz, chosen: accelerometer, vibration and what steps of the sampling leave
#define TURN_TIME 0.5     // s that an acceleration lasts: chosen as the period of a brisk motion
#define SIGMAS 6.0        // of a position, and
#define JUMP 0.05         // m: chosen so that only a position further off starts the filter anew
#define STD_MAX 0.03      // m, chosen: of a position that rows are made from

enum { PP, PV, PB, VV, VB, BB };

static double square(double x)
{
    return x * x;
}

void ipe_dead_reckoning_init(ipe_dead_reckoning_t* c, const ipe_config_t* config)
{
    memset(c, 0, sizeof *c);
    c->gravity = config->gravity;
    c->max_carry_ns = (int64_t)llround(1e9 * config->max_carry);
    c->max_gap_ns = (int64_t)llround(1e9 * config->max_age[IPE_IMU]);
    double R_PI[3][3], bias[3][3], turned[3][3], lever[3];
    mat3_from_quat(config->imu_orientation, R_PI);
    mat3_exp(config->attitude_bias, bias);
    mat3_mul(bias, R_PI, turned);
    for (int j = 0; j < 3; ++j) {
        const double column[3] = {turned[0][j], turned[1][j], turned[2][j]};
        double out[3];
        mat3_tmul_vec(R_PI, column, out);
        for (int i = 0; i < 3; ++i) { c->correction[i][j] = out[i]; }
    }
    vec3_axpy(config->tracker_target, -1.0, config->imu_position, lever);
    mat3_tmul_vec(R_PI, lever, c->lever);
    c->yaw[0] = cos(config->world_yaw), c->yaw[1] = sin(config->world_yaw);
    memcpy(c->acc_bias, config->acc_bias, sizeof c->acc_bias);
    const double turn = square(config->std_imu_alignment);
    c->std_turn = sqrt(turn + square(config->std_world_yaw));
    c->bias_variance = square(config->std_acc_bias) + square(c->gravity) * (turn + square(config->std_attitude));
    c->bias_drive = 2.0 * square(c->gravity * config->std_attitude_wander) / IPE_WANDER_TIME;
}

static void rotation(const ipe_dead_reckoning_t* c, const double q[4], double R[3][3])
{
    double R_WI[3][3];
    mat3_from_quat(q, R_WI);
    mat3_mul(R_WI, c->correction, R);
    for (int j = 0; j < 3; ++j) {
        const double x = R[0][j], y = R[1][j];
        R[0][j] = c->yaw[0] * x - c->yaw[1] * y;
        R[1][j] = c->yaw[1] * x + c->yaw[0] * y;
    }
}

/// p, v over dt with the mean acceleration a [3]; P of one axis with it.
static void predict(ipe_dead_reckoning_t* c, double dt, const double a[3])
{
    double* P = c->P;
    for (int i = 0; i < 3; ++i) {
        c->p[i] += dt * (c->v[i] + 0.5 * dt * a[i]);
        c->v[i] += dt * a[i];
    }
    const double h = 0.5 * dt * dt;
    const double pb = P[PB] + dt * P[VB] + h * P[BB], vb = P[VB] + dt * P[BB];
    const double pv = P[PV] + dt * P[VV] + h * P[VB] + dt * pb;
    P[PP] += 2.0 * dt * P[PV] + dt * dt * P[VV] + h * (P[PB] + dt * P[VB] + pb);
    P[VV] += dt * (P[VB] + vb) + dt * (square(ACC_DENSITY) + TURN_TIME * square(c->std_turn) * vec3_dot(a, a));
    P[BB] += dt * c->bias_drive;
    P[PV] = pv, P[PB] = pb, P[VB] = vb;
}

void ipe_dead_reckoning_advance(ipe_dead_reckoning_t* c, int64_t t_ns, const double acc[3], const double q[4])
{
    double R[3][3], s[3], a[3], biases[3], mean[3];
    rotation(c, q, R);
    vec3_axpy(acc, -1.0, c->acc_bias, s);
    mat3_mul_vec(R, s, a);
    a[2] -= c->gravity;
    const int64_t gap_ns = t_ns - c->t_ns;
    c->is_known = c->is_known && gap_ns > 0 && gap_ns <= c->max_gap_ns;
    if (c->is_known) {
        mat3_mul_vec(R, c->b, biases);
        for (int i = 0; i < 3; ++i) { mean[i] = 0.5 * (c->a[i] + a[i]) + biases[i]; }
        predict(c, 1e-9 * (double)gap_ns, mean);
    }
    c->t_ns = t_ns;
    memcpy(c->R, R, sizeof c->R);
    memcpy(c->a, a, sizeof c->a);
}

static void start(ipe_dead_reckoning_t* c, const double p[3])
{
    c->is_known = true;
    memcpy(c->p, p, sizeof c->p);
    memset(c->v, 0, sizeof c->v);
    memset(c->b, 0, sizeof c->b);
    memset(c->P, 0, sizeof c->P);
    c->P[PP] = square(TRACKER_STD), c->P[VV] = square(START_STD), c->P[BB] = c->bias_variance;
}

void ipe_dead_reckoning_learn(ipe_dead_reckoning_t* c, uint64_t sample, const double x[3])
{
    double arm[3], p[3], e[3], e_i[3];
    const bool is_new = !c->is_known || sample != c->learnt_from;
    c->seen_ns = c->t_ns;
    c->learnt_from = sample;
    if (!is_new) { return; }
    mat3_mul_vec(c->R, c->lever, arm);
    vec3_axpy(x, -1.0, arm, p);
    vec3_axpy(p, -1.0, c->p, e);
    double* P = c->P;
    const double S = P[PP] + square(TRACKER_STD);
    if (!c->is_known || vec3_dot(e, e) > square(SIGMAS) * S + square(JUMP)) {
        start(c, p);
        return;
    }
    const double k[3] = {P[PP] / S, P[PV] / S, P[PB] / S};
    mat3_tmul_vec(c->R, e, e_i);
    vec3_axpy(c->p, k[0], e, c->p);
    vec3_axpy(c->v, k[1], e, c->v);
    vec3_axpy(c->b, k[2], e_i, c->b);
    P[VV] -= k[1] * P[PV], P[VB] -= k[1] * P[PB], P[BB] -= k[2] * P[PB];
    P[PP] *= 1.0 - k[0], P[PV] *= 1.0 - k[0], P[PB] *= 1.0 - k[0];
}

bool ipe_dead_reckoning_read(const ipe_dead_reckoning_t* c, double x[3])
{
    if (!c->is_known || c->t_ns - c->seen_ns > c->max_carry_ns || c->P[PP] > square(STD_MAX)) { return false; }
    double arm[3];
    mat3_mul_vec(c->R, c->lever, arm);
    vec3_axpy(c->p, 1.0, arm, x);
    return true;
}
