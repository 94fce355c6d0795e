// SPDX-License-Identifier: Apache-2.0
#include "filter_states.h"

#include "motion.h"
#include "smallmat.h"

#include <stddef.h>
#include <string.h>

#define IMPLAUSIBLE 3.0     // sigmas: one correct declaration in 400 is beyond
#define LEAST_TOLD 0.01     // of the prior's variance: chosen so that the model's own errors do not pass for a state
#define RIDGE 1e-9          // of the trace of the wrench matrix squared, which is singular with fewer than six cables
#define LONGEST_FADE 5.0    // correlation times, after which 0.7 % of wander is left; chosen so that exp() stays normal
#define SMALLEST_STD 1e-12  // rad, of a wander: chosen so that D > 0 in the factored filter
#define SMALLEST_TIME 0.1   // s, of a wander: chosen under any attitude filter's
#define SMALLEST_LIFT 1e-9  // of the resultant: rounding, not a direction

enum { NO_XI = -1 };

/// How a block's columns come from those of systematic.h.
typedef enum { OWN, AS_THEY_ARE, ZERO_SUM, SUMMED } ipe_columns_t;

/// The blocks of the filter, in the order of ipe_block_t. To add one: a line here, its name there, its rows below.
static const struct {
    const char* name;
    int count, per_cable;  ///< states: count + per_cable m
    ipe_columns_t columns;
    int xi, xi_per_cable;  ///< first column of systematic.h, xi + xi_per_cable m, and offset of its prior sigma
    size_t std;            ///< OWN: offset of the prior sigma in ipe_config_t; theta has prior_covariance
} BLOCK[IPE_BLOCKS] = {
#define STD(field) offsetof(ipe_config_t, field)
    [IPE_BLOCK_THETA] = {"theta", IPE_NP, 0, OWN, 0, 0, 0},
    [IPE_BLOCK_ATTITUDE] = {"attitude", 3, 0, AS_THEY_ARE, IPE_XI_ATTITUDE, 0, 0},
    [IPE_BLOCK_YAW] = {"yaw", 1, 0, AS_THEY_ARE, IPE_XI_YAW, 0, 0},
    [IPE_BLOCK_ACC_BIAS] = {"acc_bias", 3, 0, AS_THEY_ARE, IPE_XI_ACC_BIAS, 0, 0},
    [IPE_BLOCK_ALIGNMENT] = {"alignment", 3, 0, AS_THEY_ARE, IPE_XI_ALIGNMENT, 0, 0},
    [IPE_BLOCK_POSITION_DELAY] = {"position_delay", 1, 0, AS_THEY_ARE, IPE_XI_POSITION_DELAY, 0, 0},
    [IPE_BLOCK_FORCE_DELAY] = {"force_delay", 1, 0, AS_THEY_ARE, IPE_XI_FORCE_DELAY, 0, 0},
    [IPE_BLOCK_ATTITUDE_DELAY] = {"attitude_delay", 1, 0, AS_THEY_ARE, IPE_XI_ATTITUDE_DELAY, 0, 0},
    [IPE_BLOCK_IMU_POSITION] = {"imu_position", 3, 0, AS_THEY_ARE, IPE_XI_IMU_POSITION, 0, 0},
    [IPE_BLOCK_TRACKER_TARGET] = {"tracker_target", 3, 0, AS_THEY_ARE, IPE_XI_TRACKER_TARGET, 0, 0},
    [IPE_BLOCK_CABLE_INERTIA] = {"cable_inertia", 1, 0, AS_THEY_ARE, IPE_XI_CABLE_INERTIA, 0, 0},
    [IPE_BLOCK_FORCE_OFFSET] = {"force_offset", 0, 1, AS_THEY_ARE, IPE_XI_FORCE, 0, 0},
    [IPE_BLOCK_FORCE_GAIN] = {"force_gain", -1, 1, ZERO_SUM, IPE_XI_FORCE, 1, 0},
    [IPE_BLOCK_FRICTION] = {"friction", 1, 0, SUMMED, IPE_XI_FORCE, 2, 0},
    [IPE_BLOCK_PATTERN] = {"pattern", 3 * IPE_PATTERNS, 0, OWN, 0, 0, STD(std_geometry)},
    [IPE_BLOCK_WANDER] = {"wander", IPE_WANDERS, 0, OWN, 0, 0, STD(std_attitude_wander)},
#undef STD
};

static int first_xi(int block, int n_cables)
{
    return BLOCK[block].xi + BLOCK[block].xi_per_cable * n_cables;
}

