// SPDX-License-Identifier: Apache-2.0
#include "message.h"

#include <poll.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { LINE_MAX_BYTES = 512, PATIENCE_MS = 1000 };

static size_t clamp(int n, size_t room)
{
    if (n < 0) { return 0; }
    return (size_t)n < room ? (size_t)n : room - 1;
}

/// False where stderr is a pipe that nobody reads any more: the first such message waits a second for the reader, the rest do
/// not, until it reads again.
static bool can_write(void)
{
    static atomic_bool is_stuck;
    struct pollfd out = {.fd = STDERR_FILENO, .events = POLLOUT};
    const bool is_ready = poll(&out, 1, atomic_load(&is_stuck) ? 0 : PATIENCE_MS) != 0;
    atomic_store(&is_stuck, !is_ready);
    return is_ready;
}

void ipe_message(const char* format, ...)
{
    char line[LINE_MAX_BYTES] = "inertiad: ";
    const size_t start = strlen(line);
    const size_t room = sizeof line - start - 1;
    va_list arguments;
    va_start(arguments, format);
    const size_t n = start + clamp(vsnprintf(line + start, room, format, arguments), room);
    va_end(arguments);
    for (size_t i = start; i < n; ++i) {
        if ((unsigned char)line[i] < ' ' || line[i] == 0x7F) { line[i] = '?'; }
    }
    line[n] = '\n';
    if (!can_write()) { return; }
    const ssize_t written = write(STDERR_FILENO, line, n + 1);
    (void)written;  // nowhere left to complain
}

bool ipe_message_allowed(ipe_message_limit_t* limit, const char* what)
{
    if (limit->n > IPE_MESSAGES_EACH) { return false; }
    limit->n++;
    if (limit->n <= IPE_MESSAGES_EACH) { return true; }
    ipe_message("%s: more like these are only counted", what);
    return false;
}
