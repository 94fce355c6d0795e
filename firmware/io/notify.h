// SPDX-License-Identifier: Apache-2.0
/// Reports readiness, status and liveness to the service manager: systemd's notification protocol, sd_notify(3).
///
/// One datagram of lines KEY=value per message to the socket that $NOTIFY_SOCKET names; without it every call has no effect. Never waits:
/// a datagram that finds no room is lost. No heap, one thread, one system call per message.
/// Source: sd_notify(3), sd_watchdog_enabled(3).
#ifndef IPE_NOTIFY_H
#define IPE_NOTIFY_H

#include <stdint.h>
#include <sys/un.h>

typedef struct {
    int fd;  ///< -1: off
    struct sockaddr_un address;
    unsigned address_length;
    int64_t watchdog_ns;  ///< the service manager ends a daemon silent for so long; 0: never
    uint64_t n_failed;    ///< messages that did not go out
} ipe_notify_t;

/// Read $NOTIFY_SOCKET, $WATCHDOG_USEC and $WATCHDOG_PID. 0, or -1 with errno set: the socket cannot be used, off.
int ipe_notify_open(ipe_notify_t* n);

/// Send lines: "READY=1", "WATCHDOG=1\nSTATUS=...", cut at 511 bytes.
void ipe_notify_send(ipe_notify_t* n, const char* format, ...) __attribute__((format(printf, 2, 3)));

void ipe_notify_close(ipe_notify_t* n);

#endif
