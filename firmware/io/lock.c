// SPDX-License-Identifier: Apache-2.0
#include "lock.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

static int fail(int fd, const char* path, const char* reason, char* message, size_t size)
{
    (void)snprintf(message, size, "%s: %s", path, reason);
    if (fd >= 0) { (void)close(fd); }
    return -1;
}

int ipe_lock_descriptor(int fd)
{
    return flock(fd, LOCK_EX | LOCK_NB);
}

int ipe_lock_file(const char* path, char* message, size_t size)
{
    char name[PATH_MAX];
    const int n = snprintf(name, sizeof name, "%s.lock", path);
    if (n < 0 || n >= (int)sizeof name) { return fail(-1, path, strerror(ENAMETOOLONG), message, size); }
    const int fd = open(name, O_RDWR | O_CREAT | O_CLOEXEC | O_NONBLOCK, 0644);
    if (fd < 0) { return fail(fd, name, strerror(errno), message, size); }
    if (ipe_lock_descriptor(fd) == 0) { return fd; }
    const bool is_held = errno == EWOULDBLOCK;
    return fail(fd, path, is_held ? "another inertiad uses it; name another file" : strerror(errno), message, size);
}

int ipe_lock_channels(const struct sockaddr_in* group, const char* prefix, char* message, size_t size)
{
    char address[INET_ADDRSTRLEN] = "";
    (void)inet_ntop(AF_INET, &group->sin_addr, address, sizeof address);
    struct sockaddr_un name = {.sun_family = AF_UNIX};  // the name begins with a zero: abstract
    const int n = snprintf(name.sun_path + 1, sizeof name.sun_path - 1, "inertiad %s:%u %s", address,
                           ntohs(group->sin_port), prefix);
    if (n < 0 || n >= (int)sizeof name.sun_path - 1) { return fail(-1, prefix, strerror(ENAMETOOLONG), message, size); }
    const socklen_t length = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + 1 + (size_t)n);
    const int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (fd >= 0 && bind(fd, (const struct sockaddr*)&name, length) == 0) { return fd; }
    const bool is_held = errno == EADDRINUSE;
    return fail(fd, prefix,
                is_held ? "another inertiad publishes with this prefix; choose another, or --lcm none"
                        : strerror(errno),
                message, size);
}
