// SPDX-License-Identifier: Apache-2.0
/// Messages to the daemon over LCM: TRACKER and COMMAND.
///
/// It has its own socket in LCM's multicast group, because liblcm's receiver is a thread that allocates for every new channel
/// name and receives everything the daemon itself publishes. Here a filter in the kernel passes only the two channels, and
/// one datagram is handled at a time. Messages that LCM would split (over 64 KB) are ignored. 66 KB of state, caller-allocated, no heap, one thread; one system call per message.
/// Source: LCM's wire protocol, "LC02", sequence u32, channel, zero, message; linux/filter.h.
#ifndef IPE_INBOX_H
#define IPE_INBOX_H

#include "command.h"

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

typedef struct {
    int fd;  ///< for epoll; -1: off
    char tracker[IPE_INBOX_NAME_MAX], command[IPE_INBOX_NAME_MAX];
    uint8_t datagram[IPE_INBOX_BYTES];

    uint64_t n_positions;          ///< handed on
    uint64_t n_positions_invalid;  ///< flagged as not to be used
    uint64_t n_positions_bad;      ///< not a tracker_t, or its time out of range
    uint64_t n_commands;           ///< handed on
    uint64_t n_commands_bad;       ///< not a command_t
} ipe_inbox_t;

/// Join the group of an LCM URL, udpm://[ADDRESS[:PORT]][?...]. Any other URL, "none" too, leaves the inbox off: fd -1.
///
///   tracker, command  in   names of the channels, at most 63 characters
///   message           out  one line on failure; size bytes, always terminated
///
/// 0 or -1.
int ipe_inbox_open(ipe_inbox_t* b, const char* url, const char* tracker, const char* command, char* message,
                   size_t size);

/// The next message. EMPTY: none there. What cannot be used is counted and skipped.
ipe_inbox_kind_t ipe_inbox_next(ipe_inbox_t* b, ipe_inbox_item_t* item);

void ipe_inbox_close(ipe_inbox_t* b);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_inbox_counter(const ipe_inbox_t* b, unsigned index, uint64_t* value);

#endif
