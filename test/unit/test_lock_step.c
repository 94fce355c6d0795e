// SPDX-License-Identifier: Apache-2.0
#include "lock_step.h"

#include "temp_file.h"

#include "inertiad_lcm_command_t.h"

static ipe_lock_step_t step;
static int stdin_before, stdout_before, stderr_before;

void setUp(void)
{
    stdin_before = dup(STDIN_FILENO), stdout_before = dup(STDOUT_FILENO), stderr_before = dup(STDERR_FILENO);
    silence_stderr();
}

void tearDown(void)
{
    const int before[] = {stdin_before, stdout_before, stderr_before};
    for (int fd = STDIN_FILENO; fd <= STDERR_FILENO; ++fd) {
        (void)dup2(before[fd], fd);
        (void)close(before[fd]);
    }
    remove_temp_files();
}

static void put_at(int fd, const char* path, int flags)
{
    const int from = open(path, flags | O_CLOEXEC);
    TEST_ASSERT_GREATER_OR_EQUAL(0, from);
    TEST_ASSERT_EQUAL(fd, dup2(from, fd));
    (void)close(from);
}

static void open_bytes(const void* text, size_t n)
{
    put_at(STDIN_FILENO, temp_file_of(text, n), O_RDONLY);
    TEST_ASSERT_EQUAL(0, ipe_lock_step_open(&step));
}

static ipe_lock_step_item_t next(void)
{
    ipe_lock_step_item_t item;
    while ((item = ipe_lock_step_next(&step)) == IPE_LOCK_STEP_WAIT) { ipe_lock_step_fill(&step); }
    return item;
}

static uint64_t counter(const char* cause)
{
    const char* name;
    uint64_t value = 0;
    for (unsigned i = 0; (name = ipe_lock_step_counter(&step, i, &value)) != NULL; ++i) {
        if (strcmp(name, cause) == 0) { return value; }
    }
    TEST_FAIL_MESSAGE(cause);
    return 0;
}

/// A line that is none, behind one that is; it is counted as cause says.
static void check_refused(const char* line, size_t n, const char* cause)
{
    char text[4096] = "answer\n";
    const size_t begin = strlen(text);
    memcpy(text + begin, line, n);
    open_bytes(text, begin + n);
    TEST_ASSERT_EQUAL(IPE_LOCK_STEP_ANSWER, next());
    TEST_ASSERT_EQUAL_MESSAGE(IPE_LOCK_STEP_END, next(), line);
    TEST_ASSERT_EQUAL_UINT64_MESSAGE(1, counter(cause), line);
    TEST_ASSERT_EQUAL_UINT64(0, counter("positions"));
    TEST_ASSERT_EQUAL_UINT64(0, counter("frames"));
    TEST_ASSERT_FALSE(step.is_broken);
}

static void test_items_come_in_the_order_of_the_lines(void)
{
    static const char TEXT[] = "position 1000123000 0.1 -0.2 2e0\r\n(1.000123) can1 123#0011\nanswer\n";
    open_bytes(TEXT, strlen(TEXT));
    TEST_ASSERT_EQUAL(IPE_LOCK_STEP_POSITION, next());
    TEST_ASSERT_EQUAL_INT64(1000123000, step.position.t_ns);
    TEST_ASSERT_EQUAL_DOUBLE(-0.2, step.position.position[1]);
    TEST_ASSERT_EQUAL_DOUBLE(2.0, step.position.position[2]);
    TEST_ASSERT_EQUAL(IPE_LOCK_STEP_FRAME, next());
    TEST_ASSERT_EQUAL_UINT8(1, step.frame.bus);
    TEST_ASSERT_EQUAL(IPE_LOCK_STEP_ANSWER, next());
    TEST_ASSERT_EQUAL(IPE_LOCK_STEP_END, next());
    TEST_ASSERT_EQUAL_UINT64(3, counter("lines"));
    TEST_ASSERT_EQUAL_UINT64(1, counter("positions"));
    TEST_ASSERT_EQUAL_UINT64(1, counter("frames"));
    TEST_ASSERT_EQUAL_UINT64(1, counter("answers"));
    TEST_ASSERT_FALSE(step.is_broken);
}

static void test_lines_that_are_none_are_counted_by_cause(void)
{
    static const char* const POSITION[] = {"position 1 2 3\n", "position 1.5 1 2\n", "position 1 2 3 4 5\n",
                                           "position 1 2-3 4\n", "position 1 2 3 x\n"};
    for (unsigned i = 0; i < sizeof POSITION / sizeof POSITION[0]; ++i) {
        check_refused(POSITION[i], strlen(POSITION[i]), "bad_position");
    }
    static const char ZERO[] = "position 1 2 3 4\0 5\n";
    check_refused(ZERO, sizeof ZERO - 1, "bad_position");
    check_refused("position 1 2 3 4", 16, "cut");
    check_refused("(1.0) vcan0 123#00\n", 19, "bad_frame");
    check_refused("(1.0) can8 123#00\n", 18, "bad_frame");
    check_refused("nonsense\n", 9, "bad_frame");
    check_refused("position \n", 10, "bad_frame");
}

