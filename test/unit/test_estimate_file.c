// SPDX-License-Identifier: Apache-2.0
#include "estimate_file.h"

#include "robot.h"
#include "temp_file.h"

#include <sys/stat.h>

static ipe_pipeline_t pipeline;
static ipe_counters_t counters;
static char message[256];
static char text[65536];

void setUp(void)
{
    const ipe_config_t config = cogiro();
    TEST_ASSERT_EQUAL(IPE_OK, ipe_pipeline_init(&pipeline, &config, message, sizeof message));
    ipe_counters_clear(&counters);
    ipe_counters_add(&counters, "bus0", "frames", 18446744073709551615U);
    ipe_counters_add(&counters, NULL, "align.rows", 3);
}

void tearDown(void)
{
    remove_temp_files();
}

static void have_estimate(void)
{
    nominal_theta(pipeline.estimator.estimate.theta);
    memcpy(pipeline.estimator.estimate.covariance, pipeline.config.prior_covariance,
           sizeof pipeline.estimator.estimate.covariance);
    pipeline.estimator.estimate.covariance[0][0] = 0.01;
    pipeline.estimator.estimate.n_windows = 7;
    pipeline.estimator.estimate.consistent = true;
    pipeline.estimator.estimate.observable[0] = true;
    TEST_ASSERT_EQUAL(IPE_OK,
                      ipe_body_from_theta(pipeline.estimator.estimate.theta, pipeline.estimator.estimate.covariance,
                                          &pipeline.estimator.estimate.body));
}

static int write_to(const char* path)
{
    const ipe_run_t run = {
        .pipeline = &pipeline, .counters = &counters, .n_frames = 12, .n_rejected = 5, .duration = 1.5};
    return ipe_estimate_file_write(path, &run, message, sizeof message);
}

static void read_back(const char* path)
{
    FILE* file = fopen(path, "r");
    TEST_ASSERT_NOT_NULL(file);
    text[fread(text, 1, sizeof text - 1, file)] = '\0';
    (void)fclose(file);
}

static void check_holds(const char* part)
{
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(text, part), part);
}

static void test_estimate_file_holds_the_contract(void)
{
    const char* path = temp_file("old");
    have_estimate();
    TEST_ASSERT_EQUAL(0, write_to(path));
    read_back(path);
    check_holds("\"method\": \"rls\"");
    check_holds("\"mass\": {\"value\": 161.05799999999999, \"std\": 0.1");
    check_holds("\"cog\": {\"value\": [-0.001");
    check_holds("\"inertia_cog\": {\"value\": [94.95");
    check_holds("\"consistent\": true");
    check_holds("\"observable\": {\"mass\": true, \"cog\": [false, false, false], \"inertia_cog\": [false, ");
    check_holds("\"samples\": {\"frames\": 12, \"used\": 0, \"rejected\": 5, \"windows\": 7}");
    check_holds("\"duration_s\": 1.5");
    check_holds("\"bus0.frames\": 18446744073709551615");
}

static void test_estimate_file_without_estimate_says_null(void)
{
    const char* path = temp_file("old");
    TEST_ASSERT_EQUAL(0, write_to(path));
    read_back(path);
    check_holds("\"mass\": null");
    check_holds("\"consistent\": false");
    TEST_ASSERT_NULL(strstr(text, "nan"));
}

static void test_estimate_file_that_cannot_be_written_leaves_the_old_one(void)
{
    char path[64], temporary[72];
    (void)snprintf(path, sizeof path, "%s", temp_file("old"));
    (void)snprintf(temporary, sizeof temporary, "%s.tmp", path);
    TEST_ASSERT_EQUAL(0, mkdir(temporary, 0700));  // given: the temporary name is taken
    TEST_ASSERT_EQUAL(-1, write_to(path));         // when
    TEST_ASSERT_FALSE(ipe_estimate_file_check(path, message, sizeof message));
    read_back(path);                               // then
    TEST_ASSERT_EQUAL_STRING("old", text);
    TEST_ASSERT_EQUAL_STRING_LEN(path, message, strlen(path));
    (void)rmdir(temporary);
}

static void test_estimate_file_check_leaves_nothing_behind(void)
{
    char temporary[72];
    const char* path = temp_file("old");
    (void)snprintf(temporary, sizeof temporary, "%s.tmp", path);
    TEST_ASSERT_TRUE(ipe_estimate_file_check(path, message, sizeof message));
    TEST_ASSERT_EQUAL(-1, access(temporary, F_OK));
    TEST_ASSERT_FALSE(ipe_estimate_file_check("/nonexistent/estimate.json", message, sizeof message));
    TEST_ASSERT_FALSE(ipe_estimate_file_check("/tmp", message, sizeof message));
}

static void test_estimate_file_that_is_no_regular_file_is_not_replaced(void)
{
    TEST_ASSERT_TRUE(ipe_estimate_file_check("/dev/null", message, sizeof message));
    TEST_ASSERT_EQUAL(0, write_to("/dev/null"));
    struct stat info;
    TEST_ASSERT_EQUAL(0, stat("/dev/null", &info));
    TEST_ASSERT_TRUE(S_ISCHR(info.st_mode));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_estimate_file_holds_the_contract);
    RUN_TEST(test_estimate_file_without_estimate_says_null);
    RUN_TEST(test_estimate_file_that_cannot_be_written_leaves_the_old_one);
    RUN_TEST(test_estimate_file_check_leaves_nothing_behind);
    RUN_TEST(test_estimate_file_that_is_no_regular_file_is_not_replaced);
    return UNITY_END();
}
