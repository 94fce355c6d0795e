// SPDX-License-Identifier: Apache-2.0
#include "body.h"

#include "robot.h"

static uint64_t seed;
static double theta[IPE_NP], P[IPE_NP][IPE_NP];

void setUp(void)
{
    seed = 5;
    nominal_theta(theta);
    memset(P, 0, sizeof P);
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1.0 + i; }
}

void tearDown(void)
{
}

static void test_from_theta_gives_the_body_it_was_made_of(void)
{
    ipe_body_t body;  // given: Table III's nominal body
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_body_from_theta(theta, (const double (*)[IPE_NP])P, &body));           // when
    const double cog[3] = {-0.001, -0.077, -0.118}, J[6] = {94.955, 88.859, 31.635, 4.136, -0.085, -0.393};  // then
    TEST_ASSERT_EQUAL_DOUBLE(161.058, body.mass);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-15, cog[i], body.cog[i]); }
    for (int i = 0; i < 6; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, J[i], body.inertia_cog[i]); }
    TEST_ASSERT_EQUAL_DOUBLE(1.0, body.mass_std);
}

static void test_from_theta_mass_not_positive_is_refused(void)
{
    const double bad[] = {0.0, -1.0, NAN};  // given
    for (int i = 0; i < 3; ++i) {
        ipe_body_t body = {.mass = 7.0}, before = body;
        theta[0] = bad[i];
        TEST_ASSERT_EQUAL_INT(IPE_ERR_RANGE, ipe_body_from_theta(theta, (const double (*)[IPE_NP])P, &body));  // when
        TEST_ASSERT_EQUAL_MEMORY(&before, &body, sizeof body);                                                 // then
    }
}

static void test_shift_of_a_point_mass_is_that_mass_elsewhere(void)
{
    double point[IPE_NP] = {3.0};          // given: 3 kg at the reference point
    const double d[3] = {0.5, -1.0, 2.0};  // the point lies at d from the new one
    ipe_body_shift(d, point, NULL);        // when
    const double expected[IPE_NP] = {3.0, 1.5, -3.0, 6.0, 15.0, 12.75, 3.75, 6.0, -3.0, 1.5};  // then
    for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, expected[i], point[i]); }
}

static void test_shift_there_and_back_changes_nothing(void)
{
    for (int n = 0; n < 100; ++n) {  // given
        double d[3], back[3], shifted[IPE_NP], Q[IPE_NP][IPE_NP];
        fill_normal(&seed, d, 3);
        for (int i = 0; i < 3; ++i) { back[i] = -d[i]; }
        memcpy(shifted, theta, sizeof theta);
        memcpy(Q, P, sizeof P);

        ipe_body_shift(d, shifted, Q);  // when
        ipe_body_shift(back, shifted, Q);

        for (int i = 0; i < IPE_NP; ++i) {  // then
            TEST_ASSERT_DOUBLE_WITHIN(1e-10, theta[i], shifted[i]);
            for (int j = 0; j < IPE_NP; ++j) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, P[i][j], Q[i][j]); }
        }
    }
}

static void test_shift_leaves_mass_and_central_inertia(void)
{
    double d[3];  // given
    ipe_body_t before, after;
    fill_normal(&seed, d, 3);
    (void)ipe_body_from_theta(theta, (const double (*)[IPE_NP])P, &before);
    ipe_body_shift(d, theta, P);                        // when
    (void)ipe_body_from_theta(theta, (const double (*)[IPE_NP])P, &after);
    TEST_ASSERT_EQUAL_DOUBLE(before.mass, after.mass);  // then: and their standard deviations
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, before.cog[i] + d[i], after.cog[i]); }
    for (int i = 0; i < 6; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, before.inertia_cog[i], after.inertia_cog[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, before.inertia_cog_std[i], after.inertia_cog_std[i]);
    }
}

