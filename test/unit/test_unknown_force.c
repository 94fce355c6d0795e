// SPDX-License-Identifier: Apache-2.0
#include "unknown_force.h"

#include "robot.h"

static double S[IPE_NY][IPE_NY], L[IPE_NY][IPE_NY];
static double innovation[IPE_NY], y[IPE_NY], excess[IPE_UNKNOWN_FORCE_MAX];
static ipe_unknown_force_t u;
static ipe_config_t config;
static uint64_t seed;

void setUp(void)
{
    double A[IPE_NY][IPE_NY];
    seed = 7;
    config = cogiro();
    memset(L, 0, sizeof L);
    fill_normal(&seed, &A[0][0], IPE_NY * IPE_NY);
    fill_normal(&seed, innovation, IPE_NY);
    fill_normal(&seed, y, IPE_NY);
    u = (ipe_unknown_force_t){.n = 0};
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j <= i; ++j) { L[i][j] = i == j ? 1.0 + 0.3 * i : 0.2 * normal(&seed); }
        for (int j = 0; j < IPE_NY; ++j) {
            S[i][j] = 0.0;
            for (int k = 0; k < IPE_NY; ++k) { S[i][j] += 0.1 * A[i][k] * A[j][k]; }
        }
    }
}

void tearDown(void)
{
}

/// One more unknown force with a random column. Returns it.
static const double* add_unknown(void)
{
    fill_normal(&seed, u.mean[u.n], IPE_NY);
    return u.mean[u.n++];
}

static ipe_status_t take_out(void)
{
    return ipe_unknown_force_take_out(&u, (const double (*)[IPE_NY])S, innovation, y, excess, L);
}

/// Information of 6 equations along direction v: v^T (L L^T)^-1 v.
static double information(const double v[IPE_NY])
{
    double z[IPE_NY], sum = 0.0;
    for (int i = 0; i < IPE_NY; ++i) {
        z[i] = v[i];
        for (int k = 0; k < i; ++k) { z[i] -= L[i][k] * z[k]; }
        z[i] /= L[i][i];
        sum += z[i] * z[i];
    }
    return sum;
}

static void test_take_out_of_none_changes_nothing(void)
{
    double L_before[IPE_NY][IPE_NY], e[IPE_NY];
    memcpy(L_before, L, sizeof L);
    memcpy(e, innovation, sizeof e);
    TEST_ASSERT_EQUAL_INT(IPE_OK, take_out());
    TEST_ASSERT_EQUAL_MEMORY(L_before, L, sizeof L);
    TEST_ASSERT_EQUAL_MEMORY(e, innovation, sizeof e);
}

static void test_take_out_nothing_is_told_along_the_cables(void)
{
    const double *w = add_unknown(), *v = add_unknown();
    const double along_w = information(w), along_v = information(v);  // given
    TEST_ASSERT_EQUAL_INT(IPE_OK, take_out());                        // when
    ASSERT_BELOW(1e-6 * along_w, information(w));                     // then
    ASSERT_BELOW(1e-6 * along_v, information(v));
}

static void test_take_out_leaves_what_the_force_does_not_touch(void)
{
    const double* w = add_unknown();
    double v[IPE_NY];
    double a[IPE_NY] = {1.0, -2.0, 0.5, 0.3, 1.1, -0.7}, wa = 0.0, ww = 0.0;
    for (int i = 0; i < IPE_NY; ++i) {
        wa += w[i] * a[i];
        ww += w[i] * w[i];
    }
    for (int i = 0; i < IPE_NY; ++i) { a[i] -= wa / ww * w[i]; }  // given: v = C a with a across w, so v^T C^-1 w = 0
    for (int i = 0; i < IPE_NY; ++i) {
        v[i] = 0.0;
        for (int j = 0; j < IPE_NY; ++j) {
            for (int k = 0; k < IPE_NY; ++k) { v[i] += L[i][k] * L[j][k] * a[j]; }
        }
    }
    const double before = information(v);
    TEST_ASSERT_EQUAL_INT(IPE_OK, take_out());
    TEST_ASSERT_DOUBLE_WITHIN(1e-6 * before, before, information(v));
}

