// SPDX-License-Identifier: Apache-2.0
#include "lines.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int reset(ipe_lines_t* l, int fd)
{
    l->fd = fd;
    l->is_at_end = false;
    l->is_skipping = false;
    l->error = 0;
    l->number = 0;
    l->begin = 0;
    l->end = 0;
    return fd < 0 ? -1 : 0;
}

static bool is_directory(int fd)
{
    struct stat info;
    return fstat(fd, &info) == 0 && S_ISDIR(info.st_mode);
}

/// Does not wait for the other end of a pipe. open() takes directories too, and only read() would say so.
static int open_file(const char* path)
{
    const int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0 || !is_directory(fd)) { return fd; }
    (void)close(fd);
    errno = EISDIR;
    return -1;
}

static int open_stdin(void)
{
    const int flags = fcntl(STDIN_FILENO, F_GETFL);
    if (flags < 0) { return -1; }
    if ((flags & O_ACCMODE) == O_WRONLY) {
        errno = EBADF;
        return -1;
    }
    if (!is_directory(STDIN_FILENO)) { return STDIN_FILENO; }
    errno = EISDIR;
    return -1;
}

int ipe_lines_open(ipe_lines_t* l, const char* path)
{
    return reset(l, strcmp(path, "-") == 0 ? open_stdin() : open_file(path));
}

/// Hand out n bytes of the buffer as a line and move past them and skip more.
static ipe_lines_status_t take(ipe_lines_t* l, size_t n, size_t skip, const char** text, size_t* length)
{
    *text = l->buffer + l->begin;
    *length = n > 0 && (*text)[n - 1] == '\r' ? n - 1 : n;
    l->begin += n + skip;
    l->number++;
    return IPE_LINES_OK;
}

/// No newline in the buffer: the rest of a long line, the last line, or a line still on its way.
static ipe_lines_status_t take_partial(ipe_lines_t* l, const char** text, size_t* length)
{
    const size_t n = l->end - l->begin;
    if (l->is_skipping) {
        l->begin = l->end;
        if (l->is_at_end) { return IPE_LINES_END; }
        return IPE_LINES_WAIT;
    }
    if (n > IPE_LINE_MAX) {
        l->is_skipping = true;
        (void)take(l, n, 0, text, length);
        *length = IPE_LINE_MAX;
        return IPE_LINES_LONG;
    }
    if (!l->is_at_end) { return IPE_LINES_WAIT; }
    if (n == 0) { return IPE_LINES_END; }
    (void)take(l, n, 0, text, length);
    return IPE_LINES_UNENDED;
}

/// Drop the tail of a long line. True if its end was in the buffer.
static bool finish_skipping(ipe_lines_t* l)
{
    const char* newline = memchr(l->buffer + l->begin, '\n', l->end - l->begin);
    if (newline == NULL) { return false; }
    l->begin = (size_t)(newline - l->buffer) + 1;
    l->is_skipping = false;
    return true;
}

ipe_lines_status_t ipe_lines_next(ipe_lines_t* l, const char** text, size_t* length)
{
    if (l->is_skipping && !finish_skipping(l)) { return take_partial(l, text, length); }
    const char* start = l->buffer + l->begin;
    const char* newline = memchr(start, '\n', l->end - l->begin);
    if (newline == NULL) { return take_partial(l, text, length); }
    const size_t n = (size_t)(newline - start);
    (void)take(l, n, 1, text, length);
    if (n <= IPE_LINE_MAX) { return IPE_LINES_OK; }
    *length = IPE_LINE_MAX;
    return IPE_LINES_LONG;
}

void ipe_lines_fill(ipe_lines_t* l)
{
    if (l->is_at_end) { return; }
    memmove(l->buffer, l->buffer + l->begin, l->end - l->begin);
    l->end -= l->begin;
    l->begin = 0;
    const ssize_t n = read(l->fd, l->buffer + l->end, sizeof l->buffer - l->end);
    if (n > 0) {
        l->end += (size_t)n;
    } else if (n == 0 || (errno != EINTR && errno != EAGAIN)) {
        l->is_at_end = true;
        l->error = n < 0 ? errno : 0;
    }
}

void ipe_lines_close(ipe_lines_t* l)
{
    if (l->fd > STDIN_FILENO) { (void)close(l->fd); }
    l->fd = -1;
}
