// SPDX-License-Identifier: Apache-2.0
#include "filter_states.h"

#include "smallmat.h"

#include <string.h>

#define SMALLEST_STD 1e-12  // of what is declared perfect: the factored filter needs D > 0
#define RIDGE 1e-9          // of the wrench matrix squared: with fewer cables than six it is singular
#define LONGEST_FADE 5.0    // correlation times: more is forgotten anyway

enum { PATTERN_STATES = 3 * IPE_PATTERNS, WANDER_STATES = 3 };

static int pattern_at(int n_cables)
{
    return IPE_NP + ipe_systematic_filter_count(n_cables);
}

static int wander_at(int n_cables)
{
    return pattern_at(n_cables) + PATTERN_STATES;
}

int ipe_filter_states_count(int n_cables)
{
    return wander_at(n_cables) + WANDER_STATES;
}

void ipe_filter_states_std(const ipe_config_t* config, double std[IPE_NX_MAX - IPE_NP])
{
    double all[IPE_XI_MAX];
    const int n_xi = ipe_systematic_filter_count(config->n_cables);
    ipe_systematic_std(config, all);
    memcpy(std, all, sizeof(double) * (size_t)n_xi);
    for (int i = 0; i < PATTERN_STATES; ++i) { std[n_xi + i] = config->std_geometry; }
    for (int i = 0; i < WANDER_STATES; ++i) { std[n_xi + PATTERN_STATES + i] = config->std_attitude_wander; }
    for (int i = 0; i < n_xi + PATTERN_STATES + WANDER_STATES; ++i) { std[i] = fmax(std[i], SMALLEST_STD); }
}

void ipe_filter_states_init(ipe_filter_states_t* s)
{
    memset(s, 0, sizeof *s);
}

/// Force of each cable, P axes, N: its gain column is that force.
static void cable_forces(const ipe_config_t* config, const double X[IPE_NY][IPE_XI_MAX], double F[IPE_CABLES_MAX][3])
{
    const int m = config->n_cables;
    for (int i = 0; i < m; ++i) {
        for (int j = 0; j < 3; ++j) { F[i][j] = -(1.0 + config->force_gain[i]) * X[j][IPE_XI_FORCE + m + i]; }
    }
}

/// Take the part along unit vector b [n] out of a [n].
static void remove_part(double* a, const double* b, int n)
{
    double along = 0.0;
    for (int i = 0; i < n; ++i) { along += a[i] * b[i]; }
    for (int i = 0; i < n; ++i) { a[i] -= along * b[i]; }
}

/// a [n] to unit length, or to zero where there is next to nothing of it.
static void normalise(double* a, int n, double least)
{
    double square = 0.0;
    for (int i = 0; i < n; ++i) { square += a[i] * a[i]; }
    const double scale = square > least * least ? 1.0 / sqrt(square) : 0.0;
    for (int i = 0; i < n; ++i) { a[i] *= scale; }
}

/// Two directions across unit vector up.
static void across(const double up[3], double first[3], double second[3])
{
    const double axis[3] = {fabs(up[0]) < 0.7 ? 1.0 : 0.0, fabs(up[0]) < 0.7 ? 0.0 : 1.0, 0.0};
    vec3_cross(up, axis, first);
    normalise(first, 3, 0.0);
    vec3_cross(up, first, second);
}

/// The cables' shares of the pull along the resultant and across it, orthonormal; the first is left out.
static void choose_patterns(ipe_filter_states_t* s, const double F[IPE_CABLES_MAX][3], int m)
{
    double up[3] = {0.0}, direction[IPE_PATTERNS][3], lift[IPE_CABLES_MAX];
    for (int i = 0; i < m; ++i) { vec3_axpy(up, 1.0, F[i], up); }
    const double least = 1e-9 * vec3_norm(up);
    normalise(up, 3, 0.0);
    across(up, direction[0], direction[1]);
    for (int i = 0; i < m; ++i) {
        lift[i] = vec3_dot(F[i], up);
        for (int k = 0; k < IPE_PATTERNS; ++k) { s->pattern[k][i] = vec3_dot(F[i], direction[k]); }
    }
    normalise(lift, m, least);
    for (int k = 0; k < IPE_PATTERNS; ++k) {
        remove_part(s->pattern[k], lift, m);
        if (k > 0) { remove_part(s->pattern[k], s->pattern[0], m); }
        normalise(s->pattern[k], m, least);
    }
}

