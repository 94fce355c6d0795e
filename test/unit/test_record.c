// SPDX-License-Identifier: Apache-2.0
/// What is written is read back with lcm's own reader.
#define _GNU_SOURCE  // F_SETPIPE_SZ
#include "record.h"

#include "temp_file.h"

#include <errno.h>
#include <lcm/eventlog.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <time.h>

enum { US = 1000 };

static ipe_record_t recorder;
static ipe_record_options_t options;
static char folder[32], path[64], message[512];
static const uint8_t CONFIG[] = {1, 2, 3, 4, 5};

void setUp(void)
{
    (void)snprintf(folder, sizeof folder, "/tmp/inertiad-XXXXXX");
    TEST_ASSERT_NOT_NULL(mkdtemp(folder));
    (void)snprintf(path, sizeof path, "%s/run.lcmlog", folder);
    options = (ipe_record_options_t){
        .path = path, .config_channel = "T_CONFIG", .config_bytes = CONFIG, .n_config_bytes = sizeof CONFIG};
}

static const char* numbered(unsigned n)
{
    static char name[96];
    (void)snprintf(name, sizeof name, "%s.%u", path, n);
    return name;
}

void tearDown(void)
{
    (void)unlink(path);
    for (unsigned n = 1; unlink(numbered(n)) == 0; ++n) {}
    TEST_ASSERT_EQUAL(0, rmdir(folder));
}

static void open_it(void)
{
    TEST_ASSERT_EQUAL_MESSAGE(0, ipe_record_open(&recorder, &options, message, sizeof message), message);
}

static void push(const char* channel, int64_t t_us, int value, size_t n)
{
    static uint8_t data[IPE_RECORD_MESSAGE_MAX];
    memset(data, value, n);
    ipe_record_push(&recorder, channel, t_us * US, data, n);
}

typedef struct {
    int n_events;
    int n_configs, n_checks;
    int64_t n_gaps;  ///< numbers left out
    int64_t first_us, last_us;
    int last_value, last_length;
} contents_t;

/// Read the log; every event must be whole.
static contents_t read_log(const char* name)
{
    contents_t c = {0};
    int64_t number = -1;
    lcm_eventlog_t* log = lcm_eventlog_create(name, "r");
    TEST_ASSERT_NOT_NULL(log);
    for (lcm_eventlog_event_t* e; (e = lcm_eventlog_read_next_event(log)) != NULL; lcm_eventlog_free_event(e)) {
        if (strcmp(e->channel, IPE_RECORD_CHECK_CHANNEL) == 0) {
            TEST_ASSERT_EQUAL(IPE_RECORD_CHECK, e->datalen);
            TEST_ASSERT_EQUAL_INT64(number, e->eventnum);
            c.n_checks++;
            continue;
        }
        if (number >= 0) { c.n_gaps += e->eventnum - number - 1; }
        number = e->eventnum;
        if (strcmp(e->channel, "T_CONFIG") == 0) {
            TEST_ASSERT_EQUAL(0, c.n_events + c.n_configs);  // first of all
            TEST_ASSERT_EQUAL(sizeof CONFIG, e->datalen);
            TEST_ASSERT_EQUAL_MEMORY(CONFIG, e->data, sizeof CONFIG);
            c.n_configs++;
            c.first_us = e->timestamp;
            continue;
        }
        c.n_events++;
        c.last_us = e->timestamp;
        c.last_length = e->datalen;
        c.last_value = e->datalen > 0 ? ((const uint8_t*)e->data)[e->datalen - 1] : -1;
    }
    lcm_eventlog_destroy(log);
    return c;
}

static uint64_t counter(const char* cause)
{
    const char* name;
    uint64_t value = 0;
    for (unsigned i = 0; (name = ipe_record_counter(&recorder, i, &value)) != NULL; ++i) {
        if (strcmp(name, cause) == 0) { return value; }
    }
    TEST_FAIL_MESSAGE(cause);
    return 0;
}

static void test_record_is_read_back_whole_by_lcm(void)
{
    struct stat info;
    open_it();
    push("T_RAW", 1000, 7, 100);
    push("T_EVENT", 2000, 8, 0);
    push("T_RAW", 3000, 9, 65000);
    TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
    const contents_t c = read_log(path);
    TEST_ASSERT_EQUAL(1, c.n_configs);
    TEST_ASSERT_EQUAL(1, c.n_checks);
    TEST_ASSERT_EQUAL(3, c.n_events);
    TEST_ASSERT_EQUAL_INT64(0, c.n_gaps);
    TEST_ASSERT_EQUAL_INT64(1000, c.first_us);
    TEST_ASSERT_EQUAL_INT64(3000, c.last_us);
    TEST_ASSERT_EQUAL(65000, c.last_length);
    TEST_ASSERT_EQUAL(9, c.last_value);
    TEST_ASSERT_EQUAL_UINT64(3, counter("messages"));
    TEST_ASSERT_EQUAL(0, stat(path, &info));
    TEST_ASSERT_EQUAL_UINT64((uint64_t)info.st_size, counter("bytes"));
}

