// SPDX-License-Identifier: Apache-2.0
#include "wrench.h"

#include "smallmat.h"

#include <string.h>

#define REST_SPEED 0.015    // m/s, below which friction fades with the speed: chosen as the error of the speeds
#define OBSERVER_RATE 60.0  // rad/s: chosen so that a tilt of 10 mrad makes an error of 3 mm/s
#define REACH 2e-3          // m of travel over which friction turns: chosen as measured on steel cables on pulleys
#define OBSERVER_GAP 0.5    // s without a row after which it starts again

void ipe_wrench_init(ipe_wrench_stage_t* w, const ipe_config_t* config)
{
    memset(w, 0, sizeof *w);
    w->config = config;
    mat3_from_quat(config->imu_orientation, w->R_PI);
    const double yaw[3] = {0.0, 0.0, config->world_yaw};
    mat3_exp(yaw, w->yaw);
    double bias[3][3], R_IP[3][3];
    mat3_exp(config->attitude_bias, bias);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { R_IP[i][j] = w->R_PI[j][i]; }
    }
    mat3_mul(R_IP, bias, w->correction);
}

/// R = R exp(w time).
static void turn_on(const double w[3], double time, double R[3][3])
{
    const double angle[3] = {w[0] * time, w[1] * time, w[2] * time};
    double turn[3][3], before[3][3];
    mat3_exp(angle, turn);
    memcpy(before, R, sizeof before);
    mat3_mul((const double (*)[3])before, (const double (*)[3])turn, R);
}

static void motion_from_row(const ipe_wrench_stage_t* w, const ipe_row_t* row, ipe_motion_t* motion)
{
    const ipe_config_t* k = w->config;
    double R_WI[3][3], turned[3][3], acc[3], gyro[3], lever[3];
    mat3_from_quat(row->q, R_WI);
    mat3_mul(w->yaw, R_WI, turned);
    mat3_mul(turned, w->correction, motion->R);
    vec3_axpy(row->acc, -1.0, k->acc_bias, acc);
    vec3_axpy(row->gyro, -1.0, k->gyro_bias, gyro);
    mat3_mul_vec(w->R_PI, acc, motion->s);
    mat3_mul_vec(w->R_PI, gyro, motion->w);
    if (k->delay_attitude != 0.0) { turn_on(motion->w, k->delay_attitude, motion->R); }
    mat3_mul_vec(motion->R, k->tracker_target, lever);
    vec3_axpy(row->position, -1.0, lever, motion->p);
}

/// Velocity of P: an observer of the IMU point's place, driven by its acceleration, critically damped. Returns the time
/// since the last row, s, 0 at a start.
static double observe_velocity(ipe_wrench_stage_t* w, int64_t t_ns, ipe_motion_t* motion)
{
    const double* imu = w->config->imu_position;
    const double dt = 1e-9 * (double)(t_ns - w->observed.t_ns);
    const bool is_new = w->observed.t_ns == 0 || dt < 0.0 || dt > OBSERVER_GAP;
    double arm[3], acceleration[3], turned[3];
    mat3_mul_vec((const double (*)[3])motion->R, imu, arm);
    mat3_mul_vec((const double (*)[3])motion->R, motion->s, acceleration);
    acceleration[2] -= w->config->gravity;
    for (int i = 0; i < 3; ++i) {
        double* p = &w->observed.p[i];
        double* v = &w->observed.v[i];
        const double place = motion->p[i] + arm[i];
        if (is_new) { *p = place, *v = 0.0; }
        const double off = place - *p;
        *p += dt * (*v + 2.0 * OBSERVER_RATE * off) * (is_new ? 0.0 : 1.0);
        *v += dt * (acceleration[i] + OBSERVER_RATE * OBSERVER_RATE * off) * (is_new ? 0.0 : 1.0);
    }
    w->observed.t_ns = t_ns;
    vec3_cross(motion->w, imu, arm);
    mat3_mul_vec((const double (*)[3])motion->R, arm, turned);
    vec3_axpy(w->observed.v, -1.0, turned, motion->v);
    return is_new ? 0.0 : dt;
}

