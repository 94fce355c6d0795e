// SPDX-License-Identifier: Apache-2.0
#include "sample_timing.h"

#include <limits.h>
#include <math.h>
#include <string.h>

#define REGULAR 0.75       // of the mean, chosen under 1: an interval that differs by more is a lost or late sample
#define PERIOD_ERROR 0.01  // of the period, what a measured one may be off by: chosen over a poor quartz and jitter
#define ON_LINE 0.5        // of the period: chosen as half way to the next; a stamp that near is its sample's
#define WHOLE 0.25    // of the period, chosen so that half of all latenesses are that near to whole ones: lost samples,
#define COUNTABLE 32  // periods, chosen with PERIOD_ERROR: a longer gap cannot be counted to one sample
#define AGREE 4       // if so many samples in a row say the same, and
#define BY_CHANCE 1e-4  // that all of them are late for another reason is less likely: chosen as rare beside losses
#define PROMPT_0 0.75F  // share of prompt samples until it is known: chosen as an idle host's lower end,
#define PROMPT_STEP (1.0F / 128.0F)  // what one sample changes it by: chosen as a mean of the last hundred
#define LINE_S 1.0          // s that a new line reaches back over: chosen so that some of its stamps are prompt
#define MEASURE_S 0.015625  // s over which intervals make a period: chosen as a clock's first block (clock.c)
#define IRREGULAR_MAX 6     // intervals, chosen as most hosts need fewer; then the mean of IPE_SAMPLE_TIMING_HOLD is it
#define INTERVALS 1024      // that their mean is of: chosen so that stamps that scatter leave it 0.1 % off
#define GIVE_UP_S 1.0  // s without a sample in its place, chosen over a host's stalls: the period is measured again
#define EARLY_S \
    0.25  // s of early samples, chosen over a backlog that is read at once: more are a period that is too long
#define COUNTED_LATE_S 2.0  // s: a counter is believed up to this lateness, chosen over a host's longest stalls

void ipe_sample_timing_init(ipe_sample_timing_t* p)
{
    memset(p, 0, sizeof *p);
}

static double seconds(int64_t from_ns, int64_t to_ns)
{
    return 1e-9 * (double)(to_ns - from_ns);
}

/// The line starts: through the newest sample, and so long a piece before it that the next few do not turn it.
static void start_line(ipe_sample_timing_t* p, ipe_clock_t* clock, int64_t host_ns, int n)
{
    const uint64_t n_steps = clock->n_steps;
    const double span = p->period * n;
    ipe_clock_init(clock, 0.0, 0.0);
    clock->n_steps = n_steps;
    p->index = (uint64_t)n;
    (void)ipe_clock_map(clock, 0.0, host_ns - (int64_t)llround(1e9 * span));
    (void)ipe_clock_map(clock, span, host_ns);
}

/// The newest n samples are settled, older ones that waited are dropped.
static int settle(ipe_sample_timing_t* p, int n)
{
    n = n < IPE_SAMPLE_TIMING_HOLD ? n : IPE_SAMPLE_TIMING_HOLD;
    p->n_dropped += (uint64_t)(p->n_waiting - n);
    p->n_waiting = 0;
    return n;
}

/// Is the period known from those waiting? After each that turned out wrong twice as many must be regular.
static bool is_measured(const ipe_sample_timing_t* p, double span)
{
    const int n_regular = p->n_restarts < 4 ? AGREE << p->n_restarts : IPE_SAMPLE_TIMING_HOLD;
    const bool is_precise = (double)p->irregularity <= PERIOD_ERROR * (p->n_waiting - 1);
    if (is_precise && p->n_waiting >= n_regular && span >= MEASURE_S) { return true; }
    return p->n_waiting >= IPE_SAMPLE_TIMING_HOLD && span >= GIVE_UP_S;
}

