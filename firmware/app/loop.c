// SPDX-License-Identifier: Apache-2.0
#include "loop.h"

#include "command_handler.h"
#include "data_path.h"
#include "message.h"
#include "monitor.h"

#include <errno.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/timerfd.h>
#include <unistd.h>

enum { ITEMS_PER_TURN = 4096, BATCHES_PER_TURN = 16, MESSAGES_PER_TURN = 64 };

/// Cause of the wake-up. Interfaces follow the last one: WAKE_BUS + index.
enum { WAKE_SIGNAL, WAKE_SECOND, WAKE_PACE, WAKE_INPUT, WAKE_LCM, WAKE_BUS };

static void watch(daemon_t* d, int fd, uint64_t wake, uint32_t events)
{
    struct epoll_event event = {.events = events, .data.u64 = wake};
    if (epoll_ctl(d->epoll_fd, EPOLL_CTL_ADD, fd, &event) != 0) {
        ipe_message("epoll: cannot wait for source %llu: %s", (unsigned long long)wake, strerror(errno));
    }
}

static void watch_interface(daemon_t* d, unsigned i)
{
    watch(d, d->interface[i].fd, WAKE_BUS + i, EPOLLIN);
}

int loop_open(daemon_t* d)
{
    const struct itimerspec each_second = {.it_interval.tv_sec = 1, .it_value.tv_sec = 1};
    d->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    d->second_fd = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK);
    d->pace_fd = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK);
    if (d->epoll_fd < 0 || d->second_fd < 0 || d->pace_fd < 0 ||
        timerfd_settime(d->second_fd, 0, &each_second, NULL) != 0) {
        return daemon_refuse("event loop", strerror(errno));
    }
    watch(d, d->signal_fd, WAKE_SIGNAL, EPOLLIN);
    if (!d->replay.is_lock_step) {
        watch(d, d->second_fd, WAKE_SECOND, EPOLLIN);
    }  // whose result must not depend on it
    watch(d, d->pace_fd, WAKE_PACE, EPOLLIN);
    if (d->inbox.fd >= 0) { watch(d, d->inbox.fd, WAKE_LCM, EPOLLIN); }
    for (unsigned i = 0; i < d->n_interfaces; ++i) { watch_interface(d, i); }
    d->is_replay_runnable = d->n_interfaces == 0;
    return 0;
}

/// Wait until fd is readable; false if it always is, as files are.
static bool wait_for_input(daemon_t* d, int fd)
{
    struct epoll_event event = {.events = EPOLLIN | EPOLLONESHOT, .data.u64 = WAKE_INPUT};
    return epoll_ctl(d->epoll_fd, EPOLL_CTL_MOD, fd, &event) == 0 ||
           epoll_ctl(d->epoll_fd, EPOLL_CTL_ADD, fd, &event) == 0;
}

static void wait_until(daemon_t* d, int64_t due_ns)
{
    const struct itimerspec due = {.it_value = {.tv_sec = due_ns / NS_PER_S, .tv_nsec = due_ns % NS_PER_S}};
    (void)timerfd_settime(d->pace_fd, TFD_TIMER_ABSTIME, &due, NULL);
}

/// Host time now if the replay is paced; 0 if not, where latencies would mean nothing.
static int64_t replay_arrival(const daemon_t* d)
{
    return d->replay.speed > 0.0 ? ipe_host_clock_now(&d->clock) : 0;
}

static void replay_frame(daemon_t* d, const ipe_frame_t* frame)
{
    const int64_t arrival_ns = replay_arrival(d);
    data_path_frame(d, frame, arrival_ns);
    if (arrival_ns != 0) { ipe_histogram_push(&d->decoded, ipe_host_clock_now(&d->clock) - arrival_ns); }
}

static void replay_command(daemon_t* d)
{
    const ipe_lock_step_t* l = &d->replay.lock_step;
    const ipe_inbox_item_t item = {.command = l->command, .data = l->message, .n = l->n_message};
    command_handler_execute(d, &item);
}

/// Use one item of the recorded input. False: the next one is not there yet, or there is none.
static bool replay_item(daemon_t* d)
{
    ipe_replay_item_t item;
    switch (ipe_replay_next(&d->replay, &item)) {
    case IPE_REPLAY_FRAME: replay_frame(d, item.frame); return true;
    case IPE_REPLAY_POSITION:
        ipe_publish_position(&d->publisher, item.position->t_ns, item.position->position);
        data_path_position(d, item.position->t_ns, item.position->position, replay_arrival(d));
        return true;
    case IPE_REPLAY_COMMAND: replay_command(d); return true;
    case IPE_REPLAY_WAIT:
        if (wait_for_input(d, item.fd)) { return false; }
        ipe_replay_fill(&d->replay);
        return true;
    case IPE_REPLAY_ANSWER: d->is_done = !ipe_publish_lock_step_answer(&d->publisher, d->data_ns); return true;
    case IPE_REPLAY_EARLY: wait_until(d, item.due_ns); return false;
    case IPE_REPLAY_END:
    default: d->is_done = true; return false;
    }
}

