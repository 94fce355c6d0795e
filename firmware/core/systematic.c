// SPDX-License-Identifier: Apache-2.0
#include "systematic.h"

#include "motion.h"
#include "regressor.h"
#include "smallmat.h"
#include "wrench.h"

#include <assert.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

static_assert(IPE_XI_FORCE == IPE_XI_FORCE_LOWPASS + 1, "the table and the numbers in systematic.h agree");

#define STEP 1e-4  // m and rad of the central differences: error 1e-8 relative by truncation, 1e-11 by rounding

#define CABLE_INERTIA_STD \
    0.5  // share: chosen so that cables without inertia, and at half their first mode, are 2 sigma off

#define FORCE_LOWPASS_STD \
    2e-5  // s2: of a Bessel filter of 20 Hz and order 4, (delay)^2/14; chosen as what amplifiers have

#define KIND(name, unit, count, count_per_cable, field, is_ahrs_only) \
    {name, unit, count, count_per_cable, offsetof(ipe_config_t, field), is_ahrs_only}
#define NOT_CONFIGURED SIZE_MAX  // fixed_std() has it

static const ipe_systematic_kind_t kinds[] = {
    KIND("attitude_bias", "rad", 3, 0, std_attitude, true),
    KIND("world_yaw", "rad", 1, 0, std_world_yaw, false),
    KIND("acc_bias", "m/s2", 3, 0, std_acc_bias, false),
    KIND("imu_alignment", "rad", 3, 0, std_imu_alignment, false),
    KIND("position_delay", "s", 1, 0, std_position_delay, false),
    KIND("force_delay", "s", 1, 0, std_force_delay, false),
    KIND("attitude_delay", "s", 1, 0, std_attitude_delay, true),
    KIND("imu_position", "m", 3, 0, std_imu_position, false),
    KIND("tracker_target", "m", 3, 0, std_tracker_target, false),
    KIND("acc_scale", "1", 1, 0, std_acc_scale, true),
    KIND("gyro_scale", "1", 1, 0, std_gyro_scale, true),
    KIND("gyro_bias", "rad/s", 3, 0, std_gyro_bias, true),
    {"cable_inertia", "1", 1, 0, NOT_CONFIGURED, false},
    KIND("external_force", "N", 3, 0, std_external_force, false),
    KIND("external_stiffness", "N/m", 3, 0, std_external_stiffness, false),
    {"force_lowpass", "s2", 1, 0, NOT_CONFIGURED, false},
    KIND("force_offset", "N", 0, 1, std_force_offset, false),
    KIND("force_gain", "1", 0, 1, std_force_gain, false),
    KIND("friction", "1", 0, 1, std_friction, false),
};
enum { N_KINDS = (int)(sizeof kinds / sizeof kinds[0]) };

const ipe_systematic_kind_t* ipe_systematic_table(int* n)
{
    *n = N_KINDS;
    return kinds;
}

int ipe_systematic_count(int n_cables)
{
    return IPE_XI_FORCE + 3 * n_cables;
}

int ipe_systematic_planned_count(int n_cables)
{
    return IPE_XI_FORCE + 2 * n_cables;
}

void ipe_systematic_name(int n_cables, int index, char name[IPE_SYSTEMATIC_NAME_MAX])
{
    const ipe_systematic_kind_t* kind = kinds;
    int n;
    while (index >= (n = kind->count + kind->count_per_cable * n_cables)) { index -= n, ++kind; }
    if (kind->count_per_cable > 0) {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s_%d", kind->name, (index + 1) % 100);
    } else if (n == 3) {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s_%c", kind->name, "xyz"[index]);
    } else {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s", kind->name);
    }
}

/// 0 where no cable has weight.
static double cable_inertia_std(const ipe_config_t* config)
{
    for (int i = 0; i < config->n_cables; ++i) {
        if (config->cable[i].weight_per_length > 0.0) { return CABLE_INERTIA_STD; }
    }
    return 0.0;
}

/// Of a kind that no key declares.
static double fixed_std(const ipe_config_t* config, const ipe_systematic_kind_t* kind)
{
    return strcmp(kind->name, "force_lowpass") == 0 ? FORCE_LOWPASS_STD : cable_inertia_std(config);
}

