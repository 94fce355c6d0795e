// SPDX-License-Identifier: Apache-2.0
#include "motion.h"

#include "robot.h"

#define MS 1000000LL
#define START 1000000000000LL

enum { PARAMETERS = IPE_MOTION_NP };

/// How the sensors differ from ideal ones.
typedef struct {
    double acc_bias[3], acc_scale[3], gyro_bias[3], gyro_scale[3], yaw, position_delay;
    double acc_noise, gyro_noise, position_noise, lean;  ///< lean: rad of AHRS tilt per m/s2
} faults_t;

static ipe_config_t config;
static ipe_motion_stage_t stage;
static faults_t faults;
static double theta[IPE_NP];
static uint64_t seed;
static ipe_row_t row;
static ipe_motion_t motion;
static ipe_status_t status;

void setUp(void)
{
    config = cogiro();
    config.imu_orientation[0] = sqrt(0.5), config.imu_orientation[3] = sqrt(0.5);
    config.tracker_target[0] = -0.2, config.tracker_target[2] = 0.4;
    config.std_attitude_wander = 0.01;
    config.max_carry = 1.0;
    config.attitude_estimate = IPE_ATTITUDE_FUSED;
    memset(&faults, 0, sizeof faults);
    memset(&row, 0, sizeof row);
    faults.lean = 0.01;
    nominal_theta(theta);
    seed = 7;
}

void tearDown(void)
{
}

static void quat_mul(const double a[4], const double b[4], double out[4])
{
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3];
    out[3] = a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1];
}

static void quat_exp(const double v[3], double q[4])
{
    const double angle = vec3_norm(v), share = angle > 0.0 ? sin(0.5 * angle) / angle : 0.5;
    q[0] = cos(0.5 * angle);
    for (int i = 0; i < 3; ++i) { q[1 + i] = share * v[i]; }
}

/// Where the tracked point is at t.
static void target_at(double t, double x[3])
{
    double p[3], rpy[3], q[4], R[3][3], arm[3];
    pose_at(t, p, rpy);
    quat_from_rpy(rpy, q);
    mat3_from_quat(q, R);
    mat3_mul_vec(R, (double[3]){-0.2, 0.0, 0.4}, arm);
    vec3_axpy(p, 1.0, arm, x);
}

/// The row of t seconds after START. Its AHRS leans with the acceleration.
static void make_row(double t, const ideal_t* m)
{
    double R_PI[3][3], R[3][3], up[3], wrong[4], turned[4];
    mat3_from_quat(config.imu_orientation, R_PI);
    mat3_from_quat(m->q, R);
    mat3_tmul_vec(R_PI, m->acc, row.acc);
    mat3_tmul_vec(R_PI, m->gyro, row.gyro);
    mat3_mul_vec(R, m->acc, up);
    quat_exp((double[3]){-faults.lean * up[1], faults.lean * up[0], -faults.yaw}, wrong);
    quat_mul(wrong, m->q, turned);
    quat_mul(turned, config.imu_orientation, row.q);
    for (int i = 0; i < 3; ++i) {
        row.acc[i] = row.acc[i] * (1.0 + faults.acc_scale[i]) + faults.acc_bias[i] + faults.acc_noise * normal(&seed);
        row.gyro[i] =
            row.gyro[i] * (1.0 + faults.gyro_scale[i]) + faults.gyro_bias[i] + faults.gyro_noise * normal(&seed);
    }
    target_at(t - faults.position_delay, row.position);
    for (int i = 0; i < 3; ++i) { row.position[i] += faults.position_noise * normal(&seed); }
    row.t_ns = START + (int64_t)llround(1e9 * t);
    row.has_force = row.has_position = row.is_position_new = true;
}

static void push_moving(int64_t t_ms)
{
    const double t = 1e-3 * (double)t_ms;
    const ideal_t m = ideal_at(&config, t, theta);
    make_row(t, &m);
    status = ipe_motion_push(&stage, &row, &motion);
}

