// SPDX-License-Identifier: Apache-2.0
#include "rls.h"

#include "robot.h"

static ipe_rls_t rls;
static uint64_t seed;
static double x0[IPE_NP], P0[IPE_NP][IPE_NP], L[IPE_NY][IPE_NY], truth[IPE_NP];

/// Equations in theta, and in xi where the filter carries it.
enum { XI_MAX = IPE_NX_MAX - IPE_NP };

typedef struct {
    double Y[IPE_NY][IPE_NP], X[IPE_NY][XI_MAX], y[IPE_NY];
} block_t;

static void start(int n_xi)
{
    double std[XI_MAX];
    for (int i = 0; i < XI_MAX; ++i) { std[i] = 0.1 + 0.2 * i; }
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, n_xi, std));
}

void setUp(void)
{
    seed = 97;
    const ipe_config_t k = cogiro();
    memcpy(x0, k.prior_theta, sizeof x0);
    memcpy(P0, k.prior_covariance, sizeof P0);
    memset(L, 0, sizeof L);
    for (int i = 0; i < IPE_NY; ++i) {
        L[i][i] = 1.0 + 0.3 * i;
        for (int j = 0; j < i; ++j) { L[i][j] = 0.1 * (i - j); }
    }
    nominal_theta(truth);
    start(0);
}

void tearDown(void)
{
}

/// Equations of a random motion with noise of covariance L L^T.
static block_t random_block(double motion, double noise)
{
    block_t b;
    double s[3], w[3], ww[6], alpha[3], e[IPE_NY];
    fill_normal(&seed, s, 3), fill_normal(&seed, w, 3), fill_normal(&seed, alpha, 3), fill_normal(&seed, e, IPE_NY);
    for (int i = 0; i < 3; ++i) { s[i] *= motion, w[i] *= motion, alpha[i] *= motion; }
    s[2] += 9.81;
    ipe_rate_products(w, ww);
    ipe_regressor(s, ww, alpha, b.Y);
    for (int i = 0; i < IPE_NY; ++i) {
        b.y[i] = 0.0;
        fill_normal(&seed, b.X[i], rls.n - IPE_NP);
        for (int j = 0; j < IPE_NP; ++j) { b.y[i] += b.Y[i][j] * truth[j]; }
        for (int j = 0; j <= i; ++j) { b.y[i] += noise * L[i][j] * e[j]; }
    }
    return b;
}

/// [Y, X] as the filter takes it.
static void rows_of(const block_t* b, int n, double* H)
{
    for (int i = 0; i < IPE_NY; ++i) {
        memcpy(H + i * n, b->Y[i], sizeof b->Y[i]);
        memcpy(H + i * n + IPE_NP, b->X[i], sizeof(double) * (size_t)(n - IPE_NP));
    }
}

static ipe_status_t update(ipe_rls_t* s, const block_t* b, double* nis)
{
    double H[IPE_NY * IPE_NX_MAX];
    rows_of(b, s->n, H);
    return ipe_rls_update(s, H, b->y, (const double (*)[IPE_NY])L, nis);
}

/// Solve A x = y, n x n, by Gauss-Jordan with pivoting in long double; A is spoiled, y becomes x.
static void solve(long double* A, long double* y, int n)
{
    for (int c = 0; c < n; ++c) {
        int pivot = c;
        for (int r = c + 1; r < n; ++r) {
            if (fabsl(A[r * n + c]) > fabsl(A[pivot * n + c])) { pivot = r; }
        }
        for (int j = 0; j < n; ++j) {
            const long double t = A[c * n + j];
            A[c * n + j] = A[pivot * n + j], A[pivot * n + j] = t;
        }
        const long double t = y[c];
        y[c] = y[pivot], y[pivot] = t;
        for (int r = 0; r < n; ++r) {
            if (r == c) { continue; }
            const long double k = A[r * n + c] / A[c * n + c];
            for (int j = c; j < n; ++j) { A[r * n + j] -= k * A[c * n + j]; }
            y[r] -= k * y[c];
        }
    }
    for (int c = 0; c < n; ++c) { y[c] /= A[c * n + c]; }
}

