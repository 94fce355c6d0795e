// SPDX-License-Identifier: Apache-2.0
#include "wrench.h"

#include "motion.h"

#include "robot.h"

static ipe_config_t config;
static ipe_wrench_stage_t stage;
static ipe_row_t row;
static ipe_motion_t motion;
static ipe_wrench_t wrench;

void setUp(void)
{
    config = cogiro();
    memset(&row, 0, sizeof row);
    row.acc[2] = 9.81;
    row.q[0] = 1.0;
    row.position[2] = 2.0;
    for (int i = 0; i < 8; ++i) { row.f[i] = 600.0 + 10.0 * i; }
}

void tearDown(void)
{
}

static ipe_status_t run(void)
{
    static ipe_motion_stage_t sensors;
    ipe_motion_init(&sensors, &config);
    row.has_position = true;
    (void)ipe_motion_push(&sensors, &row, &motion);
    ipe_wrench_init(&stage, &config);
    return ipe_wrench_from_row(&stage, &row, &motion, &wrench);
}

static void test_from_row_adds_forces_and_moments_of_all_cables(void)
{
    TEST_ASSERT_EQUAL_INT(IPE_OK, run());  // given, when: upright at 2 m

    double expected[6] = {0.0};            // then: cable by cable
    for (int i = 0; i < 8; ++i) {
        ipe_cable_line_t line;
        double B[3], force[3], arm[3], moment[3];
        vec3_axpy(row.position, 1.0, config.cable[i].attachment, B);
        (void)ipe_cable_line(&config.cable[i], B, &line);
        ipe_cable_sag(&config.cable[i], &line, force);
        vec3_axpy(force, row.f[i], line.u, force);
        vec3_axpy(config.cable[i].attachment, -1.0, config.imu_position, arm);
        vec3_cross(arm, force, moment);
        for (int j = 0; j < 3; ++j) { expected[j] += force[j], expected[3 + j] += moment[j]; }
    }
    for (int j = 0; j < 6; ++j) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, expected[j], wrench.y[j]); }
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_rows);
}

static void test_from_row_turned_platform_turns_force(void)
{
    config.n_cables = 1;                         // given: one weightless cable from straight above,
    config.cable[0] = (ipe_cable_t){.anchor = {0.0, 0.0, 5.0}, .swivel_axis = {0.0, 0.0, 1.0}, .tension_max = 5000.0};
    const double rpy[3] = {0.5 * PI, 0.0, 0.0};  // the platform's y axis up
    quat_from_rpy(rpy, row.q);
    memset(config.imu_position, 0, sizeof config.imu_position);
    row.f[0] = 100.0;

    TEST_ASSERT_EQUAL_INT(IPE_OK, run());                         // when

    const double expected[6] = {0.0, 100.0, 0.0, 0.0, 0.0, 0.0};  // then
    for (int j = 0; j < 6; ++j) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, expected[j], wrench.y[j]); }
}

static void test_from_row_moment_is_about_the_imu(void)
{
    (void)run();  // given: wrench about the IMU and about P
    const ipe_wrench_t at_imu = wrench;
    memset(config.imu_position, 0, sizeof config.imu_position);
    (void)run();      // when
    double shift[3];  // then: tau_I = tau_P - p_I x F
    const ipe_config_t original = cogiro();
    vec3_cross(original.imu_position, wrench.y, shift);
    for (int j = 0; j < 3; ++j) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, wrench.y[j], at_imu.y[j]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, wrench.y[3 + j] - shift[j], at_imu.y[3 + j]);
    }
}

static void test_from_row_force_calibration_is_undone(void)
{
    (void)run();  // given: the wrench of true forces
    const ipe_wrench_t expected = wrench;
    for (int i = 0; i < 8; ++i) {
        config.force_offset[i] = 5.0 * i - 12.0;
        config.force_gain[i] = 0.01 * i - 0.02;
        row.f[i] = (1.0 + config.force_gain[i]) * row.f[i] + config.force_offset[i];
    }
    (void)run();  // when: measured with offset and gain
    for (int j = 0; j < 6; ++j) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, expected.y[j], wrench.y[j]); }  // then
}

