// SPDX-License-Identifier: Apache-2.0
#include "host_clock.h"

#include <string.h>

static const int64_t STEP_MIN_NS = 100000;
// Between the two readings around the third: longer, and we were interrupted.
static const int64_t READING_MAX_NS = 20000;
// A stamp may seem to be of the future, for the readings' sake.
static const int64_t FUTURE_NS = 50000;
static const int64_t BACKLOG_NS = 1000000000;
enum { ATTEMPTS = 8 };

static int64_t read_ns(const ipe_host_clock_t* c, clockid_t clock)
{
    struct timespec t = {0};
    (void)c->read(clock, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/// CLOCK_REALTIME less CLOCK_MONOTONIC; c->now_ns is set on the way. False: interrupted each time.
static bool read_offset(ipe_host_clock_t* c, int64_t* offset_ns)
{
    for (int i = 0; i < ATTEMPTS; ++i) {
        const int64_t before_ns = read_ns(c, CLOCK_MONOTONIC);
        const int64_t real_ns = read_ns(c, CLOCK_REALTIME);
        c->now_ns = read_ns(c, CLOCK_MONOTONIC);
        *offset_ns = real_ns - before_ns - (c->now_ns - before_ns) / 2;
        if (c->now_ns - before_ns <= READING_MAX_NS) { return true; }
    }
    return false;
}

void ipe_host_clock_init(ipe_host_clock_t* c, int (*read)(clockid_t clock, struct timespec* t))
{
    memset(c, 0, sizeof *c);
    c->read = read;
    (void)read_offset(c, &c->start_ns);
    c->offset_ns = c->start_ns;
    c->before_ns = c->start_ns;
}

bool ipe_host_clock_refresh(ipe_host_clock_t* c)
{
    int64_t offset_ns;
    if (!read_offset(c, &offset_ns)) { return false; }
    const int64_t step_ns = offset_ns - c->offset_ns;
    if (step_ns < STEP_MIN_NS && step_ns > -STEP_MIN_NS) { return false; }
    c->before_ns = c->offset_ns;
    c->offset_ns = offset_ns;
    c->stepped_ns = c->now_ns;
    c->step_ns = step_ns;
    c->n_steps++;
    return true;
}

int64_t ipe_host_clock_map(const ipe_host_clock_t* c, int64_t stamp_ns)
{
    const int64_t after_ns = c->now_ns - (stamp_ns - c->offset_ns);  // ages
    const int64_t before_ns = c->now_ns - (stamp_ns - c->before_ns);
    const bool is_fresh = c->n_steps > 0 && c->now_ns - c->stepped_ns < BACKLOG_NS;
    const bool is_before = is_fresh && before_ns >= -FUTURE_NS && (after_ns < -FUTURE_NS || before_ns < after_ns);
    return stamp_ns - (is_before ? c->before_ns : c->offset_ns) + c->start_ns;
}

int64_t ipe_host_clock_now(const ipe_host_clock_t* c)
{
    return read_ns(c, CLOCK_MONOTONIC) + c->start_ns;
}
