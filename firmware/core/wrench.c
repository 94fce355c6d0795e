// SPDX-License-Identifier: Apache-2.0
#include "wrench.h"

#include "smallmat.h"

#include <string.h>

void ipe_wrench_init(ipe_wrench_stage_t* w, const ipe_config_t* config)
{
    memset(w, 0, sizeof *w);
    w->config = config;
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
        f[i] = (row->f[i] - k->force_offset[i]) / (1.0 + k->force_gain[i]);
        for (int j = 0; j < IPE_NY; ++j) { wrench->y[j] += W[j][i] * f[i]; }
    }
    count_limits(w, f);
    ++w->n_rows;
    return IPE_OK;
}
