// SPDX-License-Identifier: Apache-2.0
#include "noise.h"

#include "smallmat.h"

#include <string.h>

#define PRIOR_WINDOWS 10.0  // the configured covariance counts for so many: chosen so that it decides for 1 s only
#define HUBER_NIS \
    30.0  // from which on a window counts for less: chi-squared with 6 degrees of freedom exceeds it in 4e-5
#define LEAST_WEIGHT 0.1  // so that a misfit that lasts is not thrown away
#define FLOOR 1e-4  // of the configured variance: chosen as 1 % of its sigma, below which quantisation is all there is

ipe_status_t ipe_noise_init(ipe_noise_t* s, const double C[IPE_NY][IPE_NY])
{
    memset(s, 0, sizeof *s);
    memcpy(s->factor, C, sizeof s->factor);
    for (int i = 0; i < IPE_NY; ++i) { s->prior[i] = C[i][i]; }
    const bool good = cholesky(&s->factor[0][0], IPE_NY);
    memcpy(s->L, s->factor, sizeof s->L);
    return good ? IPE_OK : IPE_ERR_CONFIG;
}

static double learnt_variance(const ipe_noise_t* s, int i)
{
    const double v = (PRIOR_WINDOWS * s->prior[i] + fmax(s->sum[i], 0.0)) / (PRIOR_WINDOWS + (double)s->n_summed);
    return fmax(v, FLOOR * s->prior[i]);
}

/// This window's part of the long-run variance: its square and its products with the windows before.
static double contribution(const ipe_noise_t* s, const double innovation[IPE_NY], int i)
{
    const uint64_t lags = s->n_past < IPE_NOISE_LAGS ? s->n_past : IPE_NOISE_LAGS;
    double sum = innovation[i];
    for (uint64_t k = 1; k <= lags; ++k) {
        const double weight = 1.0 - (double)k / (IPE_NOISE_LAGS + 1);
        sum += 2.0 * weight * (double)s->past[(s->n_past - k) % IPE_NOISE_LAGS][i];
    }
    return sum * innovation[i];
}

static bool tells_of_noise(const ipe_noise_t* s, const double S[IPE_NY][IPE_NY])
{
    for (int i = 0; i < IPE_NY; ++i) {
        if (!(S[i][i] < learnt_variance(s, i))) { return false; }
    }
    return true;
}

void ipe_noise_push(ipe_noise_t* s, const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY])
{
    if (!all_finite(innovation, IPE_NY)) { return; }
    if (tells_of_noise(s, S)) {
        for (int i = 0; i < IPE_NY; ++i) { s->sum[i] += contribution(s, innovation, i); }
        ++s->n_summed;
    }
    for (int i = 0; i < IPE_NY; ++i) { s->past[s->n_past % IPE_NOISE_LAGS][i] = (float)innovation[i]; }
    ++s->n_past;
    for (int i = 0; i < IPE_NY; ++i) {
        const double scale = sqrt(learnt_variance(s, i) / s->prior[i]);
        for (int k = 0; k <= i; ++k) { s->L[i][k] = scale * s->factor[i][k]; }
    }
}

double ipe_noise_weight(double nis)
{
    return nis > HUBER_NIS ? fmax(sqrt(HUBER_NIS / nis), LEAST_WEIGHT) : 1.0;
}

double ipe_noise_level(const ipe_noise_t* s)
{
    double sum = 0.0;
    for (int i = 0; i < IPE_NY; ++i) { sum += log(learnt_variance(s, i) / s->prior[i]); }
    return exp(sum / IPE_NY);
}

void ipe_noise_restart(ipe_noise_t* s)
{
    s->n_past = 0;
}