/// Use at most ITEMS_PER_TURN items, so that signals and LCM are served in between.
static void run_replay(daemon_t* d)
{
    for (int i = 0; i < ITEMS_PER_TURN && d->is_replay_runnable; ++i) { d->is_replay_runnable = replay_item(d); }
}

/// Use a batch of frames. The clock is read once, after the last frame, for the latency of all.
static void use_batch(daemon_t* d, ipe_frame_t* frame, int n)
{
    for (int k = 0; k < n; ++k) {
        frame[k].t_ns = ipe_host_clock_map(&d->clock, frame[k].t_ns);
        data_path_frame(d, &frame[k], frame[k].t_ns);
    }
    const int64_t now_ns = ipe_host_clock_now(&d->clock);
    for (int k = 0; k < n; ++k) { ipe_histogram_push(&d->decoded, now_ns - frame[k].t_ns); }
}

static void read_interface(daemon_t* d, unsigned i)
{
    ipe_source_socketcan_t* s = &d->interface[i];
    for (int batch = 0; batch == 0 || (s->has_more && batch < BATCHES_PER_TURN); ++batch) {
        const int n = ipe_source_socketcan_read(s);
        monitor_clock(d);
        use_batch(d, s->frame, n);
    }
    monitor_interface(d, i);
}

static void use_position(daemon_t* d, const ipe_inbox_item_t* item)
{
    const int64_t t_ns = d->n_interfaces > 0 ? ipe_host_clock_map(&d->clock, item->t_ns) : item->t_ns;
    ipe_publish_received(&d->publisher, IPE_PUBLISH_TRACKER, t_ns, item->data, item->n);
    if (d->replay.has_tracker || d->config.position_source != IPE_POSITION_TRACKER) {
        d->n_positions_unused++;
        return;
    }
    data_path_position(d, t_ns, item->position, ipe_host_clock_now(&d->clock));
}

static void read_inbox(daemon_t* d)
{
    ipe_inbox_item_t item;
    ipe_inbox_kind_t kind;
    for (int i = 0; i < MESSAGES_PER_TURN && (kind = ipe_inbox_next(&d->inbox, &item)) != IPE_INBOX_EMPTY; ++i) {
        if (kind == IPE_INBOX_COMMAND) {
            command_handler_execute(d, &item);
        } else {
            use_position(d, &item);
        }
    }
}

/// An interface that came back has a new descriptor.
static void tick_interface(daemon_t* d, unsigned i)
{
    const int fd = d->interface[i].fd;
    ipe_source_socketcan_tick(&d->interface[i]);
    if (d->interface[i].fd != fd) { watch_interface(d, i); }
    monitor_interface(d, i);
}

static void acknowledge(int timer_fd)
{
    uint64_t n_expirations;
    (void)!read(timer_fd, &n_expirations, sizeof n_expirations);  // nothing to read: it was read before
}

static void handle(daemon_t* d, uint64_t wake)
{
    switch (wake) {
    case WAKE_SIGNAL: d->is_done = true; break;
    case WAKE_SECOND:
        acknowledge(d->second_fd);
        for (unsigned i = 0; i < d->n_interfaces; ++i) { tick_interface(d, i); }
        monitor_second(d);
        break;
    case WAKE_PACE:
        acknowledge(d->pace_fd);
        d->is_replay_runnable = true;
        break;
    case WAKE_INPUT:
        ipe_replay_fill(&d->replay);
        d->is_replay_runnable = true;
        break;
    case WAKE_LCM: read_inbox(d); break;
    default: read_interface(d, (unsigned)(wake - WAKE_BUS)); break;
    }
}

/// Pause so that several frames are read at once, if two or more will come during the pause and no whole batch is waiting: a
/// wake-up costs as much as some dozen frames.
static void collect(const daemon_t* d)
{
    const struct timespec pause = {.tv_nsec = d->collect_ns};
    bool is_worth_it = (int64_t)d->n_frames_tick * d->collect_ns >= 2 * NS_PER_S;
    for (unsigned i = 0; i < d->n_interfaces; ++i) { is_worth_it &= !d->interface[i].has_more; }
    if (is_worth_it) { (void)nanosleep(&pause, NULL); }
}

void loop_run(daemon_t* d)
{
    while (!d->is_done) {
        struct epoll_event event[WAKE_BUS + IPE_BUSES_MAX];
        collect(d);
        const int n = epoll_wait(d->epoll_fd, event, sizeof event / sizeof event[0], d->is_replay_runnable ? 0 : -1);
        for (int i = 0; i < n; ++i) { handle(d, event[i].data.u64); }
        if (d->is_replay_runnable) { run_replay(d); }
    }
}
