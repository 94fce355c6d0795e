// SPDX-License-Identifier: Apache-2.0
/// Misfit over 1 to 60 s: does the estimate move more than its sigma allows?
///
/// Under a right model the changes that theta gets from the windows are independent, and their variances are what P loses by
/// them. Over blocks of 1, 3, 10, 30 and 60 s:
///   r_i = (sum of the changes of theta_i)^2 / (sum of the losses of P_ii)
/// is 1 in the mean, and less while the noise is still believed to be as large as configured. Errors that no state has
/// (friction, hysteresis, a bent geometry) turn theta to and fro with the motion, which the noise's long-run variance hardly
/// contains. The mean r_i over the blocks of a scale counts as if 8 blocks of a healthy robot came before it. With
/// f, the learnt noise over the configured one (sigmas, worst channel), the published variances are multiplied by
///   largest of mean r_i f / 0.5,  mean NIS of late / its expectation,  1
/// Errors that move nothing leave no score: a common gain, a constant hose, cables' weight.
/// Source: firmware/DESIGN.md, "Misfit". 0.8 KB of state, 2 us per window, one thread.
#ifndef IPE_MISFIT_SCORE_H
#define IPE_MISFIT_SCORE_H

#include "noise.h"
#include "rls.h"
#include "types.h"

enum { IPE_MISFIT_SCALES = 5 };

/// From this factor on sigma the estimate is marked: chosen over the largest of 70 simulated runs without faults, 1.22.
#define IPE_MISFIT_MARKED 1.25

typedef struct {
    double before[IPE_NP], variance_before[IPE_NP];  ///< theta and the diagonal of its P before the update that runs
    int64_t begin_ns[IPE_MISFIT_SCALES];             ///< of the open block; 0: none is open
    float change[IPE_MISFIT_SCALES][IPE_NP];         ///< of theta in it
    float variance[IPE_MISFIT_SCALES][IPE_NP];       ///< that P lost in it
    float ratio[IPE_MISFIT_SCALES][IPE_NP];          ///< mean of r over the blocks of late
    int n_blocks[IPE_MISFIT_SCALES];                 ///< that it is the mean of
} ipe_misfit_score_t;

/// A gap: the open blocks are given up. All zero is the start.
void ipe_misfit_score_restart(ipe_misfit_score_t* s);

/// Call both around each update of the filter: before() keeps theta and its variances, after() adds what changed to the
/// open blocks. t_ns: the window's middle.
void ipe_misfit_score_before(ipe_misfit_score_t* s, const ipe_rls_t* rls);
void ipe_misfit_score_after(ipe_misfit_score_t* s, const ipe_rls_t* rls, int64_t t_ns);

/// By what the published sigmas are too small, at least 1.
///
///   noise  as learnt so far
///   nis    mean normalised innovation squared of late; 0: not known yet
double ipe_misfit_score_factor(const ipe_misfit_score_t* s, const ipe_noise_t* noise, double nis);

#endif
