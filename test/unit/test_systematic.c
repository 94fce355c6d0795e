// SPDX-License-Identifier: Apache-2.0
#include "systematic.h"

#include "cable.h"
#include "motion.h"
#include "robot.h"

static ipe_config_t config;
static double theta[IPE_NP];

/// A row in motion, with what its neighbours tell: angular acceleration (P axes), velocity of the tracked point, force slopes.
static ipe_row_t row;
static double alpha[3], tracked_velocity[3], f_slope[8], friction[8];

void setUp(void)
{
    const double mounted[3] = {0.2, -0.1, 0.4}, attitude[3] = {0.2, -0.25, 0.6};
    uint64_t seed = 3;
    config = cogiro();
    quat_from_rpy(mounted, config.imu_orientation);
    config.tracker_target[0] = 0.2, config.tracker_target[1] = -0.3, config.tracker_target[2] = 0.5;
    config.attitude_bias[0] = 0.02, config.attitude_bias[2] = -0.03, config.acc_bias[1] = 0.1,
    config.gyro_bias[2] = 0.01, config.world_yaw = 0.05;
    config.external_attachment[0] = 0.3, config.external_attachment[2] = 0.7, config.external_reference[1] = -0.5;
    for (int i = 0; i < 8; ++i) { config.force_offset[i] = i, config.force_gain[i] = 0.002 * i; }
    memset(&row, 0, sizeof row);
    row.has_position = true;
    quat_from_rpy(attitude, row.q);
    fill_normal(&seed, row.acc, 3), fill_normal(&seed, row.gyro, 3), fill_normal(&seed, row.position, 3);
    fill_normal(&seed, alpha, 3), fill_normal(&seed, tracked_velocity, 3), fill_normal(&seed, f_slope, 8);
    fill_normal(&seed, friction, 8);
    row.acc[2] += 9.81, row.position[2] += 2.0;
    for (int i = 0; i < 8; ++i) { row.f[i] = 500.0 + 40.0 * i; }
    nominal_theta(theta);
}

void tearDown(void)
{
}

/// The window that a long stretch of this row would average to, under k.
static ipe_average_t average_of(const ipe_config_t* k)
{
    static ipe_motion_stage_t sensors;
    ipe_wrench_stage_t stage;
    ipe_motion_t motion;
    ipe_wrench_t wrench;
    ipe_average_t a;
    memset(&a, 0, sizeof a);
    ipe_motion_init(&sensors, k);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_motion_push(&sensors, &row, &motion));
    a.error = motion.error;
    ipe_wrench_init(&stage, k);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_wrench_from_row(&stage, &row, &motion, &wrench));
    memcpy(a.s, motion.s, sizeof a.s);
    memcpy(a.w, motion.w, sizeof a.w);
    ipe_rate_products(a.w, a.ww);
    memcpy(a.alpha, alpha, sizeof alpha);
    memcpy(a.y, wrench.y, sizeof a.y);
    memcpy(a.f, wrench.f, sizeof a.f);
    memcpy(a.p, motion.p, sizeof a.p);
    memcpy(a.R, motion.R, sizeof a.R);
    for (int i = 0; i < 8; ++i) {
        a.f_slope[i] = f_slope[i] / (1.0 + k->force_gain[i]), a.friction[i] = 100.0 * friction[i];
    }
    double arm[3], turned[3];  // velocity of P = tracked point's - R (w x target)
    vec3_cross(a.w, k->tracker_target, arm);
    mat3_mul_vec((const double (*)[3])motion.R, arm, turned);
    vec3_axpy(tracked_velocity, -1.0, turned, a.velocity);
    for (int j = 0; j < IPE_NY; ++j) { a.cable_inertia[j] = 10.0 * friction[j]; }
    return a;
}

static void residual(const ipe_average_t* a, double e[IPE_NY])
{
    double Y[IPE_NY][IPE_NP];
    ipe_regressor(a->s, a->ww, a->alpha, Y);
    for (int j = 0; j < IPE_NY; ++j) {
        e[j] = a->y[j];
        for (int i = 0; i < IPE_NP; ++i) { e[j] -= Y[j][i] * theta[i]; }
    }
}

/// q [w x y z] = exp(angle about axis) q for a small angle.
static void turn_imu(int axis, double angle, double q[4])
{
    const double v[3] = {q[1], q[2], q[3]}, w = q[0], half = 0.5 * angle;
    double u[3] = {0.0}, cross[3];
    u[axis] = half;
    vec3_cross(u, v, cross);
    q[0] = w - half * v[axis];
    for (int i = 0; i < 3; ++i) { q[1 + i] = v[i] + w * u[i] + cross[i]; }
}

