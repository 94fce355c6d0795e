// SPDX-License-Identifier: Apache-2.0
#include "rls.h"

#include "smallmat.h"

#include <string.h>

#define INFORMED 0.99  // of the prior in a state's information: chosen so that taking it out costs two digits
#define LARGEST 1e15   // standard deviations: no sensor reads more, and its square is finite in double

static int column(int j)
{
    return j * (j - 1) / 2;
}

/// U D U^T of the prior's theta block. False if it is not positive definite.
static bool factorise(ipe_rls_t* s, const double P[IPE_NP][IPE_NP])
{
    for (int j = IPE_NP - 1; j >= 0; --j) {
        for (int i = j; i >= 0; --i) {
            double rest = P[i][j];
            for (int k = j + 1; k < IPE_NP; ++k) { rest -= s->U[column(k) + i] * s->D[k] * s->U[column(k) + j]; }
            if (i == j) {
                s->D[j] = rest;
            } else {
                s->U[column(j) + i] = rest / s->D[j];
            }
        }
        if (!(s->D[j] > 0.0)) { return false; }
    }
    return true;
}

ipe_status_t ipe_rls_init(ipe_rls_t* s, const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], int n_xi,
                          const double* xi_std)
{
    memset(s, 0, sizeof *s);
    if (n_xi < 0 || n_xi > IPE_NX_MAX - IPE_NP) { return IPE_ERR_CONFIG; }
    s->n = IPE_NP + n_xi;
    memcpy(s->x, theta, sizeof(double) * IPE_NP);
    for (int i = 0; i < n_xi; ++i) {
        s->D[IPE_NP + i] = xi_std[i] * xi_std[i];
        if (!(s->D[IPE_NP + i] > 0.0)) { return IPE_ERR_CONFIG; }
    }
    return factorise(s, P) ? IPE_OK : IPE_ERR_CONFIG;
}

/// f = U^T h, h being 0 before first and from end on.
static double factor(const ipe_rls_t* s, const double* h, int first, int end, int j)
{
    const double* U = &s->U[column(j)];
    double f = h[j];
    for (int i = first; i < (j < end ? j : end); ++i) { f += U[i] * h[i]; }
    return f;
}

void ipe_rls_innovation(const ipe_rls_t* s, const double* H, const double y[IPE_NY], double innovation[IPE_NY],
                        double S[IPE_NY][IPE_NY])
{
    memset(S, 0, sizeof(double) * IPE_NY * IPE_NY);
    memcpy(innovation, y, sizeof(double) * IPE_NY);
    for (int j = 0; j < s->n; ++j) {
        double f[IPE_NY];
        for (int i = 0; i < IPE_NY; ++i) {
            f[i] = factor(s, H + i * s->n, 0, s->n, j);
            innovation[i] -= H[i * s->n + j] * s->x[j];
            for (int k = 0; k <= i; ++k) { S[i][k] += f[i] * s->D[j] * f[k]; }
        }
    }
    for (int i = 0; i < IPE_NY; ++i) {
        for (int k = 0; k < i; ++k) { S[k][i] = S[i][k]; }
    }
}

