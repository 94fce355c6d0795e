// SPDX-License-Identifier: Apache-2.0
#include "monitor.h"

#include "health.h"
#include "message.h"

#include <arpa/inet.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { CHECKPOINT_TICKS = 5, FACTS_TICKS = 60, STATE_EVENTS_MAX = 10, SENDER_MAX = 32 };
static const int64_t PRESENCE_NS = NS_PER_S / 10;
#define WIDENING_OVER 1.2  // factor on sigma below which a widening is reported as over: chosen under IPE_MISFIT_MARKED

/// Report on EVENT and on stderr.
static void report(daemon_t* d, const char* source, const char* format, ...) __attribute__((format(printf, 3, 4)));

static void report(daemon_t* d, const char* source, const char* format, ...)
{
    char text[REASON_SIZE];
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    ipe_message("%s: %s", source, text);
    ipe_publish_event(&d->publisher, daemon_now(d), source, text);
}

// ---- buses ----------------------------------------------------------------------------------------------------------

void monitor_interface(daemon_t* d, unsigned i)
{
    if (d->interface[i].is_up == d->interface_was_up[i]) { return; }
    d->interface_was_up[i] = d->interface[i].is_up;
    if (d->interface[i].is_up) { ipe_bus_state_open(&d->bus_state[i]); }
    ipe_publish_event(&d->publisher, daemon_now(d), d->interface[i].interface,
                      d->interface[i].is_up ? "interface is up" : "interface is down");
}

/// An error frame carries the state of the controller.
static void read_error_frame(daemon_t* d, const ipe_frame_t* frame)
{
    const char* news = ipe_bus_state_push(&d->bus_state[frame->bus], frame);
    if (news == NULL || ++d->n_state_events[frame->bus] > STATE_EVENTS_MAX) { return; }
    report(d, health_bus_name(d, frame->bus), "%s%s", news,
           d->n_state_events[frame->bus] == STATE_EVENTS_MAX ? "; more within this second are only counted" : "");
}

// ---- losses -------------------------------------------------------------------------------------------------------

typedef enum { LOSS_SAME, LOSS_BEGAN, LOSS_ENDED } loss_change_t;

/// n lost so far: did the loss begin since the last call, or end?
static loss_change_t update_loss(loss_t* l, uint64_t n)
{
    const bool is_losing = n > l->n_last;  // fewer: another pipeline took over
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
    switch (update_loss(l, n->n_dropped + n->n_controller_overruns)) {
    case LOSS_BEGAN:
        report(d, health_bus_name(d, i),
               "frames are being lost: %" PRIu64 " by the %s, %" PRIu64 " times in the controller", n->n_dropped,
               d->n_interfaces > 0 ? "kernel" : "logger", n->n_controller_overruns);
        break;
    case LOSS_ENDED:
        report(d, health_bus_name(d, i), "no more frames are being lost; %" PRIu64 " were lost",
               l->n_last - l->n_before);
        break;
    case LOSS_SAME:
    default: break;
    }
}

static void report_record(daemon_t* d)
{
    const loss_change_t change = update_loss(&d->record_loss, ipe_record_lost(&d->recorder));
    const int cause = atomic_load(&d->recorder.error);
    if (change == LOSS_BEGAN) {
        report(d, "record", "messages are being lost: %s", cause != 0 ? strerror(cause) : "the queue is full");
    } else if (change == LOSS_ENDED) {
        report(d, "record", "no more messages are being lost; %" PRIu64 " were lost",
               d->record_loss.n_last - d->record_loss.n_before);
    }
}

/// While LCM fails, only the record and stderr carry the report.
static void report_lcm(daemon_t* d)
{
    const loss_change_t change = update_loss(&d->lcm_loss, d->publisher.n_failed);
    if (change == LOSS_BEGAN) {
        report(d, "lcm", "messages cannot be sent");
    } else if (change == LOSS_ENDED) {
        report(d, "lcm", "messages are sent again; %" PRIu64 " were not sent",
               d->lcm_loss.n_last - d->lcm_loss.n_before);
    }
}