/// IMU and tracker at 200 Hz from begin up to end, ms.
static void run(int64_t begin, int64_t end)
{
    for (int64_t t = begin; t < end; t += 5) { push_moving(t); }
}

static void start(void)
{
    ipe_motion_init(&stage, &config);
}

/// Rotation vector of A B^T, small.
static void difference(const double A[3][3], const double B[3][3], double v[3])
{
    double D[3][3];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { D[i][j] = vec3_dot(A[i], B[j]); }
    }
    v[0] = 0.5 * (D[2][1] - D[1][2]), v[1] = 0.5 * (D[0][2] - D[2][0]), v[2] = 0.5 * (D[1][0] - D[0][1]);
}

/// What the attitude lacks at t_ms, W axes.
static void attitude_error(int64_t t_ms, double v[3])
{
    double p[3], rpy[3], q[4], R[3][3];
    pose_at(1e-3 * (double)t_ms, p, rpy);
    quat_from_rpy(rpy, q);
    mat3_from_quat(q, R);
    difference((const double (*)[3])R, (const double (*)[3])motion.R, v);
}

static void test_tilt_does_not_follow_an_ahrs_that_leans_with_acceleration(void)
{
    start();
    double worst_ahrs = 0.0;
    for (int64_t t = 0; t < 20000; t += 5) {
        double own[3], R_q[3][3], R_PI[3][3], R[3][3], ahrs[3];
        push_moving(t);
        if (t < 5000) { continue; }
        attitude_error(t, own);
        ASSERT_BELOW(2e-4, hypot(own[0], own[1]));
        ASSERT_BELOW(2e-3, fabs(own[2]));
        mat3_from_quat(row.q, R_q);
        mat3_from_quat(config.imu_orientation, R_PI);
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) { R[i][j] = vec3_dot(R_q[i], R_PI[j]) - motion.R[i][j]; }
        }
        ahrs[0] = R[2][1];
        worst_ahrs = fmax(worst_ahrs, fabs(ahrs[0]));
    }
    TEST_ASSERT_EQUAL(IPE_OK, status);
    ASSERT_BELOW(worst_ahrs, 0.02);
}

static double worst_tilt_at(int64_t period)
{
    double worst = 0.0, v[3];
    start();
    for (int64_t t = 0; t < 20000; t += period) {
        push_moving(t);
        if (t < 5000) { continue; }
        attitude_error(t, v);
        worst = fmax(worst, hypot(v[0], v[1]));
    }
    return worst;
}

static void test_tilt_of_coarse_rows(void)
{
    faults.lean = 0.0;
    const double fast = worst_tilt_at(5), slow = worst_tilt_at(40);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    ASSERT_BELOW(2e-6, fast);  // 2 orders below what straight lines between rows and a fixed axis of turning leave
    ASSERT_BELOW(3e-4, slow);  // there 1.5e-3
}

/// Two runs of 30 s, the second with the parameter known to it: what the first lacked is what its sensitivity says.
static void check_sensitivity(int parameter, double size, double tolerance)
{
    faults.position_noise = 2e-3;  // so that both runs weigh alike
    const ipe_config_t plain = config;
    start();
    run(0, 30000);
    const ipe_motion_t without = motion;
    const ipe_motion_stage_t unaware = stage;
    config = plain;
    if (parameter < IPE_MOTION_BY_LEVER) {
        config.acc_bias[parameter] += size;
    } else if (parameter < IPE_MOTION_BY_DELAY) {
        config.tracker_target[parameter - IPE_MOTION_BY_LEVER] += size;
    } else if (parameter == IPE_MOTION_BY_YAW) {
        config.world_yaw += size;
    } else {
        faults.position_delay -= size;  // as align would take it out
    }
    seed = 7;
    start();
    run(0, 30000);
    double v[3], scale = 5e-2 * size;
    difference((const double (*)[3])motion.R, (const double (*)[3])without.R, v);
    for (int i = 0; i < 3; ++i) { scale = fmax(scale, fabs(v[i])); }
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(tolerance * scale, v[i], size * without.error.attitude[i][parameter]);
    }
    for (int i = 0; i < 3; ++i) {
        const double beta = stage.beta[i] - unaware.beta[i], kappa = stage.kappa[i] - unaware.kappa[i];
        const double by_beta = size * without.error.force_scale[i][parameter];
        const double by_kappa = size * without.error.rate_scale[i][parameter];
        TEST_ASSERT_DOUBLE_WITHIN(tolerance * fabs(beta) + 1e-2 * size, beta, by_beta);
        TEST_ASSERT_DOUBLE_WITHIN(tolerance * fabs(kappa) + 1e-2 * size, kappa, by_kappa);
    }
}