static void test_record_of_nothing_still_holds_the_configuration(void)
{
    open_it();
    TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
    TEST_ASSERT_EQUAL(1, read_log(path).n_configs);
}

static void test_record_that_waits_loses_nothing_of_ten_queues(void)
{
    enum { N = 10 * (IPE_RECORD_QUEUE / 60000) };
    options.waits = true;
    open_it();
    for (int i = 0; i < N; ++i) { push("T_RAW", i, i, 60000U + (unsigned)i % 17U); }
    TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
    const contents_t c = read_log(path);
    TEST_ASSERT_EQUAL(N, c.n_events);
    TEST_ASSERT_EQUAL_INT64(0, c.n_gaps);
    TEST_ASSERT_EQUAL((N - 1) & 0xFF, c.last_value);
}

static void test_record_is_on_the_disk_within_a_second(void)
{
    const struct timespec pause = {.tv_sec = 0, .tv_nsec = 900000000};
    open_it();
    push("T_RAW", 1, 1, 10);
    (void)nanosleep(&pause, NULL);
    TEST_ASSERT_EQUAL(1, read_log(path).n_events);
    TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
}

/// A pipe nobody reads stands for a disk that hangs.
static void test_record_full_queue_drops_and_counts(void)
{
    enum { N = 400 };
    TEST_ASSERT_EQUAL(0, mkfifo(path, 0600));
    const int reader = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    open_it();
    for (int i = 0; i < N; ++i) { push("T_RAW", i, i, 60000); }
    const uint64_t n_dropped = counter("dropped");
    TEST_ASSERT_GREATER_THAN_UINT64(N - IPE_RECORD_QUEUE / 60000 - 20, n_dropped);
    (void)signal(SIGPIPE, SIG_IGN);
    (void)close(reader);  // the disk is gone: what is in the queue is lost as well
    TEST_ASSERT_EQUAL(-1, ipe_record_close(&recorder));
    TEST_ASSERT_EQUAL_UINT64(N, counter("dropped") + counter("messages"));
    TEST_ASSERT_EQUAL_INT(EPIPE, atomic_load(&recorder.error));
}

/// A limit on the file's size stands for a full disk.
static void test_record_full_disk_keeps_whole_messages_and_goes_on_when_there_is_room(void)
{
    enum { N = 100, LIMIT = 1000500 };
    const struct timespec pause = {.tv_nsec = 200000000};
    struct rlimit before, limit;
    (void)signal(SIGXFSZ, SIG_IGN);
    TEST_ASSERT_EQUAL(0, getrlimit(RLIMIT_FSIZE, &before));
    limit = before;
    limit.rlim_cur = LIMIT;
    TEST_ASSERT_EQUAL(0, setrlimit(RLIMIT_FSIZE, &limit));
    open_it();
    for (int i = 0; i < N; ++i) { push("T_RAW", i, i, 60000); }
    (void)nanosleep(&pause, NULL);
    const uint64_t n_dropped = counter("dropped");
    TEST_ASSERT_EQUAL(0, setrlimit(RLIMIT_FSIZE, &before));
    push("T_RAW", N, 77, 60000);
    TEST_ASSERT_EQUAL(-1, ipe_record_close(&recorder));
    const contents_t c = read_log(path);
    TEST_ASSERT_GREATER_THAN_UINT64(0, n_dropped);
    TEST_ASSERT_EQUAL_UINT64(n_dropped, counter("dropped"));
    TEST_ASSERT_EQUAL_UINT64(N + 1, counter("dropped") + counter("messages"));
    TEST_ASSERT_EQUAL_UINT64(counter("messages"), (uint64_t)c.n_events);
    TEST_ASSERT_EQUAL_INT64(n_dropped, c.n_gaps);
    TEST_ASSERT_EQUAL(77, c.last_value);
    TEST_ASSERT_GREATER_THAN_UINT64(0, counter("errors"));
    TEST_ASSERT_EQUAL_INT(EFBIG, atomic_load(&recorder.error));
}

static void test_record_too_long_a_message_is_dropped_and_counted(void)
{
    options.waits = true;
    open_it();
    push("T_RAW", 1, 1, IPE_RECORD_MESSAGE_MAX);
    push("T_RAW", 2, 2, 1);
    TEST_ASSERT_EQUAL(-1, ipe_record_close(&recorder));
    TEST_ASSERT_EQUAL(1, read_log(path).n_events);
    TEST_ASSERT_EQUAL_INT64(1, read_log(path).n_gaps);
}

