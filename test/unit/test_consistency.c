// SPDX-License-Identifier: Apache-2.0
#include "consistency.h"

#include "robot.h"

static uint64_t seed;

void setUp(void)
{
    seed = 71;
}

void tearDown(void)
{
}

/// Smallest eigenvalue of a symmetric 4 x 4 matrix by Jacobi's rotations; A is spoiled.
static double smallest_eigenvalue(double A[4][4])
{
    for (int sweep = 0; sweep < 30; ++sweep) {
        for (int p = 0; p < 3; ++p) {
            for (int q = p + 1; q < 4; ++q) {
                if (A[p][q] == 0.0) { continue; }
                const double angle = 0.5 * atan2(2.0 * A[p][q], A[q][q] - A[p][p]), c = cos(angle), s = sin(angle);
                for (int k = 0; k < 4; ++k) {
                    const double kp = A[k][p], kq = A[k][q];
                    A[k][p] = c * kp - s * kq, A[k][q] = s * kp + c * kq;
                }
                for (int k = 0; k < 4; ++k) {
                    const double pk = A[p][k], qk = A[q][k];
                    A[p][k] = c * pk - s * qk, A[q][k] = s * pk + c * qk;
                }
            }
        }
    }
    return fmin(fmin(A[0][0], A[1][1]), fmin(A[2][2], A[3][3]));
}

static void test_check_agrees_with_eigenvalues(void)
{
    int n_consistent = 0, n_not = 0;  // given: bodies around the edge of the possible
    for (int n = 0; n < 20000; ++n) {
        double theta[IPE_NP], noise[IPE_NP], Pi[4][4];
        nominal_theta(theta);
        fill_normal(&seed, noise, IPE_NP);
        for (int i = 0; i < IPE_NP; ++i) { theta[i] += 25.0 * noise[i]; }

        const bool consistent = ipe_consistency_check(theta);  // when

        ipe_consistency_pseudo_inertia(theta, Pi);             // then
        const double smallest = smallest_eigenvalue(Pi);
        if (fabs(smallest) < 1e-9) { continue; }
        TEST_ASSERT_EQUAL_INT(smallest > 0.0, consistent);
        n_consistent += consistent, n_not += !consistent;
    }
    TEST_ASSERT_GREATER_THAN_INT(2000, n_consistent);
    TEST_ASSERT_GREATER_THAN_INT(2000, n_not);
}

static void test_pseudo_inertia_is_second_moment_of_mass(void)
{
    double theta[IPE_NP] = {0.0}, expected[4][4] = {{0.0}}, Pi[4][4];  // given: point masses
    for (int k = 0; k < 5; ++k) {
        double r[4] = {0.0, 0.0, 0.0, 1.0};
        const double m = between(&seed, 1.0, 9.0);
        fill_normal(&seed, r, 3);
        theta[0] += m;
        for (int i = 0; i < 3; ++i) { theta[1 + i] += m * r[i]; }
        theta[4] += m * (r[1] * r[1] + r[2] * r[2]), theta[5] += m * (r[0] * r[0] + r[2] * r[2]);
        theta[6] += m * (r[0] * r[0] + r[1] * r[1]);
        theta[7] -= m * r[1] * r[2], theta[8] -= m * r[0] * r[2], theta[9] -= m * r[0] * r[1];
        for (int i = 0; i < 4; ++i) {
            for (int j = 0; j < 4; ++j) { expected[i][j] += m * r[i] * r[j]; }
        }
    }
    ipe_consistency_pseudo_inertia(theta, Pi);                                                                // when
    for (int i = 0; i < 16; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, (&expected[0][0])[i], (&Pi[0][0])[i]); }  // then
    TEST_ASSERT_TRUE(ipe_consistency_check(theta));
}

/// theta of a mass, CoG and central inertia.
static void check_body(bool expected, double m, const double c[3], const double J[6])
{
    const double theta[IPE_NP] = {
        m,
        m * c[0],
        m * c[1],
        m * c[2],
        J[0] + m * (c[1] * c[1] + c[2] * c[2]),
        J[1] + m * (c[0] * c[0] + c[2] * c[2]),
        J[2] + m * (c[0] * c[0] + c[1] * c[1]),
        J[3] - m * c[1] * c[2],
        J[4] - m * c[0] * c[2],
        J[5] - m * c[0] * c[1],
    };
    TEST_ASSERT_EQUAL_INT(expected, ipe_consistency_check(theta));
}

static void test_check_paper_nominal_exists_and_its_estimate_does_not(void)
{
    check_body(true, 161.058, (const double[]){-0.001, -0.077, -0.118},
               (const double[]){94.955, 88.859, 31.635, 4.136, -0.085, -0.393});
    check_body(false, 170.740, (const double[]){0.112, -0.134, -0.125},
               (const double[]){102.982, 52.744, 46.589, 8.588, -0.132, -3.672});
}

static void test_check_triangle_inequality_decides(void)
{
    const double centre[3] = {0.3, 0.2, -0.1};  // given, when, then
    check_body(true, 2.0, centre, (const double[]){1.0, 1.0, 1.99, 0.0, 0.0, 0.0});
    check_body(false, 2.0, centre, (const double[]){1.0, 1.0, 2.01, 0.0, 0.0, 0.0});
    check_body(false, -2.0, centre, (const double[]){1.0, 1.0, 1.0, 0.0, 0.0, 0.0});
    check_body(false, 2.0, centre, (const double[]){1.0, 1.0, -1.0, 0.0, 0.0, 0.0});
}

