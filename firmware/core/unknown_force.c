// SPDX-License-Identifier: Apache-2.0
#include "unknown_force.h"

#include "smallmat.h"
#include "systematic.h"

#include <string.h>

#define SIGMA 1e4  // of what the equations tell of the force without it: chosen so that 1e-8 of that is left

int ipe_unknown_force_count(uint32_t unknown)
{
    int n = 0;
    for (; unknown != 0; unknown &= unknown - 1) { ++n; }
    return n;
}

/// Lower Cholesky factor of S + L L^T.
static bool factor_sum(const double S[IPE_NY][IPE_NY], const double L[IPE_NY][IPE_NY], double A[IPE_NY][IPE_NY])
{
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j <= i; ++j) {
            A[i][j] = S[i][j];
            for (int k = 0; k <= j; ++k) { A[i][j] += L[i][k] * L[j][k]; }
        }
    }
    return cholesky(&A[0][0], IPE_NY);
}

/// One cable's: w its column.
static bool take_out(const double w[IPE_NY], const double S[IPE_NY][IPE_NY], double innovation[IPE_NY],
                     double y[IPE_NY], double* excess, double L[IPE_NY][IPE_NY])
{
    double A[IPE_NY][IPE_NY], B[IPE_NY][IPE_NY], along[IPE_NY], information = 0.0, told = 0.0;
    if (!factor_sum(S, (const double (*)[IPE_NY])L, A)) { return false; }
    cholesky_solve(&A[0][0], IPE_NY, w, along);
    for (int i = 0; i < IPE_NY; ++i) {
        information += w[i] * along[i];
        told += innovation[i] * along[i];
    }
    if (!(information > 0.0)) { return false; }
    const double variance = SIGMA * SIGMA / information;
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NY; ++j) { B[i][j] = variance * w[i] * w[j]; }
    }
    if (!factor_sum((const double (*)[IPE_NY])B, (const double (*)[IPE_NY])L, A)) { return false; }
    memcpy(L, A, sizeof A);
    *excess = told / information;
    for (int i = 0; i < IPE_NY; ++i) {
        innovation[i] -= *excess * w[i];
        y[i] -= *excess * w[i];
    }
    return true;
}

ipe_status_t ipe_unknown_force_take_out(uint32_t unknown, const double X[IPE_NY][IPE_XI_MAX],
                                        const double S[IPE_NY][IPE_NY], double innovation[IPE_NY], double y[IPE_NY],
                                        double excess[IPE_CABLES_MAX], double L[IPE_NY][IPE_NY])
{
    double left[IPE_NY], right[IPE_NY], factor[IPE_NY][IPE_NY];
    memcpy(left, innovation, sizeof left);
    memcpy(right, y, sizeof right);
    memcpy(factor, L, sizeof factor);
    memset(excess, 0, sizeof(double) * IPE_CABLES_MAX);
    for (int j = 0; j < IPE_CABLES_MAX; ++j) {
        if (!(unknown >> (unsigned)j & 1U)) { continue; }
        double w[IPE_NY];
        for (int i = 0; i < IPE_NY; ++i) { w[i] = -X[i][IPE_XI_FORCE + j]; }
        if (!take_out(w, S, left, right, &excess[j], factor)) { return IPE_ERR_NONFINITE; }
    }
    memcpy(innovation, left, sizeof left);
    memcpy(y, right, sizeof right);
    memcpy(L, factor, sizeof factor);
    return IPE_OK;
}
