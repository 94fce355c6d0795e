// SPDX-License-Identifier: Apache-2.0
#include "noise_density.h"

#include <math.h>
#include <string.h>

#define GAIN 70.0F   // 1 + 16 + 36 + 16 + 1: squares of the fourth difference's weights
#define MEMORY 250   // blocks: chosen so that a density is known to a tenth, sqrt(2/250)
#define SPIKE 25.0F  // of the mean square: 5 sigma, which noise exceeds once in 2e6 samples
#define SURE 20      // squares before anything is called a glitch: their mean is known to a third, sqrt(2/20)

void ipe_noise_density_restart(ipe_noise_density_t* x)
{
    memset(x->block, 0, sizeof x->block);
    x->n_samples = 0;
    x->n_past = 0;
}

static void close_block(ipe_noise_density_t* x, int block_length)
{
    const int n = x->n_squares < MEMORY ? x->n_squares + 1 : MEMORY;
    for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) {
        const float mean = x->block[i] / (float)block_length;
        const float d = mean - 4.0F * x->past[0][i] + 6.0F * x->past[1][i] - 4.0F * x->past[2][i] + x->past[3][i];
        const float most = x->n_squares < SURE ? HUGE_VALF : SPIKE * x->square[i];
        if (x->n_past == IPE_NOISE_DENSITY_PAST) { x->square[i] += (fminf(d * d, most) - x->square[i]) / (float)n; }
        for (int k = IPE_NOISE_DENSITY_PAST - 1; k > 0; --k) { x->past[k][i] = x->past[k - 1][i]; }
        x->past[0][i] = mean;
    }
    if (x->n_past == IPE_NOISE_DENSITY_PAST) {
        x->n_squares = n;
    } else {
        ++x->n_past;
    }
    memset(x->block, 0, sizeof x->block);
    x->n_samples = 0;
}

void ipe_noise_density_push(ipe_noise_density_t* x, const double value[IPE_NOISE_DENSITY_CHANNELS], int block_length)
{
    for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) { x->block[i] += (float)value[i]; }
    if (++x->n_samples >= block_length) { close_block(x, block_length); }
}

void ipe_noise_density_density(const ipe_noise_density_t* x, double T, double density[IPE_NOISE_DENSITY_CHANNELS])
{
    for (int i = 0; i < IPE_NOISE_DENSITY_CHANNELS; ++i) { density[i] = T * (double)(x->square[i] / GAIN); }
}