static void test_from_row_imu_calibration_is_undone(void)
{
    const double mounted[3] = {0.1, 0.2, -0.3}, bias[3] = {0.02, -0.01, 0.03}, attitude[3] = {0.3, -0.2, 1.0};  // given
    const double s[3] = {0.3, -0.2, 9.7}, w[3] = {0.1, 0.2, 0.3}, yaw[3] = {0.0, 0.0, 0.15};
    double q_true[4], R[3][3], R_PI[3][3], B[3][3], Z[3][3], M[3][3], T1[3][3], T2[3][3];
    quat_from_rpy(attitude, q_true);
    mat3_from_quat(q_true, R);
    quat_from_rpy(mounted, config.imu_orientation);
    mat3_from_quat(config.imu_orientation, R_PI);
    memcpy(config.attitude_bias, bias, sizeof bias);
    config.world_yaw = yaw[2];
    config.acc_bias[0] = 0.4, config.gyro_bias[1] = -0.05;
    const double minus_bias[3] = {-bias[0], -bias[1], -bias[2]}, minus_yaw[3] = {0.0, 0.0, -yaw[2]};
    mat3_exp(minus_bias, B);  // measured = Rz(-yaw) R exp(-bias) R_PI
    mat3_exp(minus_yaw, Z);
    mat3_mul(Z, R, T1);
    mat3_mul(T1, B, T2);
    mat3_mul(T2, R_PI, M);
    row.q[0] = 0.5 * sqrt(1.0 + M[0][0] + M[1][1] + M[2][2]);
    row.q[1] = (M[2][1] - M[1][2]) / (4.0 * row.q[0]);
    row.q[2] = (M[0][2] - M[2][0]) / (4.0 * row.q[0]);
    row.q[3] = (M[1][0] - M[0][1]) / (4.0 * row.q[0]);
    mat3_tmul_vec(R_PI, s, row.acc);
    mat3_tmul_vec(R_PI, w, row.gyro);
    row.acc[0] += 0.4, row.gyro[1] -= 0.05;
    config.tracker_target[0] = 0.3, config.tracker_target[2] = -0.1;

    (void)run();                   // when

    for (int i = 0; i < 3; ++i) {  // then
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, s[i], motion.s[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, w[i], motion.w[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, row.position[i] - 0.3 * R[i][0] + 0.1 * R[i][2], motion.p[i]);
        for (int j = 0; j < 3; ++j) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, R[i][j], motion.R[i][j]); }
    }
}

static void test_from_row_slack_and_overload_are_counted_after_calibration(void)
{
    config.force_offset[3] = 20.0;               // given: 110 N measured is 90 N true
    row.f[3] = 110.0;
    TEST_ASSERT_EQUAL_INT(IPE_OK, run());        // when
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_slack);  // then
    TEST_ASSERT_EQUAL_UINT64(0, stage.n_overload);

    row.f[3] = 121.0;  // within limits
    (void)ipe_wrench_from_row(&stage, &row, &motion, &wrench);
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_slack);

    row.f[0] = 5001.0, row.f[1] = 5002.0;  // two overloaded cables are one row
    (void)ipe_wrench_from_row(&stage, &row, &motion, &wrench);
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_overload);
    TEST_ASSERT_EQUAL_UINT64(3, stage.n_rows);
}

static void test_from_row_impossible_pose_is_refused_and_counted(void)
{
    for (int i = 0; i < 3; ++i) {  // given: attachment 6 on its own anchor
        row.position[i] = config.cable[5].anchor[i] - config.cable[5].attachment[i];
    }
    TEST_ASSERT_EQUAL_INT(IPE_ERR_GEOMETRY, run());  // when, then
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_geometry);
    TEST_ASSERT_EQUAL_UINT64(0, stage.n_rows);
}

