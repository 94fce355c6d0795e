// SPDX-License-Identifier: Apache-2.0
/// Over memq://, LCM's transport inside one process.
#include "publish.h"

#include "robot.h"
#include "temp_file.h"

#include "inertiad_lcm_estimate_t.h"
#include "inertiad_lcm_event_t.h"
#include "inertiad_lcm_health_t.h"
#include "inertiad_lcm_order_t.h"
#include "inertiad_lcm_raw_t.h"
#include "inertiad_lcm_signals_t.h"

#include <math.h>

enum { MS = 1000000 };

static ipe_publish_t publisher;
static ipe_estimate_t estimate;
static char message[512];
static int n_received[IPE_PUBLISH_COUNT];
static int64_t last_sequence, last_dropped, last_t_ns;
static int last_length;
static char last_text[64];
static int last_kind;
static int64_t last_sender;
static inertiad_lcm_order_item_t last_item;

enum { N_DROPPED = 9 };

static void receive(const lcm_recv_buf_t* buffer, const char* channel, void* user)
{
    (void)user;
    inertiad_lcm_raw_t raw;
    inertiad_lcm_signals_t signals;
    inertiad_lcm_estimate_t e;
    inertiad_lcm_health_t health;
    inertiad_lcm_event_t event;
    inertiad_lcm_order_t order;
    const int n = (int)buffer->data_size;
    if (strcmp(channel, "TEST_RAW") == 0) {
        TEST_ASSERT_EQUAL(n, inertiad_lcm_raw_t_decode(buffer->data, 0, n, &raw));
        n_received[IPE_PUBLISH_RAW]++;
        last_sequence = raw.sequence, last_dropped = raw.n_dropped, last_length = raw.n_frames, last_t_ns = raw.t_ns;
        inertiad_lcm_raw_t_decode_cleanup(&raw);
    } else if (strcmp(channel, "TEST_SIGNALS") == 0) {
        TEST_ASSERT_EQUAL(n, inertiad_lcm_signals_t_decode(buffer->data, 0, n, &signals));
        n_received[IPE_PUBLISH_SIGNALS]++;
        last_sequence = signals.sequence, last_dropped = signals.n_dropped, last_length = signals.n_rows;
        TEST_ASSERT_EQUAL(8, signals.row[0].n_cables);
        inertiad_lcm_signals_t_decode_cleanup(&signals);
    } else if (strcmp(channel, "TEST_ESTIMATE") == 0) {
        TEST_ASSERT_EQUAL(n, inertiad_lcm_estimate_t_decode(buffer->data, 0, n, &e));
        n_received[IPE_PUBLISH_ESTIMATE]++;
        last_sequence = e.sequence, last_dropped = e.n_dropped;
        TEST_ASSERT_EQUAL(INERTIAD_LCM_ESTIMATE_T_SCHEMA, e.schema);
        if (e.n_systematic > 0) {
            (void)snprintf(last_text, sizeof last_text, "%s", e.systematic_name[e.n_systematic - 1]);
        }
        inertiad_lcm_estimate_t_decode_cleanup(&e);
    } else if (strcmp(channel, "TEST_ORDER") == 0) {
        TEST_ASSERT_EQUAL(n, inertiad_lcm_order_t_decode(buffer->data, 0, n, &order));
        n_received[IPE_PUBLISH_ORDER]++;
        last_length = order.n_items, last_item = order.item[order.n_items - 1], last_t_ns = order.t_ns;
        inertiad_lcm_order_t_decode_cleanup(&order);
    } else if (strcmp(channel, "TEST_HEALTH") == 0) {
        TEST_ASSERT_EQUAL(n, inertiad_lcm_health_t_decode(buffer->data, 0, n, &health));
        n_received[IPE_PUBLISH_HEALTH]++;
        last_length = health.n_counters;
        TEST_ASSERT_EQUAL(1, health.frozen);
        TEST_ASSERT_EQUAL(INERTIAD_LCM_BUS_T_OFF, health.bus[1].condition);
        TEST_ASSERT_EQUAL_STRING("estimate", health.latency[1].name);
        TEST_ASSERT_EQUAL_INT64(100, health.latency[1].bucket[health.latency[1].n_buckets - 1]);
        TEST_ASSERT_EQUAL_DOUBLE(50e-6, health.latency[1].p999);
        (void)snprintf(last_text, sizeof last_text, "%s", health.counter[0].name);
        inertiad_lcm_health_t_decode_cleanup(&health);
    } else if (strcmp(channel, "TEST_EVENT") == 0) {
        TEST_ASSERT_EQUAL(n, inertiad_lcm_event_t_decode(buffer->data, 0, n, &event));
        n_received[IPE_PUBLISH_EVENT]++;
        (void)snprintf(last_text, sizeof last_text, "%s: %s", event.source, event.text);
        last_kind = event.kind, last_sender = event.sender, last_sequence = event.command;
        inertiad_lcm_event_t_decode_cleanup(&event);
    } else if (strcmp(channel, "TEST_CONFIG") == 0) {
        n_received[IPE_PUBLISH_CONFIG]++;
        last_length = n;
        memcpy(last_text, buffer->data, (size_t)n);
    }
}

