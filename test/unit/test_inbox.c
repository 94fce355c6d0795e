// SPDX-License-Identifier: Apache-2.0
/// Datagrams come over the loopback; the multicast group itself, and senders on other hosts, are in test/host.
#include "command_guard.h"
#include "inbox.h"

#include "inertiad_lcm_command_t.h"
#include "inertiad_lcm_tracker_t.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>
#include <unity.h>

static ipe_inbox_t inbox;
static ipe_inbox_item_t item;
static int sender = -1, other_sender = -1;
static uint8_t bytes[4096];
static char message[256];

static int open_inbox(ipe_inbox_t* b, const char* url, ipe_inbox_origin_t from)
{
    const ipe_inbox_options_t options = {
        .url = url, .tracker = "T_TRACKER", .command = "T_COMMAND", .tracker_from = from, .command_from = from};
    return ipe_inbox_open(b, &options, message, sizeof message);
}

static int open_sender(const struct sockaddr_in* to)
{
    const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0);
    TEST_ASSERT_EQUAL(0, connect(fd, (const struct sockaddr*)to, sizeof *to));
    return fd;
}

void setUp(void)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t n = sizeof address;
    TEST_ASSERT_EQUAL(0, open_inbox(&inbox, "none", IPE_INBOX_ORIGIN_HOST));
    TEST_ASSERT_EQUAL(-1, inbox.fd);
    inbox.fd = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0);
    TEST_ASSERT_EQUAL(0, bind(inbox.fd, (const struct sockaddr*)&address, sizeof address));
    TEST_ASSERT_EQUAL(0, getsockname(inbox.fd, (struct sockaddr*)&address, &n));
    sender = open_sender(&address);
    other_sender = open_sender(&address);
}

void tearDown(void)
{
    ipe_inbox_close(&inbox);
    TEST_ASSERT_EQUAL(-1, inbox.fd);
    (void)close(sender);
    (void)close(other_sender);
}

static void send_bytes(const char* channel, const uint8_t* data, size_t n)
{
    uint8_t datagram[8192] = "LC02";
    const size_t n_channel = strlen(channel) + 1;
    memcpy(datagram + 8, channel, n_channel);
    memcpy(datagram + 8 + n_channel, data, n);
    TEST_ASSERT_EQUAL(8 + n_channel + n, send(sender, datagram, 8 + n_channel + n, 0));
}

static void send_tracker(bool is_valid, int64_t t_ns, int n_cut)
{
    const inertiad_lcm_tracker_t tracker = {.t_ns = t_ns, .valid = is_valid, .position = {1, 2, 3}};
    const int n = inertiad_lcm_tracker_t_encode(bytes, 0, sizeof bytes, &tracker);
    send_bytes("T_TRACKER", bytes, (size_t)(n - n_cut));
}

static int encode_command(int n_config)
{
    static uint8_t config[1000];
    static char text[] = "load on";
    for (int i = 0; i < n_config; ++i) { config[i] = (uint8_t)(i + 1); }
    const inertiad_lcm_command_t command = {.sequence = 5,
                                            .t_ns = 6,
                                            .sender = -7,
                                            .kind = INERTIAD_LCM_COMMAND_T_MARK,
                                            .text = text,
                                            .n_config = n_config,
                                            .config = config};
    return inertiad_lcm_command_t_encode(bytes, 0, sizeof bytes, &command);
}