/// L^-1 of a block, in long double.
static void whiten(const block_t* b, int n, long double H[IPE_NY][IPE_NX_MAX], long double z[IPE_NY])
{
    for (int i = 0; i < IPE_NY; ++i) {
        z[i] = b->y[i];
        for (int j = 0; j < n; ++j) { H[i][j] = j < IPE_NP ? b->Y[i][j] : b->X[i][j - IPE_NP]; }
        for (int k = 0; k < i; ++k) {
            z[i] -= L[i][k] * z[k];
            for (int j = 0; j < n; ++j) { H[i][j] -= L[i][k] * H[k][j]; }
        }
        z[i] /= L[i][i];
        for (int j = 0; j < n; ++j) { H[i][j] /= L[i][i]; }
    }
}

static void test_init_prior_is_reproduced(void)
{
    double A[IPE_NP][IPE_NP], P[IPE_NP][IPE_NP];  // given: a full covariance A A^T
    fill_normal(&seed, &A[0][0], IPE_NP * IPE_NP);
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) {
            P0[i][j] = 0.0;
            for (int k = 0; k < IPE_NP; ++k) { P0[i][j] += A[i][k] * A[j][k]; }
        }
    }
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, 0, NULL));  // when
    ipe_rls_covariance(&rls, IPE_NP, &P[0][0]);
    for (int i = 0; i < IPE_NP * IPE_NP; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, (&P0[0][0])[i], (&P[0][0])[i]);
    }  // then
    TEST_ASSERT_EQUAL_MEMORY(x0, rls.x, sizeof x0);
    TEST_ASSERT_TRUE(ipe_rls_invariants_hold(&rls));
}

static void test_init_covariance_not_positive_definite_is_refused(void)
{
    P0[4][4] = 0.0;  // given: a parameter known exactly
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, 0, NULL));  // when, then
    P0[4][4] = NAN;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, 0, NULL));
    P0[4][4] = 1.0, P0[4][5] = P0[5][4] = 1e4;  // correlation above 1
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, 0, NULL));
}

/// Information matrix N and vector v of the prior.
static void prior_information(long double N[IPE_NX_MAX][IPE_NX_MAX], long double v[IPE_NX_MAX])
{
    memset(N, 0, sizeof(long double) * IPE_NX_MAX * IPE_NX_MAX);
    memset(v, 0, sizeof(long double) * IPE_NX_MAX);
    for (int i = 0; i < rls.n; ++i) {
        N[i][i] = 1.0L / rls.D[i];
        v[i] = N[i][i] * rls.x[i];
    }
}

static void check_batch(int n_xi, int n_blocks)
{
    static long double N[IPE_NX_MAX][IPE_NX_MAX], v[IPE_NX_MAX], A[IPE_NX_MAX * IPE_NX_MAX];
    static double P[IPE_NX_MAX][IPE_NX_MAX];
    start(n_xi);  // given: the prior as information
    const int n = rls.n;
    prior_information(N, v);
    for (int k = 0; k < n_blocks; ++k) {  // when
        const block_t b = random_block(1.0, 1.0);
        double nis;
        TEST_ASSERT_EQUAL_INT(IPE_OK, update(&rls, &b, &nis));
        long double H[IPE_NY][IPE_NX_MAX], z[IPE_NY];
        whiten(&b, n, H, z);
        for (int r = 0; r < IPE_NY; ++r) {
            for (int i = 0; i < n; ++i) {
                v[i] += H[r][i] * z[r];
                for (int j = 0; j < n; ++j) { N[i][j] += H[r][i] * H[r][j]; }
            }
        }
    }
    ipe_rls_covariance(&rls, n, &P[0][0]);  // then: P = N^-1, x = N^-1 v
    for (int j = 0; j < n; ++j) {
        long double e[IPE_NX_MAX] = {0.0L};
        for (int i = 0; i < n * n; ++i) { A[i] = N[i / n][i % n]; }
        e[j] = 1.0L;
        solve(A, e, n);
        for (int i = 0; i < n; ++i) {
            const double P_ij = (&P[0][0])[i * n + j];
            TEST_ASSERT_DOUBLE_WITHIN(1e-10 * ipe_rls_std(&rls, i) * ipe_rls_std(&rls, j), (double)e[i], P_ij);
        }
    }
    for (int i = 0; i < n * n; ++i) { A[i] = N[i / n][i % n]; }
    solve(A, v, n);
    for (int i = 0; i < n; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-10 * 161.0, (double)v[i], rls.x[i]); }
    TEST_ASSERT_EQUAL_UINT64(n_blocks, rls.n_updates);
}

