// SPDX-License-Identifier: Apache-2.0
#include "wrench.h"

#include "smallmat.h"

#include <string.h>

#define REST_SPEED 0.015  // m/s, below which friction fades with the speed: chosen as the error of the speeds
#define REACH 2e-3        // m of travel over which friction turns: chosen as measured on steel cables on pulleys
#define REACH_TURN \
    0.08  // rad: of a small pulley, which turns further within REACH; chosen so that 25 mm of radius make REACH
#define LONGEST_GAP 0.5  // s between rows over which friction is carried on

void ipe_wrench_init(ipe_wrench_stage_t* w, const ipe_config_t* config)
{
    memset(w, 0, sizeof *w);
    w->config = config;
    w->rest_speed = REST_SPEED;
}

/// s since the last row; 0 at a start.
static double elapsed(ipe_wrench_stage_t* w, int64_t t_ns)
{
    const double dt = 1e-9 * (double)(t_ns - w->t_ns);
    const bool is_new = w->t_ns == 0 || dt < 0.0 || dt > LONGEST_GAP;
    w->t_ns = t_ns;
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

/// m of travel over which the friction of a cable turns.
static double friction_reach(const ipe_cable_t* cable)
{
    const double turned = REACH_TURN * cable->pulley_radius;
    return turned > 0.0 && turned < REACH ? turned : REACH;
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
        const double square = speed * speed, moving = square / (square + w->rest_speed * w->rest_speed);
        const double travel = fabs(speed) * dt * moving;
        w->friction[i] +=
            travel / (travel + friction_reach(&k->cable[i])) * ((speed > 0.0 ? 1.0 : -1.0) - w->friction[i]);
        wrench->friction[i] = wrench->f[i] * w->friction[i];
    }
}

static void count_limits(ipe_wrench_stage_t* w, const double f[IPE_CABLES_MAX], uint32_t unknown)
{
    bool is_slack = false, is_overloaded = false;
    for (int i = 0; i < w->config->n_cables; ++i) {
        if (unknown >> (unsigned)i & 1U) { continue; }
        is_slack |= f[i] < w->config->cable[i].tension_min;
        is_overloaded |= f[i] > w->config->cable[i].tension_max;
    }
    w->n_slack += is_slack;
    w->n_overload += is_overloaded;
}

ipe_status_t ipe_wrench_from_row(ipe_wrench_stage_t* w, const ipe_row_t* row, const ipe_motion_t* motion,
                                 ipe_wrench_t* wrench)
{
    const ipe_config_t* k = w->config;
    double W[IPE_NY][IPE_CABLES_MAX];
    double* f = wrench->f;
    if (ipe_wrench_matrix(k, motion->p, motion->R, k->imu_position, W, wrench->y) != IPE_OK) {
        ++w->n_geometry;
        return IPE_ERR_GEOMETRY;
    }
    for (int i = 0; i < k->n_cables; ++i) {
        const bool is_held = w->n_rows > 0 && (row->unknown_force >> (unsigned)i & 1U);
        f[i] = is_held ? w->f[i] : (row->f[i] - k->force_offset[i]) / (1.0 + k->force_gain[i]);
        for (int j = 0; j < IPE_NY; ++j) { wrench->y[j] += W[j][i] * f[i]; }
    }
    memcpy(w->f, f, sizeof(double) * (size_t)k->n_cables);
    friction_of(w, elapsed(w, row->t_ns), motion, (const double (*)[IPE_CABLES_MAX])W, wrench);
    count_limits(w, f, row->unknown_force);
    wrench->unknown_force = row->unknown_force;
    ++w->n_rows;
    return IPE_OK;
}