/// Regular intervals in a row make a period, the more of them the less regular. Where there are none, the mean has to do.
static int measure(ipe_sample_timing_t* p, ipe_clock_t* clock, int64_t host_ns)
{
    const double interval = seconds(p->last_ns, host_ns);
    const double mean = p->n_waiting > 1 ? seconds(p->first_ns, p->last_ns) / (p->n_waiting - 1) : interval;
    const float off = mean > 0.0 ? (float)fabs(interval / mean - 1.0) : 1.0F;
    if (p->n_waiting > 0 && off > REGULAR && ++p->n_irregular < IRREGULAR_MAX) { (void)settle(p, 0); }
    if (p->n_waiting == 0) { p->first_ns = host_ns; }
    p->irregularity = p->n_waiting == 0 ? 0.0F : fmaxf(p->irregularity, off);
    p->last_ns = host_ns;
    ++p->n_waiting;
    const double span = seconds(p->first_ns, host_ns);
    if (!is_measured(p, span)) { return 0; }
    p->period = span / (p->n_waiting - 1);
    p->n_irregular = 0;
    p->prompt = PROMPT_0;
    p->interval = (float)p->period;
    p->n_intervals = p->n_waiting - 1;
    start_line(p, clock, host_ns, p->n_waiting - 1);
    return settle(p, p->n_waiting);
}

static int measure_again(ipe_sample_timing_t* p, ipe_clock_t* clock, int64_t host_ns)
{
    ++p->n_restarts;
    p->n_early = 0;
    (void)settle(p, 0);
    p->period = 0.0;
    return measure(p, clock, host_ns);
}

/// The mean interval, without those over which a sample was lost. Short ones count: they make up for late ones.
static void learn_interval(ipe_sample_timing_t* p, int64_t host_ns)
{
    const float interval = (float)seconds(p->last_ns, host_ns);
    p->last_ns = host_ns;
    if (interval >= (float)(1.0 + REGULAR) * p->interval) { return; }
    p->n_intervals += p->n_intervals < INTERVALS;
    p->interval += (interval - p->interval) / (float)p->n_intervals;
}

/// On a line that is too fast every sample is later than the one before, and soon one seems lost. Counting that one
/// keeps the line too fast. Only the intervals tell, once there are enough of them.
static bool is_too_fast(const ipe_sample_timing_t* p, const ipe_clock_t* clock)
{
    return p->n_intervals == INTERVALS && p->period * clock->rate < (1.0 - PERIOD_ERROR) * (double)p->interval;
}

/// Number of late samples in a row that is not chance, on a host that stamps this share in time.
static int enough(const ipe_sample_timing_t* p)
{
    const double late = fmax(1.0 - (double)p->prompt, 1e-9);
    return (int)fmax(AGREE, fmin(ceil(log(BY_CHANCE) / log(late)), IPE_SAMPLE_TIMING_HOLD));
}

/// No sample is stamped before its time. Samples that are all late by the same number of periods, or sometimes by more, show
/// that so many were lost. More are lost where as many in a row as chance does not make are late by more. Number of samples
/// that agree; 0: not enough yet.
static int agreeing(ipe_sample_timing_t* p, double late)
{
    const double n = fmin(round(late / p->period), INT_MAX);
    const bool is_whole = fabs(late - n * p->period) < WHOLE * p->period || n > COUNTABLE;
    const int missing = (int)n;
    if (p->n_waiting == 1 || missing < p->n_missing || p->n_same >= enough(p)) {
        const bool is_more = p->n_waiting > 1 && missing > p->n_missing && p->last_missing > p->n_missing;
        p->n_missing = is_more && p->last_missing < missing ? p->last_missing : missing;
        p->n_since = p->n_agree = p->n_same = 0;
    }
    p->last_missing = missing;
    p->n_same = missing > p->n_missing ? p->n_same + 1 : 0;
    ++p->n_since;
    p->n_agree += is_whole && missing == p->n_missing;
    if (missing == 0 || p->n_since < enough(p)) { return 0; }
    return missing == p->n_missing && is_whole && p->n_agree >= AGREE ? p->n_since : 0;
}

