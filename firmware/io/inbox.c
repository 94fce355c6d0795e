// SPDX-License-Identifier: Apache-2.0
#include "inbox.h"

#include "source.h"

#include "inertiad_lcm_tracker_t.h"

#include <arpa/inet.h>
#include <assert.h>
#include <errno.h>
#include <linux/filter.h>
#include <netinet/in.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum {
    UDP_HEADER = 8,                                // a socket's filter sees it before the payload
    HEADER = 8,                                    // magic, sequence
    WANTED_BUFFER = 1 << 20,
    FILTER_MAX = 4 * (IPE_INBOX_NAME_MAX + 1) + 2  // instructions
};
static const char SCHEME[] = "udpm://", MAGIC[] = "LC02";
static const char DEFAULT_ADDRESS[] = "239.255.76.67";
static const uint16_t DEFAULT_PORT = 7667;
static const int64_t NS_PER_S = 1000000000;

// ---- transport ------------------------------------------------------------------------------------------------------

static int fail(const char* what, int cause, char* message, size_t size)
{
    (void)snprintf(message, size, "%s: %s", what, strerror(cause));
    return -1;
}

/// ADDRESS[:PORT][?...] after the scheme. False if it is none.
static bool read_address(const char* text, struct sockaddr_in* address)
{
    char host[INET_ADDRSTRLEN] = "";
    unsigned long port = DEFAULT_PORT;
    const size_t n_host = strcspn(text, ":?");
    if (n_host >= sizeof host) { return false; }
    memcpy(host, n_host > 0 ? text : DEFAULT_ADDRESS, n_host > 0 ? n_host : sizeof DEFAULT_ADDRESS);
    if (text[n_host] == ':') {
        char* end;
        port = strtoul(text + n_host + 1, &end, 10);
        if ((*end != '\0' && *end != '?') || port == 0 || port > UINT16_MAX) { return false; }
    }
    *address = (struct sockaddr_in){.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    return inet_pton(AF_INET, host, &address->sin_addr) == 1;
}

/// Append a test of the channel's bytes, its final zero included: accept if all agree, go on behind it otherwise.
static unsigned add_channel(struct sock_filter* program, unsigned n, const char* channel)
{
    const unsigned n_bytes = (unsigned)strlen(channel) + 1;
    const unsigned end = n + 2 * n_bytes + 1;
    for (unsigned i = 0; i < n_bytes; ++i) {
        program[n++] = (struct sock_filter)BPF_STMT(BPF_LD | BPF_B | BPF_ABS, UDP_HEADER + HEADER + i);
        const uint8_t jump = (uint8_t)(end - n - 1);
        program[n++] = (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (uint8_t)channel[i], 0, jump);
    }
    program[n++] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, UINT32_MAX);
    return n;
}

/// Only our two channels reach the socket. Where the kernel cannot filter, ipe_inbox_next() does.
static void filter_channels(const ipe_inbox_t* b)
{
    static_assert(2 * IPE_INBOX_NAME_MAX < UINT8_MAX, "a jump over a channel fits its byte");
    struct sock_filter program[FILTER_MAX];
    unsigned n = add_channel(program, 0, b->tracker);
    n = add_channel(program, n, b->command);
    program[n++] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, 0);
    const struct sock_fprog filter = {.len = (unsigned short)n, .filter = program};
    (void)setsockopt(b->fd, SOL_SOCKET, SO_ATTACH_FILTER, &filter, sizeof filter);
}