/// ADDRESS:PORT of a sender.
static const char* name_sender(const struct sockaddr_in* from, char text[SENDER_MAX])
{
    char address[INET_ADDRSTRLEN] = "?";
    (void)inet_ntop(AF_INET, &from->sin_addr, address, sizeof address);
    (void)snprintf(text, SENDER_MAX, "%s:%u", address, ntohs(from->sin_port));
    return text;
}

static void report_refused(daemon_t* d, loss_t* l, uint64_t n, const char* source, const char* format, ...)
    __attribute__((format(printf, 5, 6)));

/// Messages on a channel of ours that are refused as they arrive, n so far: the line when it begins, the sum when it ends.
static void report_refused(daemon_t* d, loss_t* l, uint64_t n, const char* source, const char* format, ...)
{
    char text[REASON_SIZE];
    const loss_change_t change = update_loss(l, n);
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (change == LOSS_BEGAN) { report(d, source, "%s", text); }
    if (change == LOSS_ENDED) { report(d, source, "no more messages are refused; %" PRIu64 " were", n - l->n_before); }
}

static void report_inbox(daemon_t* d)
{
    char text[3][SENDER_MAX];
    const ipe_inbox_t* b = &d->inbox;
    const char* position = health_sensor_name(IPE_POSITION);
    const char* foreign_command = name_sender(&b->foreign_command, text[0]);
    const char* foreign_position = name_sender(&b->foreign_position, text[2]);
    report_refused(d, &d->foreign_commands, b->n_commands_foreign, "command",
                   "COMMAND from %s is refused; --commands says who may send it", foreign_command);
    report_refused(d, &d->foreign_positions, b->n_positions_foreign, position,
                   "TRACKER from %s, which is not this host, is refused; --tracker lcm:network takes it",
                   foreign_position);
    report_refused(d, &d->unused_positions, d->n_positions_unused, position,
                   "TRACKER is not used: the position comes from elsewhere");
    const char* other = name_sender(&b->other, text[0]);
    report_refused(d, &d->other_positions, b->n_positions_other, position,
                   "a second publisher of TRACKER, %s, is refused as long as %s sends; stop one of them", other,
                   name_sender(&b->publisher, text[1]));
}

static void report_losses(daemon_t* d)
{
    report_inbox(d);
    for (unsigned i = 0; i < d->option.n_buses; ++i) { report_bus_loss(d, i); }
    if (d->is_recording) { report_record(d); }
    report_lcm(d);
}

// ---- clock and sensors ----------------------------------------------------------------------------------------------

void monitor_clock(daemon_t* d)
{
    if (!ipe_host_clock_refresh(&d->clock)) { return; }
    report(d, "clock", "the host's clock was stepped by %+.6f s; stamps go on without a jump",
           (double)d->clock.step_ns / (double)NS_PER_S);
}

/// Did frames of a sensor arrive since the last check? Those of an open sample are not counted yet.
static bool has_frames(daemon_t* d, int sensor)
{
    const ipe_sample_assembler_t* g = &d->pipeline->sample_assembler[sensor];
    const uint64_t n = g->n_used + g->n_dropped + g->n_duplicate;
    const bool is_more = n > d->n_sensor_frames[sensor];
    d->n_sensor_frames[sensor] = n;
    return is_more;
}

static void report_presence(daemon_t* d, int64_t now_ns)
{
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        const bool sends = has_frames(d, s);
        const int64_t newest_ns = daemon_newest_sample(d, (ipe_sensor_t)s);
        ipe_presence_t* p = &d->presence[s];
        if (s == IPE_POSITION && d->config.position_source == IPE_POSITION_FIXED) { continue; }
        const ipe_presence_change_t change = ipe_presence_look(p, d->pipeline->align.n_samples[s], newest_ns, now_ns);
        if (change == IPE_PRESENCE_SAME) { continue; }
        report(d, health_sensor_name((ipe_sensor_t)s),
               change == IPE_PRESENCE_BACK ? "back after %.2f s"
               : sends ? "lost, no sample for %.2f s although its frames arrive: frames are missing, or stamped "
                         "later than its period; look at group, pace and align of HEALTH"
                       : "lost, silent for %.2f s",
               (double)p->silence_ns / (double)NS_PER_S);
    }
}

