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
#include <time.h>
#include <unistd.h>

enum {
    UDP_HEADER = 8,                                // a socket's filter sees it before the payload
    HEADER = 8,                                    // magic, sequence
    WANTED_BUFFER = 1 << 20,
    SKIPPED_MAX = 64,                              // unusable messages in one call
    DISCARD_PORT = 9,                              // nothing is sent there
    FILTER_MAX = 4 * (IPE_INBOX_NAME_MAX + 1) + 2  // instructions
};
#define IS_LINK_LOCAL(address) (((address) & 0xFFFFFF00U) == INADDR_UNSPEC_GROUP)  // 224.0.0.0/24
static const char SCHEME[] = "udpm://", MAGIC[] = "LC02";
static const char DEFAULT_ADDRESS[] = "239.255.76.67";
static const uint16_t DEFAULT_PORT = 7667;
static const int64_t NS_PER_S = 1000000000;
static const int64_t SILENCE_NS = 1000000000;  // of a publisher, after which another takes its place
static const int64_t OWN_NS = 1000000000;      // for which an address that was the host's counts as such

static int64_t monotonic_ns(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * NS_PER_S + t.tv_nsec;
}

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

bool ipe_inbox_is_network(const char* url)
{
    return strncmp(url, SCHEME, strlen(SCHEME)) == 0;
}

