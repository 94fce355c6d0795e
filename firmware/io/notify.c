// SPDX-License-Identifier: Apache-2.0
#include "notify.h"

#include <errno.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { TEXT_MAX = 512 };

/// Microseconds if the watchdog is meant for this process, 0 otherwise.
static int64_t watchdog_us(void)
{
    const char *period = getenv("WATCHDOG_USEC"), *pid = getenv("WATCHDOG_PID");
    if (period == NULL || (pid != NULL && strtol(pid, NULL, 10) != getpid())) { return 0; }
    const long long us = strtoll(period, NULL, 10);
    return us > 0 && us <= INT64_MAX / 1000 ? us : 0;
}

int ipe_notify_open(ipe_notify_t* n)
{
    const char* path = getenv("NOTIFY_SOCKET");
    memset(n, 0, sizeof *n);
    n->fd = -1;
    if (path == NULL) { return 0; }
    const size_t length = strlen(path);
    if ((path[0] != '/' && path[0] != '@') || length < 2 || length >= sizeof n->address.sun_path) {
        errno = EINVAL;
        return -1;
    }
    n->address.sun_family = AF_UNIX;
    memcpy(n->address.sun_path, path, length);
    if (path[0] == '@') { n->address.sun_path[0] = '\0'; }  // in the abstract namespace
    n->address_length = (unsigned)(offsetof(struct sockaddr_un, sun_path) + length);
    n->fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (n->fd < 0) { return -1; }
    n->watchdog_ns = 1000 * watchdog_us();
    return 0;
}

void ipe_notify_send(ipe_notify_t* n, const char* format, ...)
{
    char text[TEXT_MAX];
    if (n->fd < 0) { return; }
    va_list arguments;
    va_start(arguments, format);
    const int wanted = vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    const size_t length = wanted < 0 ? 0 : wanted < TEXT_MAX ? (size_t)wanted : TEXT_MAX - 1;
    const struct sockaddr* address = (const struct sockaddr*)&n->address;
    if (sendto(n->fd, text, length, MSG_NOSIGNAL, address, n->address_length) < 0) { n->n_failed++; }
}

void ipe_notify_close(ipe_notify_t* n)
{
    if (n->fd >= 0) { (void)close(n->fd); }
    n->fd = -1;
}