static void test_init_systematic_std_not_positive_is_refused(void)
{
    const double bad[2] = {1.0, 0.0};  // given, when, then
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, 2, bad));
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, -1, bad));
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_rls_init(&rls, x0, (const double (*)[IPE_NP])P0, XI_MAX + 1, bad));
}

static void test_update_equals_batch_least_squares_with_prior(void)
{
    check_batch(0, 5000);
}

static void test_update_with_systematic_states_equals_batch_least_squares(void)
{
    check_batch(27, 1000);
    check_batch(XI_MAX, 100);
}

static void test_innovation_is_what_update_will_see(void)
{
    start(5);  // given
    const block_t b = random_block(1.0, 1.0);
    double H[IPE_NY * IPE_NX_MAX], innovation[IPE_NY], S[IPE_NY][IPE_NY], P[15 * 15];
    rows_of(&b, rls.n, H);
    ipe_rls_covariance(&rls, rls.n, P);
    const ipe_rls_t before = rls;

    ipe_rls_innovation(&rls, H, b.y, innovation, S);      // when

    TEST_ASSERT_EQUAL_MEMORY(&before, &rls, sizeof rls);  // then
    for (int r = 0; r < IPE_NY; ++r) {
        double e = b.y[r];
        for (int i = 0; i < 15; ++i) { e -= H[r * 15 + i] * rls.x[i]; }
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, e, innovation[r]);
        for (int c = 0; c < IPE_NY; ++c) {
            double v = 0.0;
            for (int i = 0; i < 15 * 15; ++i) { v += H[r * 15 + i / 15] * P[i] * H[c * 15 + i % 15]; }
            TEST_ASSERT_DOUBLE_WITHIN(1e-9 * sqrt(S[r][r] * S[c][c]), v, S[r][c]);
        }
    }
}

static void test_covariance_first_rows_are_those_of_the_whole(void)
{
    double whole[20 * 20], part[IPE_NP * IPE_NP], nis;  // given
    start(10);
    for (int k = 0; k < 20; ++k) {
        const block_t b = random_block(1.0, 1.0);
        (void)update(&rls, &b, &nis);
    }
    ipe_rls_covariance(&rls, 20, whole);  // when
    ipe_rls_covariance(&rls, IPE_NP, part);
    for (int i = 0; i < IPE_NP; ++i) {    // then
        TEST_ASSERT_EQUAL_DOUBLE(sqrt(part[i * IPE_NP + i]), ipe_rls_std(&rls, i));
        for (int j = 0; j < IPE_NP; ++j) { TEST_ASSERT_EQUAL_DOUBLE(whole[i * 20 + j], part[i * IPE_NP + j]); }
    }
}

static void test_update_nis_is_normalised_innovation_squared(void)
{
    double P[IPE_NP][IPE_NP], nis;  // given: some knowledge
    for (int n = 0; n < 3; ++n) {
        const block_t b = random_block(1.0, 1.0);
        (void)update(&rls, &b, &nis);
    }
    const block_t b = random_block(1.0, 1.0);
    ipe_rls_covariance(&rls, IPE_NP, &P[0][0]);
    long double S[IPE_NY][IPE_NY], e[IPE_NY], x[IPE_NY], expected = 0.0L;
    for (int i = 0; i < IPE_NY; ++i) {
        e[i] = b.y[i];
        for (int j = 0; j < IPE_NP; ++j) { e[i] -= b.Y[i][j] * rls.x[j]; }
        for (int j = 0; j < IPE_NY; ++j) {
            S[i][j] = 0.0L;
            for (int k = 0; k <= (i < j ? i : j); ++k) { S[i][j] += L[i][k] * L[j][k]; }
            for (int m = 0; m < IPE_NP; ++m) {
                for (int n = 0; n < IPE_NP; ++n) { S[i][j] += b.Y[i][m] * P[m][n] * b.Y[j][n]; }
            }
        }
    }
    memcpy(x, e, sizeof x);
    solve(&S[0][0], x, IPE_NY);
    for (int i = 0; i < IPE_NY; ++i) { expected += e[i] * x[i]; }

    (void)update(&rls, &b, &nis);                                               // when

    TEST_ASSERT_DOUBLE_WITHIN(1e-8 * (double)expected, (double)expected, nis);  // then
}

