// SPDX-License-Identifier: Apache-2.0
#include "replay.h"

#include <math.h>
#include <string.h>
#include <time.h>

static const double NEVER_NS = 4e18;  // after the start: a century

static int64_t monotonic_ns(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/// The input that comes next.
typedef struct {
    ipe_source_status_t status;  ///< WAIT: of source or tracker; END: no input has anything left
    ipe_source_file_t* source;   ///< NULL: the tracker
    int64_t t_ns;
} choice_t;

static choice_t choose(ipe_replay_t* r)
{
    choice_t best = {IPE_SOURCE_END, NULL, INT64_MAX};
    for (unsigned i = 0; i < r->n_buses; ++i) {
        ipe_source_file_t* s = &r->bus[i];
        const ipe_source_status_t status = ipe_source_file_peek(s);
        if (status == IPE_SOURCE_WAIT) { return (choice_t){status, s, 0}; }
        if (status == IPE_SOURCE_READY && s->head.t_ns < best.t_ns) { best = (choice_t){status, s, s->head.t_ns}; }
    }
    if (!r->has_tracker) { return best; }
    const ipe_source_status_t status = ipe_source_tracker_file_peek(&r->tracker);
    if (status == IPE_SOURCE_WAIT) { return (choice_t){status, NULL, 0}; }
    if (status == IPE_SOURCE_READY && r->tracker.head.t_ns < best.t_ns) {
        best = (choice_t){status, NULL, r->tracker.head.t_ns};
    }
    return best;
}

/// True if the item stamped t_ns has to wait, until *due_ns. The first item is due at once and sets the time base.
static bool is_early(ipe_replay_t* r, int64_t t_ns, int64_t* due_ns)
{
    if (r->speed <= 0.0) { return false; }
    const int64_t now_ns = monotonic_ns();
    if (!r->is_started) {
        r->is_started = true;
        r->log_0_ns = t_ns;
        r->clock_0_ns = now_ns;
    }
    *due_ns = r->clock_0_ns + llround(fmin((double)(t_ns - r->log_0_ns) / r->speed, NEVER_NS));
    return *due_ns > now_ns;
}

static ipe_replay_status_t next_step(ipe_replay_t* r, ipe_replay_item_t* item)
{
    switch (ipe_lock_step_next(&r->lock_step)) {
    case IPE_LOCK_STEP_FRAME:
        item->frame = &r->lock_step.frame;
        ipe_bus_count(&r->bus[item->frame->bus].counts, item->frame);
        return IPE_REPLAY_FRAME;
    case IPE_LOCK_STEP_POSITION: item->position = &r->lock_step.position; return IPE_REPLAY_POSITION;
    case IPE_LOCK_STEP_COMMAND: return IPE_REPLAY_COMMAND;
    case IPE_LOCK_STEP_ANSWER: return IPE_REPLAY_ANSWER;
    case IPE_LOCK_STEP_WAIT: item->fd = r->lock_step.lines.fd; return IPE_REPLAY_WAIT;
    case IPE_LOCK_STEP_END:
    default: return IPE_REPLAY_END;
    }
}

ipe_replay_status_t ipe_replay_next(ipe_replay_t* r, ipe_replay_item_t* item)
{
    if (r->is_lock_step) { return next_step(r, item); }
    const choice_t next = choose(r);
    if (next.status == IPE_SOURCE_END) { return IPE_REPLAY_END; }
    if (next.status == IPE_SOURCE_WAIT) {
        item->fd = next.source != NULL ? next.source->lines.fd : r->tracker.lines.fd;
        return IPE_REPLAY_WAIT;
    }
    if (is_early(r, next.t_ns, &item->due_ns)) { return IPE_REPLAY_EARLY; }
    if (next.source == NULL) {
        ipe_source_tracker_file_take(&r->tracker);
        item->position = &r->tracker.head;
        return IPE_REPLAY_POSITION;
    }
    ipe_source_file_take(next.source);
    item->frame = &next.source->head;
    return IPE_REPLAY_FRAME;
}

void ipe_replay_fill(ipe_replay_t* r)
{
    if (r->is_lock_step) {
        ipe_lock_step_fill(&r->lock_step);
        return;
    }
    const choice_t next = choose(r);
    if (next.status != IPE_SOURCE_WAIT) { return; }
    if (next.source != NULL) {
        ipe_source_file_fill(next.source);
    } else {
        ipe_source_tracker_file_fill(&r->tracker);
    }
}

void ipe_replay_close(ipe_replay_t* r)
{
    for (unsigned i = 0; i < r->n_buses; ++i) { ipe_source_file_close(&r->bus[i]); }
    if (r->has_tracker) { ipe_source_tracker_file_close(&r->tracker); }
}
