// SPDX-License-Identifier: Apache-2.0
/// Refuses commands that are not new, so that a log played again, or a datagram sent twice, changes nothing.
///
/// A command is new if its stamp is within IPE_COMMAND_AGE_MAX of this host's clock, it was sent after the daemon began
/// to listen, and its pair of sender and sequence was not accepted within that time. What was accepted before a restart
/// is not known, so a command from before it may be a repeated one.
/// 12 KB, caller-allocated, no heap, one thread; a pass over the table per command.
#ifndef IPE_COMMAND_GUARD_H
#define IPE_COMMAND_GUARD_H

#include "command.h"

#define IPE_COMMAND_AGE_MAX INT64_C(10000000000)  ///< ns

enum { IPE_COMMANDS_KEPT = 512 };

typedef enum {
    IPE_COMMAND_NEW = 0,
    IPE_COMMAND_OLD,       ///< stamped too long ago
    IPE_COMMAND_EARLY,     ///< stamped before the daemon began to listen
    IPE_COMMAND_AHEAD,     ///< stamped too far in the future
    IPE_COMMAND_REPEATED,  ///< accepted before
    IPE_COMMAND_TOO_MANY,  ///< IPE_COMMANDS_KEPT were accepted within the last seconds
} ipe_command_novelty_t;

typedef struct {
    struct {
        int64_t t_ns, sender, sequence;
    } accepted[IPE_COMMANDS_KEPT];
    unsigned n;
} ipe_command_guard_t;

/// Judge a command; one that is NEW is kept as accepted.
///
///   now_ns       CLOCK_REALTIME when it is received
///   listened_ns  for how long commands have been received, by a clock that is never set: a step of CLOCK_REALTIME
///                makes no later command an early one
ipe_command_novelty_t ipe_command_guard_check(ipe_command_guard_t* g, const ipe_command_t* command, int64_t now_ns,
                                              int64_t listened_ns);

#endif