static void test_inbox_positions_are_handed_on_if_valid(void)
{
    send_tracker(true, 77, 0);
    TEST_ASSERT_EQUAL(IPE_INBOX_POSITION, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_EQUAL_INT64(77, item.t_ns);
    TEST_ASSERT_EQUAL_DOUBLE(3.0, item.position[2]);
    send_tracker(false, 77, 0);
    send_tracker(true, 77, 5);
    send_tracker(true, -1, 0);
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_EQUAL_UINT64(1, inbox.n_positions);
    TEST_ASSERT_EQUAL_UINT64(1, inbox.n_positions_invalid);
    TEST_ASSERT_EQUAL_UINT64(2, inbox.n_positions_bad);
}

static void test_inbox_command_arrives_as_it_was_encoded(void)
{
    const int n = encode_command(1000);
    send_bytes("T_COMMAND", bytes, (size_t)n);
    TEST_ASSERT_EQUAL(IPE_INBOX_COMMAND, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_EQUAL(n, item.n);
    TEST_ASSERT_EQUAL_MEMORY(bytes, item.data, (size_t)n);
    TEST_ASSERT_EQUAL_INT64(5, item.command.sequence);
    TEST_ASSERT_EQUAL_INT64(6, item.command.t_ns);
    TEST_ASSERT_EQUAL_INT64(-7, item.command.sender);
    TEST_ASSERT_EQUAL(IPE_COMMAND_MARK, item.command.kind);
    TEST_ASSERT_EQUAL_STRING("load on", item.command.text);
    TEST_ASSERT_EQUAL(1000, item.command.n_config);
    TEST_ASSERT_EQUAL((1000 & 0xFF), item.command.config[999]);
}

/// Cut anywhere, lengthened, or with any one byte changed, a command is refused or is another whole command.
static void test_inbox_damaged_commands_are_counted(void)
{
    ipe_command_t command;
    const int n = encode_command(20);
    for (int i = 0; i < n; ++i) { TEST_ASSERT_EQUAL(-1, ipe_command_decode(bytes, (size_t)i, &command)); }
    TEST_ASSERT_EQUAL(-1, ipe_command_decode(bytes, (size_t)n + 1, &command));
    for (int i = 0; i < n; ++i) {
        bytes[i] ^= 0xFF;
        if (ipe_command_decode(bytes, (size_t)n, &command) == 0) {
            TEST_ASSERT_EQUAL(20, command.n_config);
            TEST_ASSERT_EQUAL('\0', command.text[7]);
        }
        bytes[i] ^= 0xFF;
    }
    send_bytes("T_COMMAND", bytes, 10);
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_EQUAL_UINT64(1, inbox.n_commands_bad);
}

static void test_inbox_leaves_out_what_is_not_for_it(void)
{
    const int n = encode_command(0);
    send_bytes("T_COMMANDER", bytes, (size_t)n);
    send_bytes("T_", bytes, (size_t)n);
    TEST_ASSERT_EQUAL(4, send(sender, "LC03", 4, 0));
    TEST_ASSERT_EQUAL(12, send(sender, "LC02....T_CO", 12, 0));
    TEST_ASSERT_EQUAL(0, send(sender, "", 0, 0));
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_EQUAL_UINT64(0, inbox.n_commands + inbox.n_commands_bad);
}

static ipe_inbox_kind_t next_position_of(int from)
{
    const int first = sender;
    sender = from;
    send_tracker(true, 77, 0);
    sender = first;
    return ipe_inbox_next(&inbox, &item);
}

static void test_inbox_positions_of_two_publishers_never_mix(void)
{
    TEST_ASSERT_EQUAL(IPE_INBOX_POSITION, next_position_of(sender));
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, next_position_of(other_sender));
    TEST_ASSERT_EQUAL(IPE_INBOX_POSITION, next_position_of(sender));
    TEST_ASSERT_EQUAL_UINT64(1, inbox.n_positions_other);
    inbox.publisher_ns -= 2000000000;  // silent for 2 s
    TEST_ASSERT_EQUAL(IPE_INBOX_POSITION, next_position_of(other_sender));
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, next_position_of(sender));
    TEST_ASSERT_EQUAL_UINT64(2, inbox.n_positions_other);
}

static void test_inbox_origin_none_takes_nothing(void)
{
    inbox.command_from = inbox.tracker_from = IPE_INBOX_ORIGIN_NONE;
    send_bytes("T_COMMAND", bytes, (size_t)encode_command(0));
    send_tracker(true, 77, 0);
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_EQUAL_UINT64(1, inbox.n_commands_foreign);
    TEST_ASSERT_EQUAL_UINT64(1, inbox.n_positions_foreign);
}

