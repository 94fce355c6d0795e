// SPDX-License-Identifier: Apache-2.0
#include "clock.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#define WINDOW_S 60.0  // s that the hull looks back, chosen: long enough for prompt stamps, short for drift
#define FIRST_BLOCK_S (1.0 / 64.0)  // s, of the first blocks of stamps: chosen so that IN_PACE of them take 1/8 s
#define SETTLED_S 1.0               // before, the line may still lie late because the first stamps were
#define STANDS_S 1e-3   // s: a line that earlier stamps moved by less stands still; the accuracy that alignment needs
#define IN_PACE 8       // blocks whose stamps keep the device's pace from the start need not be waited for
#define PROMPT_S 0.02   // s, mean lateness of a host that does not stall; `make test-unit T=clock` tries 300 that do
#define PATIENCE_S 5.0  // s, chosen: how long one that stalls is waited for
#define RATE_TOLERANCE 300e-6  // while the rate is taken as 1: three times the 100 ppm of a poor quartz
#define RATE_LIMIT 500e-6      // of a device's clock: five times the 100 ppm of a poor quartz
// A clock was stepped if
#define STEP_EARLY_S 0.02     // a stamp is this much before the line;
#define STEP_BACK_S 0.5       // or device time goes back by this much at once,
#define STEP_BACK_IN_A_ROW 4  // or this many samples are older than the newest: more than reordering explains;
#define STEP_SMALLEST_S 1e-3  // or stamps are off the line by this and three times their scatter,
#define STEP_IN_A_ROW 16      // this many in a row,
#define STEP_LATE_FOR_S 2.0   // those after the line for this long: a busy host is late as well, but not always;
#define STEP_LATE_S 2.0       // or for this much,
#define STEP_OVER_S 0.05      // if that does not shrink meanwhile

static const int64_t EARLIEST_NS = INT64_C(-100000000000000000);  // three years before 0, where simulated time begins

void ipe_clock_init(ipe_clock_t* c, double wrap, double min_rate_span)
{
    memset(c, 0, sizeof *c);
    c->wrap = wrap;
    c->min_rate_span = min_rate_span;
}

static void start(ipe_clock_t* c, double device, int64_t host_ns)
{
    c->is_started = true;
    c->is_settled = false;
    c->last_raw = device;
    c->unwrapped = 0.0;
    c->device_0 = device;
    c->newest = 0.0;
    c->n_back = 0;
    c->off_side = 0;
    c->n_off = 0;
    c->host_0_ns = host_ns;
    c->n_points = 0;
    c->block = FIRST_BLOCK_S;
    c->block_end = -1.0;
    c->offset = 0.0;
    c->rate = 1.0;
}

/// A late sample from before a wrap belongs to before it.
static double unwrap(ipe_clock_t* c, double device)
{
    if (c->wrap > 0.0) {
        c->unwrapped += c->wrap * ((device < c->last_raw - 0.5 * c->wrap) - (device > c->last_raw + 0.5 * c->wrap));
    }
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

/// Rate 1 and the smallest offset seen: a short record determines no more.
static void fit_offset(ipe_clock_t* c)
{
    c->rate = 1.0;
    c->offset = c->point[0].host - c->point[0].device;
    for (int i = 1; i < c->n_points; ++i) { c->offset = fmin(c->offset, c->point[i].host - c->point[i].device); }
}

static double slope(const ipe_clock_t* c, int i, int j)
{
    return (c->point[j].host - c->point[i].host) / (c->point[j].device - c->point[i].device);
}

/// Lower hull of the points by a monotone chain; the edge over the mean device time gives rate and offset. Edges that no
/// clock is as fast or slow as lead to stamps that were late together: the next one towards the others is taken.
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
    const double limit = c->min_rate_span > 0.0 ? RATE_LIMIT : INFINITY;
    while (k < n - 2 && slope(c, hull[k], hull[k + 1]) < 1.0 - limit) { ++k; }
    while (k > 0 && slope(c, hull[k], hull[k + 1]) > 1.0 + limit) { --k; }
    c->rate = slope(c, hull[k], hull[k + 1]);
    c->offset = c->point[hull[k]].host - c->rate * c->point[hull[k]].device;
    if (!(fabs(c->rate - 1.0) <= limit)) { fit_offset(c); }
}

/// How far stamps scatter after the line: the mean of the blocks' earliest.
static double scatter(const ipe_clock_t* c)
{
    double sum = 0.0;
    for (int i = 0; i < c->n_points; ++i) { sum += fabs(c->point[i].host - c->offset - c->rate * c->point[i].device); }
    return sum / c->n_points;
}

/// Did all stamps so far keep the device's pace? Those that a stall held up come together.
static bool kept_pace(const ipe_clock_t* c)
{
    double latest = 0.0;
    for (int i = 0; i < c->n_points; ++i) {
        latest = fmax(latest, c->point[i].host - c->offset - c->rate * c->point[i].device);
    }
    return c->n_points >= IN_PACE && latest < STANDS_S;
}

