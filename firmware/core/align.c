// SPDX-License-Identifier: Apache-2.0
#include "align.h"

#include "smallmat.h"

#include <assert.h>
#include <string.h>

#define SAME_INSTANT_NS 1000      // 1 us, the resolution of candump stamps: closer samples are taken as they are
#define RESTART_NS 1000000000LL   // 1 s, chosen far over any reordering: a stamp further back starts the sensor again
#define REORDERED_MAX 8           // samples that one may come late; chosen so that making room stays cheap
#define DUPLICATE 8               // of the spacing, an eighth: chosen over stamp jitter; a closer sample is a copy
#define NEIGHBOURS 2              // samples past a row's instant that the cubic needs
#define DOUBTED_SAMPLES 10        // of force after a step: the 8 of stuck_sensor.c and the two around it
#define STEP_SHARE 0.5            // of a force: chosen over the step of a payload that is let go
#define REACH_MARGIN 0.5          // of the anchors' box, its diagonal: chosen as no platform swings further out
#define FORCE_SPIKE_SHARE 0.1     // of the mean tension: chosen over the jolts of a platform that stops or is loaded
#define SPIKE_QUANTA 3.0          // steps of a signal's resolution: chosen over the flicker of a coarse one
#define POSITION_SPIKE 0.02       // m: chosen over the jitter of a tracker's stamps at 1 m/s
#define QUATERNION_TOLERANCE 0.1  // of the norm: chosen over the rounding of 8-bit signals

static int64_t to_ns(double seconds)
{
    return (int64_t)llround(1e9 * seconds);
}

/// Where the tracked point may be. Cables have no length that is known, so there is no bound below.
static void set_reach(ipe_align_t* a, const ipe_config_t* config)
{
    double low[3], high[3], size = 0.0, diagonal = 0.0;
    memcpy(low, config->cable[0].anchor, sizeof low);
    memcpy(high, low, sizeof high);
    for (int i = 0; i < config->n_cables; ++i) {
        const ipe_cable_t* cable = &config->cable[i];
        for (int k = 0; k < 3; ++k) {
            low[k] = fmin(low[k], cable->anchor[k]);
            high[k] = fmax(high[k], cable->anchor[k]);
        }
        size = fmax(size, sqrt(vec3_dot(cable->attachment, cable->attachment)));
    }
    for (int k = 0; k < 3; ++k) { diagonal += (high[k] - low[k]) * (high[k] - low[k]); }
    const double target = sqrt(vec3_dot(config->tracker_target, config->tracker_target));
    const double margin = REACH_MARGIN * sqrt(diagonal) + size + target;
    for (int k = 0; k < 3; ++k) { a->reach_high[k] = high[k] + margin; }
    for (int k = 0; k < 2; ++k) { a->reach_low[k] = low[k] - margin; }
}

static void set_spike_gates(ipe_align_t* a, const ipe_config_t* config)
{
    double force[IPE_CABLES_MAX] = {0.0};
    const double position[3] = {POSITION_SPIKE, POSITION_SPIKE, POSITION_SPIKE};
    for (int i = 0; i < config->n_signals; ++i) {
        const ipe_signal_t* signal = &config->signal[i];
        const int cable = signal->quantity - IPE_Q_F_1;
        if (cable < 0 || cable >= config->n_cables || signal->kind != IPE_INTEGER) { continue; }
        force[cable] = SPIKE_QUANTA * fabs(signal->scale);
    }
    ipe_spike_gate_init(&a->spike_gate[IPE_FORCE], config->n_cables, force, FORCE_SPIKE_SHARE);
    ipe_spike_gate_init(&a->spike_gate[IPE_POSITION], 3, position, 0.0);
}

void ipe_align_init(ipe_align_t* a, const ipe_config_t* config)
{
    memset(a, 0, sizeof *a);
    a->n_cables = config->n_cables;
    a->has_rpy = config->attitude_source == IPE_ATTITUDE_RPY;
    a->position_source = config->position_source;
    memcpy(a->fixed_position, config->fixed_position, sizeof a->fixed_position);
    a->max_wait_ns = to_ns(config->max_wait);
    a->position_seen = UINT64_MAX;
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        a->max_age_ns[s] = to_ns(config->max_age[s]);
        a->delay_ns[s] = to_ns(config->delay[s]);
    }
    set_reach(a, config);
    set_spike_gates(a, config);
}

