// SPDX-License-Identifier: Apache-2.0
#include "misfit_score.h"

#include <math.h>
#include <string.h>

#define HEALTHY 0.3F         // mean ratio of a robot without faults in its first minute
#define HEALTHY_BLOCKS 8.0F  // that it counts for: chosen so that two wild blocks of 10 s say little
#define LARGEST_HEALTHY \
    0.5   // of r f in ten directions and five scales: chosen over 90 % of 70 simulated runs, up to 600 s
#define NIS_FIRST \
    0.52  // the same of the mean NIS: while the configured covariance, which is cautious, holds the windows' noise,
#define NIS_LATER 2.6   // and what comes to it once the noise is learnt: windows overlap, so NIS stays below 6
#define NIS_TIME 600.0  // windows it is half learnt after
#define EARLY 0.05      // s before its end that a block may end, so that the rounding of stamps costs no window
static const double SCALE[IPE_MISFIT_SCALES] = {1.0, 3.0, 10.0, 30.0, 60.0};  // s
/// Blocks that the mean is of: chosen so that a fault that is gone is forgotten after one to eight minutes.
static const int BLOCKS_OF_LATE[IPE_MISFIT_SCALES] = {60, 60, 30, 10, 8};

static void open_block(ipe_misfit_score_t* s, int scale, int64_t t_ns)
{
    s->begin_ns[scale] = t_ns;
    memset(s->change[scale], 0, sizeof s->change[scale]);
    memset(s->variance[scale], 0, sizeof s->variance[scale]);
}

static void close_block(ipe_misfit_score_t* s, int scale)
{
    s->n_blocks[scale] += s->n_blocks[scale] < BLOCKS_OF_LATE[scale];
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

double ipe_misfit_score_factor(const ipe_misfit_score_t* s, const ipe_noise_t* noise, double nis)
{
    double largest = 0.0;
    const double n_noise = (double)noise->n_summed, usual_nis = NIS_FIRST + NIS_LATER * n_noise / (n_noise + NIS_TIME);
    for (int scale = 0; scale < IPE_MISFIT_SCALES; ++scale) {
        const float n = (float)s->n_blocks[scale];
        for (int i = 0; i < IPE_NP; ++i) {
            const float ratio = (n * s->ratio[scale][i] + HEALTHY_BLOCKS * HEALTHY) / (n + HEALTHY_BLOCKS);
            largest = fmax(largest, (double)ratio);
        }
    }
    const double of_score = largest * ipe_noise_growth(noise) / LARGEST_HEALTHY;
    return sqrt(fmax(1.0, fmax(of_score, nis / usual_nis)));
}
