// SPDX-License-Identifier: Apache-2.0
#include "monitor.h"

#include "flow.h"
#include "health.h"
#include "loop.h"
#include "message.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { CHECKPOINT_TICKS = 5, FACTS_TICKS = 60, STATE_EVENTS_MAX = 10 };
static const int64_t PRESENCE_NS = NS_PER_S / 10;

/// Tell it to people and programs alike.
static void tell(daemon_t* d, const char* source, const char* format, ...) __attribute__((format(printf, 3, 4)));

static void tell(daemon_t* d, const char* source, const char* format, ...)
{
    char text[REASON_SIZE];
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    ipe_message("%s: %s", source, text);
    ipe_publish_event(&d->publisher, flow_now(d), source, text);
}

// ---- buses ----------------------------------------------------------------------------------------------------------

void monitor_interface(daemon_t* d, unsigned i)
{
    if (d->interface[i].is_up == d->interface_was_up[i]) { return; }
    d->interface_was_up[i] = d->interface[i].is_up;
    ipe_publish_event(&d->publisher, flow_now(d), d->interface[i].interface,
                      d->interface[i].is_up ? "interface is up" : "interface is down");
}

void monitor_error_frame(daemon_t* d, const ipe_frame_t* frame)
{
    const char* news = ipe_bus_state_push(&d->bus_state[frame->bus], frame);
    if (news == NULL || ++d->n_state_events[frame->bus] > STATE_EVENTS_MAX) { return; }
    tell(d, health_bus_name(d, frame->bus), "%s%s", news,
         d->n_state_events[frame->bus] == STATE_EVENTS_MAX ? "; more within this second are only counted" : "");
}

// ---- what gets lost -------------------------------------------------------------------------------------------------

typedef enum { LOSS_SAME, LOSS_BEGAN, LOSS_ENDED } loss_change_t;

/// n lost so far: did it begin since the last look, or was it over in between?
static loss_change_t look_at_loss(loss_t* l, uint64_t n)
{
    const bool is_losing = n != l->n_last;
    const bool was_losing = l->is_losing;
    if (is_losing && !was_losing) { l->n_before = l->n_last; }
    l->n_last = n;
    l->is_losing = is_losing;
    return is_losing == was_losing ? LOSS_SAME : is_losing ? LOSS_BEGAN : LOSS_ENDED;
}

static void report_bus_loss(daemon_t* d, unsigned i)
{
    const ipe_bus_counts_t* n = health_bus_counts(d, i);
    loss_t* l = &d->bus_loss[i];
    switch (look_at_loss(l, n->n_dropped + n->n_controller_overruns)) {
    case LOSS_BEGAN:
        tell(d, health_bus_name(d, i), "frames are lost: %" PRIu64 " by the %s, %" PRIu64 " times in the controller",
             n->n_dropped, d->n_interfaces > 0 ? "kernel" : "logger", n->n_controller_overruns);
        break;
    case LOSS_ENDED:
        tell(d, health_bus_name(d, i), "no more frames are lost after %" PRIu64, l->n_last - l->n_before);
        break;
    case LOSS_SAME:
    default: break;
    }
}

static void report_record(daemon_t* d)
{
    const loss_change_t change = look_at_loss(&d->record_loss, ipe_record_lost(&d->recorder));
    const int cause = atomic_load(&d->recorder.error);
    if (change == LOSS_BEGAN) {
        tell(d, "record", "messages are lost: %s", cause != 0 ? strerror(cause) : "the queue is full");
    } else if (change == LOSS_ENDED) {
        tell(d, "record", "whole again after %" PRIu64 " lost messages",
             d->record_loss.n_last - d->record_loss.n_before);
    }
}

/// While it is gone nobody hears it but the record and stderr.
static void report_lcm(daemon_t* d)
{
    const loss_change_t change = look_at_loss(&d->lcm_loss, d->publisher.n_failed);
    if (change == LOSS_BEGAN) {
        tell(d, "lcm", "messages cannot be sent");
    } else if (change == LOSS_ENDED) {
        tell(d, "lcm", "back after %" PRIu64 " messages that were not sent", d->lcm_loss.n_last - d->lcm_loss.n_before);
    }
}

void monitor_losses(daemon_t* d)
{
    for (unsigned i = 0; i < d->option.n_buses; ++i) { report_bus_loss(d, i); }
    if (d->is_recording) { report_record(d); }
    report_lcm(d);
}

// ---- clock and sensors ----------------------------------------------------------------------------------------------

