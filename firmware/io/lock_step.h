// SPDX-License-Identifier: Apache-2.0
/// A simulator drives the daemon step by step through stdin and stdout: as fast as both go, with the same result each time.
///
/// in: lines, used in the order they come:
///   (1.000123) can0 123#0011           a frame on bus 0, as candump writes it (candump.h); can1: bus 1
///   position 1000123000 0.1 0.2 2.0    a position of the tracked point: host time, ns; W, m
///   command 0f1e..                     a command_t, encoded, in hexadecimal digits of either case; its stamp is data time;
///                                      at most 1024 bytes, which all have but CONFIGURE
///   answer                             write what was published since the last answer
/// out: an LCM log (record.h) of ESTIMATE and EVENT; each answer ends with a message without data on
/// PREFIX + "ANSWER". A line that is none of these is counted by cause and reported; so is a position of more than 200
/// characters, or whose time is no host time, and a command that is too long.
/// Ask often: a daemon whose answers nobody reads waits once the pipe is full, after some 0.4 s of data.
/// 130 KB of state, caller-allocated, no heap after open, one thread.
#ifndef IPE_LOCK_STEP_H
#define IPE_LOCK_STEP_H

#include "command.h"
#include "lines.h"
#include "message.h"
#include "source.h"
#include "source_tracker_file.h"
#include "types.h"

#include <stddef.h>

enum {
    IPE_LOCK_STEP_OUT = 65536,
    IPE_LOCK_STEP_MESSAGE = 1024,  ///< bytes of a command at most
};

typedef enum {
    IPE_LOCK_STEP_FRAME = 0,
    IPE_LOCK_STEP_POSITION,
    IPE_LOCK_STEP_COMMAND,
    IPE_LOCK_STEP_ANSWER,
    IPE_LOCK_STEP_WAIT,  ///< nothing until stdin is readable: ipe_lock_step_fill()
    IPE_LOCK_STEP_END,
} ipe_lock_step_item_t;

typedef struct {
    ipe_lines_t lines;
    ipe_frame_t frame;        ///< the newest
    ipe_position_t position;  ///< the newest
    ipe_command_t command;    ///< the newest, a view of message
    size_t n_message;
    uint8_t message[IPE_LOCK_STEP_MESSAGE];
    ipe_message_limit_t limit;
    uint64_t n_frames;         ///< lines that are a frame
    uint64_t n_positions;      ///< lines that are a position
    uint64_t n_commands;       ///< lines that are a command
    uint64_t n_answers;        ///< lines that ask for an answer
    uint64_t n_too_long;       ///< lines refused: too long, or a position or command that is
    uint64_t n_cut;            ///< last line refused: it has no end
    uint64_t n_bad_frames;     ///< lines refused: neither a frame of can0 to can7 nor anything else
    uint64_t n_bad_positions;  ///< lines refused: a position that cannot be read
    uint64_t n_bad_commands;   ///< lines refused: a command that cannot be read
    uint64_t n_bad_times;      ///< lines refused: a position whose time is no host time
    uint64_t n_messages;       ///< written
    bool is_broken;            ///< nobody reads stdout any more, or stdin could not be read or had no line of use
    size_t n_out;
    uint8_t out[IPE_LOCK_STEP_OUT];
} ipe_lock_step_t;

/// Begin to read stdin. 0, or -1 with errno set.
int ipe_lock_step_open(ipe_lock_step_t* l);

/// The next item, in l->frame, l->position or l->command.
ipe_lock_step_item_t ipe_lock_step_next(ipe_lock_step_t* l);

/// Read once from stdin; blocks only when that is an empty pipe.
void ipe_lock_step_fill(ipe_lock_step_t* l);

/// Put a message of n bytes, of data time t_ns, into the answer.
void ipe_lock_step_put(ipe_lock_step_t* l, const char* channel, int64_t t_ns, const uint8_t* data, size_t n);

/// Write everything that was put. False: nobody reads it.
bool ipe_lock_step_send(ipe_lock_step_t* l);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_lock_step_counter(const ipe_lock_step_t* l, unsigned index, uint64_t* value);

#endif
