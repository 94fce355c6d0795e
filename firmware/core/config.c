// SPDX-License-Identifier: Apache-2.0
#include "config.h"

#include "smallmat.h"

#include <stdio.h>
#include <string.h>

#define BITRATE_MIN 1.0  // bit/s, chosen so that a frame's time on the wire, in ns, fits an int64_t
#define BITRATE_MAX 1e8  // bit/s, chosen over CAN XL's fastest, 20 Mbit/s
#define BITRATE_UNIT "bit/s, or 0: unknown"

typedef struct {
    char* message;
    size_t size;
    bool good;
} check_t;

static void refuse(check_t* c, const char* field, int index, double value, const char* allowed)
{
    if (!c->good) { return; }
    c->good = false;
    if (index < 0) {
        (void)snprintf(c->message, c->size, "%s = %.9g: %s", field, value, allowed);
    } else {
        (void)snprintf(c->message, c->size, "%s[%d] = %.9g: %s", field, index, value, allowed);
    }
}

static void check_range(check_t* c, const char* field, int index, double value, double low, double high,
                        const char* unit)
{
    if (value >= low && value <= high) { return; }
    char allowed[128];
    (void)snprintf(allowed, sizeof allowed, "allowed %g .. %g %s", low, high, unit);
    refuse(c, field, index, value, allowed);
}

static void check_all(check_t* c, const char* field, const double* value, int n, double low, double high,
                      const char* unit)
{
    for (int i = 0; i < n; ++i) { check_range(c, field, i, value[i], low, high, unit); }
}

/// 0 stands for none of its kind.
static void check_all_or_0(check_t* c, const char* field, const double* value, int n, double low, double high,
                           const char* unit)
{
    for (int i = 0; i < n; ++i) {
        if (value[i] != 0.0) { check_range(c, field, i, value[i], low, high, unit); }
    }
}

static void check_unit(check_t* c, const char* field, int index, const double* v, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; ++i) { sum += v[i] * v[i]; }
    if (!(fabs(sqrt(sum) - 1.0) < 1e-6)) {
        refuse(c, field, index, sqrt(sum), "length of a unit vector, allowed 1 +- 1e-6");
    }
}

static void check_covariance(check_t* c, const char* field, const double* P, int n)
{
    double L[IPE_NP * IPE_NP];
    memcpy(L, P, sizeof(double) * (size_t)(n * n));
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < i; ++j) {
            if (!(fabs(P[i * n + j] - P[j * n + i]) <= 1e-9 * (fabs(P[i * n + i]) + fabs(P[j * n + j])))) {
                refuse(c, field, i * n + j, P[i * n + j], "must be symmetric");
            }
        }
    }
    if (c->good && !cholesky(L, (size_t)n)) { refuse(c, field, -1, P[0], "must be positive definite"); }
}

static void check_cable(check_t* c, const ipe_cable_t* cable, int i)
{
    check_all(c, "cable.anchor", cable->anchor, 3, -1e4, 1e4, "m");
    check_all(c, "cable.attachment", cable->attachment, 3, -1e3, 1e3, "m");
    check_range(c, "cable.pulley_radius", i, cable->pulley_radius, 0.0, 10.0, "m");
    check_unit(c, "cable.swivel_axis", i, cable->swivel_axis, 3);
    check_range(c, "cable.weight_per_length", i, cable->weight_per_length, 0.0, 1e4, "N/m");
    check_range(c, "cable.tension_min", i, cable->tension_min, 0.0, 1e7, "N");
    check_range(c, "cable.tension_max", i, cable->tension_max, cable->tension_min, 1e8, "N");
    check_range(c, "cable.force_at", i, cable->force_at, IPE_FORCE_AT_PLATFORM, IPE_FORCE_AT_WINCH, "");
}

/// Last bit of a Motorola signal counted from the frame's first, most significant bit; Intel: from the least.
static int last_bit(const ipe_signal_t* s)
{
    const int first = s->big_endian ? (s->start / 8) * 8 + 7 - s->start % 8 : s->start;
    return first + s->length - 1;
}

