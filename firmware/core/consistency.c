// SPDX-License-Identifier: Apache-2.0
#include "consistency.h"

#include "smallmat.h"

#include <string.h>

void ipe_consistency_pseudo_inertia(const double theta[IPE_NP], double Pi[4][4])
{
    const double* J = theta + 4;
    const double half_trace = 0.5 * (J[0] + J[1] + J[2]);
    const double entries[4][4] = {
        {half_trace - J[0], -J[5], -J[4], theta[1]},
        {-J[5], half_trace - J[1], -J[3], theta[2]},
        {-J[4], -J[3], half_trace - J[2], theta[3]},
        {theta[1], theta[2], theta[3], theta[0]},
    };
    memcpy(Pi, entries, sizeof entries);
}

bool ipe_consistency_check(const double theta[IPE_NP])
{
    double Pi[4][4];
    ipe_consistency_pseudo_inertia(theta, Pi);
    return all_finite(theta, IPE_NP) && cholesky(&Pi[0][0], 4);
}

#define MARGIN 2e-3          // smallest eigenvalue that is aimed at, of the scaled Pi's trace
#define CUTS_MAX 40          // cuts: measured, of 52,486 impossible estimates 13 need more than 24, none more than 40
#define HILDRETH_SWEEPS 200  // over the active cuts: chosen so that the multipliers stand still
static double unit_length(const double theta[IPE_NP])
{
    const double squared = 0.5 * (theta[4] + theta[5] + theta[6]) / theta[0];
    return squared > 1e-12 && isfinite(squared) ? sqrt(squared) : 1.0;
}

/// Pi with mass scaled to kg m2.
static void scaled_pseudo_inertia(const double theta[IPE_NP], double length, double Pi[4][4])
{
    ipe_consistency_pseudo_inertia(theta, Pi);
    for (int i = 0; i < 3; ++i) {
        Pi[i][3] *= length;
        Pi[3][i] *= length;
    }
    Pi[3][3] *= length * length;
}

/// g with g^T theta = v^T Pi(theta) v, Pi scaled.
static void cut_of(const double v[4], double length, double g[IPE_NP])
{
    for (int j = 0; j < IPE_NP; ++j) {
        double unit[IPE_NP] = {0.0}, Pi[4][4];
        unit[j] = 1.0;
        scaled_pseudo_inertia(unit, length, Pi);
        g[j] = 0.0;
        for (int i = 0; i < 4; ++i) {
            for (int k = 0; k < 4; ++k) { g[j] += v[i] * Pi[i][k] * v[k]; }
        }
    }
}

typedef struct {
    int n;
    double length, margin;
    double g[CUTS_MAX][IPE_NP], Pg[CUTS_MAX][IPE_NP], multiplier[CUTS_MAX];
} cuts_t;

static double dot10(const double a[IPE_NP], const double b[IPE_NP])
{
    double sum = 0.0;
    for (int i = 0; i < IPE_NP; ++i) { sum += a[i] * b[i]; }
    return sum;
}

/// Add the cuts that q violates. False if there is none.
static bool add_cuts(cuts_t* cuts, const double q[IPE_NP], const double P[IPE_NP][IPE_NP])
{
    double A[4][4], V[4][4];
    bool any = false;
    scaled_pseudo_inertia(q, cuts->length, A);
    symmetric_eigen(&A[0][0], &V[0][0], 4);
    for (int k = 0; k < 4 && cuts->n < CUTS_MAX; ++k) {
        if (A[k][k] >= 0.5 * cuts->margin) { continue; }
        const double v[4] = {V[0][k], V[1][k], V[2][k], V[3][k]};
        cut_of(v, cuts->length, cuts->g[cuts->n]);
        for (int i = 0; i < IPE_NP; ++i) { cuts->Pg[cuts->n][i] = dot10(P[i], cuts->g[cuts->n]); }
        cuts->multiplier[cuts->n++] = 0.0;
        any = true;
    }
    return any;
}

/// Coordinate ascent on the multipliers of min (q - theta)^T P^-1 (q - theta), g_k^T q >= margin.
static void hildreth(cuts_t* cuts, double q[IPE_NP])
{
    for (int sweep = 0; sweep < HILDRETH_SWEEPS; ++sweep) {
        double moved = 0.0;
        for (int k = 0; k < cuts->n; ++k) {
            const double gPg = dot10(cuts->g[k], cuts->Pg[k]);
            if (!(gPg > 0.0)) { continue; }
            const double step = fmax((cuts->margin - dot10(cuts->g[k], q)) / gPg, -cuts->multiplier[k]);
            cuts->multiplier[k] += step;
            for (int i = 0; i < IPE_NP; ++i) { q[i] += step * cuts->Pg[k][i]; }
            moved = fmax(moved, fabs(step) * sqrt(gPg));
        }
        if (moved < 1e-12) { return; }
    }
}

/// (q - theta)^T P^-1 (q - theta) = multipliers^T G P G^T multipliers, since q - theta = P G^T multipliers.
static double moved_by(const cuts_t* cuts, const double theta[IPE_NP], const double q[IPE_NP])
{
    double sum = 0.0;
    for (int k = 0; k < cuts->n; ++k) {
        for (int i = 0; i < IPE_NP; ++i) { sum += cuts->multiplier[k] * cuts->g[k][i] * (q[i] - theta[i]); }
    }
    return sum;
}

bool ipe_consistency_project(const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], double q[IPE_NP],
                             double* distance)
{
    memcpy(q, theta, sizeof(double) * IPE_NP);
    *distance = 0.0;
    if (ipe_consistency_check(theta)) { return true; }
    if (!all_finite(theta, IPE_NP)) { return false; }
    cuts_t cuts;
    cuts.n = 0;
    cuts.length = unit_length(theta);
    cuts.margin = MARGIN * (0.5 * fabs(theta[4] + theta[5] + theta[6]) + fabs(theta[0]) * cuts.length * cuts.length);
    while (cuts.n < CUTS_MAX && add_cuts(&cuts, q, P)) { hildreth(&cuts, q); }
    if (!ipe_consistency_check(q) || !all_finite(q, IPE_NP)) {
        memcpy(q, theta, sizeof(double) * IPE_NP);
        return false;
    }
    *distance = moved_by(&cuts, theta, q);
    return true;
}
