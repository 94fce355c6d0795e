// SPDX-License-Identifier: Apache-2.0
/// What every stage took in, passed on and refused: counted together, sent as HEALTH.
#ifndef IPE_HEALTH_H
#define IPE_HEALTH_H

#include "daemon.h"

/// Bring d->counters up to date: all, or what depends on the input only.
void health_count(daemon_t* d);
void health_count_input(daemon_t* d);

/// What bus i has taken in and lost.
const ipe_bus_counts_t* health_bus_counts(const daemon_t* d, unsigned i);

/// Interface or file of bus i; "imu", "force", "position".
const char* health_bus_name(const daemon_t* d, unsigned i);
const char* health_sensor_name(ipe_sensor_t sensor);

/// Frames taken in, from all buses.
uint64_t health_frames(const daemon_t* d);

/// IMU samples that were complete and did not become a used row.
uint64_t health_rejected_rows(const daemon_t* d);

/// Frames lost before they reached us, incomplete samples, and rows.
uint64_t health_dropped(const daemon_t* d);

/// Around a change that sets counters of the pipeline back: before it carry what p has counted, after it take off what the
/// pipeline that goes on still counts itself.
void health_carry(daemon_t* d, const ipe_pipeline_t* p);
void health_carried(daemon_t* d, const ipe_pipeline_t* p);

/// Print the counters as last counted, and the latencies.
void health_print(const daemon_t* d);

/// Send HEALTH.
void health_send(daemon_t* d, int64_t now_ns);

/// Move data time on; HEALTH goes out once per second of it.
void health_advance(daemon_t* d, int64_t t_ns);

#endif