/// How many of n_settled samples came in time.
static void learn_prompt(ipe_sample_timing_t* p, int n_settled, int n_prompt)
{
    const float n = fminf((float)n_settled, IPE_SAMPLE_TIMING_HOLD), share = (float)n_prompt / (float)n_settled;
    p->prompt += PROMPT_STEP * n * (share - p->prompt);
}

/// The line starts anew at the newest sample, at the pace that the old one had.
static int start_again(ipe_sample_timing_t* p, ipe_clock_t* clock, int64_t host_ns, int n)
{
    p->period *= clock->rate;
    start_line(p, clock, host_ns, (int)fmax(LINE_S / p->period, 1.0));
    return settle(p, n);
}

/// The line was too fast: it starts anew at the newest sample, at the pace of the intervals. Older ones are dropped.
static int pace_again(ipe_sample_timing_t* p, ipe_clock_t* clock, int64_t host_ns)
{
    ++p->n_restarts;
    p->period = (double)p->interval;
    start_line(p, clock, host_ns, (int)fmax(LINE_S / p->period, 1.0));
    return settle(p, 1);
}

int ipe_sample_timing_push(ipe_sample_timing_t* p, ipe_clock_t* clock, int64_t host_ns, uint64_t step)
{
    if (p->period == 0.0) { return measure(p, clock, host_ns); }
    learn_interval(p, host_ns);
    uint64_t ahead = p->n_waiting == 0 && step > 0 ? step : (uint64_t)p->n_waiting + 1;
    const double late = seconds(ipe_clock_at(clock, p->period * (double)(p->index + ahead)), host_ns);
    const bool is_counted = step > 0 && late > -ON_LINE * p->period && late < COUNTED_LATE_S;
    if (p->n_waiting == 0) { p->first_ns = host_ns; }
    const bool is_lasting = p->n_waiting >= IPE_SAMPLE_TIMING_HOLD && seconds(p->first_ns, host_ns) > GIVE_UP_S;
    int n = is_counted || fabs(late) <= ON_LINE * p->period ? p->n_waiting + 1 : 0;
    if (n == 0 && is_lasting) { return measure_again(p, clock, host_ns); }
    ++p->n_waiting;
    if (n > 0) { learn_prompt(p, n, 1); }
    if (late < -ON_LINE * p->period) {
        const uint64_t found = (uint64_t)round(-late / p->period);
        p->n_lost -= found < p->n_lost ? found : p->n_lost;
        if (++p->n_early >= AGREE && p->n_early * p->period > EARLY_S) {
            --p->n_waiting;  // this one is the first of the new period
            return measure_again(p, clock, host_ns);
        }
        return start_again(p, clock, host_ns, 1);
    }
    if (n == 0) {
        n = agreeing(p, late);
        if (n == 0) { return 0; }
        if (is_too_fast(p, clock)) { return pace_again(p, clock, host_ns); }
        learn_prompt(p, n, p->n_agree);
        p->n_lost += (uint64_t)p->n_missing;
        ahead += (uint64_t)p->n_missing;
        if (p->n_missing > COUNTABLE) { return start_again(p, clock, host_ns, n); }
    }
    p->index += ahead;
    if (p->period * (double)p->index > 2.0 * LINE_S) { p->n_early = 0; }
    (void)ipe_clock_map(clock, p->period * (double)p->index, host_ns);
    return settle(p, n);
}

int64_t ipe_sample_timing_instant(const ipe_sample_timing_t* p, const ipe_clock_t* clock, int before)
{
    return ipe_clock_at(clock, p->period * ((double)p->index - before));
}

void ipe_sample_timing_end(ipe_sample_timing_t* p)
{
    (void)settle(p, 0);
}