static int64_t stamp(const ipe_ring_t* ring, uint64_t i)
{
    return ring->t_ns[i % IPE_RING];
}

static uint64_t oldest(const ipe_ring_t* ring)
{
    return ring->head > ring->first + IPE_RING ? ring->head - IPE_RING : ring->first;
}

/// One past the newest sample whose instant is known.
static uint64_t timed(const ipe_ring_t* ring)
{
    return ring->head - ring->n_held;
}

/// One past the newest sample that rows may use.
static uint64_t usable(const ipe_ring_t* ring)
{
    return timed(ring) - (ring->is_suspect ? 1 : 0);
}

/// Quaternion of the reading, normalised. False if it is not one.
static bool read_attitude(const ipe_align_t* a, const double* value, double q[4])
{
    if (a->has_rpy) {
        quat_from_rpy(value, q);
        return true;
    }
    const double norm = sqrt(value[0] * value[0] + value[1] * value[1] + value[2] * value[2] + value[3] * value[3]);
    for (int i = 0; i < 4; ++i) { q[i] = value[i] / norm; }
    return fabs(norm - 1.0) < QUATERNION_TOLERANCE;
}

/// Count how late a sample of this instant comes.
static void note_lateness(ipe_align_t* a, ipe_sensor_t sensor, int64_t instant)
{
    const ipe_ring_t* imu = &a->ring[IPE_IMU];
    ipe_lateness_t* of = &a->lateness[sensor];
    if (sensor == IPE_IMU || timed(imu) == imu->first) { return; }
    const int64_t late_ns = stamp(imu, timed(imu) - 1) - instant;
    if (late_ns > of->largest_ns) { of->largest_ns = late_ns; }
    of->n_too_late += a->row_ns != 0 && instant < a->row_ns;
}

void ipe_align_set_force_delay(ipe_align_t* a, double delay)
{
    a->force_delay_ns = to_ns(delay);
    a->undelayed = a->ring[IPE_FORCE].cursor;
}

ipe_lateness_t ipe_align_lateness(const ipe_align_t* a, ipe_sensor_t sensor)
{
    return a->lateness[sensor];
}

static void store(ipe_align_t* a, ipe_sensor_t sensor, uint64_t place, const double* value, const double q[4])
{
    const uint64_t at = place % IPE_RING;
    if (sensor == IPE_FORCE) {
        memcpy(a->force[at], value, sizeof(double) * (size_t)a->n_cables);
        a->unknown[at] = (uint16_t)a->unknown_force;
    } else if (sensor == IPE_POSITION) {
        memcpy(a->position[at], value, sizeof(double) * 3);
    } else {
        memcpy(a->imu[at], value, sizeof(double) * 6);
        memcpy(a->imu[at] + 6, q, sizeof(double) * 4);
    }
}

static size_t width(const ipe_align_t* a, ipe_sensor_t sensor)
{
    return sensor == IPE_FORCE ? (size_t)a->n_cables : sensor == IPE_POSITION ? 3U : a->has_rpy ? 9U : 10U;
}

static void copy_sample(ipe_align_t* a, ipe_sensor_t sensor, uint64_t from, uint64_t to)
{
    const uint64_t i = from % IPE_RING, j = to % IPE_RING;
    a->ring[sensor].t_ns[j] = a->ring[sensor].t_ns[i];
    switch (sensor) {
    case IPE_IMU: memcpy(a->imu[j], a->imu[i], sizeof a->imu[0]); break;
    case IPE_FORCE:
        memcpy(a->force[j], a->force[i], sizeof a->force[0]);
        a->unknown[j] = a->unknown[i];
        break;
    default: memcpy(a->position[j], a->position[i], sizeof a->position[0]); break;
    }
}

