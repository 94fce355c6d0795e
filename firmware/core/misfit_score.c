// SPDX-License-Identifier: Apache-2.0
#include "misfit_score.h"

#include <math.h>
#include <string.h>

#define HEALTHY 0.3F  // mean ratio of a robot without faults: windows overlap, and the noise is long-run variance
#define HEALTHY_BLOCKS 8.0F    // that it counts for: chosen so that two wild blocks of 10 s say little
#define LARGEST_HEALTHY 0.5  // of ten directions and five scales: chosen over 80 % of 70 simulated runs without faults
#define LARGEST_NIS 1.3      // mean NIS of late: chosen over all but one of those runs
#define BLOCKS_OF_LATE 60    // chosen so that a fault that is gone is forgotten after two minutes at 1 s
#define EARLY 0.05           // s before its end that a block may end: half a hop
static const double SCALE[IPE_MISFIT_SCALES] = {1.0, 3.0, 10.0, 30.0, 60.0};  // s

static void open_block(ipe_misfit_score_t* s, int scale, int64_t t_ns)
{
    s->begin_ns[scale] = t_ns;
    memset(s->change[scale], 0, sizeof s->change[scale]);
    memset(s->variance[scale], 0, sizeof s->variance[scale]);
}

static void close_block(ipe_misfit_score_t* s, int scale)
{
    s->n_blocks[scale] += s->n_blocks[scale] < BLOCKS_OF_LATE;
    for (int i = 0; i < IPE_NP; ++i) {
        const float change = s->change[scale][i], variance = s->variance[scale][i];
        const float ratio = variance > 0.0F ? change * change / variance : 0.0F;
        s->ratio[scale][i] += (ratio - s->ratio[scale][i]) / (float)s->n_blocks[scale];
    }
    s->begin_ns[scale] = 0;
}

void ipe_misfit_score_restart(ipe_misfit_score_t* s)
{
    memset(s->begin_ns, 0, sizeof s->begin_ns);
}

void ipe_misfit_score_before(ipe_misfit_score_t* s, const ipe_rls_t* rls)
{
    for (int i = 0; i < IPE_NP; ++i) {
        s->before[i] = rls->x[i];
        s->variance_before[i] = ipe_rls_covariance_of(rls, i, i);
    }
}

void ipe_misfit_score_after(ipe_misfit_score_t* s, const ipe_rls_t* rls, int64_t t_ns)
{
    double change[IPE_NP], variance[IPE_NP];
    for (int i = 0; i < IPE_NP; ++i) {
        change[i] = rls->x[i] - s->before[i];
        variance[i] = s->variance_before[i] - ipe_rls_covariance_of(rls, i, i);
    }
    for (int scale = 0; scale < IPE_MISFIT_SCALES; ++scale) {
        if (s->begin_ns[scale] == 0) { open_block(s, scale, t_ns); }
        for (int i = 0; i < IPE_NP; ++i) {
            s->change[scale][i] += (float)change[i];
            s->variance[scale][i] += (float)variance[i];
        }
        const double length = 1e-9 * (double)(t_ns - s->begin_ns[scale]);
        if (length < 0.0 || length > SCALE[scale] - EARLY) { close_block(s, scale); }
    }
}

double ipe_misfit_score_factor(const ipe_misfit_score_t* s, double nis)
{
    double largest = 0.0;
    for (int scale = 0; scale < IPE_MISFIT_SCALES; ++scale) {
        const float n = (float)s->n_blocks[scale];
        for (int i = 0; i < IPE_NP; ++i) {
            const float ratio = (n * s->ratio[scale][i] + HEALTHY_BLOCKS * HEALTHY) / (n + HEALTHY_BLOCKS);
            largest = fmax(largest, (double)ratio);
        }
    }
    return fmax(1.0, fmax(largest / LARGEST_HEALTHY, nis / LARGEST_NIS));
}
