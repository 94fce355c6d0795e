// SPDX-License-Identifier: Apache-2.0
#include "config_file.h"

#include "crc.h"

#include "inertiad_lcm_robot_config_t.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

typedef inertiad_lcm_robot_config_t wire_t;

enum { FINGERPRINT_BYTES = 8, CRC_BYTES = IPE_CONFIG_CRC_BYTES, FILE_MAX = IPE_CONFIG_FILE_MAX };

// The micro profile reads the same file; ipe_config_check() refuses what has more cables or signals than it holds.
static_assert(sizeof(((wire_t*)0)->cable) / sizeof(inertiad_lcm_cable_config_t) >= IPE_CABLES_MAX,
              "the message holds every cable");
static_assert(sizeof(((wire_t*)0)->signal) / sizeof(inertiad_lcm_signal_config_t) >= IPE_SIGNALS_MAX,
              "the message holds every signal");
static_assert(sizeof(wire_t) < FILE_MAX, "a whole configuration fits the file buffer");

/// Arrays of the message and of ipe_config_t have the same size, or this does not compile.
#define COPY(to, from)                                                               \
    do {                                                                             \
        static_assert(sizeof(to) == sizeof(from), "field differs from the message"); \
        memcpy((to), (from), sizeof(to));                                            \
    } while (0)

/// As many entries of one per cable as ipe_config_t has.
#define COPY_CABLES(to, from)                                                        \
    do {                                                                             \
        static_assert(sizeof(to) <= sizeof(from), "field differs from the message"); \
        memcpy((to), (from), sizeof(to));                                            \
    } while (0)

uint32_t ipe_config_crc(const uint8_t* bytes, size_t n)
{
    return ipe_crc_extend(0, bytes, n);
}

static uint64_t big_endian(const uint8_t* bytes, int n)
{
    uint64_t value = 0;
    for (int i = 0; i < n; ++i) { value = (value << 8) | bytes[i]; }
    return value;
}

static void copy_cable(ipe_cable_t* to, const inertiad_lcm_cable_config_t* from)
{
    COPY(to->anchor, from->anchor);
    COPY(to->attachment, from->attachment);
    to->pulley_radius = from->pulley_radius;
    COPY(to->swivel_axis, from->swivel_axis);
    to->weight_per_length = from->weight_per_length;
    to->tension_min = from->tension_min;
    to->tension_max = from->tension_max;
    to->force_at = from->force_at;
}

static void copy_signal(ipe_signal_t* to, const inertiad_lcm_signal_config_t* from)
{
    to->quantity = from->quantity;
    to->bus = from->bus;
    to->can_id = (uint32_t)from->can_id;
    to->frame_length = from->frame_length;
    to->start = from->start;
    to->length = from->length;
    to->big_endian = from->big_endian != 0;
    to->is_signed = from->is_signed != 0;
    to->kind = from->kind;
    to->scale = from->scale;
    to->offset = from->offset;
    to->minimum = from->minimum;
    to->maximum = from->maximum;
    to->mux_start = from->mux_start;
    to->mux_length = from->mux_length;
    to->mux_big_endian = from->mux_big_endian != 0;
    to->mux_value = from->mux_value;
}

static void copy_robot(ipe_config_t* to, const wire_t* from)
{
    COPY(to->name, from->name);
    to->name[sizeof to->name - 1] = '\0';
    to->gravity = from->gravity;
    to->n_cables = from->n_cables;
    for (int i = 0; i < IPE_CABLES_MAX; ++i) { copy_cable(&to->cable[i], &from->cable[i]); }
    COPY(to->imu_position, from->imu_position);
    COPY(to->imu_orientation, from->imu_orientation);
    COPY(to->tracker_target, from->tracker_target);
}

static void copy_sources(ipe_config_t* to, const wire_t* from)
{
    to->sample_rate = from->sample_rate;
    to->attitude_source = from->attitude_source;
    to->attitude_estimate = from->attitude_estimate;
    to->position_source = from->position_source;
    COPY(to->fixed_position, from->fixed_position);
    to->n_signals = from->n_signals;
    for (int i = 0; i < IPE_SIGNALS_MAX; ++i) { copy_signal(&to->signal[i], &from->signal[i]); }
    COPY(to->bus_bitrate, from->bus_bitrate);
    COPY(to->bus_data_bitrate, from->bus_data_bitrate);
    to->max_wait = from->max_wait;
    COPY(to->max_age, from->max_age);
    to->max_carry = from->max_carry;
    COPY(to->delay, from->delay);
    to->delay_attitude = from->delay_attitude;
}

