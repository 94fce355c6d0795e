// SPDX-License-Identifier: Apache-2.0
#ifndef _GNU_SOURCE
#define _GNU_SOURCE  // recvmmsg()
#endif
#include "source_socketcan.h"

#include "message.h"

#include <errno.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/errqueue.h>
#include <linux/net_tstamp.h>
#include <linux/sock_diag.h>
#include <net/if.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

enum { WANTED_BUFFER = 8 * 1024 * 1024, BYTES_PER_FRAME = 768 };
static const int64_t NS_PER_S = 1000000000;

static int64_t to_ns(struct timespec t)
{
    return (int64_t)t.tv_sec * NS_PER_S + t.tv_nsec;
}

static int set_option(int fd, int level, int name, int value)
{
    return setsockopt(fd, level, name, &value, sizeof value);
}

static bool interface_is_up(const ipe_source_socketcan_t* s)
{
    struct ifreq request = {0};
    memcpy(request.ifr_name, s->interface, sizeof s->interface);
    return ioctl(s->fd, SIOCGIFFLAGS, &request) == 0 && (request.ifr_flags & IFF_UP) != 0;
}

/// The kernel accounts twice what is asked for.
static void enlarge_buffer(ipe_source_socketcan_t* s)
{
    if (set_option(s->fd, SOL_SOCKET, SO_RCVBUFFORCE, WANTED_BUFFER) != 0) {
        (void)set_option(s->fd, SOL_SOCKET, SO_RCVBUF, WANTED_BUFFER);
    }
    socklen_t n = sizeof s->receive_buffer;
    (void)getsockopt(s->fd, SOL_SOCKET, SO_RCVBUF, &s->receive_buffer, &n);
}

static int set_filters(const ipe_source_socketcan_t* s)
{
    static const struct can_filter ALL = {0};
    const struct can_filter* filter = s->n_filters > 0 ? s->filter : &ALL;
    const unsigned n = s->n_filters > 0 ? s->n_filters : 1;
    return setsockopt(s->fd, SOL_CAN_RAW, CAN_RAW_FILTER, filter, (socklen_t)(n * sizeof *filter));
}

static int configure(ipe_source_socketcan_t* s)
{
    const can_err_mask_t errors = CAN_ERR_MASK;
    const int stamps = SOF_TIMESTAMPING_RX_SOFTWARE | SOF_TIMESTAMPING_SOFTWARE | SOF_TIMESTAMPING_RX_HARDWARE |
                       SOF_TIMESTAMPING_RAW_HARDWARE;
    if (set_option(s->fd, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1) != 0) { return -1; }
    if (setsockopt(s->fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors) != 0) { return -1; }
    if (set_option(s->fd, SOL_SOCKET, SO_TIMESTAMPING, stamps) != 0) { return -1; }
    if (set_option(s->fd, SOL_SOCKET, SO_RXQ_OVFL, 1) != 0) { return -1; }
    return set_filters(s);
}

/// A new socket on the interface. 0, or -1 with errno set and no socket.
static int open_socket(ipe_source_socketcan_t* s)
{
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(s->interface)};
    if (address.can_ifindex == 0) { return -1; }
    s->fd = socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC | SOCK_NONBLOCK, CAN_RAW);
    if (s->fd < 0) { return -1; }
    s->last_drops = 0;
    enlarge_buffer(s);
    if (configure(s) != 0 || bind(s->fd, (const struct sockaddr*)&address, sizeof address) != 0) {
        const int cause = errno;
        ipe_source_socketcan_close(s);
        errno = cause;
        return -1;
    }
    s->is_up = interface_is_up(s);
    return 0;
}

static void add_filter(ipe_source_socketcan_t* s, uint32_t can_id)
{
    const bool is_extended = (can_id & CAN_EFF_FLAG) != 0;
    const struct can_filter filter = {
        .can_id = can_id,
        .can_mask = CAN_EFF_FLAG | CAN_RTR_FLAG | (is_extended ? CAN_EFF_MASK : CAN_SFF_MASK),
    };
    for (unsigned i = 0; i < s->n_filters; ++i) {
        if (s->filter[i].can_id == can_id) { return; }
    }
    s->filter[s->n_filters++] = filter;
}