static void handle_all(void)
{
    while (lcm_handle_timeout(publisher.lcm, 0) > 0) {}
}

void setUp(void)
{
    const ipe_config_t config = cogiro();
    memset(n_received, 0, sizeof n_received);
    memset(&estimate, 0, sizeof estimate);
    estimate.n_windows = 1;
    TEST_ASSERT_EQUAL(0, ipe_publish_open(&publisher, "memq://", "TEST_", &config, message, sizeof message));
    TEST_ASSERT_NOT_NULL(lcm_subscribe(publisher.lcm, "TEST_.*", receive, NULL));
}

void tearDown(void)
{
    ipe_publish_close(&publisher);
}

static void push_frames(int n, int64_t t_ns, int64_t step_ns)
{
    for (int i = 0; i < n; ++i) {
        const ipe_frame_t frame = {.t_ns = t_ns + i * step_ns, .can_id = 0x80000123U, .bus = 1, .length = 64};
        ipe_publish_frame(&publisher, &frame);
    }
}

static void test_publish_raw_block_is_sent_after_16_ms(void)
{
    push_frames(17, 0, MS);
    handle_all();
    TEST_ASSERT_EQUAL(1, n_received[IPE_PUBLISH_RAW]);
    TEST_ASSERT_EQUAL(16, last_length);
    TEST_ASSERT_EQUAL_INT64(15 * MS, last_t_ns);
    ipe_publish_flush(&publisher);
    handle_all();
    TEST_ASSERT_EQUAL(1, last_length);
    TEST_ASSERT_EQUAL_INT64(1, last_sequence);
}

static void test_publish_raw_block_of_the_longest_frames_is_sent_when_full(void)
{
    push_frames(IPE_PUBLISH_FRAMES, 0, 1);
    handle_all();
    TEST_ASSERT_EQUAL(1, n_received[IPE_PUBLISH_RAW]);
    TEST_ASSERT_EQUAL(IPE_PUBLISH_FRAMES, last_length);
    TEST_ASSERT_EQUAL_INT64(0, last_dropped);
}

static void test_publish_time_that_goes_back_begins_a_new_block(void)
{
    push_frames(2, 5 * MS, MS);
    push_frames(1, 1 * MS, MS);
    handle_all();
    TEST_ASSERT_EQUAL(1, n_received[IPE_PUBLISH_RAW]);
    TEST_ASSERT_EQUAL(2, last_length);
}

static bool push_row(int64_t t_ns)
{
    const ipe_row_t row = {.t_ns = t_ns};
    return ipe_publish_row(&publisher, &row, &estimate, N_DROPPED);
}

static void test_publish_rows_carry_the_number_lost_before(void)
{
    for (int i = 0; i < 2 * IPE_PUBLISH_ROWS; ++i) { (void)push_row(i); }
    handle_all();
    TEST_ASSERT_EQUAL(2, n_received[IPE_PUBLISH_SIGNALS]);
    TEST_ASSERT_EQUAL(IPE_PUBLISH_ROWS, last_length);
    TEST_ASSERT_EQUAL_INT64(N_DROPPED, last_dropped);
}

static void test_publish_estimate_keeps_its_rate_in_data_time(void)
{
    int n_sent = 0;
    for (int64_t t = 0; t < 1000; ++t) { n_sent += push_row(t * MS); }
    handle_all();
    TEST_ASSERT_EQUAL(50, n_sent);
    TEST_ASSERT_EQUAL(50, n_received[IPE_PUBLISH_ESTIMATE]);
    TEST_ASSERT_EQUAL_INT64(50, publisher.sequence[IPE_PUBLISH_ESTIMATE]);
    (void)push_row(1);                                        // when: time steps back
    handle_all();
    TEST_ASSERT_EQUAL(51, n_received[IPE_PUBLISH_ESTIMATE]);  // then: it goes on from there
}