/// bias = log(exp(bias) exp(angle about axis)).
static void turn_attitude(int axis, double angle, double bias[3])
{
    double turn[3] = {0.0}, A[3][3], B[3][3], R[3][3];
    turn[axis] = angle;
    mat3_exp(bias, A);
    mat3_exp(turn, B);
    mat3_mul(A, B, R);
    const double twice_sine[3] = {R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]};
    const double sine = 0.5 * vec3_norm(twice_sine), scale = 0.5 * asin(sine) / sine;
    for (int i = 0; i < 3; ++i) { bias[i] = scale * twice_sine[i]; }
}

static void scale(double factor, double v[3])
{
    for (int i = 0; i < 3; ++i) { v[i] *= factor; }
}

/// The IMU is xi further along an axis of P than configured: the specific force at the configured place is another.
static void move_imu(int axis, double xi, ipe_average_t* a)
{
    double arm[3] = {0.0, 0.0, 0.0}, tangential[3], turning[3], centripetal[3];
    arm[axis] = xi;
    vec3_cross(a->alpha, arm, tangential);
    vec3_cross(a->w, arm, turning);
    vec3_cross(a->w, turning, centripetal);
    for (int i = 0; i < 3; ++i) { a->s[i] -= tangential[i] + centripetal[i]; }
}

/// Cable i's tension at the platform is larger by xi of what its friction is made of: wrench of that tension.
static void rub_cable(int i, double xi, ipe_average_t* a)
{
    double b[3], B[3], force[3], arm[3], moment[3];
    ipe_cable_line_t line;
    mat3_mul_vec((const double (*)[3])a->R, config.cable[i].attachment, b);
    vec3_axpy(a->p, 1.0, b, B);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_line(&config.cable[i], B, &line));
    mat3_tmul_vec((const double (*)[3])a->R, line.u, force);
    scale(xi * a->friction[i] * ipe_cable_friction_share(&config.cable[i], &line), force);
    vec3_axpy(config.cable[i].attachment, -1.0, config.imu_position, arm);
    vec3_cross(arm, force, moment);
    for (int j = 0; j < 3; ++j) { a->y[j] += force[j], a->y[3 + j] += moment[j]; }
}

/// A spring pulls along an axis of W from the reference, with xi N, or with xi N/m.
static void pull(int axis, double xi, bool is_spring, ipe_average_t* a)
{
    double place[3], force_W[3] = {0.0}, force[3], arm[3], moment[3];
    mat3_mul_vec((const double (*)[3])a->R, config.external_attachment, place);
    vec3_axpy(a->p, 1.0, place, place);
    force_W[axis] = is_spring ? xi * (config.external_reference[axis] - place[axis]) : xi;
    mat3_tmul_vec((const double (*)[3])a->R, force_W, force);
    vec3_axpy(config.external_attachment, -1.0, config.imu_position, arm);
    vec3_cross(arm, force, moment);
    for (int j = 0; j < 3; ++j) { a->y[j] += force[j], a->y[3 + j] += moment[j]; }
}

/// Residual with the calibration corrected by xi in one parameter.
static void corrected_residual(int at, double xi, double e[IPE_NY])
{
    const int m = config.n_cables, offset = IPE_XI_FORCE, gain = offset + m, rub = gain + m;
    ipe_config_t k = config;
    const ipe_row_t measured = row;
    if (at < IPE_XI_YAW) {
        turn_attitude(at, xi, k.attitude_bias);
    } else if (at == IPE_XI_YAW) {
        k.world_yaw += xi;
    } else if (at < IPE_XI_ALIGNMENT) {
        k.acc_bias[at - IPE_XI_ACC_BIAS] += xi;
    } else if (at < IPE_XI_POSITION_DELAY) {
        turn_imu(at - IPE_XI_ALIGNMENT, xi, k.imu_orientation);
    } else if (at == IPE_XI_POSITION_DELAY) {  // the position of this instant is stamped later
        vec3_axpy(measured.position, xi, tracked_velocity, row.position);
    } else if (at >= offset && at < gain) {
        k.force_offset[at - offset] += xi;
    } else if (at >= gain && at < rub) {
        k.force_gain[at - gain] += xi;
    } else if (at >= IPE_XI_GYRO_BIAS && at < IPE_XI_GYRO_BIAS + 3) {
        k.gyro_bias[at - IPE_XI_GYRO_BIAS] += xi;
    } else if (at == IPE_XI_FORCE_DELAY) {
        for (int i = 0; i < m; ++i) { row.f[i] += xi * f_slope[i]; }
    } else if (at == IPE_XI_ATTITUDE_DELAY) {
        k.delay_attitude += xi;
    } else if (at >= IPE_XI_TRACKER_TARGET && at < IPE_XI_TRACKER_TARGET + 3) {
        k.tracker_target[at - IPE_XI_TRACKER_TARGET] += xi;
    }
    ipe_average_t a = average_of(&k);
    row = measured;
    if (at >= IPE_XI_IMU_POSITION && at < IPE_XI_IMU_POSITION + 3) { move_imu(at - IPE_XI_IMU_POSITION, xi, &a); }
    if (at == IPE_XI_ACC_SCALE) { scale(1.0 - xi, a.s); }
    if (at == IPE_XI_GYRO_SCALE) {
        scale(1.0 - xi, a.w), scale(1.0 - xi, a.alpha);
        ipe_rate_products(a.w, a.ww);
    }
    if (at == IPE_XI_CABLE_INERTIA) {
        for (int j = 0; j < IPE_NY; ++j) { a.y[j] += xi * a.cable_inertia[j]; }
    }
    if (at >= IPE_XI_EXTERNAL_FORCE && at < IPE_XI_FORCE_LOWPASS) {
        const bool is_spring = at >= IPE_XI_EXTERNAL_STIFFNESS;
        pull(at - (is_spring ? IPE_XI_EXTERNAL_STIFFNESS : IPE_XI_EXTERNAL_FORCE), xi, is_spring, &a);
    }
    if (at >= rub) { rub_cable(at - rub, xi, &a); }
    if (at >= IPE_XI_ALIGNMENT && at < IPE_XI_POSITION_DELAY) {  // the slope of the rate turns with it
        double axis[3] = {0.0, 0.0, 0.0}, turn[3];
        axis[at - IPE_XI_ALIGNMENT] = xi;
        vec3_cross(axis, a.alpha, turn);
        vec3_axpy(a.alpha, 1.0, turn, a.alpha);
    }
    residual(&a, e);
}

