// SPDX-License-Identifier: Apache-2.0
#include "body_step.h"

#include "regressor.h"
#include "robot.h"

enum { WINDOWS = 4, ALL = WINDOWS * IPE_NY };

static const double STD[IPE_NP] = {3.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.2, 0.2, 0.2};
static const double ZERO[IPE_NY][IPE_NY] = {{0.0}};

static ipe_body_step_t step;
static ipe_body_step_fit_t fit;
static uint64_t seed;
static double Y[WINDOWS][IPE_NY][IPE_NP], S[IPE_NY][IPE_NY], L[IPE_NY][IPE_NY], V[IPE_NY][IPE_NY];

void setUp(void)
{
    seed = 17;
    ipe_body_step_start(&step);
    memset(L, 0, sizeof L);
    for (int k = 0; k < WINDOWS; ++k) {
        double s[3], ww[6], alpha[3];
        fill_normal(&seed, s, 3);
        fill_normal(&seed, ww, 6);
        fill_normal(&seed, alpha, 3);
        s[2] += 9.81;
        ipe_regressor(s, ww, alpha, Y[k]);
    }
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j <= i; ++j) { L[i][j] = i == j ? 0.5 + 0.1 * i : 0.05 * normal(&seed); }
        for (int j = 0; j < IPE_NY; ++j) { S[i][j] = i == j ? 0.2 : 0.02; }
    }
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NY; ++j) {
            V[i][j] = S[i][j];
            for (int k = 0; k < IPE_NY; ++k) { V[i][j] += L[i][k] * L[j][k]; }
        }
    }
}

void tearDown(void)
{
}

static void innovation_of(int k, const double d[IPE_NP], double noise, double e[IPE_NY])
{
    double white[IPE_NY];
    fill_normal(&seed, white, IPE_NY);
    for (int i = 0; i < IPE_NY; ++i) {
        e[i] = 0.0;
        for (int p = 0; p < IPE_NP; ++p) { e[i] += Y[k][i][p] * d[p]; }
        for (int j = 0; j <= i; ++j) { e[i] += noise * L[i][j] * white[j]; }
    }
}

static bool add(int k, const double e[IPE_NY])
{
    return ipe_body_step_add(&step, (const double (*)[IPE_NP])Y[k], e, (const double (*)[IPE_NY])S,
                             (const double (*)[IPE_NY])L);
}

/// Log-likelihood of e [ALL], up to a constant, under N(0, V of each window + share G diag(std^2) G^T).
static double log_likelihood(const double* e, double share)
{
    static double C[ALL * ALL];
    double sum = 0.0, x[ALL];
    for (int i = 0; i < ALL; ++i) {
        for (int j = 0; j < ALL; ++j) {
            C[i * ALL + j] = i / IPE_NY == j / IPE_NY ? V[i % IPE_NY][j % IPE_NY] : 0.0;
            for (int p = 0; p < IPE_NP; ++p) {
                C[i * ALL + j] += share * Y[i / IPE_NY][i % IPE_NY][p] * STD[p] * STD[p] * Y[j / IPE_NY][j % IPE_NY][p];
            }
        }
    }
    TEST_ASSERT_TRUE(cholesky(C, ALL));
    cholesky_solve(C, ALL, e, x);
    for (int i = 0; i < ALL; ++i) { sum -= 0.5 * e[i] * x[i] + log(C[i * ALL + i]); }
    return sum;
}

static void test_solve_ratio_is_that_of_the_likelihoods(void)
{
    const double d[IPE_NP] = {1.0, 0.3, -0.2, 0.1, 0.1, 0.2, 0.1, 0.0, 0.05, 0.0};
    double e[WINDOWS][IPE_NY];
    for (int k = 0; k < WINDOWS; ++k) {  // given: a step under noise, which it explains
        innovation_of(k, d, 0.3, e[k]);
        TEST_ASSERT_TRUE(add(k, e[k]));
    }
    ipe_body_step_solve(&step, STD, 1.0, &fit);  // when
    TEST_ASSERT_TRUE(fit.misfit < 1.0);          // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, log_likelihood(&e[0][0], 1.0) - log_likelihood(&e[0][0], 0.0),
                              fit.log_likelihood_ratio);
}

