// SPDX-License-Identifier: Apache-2.0
#include "sample_assembler.h"

#include <math.h>
#include <string.h>

#define SPREAD 0.8            // of the period that the frames of a sample without counter may take: chosen under 1
#define DROPPED_IN_A_ROW 8    // samples, chosen over a burst of losses: then the period is measured again
#define SETTLED_INTERVALS 16  // then the silences are known: chosen so that their medians stand
#define MEDIAN_STEP 0.02F     // of the period: chosen so that a median stands within 50 samples
#define CLEARLY 1.2F          // times the silence before another frame: chosen over jitter; it is before the first one
#define REORDERED_MAX 8.0     // samples that one may come late: chosen as in align.c
#define COUNTER_SLACK_S 2.0   // s that a counter may be ahead of the stamps, chosen over stalls; beyond, it jumped

static void require(ipe_sample_assembler_t* g, int first, int n)
{
    int at = __builtin_popcountll(g->required);
    for (int q = first; q < first + n; ++q) {
        g->place[q] = (uint8_t)at++;
        g->required |= 1ULL << q;
    }
}

static bool is_bound(const ipe_config_t* config, int quantity)
{
    for (int i = 0; i < config->n_signals; ++i) {
        if (config->signal[i].quantity == quantity) { return true; }
    }
    return false;
}

void ipe_sample_assembler_init(ipe_sample_assembler_t* g, ipe_sensor_t sensor, const ipe_config_t* config)
{
    memset(g, 0, sizeof *g);
    g->counter_quantity = (uint8_t)(IPE_Q_IMU_COUNTER + (int)sensor);
    g->time_quantity = (uint8_t)(IPE_Q_IMU_TIME + (int)sensor);
    switch (sensor) {
    case IPE_IMU:
        require(g, IPE_Q_ACC_X, 3);
        require(g, IPE_Q_GYRO_X, 3);
        if (config->attitude_source == IPE_ATTITUDE_RPY) {
            require(g, IPE_Q_ROLL, 3);
        } else {
            require(g, IPE_Q_QUAT_W, 4);
        }
        break;
    case IPE_FORCE: require(g, IPE_Q_F_1, config->n_cables); break;
    default: require(g, IPE_Q_POS_X, 3); break;
    }
    g->has_counter = is_bound(config, g->counter_quantity);
    g->counter_wrap = ipe_config_wrap(config, g->counter_quantity);
    if (is_bound(config, g->time_quantity)) { g->required |= 1ULL << g->time_quantity; }
    g->optional = 1ULL << g->counter_quantity;
}

typedef struct {
    uint64_t present;  ///< quantities of this sensor in the frame
    bool has_counter;
    double counter;
} content_t;

static content_t content_of(const ipe_sample_assembler_t* g, const ipe_sample_t* sample)
{
    content_t c = {0, false, 0.0};
    for (int i = 0; i < sample->n; ++i) {
        const uint64_t bit = 1ULL << sample->item[i].quantity;
        c.present |= bit & g->required;
        if (bit & g->optional) {
            c.has_counter = true;
            c.counter = sample->item[i].value;
        }
    }
    return c;
}

static double seconds(int64_t from_ns, int64_t to_ns)
{
    return 1e-9 * (double)(to_ns - from_ns);
}

/// Learn the silence before each frame of a sample. Is this one clearly the first, the one after the longest silence?
static bool is_first(ipe_sample_assembler_t* g, const content_t* c, int64_t t_ns)
{
    const int lowest = __builtin_ctzll(c->present | 1ULL << 63);
    const int own = lowest < IPE_Q_COUNT && lowest != g->time_quantity ? g->place[lowest] : IPE_SAMPLE_ASSEMBLER_VALUES;
    const double silence = seconds(g->last_ns, t_ns);
    g->last_ns = t_ns;
    if (g->n_complete > 0 && silence > 0.0 && silence < 2.0 * g->period) {
        const float step = MEDIAN_STEP * (float)g->period;  // towards the median: losses must not move it
        g->silence[own] = g->silence[own] == 0.0F            ? (float)silence
                          : (float)silence > g->silence[own] ? g->silence[own] + step
                                                             : g->silence[own] - step;
    }
    float others = 0.0F;
    for (int i = 0; i <= IPE_SAMPLE_ASSEMBLER_VALUES; ++i) {
        others = i == own ? others : fmaxf(others, g->silence[i]);
    }
    return g->n_intervals > SETTLED_INTERVALS && g->silence[own] > CLEARLY * others;
}