/// State of cable 1's friction after `travel` [m] of rising at `speed` [m/s] from rest.
static double friction_after(double travel, double speed)
{
    const double dt = 1e-3;
    double z = 0.0;
    (void)run();
    motion.v[2] = speed;
    for (int k = 1; k * dt * speed < travel; ++k) {
        row.t_ns = (int64_t)llround(1e9 * k * dt);
        TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_wrench_from_row(&stage, &row, &motion, &wrench));
        z = wrench.friction[0] / wrench.f[0];
    }
    return z;
}

static void test_friction_of_a_small_pulley_turns_sooner(void)
{
    double z[2];
    const double radius[] = {0.05, 0.006};  // given
    for (int i = 0; i < 2; ++i) {
        for (int k = 0; k < 8; ++k) { config.cable[k].pulley_radius = radius[i]; }
        z[i] = friction_after(2e-3, 0.2);           // when
    }
    TEST_ASSERT_TRUE(z[0] < -0.05 && z[0] > -0.5);  // then: drawn in, part of it by then
    TEST_ASSERT_TRUE(z[1] < 1.8 * z[0]);
}

static void test_friction_follows_slower_speeds_where_the_error_of_speed_is_less(void)
{
    double z[2];
    z[0] = friction_after(2e-3, 0.01);  // given: the platform's
    (void)run();
    stage.rest_speed = 1e-3;            // and less
    motion.v[2] = 0.01;
    for (int k = 1; k <= 200; ++k) {    // when
        row.t_ns = 1000000 * k;
        (void)ipe_wrench_from_row(&stage, &row, &motion, &wrench);
    }
    z[1] = wrench.friction[0] / wrench.f[0];
    TEST_ASSERT_TRUE(z[1] < 1.5 * z[0]);  // then
}

static void test_matrix_is_the_change_of_cable_lengths(void)
{
    const double p[3] = {0.4, -0.3, 2.1}, rpy[3] = {0.2, -0.3, 0.5}, zero[3] = {0.0, 0.0, 0.0}, h = 1e-6;  // given
    double q[4], R[3][3], W[IPE_NY][IPE_CABLES_MAX], sag[IPE_NY];
    quat_from_rpy(rpy, q);
    mat3_from_quat(q, R);

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_wrench_matrix(&config, p, (const double (*)[3])R, zero, W, sag));  // when

    for (int j = 0; j < 6; ++j) {  // then: -dl = W^T twist, twist in platform axes
        for (int i = 0; i < 8; ++i) {
            double length[2];
            for (int side = 0; side < 2; ++side) {
                double step[3] = {0.0, 0.0, 0.0}, turn[3][3], R2[3][3], b[3], B[3], shift[3];
                step[j % 3] = side ? h : -h;
                mat3_exp(j < 3 ? zero : step, turn);
                mat3_mul((const double (*)[3])R, (const double (*)[3])turn, R2);
                mat3_mul_vec((const double (*)[3])R, j < 3 ? step : zero, shift);
                mat3_mul_vec((const double (*)[3])R2, config.cable[i].attachment, b);
                for (int c = 0; c < 3; ++c) { B[c] = p[c] + shift[c] + b[c]; }
                ipe_cable_line_t line;
                (void)ipe_cable_line(&config.cable[i], B, &line);
                length[side] = line.length;
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-7, W[j][i], -(length[1] - length[0]) / (2.0 * h));
        }
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_from_row_adds_forces_and_moments_of_all_cables);
    RUN_TEST(test_from_row_turned_platform_turns_force);
    RUN_TEST(test_from_row_moment_is_about_the_imu);
    RUN_TEST(test_from_row_force_calibration_is_undone);
    RUN_TEST(test_from_row_imu_calibration_is_undone);
    RUN_TEST(test_from_row_slack_and_overload_are_counted_after_calibration);
    RUN_TEST(test_from_row_impossible_pose_is_refused_and_counted);
    RUN_TEST(test_friction_of_a_small_pulley_turns_sooner);
    RUN_TEST(test_friction_follows_slower_speeds_where_the_error_of_speed_is_less);
    RUN_TEST(test_matrix_is_the_change_of_cable_lengths);
    return UNITY_END();
}
