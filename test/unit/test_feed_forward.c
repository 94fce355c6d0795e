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

static void test_the_derivative_is_that_of_the_wrench(void)
{
    uint64_t seed = 5;
    const double a[3] = {0.3, -0.2, 0.5}, w[3] = {0.4, -0.7, 0.2}, alpha[3] = {1.0, -2.0, 0.5};
    double theta[IPE_NP], wrench[IPE_NY], moved[IPE_NY], Y[IPE_NY][IPE_NP];
    nominal_theta(theta);
    ipe_feed_forward(theta, LEVEL, a, w, alpha, 9.81, wrench, Y);
    for (int k = 0; k < IPE_NP; ++k) {
        double other[IPE_NP];
        for (int i = 0; i < IPE_NP; ++i) { other[i] = theta[i]; }
        const double step = between(&seed, 0.1, 1.0);
        other[k] += step;
        ipe_feed_forward(other, LEVEL, a, w, alpha, 9.81, moved, NULL);
        for (int j = 0; j < IPE_NY; ++j) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, Y[j][k] * step, moved[j] - wrench[j]); }
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_a_body_at_rest_takes_its_weight_and_its_moment);
    RUN_TEST(test_a_turned_body_feels_gravity_in_its_own_axes);
    RUN_TEST(test_the_derivative_is_that_of_the_wrench);
    return UNITY_END();
}
