// SPDX-License-Identifier: Apache-2.0
#include "dead_reckoning.h"

#include "robot.h"

#define MS 1000000LL
#define NEVER 1000000000LL  // ms

static ipe_config_t config;
static ipe_dead_reckoning_t carry;
static double theta[IPE_NP];
static double x[3];

void setUp(void)
{
    config = cogiro();
    config.max_carry = 0.5;
    nominal_theta(theta);
    memset(x, 0, sizeof x);
}

void tearDown(void)
{
}

/// out = a b
static void quat_mul(const double a[4], const double b[4], double out[4])
{
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3];
    out[3] = a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1];
}

/// Unit quaternion of a rotation vector.
static void quat_exp(const double v[3], double q[4])
{
    const double angle = vec3_norm(v), share = angle > 0.0 ? sin(0.5 * angle) / angle : 0.5;
    q[0] = cos(0.5 * angle);
    for (int i = 0; i < 3; ++i) { q[1 + i] = share * v[i]; }
}

/// What the sensors say at t_ms: specific force off by acc_bias, attitude yaw q tilt instead of q.
static ideal_t measured(int64_t t_ms, const double acc_bias[3], double yaw, const double tilt[3])
{
    ideal_t m = ideal_at(&config, 1e-3 * (double)t_ms, theta);
    const double up[3] = {0.0, 0.0, yaw};
    double before[4], after[4], turned[4];
    quat_exp(up, before);
    quat_exp(tilt, after);
    quat_mul(before, m.q, turned);
    quat_mul(turned, after, m.q);
    for (int i = 0; i < 3; ++i) { m.acc[i] += acc_bias[i]; }
    return m;
}

static const double NONE[3] = {0.0, 0.0, 0.0};

/// IMU at 200 Hz, tracker at 100 Hz while seen, from begin up to end, ms.
static void run(int64_t begin, int64_t end, int64_t seen_until, const double acc_bias[3], const double tilt[3])
{
    for (int64_t t = begin; t < end; t += 5) {
        const ideal_t m = measured(t, acc_bias, 0.0, tilt);
        ipe_dead_reckoning_advance(&carry, t * MS, m.acc, m.q);
        if (t < seen_until) { ipe_dead_reckoning_learn(&carry, (uint64_t)(t / 10), m.position); }
    }
}

static double error_at(int64_t t_ms)
{
    double p[3], rpy[3], off[3];
    pose_at(1e-3 * (double)t_ms, p, rpy);
    vec3_axpy(x, -1.0, p, off);
    return vec3_norm(off);
}

static void test_read_follows_the_motion_through_a_gap(void)
{
    ipe_dead_reckoning_init(&carry, &config);
    run(0, 10000, NEVER, NONE, NONE);                       // given: seen for 10 s
    for (int64_t t = 10000; t <= 10490; t += 5) {
        run(t, t + 5, 0, NONE, NONE);                       // when: not any more
        TEST_ASSERT_TRUE(ipe_dead_reckoning_read(&carry, x));
        TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.0, error_at(t));  // then
    }
}

static void test_read_bias_of_accelerometer_and_attitude_is_learnt(void)
{
    const double bias[3] = {0.05, -0.03, 0.02}, tilt[3] = {5e-3, -5e-3, 0.0};  // 12 mm in 0.5 s, if not
    config.std_acc_bias = 0.05, config.std_attitude = 5e-3;
    ipe_dead_reckoning_init(&carry, &config);
    run(0, 20000, NEVER, bias, tilt);                       // given
    run(20000, 20500, 0, bias, tilt);                       // when
    TEST_ASSERT_TRUE(ipe_dead_reckoning_read(&carry, x));
    TEST_ASSERT_DOUBLE_WITHIN(3e-3, 0.0, error_at(20495));  // then
}

static void test_read_takes_the_calibration_off(void)
{
    config.acc_bias[0] = 0.4, config.acc_bias[2] = -0.3;  // given: 0.1 m in 0.5 s, and nothing left to learn
    config.attitude_bias[1] = 0.05, config.world_yaw = 0.3;
    ipe_dead_reckoning_init(&carry, &config);
    const double tilt[3] = {0.0, -0.05, 0.0};
    for (int64_t t = 0; t < 10500; t += 5) {
        const ideal_t m = measured(t, config.acc_bias, -0.3, tilt);
        ipe_dead_reckoning_advance(&carry, t * MS, m.acc, m.q);
        if (t < 10000) { ipe_dead_reckoning_learn(&carry, (uint64_t)(t / 10), m.position); }
    }
    TEST_ASSERT_TRUE(ipe_dead_reckoning_read(&carry, x));   // when
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.0, error_at(10495));  // then
}

