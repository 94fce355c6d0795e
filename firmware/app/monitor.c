// SPDX-License-Identifier: Apache-2.0
#include "monitor.h"

#include "flow.h"
#include "health.h"
#include "loop.h"
#include "message.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

enum { CHECKPOINT_TICKS = 5 };

void monitor_interface(daemon_t* d, unsigned i)
{
    if (d->interface[i].is_up == d->interface_was_up[i]) { return; }
    d->interface_was_up[i] = d->interface[i].is_up;
    ipe_publish_event(&d->publisher, flow_now(d), d->interface[i].interface,
                      d->interface[i].is_up ? "interface is up" : "interface is down");
}

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
    ipe_message("internal state is damaged; estimates are not to be trusted");
    ipe_publish_event(&d->publisher, flow_now(d), "pipeline", "internal state is damaged");
}

void monitor_record(daemon_t* d)
{
    const uint64_t n_lost = ipe_record_lost(&d->recorder);
    const bool was_losing = d->is_losing_record;
    d->is_losing_record = n_lost != d->n_lost_reported;
    d->n_lost_reported = n_lost;
    if (!d->is_losing_record || was_losing) { return; }
    char text[REASON_SIZE];
    const int cause = atomic_load(&d->recorder.error);
    (void)snprintf(text, sizeof text, "messages are lost: %s", cause != 0 ? strerror(cause) : "the queue is full");
    ipe_message("--record: %s", text);
    ipe_publish_event(&d->publisher, flow_now(d), "record", text);
}

/// Feed the watchdog and say in one line how it goes.
static void report_status(daemon_t* d)
{
    char mass[64] = "no estimate yet";
    unsigned n_up = 0;
    const ipe_estimate_t* e = &d->pipeline->estimate;
    const uint64_t n_frames = health_frames(d);
    for (unsigned i = 0; i < d->n_interfaces; ++i) { n_up += d->interface[i].is_up ? 1 : 0; }
    if (e->n_windows > 0) { (void)snprintf(mass, sizeof mass, "%.3f +- %.3f kg", e->body.mass, e->body.mass_std); }
    ipe_notify_send(&d->notify, "WATCHDOG=1\nSTATUS=%" PRIu64 " frames/s, %s%s, %u of %u interfaces up",
                    n_frames - d->n_frames_reported, mass, d->pipeline->is_frozen ? ", frozen" : "", n_up,
                    d->n_interfaces);
    d->n_frames_reported = n_frames;
}

void monitor_tick(daemon_t* d)
{
    for (unsigned i = 0; i < d->n_interfaces; ++i) { tick_interface(d, i); }
    check_invariants(d);
    if (d->is_recording) { monitor_record(d); }
    if (d->option.checkpoint != NULL && ++d->n_ticks >= CHECKPOINT_TICKS) {
        d->n_ticks = 0;
        ipe_checkpoint_save(&d->checkpoint, d->pipeline);
    }
    if (!d->was_health_sent) {
        ipe_publish_flush(&d->publisher);
        health_send(d, flow_now(d));
    }
    d->was_health_sent = false;
    report_status(d);
}