static void test_take_out_finds_the_force(void)
{
    const double* w = add_unknown();
    for (int i = 0; i < IPE_NY; ++i) { innovation[i] = 150.0 * w[i]; }  // given: read 150 N too much
    TEST_ASSERT_EQUAL_INT(IPE_OK, take_out());                          // when
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 150.0, excess[0]);                  // then
    for (int i = 0; i < IPE_NY; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.0, innovation[i]); }
}

static void test_take_out_not_finite_is_refused(void)
{
    (void)add_unknown();
    S[2][2] = NAN;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_NONFINITE, take_out());
}

/// Kernel of the windows at z of 0 .. 4 quarters.
static double spline(double z)
{
    const double v = z > 2.0 ? 4.0 - z : z, c = v - 1.0;
    return v < 1.0 ? v * v * v / 6.0 : (1.0 + 3.0 * c + 3.0 * c * c - 3.0 * c * c * c) / 6.0;
}

static void test_columns_are_those_of_a_moving_platform(void)
{
    enum { STEPS = 400 };
    const double length = 0.4, pull = 80.0, growth = 150.0;  // given: CoGiRo moves, a force grows
    ipe_average_t a = {.length = length, .unknown_force = 1U << 2};
    double exact[IPE_NY] = {0.0}, rest[IPE_NY] = {0.0};
    for (int k = 0; k < STEPS; ++k) {
        const double t = length * ((k + 0.5) / STEPS - 0.5), share = spline(4.0 * (k + 0.5) / STEPS) * 4.0 / STEPS;
        const ideal_t x = ideal_at(&config, 3.0 + t, config.prior_theta);
        double W[IPE_NY][IPE_CABLES_MAX], sag[IPE_NY], R[3][3], w[3], rpy[3], p[3];
        pose_at(3.0 + t, p, rpy);
        rate_at(3.0 + t, w);
        mat3_from_quat(x.q, R);
        TEST_ASSERT_EQUAL_INT(IPE_OK,
                              ipe_wrench_matrix(&config, p, (const double (*)[3])R, config.imu_position, W, sag));
        for (int i = 0; i < IPE_NY; ++i) { exact[i] += share * (pull + growth * t) * W[i][2]; }
        for (int i = 0; i < 3; ++i) {
            a.p[i] += share * p[i];
            a.velocity[i] += share * t * p[i] * 48.0 / (length * length);
            a.alpha[i] += share * t * w[i] * 48.0 / (length * length);
            a.w[i] += share * w[i];
        }
        if (k == STEPS / 2) {
            memcpy(a.R, R, sizeof R);
            for (int i = 0; i < IPE_NY; ++i) { rest[i] = pull * W[i][2]; }
        }
    }
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_unknown_force_columns(&config, &a, &u));  // when
    TEST_ASSERT_EQUAL_INT(1, u.n);  // then: a tenth of what W's turning makes
    TEST_ASSERT_EQUAL_INT(2, u.cable[0]);
    double off = 0.0, turned = 0.0;
    for (int i = 0; i < IPE_NY; ++i) {
        off += fabs(exact[i] - pull * u.mean[0][i] - growth * u.turned[0][i]);
        turned += fabs(exact[i] - rest[i]);
    }
    ASSERT_BELOW(0.1 * turned, off);
}

static void test_columns_of_too_many_are_refused(void)
{
    const ideal_t x = ideal_at(&config, 3.0, config.prior_theta);
    ipe_average_t a = {.length = 0.4, .unknown_force = 0x1F};
    double rpy[3];
    pose_at(3.0, a.p, rpy);
    mat3_from_quat(x.q, a.R);
    TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_unknown_force_columns(&config, &a, &u));
    a.unknown_force = 0xF;
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_unknown_force_columns(&config, &a, &u));
    TEST_ASSERT_EQUAL_INT(4, u.n);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_take_out_of_none_changes_nothing);
    RUN_TEST(test_take_out_nothing_is_told_along_the_cables);
    RUN_TEST(test_take_out_leaves_what_the_force_does_not_touch);
    RUN_TEST(test_take_out_finds_the_force);
    RUN_TEST(test_take_out_not_finite_is_refused);
    RUN_TEST(test_columns_are_those_of_a_moving_platform);
    RUN_TEST(test_columns_of_too_many_are_refused);
    return UNITY_END();
}
