// SPDX-License-Identifier: Apache-2.0
#include "cable.h"

#include "smallmat.h"

#include <string.h>

#define TWO_PI 6.283185307179586
#define QUARTER_TURN (0.25 * TWO_PI)

static ipe_status_t point_line(const ipe_cable_t* cable, const double d[3], ipe_cable_line_t* line)
{
    const double length = vec3_norm(d);
    if (!(length > 1e-9)) { return IPE_ERR_GEOMETRY; }
    for (int i = 0; i < 3; ++i) { line->u[i] = -d[i] / length; }
    memcpy(line->leave, cable->anchor, sizeof line->leave);
    line->free = length;
    line->wrap = 0.0;
    line->length = length;
    return IPE_OK;
}

ipe_status_t ipe_cable_line(const ipe_cable_t* cable, const double B[3], ipe_cable_line_t* line)
{
    double d[3];
    vec3_axpy(B, -1.0, cable->anchor, d);
    const double r = cable->pulley_radius;
    if (r == 0.0) { return point_line(cable, d, line); }

    const double* k = cable->swivel_axis;
    const double d_k = vec3_dot(d, k);
    double e[3];
    vec3_axpy(d, -d_k, k, e);
    const double d_e = vec3_norm(e);
    const double L2 = vec3_dot(d, d) - 2.0 * r * d_e;
    if (!(d_e > 1e-9) || !(L2 > 1e-12)) { return IPE_ERR_GEOMETRY; }
    for (int i = 0; i < 3; ++i) { e[i] /= d_e; }

    const double L = sqrt(L2), q = L2 + r * r;
    const double sin_b = (L * (d_e - r) + r * d_k) / q;
    const double cos_b = (L * d_k - r * (d_e - r)) / q;
    const double angle = atan2(sin_b, cos_b);
    for (int i = 0; i < 3; ++i) {
        line->leave[i] = cable->anchor[i] + r * ((1.0 - cos_b) * e[i] + sin_b * k[i]);
        line->u[i] = (line->leave[i] - B[i]) / L;
    }
    line->free = L;
    line->wrap = angle < 0.0 ? angle + TWO_PI : angle;
    line->length = r * line->wrap + L;
    return IPE_OK;
}

void ipe_cable_sag(const ipe_cable_t* cable, const ipe_cable_line_t* line, double force[3])
{
    const double half_weight = 0.5 * cable->weight_per_length * line->free;
    const double along = (cable->force_at == IPE_FORCE_AT_WINCH ? -half_weight : half_weight) * line->u[2];
    for (int i = 0; i < 3; ++i) { force[i] = along * line->u[i]; }
    force[2] -= half_weight;
}

double ipe_cable_friction_share(const ipe_cable_t* cable, const ipe_cable_line_t* line)
{
    const bool is_behind = cable->force_at == IPE_FORCE_AT_WINCH && cable->pulley_radius > 0.0;
    return is_behind ? line->wrap / QUARTER_TURN : 1.0;
}