/// Room for one sample at place i, newer ones move up; rows still waiting may be overrun.
static void open_place(ipe_align_t* a, ipe_sensor_t sensor, uint64_t i)
{
    ipe_ring_t* ring = &a->ring[sensor];
    for (uint64_t j = ring->head; j > i; --j) { copy_sample(a, sensor, j - 1, j); }
    ++ring->head;
    if (sensor == IPE_IMU && ring->cursor < oldest(ring)) {
        ring->cursor = oldest(ring);
        ++a->n_overrun;
    }
}

/// The smaller of the last two spacings: one stamp that is far ahead does not stretch it. 0: not known yet.
static int64_t newest_spacing(const ipe_ring_t* ring)
{
    const uint64_t i = ring->head;
    if (i < oldest(ring) + 2) { return 0; }
    const int64_t last = stamp(ring, i - 1) - stamp(ring, i - 2);
    if (i < oldest(ring) + 3) { return last; }
    const int64_t before = stamp(ring, i - 2) - stamp(ring, i - 3);
    return before < last ? before : last;
}

/// Where a stamp belongs: at the head, or between earlier samples that no row has used yet.
static ipe_status_t find_place(ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, uint64_t* place)
{
    ipe_ring_t* ring = &a->ring[sensor];
    const uint64_t used = sensor == IPE_IMU ? ring->cursor : ring->cursor + 1;  // from here on samples are free to move
    uint64_t i = ring->head;
    *place = i;
    if (i == ring->first || t_ns > stamp(ring, i - 1)) { return IPE_OK; }
    if (stamp(ring, i - 1) - t_ns > RESTART_NS) {
        ++a->n_restarts[sensor];
        if (sensor == IPE_IMU) { a->row_ns = 0; }
        ring->first = ring->cursor = ring->head;
        ring->is_suspect = false;
        return IPE_OK;
    }
    const int64_t spacing = newest_spacing(ring);
    while (i > oldest(ring) && ring->head - i <= REORDERED_MAX && stamp(ring, i - 1) > t_ns) { --i; }
    const bool has_before = i > oldest(ring), has_after = i < ring->head;
    if ((has_before && t_ns - stamp(ring, i - 1) <= spacing / DUPLICATE) ||
        (has_after && stamp(ring, i) - t_ns <= spacing / DUPLICATE)) {
        ++a->n_duplicate[sensor];
        return IPE_ERR_TIME;
    }
    if (i < used || ring->head - i > REORDERED_MAX || !has_before) {
        ++a->n_backwards[sensor];
        return IPE_ERR_TIME;
    }
    ++a->n_reordered[sensor];
    *place = i;
    return IPE_OK;
}

static const double* sample(const ipe_align_t* a, ipe_sensor_t sensor, uint64_t i)
{
    return sensor == IPE_FORCE ? a->force[i % IPE_RING] : a->position[i % IPE_RING];
}

/// Spacings from sample b to t, in those from a to b.
static double spacings(const ipe_ring_t* ring, uint64_t b, int64_t t_ns)
{
    return (double)(t_ns - stamp(ring, b)) / (double)(stamp(ring, b) - stamp(ring, b - 1));
}

/// A single force that changes by half of itself from sample b to the next is unknown for as many samples as
/// ipe_stuck_sensor_push() needs to call it stuck, and while it repeats. Where several do, the platform was hit.
static void doubt_step(ipe_align_t* a, uint64_t b, uint64_t at, uint32_t stepped)
{
    for (int i = 0; i < a->n_cables; ++i) {
        const double before = a->force[b % IPE_RING][i], after = a->force[at % IPE_RING][i];
        if (stepped != 1U << (unsigned)i || fabs(after - before) < STEP_SHARE * fabs(before)) { continue; }
        a->stepped = stepped;
        a->stepped_to = after;
        a->n_doubted = DOUBTED_SAMPLES;
        a->unknown[at % IPE_RING] |= (uint16_t)stepped;
    }
}