static void test_sensitivity_to_accelerometer_bias(void)
{
    for (int i = 0; i < 3; ++i) {
        setUp();
        check_sensitivity(IPE_MOTION_BY_ACC_BIAS + i, 0.01, 0.06);
    }
}

static void test_sensitivity_to_lever(void)
{
    for (int i = 0; i < 3; ++i) {
        setUp();
        check_sensitivity(IPE_MOTION_BY_LEVER + i, 5e-4, 0.4);
    }
}

static void test_sensitivity_to_position_delay(void)
{
    check_sensitivity(IPE_MOTION_BY_DELAY, 2e-4, 0.05);
}

static void test_sensitivity_to_yaw(void)
{
    check_sensitivity(IPE_MOTION_BY_YAW, 1e-3, 0.06);
}

static void test_accelerometer_bias_tilts_by_itself_over_gravity(void)
{
    faults.acc_bias[0] = 0.05;
    start();
    run(0, 20000);
    double v[3], expected[3];
    attitude_error(19995, v);
    for (int i = 0; i < 3; ++i) { expected[i] = 0.05 * motion.error.attitude[i][0]; }
    ASSERT_BELOW(hypot(v[0], v[1]), 2.5e-3);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(5e-4, expected[i], v[i]); }
}

static void test_gyro_bias_and_scales_are_found(void)
{
    const double scale[3] = {0.01, -0.01, 0.01};
    for (int i = 0; i < 3; ++i) { faults.acc_scale[i] = scale[i], faults.gyro_scale[i] = -scale[i]; }
    faults.gyro_bias[0] = 3e-3, faults.gyro_bias[1] = -2e-3, faults.gyro_bias[2] = 1e-3;
    start();
    run(0, 60000);
    const ideal_t m = ideal_at(&config, 59.995, theta);
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(5e-3, m.acc[i], motion.s[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1.5e-3, m.gyro[i], motion.w[i]);
    }
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-3, scale[i], stage.beta[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-3, -scale[i], stage.kappa[i]);
    }
}

static void test_errors_are_as_large_as_declared(void)
{
    faults.acc_noise = 0.03, faults.gyro_noise = 3e-3, faults.position_noise = 2e-3;
    double square[3] = {0.0}, n = 0.0;
    for (int k = 1; k <= 4; ++k) {
        seed = (uint64_t)k;
        start();
        for (int64_t t = 0; t < 30000; t += 5) {
            double v[3];
            push_moving(t);
            if (t < 5000 || t % 500 != 0) { continue; }
            attitude_error(t, v);
            for (int i = 0; i < 3; ++i) { square[i] += v[i] * v[i] / pow(motion.error.attitude_std[i], 2.0); }
            n += 1.0;
        }
    }
    for (int i = 0; i < 3; ++i) {
        ASSERT_BELOW(1.8, square[i] / n);
        ASSERT_BELOW(square[i] / n, 0.1);
    }
    TEST_ASSERT_DOUBLE_WITHIN(4e-4, 2e-3, sqrt(stage.position_variance));
}