/// Do the earliest stamps of the last second lie where the earliest before it do, and were most of them about as prompt?
/// A host that stalls again and again has none that were prompt; one that is never better is believed after a while.
static bool stands_still(const ipe_clock_t* c, double device)
{
    double before = INFINITY, since = INFINITY, sum = 0.0;
    int n = 0;
    for (int i = 0; i < c->n_points; ++i) {
        const double late = c->point[i].host - c->offset - c->rate * c->point[i].device;
        if (c->point[i].device <= device - SETTLED_S) {
            before = fmin(before, late);
        } else {
            since = fmin(since, late);
            sum += late;
            ++n;
        }
    }
    return fabs(since - before) < STANDS_S && (sum < PROMPT_S * n || device > PATIENCE_S);
}

/// Host time of a time since the first stamp [s]. Device times that no clock shows give an end of the range, from which
/// differences still fit.
static int64_t host_time(const ipe_clock_t* c, double since)
{
    const double ns = 1e9 * since;
    if (!(ns > (double)(EARLIEST_NS - c->host_0_ns))) { return EARLIEST_NS; }
    if (ns >= (double)(IPE_TIME_MAX_NS - c->host_0_ns)) { return IPE_TIME_MAX_NS; }
    return c->host_0_ns + (int64_t)llround(ns);
}

static void settle(ipe_clock_t* c, double device)
{
    c->is_settled = kept_pace(c) || stands_still(c, device);
    c->settled_ns = host_time(c, c->offset + c->rate * device);
}

static void fit(ipe_clock_t* c)
{
    if (c->n_points < 2 || c->point[c->n_points - 1].device - c->point[0].device < c->min_rate_span) {
        fit_offset(c);
    } else {
        fit_line(c);
    }
    c->scatter = scatter(c);
}

static void learn(ipe_clock_t* c, double device, double host)
{
    assert(c->n_points >= 0 && c->n_points <= IPE_CLOCK_POINTS);
    if (c->n_points > 0 && device < c->point[c->n_points - 1].device) { return; }  // reordered: its block may be over
    if (c->n_points == 0 || device >= c->block_end) {
        if (c->n_points > 0) { fit(c); }
        if (!c->is_settled) { settle(c, device); }
        make_room(c);
        c->point[c->n_points].device = device;
        c->point[c->n_points].host = host;
        ++c->n_points;
        c->block_end = device + c->block;
        if (c->n_points == 1) { fit(c); }
        return;
    }
    const int newest = c->n_points - 1;
    if (host - device >= c->point[newest].host - c->point[newest].device) { return; }
    c->point[newest].device = device;
    c->point[newest].host = host;
    if (device < SETTLED_S) { fit(c); }
}

/// Has device time gone back? One late sample is reordering, not a step.
static bool went_back(ipe_clock_t* c, double x)
{
    c->n_back = x < c->newest ? c->n_back + 1 : 0;
    const bool is_step = x < c->newest - STEP_BACK_S || c->n_back >= STEP_BACK_IN_A_ROW;
    c->newest = fmax(c->newest, x);
    return is_step;
}

/// How far off the line a stamp may be before that means anything.
static double tolerance(const ipe_clock_t* c, double x)
{
    const double since = x - c->point[0].device;
    const double drift = c->newest - c->point[0].device < c->min_rate_span ? RATE_TOLERANCE * since : 0.0;
    return STEP_SMALLEST_S + drift + 3.0 * c->scatter;
}

/// Have stamps left the line to one side for good? Until that is known those before the line are not learnt from, but for
/// the earliest of a few: a host that is seldom prompt.
static bool left_line(ipe_clock_t* c, double x, double y)
{
    const double late = y - (c->offset + c->rate * x);
    const bool is_early = x > SETTLED_S && late<-tolerance(c, x), is_late = late> tolerance(c, x);
    const int side = is_early ? -1 : is_late ? 1 : 0;
    if (side != c->off_side) {
        if (c->off_side < 0 && c->n_off < STEP_IN_A_ROW) { learn(c, c->early.device, c->early.host); }
        c->off_side = side;
        c->n_off = 0;
        c->off_device = x, c->off_host = y;
    }
    if (c->n_off++ == 0 || y - x < c->early.host - c->early.device) { c->early.device = x, c->early.host = y; }
    if (side == 0 || c->n_off < STEP_IN_A_ROW) { return false; }
    const double device = x - c->off_device, host = y - c->off_host;
    const bool catches_up = host < 0.5 * device;  // a stalled host stamps what it missed in a burst
    return is_early || host > STEP_LATE_FOR_S || (late > STEP_LATE_S && device > STEP_OVER_S && !catches_up);
}

static bool is_stepped(ipe_clock_t* c, double x, double y)
{
    if (c->n_points == 0) { return false; }
    const double late = y - (c->offset + c->rate * x);
    return went_back(c, x) || late < -STEP_EARLY_S || left_line(c, x, y);
}

int64_t ipe_clock_map(ipe_clock_t* c, double device, int64_t host_ns)
{
    if (!c->is_started) { start(c, device, host_ns); }
    double x = unwrap(c, device);
    double y = 1e-9 * (double)(host_ns - c->host_0_ns);
    if (is_stepped(c, x, y)) {
        ++c->n_steps;
        start(c, device, host_ns);
        x = 0.0, y = 0.0;
    }
    if (c->off_side >= 0) { learn(c, x, y); }
    return host_time(c, c->offset + c->rate * x);
}

int64_t ipe_clock_at(const ipe_clock_t* c, double device)
{
    const double x = device + c->unwrapped - c->device_0;
    return host_time(c, c->offset + c->rate * x);
}
