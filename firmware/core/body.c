// SPDX-License-Identifier: Apache-2.0
#include "body.h"

#include "smallmat.h"

#include <string.h>

/// |a|^2 E - a a^T as xx yy zz yz xz xy, for unit mass at a.
static void point_inertia(const double a[3], double J[6])
{
    J[0] = a[1] * a[1] + a[2] * a[2];
    J[1] = a[0] * a[0] + a[2] * a[2];
    J[2] = a[0] * a[0] + a[1] * a[1];
    J[3] = -a[1] * a[2];
    J[4] = -a[0] * a[2];
    J[5] = -a[0] * a[1];
}

/// Derivative of point_inertia with respect to a.
static void point_inertia_slope(const double a[3], double S[6][3])
{
    const double x = a[0], y = a[1], z = a[2];
    const double slope[6][3] = {
        {0.0, 2.0 * y, 2.0 * z}, {2.0 * x, 0.0, 2.0 * z}, {2.0 * x, 2.0 * y, 0.0},
        {0.0, -z, -y},           {-z, 0.0, -x},           {-y, -x, 0.0},
    };
    memcpy(S, slope, sizeof slope);
}

void ipe_body_shift_matrix(const double d[3], double T[IPE_NP][IPE_NP])
{
    double J[6], S[6][3];
    point_inertia(d, J);
    point_inertia_slope(d, S);
    memset(T, 0, sizeof(double) * IPE_NP * IPE_NP);
    for (int i = 0; i < IPE_NP; ++i) { T[i][i] = 1.0; }
    for (int i = 0; i < 3; ++i) { T[1 + i][0] = d[i]; }
    for (int i = 0; i < 6; ++i) {
        T[4 + i][0] = J[i];
        for (int j = 0; j < 3; ++j) { T[4 + i][1 + j] = S[i][j]; }
    }
}

static void transform(const double T[IPE_NP][IPE_NP], const double P[IPE_NP][IPE_NP], double out[IPE_NP][IPE_NP])
{
    double TP[IPE_NP][IPE_NP];
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) {
            TP[i][j] = 0.0;
            for (int k = 0; k < IPE_NP; ++k) { TP[i][j] += T[i][k] * P[k][j]; }
        }
    }
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = 0.0;
            for (int k = 0; k < IPE_NP; ++k) { sum += TP[i][k] * T[j][k]; }
            out[i][j] = out[j][i] = sum;
        }
    }
}

void ipe_body_shift(const double d[3], double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    double T[IPE_NP][IPE_NP], before[IPE_NP];
    ipe_body_shift_matrix(d, T);
    memcpy(before, theta, sizeof before);
    for (int i = 0; i < IPE_NP; ++i) {
        theta[i] = 0.0;
        for (int j = 0; j < IPE_NP; ++j) { theta[i] += T[i][j] * before[j]; }
    }
    if (P != NULL) { transform(T, P, P); }
}

void ipe_body_jacobian(const double theta[IPE_NP], double G[IPE_NP][IPE_NP])
{
    const double m = theta[0];
    const double* h = theta + 1;
    double J[6], S[6][3];
    point_inertia(h, J);
    point_inertia_slope(h, S);
    memset(G, 0, sizeof(double) * IPE_NP * IPE_NP);
    for (int i = 0; i < IPE_NP; ++i) { G[i][i] = 1.0; }
    for (int i = 0; i < 3; ++i) {
        G[1 + i][0] = -h[i] / (m * m);
        G[1 + i][1 + i] = 1.0 / m;
    }
    for (int i = 0; i < 6; ++i) {
        G[4 + i][0] = J[i] / (m * m);
        for (int j = 0; j < 3; ++j) { G[4 + i][1 + j] = -S[i][j] / m; }
    }
}

ipe_status_t ipe_body_from_theta(const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], ipe_body_t* body)
{
    const double m = theta[0];
    if (!(m > 0.0)) { return IPE_ERR_RANGE; }
    double J[6], G[IPE_NP][IPE_NP], covariance[IPE_NP][IPE_NP];
    point_inertia(theta + 1, J);
    body->mass = m;
    for (int i = 0; i < 3; ++i) { body->cog[i] = theta[1 + i] / m; }
    for (int i = 0; i < 6; ++i) { body->inertia_cog[i] = theta[4 + i] - J[i] / m; }
    ipe_body_jacobian(theta, G);
    transform(G, P, covariance);
    body->mass_std = sqrt(covariance[0][0]);
    for (int i = 0; i < 3; ++i) { body->cog_std[i] = sqrt(covariance[1 + i][1 + i]); }
    for (int i = 0; i < 6; ++i) { body->inertia_cog_std[i] = sqrt(covariance[4 + i][4 + i]); }
    return IPE_OK;
}
