// SPDX-License-Identifier: Apache-2.0
/// What any reader of a CAN socket pays at the least: frames are received as inertiad does and thrown away.
///
///   drain vcan0 SECONDS     batches of up to 64, SECONDS of gathering before each; says how many on stderr after SIGINT
///
/// The socket has the daemon's options; stamps, which the kernel takes for each frame all the same, are not asked back.
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
    struct iovec iov[IPE_SOCKETCAN_BATCH];
    struct mmsghdr message[IPE_SOCKETCAN_BATCH] = {0};
    uint64_t n_frames = 0;
    for (int i = 0; i < IPE_SOCKETCAN_BATCH; ++i) {
        iov[i] = (struct iovec){&source.wire[i], sizeof source.wire[i]};
        message[i].msg_hdr.msg_iov = &iov[i];
        message[i].msg_hdr.msg_iovlen = 1;
    }
    (void)sigaction(SIGINT, &action, NULL);
    (void)fcntl(source.fd, F_SETFL, 0);  // a batch is waited for
    while (!is_over) {
        const int n = recvmmsg(source.fd, message, IPE_SOCKETCAN_BATCH, MSG_WAITFORONE, NULL);
        n_frames += n > 0 ? (uint64_t)n : 0;
        if (n < IPE_SOCKETCAN_BATCH) { (void)nanosleep(&pause, NULL); }
    }
    (void)fprintf(stderr, "%" PRIu64 "\n", n_frames);
    return 0;
}
