// SPDX-License-Identifier: Apache-2.0
#include "unknown_force.h"

#include "smallmat.h"
#include "wrench.h"

#include <string.h>

#define SIGMA 1e4  // of the force, over its sigma by the equations: chosen so that 1e-8 of that is left

#define KERNEL_VARIANCE (1.0 / 48.0)  // of the cubic B-spline, of its length squared

/// The wrench matrix at the mean pose, moved on by `time` [s].
static ipe_status_t matrix_at(const ipe_config_t* config, const ipe_average_t* average, double time,
                              double W[IPE_NY][IPE_CABLES_MAX])
{
    const double bend = 0.5 * KERNEL_VARIANCE * average->length * average->length;  // mean attitude: the middle's, and
    double p[3], angle[3], turn[3][3], R[3][3], sag[IPE_NY];                        // this times alpha
    vec3_axpy(average->p, time, average->velocity, p);
    for (int i = 0; i < 3; ++i) { angle[i] = bend * average->alpha[i] + time * average->w[i]; }
    mat3_exp(angle, turn);
    mat3_mul(average->R, (const double (*)[3])turn, R);
    return ipe_wrench_matrix(config, p, (const double (*)[3])R, config->imu_position, W, sag);
}

ipe_status_t ipe_unknown_force_columns(const ipe_config_t* config, const ipe_average_t* average, ipe_unknown_force_t* u)
{
    const double deviation = sqrt(KERNEL_VARIANCE) * average->length;
    double before[IPE_NY][IPE_CABLES_MAX], after[IPE_NY][IPE_CABLES_MAX];
    u->n = 0;
    if (average->unknown_force == 0) { return IPE_OK; }
    ipe_status_t status = matrix_at(config, average, -deviation, before);
    if (status == IPE_OK) { status = matrix_at(config, average, deviation, after); }
    if (status != IPE_OK) { return status; }
    for (int j = 0; j < config->n_cables; ++j) {
        if (!(average->unknown_force >> (unsigned)j & 1U)) { continue; }
        if (u->n == IPE_UNKNOWN_FORCE_MAX) { return IPE_ERR_RANGE; }
        const double scale = 0.5 / (1.0 + config->force_gain[j]);
        for (int i = 0; i < IPE_NY; ++i) {
            u->mean[u->n][i] = scale * (after[i][j] + before[i][j]);
            u->turned[u->n][i] = scale * deviation * (after[i][j] - before[i][j]);
        }
        u->cable[u->n++] = j;
    }
    return IPE_OK;
}

/// Take out one cable's force; w: its column.
static bool take_out(const double w[IPE_NY], const double S[IPE_NY][IPE_NY], double innovation[IPE_NY],
                     double y[IPE_NY], double* excess, double L[IPE_NY][IPE_NY])
{
    double A[IPE_NY][IPE_NY], B[IPE_NY][IPE_NY], along[IPE_NY], information = 0.0, along_w = 0.0;
    if (!cholesky_of_sum(&S[0][0], &L[0][0], IPE_NY, &A[0][0])) { return false; }
    cholesky_solve(&A[0][0], IPE_NY, w, along);
    for (int i = 0; i < IPE_NY; ++i) {
        information += w[i] * along[i];
        along_w += innovation[i] * along[i];
    }
    if (!(information > 0.0)) { return false; }
    const double variance = SIGMA * SIGMA / information;
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NY; ++j) { B[i][j] = variance * w[i] * w[j]; }
    }
    if (!cholesky_of_sum(&B[0][0], &L[0][0], IPE_NY, &A[0][0])) { return false; }
    memcpy(L, A, sizeof A);
    *excess = along_w / information;
    for (int i = 0; i < IPE_NY; ++i) {
        innovation[i] -= *excess * w[i];
        y[i] -= *excess * w[i];
    }
    return true;
}

ipe_status_t ipe_unknown_force_take_out(const ipe_unknown_force_t* u, const double S[IPE_NY][IPE_NY],
                                        double innovation[IPE_NY], double y[IPE_NY],
                                        double excess[IPE_UNKNOWN_FORCE_MAX], double L[IPE_NY][IPE_NY])
{
    for (int k = 0; k < u->n; ++k) {
        if (!take_out(u->mean[k], S, innovation, y, &excess[k], L)) { return IPE_ERR_NONFINITE; }
    }
    return IPE_OK;
}