static void test_gap_of_the_tracker_is_bridged_up_to_max_carry(void)
{
    faults.gyro_bias[1] = 2e-3;
    start();
    run(0, 20000);
    for (int64_t t = 20000; t < 21500; t += 5) {
        double p[3], rpy[3], e[3];
        const double seconds = 1e-3 * (double)t;
        const ideal_t m = ideal_at(&config, seconds, theta);
        make_row(seconds, &m);
        row.has_position = row.is_position_new = false;
        memset(row.position, 0, sizeof row.position);
        status = ipe_motion_push(&stage, &row, &motion);
        TEST_ASSERT_EQUAL(t <= 20995 ? IPE_OK : IPE_IGNORED, status);
        if (status != IPE_OK) { continue; }
        pose_at(seconds, p, rpy);
        vec3_axpy(p, -1.0, motion.p, e);
        ASSERT_BELOW(2e-3, vec3_norm(e));
    }
    TEST_ASSERT_EQUAL_UINT64(200, stage.n_carried);
    TEST_ASSERT_EQUAL_UINT64(100, stage.n_no_position);
    push_moving(21500);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_starts);
}

static void test_velocity_is_that_of_the_platform(void)
{
    start();
    run(0, 10000);
    double before[3], after[3], rpy[3];
    pose_at(9.994, before, rpy);
    pose_at(9.996, after, rpy);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(2e-3, (after[i] - before[i]) / 2e-3, motion.v[i]); }
}

static void test_position_off_by_metres_is_refused(void)
{
    start();
    run(0, 10000);
    const ideal_t m = ideal_at(&config, 10.0, theta);
    make_row(10.0, &m);
    row.position[1] += 8.0;
    status = ipe_motion_push(&stage, &row, &motion);
    double p[3], rpy[3];
    pose_at(10.0, p, rpy);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(2e-3, p[i], motion.p[i]); }
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_positions_refused);
    run(10005, 20000);
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_positions_refused);
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_starts);
}

static void test_positions_that_contradict_each_other_do_not_start_anew(void)
{
    start();
    run(0, 10000);
    for (int64_t t = 10000; t < 11000; t += 5) {  // given: a second of them, metres off, each elsewhere
        const ideal_t m = ideal_at(&config, 1e-3 * (double)t, theta);
        make_row(1e-3 * (double)t, &m);
        row.position[0] += (t / 5 % 2 == 0 ? 8.0 : -8.0);
        (void)ipe_motion_push(&stage, &row, &motion);
    }
    TEST_ASSERT_EQUAL_UINT64(200, stage.n_positions_refused);
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_starts);
}

static void test_target_that_stays_elsewhere_is_followed(void)
{
    start();
    run(0, 10000);
    for (int64_t t = 10000; t < 15000; t += 5) {
        const ideal_t m = ideal_at(&config, 1e-3 * (double)t, theta);
        make_row(1e-3 * (double)t, &m);
        row.position[0] += 0.5;
        status = ipe_motion_push(&stage, &row, &motion);
    }
    double p[3], rpy[3], v[3];
    pose_at(14.995, p, rpy);
    attitude_error(14995, v);
    TEST_ASSERT_EQUAL_UINT64(2, stage.n_starts);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, p[0] + 0.5, motion.p[0]);
    ASSERT_BELOW(5e-4, hypot(v[0], v[1]));
}

static void test_gap_of_the_imu_keeps_the_tilt(void)
{
    faults.lean = 0.0;
    start();
    run(0, 10000);
    run(10500, 12000);
    double v[3];
    attitude_error(11995, v);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    TEST_ASSERT_EQUAL_UINT64(2, stage.n_starts);
    ASSERT_BELOW(2e-3, hypot(v[0], v[1]));
}