/// One sigma of a block's states before any data; 0: the block is not there.
static double prior_std(const ipe_config_t* config, int block)
{
    double of_xi[IPE_XI_MAX], std;
    if (BLOCK[block].std == 0) {
        ipe_systematic_std(config, of_xi);
        return of_xi[first_xi(block, config->n_cables)];
    }
    memcpy(&std, (const char*)config + BLOCK[block].std, sizeof std);
    // An attitude that is estimated has an error whatever the AHRS's is; its sigma comes with every window.
    return block == IPE_BLOCK_WANDER && ipe_motion_is_fused(config) ? fmax(std, SMALLEST_STD) : std;
}

static void lay_out(ipe_filter_layout_t* layout, const ipe_config_t* config)
{
    layout->n = 0;
    for (int b = 0; b < IPE_BLOCKS; ++b) {
        const bool is_there = b == IPE_BLOCK_THETA || prior_std(config, b) > 0.0;
        layout->first[b] = layout->n;
        layout->count[b] = is_there ? BLOCK[b].count + BLOCK[b].per_cable * config->n_cables : 0;
        layout->n += layout->count[b];
    }
}

/// An orthonormal basis of what sums to zero (Helmert): k + 1 equal ones, then minus their sum.
static void choose_gain_basis(int m, double basis[IPE_CABLES_MAX - 1][IPE_CABLES_MAX])
{
    for (int k = 0; k < m - 1; ++k) {
        const double norm = 1.0 / sqrt((k + 1.0) * (k + 2.0));
        for (int i = 0; i <= k; ++i) { basis[k][i] = norm; }
        basis[k][k + 1] = -(k + 1.0) * norm;
    }
}

void ipe_filter_states_init(ipe_filter_states_t* s, const ipe_config_t* config)
{
    memset(s, 0, sizeof *s);
    lay_out(&s->layout, config);
    choose_gain_basis(config->n_cables, s->gain_basis);
    for (int b = IPE_BLOCK_THETA + 1; b < IPE_BLOCKS; ++b) { s->std[b] = prior_std(config, b); }
}

const char* ipe_filter_states_name(ipe_block_t block)
{
    return BLOCK[block].name;
}

void ipe_filter_states_std(const ipe_filter_states_t* s, double std[IPE_NX_MAX - IPE_NP])
{
    for (int b = IPE_BLOCK_THETA + 1; b < IPE_BLOCKS; ++b) {
        double* of_block = std + s->layout.first[b] - IPE_NP;
        for (int i = 0; i < s->layout.count[b]; ++i) { of_block[i] = s->std[b]; }
    }
}

/// The estimate of state i by the data alone, if its prior 0 +- std makes it implausible, else 0. Under the prior the
/// estimate x has the variance std^2 - P; without it the estimate would be x std^2/(std^2 - P).
static double implausible_value(const ipe_rls_t* rls, int i, double std)
{
    const double x = rls->x[i], told = std * std - ipe_rls_covariance_of(rls, i, i);
    const bool is_told = told > LEAST_TOLD * std * std;
    return is_told && x * x > IMPLAUSIBLE * IMPLAUSIBLE * told ? fabs(x) * std * std / told : 0.0;
}

void ipe_filter_states_widen(ipe_filter_states_t* s, ipe_rls_t* rls)
{
    const ipe_block_t of_unsure_prior[] = {IPE_BLOCK_POSITION_DELAY, IPE_BLOCK_FORCE_DELAY,    IPE_BLOCK_ATTITUDE_DELAY,
                                           IPE_BLOCK_IMU_POSITION,   IPE_BLOCK_TRACKER_TARGET, IPE_BLOCK_FRICTION};
    for (size_t k = 0; k < sizeof of_unsure_prior / sizeof of_unsure_prior[0]; ++k) {
        const ipe_block_t b = of_unsure_prior[k];
        const int first = s->layout.first[b], end = first + s->layout.count[b];
        double wider = 0.0;
        for (int i = first; i < end; ++i) { wider = fmax(wider, implausible_value(rls, i, s->std[b])); }
        if (wider <= s->std[b]) { continue; }
        for (int i = first; i < end; ++i) { ipe_rls_widen_prior(rls, i, s->std[b], wider); }
        s->std[b] = wider;
    }
}