static void test_record_before_is_moved_aside(void)
{
    for (int i = 1; i <= 3; ++i) {
        open_it();
        push("T_RAW", 1, i, 10);
        TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
    }
    TEST_ASSERT_EQUAL(1, read_log(numbered(1)).last_value);
    TEST_ASSERT_EQUAL(2, read_log(numbered(2)).last_value);
    TEST_ASSERT_EQUAL(3, read_log(path).last_value);
}

static void test_record_rotated_by_size_begins_each_file_with_the_configuration(void)
{
    enum { N = 50 };
    int n_events = 0, n_files = 0;
    options.rotate_bytes = 1000000;
    open_it();
    for (int i = 0; i < N; ++i) { push("T_RAW", i, i, 60000); }
    TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
    for (unsigned n = 1; access(numbered(n), F_OK) == 0; ++n, ++n_files) {
        struct stat info;
        TEST_ASSERT_EQUAL(0, stat(numbered(n), &info));
        TEST_ASSERT_LESS_OR_EQUAL(1000000, info.st_size);
        TEST_ASSERT_EQUAL(1, read_log(numbered(n)).n_configs);
        n_events += read_log(numbered(n)).n_events;
    }
    TEST_ASSERT_EQUAL(3, n_files);
    TEST_ASSERT_EQUAL(N, n_events + read_log(path).n_events);
    TEST_ASSERT_EQUAL(1, read_log(path).n_configs);
}

static void test_record_rotated_by_data_time(void)
{
    options.rotate_us = 1000000;
    open_it();
    for (int i = 0; i < 30; ++i) { push("T_RAW", 5000000 + 100000 * i, i, 10); }
    TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
    TEST_ASSERT_EQUAL(10, read_log(numbered(1)).n_events);
    TEST_ASSERT_EQUAL(10, read_log(numbered(2)).n_events);
    TEST_ASSERT_EQUAL(10, read_log(path).n_events);
    TEST_ASSERT_EQUAL(29, read_log(path).last_value);
}

/// Values of the configurations in a log, as decimal digits in their order.
static int configs_of(const char* name)
{
    int digits = 0;
    lcm_eventlog_t* log = lcm_eventlog_create(name, "r");
    TEST_ASSERT_NOT_NULL(log);
    for (lcm_eventlog_event_t* e; (e = lcm_eventlog_read_next_event(log)) != NULL; lcm_eventlog_free_event(e)) {
        if (strcmp(e->channel, "T_CONFIG") == 0) { digits = 10 * digits + ((const uint8_t*)e->data)[0]; }
    }
    lcm_eventlog_destroy(log);
    return digits;
}

static void test_record_a_new_configuration_begins_the_files_after_it(void)
{
    options.rotate_us = 1000000;
    open_it();
    for (int i = 0; i < 30; ++i) {
        if (i == 5) { push("T_CONFIG", 500000, 7, 20); }
        push("T_RAW", 100000 * i, i, 10);
    }
    TEST_ASSERT_EQUAL(0, ipe_record_close(&recorder));
    TEST_ASSERT_EQUAL(17, configs_of(numbered(1)));
    TEST_ASSERT_EQUAL(7, configs_of(numbered(2)));
    TEST_ASSERT_EQUAL(7, configs_of(path));
}

static void test_record_that_cannot_be_opened_says_why(void)
{
    char nowhere[96];
    (void)snprintf(nowhere, sizeof nowhere, "%s/nowhere/run.lcmlog", folder);
    options.path = nowhere;
    TEST_ASSERT_EQUAL(-1, ipe_record_open(&recorder, &options, message, sizeof message));
    TEST_ASSERT_NOT_NULL(strstr(message, "No such file"));
    options.path = folder;
    TEST_ASSERT_EQUAL(-1, ipe_record_open(&recorder, &options, message, sizeof message));
    TEST_ASSERT_NOT_NULL(strstr(message, "Is a directory"));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_record_is_read_back_whole_by_lcm);
    RUN_TEST(test_record_of_nothing_still_holds_the_configuration);
    RUN_TEST(test_record_that_waits_loses_nothing_of_ten_queues);
    RUN_TEST(test_record_is_on_the_disk_within_a_second);
    RUN_TEST(test_record_full_queue_drops_and_counts);
    RUN_TEST(test_record_full_disk_keeps_whole_messages_and_goes_on_when_there_is_room);
    RUN_TEST(test_record_too_long_a_message_is_dropped_and_counted);
    RUN_TEST(test_record_before_is_moved_aside);
    RUN_TEST(test_record_rotated_by_size_begins_each_file_with_the_configuration);
    RUN_TEST(test_record_rotated_by_data_time);
    RUN_TEST(test_record_a_new_configuration_begins_the_files_after_it);
    RUN_TEST(test_record_that_cannot_be_opened_says_why);
    return UNITY_END();
}