/// Send HOST with the first data, then once a minute.
static void send_host(daemon_t* d, int64_t now_ns)
{
    if (d->n_facts_ticks > 0) { return; }
    d->n_facts_ticks = FACTS_TICKS;
    ipe_publish_host(&d->publisher, now_ns, &d->facts);
}

/// Ten times a second of data time.
static void check_sensors(daemon_t* d, int64_t now_ns)
{
    if (now_ns < d->presence_due_ns && now_ns >= d->presence_due_ns - PRESENCE_NS) { return; }
    d->presence_due_ns = now_ns + PRESENCE_NS;
    send_host(d, now_ns);
    report_presence(d, now_ns);
}

static void report_lateness(daemon_t* d, ipe_sensor_t sensor)
{
    char text[REASON_SIZE];
    loss_t* l = &d->late[sensor];
    switch (update_loss(l, ipe_align_lateness(&d->pipeline->align, sensor).n_too_late)) {
    case LOSS_BEGAN:
        health_describe_lateness(d, sensor, text, sizeof text);
        report(d, health_sensor_name(sensor), "%s", text);
        break;
    case LOSS_ENDED:
        report(d, health_sensor_name(sensor), "in time again; %" PRIu64 " samples were too late",
               l->n_last - l->n_before);
        break;
    case LOSS_SAME:
    default: break;
    }
}

static void report_unknown_force(daemon_t* d, int cable)
{
    loss_t* l = &d->unknown_force[cable];
    switch (update_loss(l, d->pipeline->stuck_sensor.n_unknown_of[cable])) {
    case LOSS_BEGAN:
        report(d, health_sensor_name(IPE_FORCE),
               "the sensor of cable %d is stuck at %g N: the estimate goes on without it; check it", cable + 1,
               (double)d->pipeline->stuck_sensor.f[cable]);
        break;
    case LOSS_ENDED:
        report(d, health_sensor_name(IPE_FORCE), "the sensor of cable %d is well again; %" PRIu64 " samples were stuck",
               cable + 1, l->n_last - l->n_before);
        break;
    case LOSS_SAME:
    default: break;
    }
}

// ---- by data time ---------------------------------------------------------------------------------------------------

static void report_change(daemon_t* d)
{
    if (d->pipeline->estimator.change_detector.n_changes == d->n_changes_reported) { return; }
    d->n_changes_reported = d->pipeline->estimator.change_detector.n_changes;
    ipe_publish_event(&d->publisher, d->last_row_ns, "detect", "payload changed");
}

/// The changes of payload that an announced one makes are reported here alone.
static void report_announcement(daemon_t* d)
{
    static const char* const TEXT[] = {
        [IPE_ANNOUNCEMENT_CONTACT] = "the announced payload is coming into contact",
        [IPE_ANNOUNCEMENT_TAKEN] = "the announced payload is taken",
        [IPE_ANNOUNCEMENT_OTHER] = "a payload of another mass than announced is taken: it is estimated anew",
        [IPE_ANNOUNCEMENT_FAILED] = "the contact is broken off: the estimate is that of the body before it again",
        [IPE_ANNOUNCEMENT_MISSED] = "the announced payload did not come",
    };
    const ipe_announcement_state_t state = d->announcement.state;
    if (state == d->announcement_reported) { return; }
    d->announcement_reported = state;
    if (state == IPE_ANNOUNCEMENT_CONTACT || state == IPE_ANNOUNCEMENT_FAILED) {
        d->n_changes_reported = d->pipeline->estimator.change_detector.n_changes;
    }
    if (state < IPE_ANNOUNCEMENT_CONTACT) { return; }
    const bool was_blind = state == IPE_ANNOUNCEMENT_MISSED && !d->announcement.has_looked;
    ipe_publish_event(&d->publisher, d->last_row_ns, "expect",
                      was_blind ? "the announced payload was not looked for: there was no estimate yet" : TEXT[state]);
}

static void report_force_delay(daemon_t* d)
{
    const double delay = d->pipeline->estimator.force_delay;
    if (delay == d->force_delay_reported) { return; }
    d->force_delay_reported = delay;
    if (delay == 0.0) { return; }  // forgotten by a command
    report(
        d, health_sensor_name(IPE_FORCE),
        "the samples are %+.1f ms late; they are shifted now and the estimate begins again: set [align] delay_force = %.4f",
        1e3 * delay, d->config.delay[IPE_FORCE] + delay);
}

