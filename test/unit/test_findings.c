// SPDX-License-Identifier: Apache-2.0
#include "findings.h"

#include "misfit_score.h"
#include "robot.h"

static ipe_config_t config;
static ipe_estimator_t estimator;
static ipe_estimate_t* const estimate = &estimator.estimate;
static ipe_findings_t found;

/// A good estimate.
void setUp(void)
{
    config = cogiro();
    config.std_force_offset = 5.0, config.std_force_delay = 1e-3, config.std_friction = 0.01;
    TEST_ASSERT_EQUAL(IPE_OK, ipe_estimator_init(&estimator, &config));
    estimate->n_windows = 500;
    estimate->consistent = true;
    estimate->sigma_factor = 1.0;
    for (int i = 0; i < IPE_NP; ++i) { estimate->observable[i] = true; }
}

void tearDown(void)
{
}

static void judge(void)
{
    ipe_findings_of(&estimator, &config, &found);
}

/// The only finding.
static const ipe_finding_t* only(const char* name, ipe_severity_t severity)
{
    judge();
    TEST_ASSERT_EQUAL_INT(1, found.n);
    TEST_ASSERT_EQUAL_STRING(name, found.item[0].name);
    TEST_ASSERT_EQUAL_INT(severity, found.item[0].severity);
    TEST_ASSERT_EQUAL_INT(severity, ipe_findings_verdict(&found));
    return &found.item[0];
}

static void test_good_estimate_has_no_finding(void)
{
    judge();
    TEST_ASSERT_EQUAL_INT(0, found.n);
    TEST_ASSERT_EQUAL_STRING("good", ipe_severity_name(ipe_findings_verdict(&found)));
    TEST_ASSERT_TRUE(ipe_findings_has_converged(&estimator));
}

static void test_no_estimate_is_not_to_be_used(void)
{
    memset(estimate, 0, sizeof *estimate);
    (void)only("no_estimate", IPE_SEVERITY_STOP);
    TEST_ASSERT_FALSE(ipe_findings_has_converged(&estimator));
}

static void test_few_windows_are_a_short_record(void)
{
    estimate->n_windows = 49;
    (void)only("short_record", IPE_SEVERITY_CARE);
    TEST_ASSERT_FALSE(ipe_findings_has_converged(&estimator));
}

static void test_widened_sigma_is_a_misfit(void)
{
    estimate->sigma_factor = IPE_MISFIT_MARKED;
    judge();
    TEST_ASSERT_EQUAL_INT(0, found.n);
    estimate->sigma_factor = 2.5;
    const ipe_finding_t* f = only("misfit", IPE_SEVERITY_CARE);
    TEST_ASSERT_NOT_NULL(strstr(f->says, "sigma is widened 2.5 times"));
    TEST_ASSERT_NOT_NULL(strstr(f->evidence, "\"sigma_factor\": 2.5"));
}

static void test_held_estimate_is_a_misfit_and_has_not_converged(void)
{
    estimate->is_misfit = true, estimate->sigma_factor = 2.5;
    TEST_ASSERT_NOT_NULL(strstr(only("misfit", IPE_SEVERITY_CARE)->says, "the estimate is held"));
    TEST_ASSERT_FALSE(ipe_findings_has_converged(&estimator));
}

static void test_impossible_body_by_its_distance(void)
{
    estimate->consistent = false, estimate->distance = 1.9;
    judge();
    TEST_ASSERT_EQUAL_INT(0, found.n);
    estimate->distance = 4.0;
    TEST_ASSERT_NOT_NULL(strstr(only("impossible_body", IPE_SEVERITY_CARE)->says, "2.0 sigma away"));
    estimate->distance = 9.1;
    (void)only("impossible_body", IPE_SEVERITY_STOP);
}