static void copy_calibration(ipe_config_t* to, const wire_t* from)
{
    COPY(to->acc_bias, from->acc_bias);
    COPY(to->gyro_bias, from->gyro_bias);
    COPY(to->attitude_bias, from->attitude_bias);
    to->world_yaw = from->world_yaw;
    COPY_CABLES(to->force_offset, from->force_offset);
    COPY_CABLES(to->force_gain, from->force_gain);
    to->std_acc_bias = from->std_acc_bias;
    to->std_gyro_bias = from->std_gyro_bias;
    to->std_attitude = from->std_attitude;
    to->std_world_yaw = from->std_world_yaw;
    to->std_imu_alignment = from->std_imu_alignment;
    to->std_imu_position = from->std_imu_position;
    to->std_force_offset = from->std_force_offset;
    to->std_force_gain = from->std_force_gain;
    to->std_force_delay = from->std_force_delay;
    to->std_position_delay = from->std_position_delay;
    to->std_geometry = from->std_geometry;
    to->std_attitude_wander = from->std_attitude_wander;
    to->std_tracker_target = from->std_tracker_target;
    to->std_attitude_delay = from->std_attitude_delay;
    to->std_friction = from->std_friction;
    to->std_force_offset_drift = from->std_force_offset_drift;
    to->std_acc_scale = from->std_acc_scale;
    to->std_gyro_scale = from->std_gyro_scale;
    to->std_external_force = from->std_external_force;
    to->std_external_stiffness = from->std_external_stiffness;
    COPY(to->external_attachment, from->external_attachment);
    COPY(to->external_reference, from->external_reference);
}

static void copy_estimator(ipe_config_t* to, const wire_t* from)
{
    to->window_length = from->window_length;
    to->memory = from->memory;
    COPY(to->residual_covariance, from->residual_covariance);
    COPY(to->prior_theta, from->prior_theta);
    COPY(to->prior_covariance, from->prior_covariance);
    to->estimate_rate = from->estimate_rate;
}

static ipe_status_t refuse(ipe_status_t status, const char* reason, char* message, size_t size)
{
    (void)snprintf(message, size, "%s", reason);
    return status;
}

ipe_status_t ipe_config_from_bytes(const uint8_t* bytes, size_t n, ipe_config_t* config, char* message, size_t size)
{
    if (n <= FINGERPRINT_BYTES + CRC_BYTES) {
        return refuse(IPE_ERR_LENGTH, "too short to be a configuration; run inertiactl compile again", message, size);
    }
    const size_t n_wire = n - CRC_BYTES;
    if (n > FILE_MAX || big_endian(bytes + n_wire, CRC_BYTES) != ipe_config_crc(bytes, n_wire)) {
        return refuse(IPE_ERR_CONFIG,
                      "damaged or not a compiled configuration (CRC differs); run inertiactl compile again", message,
                      size);
    }
    wire_t wire;
    if (big_endian(bytes, FINGERPRINT_BYTES) != (uint64_t)__inertiad_lcm_robot_config_t_get_hash() ||
        inertiad_lcm_robot_config_t_decode(bytes, 0, (int)n_wire, &wire) != (int)n_wire) {
        return refuse(IPE_ERR_CONFIG, "written by another version; run inertiactl compile again", message, size);
    }
    copy_robot(config, &wire);
    copy_sources(config, &wire);
    copy_calibration(config, &wire);
    copy_estimator(config, &wire);
    return ipe_config_check(config, message, size);
}

ipe_status_t ipe_config_set_gyro_bias(uint8_t* bytes, size_t n, const double bias[3])
{
    wire_t wire;
    const int n_wire = (int)(n - CRC_BYTES);
    if (inertiad_lcm_robot_config_t_decode(bytes, 0, n_wire, &wire) != n_wire) { return IPE_ERR_CONFIG; }
    memcpy(wire.gyro_bias, bias, sizeof wire.gyro_bias);
    (void)inertiad_lcm_robot_config_t_encode(bytes, 0, n_wire, &wire);
    const uint32_t crc = ipe_config_crc(bytes, (size_t)n_wire);
    for (int i = 0; i < CRC_BYTES; ++i) { bytes[n_wire + i] = (uint8_t)(crc >> (8 * (CRC_BYTES - 1 - i))); }
    return IPE_OK;
}

/// Bytes read, capacity when the file is longer, -1 with errno set.
static ssize_t read_file(const char* path, uint8_t* bytes, size_t capacity)
{
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) { return -1; }
    size_t n = 0;
    ssize_t got = 1;
    while (got > 0 && n < capacity) {
        got = read(fd, bytes + n, capacity - n);
        if (got > 0) { n += (size_t)got; }
    }
    const int cause = errno;
    (void)close(fd);
    errno = cause;
    return got < 0 ? -1 : (ssize_t)n;
}

ssize_t ipe_config_read(const char* path, uint8_t bytes[IPE_CONFIG_FILE_MAX])
{
    return read_file(path, bytes, FILE_MAX);
}

ipe_status_t ipe_config_load(const char* path, ipe_config_t* config, char* message, size_t size)
{
    uint8_t bytes[FILE_MAX];
    char reason[256] = "";
    const ssize_t n = read_file(path, bytes, sizeof bytes);
    if (n < 0) {
        (void)snprintf(message, size, "%s: %s", path, strerror(errno));
        return IPE_ERR_CONFIG;
    }
    const ipe_status_t status = ipe_config_from_bytes(bytes, (size_t)n, config, reason, sizeof reason);
    if (status != IPE_OK) { (void)snprintf(message, size, "%s: %s", path, reason); }
    return status;
}
