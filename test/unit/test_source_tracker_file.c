// SPDX-License-Identifier: Apache-2.0
#include "source_tracker_file.h"

#include "temp_file.h"

#include <math.h>

static ipe_source_tracker_file_t tracker;
static char message[256];

void setUp(void)
{
    message[0] = '\0';
}

void tearDown(void)
{
    ipe_source_tracker_file_close(&tracker);
    remove_temp_files();
}

static int open_text(const char* text)
{
    return ipe_source_tracker_file_open(&tracker, temp_file(text), -1, message, sizeof message);
}

static const ipe_position_t* next_position(void)
{
    ipe_source_status_t status;
    while ((status = ipe_source_tracker_file_peek(&tracker)) == IPE_SOURCE_WAIT) {
        ipe_source_tracker_file_fill(&tracker);
    }
    if (status == IPE_SOURCE_END) { return NULL; }
    ipe_source_tracker_file_take(&tracker);
    return &tracker.head;
}

static void check_position(int64_t t_ns, double x, double y, double z)
{
    const ipe_position_t* p = next_position();
    TEST_ASSERT_NOT_NULL(p);
    TEST_ASSERT_EQUAL_INT64(t_ns, p->t_ns);
    TEST_ASSERT_EQUAL_DOUBLE(x, p->position[0]);
    TEST_ASSERT_EQUAL_DOUBLE(y, p->position[1]);
    TEST_ASSERT_EQUAL_DOUBLE(z, p->position[2]);
}

static void test_tracker_columns_are_found_by_name(void)
{
    TEST_ASSERT_EQUAL(0, open_text("\xEF\xBB\xBF"
                                   "z,status,\"t\", y ,x\r\n3,ok,0.5,2,1\r\n-3e0,,1.25, -2.5 ,1\r\n"));
    check_position(500000000, 1.0, 2.0, 3.0);
    check_position(1250000000, 1.0, -2.5, -3.0);
    TEST_ASSERT_NULL(next_position());
}

static void test_tracker_time_is_exact_to_the_nanosecond(void)
{
    TEST_ASSERT_EQUAL(0, open_text("t,x,y,z\n1436509052.249713001,0,0,0\n1436509052,0,0,0\n1436509052.,0,0,0\n"
                                   "1.5e3,0,0,0\n1500.1234567894,0,0,0\n"));
    check_position(1436509052249713001, 0, 0, 0);
    check_position(1436509052000000000, 0, 0, 0);
    check_position(1436509052000000000, 0, 0, 0);
    check_position(1500000000000, 0, 0, 0);
    check_position(1500123456789, 0, 0, 0);
}

static void test_tracker_bad_rows_are_counted_and_passed_over(void)
{
    TEST_ASSERT_EQUAL(
        0, open_text("t,x,y,z\n1,2,3\n1,2,3,\n1,2,three,4\n,1,2,3\nnan,1,2,3\n1e300,1,2,3\n9000000000,1,2,3\n-1,1,2,3\n"
                     "1,2,3,4 5\n\n7,1,2,3,extra\n8,1,2"));
    check_position(7000000000, 1, 2, 3);
    TEST_ASSERT_NULL(next_position());
    TEST_ASSERT_EQUAL_UINT64(10, tracker.n_bad_rows);
    TEST_ASSERT_EQUAL_UINT64(1, tracker.n_positions);
}

static void test_tracker_stray_time_is_left_out(void)
{
    TEST_ASSERT_EQUAL(0, open_text("t,x,y,z\n1,1,0,0\n900,2,0,0\n1.1,3,0,0\n60,4,0,0\n60.1,5,0,0\n"));
    check_position(1000000000, 1, 0, 0);
    check_position(1100000000, 3, 0, 0);
    check_position(60000000000, 4, 0, 0);
    check_position(60100000000, 5, 0, 0);
    TEST_ASSERT_NULL(next_position());
    TEST_ASSERT_EQUAL_UINT64(1, tracker.lookahead.n_stray);
}

static void test_tracker_nan_is_handed_on_for_the_pipeline_to_refuse(void)
{
    TEST_ASSERT_EQUAL(0, open_text("t,x,y,z\n1,nan,2,3\n"));
    TEST_ASSERT_TRUE(isnan(next_position()->position[0]));
}

static void test_tracker_header_must_name_each_column_once(void)
{
    TEST_ASSERT_EQUAL(-1, open_text("t,x,z\n1,2,3\n"));
    TEST_ASSERT_NOT_NULL(strstr(message, "no column \"y\""));
    TEST_ASSERT_EQUAL(-1, open_text("t,x,y,z,x\n"));
    TEST_ASSERT_NOT_NULL(strstr(message, "\"x\" is there twice"));
    TEST_ASSERT_EQUAL(-1, open_text(""));
    TEST_ASSERT_NOT_NULL(strstr(message, "no header line"));
    TEST_ASSERT_EQUAL(-1, ipe_source_tracker_file_open(&tracker, "/nonexistent.csv", -1, message, sizeof message));
    TEST_ASSERT_NOT_NULL(strstr(message, "/nonexistent.csv: No such file"));
}

int main(void)
{
    UNITY_BEGIN();
    silence_stderr();
    RUN_TEST(test_tracker_columns_are_found_by_name);
    RUN_TEST(test_tracker_time_is_exact_to_the_nanosecond);
    RUN_TEST(test_tracker_bad_rows_are_counted_and_passed_over);
    RUN_TEST(test_tracker_stray_time_is_left_out);
    RUN_TEST(test_tracker_nan_is_handed_on_for_the_pipeline_to_refuse);
    RUN_TEST(test_tracker_header_must_name_each_column_once);
    return UNITY_END();
}
