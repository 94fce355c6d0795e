// SPDX-License-Identifier: Apache-2.0
#include "regressor.h"

#include "robot.h"

static uint64_t seed;

void setUp(void)
{
    seed = 23;
}

void tearDown(void)
{
}

static void times(double Y[IPE_NY][IPE_NP], const double theta[IPE_NP], double y[IPE_NY])
{
    for (int i = 0; i < IPE_NY; ++i) {
        y[i] = 0.0;
        for (int j = 0; j < IPE_NP; ++j) { y[i] += Y[i][j] * theta[j]; }
    }
}

/// Force and moment by Newton and Euler, point mass by point mass: a = s + alpha x r + w x (w x r).
static void by_point_masses(const double mass[], const double r[][3], int n, const double s[3], const double w[3],
                            const double alpha[3], double y[IPE_NY], double theta[IPE_NP])
{
    memset(y, 0, IPE_NY * sizeof(double));
    memset(theta, 0, IPE_NP * sizeof(double));
    for (int k = 0; k < n; ++k) {
        double turn[3], inward[3], centripetal[3], force[3], moment[3];
        vec3_cross(alpha, r[k], turn);
        vec3_cross(w, r[k], inward);
        vec3_cross(w, inward, centripetal);
        for (int i = 0; i < 3; ++i) { force[i] = mass[k] * (s[i] + turn[i] + centripetal[i]); }
        vec3_cross(r[k], force, moment);
        const double x = r[k][0], yy = r[k][1], z = r[k][2];
        const double J[6] = {yy * yy + z * z, x * x + z * z, x * x + yy * yy, -yy * z, -x * z, -x * yy};
        theta[0] += mass[k];
        for (int i = 0; i < 3; ++i) {
            y[i] += force[i], y[3 + i] += moment[i];
            theta[1 + i] += mass[k] * r[k][i];
        }
        for (int i = 0; i < 6; ++i) { theta[4 + i] += mass[k] * J[i]; }
    }
}

static void test_regressor_equals_newton_for_point_masses(void)
{
    for (int n = 0; n < 1000; ++n) {  // given: six masses, any motion
        double mass[6], r[6][3], s[3], w[3], alpha[3], ww[6], Y[IPE_NY][IPE_NP], expected[IPE_NY], y[IPE_NY];
        double theta[IPE_NP];
        for (int k = 0; k < 6; ++k) {
            mass[k] = between(&seed, 0.1, 40.0);
            fill_normal(&seed, r[k], 3);
        }
        fill_normal(&seed, s, 3), fill_normal(&seed, w, 3), fill_normal(&seed, alpha, 3);
        by_point_masses(mass, (const double (*)[3])r, 6, s, w, alpha, expected, theta);

        ipe_rate_products(w, ww);  // when
        ipe_regressor(s, ww, alpha, Y);

        times(Y, theta, y);  // then
        for (int i = 0; i < IPE_NY; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-10, expected[i], y[i]); }
    }
}

static void test_regressor_at_rest_is_weight_and_its_moment(void)
{
    const double s[3] = {0.0, 0.0, 9.81}, zero[6] = {0.0};  // given: upright, still
    double Y[IPE_NY][IPE_NP], theta[IPE_NP], y[IPE_NY];
    nominal_theta(theta);

    ipe_regressor(s, zero, zero, Y);  // when

    times(Y, theta, y);               // then: m g up, moment of the CoG's lever
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 161.058 * 9.81, y[2]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 161.058 * 9.81 * -0.077, y[3]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 161.058 * 9.81 * 0.001, y[4]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, y[5]);
}

static void test_regressor_of_averages_is_average_of_regressors(void)
{
    double s[3] = {0}, ww[6] = {0}, alpha[3] = {0}, mean[IPE_NY][IPE_NP] = {{0}}, Y[IPE_NY][IPE_NP];  // given
    for (int n = 0; n < 10; ++n) {
        double s_n[3], w_n[3], ww_n[6], alpha_n[3], Y_n[IPE_NY][IPE_NP];
        fill_normal(&seed, s_n, 3), fill_normal(&seed, w_n, 3), fill_normal(&seed, alpha_n, 3);
        ipe_rate_products(w_n, ww_n);
        ipe_regressor(s_n, ww_n, alpha_n, Y_n);
        for (int i = 0; i < 3; ++i) { s[i] += 0.1 * s_n[i], alpha[i] += 0.1 * alpha_n[i]; }
        for (int i = 0; i < 6; ++i) { ww[i] += 0.1 * ww_n[i]; }
        for (int i = 0; i < 60; ++i) { (&mean[0][0])[i] += 0.1 * (&Y_n[0][0])[i]; }
    }
    ipe_regressor(s, ww, alpha, Y);                                                                      // when
    for (int i = 0; i < 60; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-14, (&mean[0][0])[i], (&Y[0][0])[i]); }  // then
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_regressor_equals_newton_for_point_masses);
    RUN_TEST(test_regressor_at_rest_is_weight_and_its_moment);
    RUN_TEST(test_regressor_of_averages_is_average_of_regressors);
    return UNITY_END();
}
