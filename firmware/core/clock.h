// SPDX-License-Identifier: Apache-2.0
/// Device time -> host time.
///
/// Host stamps are late by a varying, never negative delay, so the points (device, host) lie on or above the true line.
/// The line is the edge of their lower convex hull that spans the middle of the last minute; unlike least squares it is
/// not biased by the mean delay. Device counters that wrap are unwrapped; a stepped device clock restarts the fit.
/// Points are thinned to the earliest arrival per block, blocks growing from 1/64 s to 1 s: 1.6 KB per clock, 2 us once
/// per block, a few ns otherwise. One thread.
/// Source: Zhang, Liu, Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002.
#ifndef IPE_CLOCK_H
#define IPE_CLOCK_H

#include "types.h"

enum { IPE_CLOCK_POINTS = 64 };

typedef struct {
    double wrap;                ///< s after which device time starts again at 0; 0: never
    bool is_started;
    double last_raw;            ///< s, device time as last given
    double unwrapped;           ///< s added by wraps so far
    double device_0;            ///< s, origin of device in point
    int64_t host_0_ns;          ///< origin of host in point
    struct {
        double device, host;    ///< s since the origins
    } point[IPE_CLOCK_POINTS];  ///< earliest arrival of each block, oldest first
    int n_points;
    double block;               ///< s of device time per block
    double block_end;           ///< device time at which the newest block ends
    double offset, rate;        ///< host = offset + rate * device

    uint64_t n_steps;           ///< restarts because device or host clock was stepped
} ipe_clock_t;

/// Start with nothing known. wrap [s] as in the struct.
void ipe_clock_init(ipe_clock_t* c, double wrap);

/// Learn from one pair and map it: device [s], host stamp [ns] -> host time of the device's instant [ns].
int64_t ipe_clock_map(ipe_clock_t* c, double device, int64_t host_ns);

#endif
