// SPDX-License-Identifier: Apache-2.0
#include "daemon.h"

#include "message.h"

#include <stdio.h>
#include <string.h>

int64_t daemon_now(const daemon_t* d)
{
    return d->n_interfaces > 0 ? ipe_host_clock_now(&d->clock) : d->data_ns;
}

int64_t daemon_newest_sample(const daemon_t* d, ipe_sensor_t sensor)
{
    const ipe_ring_t* ring = &d->pipeline->align.ring[sensor];
    return ring->head > ring->first ? ring->t_ns[(ring->head - 1) % IPE_RING] : 0;
}

int daemon_refuse(const char* name, const char* reason)
{
    ipe_message("%s: %s", name, reason);
    return -1;
}

bool daemon_can_use(const daemon_t* d, const ipe_config_t* config, char* text, size_t size)
{
    for (int i = 0; i < config->n_signals; ++i) {
        if ((unsigned)config->signal[i].bus < d->option.n_buses) { continue; }
        (void)snprintf(text, size, "a signal is bound to bus %d, but there are only %u; give one --bus for each",
                       config->signal[i].bus, d->option.n_buses);
        return false;
    }
    if (config->position_source != IPE_POSITION_TRACKER || d->replay.has_tracker || d->inbox.fd >= 0) { return true; }
    (void)snprintf(text, size, "no tracker positions can come over this --lcm; give --tracker file:FILE");
    return false;
}

void daemon_set_gyro_bias(daemon_t* d, const double bias[3])
{
    memcpy(d->config.gyro_bias, bias, sizeof d->config.gyro_bias);
    (void)ipe_config_set_gyro_bias(d->config_bytes, d->n_config_bytes + IPE_CONFIG_CRC_BYTES, bias);
}