static int join(const ipe_inbox_t* b, const struct sockaddr_in* address)
{
    const int on = 1, buffer = WANTED_BUFFER;
    const struct ip_mreq group = {.imr_multiaddr = address->sin_addr, .imr_interface.s_addr = htonl(INADDR_ANY)};
    (void)setsockopt(b->fd, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
    if (setsockopt(b->fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) != 0) { return -1; }
    if (bind(b->fd, (const struct sockaddr*)address, sizeof *address) != 0) { return -1; }
    return setsockopt(b->fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &group, sizeof group);
}

int ipe_inbox_open(ipe_inbox_t* b, const char* url, const char* tracker, const char* command, char* message,
                   size_t size)
{
    struct sockaddr_in address;
    memset(b, 0, sizeof *b);
    b->fd = -1;
    assert(strlen(tracker) < sizeof b->tracker && strlen(command) < sizeof b->command);
    memcpy(b->tracker, tracker, strlen(tracker) + 1);
    memcpy(b->command, command, strlen(command) + 1);
    if (strncmp(url, SCHEME, strlen(SCHEME)) != 0) { return 0; }
    if (!read_address(url + strlen(SCHEME), &address)) { return fail(url, EINVAL, message, size); }
    b->fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (b->fd < 0) { return fail(url, errno, message, size); }
    filter_channels(b);
    if (join(b, &address) == 0) { return 0; }
    const int cause = errno;
    ipe_inbox_close(b);
    return fail(url, cause, message, size);
}

void ipe_inbox_close(ipe_inbox_t* b)
{
    if (b->fd >= 0) { (void)close(b->fd); }
    b->fd = -1;
}

// ---- messages -------------------------------------------------------------------------------------------------------

static ipe_inbox_kind_t take_tracker(ipe_inbox_t* b, ipe_inbox_item_t* item)
{
    inertiad_lcm_tracker_t tracker;
    const int n = inertiad_lcm_tracker_t_decode(item->data, 0, (int)item->n, &tracker);
    if (n < 0 || tracker.t_ns < 0 || tracker.t_ns / NS_PER_S > IPE_SECONDS_MAX) {
        b->n_positions_bad++;
        return IPE_INBOX_EMPTY;
    }
    if (!tracker.valid) {
        b->n_positions_invalid++;
        return IPE_INBOX_EMPTY;
    }
    b->n_positions++;
    item->t_ns = tracker.t_ns;
    memcpy(item->position, tracker.position, sizeof item->position);
    return IPE_INBOX_POSITION;
}

static ipe_inbox_kind_t take_command(ipe_inbox_t* b, ipe_inbox_item_t* item)
{
    if (ipe_command_decode(item->data, item->n, &item->command) != 0) {
        b->n_commands_bad++;
        return IPE_INBOX_EMPTY;
    }
    b->n_commands++;
    return IPE_INBOX_COMMAND;
}

/// Content of a datagram of n bytes.
static ipe_inbox_kind_t take_datagram(ipe_inbox_t* b, size_t n, ipe_inbox_item_t* item)
{
    const char* channel = (const char*)b->datagram + HEADER;
    if (n <= HEADER || memcmp(b->datagram, MAGIC, strlen(MAGIC)) != 0) { return IPE_INBOX_EMPTY; }
    const size_t n_channel = strnlen(channel, n - HEADER);
    if (n_channel == n - HEADER) { return IPE_INBOX_EMPTY; }
    item->data = b->datagram + HEADER + n_channel + 1;
    item->n = n - HEADER - n_channel - 1;
    if (strcmp(channel, b->tracker) == 0) { return take_tracker(b, item); }
    return strcmp(channel, b->command) == 0 ? take_command(b, item) : IPE_INBOX_EMPTY;
}

ipe_inbox_kind_t ipe_inbox_next(ipe_inbox_t* b, ipe_inbox_item_t* item)
{
    ssize_t n;
    while (b->fd >= 0 && (n = recv(b->fd, b->datagram, sizeof b->datagram, 0)) >= 0) {
        const ipe_inbox_kind_t kind = take_datagram(b, (size_t)n, item);
        if (kind != IPE_INBOX_EMPTY) { return kind; }
    }
    return IPE_INBOX_EMPTY;
}

const char* ipe_inbox_counter(const ipe_inbox_t* b, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"tracker_positions", b->n_positions},       {"tracker_invalid", b->n_positions_invalid},
        {"tracker_bad_message", b->n_positions_bad}, {"commands", b->n_commands},
        {"commands_bad_message", b->n_commands_bad},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