/// -G: what c_k does to the moment, minus sum_i pattern_k,i (c_k x F_i).
static void pattern_columns(const ipe_filter_states_t* s, const double F[IPE_CABLES_MAX][3], int m, int at, int n,
                            double* H)
{
    for (int k = 0; k < IPE_PATTERNS; ++k) {
        double pull[3] = {0.0};
        for (int i = 0; i < m; ++i) { vec3_axpy(pull, s->pattern[k][i], F[i], pull); }
        for (int axis = 0; axis < 3; ++axis) {
            double unit[3] = {0.0}, moment[3];
            unit[axis] = 1.0;
            vec3_cross(unit, pull, moment);
            for (int j = 0; j < 3; ++j) {
                H[j * n + at + 3 * k + axis] = 0.0;
                H[(3 + j) * n + at + 3 * k + axis] = -moment[j];
            }
        }
    }
}

void ipe_filter_states_rows(ipe_filter_states_t* s, const ipe_config_t* config, const double Y[IPE_NY][IPE_NP],
                            const double X[IPE_NY][IPE_XI_MAX], double* H)
{
    const int m = config->n_cables, n = ipe_filter_states_count(m), n_xi = ipe_systematic_filter_count(m);
    double F[IPE_CABLES_MAX][3];
    for (int j = 0; j < IPE_NY; ++j) {
        double* row = H + j * n;
        memcpy(row, Y[j], sizeof Y[j]);
        for (int i = 0; i < n_xi; ++i) { row[IPE_NP + i] = -X[j][i]; }
        for (int i = 0; i < WANDER_STATES; ++i) { row[wander_at(m) + i] = -X[j][IPE_XI_ATTITUDE + i]; }
    }
    cable_forces(config, X, F);
    if (s->t_ns == 0) { choose_patterns(s, F, m); }
    pattern_columns(s, F, m, pattern_at(m), n, H);
}

/// The part of the innovation that is noise: V (S + V)^-1 innovation, V = L L^T. False if S + V is not positive definite.
static bool noise_part(const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY], const double L[IPE_NY][IPE_NY],
                       double noise[IPE_NY])
{
    double V[IPE_NY][IPE_NY] = {{0.0}}, A[IPE_NY][IPE_NY], weighted[IPE_NY];
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NY; ++j) {
            for (int k = 0; k <= (i < j ? i : j); ++k) { V[i][j] += L[i][k] * L[j][k]; }
            A[i][j] = S[i][j] + V[i][j];
        }
    }
    if (!cholesky(&A[0][0], IPE_NY)) { return false; }
    cholesky_solve(&A[0][0], IPE_NY, innovation, weighted);
    for (int i = 0; i < IPE_NY; ++i) {
        noise[i] = 0.0;
        for (int j = 0; j < IPE_NY; ++j) { noise[i] += V[i][j] * weighted[j]; }
    }
    return true;
}

void ipe_filter_states_denoise_gain_columns(const ipe_config_t* config, const double f[IPE_CABLES_MAX],
                                            const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                                            const double L[IPE_NY][IPE_NY], double* H)
{
    const int m = config->n_cables, n = ipe_filter_states_count(m), offset = IPE_NP + IPE_XI_FORCE, gain = offset + m;
    double noise[IPE_NY], B[IPE_NY][IPE_NY] = {{0.0}}, trace = 0.0;
    if (!noise_part(innovation, S, L, noise)) { return; }
    for (int i = 0; i < IPE_NY; ++i) {  // the wrench of a tension is its offset's column
        for (int j = 0; j < IPE_NY; ++j) {
            for (int k = 0; k < m; ++k) { B[i][j] += H[i * n + offset + k] * H[j * n + offset + k]; }
        }
        trace += B[i][i];
    }
    for (int i = 0; i < IPE_NY; ++i) { B[i][i] += RIDGE * trace; }
    if (!cholesky(&B[0][0], IPE_NY)) { return; }
    cholesky_solve(&B[0][0], IPE_NY, noise, noise);
    for (int k = 0; k < m; ++k) {
        double quiet = f[k];
        for (int j = 0; j < IPE_NY; ++j) { quiet -= H[j * n + offset + k] * noise[j]; }
        for (int j = 0; j < IPE_NY; ++j) { H[j * n + gain + k] = H[j * n + offset + k] * quiet; }
    }
}

void ipe_filter_states_advance(ipe_filter_states_t* s, const ipe_config_t* config, int64_t t_ns, ipe_rls_t* rls)
{
    if (s->t_ns != 0) {
        const double elapsed = 1e-9 * (double)(t_ns - s->t_ns) / IPE_WANDER_TIME;
        const double fade = exp(-fmin(fmax(elapsed, 0.0), LONGEST_FADE));
        const double std = fmax(config->std_attitude_wander, SMALLEST_STD);
        for (int i = wander_at(config->n_cables); i < rls->n; ++i) {
            ipe_rls_fade(rls, i, fade);
            ipe_rls_loosen(rls, i, std * std * (1.0 - fade * fade));
        }
    }
    s->t_ns = t_ns;
}