static void test_publish_estimate_before_the_first_window_is_not_sent(void)
{
    estimate.n_windows = 0;
    ipe_publish_last(&publisher, &estimate, N_DROPPED);
    handle_all();
    TEST_ASSERT_EQUAL(0, n_received[IPE_PUBLISH_ESTIMATE]);
}

static void test_publish_estimate_that_is_not_finite_is_held_back(void)
{
    double* const field[] = {&estimate.body.mass, &estimate.body.cog_std[2], &estimate.theta[9],
                             &estimate.covariance[9][9]};
    for (int i = 0; i < 4; ++i) {
        *field[i] = i % 2 == 0 ? NAN : INFINITY;
        ipe_publish_last(&publisher, &estimate, N_DROPPED);
        *field[i] = 0.0;
    }
    handle_all();
    TEST_ASSERT_EQUAL(0, n_received[IPE_PUBLISH_ESTIMATE]);
    TEST_ASSERT_EQUAL_UINT64(4, publisher.n_not_finite);
}

static void test_publish_estimate_names_its_systematic_parameters(void)
{
    estimate.n_systematic = ipe_systematic_count(8);
    (void)push_row(0);
    handle_all();
    TEST_ASSERT_EQUAL_STRING("friction_8", last_text);
}

static void test_publish_order_gives_each_item_its_place_among_the_frames(void)
{
    const double position[3] = {1.0, 2.0, 3.0};
    push_frames(20, 0, MS);  // 16 are sent, 4 wait
    ipe_publish_order(&publisher, INERTIAD_LCM_ORDER_ITEM_T_POSITION, 5, position);
    push_frames(6 * 16, 20 * MS, MS);
    handle_all();
    TEST_ASSERT_EQUAL(1, n_received[IPE_PUBLISH_ORDER]);
    TEST_ASSERT_EQUAL_INT64(1, last_item.raw);
    TEST_ASSERT_EQUAL(4, last_item.n_before);
    TEST_ASSERT_EQUAL_INT64(5, last_item.t_ns);
    TEST_ASSERT_EQUAL_DOUBLE(3.0, last_item.value[2]);
    ipe_publish_flush(&publisher);
    ipe_publish_order(&publisher, IPE_COMMAND_RESET, 6, NULL);  // when: no frame waits
    ipe_publish_flush(&publisher);
    handle_all();
    TEST_ASSERT_EQUAL_INT64(publisher.sequence[IPE_PUBLISH_RAW], last_item.raw);
    TEST_ASSERT_EQUAL(0, last_item.n_before);
    TEST_ASSERT_EQUAL(IPE_COMMAND_RESET, last_item.kind);
}

static void test_publish_expectation_is_stamped_when_it_is_used(void)
{
    ipe_expectation_t expectation = {.t_ns = 600LL * 1000 * MS};
    for (int i = 0; i < IPE_ANNOUNCEMENT_NUMBERS; ++i) { expectation.number[i] = i; }
    ipe_publish_expectation(&publisher, 5, &expectation);
    ipe_publish_flush(&publisher);
    handle_all();
    TEST_ASSERT_EQUAL(7, last_length);
    TEST_ASSERT_EQUAL_INT64(5, last_t_ns);  // a record rotates by it
    TEST_ASSERT_EQUAL_INT64(600LL * 1000 * MS, last_item.t_ns);
    TEST_ASSERT_EQUAL_DOUBLE(19.0, last_item.value[1]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, last_item.value[2]);
    TEST_ASSERT_EQUAL(IPE_COMMAND_EXPECT, last_item.kind);
}

static void test_publish_order_is_sent_when_full(void)
{
    for (int i = 0; i < IPE_PUBLISH_ITEMS; ++i) { ipe_publish_order(&publisher, 0, i, NULL); }
    handle_all();
    TEST_ASSERT_EQUAL(1, n_received[IPE_PUBLISH_ORDER]);
    TEST_ASSERT_EQUAL(IPE_PUBLISH_ITEMS, last_length);
}

