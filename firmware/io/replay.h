// SPDX-License-Identifier: Apache-2.0
/// Up to 8 CAN logs and a tracker file, merged by their stamps and, if asked, paced as they were recorded.
///
/// in: source_file and source_tracker_file; out: one frame or position at a time. At equal stamps a lower bus comes
/// first and the tracker last, so the order depends on the files alone. All wait for an input that has nothing yet (a
/// pipe), but not for one that has ended. Instead of all, a simulator may drive the daemon: lock_step.h. No heap, one thread; one clock reading per item when paced, none otherwise.
#ifndef IPE_REPLAY_H
#define IPE_REPLAY_H

#include "types.h"
#include "lock_step.h"
#include "source_file.h"
#include "source_tracker_file.h"

typedef enum {
    IPE_REPLAY_FRAME = 0,     ///< item->frame
    IPE_REPLAY_POSITION = 1,  ///< item->position
    IPE_REPLAY_WAIT = 2,      ///< an input has nothing yet: ipe_replay_fill() when item->fd is readable
    IPE_REPLAY_EARLY = 3,     ///< the next item is due at item->due_ns
    IPE_REPLAY_END = 4,       ///< every input has ended
    IPE_REPLAY_COMMAND = 6,   ///< a simulator's: r->lock_step.command
    IPE_REPLAY_ANSWER = 5,    ///< a simulator waits for what was published
} ipe_replay_status_t;

typedef struct {
    const ipe_frame_t* frame;        ///< good until the next call
    const ipe_position_t* position;  ///< good until the next call
    int fd;
    int64_t due_ns;                  ///< CLOCK_MONOTONIC
} ipe_replay_item_t;

typedef struct {
    unsigned n_buses;
    ipe_source_file_t bus[IPE_BUSES_MAX];
    bool has_tracker;
    ipe_source_tracker_file_t tracker;
    bool is_lock_step;   ///< a simulator on stdin stands for all of them
    ipe_lock_step_t lock_step;
    double speed;        ///< log seconds per second, 0: as fast as possible
    bool is_started;
    int64_t log_0_ns;    ///< stamp of the first item
    int64_t clock_0_ns;  ///< CLOCK_MONOTONIC when it was handed out
} ipe_replay_t;

/// Get the next item.
ipe_replay_status_t ipe_replay_next(ipe_replay_t* r, ipe_replay_item_t* item);

/// Read once from the input that ipe_replay_next() waits for.
void ipe_replay_fill(ipe_replay_t* r);

/// Close every input.
void ipe_replay_close(ipe_replay_t* r);

#endif
