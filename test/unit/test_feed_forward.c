// SPDX-License-Identifier: Apache-2.0
#include "feed_forward.h"

#include "robot.h"

static const double LEVEL[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, NONE[3] = {0.0, 0.0, 0.0};

void setUp(void)
{
}

void tearDown(void)
{
}

static void test_a_body_at_rest_takes_its_weight_and_its_moment(void)
{
    double theta[IPE_NP], wrench[IPE_NY];
    nominal_theta(theta);
    ipe_feed_forward(theta, LEVEL, NONE, NONE, NONE, 9.81, wrench, NULL);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 9.81 * theta[0], wrench[2]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 9.81 * theta[2], wrench[3]);  // h x (g z)
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -9.81 * theta[1], wrench[4]);
}

static void test_a_turned_body_feels_gravity_in_its_own_axes(void)
{
    const double R[3][3] = {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}};  // x of P is y of W, y is z, z is x
    const double a[3] = {1.0, 2.0, 3.0};
    double theta[IPE_NP] = {2.0}, wrench[IPE_NY];
    theta[4] = theta[5] = theta[6] = 1.0;
    ipe_feed_forward(theta, R, a, NONE, NONE, 9.81, wrench, NULL);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0, wrench[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 2.0 * 12.81, wrench[1]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 2.0, wrench[2]);
}

enum { POINTS = 5 };
static const double H = 1e-3;  // s, of the differences: chosen so that their error is below 1e-5 of what they give

/// Place of P (W, m) and attitude (P to W) at a time: a motion in all six coordinates.
static void pose(double t, double p[3], double R[3][3])
{
    const double x = 0.4 * sin(1.1 * t), y = -0.5 * sin(0.9 * t + 1.0), z = 0.7 * cos(1.3 * t);
    const double Rx[3][3] = {{1, 0, 0}, {0, cos(x), -sin(x)}, {0, sin(x), cos(x)}};
    const double Ry[3][3] = {{cos(y), 0, sin(y)}, {0, 1, 0}, {-sin(y), 0, cos(y)}};
    const double Rz[3][3] = {{cos(z), -sin(z), 0}, {sin(z), cos(z), 0}, {0, 0, 1}};
    double both[3][3];
    mat3_mul(Ry, Rx, both);
    mat3_mul(Rz, (const double (*)[3])both, R);
    p[0] = 0.6 * sin(1.7 * t), p[1] = 0.3 * cos(2.1 * t), p[2] = 2.0 + 0.4 * sin(1.2 * t + 0.5);
}

static void place(double t, const double r[3], double x[3])
{
    double p[3], R[3][3], arm[3];
    pose(t, p, R);
    mat3_mul_vec(R, r, arm);
    for (int i = 0; i < 3; ++i) { x[i] = p[i] + arm[i]; }
}

/// Second derivative of the place of a point of the body, W.
static void acceleration(double t, const double r[3], double a[3])
{
    double before[3], at[3], after[3];
    place(t - H, r, before), place(t, r, at), place(t + H, r, after);
    for (int i = 0; i < 3; ++i) { a[i] = (before[i] - 2.0 * at[i] + after[i]) / (H * H); }
}

/// w = (R^T R')v, P axes.
static void rate(double t, double w[3])
{
    double p[3], before[3][3], at[3][3], after[3][3], W[3][3] = {{0.0}};
    pose(t - H, p, before), pose(t, p, at), pose(t + H, p, after);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            for (int k = 0; k < 3; ++k) { W[i][j] += at[k][i] * (after[k][j] - before[k][j]) / (2.0 * H); }
        }
    }
    w[0] = 0.5 * (W[2][1] - W[1][2]), w[1] = 0.5 * (W[0][2] - W[2][0]), w[2] = 0.5 * (W[1][0] - W[0][1]);
}

/// Newton's law for each of some point masses gives the wrench about P; Y theta is that of the ten parameters they make.
static void test_the_wrench_is_newtons_for_every_mass_of_the_body(void)
{
    uint64_t seed = 5;
    for (int trial = 0; trial < 20; ++trial) {
        const double t = between(&seed, 0.0, 10.0), g = 9.81;
        double theta[IPE_NP] = {0.0}, force[3] = {0.0}, moment[3] = {0.0}, p[3], R[3][3];
        pose(t, p, R);
        for (int k = 0; k < POINTS; ++k) {
            const double m = between(&seed, 1.0, 20.0);
            double r[3], a[3], f[3], arm[3];
            for (int i = 0; i < 3; ++i) { r[i] = between(&seed, -1.0, 1.0); }
            acceleration(t, r, a);
            a[2] += g;
            mat3_tmul_vec((const double (*)[3])R, a, f);
            for (int i = 0; i < 3; ++i) { force[i] += m * f[i]; }
            vec3_cross(r, f, arm);
            for (int i = 0; i < 3; ++i) { moment[i] += m * arm[i]; }
            const double x = r[0], y = r[1], z = r[2];
            const double own[IPE_NP] = {1.0,           x,      y,      z,     y * y + z * z, x * x + z * z,
                                        x * x + y * y, -y * z, -x * z, -x * y};
            for (int i = 0; i < IPE_NP; ++i) { theta[i] += m * own[i]; }
        }
        double a_P[3], w[3], before[3], after[3], alpha[3], wrench[IPE_NY], Y[IPE_NY][IPE_NP];
        acceleration(t, NONE, a_P);
        rate(t, w), rate(t - H, before), rate(t + H, after);
        for (int i = 0; i < 3; ++i) { alpha[i] = (after[i] - before[i]) / (2.0 * H); }
        ipe_feed_forward(theta, (const double (*)[3])R, a_P, w, alpha, g, wrench, Y);
        for (int i = 0; i < 3; ++i) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-2, force[i], wrench[i]);  // N of some 500
            TEST_ASSERT_DOUBLE_WITHIN(1e-2, moment[i], wrench[3 + i]);
        }
        for (int i = 0; i < IPE_NY; ++i) {
            double sum = 0.0;
            for (int j = 0; j < IPE_NP; ++j) { sum += Y[i][j] * theta[j]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-9, wrench[i], sum);
        }
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_a_body_at_rest_takes_its_weight_and_its_moment);
    RUN_TEST(test_a_turned_body_feels_gravity_in_its_own_axes);
    RUN_TEST(test_the_wrench_is_newtons_for_every_mass_of_the_body);
    return UNITY_END();
}
