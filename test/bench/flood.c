// SPDX-License-Identifier: Apache-2.0
/// The sensors of a recorded run at any rate, onto a bus or as a log:
///
///   flood can.log vcan0 RATE SECONDS   sends RATE frames/s, prints how many frames and in how many seconds
///   flood can.log - RATE SECONDS       writes a candump log whose stamps advance at RATE frames/s, as fast as it is read
///
/// The run holds one frame of each sensor in turn, at its own rate. The motion goes at the run's pace whatever RATE is:
/// values of a sensor are sent again until the run has new ones. As the run's sensors do, each frame carries its
/// identifier's own counter in its first two bytes and its time in us in the next four: both go on where the run begins
/// anew.
#ifndef _GNU_SOURCE
#define _GNU_SOURCE  // sendmmsg()
#endif
#include "candump.h"

#include <errno.h>
#include <inttypes.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

enum { BATCH = 64, TICK_NS = 100000, IDS = 2048 };

static struct canfd_frame* run;
static size_t n_run;
static size_t n_sensors;  // frames of the run with one sample of each
static double period_us;  // of the run's samples
static uint16_t count[IDS];

static void fail(const char* what)
{
    (void)fprintf(stderr, "flood: %s: %s\n", what, strerror(errno));
    exit(2);
}

/// The run's order and pace, from its frames and the time between its first and last.
static void find_pattern(const char* path, int64_t span_ns)
{
    n_sensors = 1;
    while (n_sensors < n_run && run[n_sensors].can_id != run[0].can_id) { ++n_sensors; }
    n_run -= n_run % n_sensors;
    for (size_t i = n_sensors; i < n_run; ++i) {
        if (run[i].can_id != run[i - n_sensors].can_id) {
            errno = EINVAL;
            fail(path);
        }
    }
    period_us = 1e-3 * (double)span_ns * (double)n_sensors / (double)n_run;
}

static void load(const char* path)
{
    FILE* file = fopen(path, "r");
    int64_t first_ns = 0, last_ns = 0;
    char* line = NULL;
    size_t size = 0;
    ssize_t length;
    if (file == NULL) { fail(path); }
    while ((length = getline(&line, &size, file)) > 0) {
        ipe_frame_t frame;
        ipe_candump_name_t name;
        uint64_t n_dropped;
        const size_t n = (size_t)length - (line[length - 1] == '\n' ? 1 : 0);
        if (ipe_candump_parse(line, n, &frame, &name, &n_dropped) != IPE_CANDUMP_FRAME) { continue; }
        first_ns = n_run == 0 ? frame.t_ns : first_ns;
        last_ns = frame.t_ns;
        run = realloc(run, (n_run + 1) * sizeof *run);
        if (run == NULL) { fail(path); }
        run[n_run] = (struct canfd_frame){.can_id = frame.can_id % IDS, .len = frame.length, .flags = CANFD_BRS};
        memcpy(run[n_run++].data, frame.data, frame.length);
    }
    if (n_run == 0) { fail(path); }
    find_pattern(path, last_ns - first_ns);
    free(line);
    (void)fclose(file);
}

/// Frame k of the load, t_us after its begin.
static struct canfd_frame frame_at(uint64_t k, uint64_t t_us)
{
    const size_t row = (size_t)((double)t_us / period_us) % (n_run / n_sensors);
    struct canfd_frame frame = run[row * n_sensors + k % n_sensors];
    const uint16_t n = count[frame.can_id]++;
    const uint32_t time = (uint32_t)t_us;
    memcpy(frame.data, &n, sizeof n);
    memcpy(frame.data + sizeof n, &time, sizeof time);
    return frame;
}

static uint64_t due_us(uint64_t k, double rate)
{
    return (uint64_t)(1e6 * (double)k / rate);
}

static void write_log(double rate, uint64_t n)
{
    static const char DIGIT[] = "0123456789ABCDEF";
    for (uint64_t k = 0; k < n; ++k) {
        const uint64_t t_us = due_us(k, rate);
        const struct canfd_frame frame = frame_at(k, t_us);
        char text[2 * CANFD_MAX_DLEN + 1];
        for (int i = 0; i < frame.len; ++i) {
            text[2 * i] = DIGIT[frame.data[i] >> 4];
            text[2 * i + 1] = DIGIT[frame.data[i] & 15];
        }
        text[2 * frame.len] = '\0';
        if (printf("(%010" PRIu64 ".%06" PRIu64 ") can0 %03X##1%s\n", 1 + t_us / 1000000, t_us % 1000000, frame.can_id,
                   text) < 0) {
            fail("stdout");
        }
    }
}

static int open_bus(const char* interface)
{
    const int on = 1;
    const struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(interface)};
    const int fd = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (fd < 0 || setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on) != 0 ||
        setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FILTER, NULL, 0) != 0 ||
        bind(fd, (const struct sockaddr*)&address, sizeof address) != 0) {
        fail(interface);
    }
    return fd;
}

static void send_all(int fd, uint64_t k, uint64_t end, double rate)
{
    while (k < end) {
        struct canfd_frame frame[BATCH];
        struct iovec iov[BATCH];
        struct mmsghdr message[BATCH] = {0};
        unsigned n = 0;
        for (; n < BATCH && k < end; ++n, ++k) {
            frame[n] = frame_at(k, due_us(k, rate));
            iov[n] = (struct iovec){&frame[n], sizeof frame[n]};
            message[n].msg_hdr = (struct msghdr){.msg_iov = &iov[n], .msg_iovlen = 1};
        }
        for (unsigned done = 0; done < n;) {
            const int sent = sendmmsg(fd, message + done, n - done, 0);
            if (sent < 0 && errno != ENOBUFS && errno != EINTR) { fail("send"); }
            done += sent > 0 ? (unsigned)sent : 0;
        }
    }
}

static double seconds_since(struct timespec begin)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)(now.tv_sec - begin.tv_sec) + 1e-9 * (double)(now.tv_nsec - begin.tv_nsec);
}

static void send_paced(int fd, double rate, uint64_t n)
{
    const struct timespec tick = {.tv_nsec = TICK_NS};
    struct timespec begin;
    (void)clock_gettime(CLOCK_MONOTONIC, &begin);
    for (uint64_t k = 0; k < n;) {
        const uint64_t due = 1 + (uint64_t)(rate * seconds_since(begin));
        const uint64_t end = due < n ? due : n;
        send_all(fd, k, end, rate);
        if (end < n) { (void)nanosleep(&tick, NULL); }
        k = end;
    }
    (void)printf("%" PRIu64 " frames in %.6f s\n", n, seconds_since(begin));
}

int main(int argc, char** argv)
{
    if (argc != 5) {
        (void)fputs("usage: flood can.log INTERFACE|- RATE SECONDS\n", stderr);
        return 2;
    }
    const double rate = atof(argv[3]);
    const uint64_t n = (uint64_t)(rate * atof(argv[4]));
    load(argv[1]);
    if (strcmp(argv[2], "-") == 0) {
        write_log(rate, n);
    } else {
        send_paced(open_bus(argv[2]), rate, n);
    }
    return 0;
}