static void predict_wander(const ipe_filter_states_t* s, const ipe_average_t* average, double elapsed, ipe_rls_t* rls)
{
    const int first = s->layout.first[IPE_BLOCK_WANDER], count = s->layout.count[IPE_BLOCK_WANDER];
    for (int i = 0; i < count; ++i) {
        const double time = fmax(average->error.attitude_time[i], SMALLEST_TIME);
        const double fade = s->t_ns == 0 ? 1.0 : exp(-fmin(fmax(elapsed / time, 0.0), LONGEST_FADE));
        const double std = fmax(average->error.attitude_std[i], SMALLEST_STD), known = ipe_rls_std(rls, first + i);
        const double start = s->t_ns == 0 ? fmax(std * std - known * known, 0.0) : 0.0;
        ipe_rls_fade(rls, first + i, fade);
        ipe_rls_loosen(rls, first + i, start + std * std * (1.0 - fade * fade));
    }
}

static void predict_offsets(const ipe_filter_states_t* s, const ipe_config_t* config, double elapsed, ipe_rls_t* rls)
{
    const int first = s->layout.first[IPE_BLOCK_FORCE_OFFSET], end = first + s->layout.count[IPE_BLOCK_FORCE_OFFSET];
    const double drift = config->std_force_offset_drift;
    for (int i = first; i < end && drift > 0.0; ++i) { ipe_rls_loosen(rls, i, drift * drift * elapsed); }
}

void ipe_filter_states_predict(ipe_filter_states_t* s, const ipe_config_t* config, const ipe_average_t* average,
                               ipe_rls_t* rls)
{
    if (s->t_ns == 0) { s->drifted_ns = average->t_ns; }
    const double since_drift = 1e-9 * (double)(average->t_ns - s->drifted_ns);
    predict_wander(s, average, 1e-9 * (double)(average->t_ns - s->t_ns), rls);
    if (since_drift < 0.0 || since_drift >= IPE_DRIFT_INTERVAL) {
        predict_offsets(s, config, fmax(since_drift, 0.0), rls);
        s->drifted_ns = average->t_ns;
    }
    s->t_ns = average->t_ns;
}

double ipe_filter_states_common_gain_std(const ipe_config_t* config)
{
    return config->std_force_gain / sqrt((double)config->n_cables);
}

/// Gains [m] and their sigmas from the zero-sum states and the common gain's sigma.
static void read_gains(const ipe_filter_states_t* s, const ipe_config_t* config, const ipe_rls_t* rls, double* value,
                       double* sigma)
{
    const int first = s->layout.first[IPE_BLOCK_FORCE_GAIN], m = config->n_cables;
    const double common = ipe_filter_states_common_gain_std(config);
    for (int i = 0; i < m; ++i) { sigma[i] = common * common; }
    for (int k = 0; k < m - 1; ++k) {
        for (int i = 0; i < m; ++i) { value[i] += s->gain_basis[k][i] * rls->x[first + k]; }
        for (int l = 0; l <= k; ++l) {
            const double covariance = (l < k ? 2.0 : 1.0) * ipe_rls_covariance_of(rls, first + k, first + l);
            for (int i = 0; i < m; ++i) { sigma[i] += s->gain_basis[k][i] * s->gain_basis[l][i] * covariance; }
        }
    }
    for (int i = 0; i < m; ++i) { sigma[i] = sqrt(sigma[i]); }
}