static void test_no_position_yet_is_no_motion(void)
{
    start();
    const ideal_t m = ideal_at(&config, 0.0, theta);
    make_row(0.0, &m);
    row.has_position = row.is_position_new = false;
    TEST_ASSERT_EQUAL(IPE_IGNORED, ipe_motion_push(&stage, &row, &motion));
    TEST_ASSERT_EQUAL_UINT64(1, stage.n_no_position);
    push_moving(5);
    TEST_ASSERT_EQUAL(IPE_NOT_READY, status);
}

static void test_tilt_must_be_known_first(void)
{
    start();
    int64_t t = 0;
    do {
        push_moving(t);
        t += 5;
    } while (status == IPE_NOT_READY && t < 5000);
    double v[3];
    attitude_error(t - 5, v);
    ASSERT_BELOW(3000.0, (double)t);
    ASSERT_BELOW(0.02, hypot(v[0], v[1]));
    TEST_ASSERT_EQUAL_UINT64((uint64_t)t / 5 - 1, stage.n_unsettled);
}

static void test_platform_that_vibrates_has_a_motion_all_the_same(void)
{
    faults.acc_noise = 3.0;  // given: m/s2, with which tilt and scales stay unknown for minutes
    faults.position_noise = 0.003;
    start();
    run(0, 10000);
    TEST_ASSERT_EQUAL_UINT64(0, stage.n_rows);
    run(10000, 60000);  // when
    double v[3];
    attitude_error(59995, v);
    TEST_ASSERT_GREATER_THAN_UINT64(5000, stage.n_rows);  // then: half of the rows after that, and
    ASSERT_BELOW(4.0 * hypot(motion.error.attitude_std[0], motion.error.attitude_std[1]), hypot(v[0], v[1]));  // honest
}

static void test_outage_of_the_tracker_is_no_time_of_settling(void)
{
    faults.acc_noise = 0.3, faults.gyro_noise = 0.02;
    start();
    run(0, 20000);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    for (int64_t t = 20000; t < 80000; t += 5) {  // when: a minute without positions, in which the tilt drifts
        const ideal_t m = ideal_at(&config, 1e-3 * (double)t, theta);
        make_row(1e-3 * (double)t, &m);
        row.has_position = row.is_position_new = false;
        status = ipe_motion_push(&stage, &row, &motion);
    }
    TEST_ASSERT_EQUAL(IPE_IGNORED, status);
    const uint64_t n_unsettled = stage.n_unsettled;
    int64_t t = 80000;
    do {
        push_moving(t);
        t += 5;
    } while (status != IPE_OK && t < 95000);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    TEST_ASSERT_GREATER_THAN_UINT64(n_unsettled, stage.n_unsettled);
    const double sigma = sqrt(stage.spread.P[IPE_MOTION_PHI][IPE_MOTION_PHI]);
    ASSERT_BELOW(3e-3 * fmax(1.0, 1e-4 * (double)(t - 80000)), sigma);  // then: known as at the start
}

static void test_time_going_back_changes_nothing(void)
{
    start();
    run(0, 1000);
    const ipe_motion_stage_t before = stage;
    push_moving(990);
    TEST_ASSERT_EQUAL(IPE_ERR_TIME, status);
    TEST_ASSERT_EQUAL_MEMORY(&before, &stage, sizeof stage);
    push_moving(995);
    TEST_ASSERT_EQUAL(IPE_ERR_TIME, status);
}

