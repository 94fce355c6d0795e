// SPDX-License-Identifier: Apache-2.0
#include "systematic.h"

#include "regressor.h"
#include "smallmat.h"
#include "wrench.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

static_assert(IPE_XI_FILTER_MAX == IPE_XI_FORCE + 2 * IPE_CABLES_MAX, "sizes in dims.h");

#define STEP 1e-4  // m and rad of the central differences: error 1e-8 relative by truncation, 1e-11 by rounding

int ipe_systematic_count(int n_cables)
{
    return ipe_systematic_filter_count(n_cables) + 4;
}

int ipe_systematic_filter_count(int n_cables)
{
    return IPE_XI_FORCE + 2 * n_cables;
}

void ipe_systematic_name(int n_cables, int index, char name[IPE_SYSTEMATIC_NAME_MAX])
{
    const struct {
        const char* name;
        int n;
        bool is_per_cable;
    } group[] = {{"attitude_bias", 3, false},    {"world_yaw", 1, false},      {"acc_bias", 3, false},
                 {"imu_alignment", 3, false},    {"position_delay", 1, false}, {"force_offset", n_cables, true},
                 {"force_gain", n_cables, true}, {"gyro_bias", 3, false},      {"force_delay", 1, false}};
    size_t g = 0;
    while (index >= group[g].n) { index -= group[g++].n; }
    if (group[g].is_per_cable) {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s_%d", group[g].name, (index + 1) % 100);
    } else if (group[g].n == 3) {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s_%c", group[g].name, "xyz"[index]);
    } else {
        (void)snprintf(name, IPE_SYSTEMATIC_NAME_MAX, "%s", group[g].name);
    }
}

static void fill(double* out, int n, double value)
{
    for (int i = 0; i < n; ++i) { out[i] = value; }
}

void ipe_systematic_std(const ipe_config_t* config, double std[IPE_XI_MAX])
{
    const int m = config->n_cables;
    fill(std + IPE_XI_ATTITUDE, 3, config->std_attitude);
    fill(std + IPE_XI_YAW, 1, config->std_world_yaw);
    fill(std + IPE_XI_ACC_BIAS, 3, config->std_acc_bias);
    fill(std + IPE_XI_ALIGNMENT, 3, config->std_imu_alignment);
    fill(std + IPE_XI_POSITION_DELAY, 1, config->std_position_delay);
    fill(std + IPE_XI_FORCE, m, config->std_force_offset);
    fill(std + IPE_XI_FORCE + m, m, config->std_force_gain);
    fill(std + IPE_XI_FORCE + 2 * m, 3, config->std_gyro_bias);
    fill(std + IPE_XI_FORCE + 2 * m + 3, 1, config->std_force_delay);
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
    }
}

static void force_columns(const ipe_config_t* config, const ipe_average_t* a, const double W[IPE_NY][IPE_CABLES_MAX],
                          double X[IPE_NY][IPE_XI_MAX])
{
    const int m = config->n_cables;
    for (int j = 0; j < IPE_NY; ++j) {
        double by_delay = 0.0;
        for (int i = 0; i < m; ++i) {
            const double per_newton = W[j][i] / (1.0 + config->force_gain[i]);
            X[j][IPE_XI_FORCE + i] = -per_newton;
            X[j][IPE_XI_FORCE + m + i] = -per_newton * a->f[i];
            by_delay += W[j][i] * a->f_slope[i];
        }
        X[j][IPE_XI_FORCE + 2 * m + 3] = by_delay;
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
        motion_column(none, dww, none, theta, IPE_XI_FORCE + 2 * config->n_cables + i, X);
        vec3_cross(axis, a->s, ds);
        vec3_cross(axis, a->w, dw);
        vec3_cross(axis, a->alpha, dalpha);
        product_change(a->w, dw, dww);
        motion_column(ds, dww, dalpha, theta, IPE_XI_ALIGNMENT + i, X);
    }
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