static void test_shift_covariance_is_that_of_the_shifted_matrix(void)
{
    const double d[3] = {0.3, -0.2, 0.7};  // given
    double T[IPE_NP][IPE_NP], Q[IPE_NP][IPE_NP], unit[IPE_NP];
    ipe_body_shift_matrix(d, T);
    memcpy(Q, P, sizeof P);
    ipe_body_shift(d, theta, Q);        // when
    for (int j = 0; j < IPE_NP; ++j) {  // then: T is the shift's columns, Q = T P T^T
        memset(unit, 0, sizeof unit);
        unit[j] = 1.0;
        ipe_body_shift(d, unit, NULL);
        for (int i = 0; i < IPE_NP; ++i) {
            TEST_ASSERT_EQUAL_DOUBLE(T[i][j], unit[i]);
            double sum = 0.0;
            for (int k = 0; k < IPE_NP; ++k) { sum += T[i][k] * P[k][k] * T[j][k]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, sum, Q[i][j]);
            TEST_ASSERT_EQUAL_DOUBLE(Q[j][i], Q[i][j]);
        }
    }
}

static void values_of(const double t[IPE_NP], double value[IPE_NP])
{
    ipe_body_t body;
    (void)ipe_body_from_theta(t, (const double (*)[IPE_NP])P, &body);
    value[0] = body.mass;
    memcpy(value + 1, body.cog, sizeof body.cog);
    memcpy(value + 4, body.inertia_cog, sizeof body.inertia_cog);
}

static void test_jacobian_equals_finite_differences(void)
{
    double G[IPE_NP][IPE_NP];  // given: a body far from its reference point
    const double d[3] = {0.5, 0.4, -0.3};
    ipe_body_shift(d, theta, NULL);
    ipe_body_jacobian(theta, G);        // when
    for (int j = 0; j < IPE_NP; ++j) {  // then
        double plus[IPE_NP], minus[IPE_NP], moved[IPE_NP];
        const double h = 1e-4;
        memcpy(moved, theta, sizeof moved);
        moved[j] += h;
        values_of(moved, plus);
        moved[j] -= 2.0 * h;
        values_of(moved, minus);
        for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-7, (plus[i] - minus[i]) / (2.0 * h), G[i][j]); }
    }
}

static void test_from_theta_std_agrees_with_samples(void)
{
    enum { N = 100000 };  // given: theta scattered by a small P
    ipe_body_t body;
    double sum2[IPE_NP] = {0.0}, value[IPE_NP], centre[IPE_NP];
    for (int i = 0; i < IPE_NP; ++i) { P[i][i] = 1e-4 * (1.0 + i); }
    values_of(theta, centre);
    for (int n = 0; n < N; ++n) {
        double e[IPE_NP];
        fill_normal(&seed, e, IPE_NP);
        for (int i = 0; i < IPE_NP; ++i) { e[i] = theta[i] + e[i] * sqrt(P[i][i]); }
        values_of(e, value);
        for (int i = 0; i < IPE_NP; ++i) { sum2[i] += (value[i] - centre[i]) * (value[i] - centre[i]) / N; }
    }
    (void)ipe_body_from_theta(theta, (const double (*)[IPE_NP])P, &body);           // when
    TEST_ASSERT_DOUBLE_WITHIN(0.02 * body.mass_std, sqrt(sum2[0]), body.mass_std);  // then
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(0.02 * body.cog_std[i], sqrt(sum2[1 + i]), body.cog_std[i]);
    }
    for (int i = 0; i < 6; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(0.02 * body.inertia_cog_std[i], sqrt(sum2[4 + i]), body.inertia_cog_std[i]);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_from_theta_gives_the_body_it_was_made_of);
    RUN_TEST(test_from_theta_mass_not_positive_is_refused);
    RUN_TEST(test_shift_of_a_point_mass_is_that_mass_elsewhere);
    RUN_TEST(test_shift_there_and_back_changes_nothing);
    RUN_TEST(test_shift_leaves_mass_and_central_inertia);
    RUN_TEST(test_shift_covariance_is_that_of_the_shifted_matrix);
    RUN_TEST(test_jacobian_equals_finite_differences);
    RUN_TEST(test_from_theta_std_agrees_with_samples);
    return UNITY_END();
}
