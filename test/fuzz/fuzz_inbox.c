// SPDX-License-Identifier: Apache-2.0
// Datagrams of LCM, as they come, and with a right beginning: per datagram its kind, u8, length, u16, and bytes.
#include "command_guard.h"
#include "config_file.h"
#include "fuzz.h"
#include "inbox.h"
#include "inertiad_lcm_command_t.h"
#include "inertiad_lcm_expectation_t.h"
#include "inertiad_lcm_tracker_t.h"
#include "wire.h"

#include <sys/socket.h>

enum { RAW, CHANNEL_TRACKER, CHANNEL_COMMAND, TRACKER, COMMAND, CONFIGURE, KINDS, BYTES_MAX = 4096 };
static const char TRACKER_NAME[] = "INERTIAD_TRACKER", COMMAND_NAME[] = "INERTIAD_COMMAND";

static ipe_inbox_t inbox;
static ipe_command_guard_t guard;
static int sender = -1;

static size_t put_header(uint8_t* to, const char* channel)
{
    memcpy(to, "LC02\0\0\0\1", 8);
    memcpy(to + 8, channel, strlen(channel) + 1);
    return 8 + strlen(channel) + 1;
}

/// A command_t with the robot's configuration, patched.
static size_t put_configuration(uint8_t* to, input_t* in)
{
    static uint8_t base[IPE_CONFIG_FILE_MAX];
    static size_t n_base;
    if (n_base == 0) {
        const ipe_config_t good = cogiro();
        n_base = wire_encode(&good, base);
    }
    inertiad_lcm_command_t command = {.kind = IPE_COMMAND_CONFIGURE, .text = (char[]){""}, .n_config = (int32_t)n_base};
    uint8_t config[IPE_CONFIG_FILE_MAX];
    memcpy(config, base, n_base);
    patch(in, config, n_base - IPE_CONFIG_CRC_BYTES);
    wire_put_crc(config, n_base);
    command.config = config;
    return (size_t)inertiad_lcm_command_t_encode(to, 0, IPE_INBOX_BYTES / 2, &command);
}

/// The datagram; its length.
static size_t compose(uint8_t* to, int kind, input_t* in)
{
    size_t n = 0;
    if (kind != RAW) { n = put_header(to, kind == CHANNEL_TRACKER || kind == TRACKER ? TRACKER_NAME : COMMAND_NAME); }
    if (kind == TRACKER) { wire_put(to + n, (uint64_t)__inertiad_lcm_tracker_t_get_hash(), WIRE_HASH_BYTES); }
    if (kind == COMMAND) { wire_put(to + n, (uint64_t)__inertiad_lcm_command_t_get_hash(), WIRE_HASH_BYTES); }
    if (kind == TRACKER || kind == COMMAND) { n += WIRE_HASH_BYTES; }
    if (kind == CONFIGURE) { return n + put_configuration(to + n, in); }
    if (in->n > 0) { memcpy(to + n, in->at, in->n); }
    return n + in->n;
}

/// The content as it is, and behind the hash of an expectation_t: no announcement may come of numbers that are none.
static void expect(const ipe_command_t* c)
{
    static uint8_t content[IPE_INBOX_BYTES];
    static ipe_announcement_t announcement;
    static const ipe_config_t config = {.imu_position = {0.1, 0.2, 0.3}};
    char message[256];
    ipe_expectation_t e;
    int64_t t_ns = 0;
    ipe_command_t whole = *c;
    (void)ipe_command_expectation(c, &e);
    wire_put(content, (uint64_t)__inertiad_lcm_expectation_t_get_hash(), WIRE_HASH_BYTES);
    memcpy(content + WIRE_HASH_BYTES, c->config, c->n_config);
    whole.config = content, whole.n_config += WIRE_HASH_BYTES;
    if (ipe_command_expectation(&whole, &e) != 0) { return; }
    if (ipe_command_contact(c, &e, 5000000000, &t_ns) == 0) { REQUIRE(t_ns >= 0 && t_ns <= IPE_TIME_MAX_NS); }
    if (ipe_announcement_init(&announcement, &config, e.number, t_ns, 0.001, message, sizeof message) != IPE_OK) {
        return;
    }
    for (int i = 0; i < IPE_ANNOUNCEMENT_NUMBERS; ++i) { REQUIRE(e.number[i] - e.number[i] == 0.0); }
}

/// As the daemon does.
static void use(const ipe_inbox_item_t* item, ipe_inbox_kind_t kind)
{
    char message[512];
    static ipe_config_t config;
    REQUIRE(item->data >= inbox.datagram && item->data + item->n <= inbox.datagram + sizeof inbox.datagram);
    if (kind == IPE_INBOX_POSITION) {
        REQUIRE(item->t_ns >= 0 && item->t_ns / 1000000000 <= IPE_SECONDS_MAX);
        return;
    }
    const ipe_command_t* c = &item->command;
    REQUIRE(c->config >= item->data && c->config + c->n_config <= item->data + item->n);
    REQUIRE((const uint8_t*)c->text + strlen(c->text) < item->data + item->n);
    const int64_t now_ns = 20 * IPE_COMMAND_AGE_MAX, listened_ns = IPE_COMMAND_AGE_MAX / 2;
    const ipe_command_novelty_t novelty = ipe_command_guard_check(&guard, c, now_ns, listened_ns);
    REQUIRE(guard.n <= IPE_COMMANDS_KEPT);
    if (novelty == IPE_COMMAND_NEW) {
        REQUIRE(guard.n > 0);
        REQUIRE(ipe_command_guard_check(&guard, c, now_ns, listened_ns) == IPE_COMMAND_REPEATED);
    }
    expect(c);
    (void)ipe_config_from_bytes(c->config, c->n_config, &config, message, sizeof message);
}

/// A socket that nobody else can send to stands for the group's.
static void prepare(void)
{
    char message[256];
    int fd[2];
    const ipe_inbox_options_t options = {.url = "none",
                                         .tracker = TRACKER_NAME,
                                         .command = COMMAND_NAME,
                                         .tracker_from = IPE_INBOX_ORIGIN_NETWORK,
                                         .command_from = IPE_INBOX_ORIGIN_NETWORK};
    REQUIRE(ipe_inbox_open(&inbox, &options, message, sizeof message) == 0);
    REQUIRE(socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, fd) == 0);
    inbox.fd = fd[0];
    sender = fd[1];
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    static uint8_t datagram[IPE_INBOX_BYTES];
    input_t in = {data, size};
    ipe_inbox_item_t item;
    ipe_inbox_kind_t kind;
    if (sender < 0) { prepare(); }
    guard.n = 0;
    while (in.n > 0) {
        const int shape = take_u8(&in) % KINDS;
        const size_t wanted = take_u16(&in) % BYTES_MAX;
        input_t bytes = {in.at, wanted < in.n ? wanted : in.n};
        in.at += bytes.n;
        in.n -= bytes.n;
        const size_t n = compose(datagram, shape, &bytes);
        REQUIRE(send(sender, datagram, n, 0) == (ssize_t)n);
        while ((kind = ipe_inbox_next(&inbox, &item)) != IPE_INBOX_EMPTY) { use(&item, kind); }
    }
    return 0;
}
