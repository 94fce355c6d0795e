// SPDX-License-Identifier: Apache-2.0
#include "eiv_correction.h"

#include "regressor.h"
#include "smallmat.h"

#include <math.h>
#include <string.h>

#define NEGLIGIBLE 1e-9  // trace of the share of noise in all information: chosen so that rounding is not corrected
#define UNCERTAIN 0.1    // of C, one sigma: the accuracy of a density from 250 blocks (noise_density.h)

void ipe_eiv_correction_add(ipe_eiv_correction_t* a, const ipe_average_t* average, double level)
{
    for (int i = 0; i < 3; ++i) {
        a->sum[i] += (float)(average->s_variance[i] / level);
        a->sum[3 + i] += (float)(average->alpha_variance[i] / level);
    }
    a->n += (float)(1.0 / level);
}

void ipe_eiv_correction_forget(ipe_eiv_correction_t* a, double lambda)
{
    for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) { a->sum[i] *= (float)lambda; }
    a->n *= (float)lambda;
}

void ipe_eiv_correction_loosen(ipe_eiv_correction_t* a, double mass, double inertia)
{
    for (int i = 0; i < 3; ++i) {
        a->sum[i] *= (float)mass;
        a->sum[3 + i] *= (float)inertia;
    }
    a->n *= (float)fmax(mass, inertia);
}

/// Rows of C: sqrt(sum) L^-1 dY/dk of noise channel k.
static void noise_rows(int k, double sum, const double L[IPE_NY][IPE_NY], double rows[IPE_NY][IPE_NP])
{
    double unit[IPE_NOISE_DENSITY_CHANNELS] = {0.0};
    const double still[6] = {0.0};
    unit[k] = sqrt(sum);
    ipe_regressor(unit, still, unit + 3, rows);
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NP; ++j) {
            for (int l = 0; l < i; ++l) { rows[i][j] -= L[i][l] * rows[l][j]; }
            rows[i][j] /= L[i][i];
        }
    }
}

/// P += scale a b^T
static void add_outer(double P[IPE_NP][IPE_NP], double scale, const double a[IPE_NP], const double b[IPE_NP])
{
    if (scale == 0.0) { return; }
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) { P[i][j] += scale * a[i] * b[j]; }
    }
}

/// The share of a channel's rows that can be noise: theta makes of it residuals of as many windows of unit variance.
static double share_of_noise(const double rows[IPE_NY][IPE_NP], const double theta[IPE_NP], double n)
{
    double square = 0.0;
    for (int i = 0; i < IPE_NY; ++i) {
        double e = 0.0;
        for (int j = 0; j < IPE_NP; ++j) { e += rows[i][j] * theta[j]; }
        square += e * e;
    }
    return square > n ? n / square : 1.0;
}

void ipe_eiv_correction_information(const ipe_eiv_correction_t* a, const double L[IPE_NY][IPE_NY], double level,
                                    const double theta[IPE_NP], double C[IPE_NP][IPE_NP])
{
    double rows[IPE_NY][IPE_NP];
    for (int k = 0; k < IPE_NOISE_DENSITY_CHANNELS; ++k) {
        noise_rows(k, level * (double)a->sum[k], L, rows);
        const double share = share_of_noise((const double (*)[IPE_NP])rows, theta, level * (double)a->n);
        for (int row = 0; row < IPE_NY; ++row) { add_outer(C, share, rows[row], rows[row]); }
    }
}

/// S = F^T C F, F being the Cholesky factor of P: the share of noise in what the filter holds for information. Its trace.
static double noise_share(const double C[IPE_NP][IPE_NP], const double F[IPE_NP][IPE_NP], double S[IPE_NP][IPE_NP])
{
    double CF[IPE_NP][IPE_NP] = {{0.0}}, trace = 0.0;
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) {
            for (int k = j; k < IPE_NP; ++k) { CF[i][j] += C[i][k] * F[k][j]; }
        }
    }
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) {
            S[i][j] = 0.0;
            for (int k = i; k < IPE_NP; ++k) { S[i][j] += F[k][i] * CF[k][j]; }
        }
        trace += S[i][i];
    }
    return trace;
}

/// v = F^-T u, so that v^T theta has variance 1, and d = F u, what a change of it by 1 does to theta.
static void direction(const double F[IPE_NP][IPE_NP], const double U[IPE_NP][IPE_NP], int column, double v[IPE_NP],
                      double d[IPE_NP])
{
    for (int i = IPE_NP - 1; i >= 0; --i) {
        v[i] = U[i][column];
        for (int j = i + 1; j < IPE_NP; ++j) { v[i] -= F[j][i] * v[j]; }
        v[i] /= F[i][i];
        d[i] = 0.0;
        for (int j = 0; j <= i; ++j) { d[i] += F[i][j] * U[j][column]; }
    }
}

static double dot(const double a[IPE_NP], const double b[IPE_NP])
{
    double sum = 0.0;
    for (int i = 0; i < IPE_NP; ++i) { sum += a[i] * b[i]; }
    return sum;
}

/// v^T P w.
static double product(const double v[IPE_NP], const double P[IPE_NP][IPE_NP], const double w[IPE_NP])
{
    double sum = 0.0;
    for (int i = 0; i < IPE_NP; ++i) { sum += v[i] * dot(P[i], w); }
    return sum;
}

void ipe_eiv_correction_undo(const double C[IPE_NP][IPE_NP], const double prior_theta[IPE_NP],
                             const double prior[IPE_NP][IPE_NP], double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    double F[IPE_NP][IPE_NP], S[IPE_NP][IPE_NP], U[IPE_NP][IPE_NP];
    memcpy(F, P, sizeof F);
    if (!cholesky(&F[0][0], IPE_NP)) { return; }
    const double trace = noise_share(C, (const double (*)[IPE_NP])F, S);
    if (!(trace > NEGLIGIBLE) || !isfinite(trace)) { return; }
    symmetric_eigen(&S[0][0], &U[0][0], IPE_NP);
    double v[IPE_NP][IPE_NP], d[IPE_NP][IPE_NP], value[IPE_NP], variance[IPE_NP];
    bool is_lost[IPE_NP];
    for (int k = 0; k < IPE_NP; ++k) {
        direction((const double (*)[IPE_NP])F, (const double (*)[IPE_NP])U, k, v[k], d[k]);
        const double share = fmax(S[k][k], 0.0), rest = 1.0 - share;
        value[k] = dot(v[k], theta) / rest;
        const double doubt = UNCERTAIN * share * value[k];
        variance[k] = (1.0 + doubt * doubt) / (rest * rest);
        is_lost[k] = !(rest > 0.0) || variance[k] > product(v[k], prior, v[k]);
        if (is_lost[k]) { value[k] = dot(v[k], prior_theta); }
    }
    memset(theta, 0, sizeof v[0]);
    memset(P, 0, sizeof v);
    for (int k = 0; k < IPE_NP; ++k) {
        for (int i = 0; i < IPE_NP; ++i) { theta[i] += value[k] * d[k][i]; }
        for (int l = 0; l < IPE_NP; ++l) {
            const double covariance = is_lost[k] && is_lost[l] ? product(v[k], prior, v[l])
                                      : k == l                 ? variance[k]
                                                               : 0.0;
            add_outer(P, covariance, d[k], d[l]);
        }
    }
}
