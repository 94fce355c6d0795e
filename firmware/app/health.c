// SPDX-License-Identifier: Apache-2.0
#include "health.h"

#include "counter_table.h"
#include "message.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

static const uint64_t NS_PER_US = 1000;

static void count_buses(daemon_t* d)
{
    char stage[16];
    uint64_t value = 0;
    const char* cause;
    for (unsigned i = 0; i < d->option.n_buses; ++i) {
        (void)snprintf(stage, sizeof stage, "bus%u", i);
        for (unsigned k = 0;; ++k) {
            cause = d->n_interfaces > 0 ? ipe_source_socketcan_counter(&d->interface[i], k, &value)
                                        : ipe_source_file_counter(&d->replay.bus[i], k, &value);
            if (cause == NULL) { break; }
            ipe_counters_add(&d->counters, stage, cause, value);
        }
        for (unsigned k = 0; (cause = ipe_bus_state_counter(&d->bus_state[i], k, &value)) != NULL; ++k) {
            ipe_counters_add(&d->counters, stage, cause, value);
        }
    }
}

void health_count_input(daemon_t* d)
{
    uint64_t value = 0;
    const char* cause;
    ipe_counters_clear(&d->counters);
    count_buses(d);
    for (unsigned k = 0;
         d->replay.is_lock_step && (cause = ipe_lock_step_counter(&d->replay.lock_step, k, &value)) != NULL; ++k) {
        ipe_counters_add(&d->counters, "lock_step", cause, value);
    }
    for (unsigned k = 0; d->replay.has_tracker && !d->replay.is_lock_step &&
                         (cause = ipe_source_tracker_file_counter(&d->replay.tracker, k, &value)) != NULL;
         ++k) {
        ipe_counters_add(&d->counters, "tracker", cause, value);
    }
    for (unsigned k = 0; (cause = ipe_pipeline_counter(d->pipeline, k, &value)) != NULL; ++k) {
        ipe_counters_add(&d->counters, NULL, cause, d->carried.counter[k] + value);
    }
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        ipe_counters_add(&d->counters, health_sensor_name((ipe_sensor_t)s), "silences", d->presence[s].n_lost);
        if (s == IPE_IMU) { continue; }
        ipe_counters_add(&d->counters, health_sensor_name((ipe_sensor_t)s), "lateness_max_us",
                         (uint64_t)ipe_align_lateness(&d->pipeline->align, (ipe_sensor_t)s).largest_ns / NS_PER_US);
    }
}

void health_count(daemon_t* d)
{
    uint64_t value = 0;
    const char* cause;
    health_count_input(d);
    for (unsigned k = 0; (cause = ipe_publish_counter(&d->publisher, k, &value)) != NULL; ++k) {
        ipe_counters_add(&d->counters, "lcm", cause, value);
    }
    for (unsigned k = 0; (cause = ipe_inbox_counter(&d->inbox, k, &value)) != NULL; ++k) {
        ipe_counters_add(&d->counters, "lcm", cause, value);
    }
    ipe_counters_add(&d->counters, "lcm", "tracker_unused", d->n_positions_unused);
    ipe_counters_add(&d->counters, "clock", "host_steps", d->clock.n_steps);
    ipe_counters_add(&d->counters, "command", "done", d->n_commands_done);
    ipe_counters_add(&d->counters, "command", "refused", d->n_commands_refused);
    ipe_counters_add(&d->counters, "command", "old", d->n_commands_old);
    ipe_counters_add(&d->counters, "command", "repeated", d->n_commands_repeated);
    for (unsigned k = 0; d->option.record != NULL && (cause = ipe_record_counter(&d->recorder, k, &value)) != NULL;
         ++k) {
        ipe_counters_add(&d->counters, "record", cause, value);
    }
    for (unsigned k = 0;
         d->option.checkpoint != NULL && (cause = ipe_checkpoint_counter(&d->checkpoint, k, &value)) != NULL; ++k) {
        ipe_counters_add(&d->counters, "checkpoint", cause, value);
    }
}

const ipe_bus_counts_t* health_bus_counts(const daemon_t* d, unsigned i)
{
    return d->n_interfaces > 0 ? &d->interface[i].counts : &d->replay.bus[i].counts;
}

uint64_t health_frames(const daemon_t* d)
{
    uint64_t n = 0;
    for (unsigned i = 0; i < d->option.n_buses; ++i) { n += health_bus_counts(d, i)->n_frames; }
    return n;
}

const char* health_sensor_name(ipe_sensor_t sensor)
{
    static const char* const NAME[IPE_SENSOR_COUNT] = {"imu", "force", "position"};
    return NAME[sensor];
}

const char* health_bus_name(const daemon_t* d, unsigned i)
{
    return d->n_interfaces > 0 ? d->interface[i].interface : d->replay.bus[i].path;
}