static void test_read_longer_than_max_carry_is_refused(void)
{
    ipe_dead_reckoning_init(&carry, &config);
    run(0, 10000, NEVER, NONE, NONE);
    run(10000, 10500, 0, NONE, NONE);  // given: last seen at 9995
    TEST_ASSERT_TRUE(ipe_dead_reckoning_read(&carry, x));
    const double before = x[0];
    run(10500, 10505, 0, NONE, NONE);  // when
    TEST_ASSERT_FALSE(ipe_dead_reckoning_read(&carry, x));
    TEST_ASSERT_EQUAL_DOUBLE(before, x[0]);
}

static void test_read_max_carry_0_is_refused(void)
{
    config.max_carry = 0.0;
    ipe_dead_reckoning_init(&carry, &config);
    run(0, 10000, NEVER, NONE, NONE);
    run(10000, 10005, 0, NONE, NONE);
    TEST_ASSERT_FALSE(ipe_dead_reckoning_read(&carry, x));
}

static void test_read_before_enough_was_seen_is_refused(void)
{
    ipe_dead_reckoning_init(&carry, &config);
    run(0, 100, 0, NONE, NONE);
    TEST_ASSERT_FALSE(ipe_dead_reckoning_read(&carry, x));  // never seen
    run(100, 200, 105, NONE, NONE);
    TEST_ASSERT_FALSE(ipe_dead_reckoning_read(&carry, x));  // seen once: its velocity is not known
}

static void test_read_after_a_contradicting_position_is_refused(void)
{
    ipe_dead_reckoning_init(&carry, &config);
    run(0, 10000, NEVER, NONE, NONE);
    const double elsewhere[3] = {5.0, 5.0, 5.0};
    ipe_dead_reckoning_learn(&carry, 123456, elsewhere);  // given
    run(10000, 10050, 0, NONE, NONE);                     // when
    TEST_ASSERT_FALSE(ipe_dead_reckoning_read(&carry, x));
}

static void test_advance_gap_or_step_back_of_the_imu_forgets(void)
{
    const int64_t next[] = {10000 + 60, 9000};  // max_age is 50 ms
    for (int i = 0; i < 2; ++i) {
        ipe_dead_reckoning_init(&carry, &config);
        run(0, 10000, NEVER, NONE, NONE);          // given
        run(next[i], next[i] + 5, 0, NONE, NONE);  // when
        TEST_ASSERT_FALSE(ipe_dead_reckoning_read(&carry, x));
    }
}

static void test_learn_for_days_at_rest_stays_positive(void)
{
    ipe_dead_reckoning_init(&carry, &config);
    const ideal_t m = rest_at(&config, 1.0, theta);
    for (int64_t t = 0; t < 2000000; ++t) {
        ipe_dead_reckoning_advance(&carry, 10 * t * MS, m.acc, m.q);
        ipe_dead_reckoning_learn(&carry, (uint64_t)t, m.position);
    }
    const double* P = carry.P;  // pp pv pb vv vb bb
    TEST_ASSERT_TRUE(P[0] > 0.0 && P[3] > 0.0 && P[5] >= 0.0);
    TEST_ASSERT_TRUE(P[0] * P[3] > P[1] * P[1] && P[3] * P[5] >= P[4] * P[4]);
    TEST_ASSERT_DOUBLE_WITHIN(4e-6, 0.0, P[0]);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_read_follows_the_motion_through_a_gap);
    RUN_TEST(test_read_bias_of_accelerometer_and_attitude_is_learnt);
    RUN_TEST(test_read_takes_the_calibration_off);
    RUN_TEST(test_read_longer_than_max_carry_is_refused);
    RUN_TEST(test_read_max_carry_0_is_refused);
    RUN_TEST(test_read_before_enough_was_seen_is_refused);
    RUN_TEST(test_read_after_a_contradicting_position_is_refused);
    RUN_TEST(test_advance_gap_or_step_back_of_the_imu_forgets);
    RUN_TEST(test_learn_for_days_at_rest_stays_positive);
    return UNITY_END();
}