/// The newest sample is a suspect and the next one is here: was it a spike? Then it is taken out.
static void judge_suspect(ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, const double* value)
{
    ipe_ring_t* ring = &a->ring[sensor];
    const uint64_t at = ring->head - 1, b = at - 1;
    const uint32_t stepped = ipe_spike_gate_stepped(&a->spike_gate[sensor], sample(a, sensor, b - 1),
                                                    sample(a, sensor, b), sample(a, sensor, at),
                                                    spacings(ring, b, stamp(ring, at)), value, spacings(ring, b, t_ns));
    if (stepped == 0) {
        --ring->head;
        ++a->n_spikes[sensor];
    } else if (sensor == IPE_FORCE) {
        doubt_step(a, b, at, stepped & ~(uint32_t)a->unknown[b % IPE_RING]);
    }
}

/// Before a sample of force or position is put at the ring's head: judge the suspect before it, and is it one itself?
static void gate_spikes(ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, const double* value)
{
    ipe_ring_t* ring = &a->ring[sensor];
    if (ring->is_suspect) { judge_suspect(a, sensor, t_ns, value); }
    ring->is_suspect = false;
    if (ring->head < oldest(ring) + 2) { return; }
    const uint64_t b = ring->head - 1;
    if (t_ns - stamp(ring, b - 1) > a->max_age_ns[sensor]) { return; }
    ring->is_suspect = ipe_spike_gate_is_suspect(&a->spike_gate[sensor], sample(a, sensor, b - 1), sample(a, sensor, b),
                                                 value, spacings(ring, b, t_ns));
}

/// A sample of force [m] comes soon after a step, or repeats since then.
static uint32_t doubt(ipe_align_t* a, const double* value)
{
    if (a->n_doubted == 0) { return 0; }
    bool is_same = true;
    for (int i = 0; i < a->n_cables; ++i) {
        is_same = is_same && (!(a->stepped >> (unsigned)i & 1U) || value[i] == a->stepped_to);
        if (a->stepped >> (unsigned)i & 1U) { a->stepped_to = value[i]; }
    }
    a->n_doubted = is_same ? DOUBTED_SAMPLES : a->n_doubted - 1;
    return a->stepped;
}

/// Can the cables hold the tracked point there?
static bool is_reachable(const ipe_align_t* a, const double x[3])
{
    const double below = fmax(0.0, a->reach_high[2] - x[2]);
    bool is_inside = x[2] <= a->reach_high[2];
    for (int k = 0; k < 2; ++k) { is_inside &= x[k] >= a->reach_low[k] - below && x[k] <= a->reach_high[k] + below; }
    return is_inside;
}

/// Is the sample usable whatever its time? q: attitude of an IMU sample.
static ipe_status_t check_value(ipe_align_t* a, ipe_sensor_t sensor, const double* value, double q[4])
{
    assert(sensor >= IPE_IMU && sensor < IPE_SENSOR_COUNT);
    if (!all_finite(value, width(a, sensor))) {
        ++a->n_nonfinite[sensor];
        return IPE_ERR_NONFINITE;
    }
    if (sensor == IPE_IMU && !read_attitude(a, value + 6, q)) {
        ++a->n_bad_quaternion;
        return IPE_ERR_RANGE;
    }
    if (sensor == IPE_POSITION && !is_reachable(a, value)) {
        ++a->n_unreachable;
        return IPE_ERR_RANGE;
    }
    return IPE_OK;
}

ipe_status_t ipe_align_push(ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, const double* value)
{
    double q[4];
    uint64_t place;
    const int64_t instant = t_ns - a->delay_ns[sensor];
    ipe_status_t status = check_value(a, sensor, value, q);
    if (status == IPE_OK) { status = find_place(a, sensor, instant, &place); }
    if (status != IPE_OK) { return status; }
    if (sensor != IPE_IMU && place == a->ring[sensor].head) {
        gate_spikes(a, sensor, instant, value);
        place = a->ring[sensor].head;
    }
    open_place(a, sensor, place);
    store(a, sensor, place, value, q);
    if (sensor == IPE_FORCE) { a->unknown[place % IPE_RING] |= (uint16_t)doubt(a, value); }
    a->ring[sensor].t_ns[place % IPE_RING] = instant;
    ++a->n_samples[sensor];
    note_lateness(a, sensor, instant);
    return IPE_OK;
}

