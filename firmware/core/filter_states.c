// SPDX-License-Identifier: Apache-2.0
#include "filter_states.h"

#include "smallmat.h"

#include <stddef.h>
#include <string.h>

#define SMALLEST_STD 1e-12  // any unit: chosen so that D > 0 in the factored filter for what is declared perfect
#define RIDGE 1e-9          // of the trace of the wrench matrix squared, which is singular with fewer than six cables
#define LONGEST_FADE 5.0    // correlation times, after which 0.7 % of wander is left; chosen so that exp() stays normal
#define SMALLEST_LIFT 1e-9  // of the resultant: rounding, not a direction

enum { NO_XI = -1 };

/// The blocks of the filter, in the order of ipe_block_t. To add one: a line here, its name there, its rows below.
static const struct {
    const char* name;
    int count, per_cable;  ///< states: count + per_cable m
    int xi, xi_per_cable;  ///< first column of systematic.h, xi + xi_per_cable m; NO_XI: none
    size_t std;            ///< offset of the prior sigma in ipe_config_t; theta has prior_covariance
} BLOCK[IPE_BLOCKS] = {
#define STD(field) offsetof(ipe_config_t, field)
    [IPE_BLOCK_THETA] = {"theta", IPE_NP, 0, NO_XI, 0, 0},
    [IPE_BLOCK_ATTITUDE] = {"attitude", 3, 0, IPE_XI_ATTITUDE, 0, STD(std_attitude)},
    [IPE_BLOCK_YAW] = {"yaw", 1, 0, IPE_XI_YAW, 0, STD(std_world_yaw)},
    [IPE_BLOCK_ACC_BIAS] = {"acc_bias", 3, 0, IPE_XI_ACC_BIAS, 0, STD(std_acc_bias)},
    [IPE_BLOCK_ALIGNMENT] = {"alignment", 3, 0, IPE_XI_ALIGNMENT, 0, STD(std_imu_alignment)},
    [IPE_BLOCK_POSITION_DELAY] = {"position_delay", 1, 0, IPE_XI_POSITION_DELAY, 0, STD(std_position_delay)},
    [IPE_BLOCK_FORCE_OFFSET] = {"force_offset", 0, 1, IPE_XI_FORCE, 0, STD(std_force_offset)},
    [IPE_BLOCK_FORCE_GAIN] = {"force_gain", 0, 1, IPE_XI_FORCE, 1, STD(std_force_gain)},
    [IPE_BLOCK_PATTERN] = {"pattern", 3 * IPE_PATTERNS, 0, NO_XI, 0, STD(std_geometry)},
    [IPE_BLOCK_WANDER] = {"wander", IPE_WANDERS, 0, IPE_XI_ATTITUDE, 0, STD(std_attitude_wander)},
#undef STD
};

static double prior_std(const ipe_config_t* config, int block)
{
    double std;
    memcpy(&std, (const char*)config + BLOCK[block].std, sizeof std);
    return fmax(std, SMALLEST_STD);
}

static void lay_out(ipe_filter_layout_t* layout, int n_cables)
{
    layout->n = 0;
    for (int b = 0; b < IPE_BLOCKS; ++b) {
        layout->first[b] = layout->n;
        layout->count[b] = BLOCK[b].count + BLOCK[b].per_cable * n_cables;
        layout->n += layout->count[b];
    }
}

void ipe_filter_states_init(ipe_filter_states_t* s, const ipe_config_t* config)
{
    memset(s, 0, sizeof *s);
    lay_out(&s->layout, config->n_cables);
}

const char* ipe_filter_states_name(ipe_block_t block)
{
    return BLOCK[block].name;
}

void ipe_filter_states_std(const ipe_filter_layout_t* layout, const ipe_config_t* config,
                           double std[IPE_NX_MAX - IPE_NP])
{
    for (int b = IPE_BLOCK_THETA + 1; b < IPE_BLOCKS; ++b) {
        double* of_block = std + layout->first[b] - IPE_NP;
        for (int i = 0; i < layout->count[b]; ++i) { of_block[i] = prior_std(config, b); }
    }
}

