// SPDX-License-Identifier: Apache-2.0
#include "window.h"

#include "regressor.h"

#include <math.h>
#include <string.h>

#define GAP_PERIODS 1.8           // rows further apart than this have lost one between them
#define GAP_FRACTION (1.0 / 40.0) // of the window: a gap shorter than this does no harm
#define MIN_QUARTER 2             // samples per quarter window
#define STEP_BACK_S 1.0           // a stamp this far back: the clock was stepped, start again

enum { AT_S = 0, AT_W = 3, AT_WW = 6, AT_Y = 12, CHANNELS = 18 };

static void set_period(ipe_window_t* x, double period)
{
    const double quarter = fmax(MIN_QUARTER, round(0.25 * x->window_length / period));
    x->period = period;
    x->length = 4.0 * quarter * period;
    x->max_gap = fmin(fmax(GAP_PERIODS * period, GAP_FRACTION * x->length), fmax(x->max_age, 1.01 * period));
}

void ipe_window_init(ipe_window_t* x, const ipe_config_t* config)
{
    memset(x, 0, sizeof *x);
    x->window_length = config->window_length;
    x->max_age = config->max_age[IPE_IMU];
    if (config->sample_rate > 0.0) { set_period(x, 1.0 / config->sample_rate); }
}

/// Mean of the intervals near their median: neither gaps nor jitter move it.
static void measure_period(ipe_window_t* x, double interval)
{
    int at = x->n_measured++;
    for (; at > 0 && x->interval[at - 1] > interval; --at) { x->interval[at] = x->interval[at - 1]; }
    x->interval[at] = interval;
    if (x->n_measured < IPE_WINDOW_MEASURED) { return; }
    const double median = x->interval[IPE_WINDOW_MEASURED / 2];
    double sum = 0.0;
    int n = 0;
    for (int i = 0; i < IPE_WINDOW_MEASURED; ++i) {
        if (fabs(x->interval[i] - median) > 0.5 * median) { continue; }
        sum += x->interval[i];
        ++n;
    }
    set_period(x, sum / n);
}

static void remember(ipe_window_t* x, int64_t t_ns, const ipe_motion_t* motion, const ipe_wrench_t* wrench)
{
    x->previous.t_ns = t_ns;
    memcpy(x->previous.channel + AT_S, motion->s, sizeof motion->s);
    memcpy(x->previous.channel + AT_W, motion->w, sizeof motion->w);
    ipe_rate_products(motion->w, x->previous.channel + AT_WW);
    memcpy(x->previous.channel + AT_Y, wrench->y, sizeof wrench->y);
}

/// First row after a start or a gap: windows start here.
static void restart(ipe_window_t* x, int64_t t_ns)
{
    memset(x->open, 0, sizeof x->open);
    x->is_running = true;
    x->origin_ns = t_ns;
    x->first = 0;
    x->spacing = 0.0;
}

/// Cubic B-spline on 0..4 with unit area, and its derivative.
static double spline(double z, double* slope)
{
    const double v = z > 2.0 ? 4.0 - z : z;
    const double sign = z > 2.0 ? -1.0 : 1.0;
    if (v < 1.0) {
        *slope = sign * 0.5 * v * v;
        return v * v * v / 6.0;
    }
    const double c = v - 1.0;
    *slope = sign * (0.5 + c - 1.5 * c * c);
    return (1.0 + 3.0 * c + 3.0 * c * c - 3.0 * c * c * c) / 6.0;
}

/// Add the previous row, which stands for d seconds, to window index, whose time runs from -L/2 to L/2.
static void accumulate(ipe_window_t* x, uint64_t index, double d)
{
    const double quarter = 0.25 * x->length;
    const double since = 1e-9 * (double)(x->previous.t_ns - x->origin_ns) - (double)index * quarter;
    const double z = since / quarter;
    if (z <= 0.0 || z >= 4.0) { return; }
    ipe_accumulator_t* a = &x->open[index % IPE_WINDOWS_OPEN];
    double slope;
    const double weight = d * spline(z, &slope);
    const double slope_weight = d * slope;
    const double t = since - 0.5 * x->length;
    a->weight += weight;
    a->moment += weight * t;
    a->slope_weight += slope_weight;
    a->slope_moment += slope_weight * t;
    for (int i = 0; i < CHANNELS; ++i) { a->channel[i] += weight * x->previous.channel[i]; }
    for (int i = 0; i < 3; ++i) { a->slope[i] += slope_weight * x->previous.channel[AT_W + i]; }
    ++a->n_rows;
}

static void finish(ipe_window_t* x, ipe_average_t* average)
{
    ipe_accumulator_t* a = &x->open[x->first % IPE_WINDOWS_OPEN];
    double mean[CHANNELS];
    for (int i = 0; i < CHANNELS; ++i) { mean[i] = a->channel[i] / a->weight; }
    memcpy(average->s, mean + AT_S, sizeof average->s);
    memcpy(average->w, mean + AT_W, sizeof average->w);
    memcpy(average->ww, mean + AT_WW, sizeof average->ww);
    memcpy(average->y, mean + AT_Y, sizeof average->y);
    const double spread = a->slope_moment - a->slope_weight * a->moment / a->weight;
    for (int i = 0; i < 3; ++i) { average->alpha[i] = (a->slope[i] - a->slope_weight * average->w[i]) / spread; }
    average->n_rows = a->n_rows;
    average->length = x->length;
    average->t_ns = x->origin_ns + (int64_t)llround(1e9 * x->length * (0.25 * (double)x->first + 0.5));
    memset(a, 0, sizeof *a);
    ++x->first;
    ++x->n_windows;
}

/// The previous row's share of time is known now: add it to the open windows and finish the oldest if it is over.
static ipe_status_t settle_previous(ipe_window_t* x, double interval, ipe_average_t* average)
{
    const double d = 0.5 * (x->spacing + interval);
    for (uint64_t i = x->first; i < x->first + IPE_WINDOWS_OPEN; ++i) { accumulate(x, i, d); }
    const double since = 1e-9 * (double)(x->previous.t_ns - x->origin_ns);
    if (since + interval < x->length * (0.25 * (double)x->first + 1.0)) { return IPE_NOT_READY; }
    finish(x, average);
    return IPE_OK;
}

ipe_status_t ipe_window_push(ipe_window_t* x, int64_t t_ns, const ipe_motion_t* motion, const ipe_wrench_t* wrench,
                             ipe_average_t* average)
{
    const double interval = 1e-9 * (double)(t_ns - x->previous.t_ns);
    ipe_status_t status = IPE_NOT_READY;
    if (x->n_rows > 0 && interval <= 0.0 && interval > -STEP_BACK_S) {
        ++x->n_backwards;
        return IPE_ERR_TIME;
    }
    ++x->n_rows;
    if (x->period == 0.0) {
        if (x->n_rows > 1 && interval > 0.0) { measure_period(x, interval); }
    } else if (!x->is_running) {
        restart(x, t_ns);
    } else if (interval > x->max_gap || interval < 0.0) {
        ++x->n_restarts;
        restart(x, t_ns);
    } else {
        status = settle_previous(x, interval, average);
        x->spacing = interval;
    }
    remember(x, t_ns, motion, wrench);
    return status;
}
