// SPDX-License-Identifier: Apache-2.0
#include "clock.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#define WINDOW_S 60.0        // hull looks back this far
#define FIRST_BLOCK_S (1.0 / 64.0)
#define MIN_RATE_SPAN_S 5.0  // below this the rate is taken as 1
#define STEP_EARLY_S 0.02    // a stamp this much before the line, or
#define STEP_LATE_S 2.0      // this much after it: a clock was stepped

void ipe_clock_init(ipe_clock_t* c, double wrap)
{
    memset(c, 0, sizeof *c);
    c->wrap = wrap;
}

static void start(ipe_clock_t* c, double device, int64_t host_ns)
{
    c->is_started = true;
    c->last_raw = device;
    c->unwrapped = 0.0;
    c->device_0 = device;
    c->host_0_ns = host_ns;
    c->n_points = 0;
    c->block = FIRST_BLOCK_S;
    c->block_end = -1.0;
    c->offset = 0.0;
    c->rate = 1.0;
}

static double unwrap(ipe_clock_t* c, double device)
{
    if (c->wrap > 0.0 && device < c->last_raw - 0.5 * c->wrap) { c->unwrapped += c->wrap; }
    c->last_raw = device;
    return device + c->unwrapped - c->device_0;
}

/// Keep the earlier arrival of each pair of blocks; blocks are then twice as long.
static void merge_blocks(ipe_clock_t* c)
{
    for (int i = 0; i < IPE_CLOCK_POINTS / 2; ++i) {
        const double first = c->point[2 * i].host - c->point[2 * i].device;
        const double second = c->point[2 * i + 1].host - c->point[2 * i + 1].device;
        c->point[i] = c->point[first <= second ? 2 * i : 2 * i + 1];
    }
    c->n_points = IPE_CLOCK_POINTS / 2;
    c->block *= 2.0;
}

static void make_room(ipe_clock_t* c)
{
    if (c->n_points < IPE_CLOCK_POINTS) { return; }
    if (c->block * IPE_CLOCK_POINTS < WINDOW_S) {
        merge_blocks(c);
    } else {
        memmove(&c->point[0], &c->point[1], sizeof c->point[0] * (IPE_CLOCK_POINTS - 1));
        --c->n_points;
    }
}

/// Lower hull of the points by a monotone chain; the edge over the mean device time gives rate and offset.
static void fit_line(ipe_clock_t* c)
{
    int hull[IPE_CLOCK_POINTS] = {0};
    int n = 0;
    double mean = 0.0;
    for (int i = 0; i < c->n_points; ++i) {
        const double x = c->point[i].device, y = c->point[i].host;
        mean += x / c->n_points;
        while (n >= 2) {
            const double ax = c->point[hull[n - 2]].device, ay = c->point[hull[n - 2]].host;
            const double bx = c->point[hull[n - 1]].device, by = c->point[hull[n - 1]].host;
            if ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0) { break; }
            --n;
        }
        hull[n++] = i;
    }
    int k = 0;
    while (k < n - 2 && c->point[hull[k + 1]].device < mean) { ++k; }
    const double dx = c->point[hull[k + 1]].device - c->point[hull[k]].device;
    c->rate = (c->point[hull[k + 1]].host - c->point[hull[k]].host) / dx;
    c->offset = c->point[hull[k]].host - c->rate * c->point[hull[k]].device;
}

/// Rate 1 and the smallest offset seen: all that a short record tells.
static void fit_offset(ipe_clock_t* c)
{
    c->rate = 1.0;
    c->offset = c->point[0].host - c->point[0].device;
    for (int i = 1; i < c->n_points; ++i) { c->offset = fmin(c->offset, c->point[i].host - c->point[i].device); }
}

static void fit(ipe_clock_t* c)
{
    if (c->point[c->n_points - 1].device - c->point[0].device < MIN_RATE_SPAN_S) {
        fit_offset(c);
    } else {
        fit_line(c);
    }
}

static void learn(ipe_clock_t* c, double device, double host)
{
    assert(c->n_points >= 0 && c->n_points <= IPE_CLOCK_POINTS);
    if (c->n_points == 0 || device >= c->block_end) {
        if (c->n_points > 0) { fit(c); }
        make_room(c);
        c->point[c->n_points].device = device;
        c->point[c->n_points].host = host;
        ++c->n_points;
        c->block_end = device + c->block;
        if (c->n_points == 1) { fit(c); }
        return;
    }
    const int newest = c->n_points - 1;
    if (host - device < c->point[newest].host - c->point[newest].device) {
        c->point[newest].device = device;
        c->point[newest].host = host;
    }
}

int64_t ipe_clock_map(ipe_clock_t* c, double device, int64_t host_ns)
{
    if (!c->is_started) { start(c, device, host_ns); }
    double x = unwrap(c, device);
    double y = 1e-9 * (double)(host_ns - c->host_0_ns);
    const double late = y - (c->offset + c->rate * x);
    if (c->n_points > 0 && (late < -STEP_EARLY_S || late > STEP_LATE_S)) {
        ++c->n_steps;
        start(c, device, host_ns);
        x = 0.0, y = 0.0;
    }
    learn(c, x, y);
    return c->host_0_ns + (int64_t)llround(1e9 * (c->offset + c->rate * x));
}