void ipe_systematic_std(const ipe_config_t* config, double std[IPE_XI_MAX])
{
    for (const ipe_systematic_kind_t* kind = kinds; kind < kinds + N_KINDS; ++kind) {
        double sigma = fixed_std(config, kind);
        if (kind->std != NOT_CONFIGURED) { memcpy(&sigma, (const char*)config + kind->std, sizeof sigma); }
        if (kind->is_ahrs_only && ipe_motion_is_fused(config)) { sigma = 0.0; }
        for (int n = kind->count + kind->count_per_cable * config->n_cables; n > 0; --n) { *std++ = sigma; }
    }
}

/// Cable wrench at the window's tensions with the pose moved by dp (W) and turned by the body rotation vector turn
/// about the tracked point.
static ipe_status_t moved_wrench(const ipe_config_t* config, const ipe_average_t* a, const double dp[3],
                                 const double turn[3], double y[IPE_NY])
{
    double turned[3][3], R[3][3], before[3], after[3], p[3], W[IPE_NY][IPE_CABLES_MAX];
    mat3_exp(turn, turned);
    mat3_mul(a->R, turned, R);
    mat3_mul_vec(a->R, config->tracker_target, before);
    mat3_mul_vec(R, config->tracker_target, after);
    for (int i = 0; i < 3; ++i) { p[i] = a->p[i] + dp[i] + before[i] - after[i]; }
    if (ipe_wrench_matrix(config, p, R, config->imu_position, W, y) != IPE_OK) { return IPE_ERR_GEOMETRY; }
    for (int i = 0; i < config->n_cables; ++i) {
        for (int j = 0; j < IPE_NY; ++j) { y[j] += W[j][i] * a->f[i]; }
    }
    return IPE_OK;
}

/// slope [6][3] of the wrench with respect to position (W), or to attitude (body rotation about the tracked point).
static ipe_status_t pose_slope(const ipe_config_t* config, const ipe_average_t* a, bool of_attitude,
                               double slope[IPE_NY][3])
{
    const double none[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < 3; ++i) {
        double step[3] = {0.0, 0.0, 0.0}, back[3] = {0.0, 0.0, 0.0}, y_plus[IPE_NY], y_minus[IPE_NY];
        step[i] = STEP, back[i] = -STEP;
        const double* turn = of_attitude ? step : none;
        const double* turn_back = of_attitude ? back : none;
        if (moved_wrench(config, a, of_attitude ? none : step, turn, y_plus) != IPE_OK ||
            moved_wrench(config, a, of_attitude ? none : back, turn_back, y_minus) != IPE_OK) {
            return IPE_ERR_GEOMETRY;
        }
        for (int j = 0; j < IPE_NY; ++j) { slope[j][i] = (y_plus[j] - y_minus[j]) / (2.0 * STEP); }
    }
    return IPE_OK;
}

static void put_column(double X[IPE_NY][IPE_XI_MAX], int at, const double column[IPE_NY])
{
    for (int j = 0; j < IPE_NY; ++j) { X[j][at] = column[j]; }
}

static void pose_columns(const ipe_config_t* config, const ipe_average_t* a, double by_position[IPE_NY][3],
                         double by_attitude[IPE_NY][3], double X[IPE_NY][IPE_XI_MAX])
{
    double arm[3], rate_arm[3], velocity[3];
    vec3_cross(a->w, config->tracker_target, rate_arm);
    mat3_mul_vec(a->R, rate_arm, arm);
    vec3_axpy(a->velocity, 1.0, arm, velocity);
    for (int j = 0; j < IPE_NY; ++j) {
        memcpy(&X[j][IPE_XI_ATTITUDE], by_attitude[j], 3 * sizeof(double));
        X[j][IPE_XI_YAW] = 0.0;
        X[j][IPE_XI_POSITION_DELAY] = vec3_dot(by_position[j], velocity);
        X[j][IPE_XI_ATTITUDE_DELAY] = vec3_dot(by_attitude[j], a->w);
        double by_target[3];
        mat3_tmul_vec(a->R, by_position[j], by_target);
        for (int i = 0; i < 3; ++i) { X[j][IPE_XI_TRACKER_TARGET + i] = -by_target[i]; }
    }
}

static void friction_shares(const ipe_config_t* config, const ipe_average_t* a, double share[IPE_CABLES_MAX])
{
    for (int i = 0; i < config->n_cables; ++i) {
        double b[3], B[3];
        ipe_cable_line_t line;
        mat3_mul_vec(a->R, config->cable[i].attachment, b);
        vec3_axpy(a->p, 1.0, b, B);
        const bool has_line = ipe_cable_line(&config->cable[i], B, &line) == IPE_OK;
        share[i] = has_line ? ipe_cable_friction_share(&config->cable[i], &line) : 0.0;
    }
}