void ipe_filter_states_systematic(const ipe_filter_states_t* s, const ipe_config_t* config, const ipe_rls_t* rls,
                                  double xi[IPE_XI_MAX], double std[IPE_XI_MAX])
{
    const ipe_filter_layout_t* at = &s->layout;
    const int m = config->n_cables;
    memset(xi, 0, IPE_XI_MAX * sizeof xi[0]);
    memset(std, 0, IPE_XI_MAX * sizeof std[0]);
    for (int b = IPE_BLOCK_THETA + 1; b < IPE_BLOCK_PATTERN; ++b) {
        double* value = xi + first_xi(b, m);
        double* sigma = std + first_xi(b, m);
        for (int i = 0; i < at->count[b] && BLOCK[b].columns == AS_THEY_ARE; ++i) {
            value[i] = rls->x[at->first[b] + i];
            sigma[i] = ipe_rls_std(rls, at->first[b] + i);
        }
        if (at->count[b] == 0) { continue; }
        if (BLOCK[b].columns == ZERO_SUM) { read_gains(s, config, rls, value, sigma); }
        for (int i = 0; i < m && BLOCK[b].columns == SUMMED; ++i) {
            value[i] = rls->x[at->first[b]];
            sigma[i] = ipe_rls_std(rls, at->first[b]);
        }
    }
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

/// One row of a block, -X, from the row X of its columns in systematic.h.
static void row_of_block(const ipe_filter_states_t* s, ipe_columns_t columns, const double* X, int count, int m,
                         double* row)
{
    for (int k = 0; k < count; ++k) {
        row[k] = 0.0;
        if (columns == AS_THEY_ARE) { row[k] = -X[k]; }
        for (int i = 0; i < m && columns == ZERO_SUM; ++i) { row[k] -= s->gain_basis[k][i] * X[i]; }
        for (int i = 0; i < m && columns == SUMMED; ++i) { row[k] -= X[i]; }
    }
}

/// -X: the columns of the blocks that have a place in systematic.h.
static void systematic_columns(const ipe_filter_states_t* s, const double X[IPE_NY][IPE_XI_MAX], int m, double* H)
{
    for (int b = 0; b < IPE_BLOCKS; ++b) {
        if (BLOCK[b].columns == OWN) { continue; }
        for (int j = 0; j < IPE_NY; ++j) {
            row_of_block(s, BLOCK[b].columns, X[j] + first_xi(b, m), s->layout.count[b], m,
                         H + j * s->layout.n + s->layout.first[b]);
        }
    }
}

/// Wander turns about the axes of W.
static void wander_columns(const ipe_filter_layout_t* layout, const double R[3][3], const double X[IPE_NY][IPE_XI_MAX],
                           double* H)
{
    for (int j = 0; j < IPE_NY; ++j) {
        double* row = H + j * layout->n + layout->first[IPE_BLOCK_WANDER];
        for (int i = 0; i < layout->count[IPE_BLOCK_WANDER]; ++i) { row[i] = -vec3_dot(&X[j][IPE_XI_ATTITUDE], R[i]); }
    }
}

void ipe_filter_states_rows(ipe_filter_states_t* s, const ipe_config_t* config, const double R[3][3],
                            const double Y[IPE_NY][IPE_NP], const double X[IPE_NY][IPE_XI_MAX], double* H)
{
    const int m = config->n_cables;
    double F[IPE_CABLES_MAX][3];
    for (int j = 0; j < IPE_NY; ++j) { memcpy(H + j * s->layout.n, Y[j], sizeof Y[j]); }
    systematic_columns(s, X, m, H);
    wander_columns(&s->layout, R, X, H);
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

void ipe_filter_states_denoise_gain_columns(const ipe_filter_states_t* s, const double X[IPE_NY][IPE_XI_MAX],
                                            const double f[IPE_CABLES_MAX], const double innovation[IPE_NY],
                                            const double S[IPE_NY][IPE_NY], const double L[IPE_NY][IPE_NY], double* H)
{
    const int n = s->layout.n, first = s->layout.first[IPE_BLOCK_FORCE_GAIN];
    const int n_gains = s->layout.count[IPE_BLOCK_FORCE_GAIN], m = n_gains + 1;
    double noise[IPE_NY], B[IPE_NY][IPE_NY] = {{0.0}}, trace = 0.0, denoised[IPE_CABLES_MAX];
    if (n_gains == 0 || !noise_part(innovation, S, L, noise)) { return; }
    for (int i = 0; i < IPE_NY; ++i) {  // the wrench of a tension is minus its offset's column
        for (int j = 0; j < IPE_NY; ++j) {
            for (int k = 0; k < m; ++k) { B[i][j] += X[i][IPE_XI_FORCE + k] * X[j][IPE_XI_FORCE + k]; }
        }
        trace += B[i][i];
    }
    for (int i = 0; i < IPE_NY; ++i) { B[i][i] += RIDGE * trace; }
    if (!cholesky(&B[0][0], IPE_NY)) { return; }
    cholesky_solve(&B[0][0], IPE_NY, noise, noise);
    for (int k = 0; k < m; ++k) {
        denoised[k] = f[k];
        for (int j = 0; j < IPE_NY; ++j) { denoised[k] += X[j][IPE_XI_FORCE + k] * noise[j]; }
    }
    for (int j = 0; j < IPE_NY; ++j) {
        double of_gain[IPE_CABLES_MAX];
        for (int k = 0; k < m; ++k) { of_gain[k] = X[j][IPE_XI_FORCE + k] * denoised[k]; }
        row_of_block(s, ZERO_SUM, of_gain, n_gains, m, H + j * n + first);
    }
}