static void test_update_nis_of_honest_noise_averages_six(void)
{
    double sum = 0.0, nis;             // given
    for (int n = 0; n < 20000; ++n) {  // when
        const block_t b = random_block(1.0, 1.0);
        (void)update(&rls, &b, &nis);
        if (n >= 100) { sum += nis; }
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.15, 6.0, sum / 19900.0);  // then
}

static void check_refused(const block_t* b)
{
    ipe_rls_t before = rls;
    double nis = 1.0;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_NONFINITE, update(&rls, b, &nis));
    ++before.n_nonfinite;
    TEST_ASSERT_EQUAL_MEMORY(&before, &rls, sizeof rls);
}

static void test_update_nonfinite_input_leaves_state_untouched(void)
{
    double nis;  // given: a used estimator
    for (int n = 0; n < 100; ++n) {
        const block_t b = random_block(1.0, 1.0);
        (void)update(&rls, &b, &nis);
    }
    const double bad[3] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 3; ++i) {  // when, then
        block_t b = random_block(1.0, 1.0);
        b.y[3] = bad[i];
        check_refused(&b);
        b = random_block(1.0, 1.0);
        b.Y[5][9] = bad[i];
        check_refused(&b);
    }
    L[2][2] = 0.0;
    const block_t b = random_block(1.0, 1.0);
    check_refused(&b);
}

static void test_update_overflow_leaves_state_untouched(void)
{
    const double huge[3] = {1e300, 1e308, 1.7e308};  // given: finite, but its square is not
    for (int i = 0; i < 3; ++i) {
        block_t b = random_block(1.0, 1.0);
        b.y[0] = huge[i];
        check_refused(&b);  // when, then
        b = random_block(1.0, 1.0);
        b.Y[4][4] = huge[i];
        check_refused(&b);
    }
}

static void test_update_order_of_blocks_and_rows_changes_only_rounding(void)
{
    enum { N = 200 };  // given: uncorrelated noise
    static block_t block[N];
    for (int i = 0; i < IPE_NY; ++i) {
        for (int j = 0; j < IPE_NY; ++j) { L[i][j] = i == j ? 2.0 : 0.0; }
    }
    for (int n = 0; n < N; ++n) { block[n] = random_block(1.0, 1.0); }
    ipe_rls_t forward = rls, backward = rls;
    double nis, P[IPE_NP][IPE_NP];
    for (int n = 0; n < N; ++n) {  // when: all rows the other way round
        (void)update(&forward, &block[n], &nis);
        block_t reversed;
        for (int i = 0; i < IPE_NY; ++i) {
            memcpy(reversed.Y[i], block[N - 1 - n].Y[5 - i], sizeof reversed.Y[i]);
            reversed.y[i] = block[N - 1 - n].y[5 - i];
        }
        (void)update(&backward, &reversed, &nis);
    }
    ipe_rls_covariance(&forward, IPE_NP, &P[0][0]);  // then
    for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9 * sqrt(P[i][i]), forward.x[i], backward.x[i]); }
}

