// SPDX-License-Identifier: Apache-2.0
#include "rls.h"

#include "smallmat.h"

#include <string.h>

static int column(int j)
{
    return j * (j - 1) / 2;
}

ipe_status_t ipe_rls_init(ipe_rls_t* s, const double x[IPE_NP], const double P[IPE_NP][IPE_NP])
{
    memset(s, 0, sizeof *s);
    memcpy(s->x, x, sizeof s->x);
    double A[IPE_NP][IPE_NP];
    memcpy(A, P, sizeof A);
    for (int j = IPE_NP - 1; j >= 0; --j) {
        s->D[j] = A[j][j];
        if (!(s->D[j] > 0.0)) { return IPE_ERR_CONFIG; }
        for (int i = 0; i < j; ++i) { s->U[column(j) + i] = A[i][j] / s->D[j]; }
        for (int i = 0; i < j; ++i) {
            for (int k = 0; k <= i; ++k) { A[k][i] -= s->U[column(j) + k] * s->D[j] * s->U[column(j) + i]; }
        }
    }
    return IPE_OK;
}

/// One scalar row h x = y of unit variance. Returns the squared normalised innovation.
static double update_row(ipe_rls_t* s, const double h[IPE_NP], double y)
{
    double b[IPE_NP];
    double a = 1.0;
    double innovation = y;
    for (int j = 0; j < IPE_NP; ++j) {
        double* U = &s->U[column(j)];
        double f = h[j];
        for (int i = 0; i < j; ++i) { f += U[i] * h[i]; }
        const double g = s->D[j] * f;
        const double a_before = a;
        a += f * g;
        s->D[j] *= a_before / a;
        const double lambda = -f / a_before;
        for (int i = 0; i < j; ++i) {
            const double old = U[i];
            U[i] = old + b[i] * lambda;
            b[i] += g * old;
        }
        b[j] = g;
        innovation -= h[j] * s->x[j];
    }
    const double step = innovation / a;
    for (int j = 0; j < IPE_NP; ++j) { s->x[j] += b[j] * step; }
    return innovation * step;
}

/// L^-1 [Y y] row by row.
static void whiten(const double Y[IPE_NY][IPE_NP], const double y[IPE_NY], const double L[IPE_NY][IPE_NY],
                   double H[IPE_NY][IPE_NP], double z[IPE_NY])
{
    for (int i = 0; i < IPE_NY; ++i) {
        memcpy(H[i], Y[i], sizeof H[i]);
        z[i] = y[i];
        for (int k = 0; k < i; ++k) {
            for (int j = 0; j < IPE_NP; ++j) { H[i][j] -= L[i][k] * H[k][j]; }
            z[i] -= L[i][k] * z[k];
        }
        const double scale = 1.0 / L[i][i];
        for (int j = 0; j < IPE_NP; ++j) { H[i][j] *= scale; }
        z[i] *= scale;
    }
}

ipe_status_t ipe_rls_update(ipe_rls_t* s, const double Y[IPE_NY][IPE_NP], const double y[IPE_NY],
                            const double L[IPE_NY][IPE_NY], double* nis)
{
    double H[IPE_NY][IPE_NP], z[IPE_NY];
    whiten(Y, y, L, H, z);
    if (!all_finite(&H[0][0], IPE_NY * IPE_NP) || !all_finite(z, IPE_NY)) {
        ++s->n_nonfinite;
        return IPE_ERR_NONFINITE;
    }
    *nis = 0.0;
    for (int i = 0; i < IPE_NY; ++i) { *nis += update_row(s, H[i], z[i]); }
    ++s->n_updates;
    return IPE_OK;
}

void ipe_rls_covariance(const ipe_rls_t* s, double P[IPE_NP][IPE_NP])
{
    for (int i = 0; i < IPE_NP; ++i) {
        for (int k = 0; k <= i; ++k) {
            double sum = 0.0;
            for (int j = i; j < IPE_NP; ++j) {
                const double u_i = i == j ? 1.0 : s->U[column(j) + i];
                const double u_k = k == j ? 1.0 : s->U[column(j) + k];
                sum += u_i * s->D[j] * u_k;
            }
            P[i][k] = P[k][i] = sum;
        }
    }
}

bool ipe_rls_invariants_hold(const ipe_rls_t* s)
{
    for (int j = 0; j < IPE_NP; ++j) {
        if (!(s->D[j] > 0.0)) { return false; }
    }
    return all_finite(s->x, IPE_NP) && all_finite(s->U, IPE_NU) && all_finite(s->D, IPE_NP);
}