/// One scalar row h x = y of this variance. Returns the squared normalised innovation. Where h begins with zeros, so do f, g
/// and b: columns before its first entry stay as they are.
static double update_row(ipe_rls_t* s, const double* h, double y, double variance)
{
    double b[IPE_NX_MAX] = {0.0};
    double a = variance;
    double innovation = y;
    int first = 0, end = s->n;
    while (first < s->n && h[first] == 0.0) { ++first; }
    while (end > first && h[end - 1] == 0.0) { --end; }
    for (int j = first; j < s->n; ++j) {
        double* U = &s->U[column(j)];
        const double f = factor(s, h, first, end, j);
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
    for (int j = 0; j < s->n; ++j) { s->x[j] += b[j] * step; }
    return innovation * step;
}

/// H = L^-1 H and z = L^-1 y, row by row.
static void whiten(double* H, int n, const double y[IPE_NY], const double L[IPE_NY][IPE_NY], double z[IPE_NY])
{
    for (int i = 0; i < IPE_NY; ++i) {
        double* row = H + i * n;
        z[i] = y[i];
        for (int k = 0; k < i; ++k) {
            for (int j = 0; j < n; ++j) { row[j] -= L[i][k] * H[k * n + j]; }
            z[i] -= L[i][k] * z[k];
        }
        const double scale = 1.0 / L[i][i];
        for (int j = 0; j < n; ++j) { row[j] *= scale; }
        z[i] *= scale;
    }
}

static bool all_plausible(const double* v, int n)
{
    for (int i = 0; i < n; ++i) {
        if (!(fabs(v[i]) <= LARGEST)) { return false; }
    }
    return true;
}

ipe_status_t ipe_rls_whiten(ipe_rls_t* s, double* H, const double y[IPE_NY], const double L[IPE_NY][IPE_NY],
                            double z[IPE_NY])
{
    whiten(H, s->n, y, L, z);
    if (!all_plausible(H, IPE_NY * s->n) || !all_plausible(z, IPE_NY)) {
        ++s->n_nonfinite;
        return IPE_ERR_NONFINITE;
    }
    return IPE_OK;
}

double ipe_rls_update_whitened(ipe_rls_t* s, const double* H, const double z[IPE_NY])
{
    double nis = 0.0;
    for (int i = 0; i < IPE_NY; ++i) { nis += update_row(s, H + i * s->n, z[i], 1.0); }
    ++s->n_updates;
    return nis;
}

ipe_status_t ipe_rls_update(ipe_rls_t* s, double* H, const double y[IPE_NY], const double L[IPE_NY][IPE_NY],
                            double* nis)
{
    double z[IPE_NY];
    const ipe_status_t status = ipe_rls_whiten(s, H, y, L, z);
    if (status == IPE_OK) { *nis = ipe_rls_update_whitened(s, H, z); }
    return status;
}

void ipe_rls_update_row(ipe_rls_t* s, const double* h, double y)
{
    (void)update_row(s, h, y, 1.0);
}

void ipe_rls_widen_prior(ipe_rls_t* s, int i, double std, double wider)
{
    double h[IPE_NX_MAX] = {0.0};
    const double removed = 1.0 / (std * std) - 1.0 / (wider * wider);
    h[i] = 1.0;
    if (!(removed * ipe_rls_covariance_of(s, i, i) < INFORMED)) {
        ipe_rls_loosen(s, i, wider * wider);
        return;
    }
    (void)update_row(s, h, 0.0, -1.0 / removed);
}

void ipe_rls_forget(ipe_rls_t* s, double lambda)
{
    for (int j = 0; j < s->n; ++j) { s->D[j] /= lambda; }
}

void ipe_rls_loosen(ipe_rls_t* s, int i, double variance)
{
    double a[IPE_NX_MAX] = {0.0};
    double c = variance;
    a[i] = 1.0;
    for (int j = i; j >= 0; --j) {
        double* U = &s->U[column(j)];
        const double D = s->D[j] + c * a[j] * a[j];
        const double b = c * a[j] / D;
        for (int k = 0; k < j; ++k) {
            a[k] -= a[j] * U[k];
            U[k] += b * a[k];
        }
        c *= s->D[j] / D;
        s->D[j] = D;
    }
}

void ipe_rls_fade(ipe_rls_t* s, int i, double factor)
{
    double* U = &s->U[column(i)];
    s->x[i] *= factor;
    s->D[i] *= factor * factor;
    for (int k = 0; k < i; ++k) { U[k] /= factor; }
    for (int j = i + 1; j < s->n; ++j) { s->U[column(j) + i] *= factor; }
}

double ipe_rls_covariance_of(const ipe_rls_t* s, int i, int k)
{
    double sum = 0.0;
    for (int j = i > k ? i : k; j < s->n; ++j) {
        const double u_i = i == j ? 1.0 : s->U[column(j) + i];
        const double u_k = k == j ? 1.0 : s->U[column(j) + k];
        sum += u_i * s->D[j] * u_k;
    }
    return sum;
}

void ipe_rls_covariance(const ipe_rls_t* s, int rows, double* P)
{
    for (int i = 0; i < rows; ++i) {
        for (int k = 0; k <= i; ++k) { P[i * rows + k] = P[k * rows + i] = ipe_rls_covariance_of(s, i, k); }
    }
}

double ipe_rls_std(const ipe_rls_t* s, int i)
{
    return sqrt(ipe_rls_covariance_of(s, i, i));
}

bool ipe_rls_invariants_hold(const ipe_rls_t* s)
{
    for (int j = 0; j < s->n; ++j) {
        if (!(s->D[j] > 0.0)) { return false; }
    }
    const size_t n = (size_t)s->n;
    return all_finite(s->x, n) && all_finite(s->D, n) && all_finite(s->U, n * (n - 1) / 2);
}