void monitor_clock(daemon_t* d)
{
    if (!ipe_host_clock_refresh(&d->clock)) { return; }
    tell(d, "clock", "the host's clock was stepped by %+.6f s; stamps go on without a jump",
         (double)d->clock.step_ns / (double)NS_PER_S);
}

static void look_at_sensors(daemon_t* d, int64_t now_ns)
{
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        const ipe_ring_t* ring = &d->pipeline->align.ring[s];
        const int64_t newest_ns = ring->head > ring->first ? ring->t_ns[(ring->head - 1) % IPE_RING] : 0;
        ipe_presence_t* p = &d->presence[s];
        if (s == IPE_POSITION && d->config.position_source == IPE_POSITION_FIXED) { continue; }
        const ipe_presence_change_t change = ipe_presence_look(p, d->pipeline->align.n_samples[s], newest_ns, now_ns);
        if (change == IPE_PRESENCE_SAME) { continue; }
        tell(d, health_sensor_name((ipe_sensor_t)s),
             change == IPE_PRESENCE_LOST ? "lost, silent for %.2f s" : "back after %.2f s",
             (double)p->silence_ns / (double)NS_PER_S);
    }
}

/// Send HOST, when there is a time to stamp it with and then once a minute.
static void tell_facts(daemon_t* d, int64_t now_ns)
{
    if (d->n_facts_ticks > 0) { return; }
    d->n_facts_ticks = FACTS_TICKS;
    ipe_publish_host(&d->publisher, now_ns, &d->facts);
}

void monitor_advance(daemon_t* d, int64_t now_ns)
{
    if (now_ns < d->presence_due_ns && now_ns >= d->presence_due_ns - PRESENCE_NS) { return; }
    d->presence_due_ns = now_ns + PRESENCE_NS;
    tell_facts(d, now_ns);
    look_at_sensors(d, now_ns);
}

// ---- once a second --------------------------------------------------------------------------------------------------

static void tick_interface(daemon_t* d, unsigned i)
{
    const int fd = d->interface[i].fd;
    ipe_source_socketcan_tick(&d->interface[i]);
    if (d->interface[i].fd != fd) { loop_watch_interface(d, i); }
    monitor_interface(d, i);
}

/// A wrong number in the state is a fault of this program or of the machine: say so, once.
static void check_invariants(daemon_t* d)
{
    if (d->is_damage_reported || ipe_pipeline_invariants_hold(d->pipeline)) { return; }
    d->is_damage_reported = true;
    tell(d, "pipeline", "internal state is damaged; estimates are not to be trusted");
}

/// Feed the watchdog and say in one line how it goes.
static void report_status(daemon_t* d)
{
    char mass[64] = "no estimate yet";
    unsigned n_up = 0;
    const ipe_estimate_t* e = &d->pipeline->estimator.estimate;
    for (unsigned i = 0; i < d->n_interfaces; ++i) { n_up += d->interface[i].is_up ? 1 : 0; }
    if (e->n_windows > 0) { (void)snprintf(mass, sizeof mass, "%.3f +- %.3f kg", e->body.mass, e->body.mass_std); }
    ipe_notify_send(&d->notify, "WATCHDOG=1\nSTATUS=%" PRIu64 " frames/s, %s%s, %u of %u interfaces up",
                    d->n_frames_tick, mass, d->pipeline->is_frozen ? ", frozen" : "", n_up, d->n_interfaces);
}

static void count_frames(daemon_t* d)
{
    const uint64_t n = health_frames(d);
    d->n_frames_tick = n - d->n_frames_last;
    d->n_frames_last = n;
}

void monitor_tick(daemon_t* d)
{
    monitor_clock(d);
    for (unsigned i = 0; i < d->n_interfaces; ++i) { tick_interface(d, i); }
    monitor_losses(d);
    memset(d->n_state_events, 0, sizeof d->n_state_events);
    if (d->n_interfaces > 0) { monitor_advance(d, flow_now(d)); }
    if (d->n_facts_ticks > 0) { d->n_facts_ticks--; }
    check_invariants(d);
    if (d->option.checkpoint != NULL && ++d->n_ticks >= CHECKPOINT_TICKS) {
        d->n_ticks = 0;
        ipe_checkpoint_save(&d->checkpoint, d->pipeline);
    }
    if (!d->was_health_sent) {
        ipe_publish_flush(&d->publisher);
        health_send(d, flow_now(d));
    }
    d->was_health_sent = false;
    count_frames(d);
    report_status(d);
}
