// SPDX-License-Identifier: Apache-2.0
/// Text lines from a file, a pipe or stdin, without copying and without blocking.
///
/// One read() per IPE_LINES_BYTES, or per call of ipe_lines_fill() on a pipe. 64 KB of state, caller-allocated, no heap.
/// One thread.
#ifndef IPE_LINES_H
#define IPE_LINES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { IPE_LINES_BYTES = 65536, IPE_LINE_MAX = 4096 };

/// Result of a call: a line, nothing yet, or the end.
typedef enum {
    IPE_LINES_OK = 0,
    IPE_LINES_WAIT = 1,     ///< no whole line in the buffer: ipe_lines_fill() when the descriptor is readable
    IPE_LINES_END = 2,      ///< no more lines, ever
    IPE_LINES_LONG = 3,     ///< a line longer than IPE_LINE_MAX was skipped; text is its beginning
    IPE_LINES_UNENDED = 4,  ///< the last line, and it had no newline: possibly cut
} ipe_lines_status_t;

typedef struct {
    int fd;             ///< for epoll; -1: closed
    bool is_at_end;     ///< read() has returned 0 or an error
    bool is_skipping;   ///< inside a line that is too long
    int error;          ///< errno of the read() that ended it, 0: none
    uint64_t number;    ///< lines read
    size_t begin, end;  ///< unread bytes: buffer[begin .. end)
    char buffer[IPE_LINES_BYTES];
} ipe_lines_t;

/// Open a file, or stdin for "-". Does not wait for the other end of a pipe. 0, or -1 with errno set.
int ipe_lines_open(ipe_lines_t* l, const char* path);

/// The next line, without its \n or \r\n.
///
///   text    out  view into the buffer, good until the next ipe_lines_fill(); not terminated
///   length  out  bytes
ipe_lines_status_t ipe_lines_next(ipe_lines_t* l, const char** text, size_t* length);

/// Read once. Call only after IPE_LINES_WAIT, and when poll() says that fd is readable: a pipe that nobody has opened for
/// writing yet looks ended, and stdin, when it is an empty pipe, blocks.
void ipe_lines_fill(ipe_lines_t* l);

/// Close the descriptor, unless it is stdin.
void ipe_lines_close(ipe_lines_t* l);

#endif
