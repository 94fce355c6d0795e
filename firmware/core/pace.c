// SPDX-License-Identifier: Apache-2.0
#include "pace.h"

#include <math.h>
#include <string.h>

#define REGULAR 0.3         // of the period: intervals that differ by less agree
#define ON_LINE 0.5         // of the period: a stamp that near is its sample's
#define WHOLE 0.25          // of the period: a lateness that near to whole periods may be lost samples,
#define COUNTABLE 32        // more than that cannot be told to one sample: the line starts anew
#define AGREE 4             // if so many samples in a row say the same
#define MEASURE_S 0.015625  // and intervals over this long make a period
#define IRREGULAR_MAX 64    // intervals, then the mean of more has to do
#define GIVE_UP_S 1.0       // after so long without a sample in its place the period is measured again
#define COUNTED_LATE_S 2.0  // a counter is believed up to this lateness

void ipe_pace_init(ipe_pace_t* p)
{
    memset(p, 0, sizeof *p);
}

static double seconds(int64_t from_ns, int64_t to_ns)
{
    return 1e-9 * (double)(to_ns - from_ns);
}

/// The line starts at the newest sample, which is number 0.
static void start_line(ipe_pace_t* p, ipe_clock_t* clock, int64_t host_ns)
{
    const uint64_t n_steps = clock->n_steps;
    ipe_clock_init(clock, 0.0, 0.0);
    clock->n_steps = n_steps;
    p->index = 0;
    (void)ipe_clock_map(clock, 0.0, host_ns);
}

/// The newest n samples are settled, older ones that waited are dropped.
static int settle(ipe_pace_t* p, int n)
{
    n = n < IPE_PACE_HOLD ? n : IPE_PACE_HOLD;
    p->n_dropped += (uint64_t)(p->n_waiting - n);
    p->n_waiting = 0;
    p->n_agree = 0;
    return n;
}

/// Regular intervals for a while make a period. Where there are none, the mean has to do.
static int measure(ipe_pace_t* p, ipe_clock_t* clock, int64_t host_ns)
{
    const double interval = seconds(p->last_ns, host_ns);
    const double mean = p->n_waiting > 1 ? seconds(p->first_ns, p->last_ns) / (p->n_waiting - 1) : interval;
    const bool is_regular = interval > 0.0 && fabs(interval - mean) < REGULAR * mean;
    if (p->n_waiting > 0 && !is_regular && ++p->n_irregular < IRREGULAR_MAX) { (void)settle(p, 0); }
    if (p->n_waiting == 0) { p->first_ns = host_ns; }
    p->last_ns = host_ns;
    ++p->n_waiting;
    const double span = seconds(p->first_ns, host_ns);
    if (p->n_waiting < AGREE || span < MEASURE_S) { return 0; }
    p->period = span / (p->n_waiting - 1);
    p->n_irregular = 0;
    start_line(p, clock, host_ns);
    return settle(p, p->n_waiting);
}

static int measure_again(ipe_pace_t* p, ipe_clock_t* clock, int64_t host_ns)
{
    ++p->n_restarts;
    (void)settle(p, 0);
    p->period = 0.0;
    return measure(p, clock, host_ns);
}

/// How many lost samples would put one that is so late on its line; 0: no whole number of them.
static uint64_t samples_missing(const ipe_pace_t* p, double late)
{
    const double n = round(late / p->period);
    const bool is_whole = fabs(late - n * p->period) < WHOLE * p->period || n > COUNTABLE;
    return n > 0.0 && is_whole ? (uint64_t)n : 0;
}

int ipe_pace_push(ipe_pace_t* p, ipe_clock_t* clock, int64_t host_ns, uint64_t step)
{
    if (p->period == 0.0) { return measure(p, clock, host_ns); }
    uint64_t ahead = p->n_waiting == 0 && step > 0 ? step : (uint64_t)p->n_waiting + 1;
    const double late = seconds(ipe_clock_at(clock, p->period * (double)(p->index + ahead)), host_ns);
    const bool is_counted = step > 0 && late > -ON_LINE * p->period && late < COUNTED_LATE_S;
    if (p->n_waiting == 0) { p->first_ns = host_ns; }
    const bool is_lasting = p->n_waiting >= IPE_PACE_HOLD && seconds(p->first_ns, host_ns) > GIVE_UP_S;
    int n = is_counted || fabs(late) <= ON_LINE * p->period ? p->n_waiting + 1 : 0;
    if (n == 0 && is_lasting) { return measure_again(p, clock, host_ns); }
    ++p->n_waiting;
    if (n == 0) {
        const uint64_t missing = samples_missing(p, late);
        p->n_agree = missing > 0 && missing == p->n_missing ? p->n_agree + 1 : missing > 0;
        p->n_missing = missing;
        if (p->n_agree < AGREE) { return 0; }
        n = p->n_agree;
        p->n_lost += missing;
        ahead += missing;
        if (missing > COUNTABLE) {
            p->period *= clock->rate;
            start_line(p, clock, host_ns);
            return settle(p, n);
        }
    }
    p->index += ahead;
    (void)ipe_clock_map(clock, p->period * (double)p->index, host_ns);
    return settle(p, n);
}

int64_t ipe_pace_instant(const ipe_pace_t* p, const ipe_clock_t* clock, int before)
{
    return ipe_clock_at(clock, p->period * ((double)p->index - before));
}

void ipe_pace_end(ipe_pace_t* p)
{
    (void)settle(p, 0);
}