static void test_update_covariance_stays_positive_definite_over_1e6_blocks(void)
{
    double P[IPE_NP][IPE_NP], nis;       // given: motion that comes and goes
    for (int n = 0; n < 1000000; ++n) {  // when
        const block_t b = random_block(n % 1000 < 500 ? 1.0 : 1e-3, 1.0);
        if (update(&rls, &b, &nis) != IPE_OK) { TEST_FAIL(); }
        if (n % 1000 != 0) { continue; }
        TEST_ASSERT_TRUE(ipe_rls_invariants_hold(&rls));  // then
        ipe_rls_covariance(&rls, IPE_NP, &P[0][0]);
        for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_TRUE(P[i][i] > 0.0 && P[i][i] <= P0[i][i]); }
        TEST_ASSERT_TRUE(cholesky(&P[0][0], IPE_NP));
    }
    for (int i = 0; i < IPE_NP; ++i) { TEST_ASSERT_DOUBLE_WITHIN(0.05, truth[i], rls.x[i]); }
}

static void test_update_row_is_one_sixth_of_a_block(void)
{
    const block_t b = random_block(1.0, 1.0);  // given: unit covariance
    ipe_rls_t by_rows = rls;
    double H[IPE_NY * IPE_NP], nis;
    for (int i = 0; i < IPE_NY * IPE_NY; ++i) { (&L[0][0])[i] = i % 7 == 0 ? 1.0 : 0.0; }
    rows_of(&b, IPE_NP, H);
    for (int i = 0; i < IPE_NY; ++i) { ipe_rls_update_row(&by_rows, H + i * IPE_NP, b.y[i]); }  // when
    (void)update(&rls, &b, &nis);
    TEST_ASSERT_EQUAL_MEMORY(rls.x, by_rows.x, sizeof rls.x);                                   // then
    TEST_ASSERT_EQUAL_MEMORY(rls.U, by_rows.U, sizeof rls.U);
}

/// Bierman's recursion with nothing left out, one row h x = y of unit variance.
static void update_plainly(ipe_rls_t* s, const double* h, double y)
{
    double b[IPE_NX_MAX], a = 1.0, innovation = y;
    for (int j = 0; j < s->n; ++j) {
        double *U = s->U + j * (j - 1) / 2, f = h[j];
        for (int i = 0; i < j; ++i) { f += U[i] * h[i]; }
        const double g = s->D[j] * f, before = a;
        a += f * g;
        s->D[j] *= before / a;
        for (int i = 0; i < j; ++i) {
            const double old = U[i];
            U[i] = old + b[i] * (-f / before);
            b[i] += g * old;
        }
        b[j] = g;
        innovation -= h[j] * s->x[j];
    }
    for (int j = 0; j < s->n; ++j) { s->x[j] += b[j] * (innovation / a); }
}

static void test_update_row_that_is_mostly_zeros_gives_the_bits_of_a_full_one(void)
{
    double nis;
    start(XI_MAX);  // given: states correlated with each other
    for (int k = 0; k < 20; ++k) {
        const block_t b = random_block(1.0, 1.0);
        (void)update(&rls, &b, &nis);
    }
    ipe_rls_t plain = rls;
    for (int i = 0; i < rls.n; ++i) {
        double h[IPE_NX_MAX] = {0.0};
        h[i] = 0.7;
        if (i % 3 == 0) { h[i / 2] = -0.4; }
        ipe_rls_update_row(&rls, h, 0.1 * i);  // when
        update_plainly(&plain, h, 0.1 * i);
    }
    TEST_ASSERT_EQUAL_MEMORY(&plain, &rls, sizeof rls);  // then
}

static void test_forget_divides_covariance(void)
{
    double before[IPE_NP * IPE_NP], after[IPE_NP * IPE_NP], nis;  // given
    const block_t b = random_block(1.0, 1.0);
    (void)update(&rls, &b, &nis);
    ipe_rls_covariance(&rls, IPE_NP, before);
    ipe_rls_forget(&rls, 0.8);                   // when
    ipe_rls_covariance(&rls, IPE_NP, after);
    for (int i = 0; i < IPE_NP * IPE_NP; ++i) {  // then
        TEST_ASSERT_DOUBLE_WITHIN(1e-9 * (1.0 + fabs(before[i])), before[i] / 0.8, after[i]);
    }
}

