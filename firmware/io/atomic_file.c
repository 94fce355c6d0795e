// SPDX-License-Identifier: Apache-2.0
#include "atomic_file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { PATIENCE_MS = 2000, PAUSE_MS = 20 };

static int fail(const char* path, const char* what, char* message, size_t size)
{
    (void)snprintf(message, size, "%s: %s: %s", path, what, strerror(errno));
    return -1;
}

static bool wait_for_reader(int fd)
{
    struct pollfd pipe = {.fd = fd, .events = POLLOUT};
    if (poll(&pipe, 1, PATIENCE_MS) > 0) { return true; }
    errno = ETIMEDOUT;
    return false;
}

static bool write_all(int fd, const uint8_t* bytes, size_t n)
{
    while (n > 0) {
        const ssize_t written = write(fd, bytes, n);
        if (written < 0 && errno == EAGAIN && wait_for_reader(fd)) { continue; }
        if (written < 0 && errno != EINTR) { return false; }
        if (written > 0) {
            bytes += written;
            n -= (size_t)written;
        }
    }
    return true;
}

static bool is_directory(const char* path)
{
    struct stat info;
    errno = EISDIR;
    return stat(path, &info) == 0 && S_ISDIR(info.st_mode);
}

static bool is_written_directly(const char* path)
{
    struct stat info;
    return stat(path, &info) == 0 && !S_ISREG(info.st_mode);
}

/// Where the text goes before it is moved to path; false if the name is too long.
static bool name_temporary(char name[PATH_MAX], const char* path)
{
    const int n = snprintf(name, PATH_MAX, "%s.tmp", path);
    errno = ENAMETOOLONG;
    return n > 0 && n < PATH_MAX;
}

static int create(const char* name)
{
    return open(name, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
}

bool ipe_atomic_file_check(const char* path, char* message, size_t size)
{
    char name[PATH_MAX];
    if (is_directory(path)) { return fail(path, "cannot write", message, size) == 0; }
    if (is_written_directly(path)) { return access(path, W_OK) == 0 || fail(path, "cannot write", message, size) == 0; }
    const int fd = name_temporary(name, path) ? create(name) : -1;
    if (fd < 0) { return fail(path, "cannot write", message, size) == 0; }
    (void)close(fd);
    (void)unlink(name);
    return true;
}

void ipe_atomic_file_sync_name(const char* path)
{
    char name[PATH_MAX];
    (void)snprintf(name, sizeof name, "%s", path);
    char* slash = strrchr(name, '/');
    if (slash != NULL) { slash[1] = '\0'; }
    const int fd = open(slash != NULL ? name : ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) { return; }
    (void)fsync(fd);
    (void)close(fd);
}

/// A pipe's reader may come a little later than its writer.
static int open_directly(const char* path)
{
    const struct timespec pause = {.tv_nsec = PAUSE_MS * 1000000L};
    for (int waited_ms = 0;; waited_ms += PAUSE_MS) {
        const int fd = open(path, O_WRONLY | O_CLOEXEC | O_NONBLOCK);
        if (fd >= 0 || errno != ENXIO || waited_ms >= PATIENCE_MS) { return fd; }
        (void)nanosleep(&pause, NULL);
    }
}

static int write_directly(const char* path, const void* bytes, size_t n, char* message, size_t size)
{
    const int fd = open_directly(path);
    if (fd < 0) { return fail(path, errno == ENXIO ? "nobody reads this pipe" : "cannot open", message, size); }
    const bool good = write_all(fd, bytes, n);
    if (!good) { (void)fail(path, "cannot write", message, size); }
    (void)close(fd);
    return good ? 0 : -1;
}

static int write_atomically(const char* path, const void* bytes, size_t n, char* message, size_t size)
{
    char name[PATH_MAX];
    const int fd = name_temporary(name, path) ? create(name) : -1;
    if (fd < 0) { return fail(path, "cannot write", message, size); }
    const bool good = write_all(fd, bytes, n) && fsync(fd) == 0;
    if (!good) { (void)fail(name, "cannot write", message, size); }
    (void)close(fd);
    if (good && rename(name, path) != 0) { return fail(path, "cannot replace", message, size); }
    if (!good) { (void)unlink(name); }
    ipe_atomic_file_sync_name(path);
    return good ? 0 : -1;
}

int ipe_atomic_file_write(const char* path, const void* bytes, size_t n, char* message, size_t size)
{
    return is_written_directly(path) ? write_directly(path, bytes, n, message, size)
                                     : write_atomically(path, bytes, n, message, size);
}
