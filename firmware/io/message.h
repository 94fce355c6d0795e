// SPDX-License-Identifier: Apache-2.0
/// One-line messages to stderr: "inertiad: ...". No heap, one write() per line, safe from any thread. A line for which a pipe
/// has no room within 1 s is lost.
#ifndef IPE_MESSAGE_H
#define IPE_MESSAGE_H

#include <stdbool.h>
#include <stdint.h>

/// Passes the first few messages of a kind; the rest are only counted.
typedef struct {
    uint32_t n;  ///< messages asked for so far
} ipe_message_limit_t;

enum { IPE_MESSAGES_EACH = 5 };

/// Write "inertiad: " and the formatted text as one line, cut at 510 bytes. Control characters become '?'.
void ipe_message(const char* format, ...) __attribute__((format(printf, 1, 2)));

/// True for the first IPE_MESSAGES_EACH calls; the one after them says, once, that more are only counted.
///
///   what  in  where they come from, "can.log"
bool ipe_message_allowed(ipe_message_limit_t* limit, const char* what);

#endif
