// SPDX-License-Identifier: Apache-2.0
#include "config_diff.h"

#include <stdio.h>
#include <string.h>

#define FIELD(name, effect) {#name, effect, offsetof(ipe_config_t, name), sizeof(((ipe_config_t*)0)->name)}

static const struct {
    const char* name;
    ipe_config_diff_t effect;
    size_t offset, size;
} FIELDS[] = {
    FIELD(name, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(gravity, IPE_CONFIG_DIFF_NEW),
    FIELD(n_cables, IPE_CONFIG_DIFF_NEW),
    FIELD(cable, IPE_CONFIG_DIFF_NEW),
    FIELD(imu_position, IPE_CONFIG_DIFF_NEW),
    FIELD(imu_orientation, IPE_CONFIG_DIFF_NEW),
    FIELD(tracker_target, IPE_CONFIG_DIFF_NEW),
    FIELD(sample_rate, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(attitude_source, IPE_CONFIG_DIFF_NEW),
    FIELD(attitude_estimate, IPE_CONFIG_DIFF_NEW),
    FIELD(position_source, IPE_CONFIG_DIFF_NEW),
    FIELD(fixed_position, IPE_CONFIG_DIFF_NEW),
    FIELD(n_signals, IPE_CONFIG_DIFF_NEW),
    FIELD(signal, IPE_CONFIG_DIFF_NEW),
    FIELD(bus_bitrate, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(bus_data_bitrate, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(max_wait, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(max_age, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(max_carry, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(delay, IPE_CONFIG_DIFF_NEW),
    FIELD(delay_attitude, IPE_CONFIG_DIFF_NEW),
    FIELD(acc_bias, IPE_CONFIG_DIFF_NEW),
    FIELD(gyro_bias, IPE_CONFIG_DIFF_NEW),
    FIELD(attitude_bias, IPE_CONFIG_DIFF_NEW),
    FIELD(world_yaw, IPE_CONFIG_DIFF_NEW),
    FIELD(force_offset, IPE_CONFIG_DIFF_NEW),
    FIELD(force_gain, IPE_CONFIG_DIFF_NEW),
    FIELD(std_acc_bias, IPE_CONFIG_DIFF_NEW),
    FIELD(std_gyro_bias, IPE_CONFIG_DIFF_NEW),
    FIELD(std_attitude, IPE_CONFIG_DIFF_NEW),
    FIELD(std_world_yaw, IPE_CONFIG_DIFF_NEW),
    FIELD(std_imu_alignment, IPE_CONFIG_DIFF_NEW),
    FIELD(std_imu_position, IPE_CONFIG_DIFF_NEW),
    FIELD(std_force_offset, IPE_CONFIG_DIFF_NEW),
    FIELD(std_force_gain, IPE_CONFIG_DIFF_NEW),
    FIELD(std_force_delay, IPE_CONFIG_DIFF_NEW),
    FIELD(std_position_delay, IPE_CONFIG_DIFF_NEW),
    FIELD(std_geometry, IPE_CONFIG_DIFF_NEW),
    FIELD(std_attitude_wander, IPE_CONFIG_DIFF_NEW),
    FIELD(std_tracker_target, IPE_CONFIG_DIFF_NEW),
    FIELD(std_attitude_delay, IPE_CONFIG_DIFF_NEW),
    FIELD(std_friction, IPE_CONFIG_DIFF_NEW),
    FIELD(std_force_offset_drift, IPE_CONFIG_DIFF_NEW),
    FIELD(std_acc_scale, IPE_CONFIG_DIFF_NEW),
    FIELD(std_gyro_scale, IPE_CONFIG_DIFF_NEW),
    FIELD(std_external_force, IPE_CONFIG_DIFF_NEW),
    FIELD(std_external_stiffness, IPE_CONFIG_DIFF_NEW),
    FIELD(external_attachment, IPE_CONFIG_DIFF_NEW),
    FIELD(external_reference, IPE_CONFIG_DIFF_NEW),
    FIELD(window_length, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(memory, IPE_CONFIG_DIFF_LEARNT_HOLDS),
    FIELD(residual_covariance, IPE_CONFIG_DIFF_NEW),
    FIELD(prior_theta, IPE_CONFIG_DIFF_NEW),
    FIELD(prior_covariance, IPE_CONFIG_DIFF_NEW),
    FIELD(estimate_rate, IPE_CONFIG_DIFF_LEARNT_HOLDS),
};

static void append(char* names, size_t size, const char* name)
{
    const size_t n = strlen(names);
    (void)snprintf(names + n, size - n, "%s%s", n > 0 ? ", " : "", name);
}

ipe_config_diff_t ipe_config_diff_compare(const ipe_config_t* a, const ipe_config_t* b, char* names, size_t size)
{
    ipe_config_diff_t difference = IPE_CONFIG_DIFF_SAME;
    names[0] = '\0';
    for (size_t i = 0; i < sizeof FIELDS / sizeof FIELDS[0]; ++i) {
        const size_t at = FIELDS[i].offset;
        if (memcmp((const char*)a + at, (const char*)b + at, FIELDS[i].size) == 0) { continue; }
        append(names, size, FIELDS[i].name);
        if (FIELDS[i].effect > difference) { difference = FIELDS[i].effect; }
    }
    return difference;
}