static void make_filters(ipe_source_socketcan_t* s, const ipe_config_t* config)
{
    s->n_filters = 0;
    for (int i = 0; i < config->n_signals; ++i) {
        if (config->signal[i].bus == s->bus) { add_filter(s, config->signal[i].can_id); }
    }
}

static const char* reason_of(int cause)
{
    if (cause == EAFNOSUPPORT || cause == EPROTONOSUPPORT) {
        return "this kernel has no CAN sockets; modprobe can-raw";
    }
    return cause == ENODEV ? "no such interface; ip link lists what there is" : strerror(cause);
}

int ipe_source_socketcan_open(ipe_source_socketcan_t* s, const char* interface, uint8_t bus, const ipe_config_t* config,
                              char* message, size_t size)
{
    memset(s, 0, sizeof *s);
    s->fd = -1;
    s->bus = bus;
    if (strlen(interface) >= sizeof s->interface) {
        (void)snprintf(message, size, "%s: interface names have at most %zu characters", interface,
                       sizeof s->interface - 1);
        return -1;
    }
    (void)snprintf(s->interface, sizeof s->interface, "%s", interface);
    s->takes_all = config == NULL;
    if (!s->takes_all) { make_filters(s, config); }
    if (open_socket(s) != 0) {
        (void)snprintf(message, size, "%s: %s", interface, reason_of(errno));
        return -1;
    }
    if (s->receive_buffer < WANTED_BUFFER) {
        ipe_message("%s: receive buffer holds %d frames only; give CAP_NET_ADMIN or raise net.core.rmem_max to %d",
                    interface, ipe_source_socketcan_capacity(s), WANTED_BUFFER);
    }
    if (!s->is_up) { ipe_message("%s: interface is down, waiting for it; ip link set %s up", interface, interface); }
    return 0;
}

int ipe_source_socketcan_capacity(const ipe_source_socketcan_t* s)
{
    return s->receive_buffer / BYTES_PER_FRAME;
}

int ipe_source_socketcan_filter(ipe_source_socketcan_t* s, const ipe_config_t* config)
{
    if (s->takes_all) { return 0; }
    make_filters(s, config);
    return s->fd < 0 ? 0 : set_filters(s);
}

/// The interface is down (it keeps its socket) or gone (the socket is of no more use).
static void lose(ipe_source_socketcan_t* s, int cause)
{
    if (s->is_up) {
        s->n_down++;
        ipe_message("%s: %s; waiting for it", s->interface,
                    cause == ENETDOWN ? "interface went down" : strerror(cause));
    }
    s->is_up = false;
    if (cause != ENETDOWN) { ipe_source_socketcan_close(s); }
}

/// The count comes by two ways, and with a frame it is as old as the frame: only what is more than before is new.
static void note_drops(ipe_source_socketcan_t* s, uint32_t drops)
{
    const uint32_t more = drops - s->last_drops;
    if (more > INT32_MAX) { return; }
    s->counts.n_dropped += more;
    s->last_drops = drops;
}

static void read_control(ipe_source_socketcan_t* s, struct msghdr* header, ipe_frame_t* frame)
{
    for (struct cmsghdr* c = CMSG_FIRSTHDR(header); c != NULL; c = CMSG_NXTHDR(header, c)) {
        if (c->cmsg_level != SOL_SOCKET) { continue; }
        if (c->cmsg_type == SCM_TIMESTAMPING) {
            struct scm_timestamping stamp;
            memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
            frame->t_ns = to_ns(stamp.ts[0]);
            frame->t_hw_ns = to_ns(stamp.ts[2]);
        } else if (c->cmsg_type == SO_RXQ_OVFL) {
            uint32_t drops;
            memcpy(&drops, CMSG_DATA(c), sizeof drops);
            note_drops(s, drops);
        }
    }
}

static void stamp_on_reading(ipe_source_socketcan_t* s, ipe_frame_t* frame)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_REALTIME, &now);
    frame->t_ns = to_ns(now);
    s->n_unstamped++;
}

