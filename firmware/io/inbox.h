// SPDX-License-Identifier: Apache-2.0
/// Messages to the daemon over LCM: TRACKER and COMMAND.
///
/// It has its own socket in LCM's multicast group, because liblcm's receiver is a thread that allocates for every new
/// channel name and receives everything the daemon itself publishes. Here a filter in the kernel passes only the two
/// channels, and one datagram is handled at a time. Messages that LCM would split (over 64 KB) are ignored.
///
/// Each channel has an origin from which it is taken: nobody, this host, or the network. A datagram is from this host if
/// its source is one of the host's own addresses. A host that has only the loopback sends without a source address. The
/// kernel drops such datagrams when they come from outside (fib_validate_source, ip_mc_validate_source).
/// TRACKER is bound to its first publisher, an address and port, until that has been silent for 1 s. So positions of two
/// publishers never mix. All that is refused is counted.
/// 66 KB of state, caller-allocated, no heap, one thread; one system call per message, with ORIGIN_HOST three more once a
/// second.
/// Source: LCM's wire protocol, "LC02", sequence u32, channel, zero, message; linux/filter.h.
#ifndef IPE_INBOX_H
#define IPE_INBOX_H

#include "command.h"

#include <netinet/in.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { IPE_INBOX_NAME_MAX = 64, IPE_INBOX_BYTES = 65536 };

typedef enum {
    IPE_INBOX_EMPTY = 0,
    IPE_INBOX_POSITION = 1,
    IPE_INBOX_COMMAND = 2,
} ipe_inbox_kind_t;

/// One message; good until the next is read.
typedef struct {
    int64_t t_ns;           ///< POSITION: host time of the measured instant
    double position[3];     ///< POSITION: W, m
    ipe_command_t command;  ///< COMMAND
    const uint8_t* data;    ///< the message as it came, n bytes
    size_t n;
} ipe_inbox_item_t;

/// Is it the URL of a multicast group, "udpm:..."?
bool ipe_inbox_is_network(const char* url);

/// The group and port of such a URL. 0; -1: it names none, one line in message.
int ipe_inbox_read_url(const char* url, struct sockaddr_in* group, char* message, size_t size);

/// Who may send on a channel.
typedef enum {
    IPE_INBOX_ORIGIN_NONE = 0,     ///< nobody
    IPE_INBOX_ORIGIN_HOST = 1,     ///< programs on this host
    IPE_INBOX_ORIGIN_NETWORK = 2,  ///< everybody who reaches the group
} ipe_inbox_origin_t;

typedef struct {
    const char* url;
    const char *tracker, *command;  ///< names of the channels, at most 63 characters; copied
    ipe_inbox_origin_t tracker_from, command_from;
} ipe_inbox_options_t;

typedef struct {
    int fd;  ///< for epoll; -1: off
    int probe_fd;
    char tracker[IPE_INBOX_NAME_MAX], command[IPE_INBOX_NAME_MAX];
    ipe_inbox_origin_t tracker_from, command_from;
    bool is_link_local;            ///< group: only there the kernel lets datagrams without a source in
    struct sockaddr_in publisher;  ///< of TRACKER; family 0: not bound
    int64_t publisher_ns;          ///< CLOCK_MONOTONIC of its last message
    struct sockaddr_in other;      ///< the last publisher of TRACKER that was refused
    struct sockaddr_in foreign_position, foreign_command;  ///< the last senders from elsewhere that were refused
    uint32_t own_address;  ///< found to be the host's at own_ns, CLOCK_MONOTONIC; 0: none
    int64_t own_ns;
    uint8_t datagram[IPE_INBOX_BYTES];

    uint64_t n_positions;          ///< TRACKER messages handed on
    uint64_t n_positions_invalid;  ///< TRACKER messages flagged as not to be used
    uint64_t n_positions_bad;      ///< TRACKER messages refused: not a tracker_t, or its time out of range
    uint64_t n_positions_other;    ///< TRACKER messages refused: of another publisher than the bound one
    uint64_t n_positions_foreign;  ///< TRACKER messages refused: from another origin than allowed
    uint64_t n_commands;           ///< COMMAND messages handed on
    uint64_t n_commands_bad;       ///< COMMAND messages refused: not a command_t
    uint64_t n_commands_foreign;   ///< COMMAND messages refused: from another origin than allowed
} ipe_inbox_t;

/// Join the group of an LCM URL, udpm://[ADDRESS[:PORT]][?...], on the loopback and on the interface to which multicast
/// is routed. Any other URL, "none" too, leaves the inbox off: fd -1.
///
///   message  out  one line on failure; size bytes, always terminated
///
/// 0 or -1.
int ipe_inbox_open(ipe_inbox_t* b, const ipe_inbox_options_t* options, char* message, size_t size);

/// The next message. EMPTY: none there, or only such as cannot be used, which are counted; after some dozen of these the
/// rest waits for the next call.
ipe_inbox_kind_t ipe_inbox_next(ipe_inbox_t* b, ipe_inbox_item_t* item);

void ipe_inbox_close(ipe_inbox_t* b);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_inbox_counter(const ipe_inbox_t* b, unsigned index, uint64_t* value);

#endif