static void test_columns_equal_residuals_of_a_corrected_calibration(void)
{
    const int n = ipe_systematic_count(config.n_cables);  // given
    const ipe_average_t a = average_of(&config);
    double X[IPE_NY][IPE_XI_MAX], plus[IPE_NY], minus[IPE_NY];

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_systematic_columns(&config, &a, theta, X));  // when

    TEST_ASSERT_EQUAL_INT(32 + 3 * 8, n);
    for (int at = 0; at < n; ++at) {  // then
        const double h = 1e-4;
        corrected_residual(at, h, plus);
        corrected_residual(at, -h, minus);
        for (int j = 0; j < IPE_NY; ++j) {
            const double slope = (plus[j] - minus[j]) / (2.0 * h);
            char message[48];
            (void)snprintf(message, sizeof message, "parameter %d, row %d", at, j);
            TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(1e-4 * (1.0 + fabs(slope)), slope, X[j][at], message);
        }
    }
}

static void test_std_are_the_configured_ones_in_order(void)
{
    double std[IPE_XI_MAX];  // given
    config.n_cables = 2;
    config.std_attitude = 1.0, config.std_world_yaw = 2.0, config.std_acc_bias = 3.0, config.std_imu_alignment = 4.0;
    config.std_position_delay = 5.0, config.std_force_delay = 6.0, config.std_attitude_delay = 7.0;
    config.std_imu_position = 8.0, config.std_tracker_target = 9.0, config.std_acc_scale = 10.0;
    config.std_gyro_scale = 11.0, config.std_gyro_bias = 12.0, config.std_force_offset = 13.0;
    config.std_force_gain = 14.0, config.std_friction = 15.0;
    config.std_external_force = 16.0, config.std_external_stiffness = 17.0;
    ipe_systematic_std(&config, std);                                                                           // when
    const double expected[] = {1,  1,  1,  2,  3,  3,   3,  4,  4,  4,  5,  6,  7,    8,  8,  8,  9,  9,  9,
                               10, 11, 12, 12, 12, 0.5, 16, 16, 16, 17, 17, 17, 2e-5, 13, 13, 14, 14, 15, 15};  // then
    TEST_ASSERT_EQUAL_INT(38, ipe_systematic_count(2));
    for (int i = 0; i < 38; ++i) { TEST_ASSERT_EQUAL_DOUBLE(expected[i], std[i]); }
}

static void test_std_of_what_the_robot_cannot_have_are_zero(void)
{
    double std[IPE_XI_MAX];
    config.std_acc_scale = config.std_gyro_scale = config.std_attitude_delay = 1.0;
    for (int i = 0; i < 8; ++i) { config.cable[i].weight_per_length = 0.0; }
    config.attitude_estimate = IPE_ATTITUDE_FUSED;  // given
    ipe_systematic_std(&config, std);               // when
    TEST_ASSERT_EQUAL_DOUBLE(0.0, std[IPE_XI_ACC_SCALE]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, std[IPE_XI_GYRO_SCALE]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, std[IPE_XI_ATTITUDE_DELAY]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, std[IPE_XI_CABLE_INERTIA]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, std[IPE_XI_EXTERNAL_FORCE]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, std[IPE_XI_EXTERNAL_STIFFNESS]);
}

