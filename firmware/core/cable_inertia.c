// SPDX-License-Identifier: Apache-2.0
#include "cable_inertia.h"

#include "cable.h"
#include "smallmat.h"

#include <string.h>

#define MOVED_SHARE (1.0 / 3.0)  // of the mass of a straight cable that turns about its other end

/// Acceleration of a body point, P axes.
static void acceleration_at(const ipe_config_t* config, const ipe_average_t* a, const double point[3], double out[3])
{
    const double* ww = a->ww;
    double arm[3], tangential[3];
    vec3_axpy(point, -1.0, config->imu_position, arm);
    vec3_cross(a->alpha, arm, tangential);
    const double centripetal[3] = {
        -(ww[1] + ww[2]) * arm[0] + ww[5] * arm[1] + ww[4] * arm[2],
        ww[5] * arm[0] - (ww[0] + ww[2]) * arm[1] + ww[3] * arm[2],
        ww[4] * arm[0] + ww[3] * arm[1] - (ww[0] + ww[1]) * arm[2],
    };
    for (int i = 0; i < 3; ++i) { out[i] = a->s[i] - config->gravity * a->R[2][i] + tangential[i] + centripetal[i]; }
}

/// Force of one cable's inertia on the platform, P axes.
static ipe_status_t inertia_force(const ipe_config_t* config, const ipe_average_t* a, const ipe_cable_t* cable,
                                  double force[3])
{
    double b[3], B[3], u[3], acceleration[3];
    ipe_cable_line_t line;
    mat3_mul_vec((const double (*)[3])a->R, cable->attachment, b);
    vec3_axpy(a->p, 1.0, b, B);
    if (ipe_cable_line(cable, B, &line) != IPE_OK) { return IPE_ERR_GEOMETRY; }
    mat3_tmul_vec((const double (*)[3])a->R, line.u, u);
    acceleration_at(config, a, cable->attachment, acceleration);
    const double mass = cable->weight_per_length * line.free / config->gravity;
    const double along = vec3_dot(u, acceleration);
    const double along_share = cable->force_at == IPE_FORCE_AT_WINCH ? 1.0 : 0.0;
    for (int i = 0; i < 3; ++i) {
        force[i] = -mass * (MOVED_SHARE * (acceleration[i] - along * u[i]) + along_share * along * u[i]);
    }
    return IPE_OK;
}

ipe_status_t ipe_cable_inertia_add(const ipe_config_t* config, ipe_average_t* average)
{
    double added[IPE_NY] = {0.0};
    if (config->gravity == 0.0) { return IPE_OK; }
    for (int i = 0; i < config->n_cables; ++i) {
        const ipe_cable_t* cable = &config->cable[i];
        double force[3], arm[3], moment[3];
        if (cable->weight_per_length == 0.0) { continue; }
        if (inertia_force(config, average, cable, force) != IPE_OK) { return IPE_ERR_GEOMETRY; }
        vec3_axpy(cable->attachment, -1.0, config->imu_position, arm);
        vec3_cross(arm, force, moment);
        for (int j = 0; j < 3; ++j) { added[j] += force[j], added[3 + j] += moment[j]; }
    }
    memcpy(average->cable_inertia, added, sizeof added);
    for (int j = 0; j < IPE_NY; ++j) { average->y[j] += added[j]; }
    return IPE_OK;
}