/// The flags of an FD frame; those of a classical one mean nothing.
static uint8_t frame_flags(const struct canfd_frame* wire, unsigned n_bytes)
{
    unsigned flags = n_bytes == CANFD_MTU ? IPE_FRAME_FD : 0;
    if (flags != 0 && (wire->flags & CANFD_BRS) != 0) { flags |= IPE_FRAME_BRS; }
    if (flags != 0 && (wire->flags & CANFD_ESI) != 0) { flags |= IPE_FRAME_ESI; }
    return (uint8_t)flags;
}

/// Turn a message into *frame. False for a frame that this socket sent.
static bool convert(ipe_source_socketcan_t* s, struct mmsghdr* message, const struct canfd_frame* wire,
                    ipe_frame_t* frame)
{
    memset(frame, 0, sizeof *frame);
    read_control(s, &message->msg_hdr, frame);
    if ((message->msg_hdr.msg_flags & MSG_CONFIRM) != 0) {
        s->n_own++;
        return false;
    }
    if (frame->t_ns == 0) { stamp_on_reading(s, frame); }
    frame->can_id = wire->can_id;
    frame->bus = s->bus;
    frame->flags = frame_flags(wire, message->msg_len);
    frame->length = wire->len < IPE_DATA_MAX ? wire->len : IPE_DATA_MAX;
    memcpy(frame->data, wire->data, frame->length);
    ipe_bus_count(&s->counts, frame);
    return true;
}

static int receive(ipe_source_socketcan_t* s, struct mmsghdr message[IPE_SOCKETCAN_BATCH])
{
    struct iovec iov[IPE_SOCKETCAN_BATCH];
    for (int i = 0; i < IPE_SOCKETCAN_BATCH; ++i) {
        iov[i] = (struct iovec){.iov_base = &s->wire[i], .iov_len = sizeof s->wire[i]};
        message[i].msg_hdr = (struct msghdr){.msg_iov = &iov[i],
                                             .msg_iovlen = 1,
                                             .msg_control = s->control[i].bytes,
                                             .msg_controllen = sizeof s->control[i].bytes};
    }
    const int n = recvmmsg(s->fd, message, IPE_SOCKETCAN_BATCH, MSG_DONTWAIT, NULL);
    if (n < 0 && errno != EAGAIN && errno != EINTR) { lose(s, errno); }
    return n;
}

int ipe_source_socketcan_read(ipe_source_socketcan_t* s)
{
    struct mmsghdr message[IPE_SOCKETCAN_BATCH];
    int n_frames = 0;
    const int n = s->fd >= 0 ? receive(s, message) : 0;
    for (int i = 0; i < n; ++i) { n_frames += convert(s, &message[i], &s->wire[i], &s->frame[n_frames]) ? 1 : 0; }
    s->has_more = n == IPE_SOCKETCAN_BATCH;
    return n_frames;
}

static void read_drops(ipe_source_socketcan_t* s)
{
    uint32_t info[SK_MEMINFO_VARS] = {0};
    socklen_t n = sizeof info;
    if (s->fd < 0 || getsockopt(s->fd, SOL_SOCKET, SO_MEMINFO, info, &n) != 0) { return; }
    if (n > SK_MEMINFO_DROPS * sizeof info[0]) { note_drops(s, info[SK_MEMINFO_DROPS]); }
}

void ipe_source_socketcan_tick(ipe_source_socketcan_t* s)
{
    read_drops(s);
    if (s->is_up) { return; }
    if (s->fd < 0) {
        (void)open_socket(s);
    } else {
        s->is_up = interface_is_up(s);
    }
    if (s->is_up) { ipe_message("%s: interface is up", s->interface); }
}

void ipe_source_socketcan_close(ipe_source_socketcan_t* s)
{
    if (s->fd < 0) { return; }
    read_drops(s);
    (void)close(s->fd);
    s->fd = -1;
}

const char* ipe_source_socketcan_counter(const ipe_source_socketcan_t* s, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"frames", s->counts.n_frames},
        {"error_frames", s->counts.n_error_frames},
        {"dropped_by_kernel", s->counts.n_dropped},
        {"controller_overruns", s->counts.n_controller_overruns},
        {"own", s->n_own},
        {"unstamped", s->n_unstamped},
        {"went_down", s->n_down},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
