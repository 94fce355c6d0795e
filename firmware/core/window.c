// SPDX-License-Identifier: Apache-2.0
#include "window.h"

#include "regressor.h"

#include <math.h>
#include <string.h>

#define GAP_PERIODS 1.8         // between rows: chosen under 2, so that one lost row is seen in spite of jitter
#define SLOW_PERIODS 1.5        // the same for rows slower than max_age, whose jitter is no gap
#define GAP_PERMILLE 25         // of the window, 10 ms of 0.4 s: chosen so that a shorter gap does no harm
#define MIN_QUARTER 2           // samples per quarter window: the least that gives the kernel a shape
#define STEP_BACK_S 1.0         // s, chosen over any reordering: a stamp this far back means the clock was stepped
#define BLOCKS_PER_QUARTER 8.0  // of noise_density.h: chosen so that their differences see no motion
#define KERNEL_SQUARE (151.0 / 315.0)  // integral of the B-spline squared, quarters
#define SLOPE_SQUARE (2.0 / 3.0)       // integral of its derivative squared, per quarter cubed

void ipe_window_set_period(ipe_window_t* x, double period)
{
    const double quarter = fmax(MIN_QUARTER, round(0.25 * x->window_length / period));
    memset(&x->noise_density, 0, sizeof x->noise_density);
    x->period = period;
    x->length = 4.0 * quarter * period;
    x->max_gap =
        fmin(fmax(GAP_PERIODS * period, x->gap_permille / 1000.0 * x->length), fmax(x->max_age, SLOW_PERIODS * period));
}

void ipe_window_init_length(ipe_window_t* x, const ipe_config_t* config, double length, int gap_permille, double period)
{
    memset(x, 0, sizeof *x);
    x->n_cables = config->n_cables;
    x->n_channels = IPE_CHANNEL_F + 2 * config->n_cables;
    x->window_length = length;
    x->gap_permille = gap_permille;
    x->max_age = config->max_age[IPE_IMU];
    if (period > 0.0) { ipe_window_set_period(x, period); }
}

void ipe_window_init(ipe_window_t* x, const ipe_config_t* config)
{
    const double rate = config->sample_rate;
    ipe_window_init_length(x, config, config->window_length, GAP_PERMILLE, rate > 0.0 ? 1.0 / rate : 0.0);
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
    ipe_window_set_period(x, sum / n);
}

static void remember(ipe_window_t* x, int64_t t_ns, const ipe_motion_t* motion, const ipe_wrench_t* wrench)
{
    double* channel = x->previous.channel;
    x->previous.t_ns = t_ns;
    memcpy(channel + IPE_CHANNEL_S, motion->s, sizeof motion->s);
    ipe_rate_products(motion->w, channel + IPE_CHANNEL_WW);
    memcpy(channel + IPE_CHANNEL_Y, wrench->y, sizeof wrench->y);
    memcpy(channel + IPE_CHANNEL_W, motion->w, sizeof motion->w);
    memcpy(channel + IPE_CHANNEL_P, motion->p, sizeof motion->p);
    memcpy(channel + IPE_CHANNEL_F, wrench->f, sizeof(double) * (size_t)x->n_cables);
    memcpy(channel + IPE_CHANNEL_F + x->n_cables, wrench->friction, sizeof(double) * (size_t)x->n_cables);
    memcpy(x->previous.R, motion->R, sizeof motion->R);
    x->previous.error = motion->error;
    x->previous.unknown_force = wrench->unknown_force;
}

/// First row after a start or a gap: windows start here.
static void restart(ipe_window_t* x, int64_t t_ns)
{
    memset(x->open, 0, sizeof x->open);
    x->is_running = true;
    x->origin_ns = t_ns;
    x->first = 0;
    x->spacing = 0.0;
    ipe_noise_density_restart(&x->noise_density);
}

void ipe_window_restart(ipe_window_t* x)
{
    x->is_running = false;
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
    const double* channel = x->previous.channel;
    const int n_sloped = x->n_channels - x->n_cables;
    for (int i = 0; i < x->n_channels; ++i) { a->channel[i] += weight * channel[i]; }
    for (int i = IPE_CHANNEL_W; i < n_sloped; ++i) { a->slope[i - IPE_CHANNEL_W] += slope_weight * channel[i]; }
    if (z <= 2.0 + 1e-6) {
        memcpy(a->R, x->previous.R, sizeof a->R);
        a->error = x->previous.error;
    }
    a->unknown_force |= x->previous.unknown_force;
    ++a->n_rows;
}

static int block_length(const ipe_window_t* x)
{
    return (int)fmax(1.0, round(0.25 * x->length / (BLOCKS_PER_QUARTER * x->period)));
}

/// Variance of the averages of s and w under the kernel, from their white noise.
static void noise_of_averages(const ipe_window_t* x, ipe_average_t* average)
{
    const double quarter = 0.25 * x->length;
    double density[IPE_NOISE_DENSITY_CHANNELS];
    ipe_noise_density_density(&x->noise_density, block_length(x) * x->period, density);
    for (int i = 0; i < 3; ++i) {
        average->s_variance[i] = KERNEL_SQUARE / quarter * density[i];
        average->alpha_variance[i] = SLOPE_SQUARE / (quarter * quarter * quarter) * density[3 + i];
    }
}

static void finish(ipe_window_t* x, ipe_average_t* average)
{
    ipe_accumulator_t* a = &x->open[x->first % IPE_WINDOWS_OPEN];
    const size_t n_bytes = sizeof(double) * (size_t)x->n_cables;
    double mean[IPE_CHANNELS] = {0}, slope[IPE_SLOPES] = {0};
    memset(average, 0, sizeof *average);
    const double spread = a->slope_moment - a->slope_weight * a->moment / a->weight;
    for (int i = 0; i < x->n_channels; ++i) { mean[i] = a->channel[i] / a->weight; }
    for (int i = IPE_CHANNEL_W; i < x->n_channels - x->n_cables; ++i) {
        slope[i - IPE_CHANNEL_W] = (a->slope[i - IPE_CHANNEL_W] - a->slope_weight * mean[i]) / spread;
    }
    memcpy(average->s, mean + IPE_CHANNEL_S, sizeof average->s);
    memcpy(average->ww, mean + IPE_CHANNEL_WW, sizeof average->ww);
    memcpy(average->y, mean + IPE_CHANNEL_Y, sizeof average->y);
    memcpy(average->w, mean + IPE_CHANNEL_W, sizeof average->w);
    memcpy(average->p, mean + IPE_CHANNEL_P, sizeof average->p);
    memcpy(average->f, mean + IPE_CHANNEL_F, n_bytes);
    memcpy(average->friction, mean + IPE_CHANNEL_F + x->n_cables, n_bytes);
    memcpy(average->alpha, slope, sizeof average->alpha);
    memcpy(average->velocity, slope + IPE_CHANNEL_P - IPE_CHANNEL_W, sizeof average->velocity);
    memcpy(average->f_slope, slope + IPE_CHANNEL_F - IPE_CHANNEL_W, n_bytes);
    memcpy(average->R, a->R, sizeof average->R);
    average->error = a->error;
    noise_of_averages(x, average);
    average->unknown_force = a->unknown_force;
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
        const double* s = motion->s;
        const double* w = motion->w;
        ipe_noise_density_push(&x->noise_density, (double[]){s[0], s[1], s[2], w[0], w[1], w[2]}, block_length(x));
    }
    remember(x, t_ns, motion, wrench);
    return status;
}
