// SPDX-License-Identifier: Apache-2.0
#include "spike_gate.h"

#include <math.h>
#include <string.h>

#define LEARNING 32        // samples before the noise has a meaning
#define MEMORY 64          // samples that the noise is a mean of
#define CLIP 3.0F          // times the noise that one sample counts for: spikes and jolts barely move it
#define SUSPECT 12.0F      // times the noise, 10 sigma of white noise: chosen so that healthy runs have none
#define BACK 0.25          // of the spike, within which the next sample is back
#define LONGEST_REACH 3.0  // spacings: chosen so that a line through two noisy samples still predicts

void ipe_spike_gate_init(ipe_spike_gate_t* g, int n_channels, const double* least, double least_share)
{
    memset(g, 0, sizeof *g);
    g->n_channels = n_channels;
    g->least_share = least_share;
    memcpy(g->least, least, sizeof(double) * (size_t)n_channels);
}

static double off_line(double a, double b, double x, double r)
{
    return x - b - r * (b - a);
}

/// e at r to that of even spacing, for white noise in a, b and x: sqrt(3/(1 + r + r^2)) within 4 % for r of 0.5 to 3.
static double evened(double r)
{
    return 2.0 / (1.0 + r);
}

/// Size from which on |e| of channel i is suspicious.
static double limit(const ipe_spike_gate_t* g, const double* b, int i)
{
    double mean = 0.0;
    for (int k = 0; k < g->n_channels; ++k) { mean += fabs(b[k]) / g->n_channels; }
    return fmax(fmax((double)(SUSPECT * g->noise[i]), g->least[i]), g->least_share * mean);
}

static float learnt(float noise, float size, float share)
{
    const bool is_clipped = share < 2.0F / LEARNING && noise > 0.0F && size > CLIP * noise;
    return noise + share * ((is_clipped ? CLIP * noise : size) - noise);
}

bool ipe_spike_gate_is_suspect(ipe_spike_gate_t* g, const double* a, const double* b, const double* x, double r)
{
    bool is_suspect = false;
    if (!(r > 0.0 && r < LONGEST_REACH)) { return false; }
    const double scale = evened(r);
    g->n_learnt += g->n_learnt < MEMORY;
    const float share = 1.0F / (float)g->n_learnt;
    for (int i = 0; i < g->n_channels; ++i) {
        const float e = (float)(scale * fabs(off_line(a[i], b[i], x[i], r)));
        if (e > SUSPECT * g->noise[i] && g->n_learnt > LEARNING) { is_suspect |= (double)e > limit(g, b, i); }
        g->noise[i] = learnt(g->noise[i], e, share);
    }
    return is_suspect;
}

uint32_t ipe_spike_gate_stepped(const ipe_spike_gate_t* g, const double* a, const double* b, const double* x, double r,
                                const double* next, double r_next)
{
    const double scale = evened(r);
    uint32_t stepped = 0;
    for (int i = 0; i < g->n_channels; ++i) {
        const double e = fabs(off_line(a[i], b[i], x[i], r));
        if (scale * e <= limit(g, b, i)) { continue; }
        if (fabs(off_line(a[i], b[i], next[i], r_next)) > BACK * e) { stepped |= 1U << (unsigned)i; }
    }
    return stepped;
}
