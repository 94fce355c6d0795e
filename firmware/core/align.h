// SPDX-License-Identifier: Apache-2.0
/// Samples of three sensors, each with its own rate -> one row per IMU sample.
///
/// A row waits until two samples of force and position past its instant are there: for max_wait, by which a sensor may be
/// late, and two periods of that sensor. They are interpolated at the row's instant by a cubic through the neighbours
/// (Hermite, tangents by finite differences), never across a gap longer than max_age. A sensor that is constantly late by less
/// than max_wait therefore gives the same rows as one on time, as long as max_wait is at most IPE_WAIT_MAX IMU samples
/// (ipe_config_check). Every IMU sample becomes a row; force or position that did not come leave it without them (has_force,
/// has_position), counted by cause.
/// Outliers are taken out before a row can use them: positions that the cables cannot reach, and samples of force or position
/// that are spikes, spike_gate.h. A force that steps within one sample is unknown for 10, and while it
/// repeats: its sensor may have died. Rows that would use a suspect wait for the sample after it; others do not wait any longer.
/// A sample may come up to 8 samples late within its own stream if no row has used its neighbours yet. Samples whose instant
/// is not known yet are held in the ring; rows wait for them as for samples that have not come.
/// 329 KB of state (31 KB in the micro profile), O(1) per sample, one thread. The result depends on the samples and their
/// stamps, not on when they were pushed, as long as no row waits longer than it may.
#ifndef IPE_ALIGN_H
#define IPE_ALIGN_H

#include "config.h"
#include "sample_assembler.h"
#include "sample_timing.h"
#include "spike_gate.h"
#include "types.h"

/// The last IPE_RING samples of one sensor; sample i is at i % IPE_RING.
typedef struct {
    int64_t t_ns[IPE_RING];
    uint64_t first;   ///< the oldest since the last restart
    uint64_t head;    ///< one past the newest
    unsigned n_held;  ///< of these, newest: instant not known yet
    bool is_suspect;  ///< the newest whose instant is known may be a spike
    uint64_t cursor;  ///< imu: next row; force, position: the sample at or before the last row
} ipe_ring_t;

/// How late the samples of a sensor come, in data time: behind the newest IMU sample whose instant is known.
typedef struct {
    int64_t largest_ns;   ///< largest lateness of a sample taken in
    uint64_t n_too_late;  ///< samples that came after rows past their instant had gone on without them
} ipe_lateness_t;

typedef struct {
    int n_cables;
    bool has_rpy;
    int32_t position_source;
    double fixed_position[3];
    int64_t max_wait_ns, max_age_ns[IPE_SENSOR_COUNT], delay_ns[IPE_SENSOR_COUNT];
    int64_t force_delay_ns;              ///< found by estimation, beyond delay_ns
    bool is_ending;                      ///< no more samples will come: do not wait
    uint32_t unknown_force;              ///< of the samples of force that come next, types.h
    double reach_low[2], reach_high[3];  ///< W, m: the anchors' box and a margin; it widens downwards, 1 m per m

    ipe_spike_gate_t spike_gate[IPE_SENSOR_COUNT];  ///< of force and position

    ipe_ring_t ring[IPE_SENSOR_COUNT];
    double imu[IPE_RING][10];    ///< acc 3, gyro 3, q 4
    double force[IPE_RING][IPE_CABLES_MAX];
    uint16_t unknown[IPE_RING];  ///< of force
    uint32_t stepped;            ///< forces that stepped, and are unknown
    double stepped_to;           ///< its value in the last sample, N
    int n_doubted;               ///< for so many more samples
    double position[IPE_RING][3];
    ipe_lateness_t lateness[IPE_SENSOR_COUNT];
    uint64_t undelayed;                      ///< the force sample at or before the last row's instant by force_delay_ns
    int64_t row_ns;                          ///< instant of the last row; 0: none yet
    uint64_t position_seen;                  ///< the tracker sample at or before the last row that has a position

    uint64_t n_samples[IPE_SENSOR_COUNT];    ///< samples taken in
    uint64_t n_backwards[IPE_SENSOR_COUNT];  ///< samples refused: a row has passed them, or out of order by too much
    uint64_t n_duplicate[IPE_SENSOR_COUNT];  ///< samples refused: one of that instant is there
    uint64_t n_reordered[IPE_SENSOR_COUNT];  ///< samples taken in, though they came after later ones
    uint64_t n_restarts[IPE_SENSOR_COUNT];   ///< times the stamps stepped back by over a second
    uint64_t n_nonfinite[IPE_SENSOR_COUNT];  ///< samples refused: a value is NaN or Inf
    uint64_t n_bad_quaternion;               ///< IMU samples refused: quaternion's length not 1 +- 0.1
    uint64_t n_unreachable;                  ///< positions refused: no cable reaches there
    uint64_t n_spikes[IPE_SENSOR_COUNT];     ///< samples taken out again: spikes
    uint64_t n_rows;                         ///< IMU samples that became rows
    uint64_t n_overrun;                      ///< IMU samples lost: ring full while waiting
    uint64_t n_missing[IPE_SENSOR_COUNT];    ///< rows without this sensor: it had a gap there
    uint64_t n_late[IPE_SENSOR_COUNT];       ///< rows without this sensor: it did not come within max_wait
} ipe_align_t;

void ipe_align_init(ipe_align_t* a, const ipe_config_t* config);

/// Take one sample: t_ns host time of its stamp; value as in ipe_reading_t.
///
/// IPE_OK; IPE_ERR_TIME, IPE_ERR_NONFINITE, IPE_ERR_RANGE (quaternion, position out of reach): refused and counted, nothing else changed.
ipe_status_t ipe_align_push(ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, const double* value);

/// From the next sample of force on these cables' values are no measurements: bit i for cable i. 0 at the start.
void ipe_align_set_unknown_force(ipe_align_t* a, uint32_t unknown);

/// Take one sample that was taken before host time t_ns, its stamp, but it is not known when. At most IPE_SAMPLE_TIMING_HOLD are
/// kept, older ones drop out (ipe_sample_timing_t counts). Status as of ipe_align_push().
ipe_status_t ipe_align_hold(ipe_align_t* a, ipe_sensor_t sensor, int64_t t_ns, const double* value);

/// The newest n samples held were taken at host times t_ns [n], oldest first; older ones are dropped.
void ipe_align_settle(ipe_align_t* a, ipe_sensor_t sensor, int n, const int64_t* t_ns);

/// The next row, once its sensors are there or are not waited for any longer. IPE_OK or IPE_NOT_READY.
ipe_status_t ipe_align_pop(ipe_align_t* a, ipe_row_t* row);

/// The forces are found to be `delay` [s] later than configured: from the next row on, a row whose instant plus delay has
/// no forces has none.
void ipe_align_set_force_delay(ipe_align_t* a, double delay);

/// Put the forces of the last row's instant plus the delay found into f [m], N; as they are if none was found.
void ipe_align_undelay_forces(const ipe_align_t* a, double f[IPE_CABLES_MAX]);

/// Lateness of a sensor since the start. If n_too_late is not 0, max_wait (s) has to be raised over largest_ns.
ipe_lateness_t ipe_align_lateness(const ipe_align_t* a, ipe_sensor_t sensor);

#endif