static void force_columns(const ipe_config_t* config, const ipe_average_t* a, const double W[IPE_NY][IPE_CABLES_MAX],
                          double X[IPE_NY][IPE_XI_MAX])
{
    const int m = config->n_cables;
    double share[IPE_CABLES_MAX];
    friction_shares(config, a, share);
    for (int j = 0; j < IPE_NY; ++j) {
        double by_delay = 0.0;
        for (int i = 0; i < m; ++i) {
            const double per_newton = W[j][i] / (1.0 + config->force_gain[i]);
            X[j][IPE_XI_FORCE + i] = -per_newton;
            X[j][IPE_XI_FORCE + m + i] = -per_newton * a->f[i];
            X[j][IPE_XI_FORCE + 2 * m + i] = W[j][i] * share[i] * a->friction[i];
            by_delay += W[j][i] * a->f_slope[i];
        }
        X[j][IPE_XI_FORCE_DELAY] = by_delay;
        X[j][IPE_XI_FORCE_LOWPASS] = 0.0;
        X[j][IPE_XI_CABLE_INERTIA] = a->cable_inertia[j];
    }
}

/// Force along each axis of W at the external attachment, and minus that times its way from the reference.
static void external_columns(const ipe_config_t* config, const ipe_average_t* a, double X[IPE_NY][IPE_XI_MAX])
{
    double arm[3], turned[3], way[3];
    vec3_axpy(config->external_attachment, -1.0, config->imu_position, arm);
    mat3_mul_vec(a->R, config->external_attachment, turned);
    vec3_axpy(a->p, 1.0, turned, way);
    vec3_axpy(way, -1.0, config->external_reference, way);
    for (int i = 0; i < 3; ++i) {
        double wrench[IPE_NY];
        memcpy(wrench, a->R[i], 3 * sizeof(double));  // R^T e_i
        vec3_cross(arm, wrench, wrench + 3);
        for (int j = 0; j < IPE_NY; ++j) {
            X[j][IPE_XI_EXTERNAL_FORCE + i] = wrench[j];
            X[j][IPE_XI_EXTERNAL_STIFFNESS + i] = -way[i] * wrench[j];
        }
    }
}

/// -Y(ds, dww, dalpha) theta as a column: effect of a change of the averaged motion on the residual.
static void motion_column(const double ds[3], const double dww[6], const double dalpha[3], const double theta[IPE_NP],
                          int at, double X[IPE_NY][IPE_XI_MAX])
{
    double Y[IPE_NY][IPE_NP], column[IPE_NY];
    ipe_regressor(ds, dww, dalpha, Y);
    for (int j = 0; j < IPE_NY; ++j) {
        column[j] = 0.0;
        for (int i = 0; i < IPE_NP; ++i) { column[j] -= Y[j][i] * theta[i]; }
    }
    put_column(X, at, column);
}

/// d(w w^T) for dw, as xx yy zz yz xz xy.
static void product_change(const double w[3], const double dw[3], double dww[6])
{
    for (int i = 0; i < 3; ++i) { dww[i] = 2.0 * w[i] * dw[i]; }
    dww[3] = w[1] * dw[2] + dw[1] * w[2];
    dww[4] = w[0] * dw[2] + dw[0] * w[2];
    dww[5] = w[0] * dw[1] + dw[0] * w[1];
}

/// ([alpha]x + [w]x[w]x) e_i: acceleration, P axes, of a place at 1 m along axis i relative to the reference.
static void relative_acceleration(const ipe_average_t* a, int i, double out[3])
{
    const double axis[3] = {i == 0, i == 1, i == 2};
    const double* ww = a->ww;
    const double W2[3][3] = {
        {-ww[1] - ww[2], ww[5], ww[4]}, {ww[5], -ww[0] - ww[2], ww[3]}, {ww[4], ww[3], -ww[0] - ww[1]}};
    vec3_cross(a->alpha, axis, out);
    for (int j = 0; j < 3; ++j) { out[j] += W2[j][i]; }
}

