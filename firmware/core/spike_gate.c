// SPDX-License-Identifier: Apache-2.0
#include "spike_gate.h"

#include <math.h>
#include <string.h>

#define LEARNING 32      // samples before the noise has a meaning
#define MEMORY 64        // samples that the noise is a mean of
#define CLIP 3.0F        // times the noise that one sample counts for: spikes and jolts barely move it
#define SUSPECT 12.0F    // times the noise, 10 sigma of white noise: chosen so that healthy runs have none
#define BACK 0.25        // of the spike, within which the next sample is back
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

/// e at r to that of even spacing, for white noise in a, b and x.
static double evened(double r)
{
    return sqrt(6.0 / (1.0 + (1.0 + r) * (1.0 + r) + r * r));
}

/// Size from which on |e| of channel i is suspicious.
static double limit(const ipe_spike_gate_t* g, const double* b, int i)
{
    double mean = 0.0;
    for (int k = 0; k < g->n_channels; ++k) { mean += fabs(b[k]) / g->n_channels; }
    return fmax(fmax((double)(SUSPECT * g->noise[i]), g->least[i]), g->least_share * mean);
}

static void learn(ipe_spike_gate_t* g, int i, float size)
{
    const bool has_scale = g->n_learnt > LEARNING / 2 && g->noise[i] > 0.0F;
    const float counted = has_scale ? fminf(size, CLIP * g->noise[i]) : size;
    g->noise[i] += (counted - g->noise[i]) / (float)g->n_learnt;
}

bool ipe_spike_gate_is_suspect(ipe_spike_gate_t* g, const double* a, const double* b, const double* x, double r)
{
    bool is_suspect = false;
    if (!(r > 0.0 && r < LONGEST_REACH)) { return false; }
    const double scale = evened(r);
    g->n_learnt += g->n_learnt < MEMORY;
    for (int i = 0; i < g->n_channels; ++i) {
        const double e = scale * fabs(off_line(a[i], b[i], x[i], r));
        if (e > (double)(SUSPECT * g->noise[i]) && g->n_learnt > LEARNING) { is_suspect |= e > limit(g, b, i); }
        learn(g, i, (float)e);
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
