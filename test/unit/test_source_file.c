// SPDX-License-Identifier: Apache-2.0
#include "source_file.h"

#include "temp_file.h"

static ipe_source_file_t source;

void setUp(void)
{
}

void tearDown(void)
{
    ipe_source_file_close(&source);
    remove_temp_files();
}

/// The next frame, reading as needed; NULL at the end.
static const ipe_frame_t* next_frame(void)
{
    ipe_source_status_t status;
    while ((status = ipe_source_file_peek(&source)) == IPE_SOURCE_WAIT) { ipe_source_file_fill(&source); }
    if (status == IPE_SOURCE_END) { return NULL; }
    ipe_source_file_take(&source);
    return &source.head;
}

static int count_to_end(void)
{
    int n = 0;
    while (next_frame() != NULL) { n++; }
    return n;
}

static uint64_t counter(const char* cause)
{
    const char* name;
    uint64_t value = 0;
    for (unsigned i = 0; (name = ipe_source_file_counter(&source, i, &value)) != NULL; ++i) {
        if (strcmp(name, cause) == 0) { return value; }
    }
    TEST_FAIL_MESSAGE(cause);
    return 0;
}

static void open_text(const char* text, const char* interface)
{
    TEST_ASSERT_EQUAL(0, ipe_source_file_open(&source, temp_file(text), 3, interface));
}

static void test_source_file_absent_or_a_directory_is_refused(void)
{
    TEST_ASSERT_EQUAL(-1, ipe_source_file_open(&source, "/nonexistent/can.log", 0, NULL));
    TEST_ASSERT_EQUAL(-1, ipe_source_file_open(&source, "/tmp", 0, NULL));
}

static void test_source_file_bad_line_does_not_lose_the_next(void)
{
    open_text("(1.0) can0 123#01\nrubbish\n(2.0) can0 1#\n\n# note\n(3.0) can0 123#03\r\n", NULL);
    TEST_ASSERT_EQUAL_INT64(1000000000, next_frame()->t_ns);
    TEST_ASSERT_EQUAL_INT64(3000000000, next_frame()->t_ns);
    TEST_ASSERT_EQUAL(3, source.head.bus);
    TEST_ASSERT_NULL(next_frame());
    TEST_ASSERT_EQUAL_UINT64(1, counter("bad_stamp"));
    TEST_ASSERT_EQUAL_UINT64(1, counter("bad_id"));
    TEST_ASSERT_EQUAL_UINT64(2, counter("comments"));
    TEST_ASSERT_EQUAL_UINT64(6, counter("lines"));
}

static void test_source_file_peek_shows_the_same_frame_until_taken(void)
{
    open_text("(1.0) can0 123#01\n(2.0) can0 123#02\n", NULL);
    TEST_ASSERT_EQUAL(IPE_SOURCE_WAIT, ipe_source_file_peek(&source));
    ipe_source_file_fill(&source);
    TEST_ASSERT_EQUAL(IPE_SOURCE_READY, ipe_source_file_peek(&source));
    TEST_ASSERT_EQUAL(IPE_SOURCE_READY, ipe_source_file_peek(&source));
    TEST_ASSERT_EQUAL_UINT64(0, counter("frames"));
    TEST_ASSERT_EQUAL(2, count_to_end());
    TEST_ASSERT_EQUAL_UINT64(2, counter("frames"));
}

static void test_source_file_filter_takes_one_interface(void)
{
    open_text("(1.0) can0 123#01\n(2.0) can1 123#02\n(3.0) can 123#03\n", "can1");
    TEST_ASSERT_EQUAL_HEX8(2, next_frame()->data[0]);
    TEST_ASSERT_NULL(next_frame());
    TEST_ASSERT_EQUAL_UINT64(2, counter("other_interface"));
}

static void test_source_file_cut_last_line_is_counted_apart(void)
{
    open_text("(1.0) can0 123#01\n(2.0) can0 123#0", NULL);
    TEST_ASSERT_EQUAL(1, count_to_end());
    TEST_ASSERT_EQUAL_UINT64(1, counter("cut"));
    TEST_ASSERT_EQUAL_UINT64(0, counter("bad_data"));
}

static void test_source_file_whole_last_line_without_line_end_is_taken(void)
{
    open_text("(1.0) can0 123#01\n(2.0) can0 123#02", NULL);
    TEST_ASSERT_EQUAL(2, count_to_end());
}

static void test_source_file_line_longer_than_the_buffer_is_one_bad_line(void)
{
    enum { SIZE = 3 * IPE_LINES_BYTES };
    static char text[SIZE + 64];
    memset(text, '1', SIZE);
    (void)snprintf(text + SIZE, 64, "\n(2.0) can0 123#02\n");
    open_text(text, NULL);
    TEST_ASSERT_EQUAL(1, count_to_end());
    TEST_ASSERT_EQUAL_UINT64(1, counter("too_long"));
    TEST_ASSERT_EQUAL_UINT64(2, counter("lines"));
}

static void test_source_file_lines_across_buffer_ends_are_whole(void)
{
    enum { N = 20000, LINE = 36 };
    static char text[N * LINE + 1];
    for (unsigned i = 0; i < N; ++i) {
        (void)snprintf(text + i * LINE, LINE + 1, "(%010u.000001) c0 123#%08X\n", i, i);
    }
    open_text(text, NULL);
    for (int i = 0; i < N; ++i) {
        const ipe_frame_t* f = next_frame();
        TEST_ASSERT_EQUAL_INT64(i * INT64_C(1000000000) + 1000, f->t_ns);
        TEST_ASSERT_EQUAL(i, f->data[0] << 24 | f->data[1] << 16 | f->data[2] << 8 | f->data[3]);
    }
    TEST_ASSERT_NULL(next_frame());
}

