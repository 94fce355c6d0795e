// SPDX-License-Identifier: Apache-2.0
#include "publish.h"

#include "inertiad_lcm_estimate_t.h"
#include "inertiad_lcm_event_t.h"
#include "inertiad_lcm_health_t.h"
#include "inertiad_lcm_host_t.h"
#include "inertiad_lcm_order_t.h"
#include "inertiad_lcm_raw_t.h"
#include "inertiad_lcm_signals_t.h"
#include "inertiad_lcm_tracker_t.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { PREFIX_MAX = 40, RAW_PER_ORDER = 6 };  // about 0.1 s
static const int64_t BLOCK_NS = 16000000;

/// Fields and their counterparts in a message have the same size, or this does not compile.
#define COPY(to, from)                                                               \
    do {                                                                             \
        static_assert(sizeof(to) == sizeof(from), "field differs from the message"); \
        memcpy((to), (from), sizeof(to));                                            \
    } while (0)

static bool is_good_prefix(const char* prefix)
{
    static const char ALLOWED[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-/";
    const size_t n = strlen(prefix);
    return n >= 1 && n <= PREFIX_MAX && strspn(prefix, ALLOWED) == n;
}

static void name_channels(ipe_publish_t* p, const char* prefix)
{
    static const char* const NAME[IPE_PUBLISH_COUNT] = {"RAW",   "SIGNALS", "ESTIMATE", "HEALTH", "EVENT", "HOST",
                                                        "ORDER", "TRACKER", "COMMAND",  "CONFIG", "ANSWER"};
    for (int i = 0; i < IPE_PUBLISH_COUNT; ++i) {
        (void)snprintf(p->channel[i], sizeof p->channel[i], "%.*s%s", PREFIX_MAX, prefix, NAME[i]);
    }
}

int ipe_publish_check_prefix(const char* prefix, char* message, size_t size)
{
    if (is_good_prefix(prefix)) { return 0; }
    (void)snprintf(message, size, "prefix \"%s\": allowed are 1 to %d letters, digits, '_', '-', '/'", prefix,
                   PREFIX_MAX);
    return -1;
}

int ipe_publish_open(ipe_publish_t* p, const char* url, const char* prefix, const ipe_config_t* config, char* message,
                     size_t size)
{
    memset(p, 0, sizeof *p);
    ipe_publish_configure(p, config);
    if (ipe_publish_check_prefix(prefix, message, size) != 0) { return -1; }
    name_channels(p, prefix);
    if (strcmp(url, "none") == 0) { return 0; }
    p->lcm = lcm_create(url);
    if (p->lcm != NULL) { return 0; }
    (void)snprintf(message, size,
                   "%s: cannot open; without a route for multicast: "
                   "ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo; or go without: --lcm none",
                   url);
    return -1;
}

void ipe_publish_record(ipe_publish_t* p, ipe_record_t* record)
{
    p->record = record;
}

void ipe_publish_lock_step(ipe_publish_t* p, ipe_lock_step_t* lock_step)
{
    p->lock_step = lock_step;
}

bool ipe_publish_lock_step_answer(ipe_publish_t* p, int64_t t_ns)
{
    ipe_lock_step_put(p->lock_step, p->channel[IPE_PUBLISH_ANSWER], t_ns, NULL, 0);
    return ipe_lock_step_send(p->lock_step);
}

static bool is_on(const ipe_publish_t* p)
{
    return p->lcm != NULL || p->record != NULL || p->lock_step != NULL;
}

void ipe_publish_received(ipe_publish_t* p, ipe_publish_channel_t channel, int64_t t_ns, const uint8_t* data, size_t n)
{
    if (p->record != NULL) { ipe_record_push(p->record, p->channel[channel], t_ns, data, n); }
}

/// Send n encoded bytes; n < 0: they could not be encoded. True when sent.
static bool send_bytes(ipe_publish_t* p, ipe_publish_channel_t channel, const uint8_t* data, int n)
{
    if (n >= 0 && lcm_publish(p->lcm, p->channel[channel], data, (unsigned)n) == 0) {
        p->n_messages++;
        return true;
    }
    p->n_failed++;
    if (ipe_message_allowed(&p->limit, "LCM")) {
        ipe_message("%s: a message of %d bytes was not sent", p->channel[channel], n);
    }
    return false;
}

/// Send and record the n bytes of p->bytes at data time t_ns; n < 0: they could not be encoded. True when sent.
static bool send(ipe_publish_t* p, ipe_publish_channel_t channel, int64_t t_ns, int n)
{
    p->sequence[channel]++;
    if (n >= 0 && p->record != NULL) { ipe_record_push(p->record, p->channel[channel], t_ns, p->bytes, (size_t)n); }
    const bool is_answered = channel == IPE_PUBLISH_ESTIMATE || channel == IPE_PUBLISH_EVENT;
    if (n >= 0 && p->lock_step != NULL && is_answered) {
        ipe_lock_step_put(p->lock_step, p->channel[channel], t_ns, p->bytes, (size_t)n);
    }
    return p->lcm == NULL ? n >= 0 : send_bytes(p, channel, p->bytes, n);
}

static void send_order(ipe_publish_t* p)
{
    if (p->n_items < 1 || p->n_items > IPE_PUBLISH_ITEMS) { return; }  // none; more there never are
    const inertiad_lcm_order_t message = {.sequence = p->sequence[IPE_PUBLISH_ORDER],
                                          .t_ns = p->order_ns,
                                          .n_dropped = (int64_t)p->n_items_failed,
                                          .n_items = p->n_items,
                                          .item = p->item};
    const int n = inertiad_lcm_order_t_encode(p->bytes, 0, sizeof p->bytes, &message);
    if (!send(p, IPE_PUBLISH_ORDER, message.t_ns, n)) { p->n_items_failed += (uint64_t)p->n_items; }
    p->n_items = 0;
}

static void send_frames(ipe_publish_t* p)
{
    if (p->n_frames == 0) { return; }
    const inertiad_lcm_raw_t message = {.sequence = p->sequence[IPE_PUBLISH_RAW],
                                        .t_ns = p->frame[p->n_frames - 1].t_ns,
                                        .n_dropped = (int64_t)p->n_frames_failed,
                                        .n_frames = p->n_frames,
                                        .frame = p->frame};
    const int n = inertiad_lcm_raw_t_encode(p->bytes, 0, sizeof p->bytes, &message);
    if (!send(p, IPE_PUBLISH_RAW, message.t_ns, n)) { p->n_frames_failed += (uint64_t)p->n_frames; }
    p->n_frames = 0;
    if (p->n_items > 0 && p->sequence[IPE_PUBLISH_RAW] - p->item[0].raw >= RAW_PER_ORDER) { send_order(p); }
}

static void send_rows(ipe_publish_t* p)
{
    if (p->n_rows == 0) { return; }
    const inertiad_lcm_signals_t message = {.sequence = p->sequence[IPE_PUBLISH_SIGNALS],
                                            .t_ns = p->row[p->n_rows - 1].t_ns,
                                            .n_dropped = (int64_t)p->n_input_dropped,
                                            .n_rows = p->n_rows,
                                            .row = p->row};
    (void)send(p, IPE_PUBLISH_SIGNALS, message.t_ns,
               inertiad_lcm_signals_t_encode(p->bytes, 0, sizeof p->bytes, &message));
    p->n_rows = 0;
}

/// True if an item stamped t_ns does not belong into a block that began at first_ns.
static bool is_past_block(int64_t first_ns, int64_t t_ns)
{
    return t_ns < first_ns || t_ns - first_ns >= BLOCK_NS;
}

void ipe_publish_frame(ipe_publish_t* p, const ipe_frame_t* frame)
{
    if (!is_on(p)) { return; }
    if (p->n_frames > 0 && is_past_block(p->frame[0].t_ns, frame->t_ns)) { send_frames(p); }
    uint8_t* data = p->frame_data[p->n_frames];
    memcpy(data, frame->data, frame->length);
    p->frame[p->n_frames++] = (inertiad_lcm_can_frame_t){.t_ns = frame->t_ns,
                                                         .t_hw_ns = frame->t_hw_ns,
                                                         .can_id = (int32_t)frame->can_id,
                                                         .bus = (int8_t)frame->bus,
                                                         .flags = (int8_t)frame->flags,
                                                         .length = (int8_t)frame->length,
                                                         .data = data};
    if (p->n_frames == IPE_PUBLISH_FRAMES) { send_frames(p); }
}

/// Used at host time used_ns.
static void add_item(ipe_publish_t* p, int kind, int64_t used_ns, int64_t t_ns, const double* value)
{
    if (!is_on(p)) { return; }
    inertiad_lcm_order_item_t* item = &p->item[p->n_items++];
    *item = (inertiad_lcm_order_item_t){
        .raw = p->sequence[IPE_PUBLISH_RAW], .n_before = p->n_frames, .kind = (int8_t)kind, .t_ns = t_ns};
    if (value != NULL) { memcpy(item->value, value, sizeof item->value); }
    p->order_ns = used_ns;
    if (p->n_items == IPE_PUBLISH_ITEMS) { send_order(p); }
}

void ipe_publish_order(ipe_publish_t* p, int kind, int64_t t_ns, const double* value)
{
    add_item(p, kind, t_ns, t_ns, value);
}

void ipe_publish_expectation(ipe_publish_t* p, int64_t now_ns, const ipe_expectation_t* expectation)
{
    enum { IN_ITEM = 3, NUMBERS = INERTIAD_LCM_ORDER_ITEM_T_EXPECT_ITEMS * IN_ITEM };
    static_assert((int)IPE_ANNOUNCEMENT_NUMBERS <= NUMBERS && NUMBERS - (int)IPE_ANNOUNCEMENT_NUMBERS < IN_ITEM,
                  "EXPECT_ITEMS are as many as hold the numbers");
    double number[NUMBERS] = {0.0};
    memcpy(number, expectation->number, sizeof expectation->number);
    for (int i = 0; i < NUMBERS; i += IN_ITEM) {
        add_item(p, IPE_COMMAND_EXPECT, now_ns, expectation->t_ns, number + i);
    }
}

static void add_row(ipe_publish_t* p, const ipe_row_t* row)
{
    if (p->n_rows > 0 && is_past_block(p->row[0].t_ns, row->t_ns)) { send_rows(p); }
    inertiad_lcm_signals_row_t* to = &p->row[p->n_rows];
    to->t_ns = row->t_ns;
    COPY(to->acc, row->acc);
    COPY(to->gyro, row->gyro);
    COPY(to->q, row->q);
    COPY(to->position, row->position);
    to->n_cables = p->n_cables;
    to->f = p->row_f[p->n_rows];
    memcpy(to->f, row->f, sizeof row->f);
    p->n_rows++;
    if (p->n_rows == IPE_PUBLISH_ROWS) { send_rows(p); }
}

void ipe_publish_position(ipe_publish_t* p, int64_t t_ns, const double position[3])
{
    if (p->record == NULL) { return; }
    uint8_t bytes[256];
    inertiad_lcm_tracker_t message = {.sequence = p->sequence[IPE_PUBLISH_TRACKER]++, .t_ns = t_ns, .valid = 1};
    memcpy(message.position, position, sizeof message.position);
    const int n = inertiad_lcm_tracker_t_encode(bytes, 0, sizeof bytes, &message);
    if (n >= 0) { ipe_record_push(p->record, p->channel[IPE_PUBLISH_TRACKER], t_ns, bytes, (size_t)n); }
}

static void copy_estimate(inertiad_lcm_estimate_t* to, const ipe_estimate_t* from)
{
    to->schema = INERTIAD_LCM_ESTIMATE_T_SCHEMA;
    to->t_ns = from->t_ns;
    to->n_windows = (int64_t)from->n_windows;
    to->n_rows = (int64_t)from->n_rows;
    to->mass = from->body.mass;
    to->mass_std = from->body.mass_std;
    COPY(to->cog, from->body.cog);
    COPY(to->cog_std, from->body.cog_std);
    COPY(to->inertia_cog, from->body.inertia_cog);
    COPY(to->inertia_cog_std, from->body.inertia_cog_std);
    COPY(to->theta, from->theta);
    COPY(to->covariance, from->covariance);
    to->n_systematic = from->n_systematic;
    // The generated type has no const, and its encoder only reads.
    to->systematic = (double*)(uintptr_t)from->systematic;
    to->systematic_std = (double*)(uintptr_t)from->systematic_std;
    for (int i = 0; i < IPE_NP; ++i) { to->observable[i] = from->observable[i] ? 1 : 0; }
    to->consistent = from->consistent ? 1 : 0;
    to->distance = from->distance;
    to->nis = from->nis;
    to->n_changes = (int64_t)from->n_changes;
    to->provisional = from->is_provisional ? 1 : 0;
}

static bool all_are_finite(const double* value, size_t n)
{
    for (size_t i = 0; i < n; ++i) {
        if (!isfinite(value[i])) { return false; }
    }
    return true;
}

static bool is_finite(const ipe_estimate_t* e)
{
    return isfinite(e->body.mass) && isfinite(e->body.mass_std) && isfinite(e->nis) && all_are_finite(e->body.cog, 3) &&
           all_are_finite(e->body.cog_std, 3) && all_are_finite(e->body.inertia_cog, 6) &&
           all_are_finite(e->body.inertia_cog_std, 6) && all_are_finite(e->theta, IPE_NP) &&
           all_are_finite(&e->covariance[0][0], (size_t)IPE_NP * IPE_NP) &&
           all_are_finite(e->systematic, (size_t)e->n_systematic) &&
           all_are_finite(e->systematic_std, (size_t)e->n_systematic);
}

/// True once per period of data time; keeps its phase, and starts anew when time jumps.
static bool is_due(ipe_publish_t* p, int64_t now_ns)
{
    const int64_t late = now_ns - p->estimate_due_ns;
    if (p->has_estimate_due && late < 0 && late >= -p->estimate_period_ns) { return false; }
    const bool in_phase = p->has_estimate_due && late >= 0 && late < p->estimate_period_ns;
    p->estimate_due_ns = (in_phase ? p->estimate_due_ns : now_ns) + p->estimate_period_ns;
    p->has_estimate_due = true;
    return true;
}

/// True: sent.
static bool send_estimate(ipe_publish_t* p, int64_t now_ns, const ipe_estimate_t* estimate)
{
    if (estimate->n_windows == 0 || !is_due(p, now_ns)) { return false; }
    if (!is_finite(estimate)) {
        p->n_not_finite++;
        return false;
    }
    inertiad_lcm_estimate_t message = {.sequence = p->sequence[IPE_PUBLISH_ESTIMATE],
                                       .n_dropped = (int64_t)p->n_input_dropped,
                                       .systematic_name = p->systematic_names,
                                       .verdict = p->verdict};
    copy_estimate(&message, estimate);
    return send(p, IPE_PUBLISH_ESTIMATE, now_ns,
                inertiad_lcm_estimate_t_encode(p->bytes, 0, sizeof p->bytes, &message));
}

static_assert((int)IPE_SEVERITY_GOOD == INERTIAD_LCM_ESTIMATE_T_GOOD, "severities are numbered as in the message");
static_assert((int)IPE_SEVERITY_CARE == INERTIAD_LCM_ESTIMATE_T_CARE, "severities are numbered as in the message");
static_assert((int)IPE_SEVERITY_STOP == INERTIAD_LCM_ESTIMATE_T_STOP, "severities are numbered as in the message");

void ipe_publish_verdict(ipe_publish_t* p, ipe_severity_t verdict)
{
    p->verdict = (int8_t)verdict;
}

bool ipe_publish_row(ipe_publish_t* p, const ipe_row_t* row, const ipe_estimate_t* estimate, uint64_t n_dropped)
{
    if (!is_on(p)) { return false; }
    p->n_input_dropped = n_dropped;
    add_row(p, row);
    return send_estimate(p, row->t_ns, estimate);
}

static void copy_latency(inertiad_lcm_latency_t* to, int64_t bucket[IPE_HISTOGRAM_BUCKETS], const char* name,
                         const ipe_histogram_t* h)
{
    *to = (inertiad_lcm_latency_t){.name = (char*)(uintptr_t)name,
                                   .n = (int64_t)h->n,
                                   .p50 = ipe_histogram_quantile(h, 0.5),
                                   .p99 = ipe_histogram_quantile(h, 0.99),
                                   .p999 = ipe_histogram_quantile(h, 0.999),
                                   .longest = ipe_histogram_quantile(h, 1.0),
                                   .bucket = bucket};
    for (int b = 0; b < IPE_HISTOGRAM_BUCKETS; ++b) {
        bucket[b] = (int64_t)h->n_bucket[b];
        if (bucket[b] > 0) { to->n_buckets = b + 1; }
    }
}

void ipe_publish_health(ipe_publish_t* p, int64_t t_ns, const ipe_health_t* h)
{
    if (!is_on(p)) { return; }
    inertiad_lcm_bus_t bus[IPE_BUSES_MAX];
    inertiad_lcm_latency_t latency[IPE_LATENCIES_MAX];
    // The generated types have no const, and their encoders only read.
    for (unsigned i = 0; i < h->counters->n; ++i) {
        p->counter[i].name = (char*)(uintptr_t)h->counters->item[i].name;
        p->counter[i].value = (int64_t)h->counters->item[i].value;
    }
    for (unsigned i = 0; i < h->n_buses; ++i) {
        bus[i] = (inertiad_lcm_bus_t){.name = (char*)(uintptr_t)h->bus[i].name,
                                      .up = h->bus[i].is_up ? 1 : 0,
                                      .condition = (int8_t)h->bus[i].condition};
    }
    for (unsigned i = 0; i < h->n_latencies; ++i) {
        copy_latency(&latency[i], p->bucket[i], h->latency[i].name, h->latency[i].histogram);
    }
    inertiad_lcm_health_t message = {.sequence = p->sequence[IPE_PUBLISH_HEALTH],
                                     .t_ns = t_ns,
                                     .n_counters = (int32_t)h->counters->n,
                                     .counter = p->counter,
                                     .frozen = h->is_frozen ? 1 : 0,
                                     .n_buses = (int32_t)h->n_buses,
                                     .bus = bus,
                                     .n_latencies = (int32_t)h->n_latencies,
                                     .latency = latency};
    memcpy(message.age, h->age, sizeof message.age);
    (void)send(p, IPE_PUBLISH_HEALTH, t_ns, inertiad_lcm_health_t_encode(p->bytes, 0, sizeof p->bytes, &message));
}

void ipe_publish_host(ipe_publish_t* p, int64_t t_ns, const ipe_host_facts_t* facts)
{
    if (!is_on(p)) { return; }
    inertiad_lcm_fact_t fact[IPE_FACTS_MAX];
    for (unsigned i = 0; i < facts->n; ++i) {
        // The generated type has no const, and its encoder only reads.
        fact[i].name = (char*)(uintptr_t)facts->fact[i].name;
        fact[i].value = (char*)(uintptr_t)facts->fact[i].value;
    }
    const inertiad_lcm_host_t message = {
        .sequence = p->sequence[IPE_PUBLISH_HOST], .t_ns = t_ns, .n_facts = (int32_t)facts->n, .fact = fact};
    (void)send(p, IPE_PUBLISH_HOST, t_ns, inertiad_lcm_host_t_encode(p->bytes, 0, sizeof p->bytes, &message));
}

void ipe_publish_config(ipe_publish_t* p, const uint8_t* data, size_t n)
{
    if (p->lcm != NULL) { (void)send_bytes(p, IPE_PUBLISH_CONFIG, data, (int)n); }
}

static void send_event(ipe_publish_t* p, int64_t t_ns, inertiad_lcm_event_t message, const char* source,
                       const char* text)
{
    if (!is_on(p)) { return; }
    message.sequence = p->sequence[IPE_PUBLISH_EVENT];
    message.t_ns = t_ns;
    // The generated type has no const, and its encoder only reads.
    message.source = (char*)(uintptr_t)source;
    message.text = (char*)(uintptr_t)text;
    (void)send(p, IPE_PUBLISH_EVENT, t_ns, inertiad_lcm_event_t_encode(p->bytes, 0, sizeof p->bytes, &message));
}

void ipe_publish_event(ipe_publish_t* p, int64_t t_ns, const char* source, const char* text)
{
    send_event(p, t_ns, (inertiad_lcm_event_t){.kind = INERTIAD_LCM_EVENT_T_NEWS}, source, text);
}

void ipe_publish_answer(ipe_publish_t* p, int64_t t_ns, const ipe_command_t* command, bool is_done, const char* text)
{
    const inertiad_lcm_event_t message = {.kind = is_done ? INERTIAD_LCM_EVENT_T_DONE : INERTIAD_LCM_EVENT_T_REFUSED,
                                          .sender = command->sender,
                                          .command = command->sequence};
    send_event(p, t_ns, message, "command", text);
}

void ipe_publish_flush(ipe_publish_t* p)
{
    send_frames(p);
    send_order(p);
    send_rows(p);
}

void ipe_publish_configure(ipe_publish_t* p, const ipe_config_t* config)
{
    ipe_publish_flush(p);
    p->n_cables = config->n_cables;
    for (int i = 0; i < ipe_systematic_count(config->n_cables); ++i) {
        ipe_systematic_name(config->n_cables, i, p->systematic_name[i]);
        p->systematic_names[i] = p->systematic_name[i];
    }
    const int64_t period_ns = llround(1e9 / config->estimate_rate);
    p->has_estimate_due = p->has_estimate_due && period_ns == p->estimate_period_ns;  // the same rate keeps its phase
    p->estimate_period_ns = period_ns;
}

void ipe_publish_last(ipe_publish_t* p, const ipe_estimate_t* estimate, uint64_t n_dropped)
{
    if (!is_on(p)) { return; }
    p->n_input_dropped = n_dropped;
    ipe_publish_flush(p);
    p->has_estimate_due = false;
    (void)send_estimate(p, estimate->t_ns, estimate);
}

void ipe_publish_close(ipe_publish_t* p)
{
    if (p->lcm == NULL) { return; }
    lcm_destroy(p->lcm);
    p->lcm = NULL;
}

const char* ipe_publish_counter(const ipe_publish_t* p, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"messages", p->n_messages},
        {"failed", p->n_failed},
        {"estimates_not_finite", p->n_not_finite},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