static void check_signal(check_t* c, const ipe_signal_t* s, int i)
{
    check_range(c, "signal.quantity", i, s->quantity, 0, IPE_Q_COUNT - 1, "");
    check_range(c, "signal.bus", i, s->bus, 0, IPE_BUSES_MAX - 1, "");
    check_range(c, "signal.can_id", i, (s->can_id & ~IPE_CAN_EFF), 0, (s->can_id & IPE_CAN_EFF) ? 0x1FFFFFFF : 0x7FF,
                "");
    check_range(c, "signal.frame_length", i, s->frame_length, 1, IPE_DATA_MAX, "bytes");
    check_range(c, "signal.length", i, s->length, 1, 64, "bits");
    check_range(c, "signal.start", i, s->start, 0, 8 * IPE_DATA_MAX - 1, "");
    check_range(c, "signal last bit", i, last_bit(s), 0, 8.0 * s->frame_length - 1, "in its frame");
    check_range(c, "signal.kind", i, s->kind, IPE_INTEGER, IPE_FLOAT64, "");
    if (s->kind == IPE_FLOAT32) { check_range(c, "signal.length", i, s->length, 32, 32, "bits for float32"); }
    if (s->kind == IPE_FLOAT64) { check_range(c, "signal.length", i, s->length, 64, 64, "bits for float64"); }
    check_range(c, "signal.scale", i, fabs(s->scale), 1e-30, 1e30, "in magnitude");
    check_range(c, "signal.offset", i, s->offset, -1e30, 1e30, "");
    check_range(c, "signal.minimum", i, s->minimum, -HUGE_VAL, HUGE_VAL, "");
    check_range(c, "signal.maximum", i, s->maximum, s->minimum, HUGE_VAL, "");
    check_range(c, "signal.mux_start", i, s->mux_start, -1, 8.0 * s->frame_length - 1, "");
    if (s->mux_start >= 0) { check_range(c, "signal.mux_length", i, s->mux_length, 1, 32, "bits"); }
}

static void check_bound(check_t* c, uint64_t bound, int first, int n, const char* what)
{
    for (int i = 0; i < n; ++i) {
        if (!(bound >> (first + i) & 1U)) { refuse(c, what, i, 0, "no CAN signal is bound to it"); }
    }
}

static void check_bindings(check_t* c, const ipe_config_t* k)
{
    uint64_t bound = 0;
    for (int i = 0; i < k->n_signals; ++i) { bound |= 1ULL << (unsigned)k->signal[i].quantity; }
    check_bound(c, bound, IPE_Q_ACC_X, 3, "acc");
    check_bound(c, bound, IPE_Q_GYRO_X, 3, "gyro");
    if (k->attitude_source == IPE_ATTITUDE_QUATERNION) { check_bound(c, bound, IPE_Q_QUAT_W, 4, "quaternion"); }
    if (k->attitude_source == IPE_ATTITUDE_RPY) { check_bound(c, bound, IPE_Q_ROLL, 3, "roll pitch yaw"); }
    if (k->position_source == IPE_POSITION_CAN) { check_bound(c, bound, IPE_Q_POS_X, 3, "position"); }
    check_bound(c, bound, IPE_Q_F_1, k->n_cables, "force");
}

static void check_std(check_t* c, const ipe_config_t* k)
{
    const struct {
        const char* field;
        double value;
    } std[] = {
        {"std_acc_bias", k->std_acc_bias},
        {"std_gyro_bias", k->std_gyro_bias},
        {"std_attitude", k->std_attitude},
        {"std_world_yaw", k->std_world_yaw},
        {"std_imu_alignment", k->std_imu_alignment},
        {"std_imu_position", k->std_imu_position},
        {"std_force_offset", k->std_force_offset},
        {"std_force_gain", k->std_force_gain},
        {"std_force_delay", k->std_force_delay},
        {"std_position_delay", k->std_position_delay},
        {"std_geometry", k->std_geometry},
        {"std_attitude_wander", k->std_attitude_wander},
        {"std_tracker_target", k->std_tracker_target},
        {"std_attitude_delay", k->std_attitude_delay},
        {"std_friction", k->std_friction},
        {"std_force_offset_drift", k->std_force_offset_drift},
        {"std_acc_scale", k->std_acc_scale},
        {"std_gyro_scale", k->std_gyro_scale},
        {"std_external_force", k->std_external_force},
        {"std_external_stiffness", k->std_external_stiffness},
    };
    for (size_t i = 0; i < sizeof std / sizeof std[0]; ++i) {
        check_range(c, std[i].field, -1, std[i].value, 0.0, 1e6, "SI");
    }
}