static void report_misfit(daemon_t* d)
{
    const bool is_misfit = ipe_change_detector_is_misfit(&d->pipeline->estimator.change_detector);
    if (is_misfit == d->is_misfit_reported) { return; }
    d->is_misfit_reported = is_misfit;
    ipe_publish_event(&d->publisher, d->last_row_ns, "detect",
                      is_misfit
                          ? "no payload explains the forces of the last 5 s: the estimate is held, its sigmas are "
                            "wider; look for a push, a slack cable or a broken sensor"
                          : "the forces fit again: the estimate goes on");
}

static void report_widening(daemon_t* d)
{
    char text[160];
    const double factor = d->pipeline->estimator.estimate.sigma_factor;
    if (d->is_misfit_reported) { return; }  // says that the sigmas are wider
    const double limit = d->is_widening_reported ? WIDENING_OVER : IPE_MISFIT_MARKED;
    if ((factor > limit) == d->is_widening_reported) { return; }
    d->is_widening_reported = factor > limit;
    (void)snprintf(
        text, sizeof text,
        d->is_widening_reported
            ? "the estimate moves more than noise moves it: its sigmas are %.2g times wider; look at geometry, "
              "friction of the pulleys and the force sensors"
            : "the estimate moves as noise moves it: its sigmas are %.2g times wider",
        factor);
    ipe_publish_event(&d->publisher, d->last_row_ns, "misfit", text);
}

/// Once a second: of real time, in lock-step of data time.
static void tick(daemon_t* d)
{
    memset(d->n_state_events, 0, sizeof d->n_state_events);
    if (d->option.checkpoint == NULL || ++d->n_ticks < CHECKPOINT_TICKS) { return; }
    d->n_ticks = 0;
    ipe_checkpoint_save(&d->checkpoint, d->pipeline);
}

/// Once a second of data time; not at the first call, when there is nothing to compare with.
static void check_second(daemon_t* d, int64_t t_ns)
{
    if (t_ns < d->health_due_ns && t_ns >= d->health_due_ns - NS_PER_S) { return; }
    if (d->health_due_ns != 0) {
        report_lateness(d, IPE_FORCE);
        report_lateness(d, IPE_POSITION);
        for (int i = 0; i < d->config.n_cables; ++i) { report_unknown_force(d, i); }
        report_widening(d);
        health_send(d, t_ns);
        if (d->replay.is_lock_step) { tick(d); }
    }
    d->health_due_ns = t_ns + NS_PER_S;
}

void monitor_frame(daemon_t* d, const ipe_frame_t* frame)
{
    if ((frame->can_id & IPE_CAN_ERR) != 0) { read_error_frame(d, frame); }
    report_announcement(d);
    report_change(d);
    report_force_delay(d);
    report_misfit(d);
    check_second(d, frame->t_ns);
    check_sensors(d, frame->t_ns);
}

// ---- by real time ---------------------------------------------------------------------------------------------------

/// A broken invariant is a fault of this program or of the machine. Reported once.
static void check_invariants(daemon_t* d)
{
    if (d->is_damage_reported || ipe_pipeline_invariants_hold(d->pipeline)) { return; }
    d->is_damage_reported = true;
    report(d, "pipeline", "an invariant of the estimator is broken: do not use the estimates, restart inertiad");
}

/// Feed the watchdog; the status line goes to systemd.
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

void monitor_second(daemon_t* d)
{
    monitor_clock(d);
    report_losses(d);
    if (d->n_interfaces > 0) { check_sensors(d, daemon_now(d)); }
    if (d->n_facts_ticks > 0) { d->n_facts_ticks--; }
    check_invariants(d);
    tick(d);
    if (!d->was_health_sent) {
        ipe_publish_flush(&d->publisher);
        health_send(d, daemon_now(d));
    }
    d->was_health_sent = false;
    count_frames(d);
    report_status(d);
}

void monitor_end(daemon_t* d)
{
    report_announcement(d);
    report_change(d);
    report_misfit(d);
    report_losses(d);
}
