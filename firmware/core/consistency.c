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
#define HILDRETH_SWEEPS 200  // over the active cuts: chosen so that the multipliers stand still
#define STEPS_OF_PART 1500  // steps of a multiplier: chosen so that a part costs no more than the rest of a publication
enum { CUTS_MAX = IPE_CONSISTENCY_CUTS_MAX };

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

/// What follows from a search's cuts: g_k^T q >= margin.
typedef struct {
    double g[CUTS_MAX][IPE_NP], Pg[CUTS_MAX][IPE_NP], gPg[CUTS_MAX];
} cuts_t;

static double dot10(const double a[IPE_NP], const double b[IPE_NP])
{
    double sum = 0.0;
    for (int i = 0; i < IPE_NP; ++i) { sum += a[i] * b[i]; }
    return sum;
}

static void write_out(const ipe_projection_t* search, const double P[IPE_NP][IPE_NP], cuts_t* cuts)
{
    for (int k = 0; k < search->n; ++k) {
        cut_of(search->v[k], search->length, cuts->g[k]);
        for (int i = 0; i < IPE_NP; ++i) { cuts->Pg[k][i] = dot10(P[i], cuts->g[k]); }
        cuts->gPg[k] = dot10(cuts->g[k], cuts->Pg[k]);
    }
}

/// Add the cuts that q violates. False if there is none.
static bool add_cuts(ipe_projection_t* search)
{
    double A[4][4], V[4][4];
    const int n = search->n;
    scaled_pseudo_inertia(search->q, search->length, A);
    symmetric_eigen(&A[0][0], &V[0][0], 4);
    for (int k = 0; k < 4 && search->n < CUTS_MAX; ++k) {
        if (A[k][k] >= 0.5 * search->margin) { continue; }
        for (int i = 0; i < 4; ++i) { search->v[search->n][i] = V[i][k]; }
        search->multiplier[search->n++] = 0.0;
    }
    return search->n > n;
}

/// One sweep of coordinate ascent on the multipliers of min (q - theta)^T P^-1 (q - theta), g_k^T q >= margin. The longest step.
static double sweep(ipe_projection_t* search, const cuts_t* cuts)
{
    double* q = search->q;
    double moved = 0.0;
    for (int k = 0; k < search->n; ++k) {
        const double gPg = cuts->gPg[k];
        if (!(gPg > 0.0)) { continue; }
        const double step = fmax((search->margin - dot10(cuts->g[k], q)) / gPg, -search->multiplier[k]);
        search->multiplier[k] += step;
        for (int i = 0; i < IPE_NP; ++i) { q[i] += step * cuts->Pg[k][i]; }
        moved = fmax(moved, fabs(step) * sqrt(gPg));
    }
    return moved;
}

/// Sweeps until the multipliers stand still, or this part is over.
static void hildreth(ipe_projection_t* search, const cuts_t* cuts)
{
    for (int step = 0; step < STEPS_OF_PART && search->is_sweeping; step += search->n) {
        const bool stands_still = sweep(search, cuts) < 1e-12;
        search->is_sweeping = !stands_still && ++search->n_sweeps < HILDRETH_SWEEPS;
    }
}

/// (q - theta)^T P^-1 (q - theta) = multipliers^T G P G^T multipliers, since q - theta = P G^T multipliers.
static double moved_by(const ipe_projection_t* search, const cuts_t* cuts, const double theta[IPE_NP])
{
    double sum = 0.0;
    for (int k = 0; k < search->n; ++k) {
        for (int i = 0; i < IPE_NP; ++i) { sum += search->multiplier[k] * cuts->g[k][i] * (search->q[i] - theta[i]); }
    }
    return sum;
}

ipe_status_t ipe_consistency_begin(const double theta[IPE_NP], ipe_projection_t* search)
{
    memset(search, 0, sizeof *search);
    memcpy(search->q, theta, sizeof search->q);
    if (ipe_consistency_check(theta)) { return IPE_OK; }
    if (!all_finite(theta, IPE_NP)) { return IPE_ERR_NONFINITE; }
    search->length = unit_length(theta);
    search->margin =
        MARGIN * (0.5 * fabs(theta[4] + theta[5] + theta[6]) + fabs(theta[0]) * search->length * search->length);
    return IPE_UNFINISHED;
}

ipe_status_t ipe_consistency_go_on(const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], ipe_projection_t* search,
                                   double* distance)
{
    cuts_t cuts = {0};
    if (!search->is_sweeping) {
        search->is_sweeping = search->n < CUTS_MAX && add_cuts(search);
        search->n_sweeps = 0;
    }
    write_out(search, P, &cuts);
    if (search->is_sweeping) {
        hildreth(search, &cuts);
        return IPE_UNFINISHED;
    }
    if (!ipe_consistency_check(search->q) || !all_finite(search->q, IPE_NP)) { return IPE_ERR_NONFINITE; }
    *distance = moved_by(search, &cuts, theta);
    return IPE_OK;
}

bool ipe_consistency_project(const double theta[IPE_NP], const double P[IPE_NP][IPE_NP], double q[IPE_NP],
                             double* distance)
{
    ipe_projection_t search;
    *distance = 0.0;
    ipe_status_t status = ipe_consistency_begin(theta, &search);
    while (status == IPE_UNFINISHED) { status = ipe_consistency_go_on(theta, P, &search, distance); }
    memcpy(q, status == IPE_OK ? search.q : theta, sizeof search.q);
    return status == IPE_OK;
}
