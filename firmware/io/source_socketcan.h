// SPDX-License-Identifier: Apache-2.0
/// CAN frames from one Linux CAN interface.
///
/// in: one raw socket, classical, FD and error frames. out: batches of up to 64 frames with the kernel's stamp
/// (CLOCK_REALTIME) and the controller's own, in the order of arrival. What the kernel or the controller lost is counted.
/// An interface that goes down or is unplugged is waited for: call ipe_source_socketcan_tick() once a second.
/// The receive buffer is made 8 MB where allowed (CAP_NET_ADMIN), about 1 s of a full bus; less is reported.
/// 25 KB of state, caller-allocated, no heap, one thread. One system call per batch.
/// Source: Linux Documentation/networking/can.rst, timestamping.rst.
#ifndef IPE_SOURCE_SOCKETCAN_H
#define IPE_SOURCE_SOCKETCAN_H

#include "bus_counts.h"
#include "config.h"
#include "types.h"

#include <linux/can.h>
#include <sys/socket.h>

enum { IPE_SOCKETCAN_BATCH = 64, IPE_SOCKETCAN_NAME_MAX = 16 };

/// Room for the stamps and the drop counter that come with one frame.
typedef union {
    char bytes[128];
    struct cmsghdr alignment;
} ipe_socketcan_control_t;

typedef struct {
    int fd;  ///< for epoll; -1 while the interface is gone
    char interface[IPE_SOCKETCAN_NAME_MAX];
    uint8_t bus;
    bool is_up;                                    ///< frames can come
    bool takes_all;                                ///< every identifier, whatever is bound
    unsigned n_filters;                            ///< 0: every identifier
    struct can_filter filter[IPE_SIGNALS_MAX];
    int receive_buffer;                            ///< bytes, as the kernel counts them
    uint32_t last_drops;                           ///< the kernel's counter for this socket, as last read
    bool has_more;                                 ///< the last batch was full: there may be more
    ipe_frame_t frame[IPE_SOCKETCAN_BATCH];        ///< the last batch
    struct canfd_frame wire[IPE_SOCKETCAN_BATCH];  ///< the same as the kernel gave it
    ipe_socketcan_control_t control[IPE_SOCKETCAN_BATCH];

    ipe_bus_counts_t counts;  ///< n_dropped: by the kernel, socket buffer full
    uint64_t n_own;           ///< frames this socket sent itself, left out
    uint64_t n_unstamped;     ///< frames without a kernel stamp, stamped on reading
    uint64_t n_down;          ///< times the interface went down or away
} ipe_source_socketcan_t;

/// Open a socket on an interface that exists; it may be down.
///
///   config   in   identifiers that its signals on this bus are bound to are let through, no others; NULL: all
///   message  out  one line on failure; size bytes, always terminated
///
/// 0 or -1. Warns on stderr when the buffer stays small or the interface is down.
int ipe_source_socketcan_open(ipe_source_socketcan_t* s, const char* interface, uint8_t bus, const ipe_config_t* config,
                              char* message, size_t size);

/// Frames that the receive buffer holds, about.
int ipe_source_socketcan_capacity(const ipe_source_socketcan_t* s);

/// From now on let through what this configuration's signals are bound to; without effect on a source that takes all. 0, or
/// -1 with errno set.
int ipe_source_socketcan_filter(ipe_source_socketcan_t* s, const ipe_config_t* config);

/// Read what is there, at most one batch, into s->frame. Never blocks.
///
/// Number of frames in s->frame; 0: nothing there, or the interface went down (s->is_up is false then). Call again while
/// s->has_more.
int ipe_source_socketcan_read(ipe_source_socketcan_t* s);

/// Once a second: read the kernel's drop counter; open again an interface that came back (s->fd may change).
void ipe_source_socketcan_tick(ipe_source_socketcan_t* s);

void ipe_source_socketcan_close(ipe_source_socketcan_t* s);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_source_socketcan_counter(const ipe_source_socketcan_t* s, unsigned index, uint64_t* value);

#endif