ipe_status_t ipe_align_hold(ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, const double* value)
{
    double q[4];
    ipe_ring_t* ring = &a->ring[sensor];
    const ipe_status_t status = check_value(a, sensor, value, q);
    if (status != IPE_OK) { return status; }
    const int64_t latest = t_ns - a->delay_ns[sensor];
    const bool has_two = ring->n_held == 0 && ring->head > ring->first + 1;
    const int64_t spacing = has_two ? stamp(ring, ring->head - 1) - stamp(ring, ring->head - 2) : 0;
    const int64_t back = ring->head > ring->first ? stamp(ring, ring->head - 1) + spacing / DUPLICATE - latest : 0;
    if (back > 0 && back <= RESTART_NS) {
        ++a->n_backwards[sensor];
        return IPE_ERR_TIME;
    }
    if (ring->n_held == IPE_SAMPLE_TIMING_HOLD) { ipe_align_settle(a, sensor, IPE_SAMPLE_TIMING_HOLD - 1, NULL); }
    open_place(a, sensor, ring->head);
    store(a, sensor, ring->head - 1, value, q);
    ring->t_ns[(ring->head - 1) % IPE_RING] = latest;
    ++ring->n_held;
    return IPE_OK;
}

void ipe_align_settle(ipe_align_t* a, ipe_sensor_t sensor, int n, const int64_t* t_ns)
{
    ipe_ring_t* ring = &a->ring[sensor];
    const uint64_t end = ring->head, keep = (uint64_t)n;
    ring->head -= ring->n_held;
    ring->n_held = 0;
    for (uint64_t i = end - keep; i < end; ++i) {
        uint64_t place = ring->head;
        if (t_ns != NULL) {
            const int64_t instant = t_ns[i - (end - keep)] - a->delay_ns[sensor];
            if (find_place(a, sensor, instant, &place) != IPE_OK) { continue; }
            if (place != ring->head) {  // between samples in place, where no room is made any more
                --a->n_reordered[sensor];
                ++a->n_backwards[sensor];
                continue;
            }
            if (sensor != IPE_IMU) { gate_spikes(a, sensor, instant, sample(a, sensor, i)); }
            if (sensor == IPE_FORCE) { a->unknown[i % IPE_RING] |= (uint16_t)doubt(a, sample(a, sensor, i)); }
            place = ring->head;
            ring->t_ns[i % IPE_RING] = instant;
            ++a->n_samples[sensor];
            note_lateness(a, sensor, instant);
        }
        copy_sample(a, sensor, i, place);
        ++ring->head;
    }
    if (t_ns == NULL) { ring->n_held = (unsigned)n; }
}

typedef enum { FOUND, WAIT, GAP, LATE } search_t;

/// Period of a sensor by its last two samples, at most max_age, which it is taken for before there are two.
static int64_t period(const ipe_align_t* a, ipe_sensor_t sensor)
{
    const ipe_ring_t* ring = &a->ring[sensor];
    const uint64_t end = timed(ring);
    if (end < oldest(ring) + 2) { return a->max_age_ns[sensor]; }
    const int64_t spacing = stamp(ring, end - 1) - stamp(ring, end - 2);
    return spacing < a->max_age_ns[sensor] ? spacing : a->max_age_ns[sensor];
}

/// May the row at t_ns wait for more of this sensor?
static bool may_wait_for(const ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns)
{
    const ipe_ring_t* imu = &a->ring[IPE_IMU];
    const bool is_full = imu->head - imu->cursor >= IPE_RING;
    const int64_t waited = stamp(imu, timed(imu) - 1) - t_ns;
    const int n_awaited = NEIGHBOURS + (a->ring[sensor].is_suspect ? 1 : 0);
    return !a->is_ending && !is_full && waited <= a->max_wait_ns + n_awaited * period(a, sensor);
}