/// Wrench of a force in P axes at attachment, about point.
static void wrench_of(const double force[3], const double attachment[3], const double point[3], double wrench[IPE_NY])
{
    double arm[3];
    vec3_axpy(attachment, -1.0, point, arm);
    memcpy(wrench, force, 3 * sizeof(double));
    vec3_cross(arm, force, wrench + 3);
}

ipe_status_t ipe_wrench_matrix(const ipe_config_t* config, const double p[3], const double R[3][3],
                               const double point[3], double W[IPE_NY][IPE_CABLES_MAX], double sag[IPE_NY])
{
    memset(sag, 0, IPE_NY * sizeof(double));
    for (int i = 0; i < config->n_cables; ++i) {
        const ipe_cable_t* cable = &config->cable[i];
        double b[3], B[3], u[3], weight_w[3], weight[3], column[IPE_NY], sag_i[IPE_NY];
        ipe_cable_line_t line;
        mat3_mul_vec(R, cable->attachment, b);
        vec3_axpy(p, 1.0, b, B);
        if (ipe_cable_line(cable, B, &line) != IPE_OK) { return IPE_ERR_GEOMETRY; }
        ipe_cable_sag(cable, &line, weight_w);
        mat3_tmul_vec(R, line.u, u);
        mat3_tmul_vec(R, weight_w, weight);
        wrench_of(u, cable->attachment, point, column);
        wrench_of(weight, cable->attachment, point, sag_i);
        for (int j = 0; j < IPE_NY; ++j) {
            W[j][i] = column[j];
            sag[j] += sag_i[j];
        }
    }
    return IPE_OK;
}

/// Tensions with the sign of the cables' travel; the first three rows of W are the cables' directions.
static void friction_of(ipe_wrench_stage_t* w, double dt, const ipe_motion_t* motion,
                        const double W[IPE_NY][IPE_CABLES_MAX], ipe_wrench_t* wrench)
{
    const ipe_config_t* k = w->config;
    double v[3];
    mat3_tmul_vec((const double (*)[3])motion->R, motion->v, v);
    for (int i = 0; i < k->n_cables; ++i) {
        double turning[3];
        vec3_cross(motion->w, k->cable[i].attachment, turning);
        const double speed =
            -(W[0][i] * (v[0] + turning[0]) + W[1][i] * (v[1] + turning[1]) + W[2][i] * (v[2] + turning[2]));
        const double square = speed * speed, moving = square / (square + REST_SPEED * REST_SPEED);
        const double travel = fabs(speed) * dt * moving;
        w->friction[i] += travel / (travel + REACH) * ((speed > 0.0 ? 1.0 : -1.0) - w->friction[i]);
        wrench->friction[i] = wrench->f[i] * w->friction[i];
    }
}

static void count_limits(ipe_wrench_stage_t* w, const double f[IPE_CABLES_MAX])
{
    bool is_slack = false, is_overloaded = false;
    for (int i = 0; i < w->config->n_cables; ++i) {
        is_slack |= f[i] < w->config->cable[i].tension_min;
        is_overloaded |= f[i] > w->config->cable[i].tension_max;
    }
    w->n_slack += is_slack;
    w->n_overload += is_overloaded;
}

ipe_status_t ipe_wrench_from_row(ipe_wrench_stage_t* w, const ipe_row_t* row, ipe_motion_t* motion,
                                 ipe_wrench_t* wrench)
{
    const ipe_config_t* k = w->config;
    motion_from_row(w, row, motion);
    const double dt = observe_velocity(w, row->t_ns, motion);
    double W[IPE_NY][IPE_CABLES_MAX];
    double* f = wrench->f;
    if (ipe_wrench_matrix(k, motion->p, motion->R, k->imu_position, W, wrench->y) != IPE_OK) {
        ++w->n_geometry;
        return IPE_ERR_GEOMETRY;
    }
    for (int i = 0; i < k->n_cables; ++i) {
        f[i] = (row->f[i] - k->force_offset[i]) / (1.0 + k->force_gain[i]);
        for (int j = 0; j < IPE_NY; ++j) { wrench->y[j] += W[j][i] * f[i]; }
    }
    friction_of(w, dt, motion, (const double (*)[IPE_CABLES_MAX])W, wrench);
    count_limits(w, f);
    ++w->n_rows;
    return IPE_OK;
}
