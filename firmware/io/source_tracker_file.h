// SPDX-License-Identifier: Apache-2.0
/// Positions of a laser tracker or a motion capture system from a CSV file.
///
/// in: a header with the columns t [s], x, y, z [m, world frame] in any order, among others that are ignored; then rows.
/// out: one position at a time, in the order of the file. t counts from the same instant as the stamps of the CAN log.
/// A row whose time is over 1 s off while the next one is back is left out and counted.
/// A row that cannot be read never stops the reading: it is counted, and the first few are reported with line number.
/// 64 KB of state, caller-allocated, no heap, one thread.
#ifndef IPE_SOURCE_TRACKER_FILE_H
#define IPE_SOURCE_TRACKER_FILE_H

#include "lines.h"
#include "lookahead.h"
#include "message.h"

typedef struct {
    int64_t t_ns;        ///< host time, ns
    double position[3];  ///< of the tracked point, W, m; as read, may be NaN
} ipe_position_t;

enum { IPE_TRACKER_COLUMNS = 4 };

typedef struct {
    const char* path;
    int column[IPE_TRACKER_COLUMNS];  ///< index of t, x, y, z in the file
    ipe_lookahead_t lookahead;
    ipe_position_t head;              ///< the next position, when peeked
    ipe_position_t ahead;             ///< the one after it, read only when head's time is far off
    ipe_lines_t lines;
    ipe_message_limit_t limit;

    uint64_t n_positions;  ///< positions handed on
    uint64_t n_bad_rows;   ///< rows refused: a needed cell missing or not a number, or the line too long or cut
} ipe_source_tracker_file_t;

/// Open a file ("-": stdin) and read its header; waits for it on a pipe, until stop_fd is readable. path is kept by pointer.
///
///   stop_fd  in   such as a signalfd; -1: none
///   message  out  one line on failure: cannot be opened, no header, a column missing or there twice, stopped
///
/// 0 or -1.
int ipe_source_tracker_file_open(ipe_source_tracker_file_t* s, const char* path, int stop_fd, char* message,
                                 size_t size);

/// Look at the next position, s->head, without taking it. READY, WAIT (call _fill() when readable), END.
ipe_source_status_t ipe_source_tracker_file_peek(ipe_source_tracker_file_t* s);

/// Take the position that peek() showed.
void ipe_source_tracker_file_take(ipe_source_tracker_file_t* s);

/// Read once from the descriptor s->lines.fd; blocks only when that is an empty pipe.
void ipe_source_tracker_file_fill(ipe_source_tracker_file_t* s);

void ipe_source_tracker_file_close(ipe_source_tracker_file_t* s);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_source_tracker_file_counter(const ipe_source_tracker_file_t* s, unsigned index, uint64_t* value);

#endif