int ipe_inbox_read_url(const char* url, struct sockaddr_in* group, char* message, size_t size)
{
    return read_address(url + strlen(SCHEME), group) ? 0 : fail(url, EINVAL, message, size);
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

static int join_on(const ipe_inbox_t* b, const struct sockaddr_in* address, in_addr_t interface)
{
    const struct ip_mreq group = {.imr_multiaddr = address->sin_addr, .imr_interface.s_addr = htonl(interface)};
    return setsockopt(b->fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &group, sizeof group);
}

static int join(const ipe_inbox_t* b, const struct sockaddr_in* address)
{
    const int on = 1, off = 0, buffer = WANTED_BUFFER;
    (void)setsockopt(b->fd, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
    (void)setsockopt(b->fd, IPPROTO_IP, IP_MULTICAST_ALL, &off, sizeof off);
    if (setsockopt(b->fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) != 0) { return -1; }
    if (bind(b->fd, (const struct sockaddr*)address, sizeof *address) != 0) { return -1; }
    const bool is_on_loopback = join_on(b, address, INADDR_LOOPBACK) == 0;
    if (join_on(b, address, INADDR_ANY) == 0) { return 0; }
    return is_on_loopback && (errno == ENODEV || errno == EADDRINUSE) ? 0
                                                                      : -1;  // no route, or it leads to the loopback
}

static int open_sockets(ipe_inbox_t* b, const struct sockaddr_in* address)
{
    b->fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    b->probe_fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (b->fd < 0 || b->probe_fd < 0) { return -1; }
    filter_channels(b);
    return join(b, address);
}

int ipe_inbox_open(ipe_inbox_t* b, const ipe_inbox_options_t* o, char* message, size_t size)
{
    struct sockaddr_in address;
    memset(b, 0, sizeof *b);
    b->fd = b->probe_fd = -1;
    b->tracker_from = o->tracker_from;
    b->command_from = o->command_from;
    assert(strlen(o->tracker) < sizeof b->tracker && strlen(o->command) < sizeof b->command);
    memcpy(b->tracker, o->tracker, strlen(o->tracker) + 1);
    memcpy(b->command, o->command, strlen(o->command) + 1);
    if (!ipe_inbox_is_network(o->url)) { return 0; }
    if (ipe_inbox_read_url(o->url, &address, message, size) != 0) { return -1; }
    b->is_link_local = IS_LINK_LOCAL(ntohl(address.sin_addr.s_addr));
    if (open_sockets(b, &address) == 0) { return 0; }
    const int cause = errno;
    ipe_inbox_close(b);
    return fail(o->url, cause, message, size);
}

void ipe_inbox_close(ipe_inbox_t* b)
{
    if (b->fd >= 0) { (void)close(b->fd); }
    if (b->probe_fd >= 0) { (void)close(b->probe_fd); }
    b->fd = b->probe_fd = -1;
}

// ---- origin ---------------------------------------------------------------------------------------------------------

/// The kernel answers: what is sent to one of the host's own addresses has that address as its source, too.
static bool is_own_address(const ipe_inbox_t* b, const struct sockaddr_in* from)
{
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(DISCARD_PORT), .sin_addr = from->sin_addr};
    const struct sockaddr none = {.sa_family = AF_UNSPEC};
    struct sockaddr_in source = {0};
    socklen_t n = sizeof source;
    (void)connect(b->probe_fd, &none, sizeof none);  // forget the last one
    return connect(b->probe_fd, (const struct sockaddr*)&to, sizeof to) == 0 &&
           getsockname(b->probe_fd, (struct sockaddr*)&source, &n) == 0 &&
           source.sin_addr.s_addr == from->sin_addr.s_addr;
}

static bool is_from_host(ipe_inbox_t* b, const struct sockaddr_in* from)
{
    if (from->sin_family != AF_INET) { return false; }
    const uint32_t address = from->sin_addr.s_addr;
    if (address == INADDR_ANY) { return !b->is_link_local; }
    if (ntohl(address) >> IN_CLASSA_NSHIFT == IN_LOOPBACKNET) { return true; }
    const int64_t now_ns = monotonic_ns();
    if (address == b->own_address && now_ns - b->own_ns < OWN_NS) { return true; }
    if (!is_own_address(b, from)) { return false; }
    b->own_address = address;
    b->own_ns = now_ns;
    return true;
}

static bool is_allowed(ipe_inbox_t* b, ipe_inbox_origin_t origin, const struct sockaddr_in* from,
                       struct sockaddr_in* foreign, uint64_t* n_foreign)
{
    if (origin == IPE_INBOX_ORIGIN_NETWORK || (origin == IPE_INBOX_ORIGIN_HOST && is_from_host(b, from))) {
        return true;
    }
    *foreign = *from;
    ++*n_foreign;
    return false;
}

/// True if TRACKER is bound to this publisher, or now gets bound to it.
static bool is_publisher(ipe_inbox_t* b, const struct sockaddr_in* from)
{
    const int64_t now_ns = monotonic_ns();
    const bool is_same =
        b->publisher.sin_port == from->sin_port && b->publisher.sin_addr.s_addr == from->sin_addr.s_addr;
    if (!is_same && b->publisher_ns != 0 && now_ns - b->publisher_ns < SILENCE_NS) {
        b->other = *from;
        b->n_positions_other++;
        return false;
    }
    b->publisher = *from;
    b->publisher_ns = now_ns;
    return true;
}

// ---- messages -------------------------------------------------------------------------------------------------------

static ipe_inbox_kind_t take_tracker(ipe_inbox_t* b, const struct sockaddr_in* from, ipe_inbox_item_t* item)
{
    inertiad_lcm_tracker_t tracker;
    if (!is_allowed(b, b->tracker_from, from, &b->foreign_position, &b->n_positions_foreign)) {
        return IPE_INBOX_EMPTY;
    }
    const int n = inertiad_lcm_tracker_t_decode(item->data, 0, (int)item->n, &tracker);
    if (n < 0 || tracker.t_ns < 0 || tracker.t_ns / NS_PER_S > IPE_SECONDS_MAX) {
        b->n_positions_bad++;
        return IPE_INBOX_EMPTY;
    }
    if (!is_publisher(b, from)) { return IPE_INBOX_EMPTY; }
    if (!tracker.valid) {
        b->n_positions_invalid++;
        return IPE_INBOX_EMPTY;
    }
    b->n_positions++;
    item->t_ns = tracker.t_ns;
    memcpy(item->position, tracker.position, sizeof item->position);
    return IPE_INBOX_POSITION;
}

static ipe_inbox_kind_t take_command(ipe_inbox_t* b, const struct sockaddr_in* from, ipe_inbox_item_t* item)
{
    if (!is_allowed(b, b->command_from, from, &b->foreign_command, &b->n_commands_foreign)) { return IPE_INBOX_EMPTY; }
    if (ipe_command_decode(item->data, item->n, &item->command) != 0) {
        b->n_commands_bad++;
        return IPE_INBOX_EMPTY;
    }
    b->n_commands++;
    return IPE_INBOX_COMMAND;
}

/// Content of a datagram of n bytes.
static ipe_inbox_kind_t take_datagram(ipe_inbox_t* b, size_t n, const struct sockaddr_in* from, ipe_inbox_item_t* item)
{
    const char* channel = (const char*)b->datagram + HEADER;
    if (n <= HEADER || memcmp(b->datagram, MAGIC, strlen(MAGIC)) != 0) { return IPE_INBOX_EMPTY; }
    const size_t n_channel = strnlen(channel, n - HEADER);
    if (n_channel == n - HEADER) { return IPE_INBOX_EMPTY; }
    item->data = b->datagram + HEADER + n_channel + 1;
    item->n = n - HEADER - n_channel - 1;
    if (strcmp(channel, b->tracker) == 0) { return take_tracker(b, from, item); }
    return strcmp(channel, b->command) == 0 ? take_command(b, from, item) : IPE_INBOX_EMPTY;
}

ipe_inbox_kind_t ipe_inbox_next(ipe_inbox_t* b, ipe_inbox_item_t* item)
{
    for (int i = 0; i < SKIPPED_MAX && b->fd >= 0; ++i) {
        struct sockaddr_in from = {0};
        socklen_t size = sizeof from;
        const ssize_t n = recvfrom(b->fd, b->datagram, sizeof b->datagram, 0, (struct sockaddr*)&from, &size);
        if (n < 0) { return IPE_INBOX_EMPTY; }
        const ipe_inbox_kind_t kind = take_datagram(b, (size_t)n, &from, item);
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
        {"tracker_bad_message", b->n_positions_bad}, {"tracker_other_publisher", b->n_positions_other},
        {"tracker_foreign", b->n_positions_foreign}, {"commands", b->n_commands},
        {"commands_bad_message", b->n_commands_bad}, {"commands_foreign", b->n_commands_foreign},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
