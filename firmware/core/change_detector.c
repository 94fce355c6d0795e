// SPDX-License-Identifier: Apache-2.0
#include "change_detector.h"

#include "smallmat.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CUSUM_DRIFT \
    12.0  // NIS, twice its mean of 6: chosen so that noise underrated by a factor of 1.4 raises no alarm
#define CUSUM_LIMIT 60.0  // NIS: chosen so that five windows at twice the drift raise the alarm (Page 1954)
#define CALM_WINDOWS 5
#define CONTEST_WINDOWS 50
#define SETTLING_WINDOWS 50

void ipe_change_detector_init(ipe_change_detector_t* d)
{
    memset(d, 0, sizeof *d);
}

void ipe_change_detector_restart(ipe_change_detector_t* d)
{
    d->n_contest = d->n_restless = d->n_calm = 0;
}

double ipe_change_detector_nis(const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                               const double L[IPE_NY][IPE_NY])
{
    double A[IPE_NY][IPE_NY];
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j <= i; ++j) {
            A[i][j] = S[i][j];
            for (int k = 0; k <= j; ++k) { A[i][j] += L[i][k] * L[j][k]; }
        }
    }
    if (!cholesky(&A[0][0], IPE_NY)) { return NAN; }
    double z[IPE_NY], nis = 0.0;
    for (int i = 0; i < IPE_NY; ++i) {
        z[i] = innovation[i];
        for (int k = 0; k < i; ++k) { z[i] -= A[i][k] * z[k]; }
        z[i] /= A[i][i];
        nis += z[i] * z[i];
    }
    return nis;
}

#define LEVEL_START 6.0
#define LEVEL_WINDOWS 50.0
#define LEVEL_MIN 0.5
#define DRIFT 2.0
#define LIMIT 6.0
#define LLR_MIN 20.0
#define EVIDENCE 1000.0
#define MISFIT_MAX 1.0
#define MOMENTS_MIN 40.0
static bool is_suspicious(ipe_change_detector_t* d, double nis)
{
    const double level = fmax(d->level, LEVEL_MIN);
    d->cusum = fmax(0.0, d->cusum + fmin(nis, IPE_CHANGE_DETECTOR_NIS_LIMIT) - DRIFT * level);
    if (nis <= IPE_CHANGE_DETECTOR_NIS_LIMIT && d->cusum <= LIMIT * level) { return false; }
    d->cusum = 0.0;
    return true;
}

static void learn_level(ipe_change_detector_t* d, double nis)
{
    d->level += (fmin(nis, IPE_CHANGE_DETECTOR_NIS_LIMIT) - d->level) / d->n_level;
    d->n_level += d->n_level < LEVEL_WINDOWS;
}

