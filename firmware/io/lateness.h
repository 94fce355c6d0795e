// SPDX-License-Identifier: Apache-2.0
/// How late the samples of one sensor arrive, and the max_wait that would suffice for them.
///
/// Lateness of a sample: how far the newest IMU sample was ahead of it on arrival; time is the samples' own, so a paced, a
/// fast and a live run give the same. A row waits until the sensor reaches past the row's instant, so max_wait must cover
/// the longest lateness plus one interval between the sensor's samples.
/// 64 B per sensor, no heap, one thread; a few comparisons per call.
#ifndef IPE_LATENESS_H
#define IPE_LATENESS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint64_t n_samples;   ///< at the last push
    int64_t newest_ns;    ///< stamp of the newest sample then
    int64_t longest_ns;   ///< lateness, since the last look
    int64_t interval_ns;  ///< between samples, shortest since the last look: gaps are no lateness; 0: none seen
    uint64_t n_lost;      ///< at the last look
    bool is_late;         ///< rows were lost or carried because of it between the last two looks

    int64_t worst_ns;     ///< longest lateness since the start
    int64_t needed_ns;    ///< max_wait that would have sufficed whenever is_late; 0: never late
} ipe_lateness_t;

typedef enum { IPE_LATENESS_SAME = 0, IPE_LATENESS_BEGAN = 1, IPE_LATENESS_ENDED = 2 } ipe_lateness_change_t;

/// After a frame or position: the sensor has given n_samples so far, the newest stamped newest_ns; the newest IMU sample is
/// stamped imu_ns.
void ipe_lateness_push(ipe_lateness_t* l, uint64_t n_samples, int64_t newest_ns, int64_t imu_ns);

/// Once a second of data time: did rows begin, or cease, to miss this sensor because it is later than max_wait?
///
///   n_lost       in  rows that did not find this sensor in time, so far
///   max_wait_ns  in  as configured
ipe_lateness_change_t ipe_lateness_look(ipe_lateness_t* l, uint64_t n_lost, int64_t max_wait_ns);

/// The value of max_wait [s] to recommend: what sufficed, rounded up to 0.05 s. 0: never late.
double ipe_lateness_advice(const ipe_lateness_t* l);

#endif