static void test_solve_finds_the_step(void)
{
    const double d[IPE_NP] = {1.0, 0.3, -0.2, 0.1, 0.1, 0.2, 0.1, 0.0, 0.05, 0.0};
    double e[IPE_NY], precise[IPE_NP];
    for (int k = 0; k < WINDOWS; ++k) {
        innovation_of(k, d, 0.0, e);
        TEST_ASSERT_TRUE(add(k, e));
    }
    for (int p = 0; p < IPE_NP; ++p) { precise[p] = 1e4; }  // given: next to no prior
    ipe_body_step_solve(&step, precise, 1.0, &fit);         // when
    for (int p = 0; p < IPE_NP; ++p) { TEST_ASSERT_DOUBLE_WITHIN(1e-3, d[p], fit.theta[p]); }  // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.0, fit.remaining);
    TEST_ASSERT_TRUE(fit.first_moments > 100.0);
}

static void test_solve_noise_prefers_no_step(void)
{
    const double none[IPE_NP] = {0.0};
    int n_preferred = 0;
    for (int trial = 0; trial < 1000; ++trial) {  // given
        ipe_body_step_start(&step);
        for (int k = 0; k < WINDOWS; ++k) {
            double e[IPE_NY];
            innovation_of(k, none, 1.0, e);
            TEST_ASSERT_TRUE(add(k, e));
        }
        ipe_body_step_solve(&step, STD, 1.0, &fit);  // when
        n_preferred += fit.log_likelihood_ratio > 0.0;
    }
    TEST_ASSERT_LESS_THAN_INT(5, n_preferred);  // then
}

static void test_solve_push_is_no_step_of_a_body(void)
{
    for (int k = 0; k < WINDOWS; ++k) {  // given: 30 sigma across gravity
        double e[IPE_NY] = {15.0};
        TEST_ASSERT_TRUE(add(k, e));
    }
    ipe_body_step_solve(&step, STD, 1.0, &fit);  // when
    TEST_ASSERT_TRUE(fit.misfit > 10.0);         // then
    TEST_ASSERT_TRUE(fit.log_likelihood_ratio < 20.0);
}

static void test_solve_larger_scale_of_noise_lowers_the_ratio(void)
{
    const double d[IPE_NP] = {1.0};
    double e[IPE_NY];
    innovation_of(0, d, 0.0, e);
    TEST_ASSERT_TRUE(add(0, e));  // given
    ipe_body_step_solve(&step, STD, 1.0, &fit);
    const double honest = fit.log_likelihood_ratio;
    ipe_body_step_solve(&step, STD, 10.0, &fit);                // when
    TEST_ASSERT_TRUE(fit.log_likelihood_ratio < 0.5 * honest);  // then
}

static void test_add_values_that_are_not_finite_are_refused(void)
{
    const ipe_body_step_t before = step;
    double e[IPE_NY] = {NAN};      // given
    TEST_ASSERT_FALSE(add(0, e));  // when, then
    e[0] = 1.0;
    TEST_ASSERT_FALSE(ipe_body_step_add(&step, (const double (*)[IPE_NP])Y[0], e, ZERO, ZERO));
    TEST_ASSERT_EQUAL_MEMORY(&before, &step, sizeof step);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_solve_ratio_is_that_of_the_likelihoods);
    RUN_TEST(test_solve_finds_the_step);
    RUN_TEST(test_solve_noise_prefers_no_step);
    RUN_TEST(test_solve_push_is_no_step_of_a_body);
    RUN_TEST(test_solve_larger_scale_of_noise_lowers_the_ratio);
    RUN_TEST(test_add_values_that_are_not_finite_are_refused);
    return UNITY_END();
}