ipe_change_detector_verdict_t ipe_change_detector_push(ipe_change_detector_t* d, const ipe_change_detector_window_t* w,
                                                       const double payload_std[IPE_NP])
{
    static int kk; ++kk; if (getenv("TRACEALL")) { fprintf(stderr, "W %d nis %.1f\n", kk, w->nis); }
    if (isnan(w->nis)) { return IPE_CHANGE_DETECTOR_USE; }
    if (d->level == 0.0) { d->level = LEVEL_START; d->n_level = 10; }
    if (d->n_settling > 0) { --d->n_settling; d->cusum = 0; learn_level(d, w->nis); return IPE_CHANGE_DETECTOR_USE; }
    if (d->n_contest == 0) {
        if (!is_suspicious(d, w->nis)) { learn_level(d, w->nis); return IPE_CHANGE_DETECTOR_USE; }
        ipe_body_step_start(&d->step);
    }
    ++d->n_contest;
    const bool is_calm = w->nis <= DRIFT * fmax(d->level, LEVEL_MIN);
    d->n_restless += !is_calm;
    d->n_calm = is_calm ? d->n_calm + 1 : 0;
    ipe_body_step_fit_t fit, one;
    ipe_body_step_t single;
    ipe_body_step_start(&single);
    ipe_body_step_add(&single, w->Y, w->innovation, w->S, w->L);
    ipe_body_step_solve(&single, payload_std, 1.0, &one);
    ipe_body_step_add(&d->step, w->Y, w->innovation, w->S, w->L);
    ipe_body_step_solve(&d->step, payload_std, 1.0, &fit);
    // contradiction of this window to step
    if (d->step.n_windows > 1 && fit.misfit > MISFIT_MAX && one.misfit < 0.25 * fit.misfit) {
        d->step = single;
        fit = one;
    }
    bool won = false;
    double kap = 1.0, mm=0, hh=0, jj=0;
    for (int kk = 0; kk < 5 && !won; ++kk, kap /= 4.0) {
        double std[IPE_NP];
        for (int i = 0; i < IPE_NP; ++i) { std[i] = kap * payload_std[i]; }
        ipe_body_step_solve(&d->step, std, fmax(1.0, d->level), &fit);
        mm = fabs(fit.theta[0])/std[0], hh=0, jj=0; for(int i=1;i<4;i++) hh+=pow(fit.theta[i]/std[i],2); for(int i=4;i<10;i++) jj+=pow(fit.theta[i]/std[i],2);
        hh = sqrt(hh); jj = sqrt(jj);
        won = d->step.n_windows > 1 && fit.misfit < MISFIT_MAX && fit.log_likelihood_ratio > LLR_MIN && (mm > 0.25 || hh > 0.25) && (fabs(fit.theta[0]) > 0.005 * w->mass || (d->step.n_windows >= 30 && hh * std[0] > 0.005 * w->mass)) &&
            fit.log_likelihood_ratio * d->step.n_windows > EVIDENCE && fit.first_moments > MOMENTS_MIN;
        if (getenv("TRACE")) { fprintf(stderr, "   k %.4f llr %8.1f misfit %.2f m %.3f h %.3f J %.3f  mom %.1f\n", kap, fit.log_likelihood_ratio, fit.misfit, mm, hh, jj, fit.first_moments); }
        if (won) break;
    }
    if (getenv("TRACE")) {
        fprintf(stderr, "T %d n %d nis %8.1f one: llr %8.1f misfit %7.1f | llr %8.1f misfit %7.1f m %7.3f  mom %8.1f calm %d lev %.2f\n",
                d->n_contest, d->step.n_windows, w->nis, one.log_likelihood_ratio, one.misfit, fit.log_likelihood_ratio,
                fit.misfit, fit.theta[0], fit.first_moments, d->n_calm, d->level);
        if (won) fprintf(stderr,"S kap %.4f m %.3f h %.3f J %.3f  kg %.3f misfit %.2f llr %.1f n %d mom %.1f nis %.1f lev %.2f\n", kap, mm, hh, jj, fit.theta[0], fit.misfit, fit.log_likelihood_ratio, d->step.n_windows, fit.first_moments, w->nis, d->level);
        if (won) fprintf(stderr, "CHANGE %d\n", kk);
    }
    if (won) {
        ++d->n_changes;
        ipe_change_detector_restart(d);
        return IPE_CHANGE_DETECTOR_CHANGE;
    }
    if (d->n_calm >= (d->n_restless < CALM_WINDOWS ? d->n_restless : CALM_WINDOWS) || d->n_contest >= CONTEST_WINDOWS) {
        if (d->n_contest >= CONTEST_WINDOWS) { d->n_settling = SETTLING_WINDOWS; }
        ++d->n_rejected;
        if (getenv("TRACE")) { fprintf(stderr, "rejected %d\n",kk); }
        ipe_change_detector_restart(d);
        return IPE_CHANGE_DETECTOR_USE;
    }
    ++d->n_held;
    return IPE_CHANGE_DETECTOR_HOLD;
}
