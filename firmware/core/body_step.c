// SPDX-License-Identifier: Apache-2.0
#include "body_step.h"

#include "smallmat.h"

#include <string.h>

enum { FIRST_MOMENTS = 4 };  // mass and first moments lead theta

void ipe_body_step_start(ipe_body_step_t* s)
{
    memset(s, 0, sizeof *s);
}

bool ipe_body_step_add(ipe_body_step_t* s, const double Y[IPE_NY][IPE_NP], const double innovation[IPE_NY],
                       const double S[IPE_NY][IPE_NY], const double L[IPE_NY][IPE_NY])
{
    double V[IPE_NY][IPE_NY], e[IPE_NY], G[IPE_NP][IPE_NY];
    if (!all_finite(innovation, IPE_NY) || !all_finite(&Y[0][0], IPE_NY * IPE_NP) ||
        !cholesky_of_sum(&S[0][0], &L[0][0], IPE_NY, &V[0][0])) {
        return false;
    }
    memcpy(e, innovation, sizeof e);
    substitute_forward(&V[0][0], IPE_NY, e);
    for (int p = 0; p < IPE_NP; ++p) {
        for (int j = 0; j < IPE_NY; ++j) { G[p][j] = Y[j][p]; }
        substitute_forward(&V[0][0], IPE_NY, G[p]);
    }
    for (int j = 0; j < IPE_NY; ++j) {
        for (int p = 0; p < IPE_NP; ++p) {
            for (int q = 0; q <= p; ++q) { s->information[p][q] += G[p][j] * G[q][j]; }
            s->projected[p] += G[p][j] * e[j];
        }
        s->square += e[j] * e[j];
    }
    ++s->n_windows;
    return true;
}

/// Least squares in units of std with noise of this scale: x [10], factor of its information. Returns the explained part.
static double explain(const ipe_body_step_t* s, const double std[IPE_NP], double scale, double A[IPE_NP][IPE_NP],
                      double x[IPE_NP])
{
    double explained = 0.0;
    for (int p = 0; p < IPE_NP; ++p) {
        for (int q = 0; q <= p; ++q) {
            A[p][q] = std[p] * s->information[p][q] * std[q] / scale + (p == q ? 1.0 : 0.0);
        }
        x[p] = std[p] * s->projected[p] / scale;
    }
    (void)cholesky(&A[0][0], IPE_NP);  // positive definite: 1 on the diagonal of a sum of squares
    cholesky_solve(&A[0][0], IPE_NP, x, x);
    for (int p = 0; p < IPE_NP; ++p) { explained += x[p] * std[p] * s->projected[p] / scale; }
    return explained;
}

/// Squared Mahalanobis length of the first entries of x, with the information A A^T in all of them.
static double length_of_first(const double A[IPE_NP][IPE_NP], const double x[IPE_NP])
{
    double C[FIRST_MOMENTS][FIRST_MOMENTS], column[IPE_NP], w[FIRST_MOMENTS], length = 0.0;
    for (int j = 0; j < FIRST_MOMENTS; ++j) {
        memset(column, 0, sizeof column);
        column[j] = 1.0;
        cholesky_solve(&A[0][0], IPE_NP, column, column);
        for (int i = j; i < FIRST_MOMENTS; ++i) { C[i][j] = column[i]; }
    }
    if (!cholesky(&C[0][0], FIRST_MOMENTS)) { return 0.0; }
    cholesky_solve(&C[0][0], FIRST_MOMENTS, x, w);
    for (int i = 0; i < FIRST_MOMENTS; ++i) { length += x[i] * w[i]; }
    return length;
}

void ipe_body_step_solve(const ipe_body_step_t* s, const double std[IPE_NP], double scale, ipe_body_step_fit_t* fit)
{
    double A[IPE_NP][IPE_NP] = {{0.0}}, x[IPE_NP], penalty = 0.0;
    const double freedom = fmax(IPE_NY * s->n_windows - IPE_NP, IPE_NY / 2.0);
    fit->remaining = fmax(s->square - explain(s, std, 1.0, A, x), 0.0);
    fit->misfit = fit->remaining / freedom;
    const double explained = explain(s, std, fmax(fit->misfit, scale), A, x);
    for (int p = 0; p < IPE_NP; ++p) {
        penalty += 2.0 * log(A[p][p]);
        fit->theta[p] = std[p] * x[p];
    }
    fit->log_likelihood_ratio = 0.5 * (explained - penalty);
    fit->first_moments = length_of_first((const double (*)[IPE_NP])A, x);
}

void ipe_body_step_along(const ipe_body_step_t* s, const double d[IPE_NP], double scale, ipe_body_step_fit_t* fit,
                         double* share, double* share_std)
{
    double information = 0.0, projected = 0.0;
    for (int p = 0; p < IPE_NP; ++p) {
        for (int q = 0; q < p; ++q) { information += 2.0 * d[p] * s->information[p][q] * d[q]; }
        information += d[p] * s->information[p][p] * d[p];
        projected += d[p] * s->projected[p];
    }
    const double best = projected / (information + scale);
    fit->remaining = fmax(s->square - best * (2.0 * projected - best * information), 0.0);
    fit->misfit = fit->remaining / fmax(IPE_NY * s->n_windows - 1, 1.0);
    const double noise = fmax(fit->misfit, scale);
    *share = projected / (information + noise);
    *share_std = sqrt(noise / (information + noise));
    for (int p = 0; p < IPE_NP; ++p) { fit->theta[p] = *share * d[p]; }
    fit->log_likelihood_ratio = 0.5 * (*share * projected / noise - log(1.0 + information / noise));
    fit->first_moments = *share * *share * information / noise;
}