/// Put a cursor on the sample at or before t and say whether t can be interpolated from there.
static search_t search(const ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, uint64_t* cursor)
{
    const ipe_ring_t* ring = &a->ring[sensor];
    if (*cursor < oldest(ring)) { *cursor = oldest(ring); }
    while (*cursor + 1 < usable(ring) && stamp(ring, *cursor + 1) <= t_ns + SAME_INSTANT_NS) { ++*cursor; }
    if (usable(ring) == ring->first) { return may_wait_for(a, sensor, t_ns) ? WAIT : LATE; }
    const int64_t since = t_ns - stamp(ring, *cursor);
    if (since < -SAME_INSTANT_NS) { return GAP; }
    if (since <= SAME_INSTANT_NS) { return FOUND; }
    const uint64_t behind = usable(ring) - 1 - *cursor;
    if (behind < NEIGHBOURS && may_wait_for(a, sensor, t_ns)) { return WAIT; }
    if (behind < 1) { return LATE; }
    return stamp(ring, *cursor + 1) - stamp(ring, *cursor) > a->max_age_ns[sensor] ? GAP : FOUND;
}

/// The forces at t and, where a delay was found, at t plus that.
static search_t search_force(ipe_align_t* a, int64_t t_ns)
{
    const search_t measured = search(a, IPE_FORCE, t_ns, &a->ring[IPE_FORCE].cursor);
    if (a->force_delay_ns == 0 || measured != FOUND) { return measured; }
    return search(a, IPE_FORCE, t_ns + a->force_delay_ns, &a->undelayed);
}

/// Cubic Hermite weights of the samples i - 1 .. i + 2 at t. A missing outer neighbour, or one beyond a gap, leaves the
/// slope of the bracket itself.
static void hermite_weights(const ipe_align_t* a, ipe_sensor_t sensor, uint64_t i, int64_t t_ns, double weight[4])
{
    const ipe_ring_t* ring = &a->ring[sensor];
    const double h = 1e-9 * (double)(stamp(ring, i + 1) - stamp(ring, i));
    const double x = 1e-9 * (double)(t_ns - stamp(ring, i)) / h;
    const double h00 = (1.0 + 2.0 * x) * (1.0 - x) * (1.0 - x), h10 = x * (1.0 - x) * (1.0 - x);
    const double h01 = x * x * (3.0 - 2.0 * x), h11 = x * x * (x - 1.0);
    weight[0] = 0.0, weight[1] = h00, weight[2] = h01, weight[3] = 0.0;
    const int64_t before = i > oldest(ring) ? stamp(ring, i) - stamp(ring, i - 1) : 0;
    const int64_t after = i + 2 < usable(ring) ? stamp(ring, i + 2) - stamp(ring, i + 1) : 0;
    if (before > 0 && before <= a->max_age_ns[sensor]) {
        const double g = 1e-9 * (double)before;  // slope at i: parabola through i - 1, i, i + 1
        weight[0] += h10 * (-h * h / (g * (g + h)));
        weight[1] += h10 * (h - g) / g;
        weight[2] += h10 * g / (g + h);
    } else {
        weight[1] -= h10, weight[2] += h10;
    }
    if (after > 0 && after <= a->max_age_ns[sensor]) {
        const double g = 1e-9 * (double)after;  // slope at i + 1: parabola through i, i + 1, i + 2
        weight[1] += h11 * (-g / (g + h));
        weight[2] += h11 * (g - h) / g;
        weight[3] += h11 * h * h / (g * (g + h));
    } else {
        weight[1] -= h11, weight[2] += h11;
    }
}

/// Between the samples i and i + 1.
static void interpolate(const ipe_align_t* a, ipe_sensor_t sensor, uint64_t i, int64_t t_ns, const double* samples,
                        size_t stride, size_t n, double* out)
{
    if (t_ns - stamp(&a->ring[sensor], i) <= SAME_INSTANT_NS) {
        memcpy(out, samples + (i % IPE_RING) * stride, n * sizeof(double));
        return;
    }
    double weight[4];
    hermite_weights(a, sensor, i, t_ns, weight);
    memset(out, 0, n * sizeof(double));
    for (uint64_t k = 0; k < 4; ++k) {
        if (weight[k] == 0.0) { continue; }
        const double* v = samples + ((i + k + IPE_RING - 1) % IPE_RING) * stride;
        for (size_t j = 0; j < n; ++j) { out[j] += weight[k] * v[j]; }
    }
}

