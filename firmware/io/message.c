// SPDX-License-Identifier: Apache-2.0
#include "message.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { LINE_MAX_BYTES = 512 };

static size_t clamp(int n, size_t room)
{
    if (n < 0) { return 0; }
    return (size_t)n < room ? (size_t)n : room - 1;
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