static void test_loosen_adds_variance_to_one_state_only(void)
{
    double before[IPE_NP * IPE_NP], after[IPE_NP * IPE_NP], nis;  // given
    const block_t b = random_block(1.0, 1.0);
    (void)update(&rls, &b, &nis);
    ipe_rls_covariance(&rls, IPE_NP, before);
    for (int k = 0; k < IPE_NP; ++k) {
        ipe_rls_loosen(&rls, k, 3.0 + k);  // when
        before[k * IPE_NP + k] += 3.0 + k;
        ipe_rls_covariance(&rls, IPE_NP, after);
        for (int i = 0; i < IPE_NP * IPE_NP; ++i) {  // then
            TEST_ASSERT_DOUBLE_WITHIN(1e-9 * (1.0 + fabs(before[i])), before[i], after[i]);
        }
    }
    TEST_ASSERT_TRUE(ipe_rls_invariants_hold(&rls));
}

static void test_fade_scales_one_state_with_its_row_and_column(void)
{
    double before[IPE_NP * IPE_NP], after[IPE_NP * IPE_NP], nis;  // given
    const block_t b = random_block(1.0, 1.0);
    (void)update(&rls, &b, &nis);
    for (int k = 0; k < IPE_NP; ++k) {
        ipe_rls_covariance(&rls, IPE_NP, before);
        const double x = rls.x[k];
        ipe_rls_fade(&rls, k, 0.3);                                     // when
        ipe_rls_covariance(&rls, IPE_NP, after);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15 * fabs(x), 0.3 * x, rls.x[k]);  // then
        for (int i = 0; i < IPE_NP; ++i) {
            for (int j = 0; j < IPE_NP; ++j) {
                const double expected = before[i * IPE_NP + j] * (i == k ? 0.3 : 1.0) * (j == k ? 0.3 : 1.0);
                TEST_ASSERT_DOUBLE_WITHIN(1e-9 * (1.0 + fabs(expected)), expected, after[i * IPE_NP + j]);
            }
        }
    }
    TEST_ASSERT_TRUE(ipe_rls_invariants_hold(&rls));
}

static void test_invariants_broken_state_is_noticed(void)
{
    ipe_rls_t broken = rls;  // given, when, then
    broken.D[3] = 0.0;
    TEST_ASSERT_FALSE(ipe_rls_invariants_hold(&broken));
    broken = rls;
    broken.x[0] = NAN;
    TEST_ASSERT_FALSE(ipe_rls_invariants_hold(&broken));
    broken = rls;
    broken.U[IPE_NP * (IPE_NP - 1) / 2 - 1] = INFINITY;
    TEST_ASSERT_FALSE(ipe_rls_invariants_hold(&broken));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_init_prior_is_reproduced);
    RUN_TEST(test_init_covariance_not_positive_definite_is_refused);
    RUN_TEST(test_init_systematic_std_not_positive_is_refused);
    RUN_TEST(test_update_equals_batch_least_squares_with_prior);
    RUN_TEST(test_update_with_systematic_states_equals_batch_least_squares);
    RUN_TEST(test_innovation_is_what_update_will_see);
    RUN_TEST(test_covariance_first_rows_are_those_of_the_whole);
    RUN_TEST(test_update_nis_is_normalised_innovation_squared);
    RUN_TEST(test_update_nis_of_honest_noise_averages_six);
    RUN_TEST(test_update_nonfinite_input_leaves_state_untouched);
    RUN_TEST(test_update_overflow_leaves_state_untouched);
    RUN_TEST(test_update_order_of_blocks_and_rows_changes_only_rounding);
    RUN_TEST(test_update_covariance_stays_positive_definite_over_1e6_blocks);
    RUN_TEST(test_update_row_is_one_sixth_of_a_block);
    RUN_TEST(test_update_row_that_is_mostly_zeros_gives_the_bits_of_a_full_one);
    RUN_TEST(test_forget_divides_covariance);
    RUN_TEST(test_loosen_adds_variance_to_one_state_only);
    RUN_TEST(test_fade_scales_one_state_with_its_row_and_column);
    RUN_TEST(test_invariants_broken_state_is_noticed);
    return UNITY_END();
}