static void test_publish_health_and_event_arrive_whole(void)
{
    static ipe_counters_t counters;
    static ipe_histogram_t histogram;
    const ipe_health_t health = {.counters = &counters,
                                 .age = {0.0, 1.0, -1.0},
                                 .is_frozen = true,
                                 .n_buses = 2,
                                 .bus = {{"can0", true, IPE_BUS_ACTIVE}, {"can1", false, IPE_BUS_OFF}},
                                 .n_latencies = 2,
                                 .latency = {{"decoded", &histogram}, {"estimate", &histogram}}};
    for (int i = 0; i < 100; ++i) { ipe_histogram_push(&histogram, 50000); }
    for (int i = 0; i < IPE_COUNTERS_MAX; ++i) {
        ipe_counters_add(&counters, "stage_with_a_long_name", "cause_that_is_long", 7);
    }
    ipe_publish_health(&publisher, 1, &health);
    handle_all();
    TEST_ASSERT_EQUAL(IPE_COUNTERS_MAX, last_length);
    TEST_ASSERT_EQUAL_STRING("stage_with_a_long_name.cause_that_is_long", last_text);
    ipe_publish_event(&publisher, 1, "can0", "interface is down");
    handle_all();
    TEST_ASSERT_EQUAL_STRING("can0: interface is down", last_text);
}

static void test_publish_config_arrives_as_it_is_and_is_counted(void)
{
    const uint8_t bytes[] = {7, 0, 9};
    const uint64_t n_before = publisher.n_messages;
    ipe_publish_config(&publisher, bytes, sizeof bytes);  // when
    handle_all();                                         // then
    TEST_ASSERT_EQUAL(1, n_received[IPE_PUBLISH_CONFIG]);
    TEST_ASSERT_EQUAL(sizeof bytes, last_length);
    TEST_ASSERT_EQUAL_MEMORY(bytes, last_text, sizeof bytes);
    TEST_ASSERT_EQUAL_UINT64(n_before + 1, publisher.n_messages);
}

static void test_publish_answer_tells_which_command_it_answers(void)
{
    const ipe_command_t command = {.sequence = 3, .sender = 99};
    ipe_publish_answer(&publisher, 1, &command, false, "moving");
    handle_all();
    TEST_ASSERT_EQUAL_STRING("command: moving", last_text);
    TEST_ASSERT_EQUAL(INERTIAD_LCM_EVENT_T_REFUSED, last_kind);
    TEST_ASSERT_EQUAL_INT64(99, last_sender);
    TEST_ASSERT_EQUAL_INT64(3, last_sequence);
}

static void test_publish_without_lcm_does_nothing(void)
{
    const ipe_config_t config = cogiro();
    ipe_publish_close(&publisher);
    TEST_ASSERT_EQUAL(0, ipe_publish_open(&publisher, "none", "TEST_", &config, message, sizeof message));
    push_frames(1000, 0, MS);
    ipe_publish_last(&publisher, &estimate, N_DROPPED);
    TEST_ASSERT_EQUAL_UINT64(0, publisher.n_messages);
}

static void test_publish_bad_prefix_is_refused(void)
{
    const ipe_config_t config = cogiro();
    static ipe_publish_t other;
    TEST_ASSERT_EQUAL(-1, ipe_publish_open(&other, "none", "A*", &config, message, sizeof message));
    TEST_ASSERT_EQUAL(-1, ipe_publish_open(&other, "none", "", &config, message, sizeof message));
    TEST_ASSERT_NOT_NULL(strstr(message, "prefix"));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_publish_raw_block_is_sent_after_16_ms);
    RUN_TEST(test_publish_raw_block_of_the_longest_frames_is_sent_when_full);
    RUN_TEST(test_publish_time_that_goes_back_begins_a_new_block);
    RUN_TEST(test_publish_rows_carry_the_number_lost_before);
    RUN_TEST(test_publish_estimate_keeps_its_rate_in_data_time);
    RUN_TEST(test_publish_estimate_before_the_first_window_is_not_sent);
    RUN_TEST(test_publish_estimate_that_is_not_finite_is_held_back);
    RUN_TEST(test_publish_estimate_names_its_systematic_parameters);
    RUN_TEST(test_publish_order_gives_each_item_its_place_among_the_frames);
    RUN_TEST(test_publish_expectation_is_stamped_when_it_is_used);
    RUN_TEST(test_publish_order_is_sent_when_full);
    RUN_TEST(test_publish_health_and_event_arrive_whole);
    RUN_TEST(test_publish_config_arrives_as_it_is_and_is_counted);
    RUN_TEST(test_publish_answer_tells_which_command_it_answers);
    RUN_TEST(test_publish_without_lcm_does_nothing);
    RUN_TEST(test_publish_bad_prefix_is_refused);
    return UNITY_END();
}