static void test_table_lies_as_the_indices_say(void)
{
    const struct {
        const char* name;
        int first;
    } expected[] = {{"attitude_bias", IPE_XI_ATTITUDE},
                    {"world_yaw", IPE_XI_YAW},
                    {"acc_bias", IPE_XI_ACC_BIAS},
                    {"imu_alignment", IPE_XI_ALIGNMENT},
                    {"position_delay", IPE_XI_POSITION_DELAY},
                    {"force_delay", IPE_XI_FORCE_DELAY},
                    {"attitude_delay", IPE_XI_ATTITUDE_DELAY},
                    {"imu_position", IPE_XI_IMU_POSITION},
                    {"tracker_target", IPE_XI_TRACKER_TARGET},
                    {"acc_scale", IPE_XI_ACC_SCALE},
                    {"gyro_scale", IPE_XI_GYRO_SCALE},
                    {"gyro_bias", IPE_XI_GYRO_BIAS},
                    {"cable_inertia", IPE_XI_CABLE_INERTIA},
                    {"external_force", IPE_XI_EXTERNAL_FORCE},
                    {"external_stiffness", IPE_XI_EXTERNAL_STIFFNESS},
                    {"force_lowpass", IPE_XI_FORCE_LOWPASS},
                    {"force_offset", IPE_XI_FORCE},
                    {"force_gain", IPE_XI_FORCE + 8},
                    {"friction", IPE_XI_FORCE + 16}};
    int n, first = 0;
    const ipe_systematic_kind_t* kinds = ipe_systematic_table(&n);  // when, of 8 cables
    TEST_ASSERT_EQUAL_INT(19, n);                                   // then
    for (int k = 0; k < n; ++k) {
        TEST_ASSERT_EQUAL_STRING(expected[k].name, kinds[k].name);
        TEST_ASSERT_EQUAL_INT(expected[k].first, first);
        first += kinds[k].count + 8 * kinds[k].count_per_cable;
    }
    TEST_ASSERT_EQUAL_INT(ipe_systematic_count(8), first);
}

static void test_columns_impossible_pose_is_refused(void)
{
    ipe_average_t a = average_of(&config);  // given: P's attachment on its own anchor
    double X[IPE_NY][IPE_XI_MAX], B[3];
    mat3_mul_vec((const double (*)[3])a.R, config.cable[3].attachment, B);
    vec3_axpy(config.cable[3].anchor, -1.0, B, a.p);
    TEST_ASSERT_EQUAL_INT(IPE_ERR_GEOMETRY, ipe_systematic_columns(&config, &a, theta, X));  // when, then
}

static void test_systematic_name_of_each_parameter(void)
{
    static const char* const EXPECTED[] = {"attitude_bias_x",      "attitude_bias_y",
                                           "attitude_bias_z",      "world_yaw",
                                           "acc_bias_x",           "acc_bias_y",
                                           "acc_bias_z",           "imu_alignment_x",
                                           "imu_alignment_y",      "imu_alignment_z",
                                           "position_delay",       "force_delay",
                                           "attitude_delay",       "imu_position_x",
                                           "imu_position_y",       "imu_position_z",
                                           "tracker_target_x",     "tracker_target_y",
                                           "tracker_target_z",     "acc_scale",
                                           "gyro_scale",           "gyro_bias_x",
                                           "gyro_bias_y",          "gyro_bias_z",
                                           "cable_inertia",        "external_force_x",
                                           "external_force_y",     "external_force_z",
                                           "external_stiffness_x", "external_stiffness_y",
                                           "external_stiffness_z", "force_lowpass",
                                           "force_offset_1",       "force_offset_2",
                                           "force_gain_1",         "force_gain_2",
                                           "friction_1",           "friction_2"};
    char name[IPE_SYSTEMATIC_NAME_MAX];
    TEST_ASSERT_EQUAL(sizeof EXPECTED / sizeof EXPECTED[0], ipe_systematic_count(2));
    for (int i = 0; i < ipe_systematic_count(2); ++i) {
        ipe_systematic_name(2, i, name);
        TEST_ASSERT_EQUAL_STRING(EXPECTED[i], name);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_columns_equal_residuals_of_a_corrected_calibration);
    RUN_TEST(test_std_are_the_configured_ones_in_order);
    RUN_TEST(test_table_lies_as_the_indices_say);
    RUN_TEST(test_std_of_what_the_robot_cannot_have_are_zero);
    RUN_TEST(test_columns_impossible_pose_is_refused);
    RUN_TEST(test_systematic_name_of_each_parameter);
    return UNITY_END();
}