static void test_source_file_stray_stamp_is_left_out_and_a_gap_is_not(void)
{
    open_text(
        "(100.0) c 123#01\n(999.0) c 123#02\n(0.1) c 123#03\n(100.1) c 123#04\n(700.0) c 123#05\n(700.1) c 123#06\n"
        "(9.0) c 123#07\n(8.9) c 123#08\n(900.0) c 123#09\n",
        NULL);
    static const uint8_t EXPECTED[] = {1, 2, 3, 4, 5, 6, 7, 8, 9};
    for (size_t i = 0; i < sizeof EXPECTED; ++i) {
        const ipe_frame_t* f = next_frame();
        TEST_ASSERT_NOT_NULL(f);
        TEST_ASSERT_EQUAL(EXPECTED[i], f->data[0]);
    }
    TEST_ASSERT_NULL(next_frame());
    open_text("(100.0) c 123#01\n(999.0) c 123#02\n(100.1) c 123#03\n(0.1) c 123#04\n(100.2) c 123#05\n", NULL);
    TEST_ASSERT_EQUAL(3, count_to_end());
    TEST_ASSERT_EQUAL_UINT64(2, counter("stray_stamp"));
}

static void test_source_file_pipe_gives_a_line_when_its_end_has_come(void)
{
    int fd[2];
    TEST_ASSERT_EQUAL(0, pipe(fd));
    open_text("", NULL);
    ipe_source_file_close(&source);
    source.lines.fd = fd[0];                                            // given: an open pipe
    TEST_ASSERT_EQUAL(7, write(fd[1], "(1.0) c", 7));                   // when: half a line comes
    ipe_source_file_fill(&source);
    TEST_ASSERT_EQUAL(IPE_SOURCE_WAIT, ipe_source_file_peek(&source));  // then: not yet a frame
    TEST_ASSERT_EQUAL(11, write(fd[1], "an0 123#01\n", 11));
    ipe_source_file_fill(&source);
    TEST_ASSERT_EQUAL(IPE_SOURCE_READY, ipe_source_file_peek(&source));
    ipe_source_file_take(&source);
    (void)close(fd[1]);
    TEST_ASSERT_EQUAL(0, count_to_end());
}

static void test_source_file_counts_drops_and_controller_overruns(void)
{
    open_text("DROPCOUNT: dropped 5 CAN frames on 'can0' socket (total drops 5)\n"
              "DROPCOUNT: dropped 1 CAN frame on 'can0' socket (total drops 6)\n"
              "(1.0) can0 20000004#0001000000000000\n(1.0) can0 20000004#0000000000000000\n",
              NULL);
    TEST_ASSERT_EQUAL(2, count_to_end());
    TEST_ASSERT_EQUAL_UINT64(6, counter("dropped_by_logger"));
    TEST_ASSERT_EQUAL_UINT64(2, counter("error_frames"));
    TEST_ASSERT_EQUAL_UINT64(1, counter("controller_overruns"));
}

static void test_source_file_every_line_is_counted_once(void)
{
    static char text[200000];
    uint64_t seed = 3;
    for (size_t i = 0; i < sizeof text - 1; ++i) {
        static const char LETTERS[] = "(1.5) can0 123#01\n\n\n#;RT_D";
        seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
        text[i] = LETTERS[(seed >> 33) % (sizeof LETTERS - 1)];
    }
    open_text(text, NULL);
    const int n_frames = count_to_end();
    uint64_t sum = (uint64_t)n_frames;
    static const char* const OTHER[] = {"comments", "drop_reports", "other_interface", "bad_stamp",
                                        "bad_name", "bad_id",       "bad_data",        "bad_tail",
                                        "too_long", "cut",          "stray_stamp"};
    for (size_t i = 0; i < sizeof OTHER / sizeof OTHER[0]; ++i) { sum += counter(OTHER[i]); }
    TEST_ASSERT_EQUAL_UINT64(counter("lines"), sum);
}

int main(void)
{
    UNITY_BEGIN();
    silence_stderr();
    RUN_TEST(test_source_file_absent_or_a_directory_is_refused);
    RUN_TEST(test_source_file_bad_line_does_not_lose_the_next);
    RUN_TEST(test_source_file_peek_shows_the_same_frame_until_taken);
    RUN_TEST(test_source_file_filter_takes_one_interface);
    RUN_TEST(test_source_file_cut_last_line_is_counted_apart);
    RUN_TEST(test_source_file_whole_last_line_without_line_end_is_taken);
    RUN_TEST(test_source_file_line_longer_than_the_buffer_is_one_bad_line);
    RUN_TEST(test_source_file_lines_across_buffer_ends_are_whole);
    RUN_TEST(test_source_file_stray_stamp_is_left_out_and_a_gap_is_not);
    RUN_TEST(test_source_file_pipe_gives_a_line_when_its_end_has_come);
    RUN_TEST(test_source_file_counts_drops_and_controller_overruns);
    RUN_TEST(test_source_file_every_line_is_counted_once);
    return UNITY_END();
}