/// "command " and an encoded MARK in hexadecimal digits; its length.
static size_t command_line(const char* digits, char line[4096])
{
    uint8_t bytes[256];
    const inertiad_lcm_command_t command = {
        .sequence = 7, .t_ns = 5, .kind = IPE_COMMAND_MARK, .text = (char[]){"payload on"}, .config = (uint8_t[]){0}};
    const int n = inertiad_lcm_command_t_encode(bytes, 0, sizeof bytes, &command);
    size_t at = strlen(strcpy(line, "command "));
    for (int i = 0; i < n; ++i) {
        line[at++] = digits[bytes[i] >> 4U];
        line[at++] = digits[bytes[i] & 15U];
    }
    line[at++] = '\n';
    return at;
}

static void test_command_is_read_in_digits_of_either_case(void)
{
    static const char* const DIGITS[] = {"0123456789abcdef", "0123456789ABCDEF"};
    for (int k = 0; k < 2; ++k) {
        char line[4096];
        open_bytes(line, command_line(DIGITS[k], line));
        TEST_ASSERT_EQUAL(IPE_LOCK_STEP_COMMAND, next());
        TEST_ASSERT_EQUAL_INT(IPE_COMMAND_MARK, step.command.kind);
        TEST_ASSERT_EQUAL_INT64(7, step.command.sequence);
        TEST_ASSERT_EQUAL_STRING("payload on", step.command.text);
        TEST_ASSERT_EQUAL(IPE_LOCK_STEP_END, next());
        TEST_ASSERT_EQUAL_UINT64(1, counter("commands"));
    }
}

static void test_commands_that_are_none_are_counted_by_cause(void)
{
    char line[4096], odd[4096];
    const size_t n = command_line("0123456789abcdef", line);
    check_refused("command 0\n", 10, "bad_command");
    check_refused("command zz\n", 11, "bad_command");
    check_refused("command 00\n", 11, "bad_command");
    check_refused("command \n", 9, "bad_frame");
    for (size_t cut = 1; cut <= 2; ++cut) {  // half a byte less, one byte less
        memcpy(odd, line, n);
        odd[n - 1 - cut] = '\n';
        check_refused(odd, n - cut, "bad_command");
    }
    memset(odd, '0', sizeof odd);
    memcpy(odd, "command ", 8);
    odd[8 + 2 * IPE_LOCK_STEP_MESSAGE + 2] = '\n';
    check_refused(odd, 8 + 2 * IPE_LOCK_STEP_MESSAGE + 3, "too_long");
}

static void test_times_that_are_none_are_refused(void)
{
    static const char* const LINE[] = {"position -1 1 2 3\n", "position 9223372036854775807 1 2 3\n",
                                       "position -99999999999999999999999 1 2 3\n",
                                       "position 99999999999999999999999 1 2 3\n"};
    for (unsigned i = 0; i < sizeof LINE / sizeof LINE[0]; ++i) { check_refused(LINE[i], strlen(LINE[i]), "bad_time"); }
}

static void test_long_position_is_not_cut_and_used(void)
{
    char line[401] = "";
    memset(line, '1', 400);
    memcpy(line, "position 1 2 3 4.", 17);
    line[399] = '\n';
    check_refused(line, 400, "too_long");
}

static void test_stdin_without_a_line_of_use_is_broken(void)
{
    open_bytes("a\nb\n", 4);
    TEST_ASSERT_EQUAL(IPE_LOCK_STEP_END, next());
    TEST_ASSERT_TRUE(step.is_broken);
    open_bytes("", 0);  // when: nothing at all
    TEST_ASSERT_EQUAL(IPE_LOCK_STEP_END, next());
    TEST_ASSERT_FALSE(step.is_broken);
}

static void test_stdin_that_is_a_directory_is_refused(void)
{
    put_at(STDIN_FILENO, "/tmp", O_RDONLY | O_DIRECTORY);
    TEST_ASSERT_EQUAL(-1, ipe_lock_step_open(&step));
}

static void test_stdout_that_takes_nothing_is_noticed(void)
{
    open_bytes("answer\n", 7);
    ipe_lock_step_put(&step, "ANSWER", 0, NULL, 0);
    (void)fflush(stdout);
    put_at(STDOUT_FILENO, "/dev/full", O_WRONLY);
    const bool is_sent = ipe_lock_step_send(&step);
    TEST_ASSERT_EQUAL(STDOUT_FILENO, dup2(stdout_before, STDOUT_FILENO));
    TEST_ASSERT_FALSE(is_sent);
    TEST_ASSERT_TRUE(step.is_broken);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_items_come_in_the_order_of_the_lines);
    RUN_TEST(test_lines_that_are_none_are_counted_by_cause);
    RUN_TEST(test_command_is_read_in_digits_of_either_case);
    RUN_TEST(test_commands_that_are_none_are_counted_by_cause);
    RUN_TEST(test_times_that_are_none_are_refused);
    RUN_TEST(test_long_position_is_not_cut_and_used);
    RUN_TEST(test_stdin_without_a_line_of_use_is_broken);
    RUN_TEST(test_stdin_that_is_a_directory_is_refused);
    RUN_TEST(test_stdout_that_takes_nothing_is_noticed);
    return UNITY_END();
}