static void test_check_nonfinite_is_refused(void)
{
    for (int i = 0; i < IPE_NP; ++i) {  // given
        double theta[IPE_NP];
        nominal_theta(theta);
        theta[i] = NAN;
        TEST_ASSERT_FALSE(ipe_consistency_check(theta));  // when, then
    }
}

/// Some covariance, not diagonal.
static void random_covariance(double P[IPE_NP][IPE_NP])
{
    double A[IPE_NP][IPE_NP];
    fill_normal(&seed, &A[0][0], IPE_NP * IPE_NP);
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) {
            P[i][j] = i == j ? 20.0 : 0.0;
            for (int k = 0; k < IPE_NP; ++k) { P[i][j] += 5.0 * A[i][k] * A[j][k]; }
        }
    }
}

/// a^T P^-1 b by the Cholesky factor of P.
static double in_metric(const double P[IPE_NP][IPE_NP], const double a[IPE_NP], const double b[IPE_NP])
{
    double L[IPE_NP][IPE_NP], u[IPE_NP], v[IPE_NP], sum = 0.0;
    memcpy(L, P, sizeof L);
    TEST_ASSERT_TRUE(cholesky(&L[0][0], IPE_NP));
    for (int i = 0; i < IPE_NP; ++i) {
        u[i] = a[i], v[i] = b[i];
        for (int j = 0; j < i; ++j) { u[i] -= L[i][j] * u[j], v[i] -= L[i][j] * v[j]; }
        u[i] /= L[i][i], v[i] /= L[i][i];
        sum += u[i] * v[i];
    }
    return sum;
}

static void random_theta(double spread, double theta[IPE_NP])
{
    double noise[IPE_NP];
    nominal_theta(theta);
    fill_normal(&seed, noise, IPE_NP);
    for (int i = 0; i < IPE_NP; ++i) { theta[i] += spread * noise[i]; }
}

static void test_project_gives_the_nearest_body_that_can_exist(void)
{
    int n_projected = 0, n_given_up = 0;
    for (int n = 0; n < 500; ++n) {  // given
        double theta[IPE_NP], P[IPE_NP][IPE_NP], q[IPE_NP], moved[IPE_NP], distance;
        random_theta(40.0, theta);
        random_covariance(P);
        if (theta[0] < 20.0 || ipe_consistency_check(theta)) { continue; }

        if (!ipe_consistency_project(theta, (const double (*)[IPE_NP])P, q, &distance)) {  // when
            TEST_ASSERT_EQUAL_MEMORY(theta, q, sizeof q);
            ++n_given_up;
            continue;
        }
        TEST_ASSERT_TRUE(ipe_consistency_check(q));  // then
        for (int i = 0; i < IPE_NP; ++i) { moved[i] = theta[i] - q[i]; }
        TEST_ASSERT_DOUBLE_WITHIN(1e-6 * distance, in_metric((const double (*)[IPE_NP])P, moved, moved), distance);
        for (int k = 0; k < 200; ++k) {  // every other body lies beyond the tangent plane at q
            double other[IPE_NP], way[IPE_NP];
            random_theta(20.0, other);
            if (!ipe_consistency_check(other)) { continue; }
            for (int i = 0; i < IPE_NP; ++i) { way[i] = other[i] - q[i]; }
            const double margin = 0.05 * sqrt(distance * in_metric((const double (*)[IPE_NP])P, way, way));
            ASSERT_BELOW(margin, in_metric((const double (*)[IPE_NP])P, moved, way));
        }
        ++n_projected;
    }
    TEST_ASSERT_GREATER_THAN_INT(100, n_projected);
    TEST_ASSERT_LESS_THAN_INT(1 + n_projected / 100, n_given_up);
}

static void test_project_leaves_a_body_that_can_exist(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP], q[IPE_NP], distance = -1.0;  // given
    nominal_theta(theta);
    random_covariance(P);
    TEST_ASSERT_TRUE(ipe_consistency_project(theta, (const double (*)[IPE_NP])P, q, &distance));  // when
    TEST_ASSERT_EQUAL_MEMORY(theta, q, sizeof q);                                                 // then
    TEST_ASSERT_EQUAL_DOUBLE(0.0, distance);
}

static void test_project_nonfinite_is_refused(void)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP], q[IPE_NP], distance;  // given
    random_covariance(P);
    for (int i = 0; i < IPE_NP; ++i) {
        nominal_theta(theta);
        theta[i] = i % 2 ? NAN : INFINITY;
        TEST_ASSERT_FALSE(ipe_consistency_project(theta, (const double (*)[IPE_NP])P, q, &distance));  // when, then
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_check_agrees_with_eigenvalues);
    RUN_TEST(test_pseudo_inertia_is_second_moment_of_mass);
    RUN_TEST(test_check_paper_nominal_exists_and_its_estimate_does_not);
    RUN_TEST(test_check_triangle_inequality_decides);
    RUN_TEST(test_check_nonfinite_is_refused);
    RUN_TEST(test_project_gives_the_nearest_body_that_can_exist);
    RUN_TEST(test_project_leaves_a_body_that_can_exist);
    RUN_TEST(test_project_nonfinite_is_refused);
    return UNITY_END();
}
