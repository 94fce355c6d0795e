// SPDX-License-Identifier: Apache-2.0
#include "stuck_sensor.h"

#include <math.h>
#include <string.h>

#define STUCK_NS 250000000LL     // unchanged for 0.25 s, the default max_age of a position,
#define SAME_MAX 1000000         // so far repeats are counted: chosen so that the count cannot overflow
#define STUCK_SAMPLES 8          // and so many samples: chosen so that slow sensors may repeat a value
#define SMOOTHING_S 0.2F         // s, of the specific force: chosen to average vibration and to follow motion
#define SETTLED_NS 1000000000LL  // ns, five times SMOOTHING_S: then it is a mean
#define MOVED 0.2F               // m/s2: chosen over the noise of that mean
#define RESOLUTION_STEPS 4.0     // of a force signal: chosen so that quantisation is not called stuck
#define LEARNING_SAMPLES 200  // of a force signal that changed: chosen so that its noise and its longest run are known
#define NOISE_MEMORY 64.0F    // samples that the noise is a mean of: chosen so that it is known to a sixth
#define NOISE_STEPS \
    4.0F                // of its resolution, over which a signal does not repeat by chance 8 times: once in 1e6 samples
#define LONGEST_RUNS 4  // times the longest run: chosen so that a gateway that repeats samples is not called stuck
#define UNKNOWN_MAX 2   // forces: chosen so that most of a window's 6 equations are left
#define FORCES_MOVED 0.05F  // of their sum: chosen so that swing is not called motion

/// Largest value that an integer signal can have, less half a step.
static double range_end(const ipe_signal_t* s)
{
    const int bits = s->is_signed ? s->length - 1 : s->length;
    const double largest = s->scale > 0.0 ? ldexp(1.0, bits) - 1.0 : s->is_signed ? -ldexp(1.0, bits) : 0.0;
    return s->scale * largest + s->offset - 0.5 * fabs(s->scale);
}

void ipe_stuck_sensor_init(ipe_stuck_sensor_t* k, const ipe_config_t* config)
{
    memset(k, 0, sizeof *k);
    k->n_cables = config->n_cables;
    k->n_imu = config->attitude_source == IPE_ATTITUDE_RPY ? 9 : 10;
    for (int i = 0; i < k->n_cables; ++i) {
        k->threshold[i] = MOVED;
        k->force[i].range_end = HUGE_VAL;
    }
    for (int i = 0; i < config->n_signals; ++i) {
        const ipe_signal_t* s = &config->signal[i];
        const int cable = s->quantity - IPE_Q_F_1;
        if (cable < 0 || cable >= k->n_cables || s->kind != IPE_INTEGER) { continue; }
        k->force[cable].range_end = range_end(s);
        if (config->prior_theta[0] <= 0.0) { continue; }
        const double per_newton = k->n_cables / config->prior_theta[0];
        k->threshold[cable] = fmaxf(MOVED, (float)(RESOLUTION_STEPS * fabs(s->scale) * per_newton));
    }
}