static void test_failed_sensor_is_named_with_the_force_it_should_read(void)
{
    estimate->unknown_force = 1U << 4;
    estimator.restored[4] = 512.5;
    const ipe_finding_t* f = only("broken_force_sensor", IPE_SEVERITY_CARE);
    TEST_ASSERT_NOT_NULL(strstr(f->says, "force sensor 5 has failed"));
    TEST_ASSERT_NOT_NULL(strstr(f->evidence, "\"cable\": 5, \"most_probable_force\": 512.5"));
}

static void test_corrections_beyond_four_sigmas_the_furthest_first(void)
{
    estimate->systematic[IPE_XI_FORCE + 2] = -19.0;  // given: 3.8 sigma
    judge();
    TEST_ASSERT_EQUAL_INT(0, found.n);
    estimate->systematic[IPE_XI_FORCE + 2] = -21.0;
    estimate->systematic[IPE_XI_FORCE_DELAY] = 0.02;
    for (int i = 0; i < 8; ++i) { estimate->systematic[IPE_XI_FORCE + 16 + i] = 0.05; }  // one friction of all cables
    judge();                                                                             // when
    TEST_ASSERT_EQUAL_INT(3, found.n);                                                   // then
    TEST_ASSERT_NOT_NULL(strstr(found.item[0].says, "force_delay = 20 ms: 20 times"));
    TEST_ASSERT_NOT_NULL(strstr(found.item[1].says, "friction_1 = 5 %: 5 times"));
    TEST_ASSERT_NOT_NULL(strstr(found.item[2].says, "force_offset_3 = -21 N: 4 times"));
    TEST_ASSERT_NOT_NULL(strstr(found.item[2].evidence, "\"parameter\": \"force_offset_3\""));
}

static void test_poorly_observable_parameters_are_named(void)
{
    estimate->observable[1] = estimate->observable[9] = false;
    const ipe_finding_t* f = only("poorly_observable", IPE_SEVERITY_CARE);
    TEST_ASSERT_NOT_NULL(strstr(f->says, "cog x, J xy;"));
    TEST_ASSERT_EQUAL_STRING("\"parameters\": [\"cog x\", \"J xy\"]", f->evidence);
}

static void test_everything_at_once_fits_and_the_worst_comes_first(void)
{
    memset(estimate->observable, 0, sizeof estimate->observable);
    estimate->n_changes = 3, estimate->is_misfit = true, estimate->unknown_force = 0xFF;
    estimate->consistent = false, estimate->distance = 100.0;
    for (int i = 0; i < IPE_XI_MAX; ++i) { estimate->systematic[i] = 1e3 + i; }
    judge();
    TEST_ASSERT_EQUAL_INT(IPE_FINDINGS_MAX, found.n);
    TEST_ASSERT_EQUAL_INT(IPE_SEVERITY_STOP, ipe_findings_verdict(&found));
    for (int i = 1; i < found.n; ++i) { TEST_ASSERT_TRUE(found.item[i].severity <= found.item[i - 1].severity); }
}

static void test_payload_change_alone_is_good(void)
{
    estimate->n_changes = 1;
    (void)only("payload_changed", IPE_SEVERITY_GOOD);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_good_estimate_has_no_finding);
    RUN_TEST(test_no_estimate_is_not_to_be_used);
    RUN_TEST(test_few_windows_are_a_short_record);
    RUN_TEST(test_widened_sigma_is_a_misfit);
    RUN_TEST(test_held_estimate_is_a_misfit_and_has_not_converged);
    RUN_TEST(test_impossible_body_by_its_distance);
    RUN_TEST(test_failed_sensor_is_named_with_the_force_it_should_read);
    RUN_TEST(test_corrections_beyond_four_sigmas_the_furthest_first);
    RUN_TEST(test_poorly_observable_parameters_are_named);
    RUN_TEST(test_everything_at_once_fits_and_the_worst_comes_first);
    RUN_TEST(test_payload_change_alone_is_good);
    return UNITY_END();
}