ipe_status_t ipe_config_check(const ipe_config_t* config, char* message, size_t size)
{
    const ipe_config_t* k = config;
    check_t check = {message, size, true};
    check_t* c = &check;
    check_range(c, "gravity", -1, k->gravity, 0.0, 1e3, "m/s2");
    check_range(c, "n_cables", -1, k->n_cables, 1, IPE_CABLES_MAX, "");
    for (int i = 0; c->good && i < k->n_cables; ++i) { check_cable(c, &k->cable[i], i); }
    check_all(c, "imu_position", k->imu_position, 3, -1e3, 1e3, "m");
    check_unit(c, "imu_orientation", -1, k->imu_orientation, 4);
    check_all(c, "tracker_target", k->tracker_target, 3, -1e3, 1e3, "m");
    check_range(c, "sample_rate", -1, k->sample_rate, 0.0, 1e5, "Hz");
    check_range(c, "attitude_source", -1, k->attitude_source, IPE_ATTITUDE_QUATERNION, IPE_ATTITUDE_RPY, "");
    check_range(c, "attitude_estimate", -1, k->attitude_estimate, IPE_ATTITUDE_AHRS,
                k->position_source == IPE_POSITION_FIXED ? IPE_ATTITUDE_AHRS : IPE_ATTITUDE_FUSED,
                "(fused needs a measured position)");
    check_range(c, "position_source", -1, k->position_source, IPE_POSITION_TRACKER, IPE_POSITION_CAN, "");
    check_all(c, "fixed_position", k->fixed_position, 3, -1e4, 1e4, "m");
    check_range(c, "n_signals", -1, k->n_signals, 1, IPE_SIGNALS_MAX, "");
    for (int i = 0; c->good && i < k->n_signals; ++i) { check_signal(c, &k->signal[i], i); }
    if (c->good) { check_bindings(c, k); }
    check_all_or_0(c, "bus_bitrate", k->bus_bitrate, IPE_BUSES_MAX, BITRATE_MIN, BITRATE_MAX, BITRATE_UNIT);
    check_all_or_0(c, "bus_data_bitrate", k->bus_data_bitrate, IPE_BUSES_MAX, BITRATE_MIN, BITRATE_MAX, BITRATE_UNIT);
    check_range(c, "max_wait", -1, k->max_wait, 0.0, IPE_MAX_WAIT, "s");
    check_all(c, "max_age", k->max_age, IPE_SENSOR_COUNT, 1e-6, 10.0, "s");
    check_range(c, "max_wait * sample_rate", -1, k->max_wait * k->sample_rate, 0.0, IPE_WAIT_MAX,
                "samples, the buffers' capacity: lower max_wait");
    check_range(c, "max_carry", -1, k->max_carry, 0.0, 10.0, "s");
    check_all(c, "delay", k->delay, IPE_SENSOR_COUNT, -1.0, 1.0, "s");
    check_range(c, "delay_attitude", -1, k->delay_attitude, -1.0, 1.0, "s");
    check_all(c, "acc_bias", k->acc_bias, 3, -20.0, 20.0, "m/s2");
    check_all(c, "gyro_bias", k->gyro_bias, 3, -1.0, 1.0, "rad/s");
    check_all(c, "attitude_bias", k->attitude_bias, 3, -1.0, 1.0, "rad");
    check_range(c, "world_yaw", -1, k->world_yaw, -7.0, 7.0, "rad");
    check_all(c, "force_offset", k->force_offset, IPE_CABLES_MAX, -1e6, 1e6, "N");
    check_all(c, "force_gain", k->force_gain, IPE_CABLES_MAX, -0.9, 9.0, "");
    check_std(c, k);
    check_all(c, "external_attachment", k->external_attachment, 3, -1e3, 1e3, "m");
    check_all(c, "external_reference", k->external_reference, 3, -1e4, 1e4, "m");
    check_range(c, "window_length", -1, k->window_length, 0.01, 10.0, "s");
    if (k->memory != 0.0) { check_range(c, "memory", -1, k->memory, 10.0, 1e9, "s, or 0: for ever"); }
    check_covariance(c, "residual_covariance", &k->residual_covariance[0][0], IPE_NY);
    check_all(c, "prior_theta", k->prior_theta, IPE_NP, -1e9, 1e9, "SI");
    check_covariance(c, "prior_covariance", &k->prior_covariance[0][0], IPE_NP);
    check_range(c, "estimate_rate", -1, k->estimate_rate, 0.01, 1e4, "Hz");
    return c->good ? IPE_OK : IPE_ERR_CONFIG;
}

double ipe_config_wrap(const ipe_config_t* config, int quantity)
{
    for (int i = 0; i < config->n_signals; ++i) {
        const ipe_signal_t* s = &config->signal[i];
        if (s->quantity == quantity && s->kind == IPE_INTEGER) { return ldexp(fabs(s->scale), s->length); }
    }
    return 0.0;
}