static float distance(const float a[3], const float b[3])
{
    return sqrtf((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
}

static float size(const float a[3])
{
    return sqrtf(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
}

/// From now on motion is what differs from the specific force of this moment.
static void refer(const ipe_stuck_sensor_t* k, ipe_stuck_sensor_channel_t* c)
{
    memcpy(c->reference, k->acc, sizeof c->reference);
    c->lag = distance(k->acc, k->imu);
}

/// Note whether a channel changed. True if it should have and did not.
static bool watch(ipe_stuck_sensor_t* k, int channel, int64_t t_ns, const double* value, float* last, int n)
{
    ipe_stuck_sensor_channel_t* c = &k->channel[channel];
    bool is_same = c->n_same > 0;
    for (int i = 0; i < n; ++i) {
        is_same = is_same && last[i] == (float)value[i];
        last[i] = (float)value[i];
    }
    if (!is_same || t_ns < c->since_ns) {
        *c = (ipe_stuck_sensor_channel_t){.since_ns = t_ns, .n_same = 1};
        if (k->acc_ns - k->acc_since_ns >= SETTLED_NS) { refer(k, c); }
        return false;
    }
    c->n_same += c->n_same < SAME_MAX;
    return c->has_moved && c->n_same >= STUCK_SAMPLES && t_ns - c->since_ns > STUCK_NS;
}

/// Judge the other channels by the specific force. A reference is taken when there is something to compare.
static void note_motion(ipe_stuck_sensor_t* k, int64_t t_ns)
{
    if (k->acc_ns == 0) { k->acc_since_ns = t_ns; }
    const float share = k->acc_ns == 0 ? 1.0F : 1e-9F * (float)(t_ns - k->acc_ns) / SMOOTHING_S;
    for (int i = 0; i < 3; ++i) { k->acc[i] += fminf(fmaxf(share, 0.0F), 1.0F) * (k->imu[i] - k->acc[i]); }
    k->acc_ns = t_ns;
    if (t_ns - k->acc_since_ns < SETTLED_NS) { return; }
    for (int i = 0; i < k->n_cables; ++i) {
        ipe_stuck_sensor_channel_t* c = &k->channel[i];
        if (size(c->reference) == 0.0F) { refer(k, c); }
        c->has_moved |= distance(k->acc, c->reference) > k->threshold[i] + c->lag;
    }
    ipe_stuck_sensor_channel_t* position = &k->channel[IPE_STUCK_SENSOR_POSITION];
    if (size(position->reference) == 0.0F) { refer(k, position); }
    position->has_moved |= fabsf(size(k->acc) - size(position->reference)) > MOVED + position->lag;
}

static void note_forces(ipe_stuck_sensor_t* k)
{
    float change = 0.0F, sum = 0.0F;
    for (int i = 0; i < k->n_cables; ++i) {
        change += fabsf(k->f[i] - k->f_reference[i]);
        sum += fabsf(k->f_reference[i]);
    }
    if (sum == 0.0F) { memcpy(k->f_reference, k->f, sizeof k->f_reference); }
    k->channel[IPE_STUCK_SENSOR_IMU].has_moved |= sum > 0.0F && change > FORCES_MOVED * sum;
}

/// Learn a force signal's noise and resolution from its sample, after watch(); last: the one before.
static void learn_force(ipe_stuck_sensor_force_t* f, float last, float value)
{
    const float step = fabsf(value - last), bend = fabsf(value - 2.0F * last + f->before);
    f->before = last;
    if (step > 0.0F && (f->resolution == 0.0F || step < f->resolution)) { f->resolution = step; }
    f->n_seen += step > 0.0F && f->n_seen < LEARNING_SAMPLES;
    const float counted = f->n_seen < LEARNING_SAMPLES ? bend : fminf(bend, 3.0F * f->noise);
    f->noise += (counted - f->noise) / NOISE_MEMORY;
}

/// Does a noisy signal repeat, which it never did by chance, while the others change?
static bool is_silent(const ipe_stuck_sensor_t* k, int i, int n_changed)
{
    const ipe_stuck_sensor_force_t* f = &k->force[i];
    const int n_same = k->channel[i].n_same;
    return f->n_seen >= LEARNING_SAMPLES && f->noise > NOISE_STEPS * f->resolution && n_same >= STUCK_SAMPLES &&
           n_same >= LONGEST_RUNS * f->n_longest && 2 * n_changed >= k->n_cables - 1;
}

/// Is channel i of a sample of forces stuck? n_changed: channels of it that changed.
static bool is_force_stuck(ipe_stuck_sensor_t* k, int i, bool is_stuck, int n_changed)
{
    ipe_stuck_sensor_force_t* f = &k->force[i];
    if (is_stuck || is_silent(k, i, n_changed)) {
        f->was_stuck = true;
        f->stuck_at = k->f[i];
    }
    f->was_stuck = f->was_stuck && k->f[i] <= f->stuck_at;  // more than that: it was not saturated there
    return (f->was_stuck && k->f[i] == f->stuck_at) || (double)k->f[i] >= f->range_end;
}

/// Forces of a sample: which are stuck, and are they too many?
static bool watch_forces(ipe_stuck_sensor_t* k, int64_t t_ns, const double* value)
{
    bool is_stuck[IPE_CABLES_MAX];
    int n_changed = 0, n_unknown = 0;
    k->unknown = 0;
    for (int i = 0; i < k->n_cables; ++i) {
        const float last = k->f[i];
        const int n_same = k->channel[i].n_same;
        is_stuck[i] = watch(k, i, t_ns, &value[i], &k->f[i], 1);
        if (n_same > 0) { learn_force(&k->force[i], last, k->f[i]); }
        if (k->channel[i].n_same > 1) { continue; }
        ++n_changed;
        if (!(k->force[i].was_stuck && last == k->force[i].stuck_at) && n_same > k->force[i].n_longest) {
            k->force[i].n_longest = n_same;
        }
    }
    for (int i = 0; i < k->n_cables; ++i) {
        if (!is_force_stuck(k, i, is_stuck[i], n_changed)) { continue; }
        k->unknown |= 1U << (unsigned)i;
        ++n_unknown;
    }
    if (n_unknown > UNKNOWN_MAX || (n_unknown > 0 && 2 * n_unknown >= k->n_cables)) { return true; }
    k->n_unknown += n_unknown > 0;
    for (int i = 0; i < k->n_cables; ++i) { k->n_unknown_of[i] += k->unknown >> (unsigned)i & 1U; }
    return false;
}

bool ipe_stuck_sensor_push(ipe_stuck_sensor_t* k, ipe_sensor_t sensor, int64_t t_ns, const double* value)
{
    bool is_stuck = false;
    switch (sensor) {
    case IPE_IMU:
        is_stuck = watch(k, IPE_STUCK_SENSOR_IMU, t_ns, value, k->imu, k->n_imu);
        if (k->channel[IPE_STUCK_SENSOR_IMU].n_same == 1) { memcpy(k->f_reference, k->f, sizeof k->f_reference); }
        note_motion(k, t_ns);
        break;
    case IPE_FORCE:
        is_stuck = watch_forces(k, t_ns, value);
        note_forces(k);
        break;
    default: is_stuck = watch(k, IPE_STUCK_SENSOR_POSITION, t_ns, value, k->position, 3); break;
    }
    k->n_stuck[sensor] += is_stuck;
    return is_stuck;
}