/// Unusable messages cannot keep the caller from its other work.
static void test_inbox_returns_from_a_flood(void)
{
    for (int i = 0; i < 100; ++i) { send_bytes("T_COMMAND", bytes, 1); }
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_LESS_THAN(100, inbox.n_commands_bad);
    TEST_ASSERT_EQUAL(IPE_INBOX_EMPTY, ipe_inbox_next(&inbox, &item));
    TEST_ASSERT_EQUAL_UINT64(100, inbox.n_commands_bad);
}

static ipe_command_novelty_t check(ipe_command_guard_t* guard, int64_t sender_id, int64_t sequence, int64_t t_ns)
{
    const ipe_command_t command = {.sender = sender_id, .sequence = sequence, .t_ns = t_ns};
    return ipe_command_guard_check(guard, &command, INT64_C(1700000000000000000), INT64_C(60000000000));
}

static void test_command_guard_takes_each_new_command_once(void)
{
    static ipe_command_guard_t guard;
    const int64_t now = INT64_C(1700000000000000000), s = 1000000000;
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(&guard, 1, 0, now));
    TEST_ASSERT_EQUAL(IPE_COMMAND_REPEATED, check(&guard, 1, 0, now + s));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(&guard, 1, 1, now));
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(&guard, 2, 0, now - 9 * s));
    TEST_ASSERT_EQUAL(IPE_COMMAND_OLD, check(&guard, 3, 0, now - 11 * s));
    TEST_ASSERT_EQUAL(IPE_COMMAND_AHEAD, check(&guard, 3, 0, now + 11 * s));
    TEST_ASSERT_EQUAL(IPE_COMMAND_OLD, check(&guard, 3, 0, INT64_MIN));
    TEST_ASSERT_EQUAL(IPE_COMMAND_AHEAD, check(&guard, 3, 0, INT64_MAX));
    for (unsigned i = guard.n; i < IPE_COMMANDS_KEPT; ++i) {
        TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, check(&guard, 4, i, now));
    }
    TEST_ASSERT_EQUAL(IPE_COMMAND_TOO_MANY, check(&guard, 5, 0, now));
    const ipe_command_t later = {.sender = 5, .t_ns = now + 20 * s};
    TEST_ASSERT_EQUAL(IPE_COMMAND_NEW, ipe_command_guard_check(&guard, &later, now + 20 * s, 60 * s));
    TEST_ASSERT_EQUAL(1, guard.n);
}

static void test_inbox_bad_address_is_refused(void)
{
    static ipe_inbox_t other;
    const char* const url[] = {"udpm://here",         "udpm://1.2.3",
                               "udpm://239.1.1.1:0",  "udpm://239.1.1.1:70000",
                               "udpm://239.1.1.1:7x", "udpm://10.255.255.254:7667"};
    for (unsigned i = 0; i < sizeof url / sizeof url[0]; ++i) {
        TEST_ASSERT_EQUAL(-1, open_inbox(&other, url[i], IPE_INBOX_ORIGIN_HOST));
        TEST_ASSERT_EQUAL_MEMORY(url[i], message, strlen(url[i]));
        TEST_ASSERT_EQUAL(-1, other.fd);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_inbox_positions_of_two_publishers_never_mix);
    RUN_TEST(test_inbox_origin_none_takes_nothing);
    RUN_TEST(test_inbox_returns_from_a_flood);
    RUN_TEST(test_command_guard_takes_each_new_command_once);
    RUN_TEST(test_inbox_positions_are_handed_on_if_valid);
    RUN_TEST(test_inbox_command_arrives_as_it_was_encoded);
    RUN_TEST(test_inbox_damaged_commands_are_counted);
    RUN_TEST(test_inbox_leaves_out_what_is_not_for_it);
    RUN_TEST(test_inbox_bad_address_is_refused);
    return UNITY_END();
}