/// Cables whose force a sample around the row does not tell, i - 1 .. i + 2.
static uint32_t unknown_around(const ipe_align_t* a, uint64_t i)
{
    const ipe_ring_t* ring = &a->ring[IPE_FORCE];
    const uint64_t end = i + 1 + NEIGHBOURS;
    uint32_t unknown = 0;
    for (uint64_t k = i > oldest(ring) ? i - 1 : i; k < end && k < usable(ring); ++k) {
        unknown |= a->unknown[k % IPE_RING];
    }
    return unknown;
}

void ipe_align_set_unknown_force(ipe_align_t* a, uint32_t unknown)
{
    a->unknown_force = unknown;
}

static void fill_force(const ipe_align_t* a, uint64_t i, int64_t t_ns, double f[IPE_CABLES_MAX])
{
    interpolate(a, IPE_FORCE, i, t_ns, &a->force[0][0], IPE_CABLES_MAX, (size_t)a->n_cables, f);
}

/// The row of the IMU sample at the cursor.
static void fill_row(ipe_align_t* a, int64_t t_ns, search_t force, search_t position, ipe_row_t* row)
{
    const double* imu = a->imu[a->ring[IPE_IMU].cursor % IPE_RING];
    memset(row, 0, sizeof *row);
    row->t_ns = t_ns;
    memcpy(row->acc, imu, sizeof row->acc);
    memcpy(row->gyro, imu + 3, sizeof row->gyro);
    memcpy(row->q, imu + 6, sizeof row->q);
    row->has_force = force == FOUND;
    row->has_position = position == FOUND;
    if (row->has_force) {
        fill_force(a, a->ring[IPE_FORCE].cursor, t_ns, row->f);
        row->unknown_force = unknown_around(a, a->ring[IPE_FORCE].cursor);
        if (a->force_delay_ns != 0) { row->unknown_force |= unknown_around(a, a->undelayed); }
    }
    if (row->has_position && a->position_source == IPE_POSITION_FIXED) {
        memcpy(row->position, a->fixed_position, sizeof a->fixed_position);
    } else if (row->has_position) {
        const uint64_t sample = a->ring[IPE_POSITION].cursor;
        interpolate(a, IPE_POSITION, sample, t_ns, &a->position[0][0], 3, 3, row->position);
        row->is_position_new = sample != a->position_seen;
        a->position_seen = sample;
    }
}

void ipe_align_undelay_forces(const ipe_align_t* a, double f[IPE_CABLES_MAX])
{
    if (a->force_delay_ns != 0) { fill_force(a, a->undelayed, a->row_ns + a->force_delay_ns, f); }
}

static void count(ipe_align_t* a, ipe_sensor_t sensor, search_t found)
{
    a->n_missing[sensor] += found == GAP;
    a->n_late[sensor] += found == LATE;
}

ipe_status_t ipe_align_pop(ipe_align_t* a, ipe_row_t* row)
{
    ipe_ring_t* imu = &a->ring[IPE_IMU];
    while (imu->cursor < timed(imu)) {
        const int64_t t_ns = stamp(imu, imu->cursor);
        const search_t force = search_force(a, t_ns);
        const bool is_fixed = a->position_source == IPE_POSITION_FIXED;
        const search_t position = is_fixed ? FOUND : search(a, IPE_POSITION, t_ns, &a->ring[IPE_POSITION].cursor);
        if (force == WAIT || position == WAIT) { return IPE_NOT_READY; }
        fill_row(a, t_ns, force, position, row);
        count(a, IPE_FORCE, force);
        count(a, IPE_POSITION, position);
        ++imu->cursor;
        a->row_ns = t_ns;
        ++a->n_rows;
        return IPE_OK;
    }
    return IPE_NOT_READY;
}
