// SPDX-License-Identifier: Apache-2.0
#include "histogram.h"

#include <string.h>
#include <unity.h>

static ipe_histogram_t h;

void setUp(void)
{
    memset(&h, 0, sizeof h);
}

void tearDown(void)
{
}

static void test_histogram_quantiles_are_right_to_nine_percent(void)
{
    for (int i = 1; i <= 100000; ++i) { ipe_histogram_push(&h, 1000LL * i); }  // 1 us .. 0.1 s, evenly
    const double share[] = {0.1, 0.5, 0.99, 0.999};
    for (int i = 0; i < 4; ++i) {
        const double exact = 0.1 * share[i], found = ipe_histogram_quantile(&h, share[i]);
        TEST_ASSERT_TRUE(found >= exact && found <= 1.0906 * exact);
    }
    TEST_ASSERT_EQUAL_DOUBLE(0.1, ipe_histogram_quantile(&h, 1.0));
}

static void test_histogram_rare_long_ones_are_in_the_tail_only(void)
{
    for (int i = 0; i < 9980; ++i) { ipe_histogram_push(&h, 20000); }
    for (int i = 0; i < 20; ++i) { ipe_histogram_push(&h, 5000000); }
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 20e-6, ipe_histogram_quantile(&h, 0.5));
    TEST_ASSERT_DOUBLE_WITHIN(2e-6, 20e-6, ipe_histogram_quantile(&h, 0.997));
    TEST_ASSERT_EQUAL_DOUBLE(5e-3, ipe_histogram_quantile(&h, 0.999));
    TEST_ASSERT_EQUAL_UINT64(10000, h.n);
}

static void test_histogram_extremes_stay_inside(void)
{
    const int64_t extreme[] = {INT64_MIN, -1, 0, 1, 1000, INT64_MAX};
    for (int i = 0; i < 6; ++i) { ipe_histogram_push(&h, extreme[i]); }
    TEST_ASSERT_EQUAL_UINT64(5, h.n_bucket[0]);
    TEST_ASSERT_EQUAL_UINT64(1, h.n_bucket[IPE_HISTOGRAM_BUCKETS - 1]);
    TEST_ASSERT_EQUAL_DOUBLE(1e-9 * (double)INT64_MAX, ipe_histogram_quantile(&h, 1.0));
}

static void test_histogram_of_nothing_is_zero(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(0.0, ipe_histogram_quantile(&h, 0.5));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_histogram_quantiles_are_right_to_nine_percent);
    RUN_TEST(test_histogram_rare_long_ones_are_in_the_tail_only);
    RUN_TEST(test_histogram_extremes_stay_inside);
    RUN_TEST(test_histogram_of_nothing_is_zero);
    return UNITY_END();
}