/// Does a frame with this content start another sample than the open one?
static bool starts_another(ipe_sample_assembler_t* g, const content_t* c, int64_t t_ns)
{
    if (c->has_counter) { return c->counter != g->counter; }
    if (!g->has_counter && is_first(g, c, t_ns)) { return true; }
    const double longest = (g->has_counter ? 1.0 : SPREAD) * g->period;
    const bool is_late = g->period > 0.0 && seconds(g->opened_ns, t_ns) > longest;
    return is_late || (!g->has_counter && (g->present & c->present) != 0);
}

/// No sample is open: does this frame repeat the last one?
static bool repeats_last(const ipe_sample_assembler_t* g, const content_t* c, int64_t t_ns)
{
    if (!g->has_counter || g->n_complete == 0) { return false; }
    return c->has_counter ? c->counter == g->completed_counter : seconds(g->completed_ns, t_ns) <= g->period;
}

static void open_sample(ipe_sample_assembler_t* g, int64_t t_ns)
{
    g->is_open = true;
    g->present = 0;
    g->n_open_frames = 0;
    g->counter = -1.0;
    g->opened_ns = t_ns;
    g->reading.t_ns = t_ns;
    g->reading.has_device_time = false;
}

static void take_values(ipe_sample_assembler_t* g, const ipe_sample_t* sample, uint64_t wanted)
{
    for (int i = 0; i < sample->n; ++i) {
        const unsigned q = sample->item[i].quantity;
        if (!(wanted >> q & 1U)) { continue; }
        if (q == g->time_quantity) {
            g->reading.has_device_time = true;
            g->reading.device_time = sample->item[i].value;
        } else {
            g->reading.value[g->place[q]] = sample->item[i].value;
        }
    }
    g->present |= wanted;
}

/// Samples from the last complete one to this, from its counter; what is in between was lost. 0: no counter, or it jumped.
static uint64_t count_step(ipe_sample_assembler_t* g, bool* is_reordered)
{
    *is_reordered = false;
    if (!g->has_counter || g->n_complete == 0 || g->period == 0.0) { return 0; }
    const double difference = g->counter - g->completed_counter, wrap = g->counter_wrap;
    const double step = wrap > 0.0 && difference < 0.0 ? difference + wrap : difference;
    *is_reordered = step < 0.0 ? step >= -REORDERED_MAX : wrap > 0.0 && wrap - step <= REORDERED_MAX;
    if (*is_reordered) {
        g->n_lost -= g->n_lost > 0;
        return 0;
    }
    if (step < 0.0 || step * g->period - seconds(g->completed_ns, g->opened_ns) > COUNTER_SLACK_S) {
        ++g->n_jumps;
        return 0;
    }
    g->n_lost += (uint64_t)fmax(step - 1.0 - g->n_dropped_since, 0.0);
    return (uint64_t)step;
}

static void close_sample(ipe_sample_assembler_t* g)
{
    const double interval = seconds(g->completed_ns, g->opened_ns);
    bool is_reordered;
    g->reading.step = count_step(g, &is_reordered);
    g->n_used += g->n_open_frames;
    if (g->n_complete > 0 && g->n_intervals++ == 0) {
        g->period = interval;
    } else if (interval < 1.5 * g->period) {
        g->period += 0.1 * (interval - g->period);
    }
    g->n_dropped_in_a_row = 0;
    g->n_dropped_since = 0;
    if (!is_reordered) {
        g->completed_ns = g->opened_ns;
        g->completed_counter = g->counter;
    }
    g->is_open = false;
    ++g->n_complete;
}

static void drop_sample(ipe_sample_assembler_t* g)
{
    g->is_open = false;
    ++g->n_incomplete;
    ++g->n_dropped_since;
    g->n_dropped += g->n_open_frames;
    if (++g->n_dropped_in_a_row >= DROPPED_IN_A_ROW) {
        g->period = 0.0;
        g->n_intervals = 0;
    }
}

ipe_status_t ipe_sample_assembler_push(ipe_sample_assembler_t* g, const ipe_sample_t* sample, ipe_reading_t* reading)
{
    const content_t c = content_of(g, sample);
    if (c.present == 0 && !c.has_counter) { return IPE_IGNORED; }
    const int64_t t_ns = sample->t_ns - (int64_t)(1e9 * sample->wire_time);
    if (starts_another(g, &c, t_ns) && g->is_open) { drop_sample(g); }
    if (!g->is_open && repeats_last(g, &c, t_ns)) {
        ++g->n_duplicate;
        return IPE_NOT_READY;
    }
    if (!g->is_open) { open_sample(g, t_ns); }
    if (c.has_counter) { g->counter = c.counter; }
    if (c.present != 0 && (g->present & c.present) == c.present) {
        ++g->n_duplicate;
        return IPE_NOT_READY;
    }
    ++g->n_open_frames;
    take_values(g, sample, c.present & ~g->present);
    if (g->present != g->required) { return IPE_NOT_READY; }
    close_sample(g);
    *reading = g->reading;
    return IPE_OK;
}
