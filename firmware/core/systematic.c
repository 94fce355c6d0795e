// SPDX-License-Identifier: Apache-2.0
#include "systematic.h"

#include "regressor.h"
#include "smallmat.h"
#include "wrench.h"

#include <assert.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

static_assert(IPE_XI_FORCE == IPE_XI_CABLE_INERTIA + 1, "the table and the numbers in systematic.h agree");

#define STEP 1e-4  // m and rad of the central differences: error 1e-8 relative by truncation, 1e-11 by rounding

#define CABLE_INERTIA_STD \
    0.5  // share: chosen so that cables without inertia, and at half their first mode, are 2 sigma off

enum { PER_CABLE = 0 };

/// The groups, in the order of xi.
static const struct {
    const char* name;
    int count;  ///< or PER_CABLE
    bool is_ahrs_only;
    size_t std;
} GROUP[] = {
#define STD(field) offsetof(ipe_config_t, field)
#define NOT_CONFIGURED SIZE_MAX  // cable_inertia_std() has it
    {"attitude_bias", 3, false, STD(std_attitude)},
    {"world_yaw", 1, false, STD(std_world_yaw)},
    {"acc_bias", 3, false, STD(std_acc_bias)},
    {"imu_alignment", 3, false, STD(std_imu_alignment)},
    {"position_delay", 1, false, STD(std_position_delay)},
    {"force_delay", 1, false, STD(std_force_delay)},
    {"attitude_delay", 1, true, STD(std_attitude_delay)},
    {"imu_position", 3, false, STD(std_imu_position)},
    {"tracker_target", 3, false, STD(std_tracker_target)},
    {"acc_scale", 1, true, STD(std_acc_scale)},
    {"gyro_scale", 1, true, STD(std_gyro_scale)},
    {"gyro_bias", 3, false, STD(std_gyro_bias)},
    {"cable_inertia", 1, false, NOT_CONFIGURED},
    {"force_offset", PER_CABLE, false, STD(std_force_offset)},
    {"force_gain", PER_CABLE, false, STD(std_force_gain)},
    {"friction", PER_CABLE, false, STD(std_friction)},
#undef STD
};

enum { GROUPS = sizeof GROUP / sizeof GROUP[0] };

int ipe_systematic_count(int n_cables)
{
    return IPE_XI_FORCE + 3 * n_cables;
}

int ipe_systematic_planned_count(int n_cables)
{
    return IPE_XI_FORCE + 2 * n_cables;
}

bool ipe_systematic_group(int number, int n_cables, ipe_systematic_group_t* group)
{
    if (number < 0 || number >= GROUPS) { return false; }
    group->first = 0;
    for (int i = 0; i <= number; ++i) {
        if (i > 0) { group->first += group->count; }
        group->count = GROUP[i].count == PER_CABLE ? n_cables : GROUP[i].count;
    }
    group->name = GROUP[number].name;
    return true;
}

void ipe_systematic_name(int n_cables, int index, char name[IPE_SYSTEMATIC_NAME_MAX])
{
    ipe_systematic_group_t group = {"", 0, 0};
    for (int g = 0; ipe_systematic_group(g, n_cables, &group) && index >= group.first + group.count; ++g) {}
    const int i = index - group.first;
    if (group.first >= IPE_XI_FORCE) {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s_%d", group.name, (i + 1) % 100);
    } else if (group.count == 3) {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s_%c", group.name, "xyz"[i % 3]);
    } else {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s", group.name);
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

void ipe_systematic_std(const ipe_config_t* config, double std[IPE_XI_MAX])
{
    for (int g = 0; g < GROUPS; ++g) {
        const int count = GROUP[g].count == PER_CABLE ? config->n_cables : GROUP[g].count;
        const bool is_absent = GROUP[g].is_ahrs_only && config->attitude_estimate == IPE_ATTITUDE_FUSED;
        double value = cable_inertia_std(config);
        if (GROUP[g].std != NOT_CONFIGURED) { memcpy(&value, (const char*)config + GROUP[g].std, sizeof value); }
        for (int i = 0; i < count; ++i) { *std++ = is_absent ? 0.0 : value; }
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
    const double* up = a->R[2];  // z of W in P axes
    for (int j = 0; j < IPE_NY; ++j) {
        memcpy(&X[j][IPE_XI_ATTITUDE], by_attitude[j], 3 * sizeof(double));
        X[j][IPE_XI_YAW] = vec3_dot(by_attitude[j], up);
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
        X[j][IPE_XI_CABLE_INERTIA] = a->cable_inertia[j];
    }
}

/// -Y(ds, dww, dalpha) theta as a column: what a change of the averaged motion does to the residual.
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
        product_change(a->w, minus, dww);
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

/// An IMU mounted otherwise gives another attitude too: R(q) R_PI^T exp(-xi) exp(attitude_bias).
static void add_turned_attitude(const ipe_config_t* config, const double by_attitude[IPE_NY][3],
                                double X[IPE_NY][IPE_XI_MAX])
{
    double bias[3][3], turned[3];
    mat3_exp(config->attitude_bias, bias);
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
    motion_columns(config, average, theta, X);
    add_turned_attitude(config, by_attitude, X);
    return IPE_OK;
}
