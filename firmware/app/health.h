// SPDX-License-Identifier: Apache-2.0
/// Counters of every stage: input, output, rejected by cause. Sent as HEALTH and printed at the end.
#ifndef IPE_HEALTH_H
#define IPE_HEALTH_H

#include "daemon.h"

/// Update d->counters: all of them, or only those that depend on the input alone.
void health_count(daemon_t* d);
void health_count_input(daemon_t* d);

/// Frames received from and lost on bus i.
const ipe_bus_counts_t* health_bus_counts(const daemon_t* d, unsigned i);

/// Interface or file of bus i; "imu", "force" or "position".
const char* health_bus_name(const daemon_t* d, unsigned i);
const char* health_sensor_name(ipe_sensor_t sensor);

/// Frames received from all buses.
uint64_t health_frames(const daemon_t* d);

/// Complete IMU samples that did not become a used row.
uint64_t health_rejected_rows(const daemon_t* d);

/// Frames lost before the daemon received them, incomplete samples, and rejected rows.
uint64_t health_dropped(const daemon_t* d);

/// Keep counters from decreasing across a change that sets counters of the pipeline back: call the first before the change
/// with the pipeline in use, the second after it with the pipeline that continues.
void health_carry(daemon_t* d, const ipe_pipeline_t* p);
void health_carried(daemon_t* d, const ipe_pipeline_t* p);

/// Print the counters as last updated, the latencies, and advice on max_wait if a sensor was late.
void health_print(const daemon_t* d);

/// Update d->counters, send HEALTH, stamped now_ns, and CONFIG.
void health_send(daemon_t* d, int64_t now_ns);

/// Write one line about a sensor that is later than rows wait, with the key of robot.toml to change, into text[size].
void health_describe_lateness(const daemon_t* d, ipe_sensor_t sensor, char* text, size_t size);

#endif