void ipe_filter_states_predict(ipe_filter_states_t* s, const ipe_config_t* config, int64_t t_ns, ipe_rls_t* rls)
{
    const int first = s->layout.first[IPE_BLOCK_WANDER], end = first + s->layout.count[IPE_BLOCK_WANDER];
    if (s->t_ns != 0) {
        const double elapsed = 1e-9 * (double)(t_ns - s->t_ns) / IPE_WANDER_TIME;
        const double fade = exp(-fmin(fmax(elapsed, 0.0), LONGEST_FADE));
        const double std = prior_std(config, IPE_BLOCK_WANDER);
        for (int i = first; i < end; ++i) {
            ipe_rls_fade(rls, i, fade);
            ipe_rls_loosen(rls, i, std * std * (1.0 - fade * fade));
        }
    }
    s->t_ns = t_ns;
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
    const double least = SMALLEST_LIFT * vec3_norm(up);
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

/// -G: the moment of c_k, minus sum_i pattern_k,i (c_k x F_i).
static void pattern_columns(const ipe_filter_states_t* s, const double F[IPE_CABLES_MAX][3], int m, double* H)
{
    const int n = s->layout.n, first = s->layout.first[IPE_BLOCK_PATTERN];
    for (int column = 0; column < s->layout.count[IPE_BLOCK_PATTERN]; ++column) {
        double pull[3] = {0.0}, unit[3] = {0.0}, moment[3];
        for (int i = 0; i < m; ++i) { vec3_axpy(pull, s->pattern[column / 3][i], F[i], pull); }
        unit[column % 3] = 1.0;
        vec3_cross(unit, pull, moment);
        for (int j = 0; j < 3; ++j) {
            H[j * n + first + column] = 0.0;
            H[(3 + j) * n + first + column] = -moment[j];
        }
    }
}

/// -X: the columns of the blocks that have a place in systematic.h.
static void systematic_columns(const ipe_filter_layout_t* layout, const double X[IPE_NY][IPE_XI_MAX], int m, double* H)
{
    for (int b = 0; b < IPE_BLOCKS; ++b) {
        if (BLOCK[b].xi == NO_XI) { continue; }
        const int xi = BLOCK[b].xi + BLOCK[b].xi_per_cable * m;
        for (int j = 0; j < IPE_NY; ++j) {
            double* row = H + j * layout->n + layout->first[b];
            for (int i = 0; i < layout->count[b]; ++i) { row[i] = -X[j][xi + i]; }
        }
    }
}

void ipe_filter_states_rows(ipe_filter_states_t* s, const ipe_config_t* config, const double Y[IPE_NY][IPE_NP],
                            const double X[IPE_NY][IPE_XI_MAX], double* H)
{
    const int m = config->n_cables;
    double F[IPE_CABLES_MAX][3];
    for (int j = 0; j < IPE_NY; ++j) { memcpy(H + j * s->layout.n, Y[j], sizeof Y[j]); }
    systematic_columns(&s->layout, X, m, H);
    cable_forces(config, X, F);
    if (!s->has_patterns) { choose_patterns(s, (const double (*)[3])F, m); }
    s->has_patterns = true;
    pattern_columns(s, (const double (*)[3])F, m, H);
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

void ipe_filter_states_denoise_gain_columns(const ipe_filter_states_t* s, const double f[IPE_CABLES_MAX],
                                            const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                                            const double L[IPE_NY][IPE_NY], double* H)
{
    const ipe_filter_layout_t* at = &s->layout;
    const int n = at->n, m = at->count[IPE_BLOCK_FORCE_GAIN];
    const int offset = at->first[IPE_BLOCK_FORCE_OFFSET], gain = at->first[IPE_BLOCK_FORCE_GAIN];
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
        double denoised = f[k];
        for (int j = 0; j < IPE_NY; ++j) { denoised -= H[j * n + offset + k] * noise[j]; }
        for (int j = 0; j < IPE_NY; ++j) { H[j * n + gain + k] = H[j * n + offset + k] * denoised; }
    }
}
