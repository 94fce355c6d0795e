// SPDX-License-Identifier: Apache-2.0
#include "replay.h"

#include "temp_file.h"

#include <time.h>

static ipe_replay_t replay;

void setUp(void)
{
    memset(&replay, 0, sizeof replay);
}

void tearDown(void)
{
    ipe_replay_close(&replay);
    remove_temp_files();
}

static void add_log(const char* text)
{
    const unsigned i = replay.n_buses++;
    TEST_ASSERT_EQUAL(0, ipe_source_file_open(&replay.bus[i], temp_file(text), (uint8_t)i, NULL));
}

static void add_tracker(const char* text)
{
    char message[128];
    TEST_ASSERT_EQUAL(0, ipe_source_tracker_file_open(&replay.tracker, temp_file(text), -1, message, sizeof message));
    replay.has_tracker = true;
}

static ipe_replay_status_t next(ipe_replay_item_t* item)
{
    ipe_replay_status_t status;
    while ((status = ipe_replay_next(&replay, item)) == IPE_REPLAY_WAIT) { ipe_replay_fill(&replay); }
    return status;
}

/// The order of a whole replay: bus numbers, 't' for the tracker.
static void check_order(const char* expected)
{
    char order[64] = "";
    ipe_replay_item_t item;
    ipe_replay_status_t status;
    for (size_t n = 0; (status = next(&item)) != IPE_REPLAY_END && n + 1 < sizeof order; ++n) {
        order[n] = status == IPE_REPLAY_FRAME ? (char)('0' + item.frame->bus) : 't';
        order[n + 1] = '\0';
    }
    TEST_ASSERT_EQUAL_STRING(expected, order);
}

static void test_replay_merges_by_stamp_with_lower_bus_first_and_tracker_last(void)
{
    add_log("(1.0) a 001#\n(3.0) a 001#\n(5.0) a 001#\n");
    add_log("(1.0) b 001#\n(2.0) b 001#\n");
    add_tracker("t,x,y,z\n1,0,0,0\n4,0,0,0\n9,0,0,0\n");
    check_order("01t10t0t");
}

static void test_replay_stamp_that_goes_back_does_not_stop_the_merge(void)
{
    add_log("(5.0) a 001#\n(1.0) a 001#\n(1.1) a 001#\n");
    add_log("(1.05) b 001#\n(5.5) b 001#\n");
    check_order("10001");
}

static void test_replay_stray_stamp_does_not_drain_the_other_inputs(void)
{
    add_log("(1.0) a 001#\n(900.0) a 001#\n(1.2) a 001#\n");
    add_tracker("t,x,y,z\n1.1,0,0,0\n1.3,0,0,0\n");
    check_order("0t0t");
}

static void test_replay_of_nothing_ends(void)
{
    check_order("");
    add_log("");
    check_order("");
}

static void test_replay_input_without_data_holds_the_others_back(void)
{
    int fd[2];
    ipe_replay_item_t item;
    add_log("(1.0) a 001#\n");
    add_log("");
    TEST_ASSERT_EQUAL(0, pipe(fd));
    (void)dup2(fd[0], replay.bus[1].lines.fd);
    (void)close(fd[0]);
    ipe_source_file_fill(&replay.bus[0]);
    TEST_ASSERT_EQUAL(IPE_REPLAY_WAIT, ipe_replay_next(&replay, &item));
    TEST_ASSERT_EQUAL(replay.bus[1].lines.fd, item.fd);
    (void)close(fd[1]);
    check_order("0");
}

static void test_replay_paced_hands_items_out_when_due(void)
{
    ipe_replay_item_t item;
    struct timespec now;
    add_log("(100.0) a 001#\n(101.0) a 001#\n");
    replay.speed = 20.0;
    TEST_ASSERT_EQUAL(IPE_REPLAY_FRAME, next(&item));
    TEST_ASSERT_EQUAL(IPE_REPLAY_EARLY, next(&item));
    const struct timespec due = {.tv_sec = item.due_ns / 1000000000, .tv_nsec = item.due_ns % 1000000000};
    TEST_ASSERT_EQUAL_INT64(50000000, item.due_ns - replay.clock_0_ns);
    TEST_ASSERT_EQUAL(0, clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL));
    TEST_ASSERT_EQUAL(IPE_REPLAY_FRAME, next(&item));
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    TEST_ASSERT_TRUE((int64_t)now.tv_sec * 1000000000 + now.tv_nsec >= item.due_ns);
    TEST_ASSERT_EQUAL(IPE_REPLAY_END, next(&item));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_replay_merges_by_stamp_with_lower_bus_first_and_tracker_last);
    RUN_TEST(test_replay_stamp_that_goes_back_does_not_stop_the_merge);
    RUN_TEST(test_replay_stray_stamp_does_not_drain_the_other_inputs);
    RUN_TEST(test_replay_of_nothing_ends);
    RUN_TEST(test_replay_input_without_data_holds_the_others_back);
    RUN_TEST(test_replay_paced_hands_items_out_when_due);
    return UNITY_END();
}