uint64_t health_rejected_rows(const daemon_t* d)
{
    return d->carried.n_rejected + ipe_pipeline_counter_sum(d->pipeline, IPE_COUNTER_REJECTED);
}

uint64_t health_dropped(const daemon_t* d)
{
    uint64_t n = health_rejected_rows(d) + d->carried.n_incomplete +
                 ipe_pipeline_counter_sum(d->pipeline, IPE_COUNTER_INCOMPLETE);
    for (unsigned i = 0; i < d->option.n_buses; ++i) {
        n += health_bus_counts(d, i)->n_dropped + health_bus_counts(d, i)->n_controller_overruns;
    }
    return n;
}

void health_carry(daemon_t* d, const ipe_pipeline_t* p)
{
    uint64_t value;
    for (unsigned k = 0; ipe_pipeline_counter(p, k, &value) != NULL; ++k) { d->carried.counter[k] += value; }
    d->carried.n_rejected += ipe_pipeline_counter_sum(p, IPE_COUNTER_REJECTED);
    d->carried.n_incomplete += ipe_pipeline_counter_sum(p, IPE_COUNTER_INCOMPLETE);
}

void health_carried(daemon_t* d, const ipe_pipeline_t* p)
{
    uint64_t value;
    for (unsigned k = 0; ipe_pipeline_counter(p, k, &value) != NULL; ++k) { d->carried.counter[k] -= value; }
    d->carried.n_rejected -= ipe_pipeline_counter_sum(p, IPE_COUNTER_REJECTED);
    d->carried.n_incomplete -= ipe_pipeline_counter_sum(p, IPE_COUNTER_INCOMPLETE);
}

static double age_of(const daemon_t* d, ipe_sensor_t sensor, int64_t now_ns)
{
    const int64_t newest_ns = daemon_newest_sample(d, sensor);
    return newest_ns == 0 ? -1.0 : (double)(now_ns - newest_ns) / (double)NS_PER_S;
}

void health_send(daemon_t* d, int64_t now_ns)
{
    ipe_health_t h = {.counters = &d->counters,
                      .is_frozen = d->pipeline->is_frozen,
                      .n_buses = d->option.n_buses,
                      .n_latencies = IPE_LATENCIES_MAX,
                      .latency = {{"decoded", &d->decoded}, {"estimate", &d->estimated}}};
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) { h.age[s] = age_of(d, (ipe_sensor_t)s, now_ns); }
    for (unsigned i = 0; i < h.n_buses; ++i) {
        h.bus[i].name = health_bus_name(d, i);
        h.bus[i].is_up = d->n_interfaces == 0 || d->interface[i].is_up;
        h.bus[i].condition = d->bus_state[i].condition;
    }
    health_count(d);
    ipe_publish_health(&d->publisher, now_ns, &h);
    ipe_publish_config(&d->publisher, d->config_bytes, d->n_config_bytes);
    d->was_health_sent = true;
}

static void print_latency(const char* name, const ipe_histogram_t* h)
{
    if (h->n == 0) { return; }
    ipe_message("latency.%s: %" PRIu64 " times, p50 %.1f us, p99 %.1f us, p99.9 %.1f us, longest %.1f us", name, h->n,
                1e6 * ipe_histogram_quantile(h, 0.5), 1e6 * ipe_histogram_quantile(h, 0.99),
                1e6 * ipe_histogram_quantile(h, 0.999), 1e6 * ipe_histogram_quantile(h, 1.0));
}

void health_describe_lateness(const daemon_t* d, ipe_sensor_t sensor, char* text, size_t size)
{
    const double rate = d->config.sample_rate, step = 0.05;  // s, of the advice
    const double late = (double)ipe_align_lateness(&d->pipeline->align, sensor).largest_ns / (double)NS_PER_S;
    const double advice = step * ceil(late / step);
    const double limit = rate > 0.0 ? fmin(IPE_MAX_WAIT, IPE_WAIT_MAX / rate) : IPE_MAX_WAIT;
    if (advice <= limit) {
        (void)snprintf(text, size,
                       "samples arrive up to %.3f s late; rows wait %g s: raise align.max_wait to at least %.2f", late,
                       d->config.max_wait, advice);
    } else {
        (void)snprintf(
            text, size,
            "samples arrive up to %.3f s late; rows wait %g s, and align.max_wait can be at most %g: deliver the "
            "samples sooner",
            late, d->config.max_wait, limit);
    }
}

void health_print(const daemon_t* d)
{
    char text[REASON_SIZE];
    ipe_counters_print(&d->counters, d->option.is_verbose);
    print_latency("decoded", &d->decoded);
    print_latency("estimate", &d->estimated);
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        if (ipe_align_lateness(&d->pipeline->align, (ipe_sensor_t)s).n_too_late == 0) { continue; }
        health_describe_lateness(d, (ipe_sensor_t)s, text, sizeof text);
        ipe_message("%s: %s", health_sensor_name((ipe_sensor_t)s), text);
    }
}