static void test_ten_minutes_at_rest(void)
{
    faults.acc_noise = 0.01, faults.gyro_noise = 1e-3, faults.position_noise = 1e-3, faults.lean = 0.0;
    faults.gyro_bias[2] = 2e-3;
    const ideal_t m = rest_at(&config, 0.4, theta);
    start();
    for (int64_t t = 0; t < 600000; t += 40) {
        make_row(1e-3 * (double)t, &m);
        target_at(0.4, row.position);
        for (int i = 0; i < 3; ++i) { row.position[i] += faults.position_noise * normal(&seed); }
        status = ipe_motion_push(&stage, &row, &motion);
    }
    double v[3];
    attitude_error(400, v);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    ASSERT_BELOW(3e-3, hypot(v[0], v[1]));
    ASSERT_BELOW(0.03, fabs(v[2]));
    TEST_ASSERT_DOUBLE_WITHIN(3e-4, 2e-3, stage.b[2]);
    for (int i = 0; i < IPE_MOTION_STATES; ++i) {
        for (int j = 0; j < IPE_MOTION_STATES; ++j) {
            const double (*P)[IPE_MOTION_STATES] = (const double (*)[IPE_MOTION_STATES])stage.spread.P;
            TEST_ASSERT_EQUAL_DOUBLE(P[i][j], P[j][i]);
            ASSERT_BELOW(1.0 + 1e-9, P[i][j] * P[i][j] / (P[i][i] * P[j][j]));
        }
    }
}

static void test_fixed_position_leaves_the_sensors_as_they_are(void)
{
    config.position_source = IPE_POSITION_FIXED;
    config.acc_bias[0] = 0.1, config.gyro_bias[1] = 0.01;
    start();
    push_moving(100);
    TEST_ASSERT_EQUAL(IPE_OK, status);
    const ideal_t m = ideal_at(&config, 0.1, theta);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, m.acc[1] - 0.1, motion.s[1]);  // x of I is y of P
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, m.gyro[0] + 0.01, motion.w[0]);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, motion.error.attitude[2][IPE_MOTION_BY_YAW]);
    TEST_ASSERT_EQUAL_DOUBLE(0.01, motion.error.attitude_std[0]);
}

static void test_new_gyro_bias_leaves_the_rate(void)
{
    faults.gyro_bias[0] = 3e-3;
    start();
    run(0, 20000);
    const double before = motion.w[1];
    ipe_motion_set_gyro_bias(&stage, (double[3]){3e-3, 0.0, 0.0});
    push_moving(20000);
    TEST_ASSERT_DOUBLE_WITHIN(2e-2, before, motion.w[1]);
    TEST_ASSERT_DOUBLE_WITHIN(3e-4, 0.0, stage.b[0]);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_tilt_does_not_follow_an_ahrs_that_leans_with_acceleration);
    RUN_TEST(test_tilt_of_coarse_rows);
    RUN_TEST(test_sensitivity_to_accelerometer_bias);
    RUN_TEST(test_sensitivity_to_lever);
    RUN_TEST(test_sensitivity_to_position_delay);
    RUN_TEST(test_sensitivity_to_yaw);
    RUN_TEST(test_accelerometer_bias_tilts_by_itself_over_gravity);
    RUN_TEST(test_gyro_bias_and_scales_are_found);
    RUN_TEST(test_errors_are_as_large_as_declared);
    RUN_TEST(test_gap_of_the_tracker_is_bridged_up_to_max_carry);
    RUN_TEST(test_velocity_is_that_of_the_platform);
    RUN_TEST(test_position_off_by_metres_is_refused);
    RUN_TEST(test_positions_that_contradict_each_other_do_not_start_anew);
    RUN_TEST(test_target_that_stays_elsewhere_is_followed);
    RUN_TEST(test_gap_of_the_imu_keeps_the_tilt);
    RUN_TEST(test_no_position_yet_is_no_motion);
    RUN_TEST(test_tilt_must_be_known_first);
    RUN_TEST(test_platform_that_vibrates_has_a_motion_all_the_same);
    RUN_TEST(test_outage_of_the_tracker_is_no_time_of_settling);
    RUN_TEST(test_time_going_back_changes_nothing);
    RUN_TEST(test_ten_minutes_at_rest);
    RUN_TEST(test_fixed_position_leaves_the_sensors_as_they_are);
    RUN_TEST(test_new_gyro_bias_leaves_the_rate);
    return UNITY_END();
}
