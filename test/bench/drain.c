// SPDX-License-Identifier: Apache-2.0
/// What any reader of a CAN socket pays at the least: frames are received as inertiad does and thrown away.
///
///   drain vcan0 SECONDS     batches of up to 64, SECONDS of gathering before each; says how many on stderr after SIGINT
///
/// The socket has the daemon's options, so the kernel does the same for each frame.
#ifndef _GNU_SOURCE
#define _GNU_SOURCE  // recvmmsg()
#endif
#include "source_socketcan.h"

#include <fcntl.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static volatile sig_atomic_t is_over;

static void end(int number)
{
    (void)number;
    is_over = 1;
}

/// Frames of a batch; waits for the first of them, or for a signal.
static int receive(ipe_source_socketcan_t* s)
{
    struct iovec iov[IPE_SOCKETCAN_BATCH];
    struct mmsghdr message[IPE_SOCKETCAN_BATCH] = {0};
    for (int i = 0; i < IPE_SOCKETCAN_BATCH; ++i) {
        iov[i] = (struct iovec){.iov_base = &s->wire[i], .iov_len = sizeof s->wire[i]};
        message[i].msg_hdr = (struct msghdr){.msg_iov = &iov[i],
                                             .msg_iovlen = 1,
                                             .msg_control = s->control[i].bytes,
                                             .msg_controllen = sizeof s->control[i].bytes};
    }
    const int n = recvmmsg(s->fd, message, IPE_SOCKETCAN_BATCH, MSG_WAITFORONE, NULL);
    return n > 0 ? n : 0;
}

int main(int argc, char** argv)
{
    static ipe_source_socketcan_t source;
    char reason[256];
    if (argc != 3) {
        (void)fputs("usage: drain INTERFACE SECONDS\n", stderr);
        return 2;
    }
    if (ipe_source_socketcan_open(&source, argv[1], 0, NULL, reason, sizeof reason) != 0) {
        (void)fprintf(stderr, "drain: %s\n", reason);
        return 2;
    }
    const struct timespec pause = {.tv_nsec = (long)(1e9 * atof(argv[2]))};
    const struct sigaction action = {.sa_handler = end};
    uint64_t n_frames = 0;
    (void)sigaction(SIGINT, &action, NULL);
    (void)fcntl(source.fd, F_SETFL, 0);  // a batch is waited for
    while (!is_over) {
        const int n = receive(&source);
        n_frames += (uint64_t)n;
        if (n < IPE_SOCKETCAN_BATCH) { (void)nanosleep(&pause, NULL); }
    }
    (void)fprintf(stderr, "%" PRIu64 "\n", n_frames);
    return 0;
}