static void scale_columns(const ipe_average_t* a, const double theta[IPE_NP], double X[IPE_NY][IPE_XI_MAX])
{
    const double none[6] = {0.0};
    double ds[3], dww[6], dalpha[3];
    for (int i = 0; i < 3; ++i) { ds[i] = -a->s[i], dalpha[i] = -a->alpha[i]; }
    for (int i = 0; i < 6; ++i) { dww[i] = -2.0 * a->ww[i]; }
    motion_column(ds, none, none, theta, IPE_XI_ACC_SCALE, X);
    motion_column(none, dww, dalpha, theta, IPE_XI_GYRO_SCALE, X);
}

static void motion_columns(const ipe_config_t* config, const ipe_average_t* a, const double theta[IPE_NP],
                           double X[IPE_NY][IPE_XI_MAX])
{
    const double none[6] = {0.0};
    double R_PI[3][3];
    mat3_from_quat(config->imu_orientation, R_PI);
    for (int i = 0; i < 3; ++i) {
        const double minus[3] = {-R_PI[0][i], -R_PI[1][i], -R_PI[2][i]};
        double axis[3] = {0.0, 0.0, 0.0}, ds[3], dw[3], dalpha[3], dww[6];
        axis[i] = 1.0;
        motion_column(minus, none, none, theta, IPE_XI_ACC_BIAS + i, X);
        product_change(a->w, ipe_motion_is_fused(config) ? none : minus, dww);
        motion_column(none, dww, none, theta, IPE_XI_GYRO_BIAS + i, X);
        vec3_cross(axis, a->s, ds);
        vec3_cross(axis, a->w, dw);
        vec3_cross(axis, a->alpha, dalpha);
        product_change(a->w, dw, dww);
        motion_column(ds, dww, dalpha, theta, IPE_XI_ALIGNMENT + i, X);
        relative_acceleration(a, i, ds);
        for (int j = 0; j < 3; ++j) { ds[j] = -ds[j]; }
        motion_column(ds, none, none, theta, IPE_XI_IMU_POSITION + i, X);
    }
    scale_columns(a, theta, X);
}

/// -diag(scale) of I axes, applied to a vector of P axes.
static void scaled_back(const double R_PI[3][3], const double scale[3], const double v[3], double out[3])
{
    double v_I[3];
    mat3_tmul_vec(R_PI, v, v_I);
    for (int i = 0; i < 3; ++i) { v_I[i] *= -scale[i]; }
    mat3_mul_vec(R_PI, v_I, out);
}

/// The change of w w^T, given as xx yy zz yz xz xy, where w changes as scaled_back() has it.
static void products_scaled_back(const double R_PI[3][3], const double scale[3], const double ww[6], double dww[6])
{
    const double M[3][3] = {{ww[0], ww[5], ww[4]}, {ww[5], ww[1], ww[3]}, {ww[4], ww[3], ww[2]}};
    double D[3][3];
    for (int i = 0; i < 3; ++i) { scaled_back(R_PI, scale, M[i], D[i]); }  // row i: change of w_i's partner
    for (int i = 0; i < 3; ++i) { dww[i] = 2.0 * D[i][i]; }
    dww[3] = D[1][2] + D[2][1];
    dww[4] = D[0][2] + D[2][0];
    dww[5] = D[0][1] + D[1][0];
}

/// How the attitude and the scales of s and w, as the motion stage estimates them, depend on a parameter [8] of it: added to
/// column at as a change of the residual.
static void add_estimated(const ipe_config_t* config, const ipe_average_t* a, const double by_attitude[IPE_NY][3],
                          const double theta[IPE_NP], const double parameter[IPE_MOTION_NP], int at,
                          double X[IPE_NY][IPE_XI_MAX])
{
    double turn_w[3] = {0.0}, turn[3], force_scale[3] = {0.0}, rate_scale[3] = {0.0};
    double ds[3], dww[6], dalpha[3], R_PI[3][3], Y[IPE_NY][IPE_NP];
    for (int k = 0; k < IPE_MOTION_NP; ++k) {
        for (int i = 0; i < 3; ++i) {
            turn_w[i] += a->error.attitude[i][k] * parameter[k];
            force_scale[i] += a->error.force_scale[i][k] * parameter[k];
            rate_scale[i] += a->error.rate_scale[i][k] * parameter[k];
        }
    }
    mat3_from_quat(config->imu_orientation, R_PI);
    mat3_tmul_vec(a->R, turn_w, turn);
    scaled_back((const double (*)[3])R_PI, force_scale, a->s, ds);
    scaled_back((const double (*)[3])R_PI, rate_scale, a->alpha, dalpha);
    products_scaled_back((const double (*)[3])R_PI, rate_scale, a->ww, dww);
    ipe_regressor(ds, dww, dalpha, Y);
    for (int j = 0; j < IPE_NY; ++j) {
        X[j][at] += vec3_dot(by_attitude[j], turn);
        for (int i = 0; i < IPE_NP; ++i) { X[j][at] -= Y[j][i] * theta[i]; }
    }
}

