// SPDX-License-Identifier: Apache-2.0
/// CAN frames from a candump log: a file, a pipe or stdin.
///
/// in: text lines (candump.h), out: one frame at a time, in the order of the file. A line that is no frame never stops
/// the reading: it is counted by cause, and the first few are reported with file and line number.
/// A frame whose stamp is over 1 s off while the next one is back is left out and counted: its stamp is wrong and would
/// delay every source that is merged with it.
/// All interfaces of a log become the one bus it was opened as, or only one of them with a filter.
/// 64 KB of state, caller-allocated, no heap, one thread. 10 million frames/s on a desktop machine.
#ifndef IPE_SOURCE_FILE_H
#define IPE_SOURCE_FILE_H

#include "types.h"
#include "bus_counts.h"
#include "candump.h"
#include "lines.h"
#include "lookahead.h"
#include "message.h"

typedef struct {
    const char* path;
    const char* interface;  ///< only this one's frames, NULL: all
    uint8_t bus;
    ipe_lookahead_t lookahead;
    ipe_frame_t head;   ///< the next frame, when peeked
    ipe_frame_t ahead;  ///< the one after it, read only when head's stamp is far off
    ipe_lines_t lines;
    ipe_message_limit_t limit;

    ipe_bus_counts_t counts;               ///< n_dropped: from DROPCOUNT lines
    uint64_t n_result[IPE_CANDUMP_COUNT];  ///< lines
    uint64_t n_other_interface;            ///< frames of interfaces that the filter keeps out
    uint64_t n_too_long;                   ///< lines skipped, longer than IPE_LINE_MAX
    uint64_t n_cut;                        ///< last lines without line end that are no frame
} ipe_source_file_t;

/// Open a log, "-" for stdin. Strings are kept by pointer.
///
///   interface  in  take only the frames of this interface, NULL: of all
///
/// 0, or -1 with errno set.
int ipe_source_file_open(ipe_source_file_t* s, const char* path, uint8_t bus, const char* interface);

/// Look at the next frame, s->head, without taking it. READY, WAIT (call ipe_source_file_fill() when readable), END.
ipe_source_status_t ipe_source_file_peek(ipe_source_file_t* s);

/// Take the frame that peek() showed.
void ipe_source_file_take(ipe_source_file_t* s);

/// Read once from the descriptor s->lines.fd; blocks only when that is an empty pipe.
void ipe_source_file_fill(ipe_source_file_t* s);

void ipe_source_file_close(ipe_source_file_t* s);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_source_file_counter(const ipe_source_file_t* s, unsigned index, uint64_t* value);

#endif