/// The parameters that the motion stage's estimates depend on, ipe_attitude_error_t.
static void add_estimated_columns(const ipe_config_t* config, const ipe_average_t* a,
                                  const double by_attitude[IPE_NY][3], const double theta[IPE_NP],
                                  double X[IPE_NY][IPE_XI_MAX])
{
    double lever[3];
    vec3_axpy(config->tracker_target, -1.0, config->imu_position, lever);
    for (int i = 0; i < 3; ++i) {
        double bias[IPE_MOTION_NP] = {0.0}, alignment[IPE_MOTION_NP] = {0.0}, axis[3] = {0.0};
        bias[IPE_MOTION_BY_ACC_BIAS + i] = 1.0;
        axis[i] = 1.0;
        vec3_cross(lever, axis, alignment + IPE_MOTION_BY_LEVER);  // the lever in I axes turns the other way
        add_estimated(config, a, by_attitude, theta, bias, IPE_XI_ACC_BIAS + i, X);
        add_estimated(config, a, by_attitude, theta, alignment, IPE_XI_ALIGNMENT + i, X);
        double longer[IPE_MOTION_NP] = {0.0}, shorter[IPE_MOTION_NP] = {0.0};
        longer[IPE_MOTION_BY_LEVER + i] = 1.0, shorter[IPE_MOTION_BY_LEVER + i] = -1.0;
        add_estimated(config, a, by_attitude, theta, longer, IPE_XI_TRACKER_TARGET + i, X);
        add_estimated(config, a, by_attitude, theta, shorter, IPE_XI_IMU_POSITION + i, X);
    }
    const double delay[IPE_MOTION_NP] = {[IPE_MOTION_BY_DELAY] = 1.0};
    const double yaw[IPE_MOTION_NP] = {[IPE_MOTION_BY_YAW] = 1.0};
    add_estimated(config, a, by_attitude, theta, delay, IPE_XI_POSITION_DELAY, X);
    add_estimated(config, a, by_attitude, theta, yaw, IPE_XI_YAW, X);
}

/// An IMU mounted otherwise gives another attitude too: of the AHRS R(q) R_PI^T exp(-xi) exp(attitude_bias), fused without
/// the bias.
static void add_turned_attitude(const ipe_config_t* config, const double by_attitude[IPE_NY][3],
                                double X[IPE_NY][IPE_XI_MAX])
{
    const double none[3] = {0.0, 0.0, 0.0};
    double bias[3][3], turned[3];
    mat3_exp(ipe_motion_is_fused(config) ? none : config->attitude_bias, bias);
    for (int j = 0; j < IPE_NY; ++j) {
        mat3_mul_vec(bias, by_attitude[j], turned);
        vec3_axpy(&X[j][IPE_XI_ALIGNMENT], -1.0, turned, &X[j][IPE_XI_ALIGNMENT]);
    }
}

ipe_status_t ipe_systematic_columns(const ipe_config_t* config, const ipe_average_t* average,
                                    const double theta[IPE_NP], double X[IPE_NY][IPE_XI_MAX])
{
    double by_position[IPE_NY][3], by_attitude[IPE_NY][3], W[IPE_NY][IPE_CABLES_MAX], sag[IPE_NY];
    if (pose_slope(config, average, false, by_position) != IPE_OK ||
        pose_slope(config, average, true, by_attitude) != IPE_OK ||
        ipe_wrench_matrix(config, average->p, average->R, config->imu_position, W, sag) != IPE_OK) {
        return IPE_ERR_GEOMETRY;
    }
    pose_columns(config, average, by_position, by_attitude, X);
    force_columns(config, average, W, X);
    external_columns(config, average, X);
    motion_columns(config, average, theta, X);
    add_turned_attitude(config, by_attitude, X);
    add_estimated_columns(config, average, (const double (*)[3])by_attitude, theta, X);
    return IPE_OK;
}
