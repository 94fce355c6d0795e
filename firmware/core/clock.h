// SPDX-License-Identifier: Apache-2.0
/// Device time -> host time.
///
/// Host stamps are late by a varying, never negative delay, so the points (device, host) lie on or above the true line.
/// The line is the edge of their lower convex hull that spans the middle of the last minute; unlike least squares it is
/// not biased by the mean delay. Device counters that wrap are unwrapped. A stepped clock restarts the fit: steps over
/// 20 ms ahead at once, back within 4 samples, small ones (1 ms and three times the scatter) within 16 samples or 2 s.
/// A clock is settled after 8 blocks whose stamps all kept the device's pace to 1 ms, else when its line has stood still for a
/// second; before, it may have seen late stamps only.
/// Points are thinned to the earliest arrival per block, blocks growing from 1/64 s to 1 s: 1.6 KB per clock, 2 us once
/// per block, a few ns otherwise. One thread.
/// Source: Zhang, Liu, Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002.
#ifndef IPE_CLOCK_H
#define IPE_CLOCK_H

#include "types.h"

enum { IPE_CLOCK_POINTS = 64 };
#define IPE_CLOCK_RATE_SPAN 5.0  // s, min_rate_span of a clock that runs true to some 100 ppm

typedef struct {
    double wrap;              ///< s after which device time starts again at 0; 0: never
    bool is_started;
    bool is_settled;          ///< stamps kept the device's pace, or the line has stood still: mapped times can be used
    int64_t settled_ns;       ///< host time from which on that is so
    double min_rate_span;     ///< s of device time from which on the rate is measured; below it is taken as 1
    double last_raw;          ///< s, device time as last given
    double unwrapped;         ///< s added by wraps so far
    double device_0;          ///< s, origin of device in point
    int64_t host_0_ns;        ///< origin of host in point
    struct {
        double device, host;  ///< s since the origins
    } point[IPE_CLOCK_POINTS];  ///< earliest arrival of each block, oldest first
    int n_points;
    double block;               ///< s of device time per block
    double block_end;           ///< device time at which the newest block ends
    double offset, rate;        ///< host = offset + rate * device
    double scatter;             ///< s, mean of point after the line
    double newest;              ///< device time
    int n_back;                 ///< samples in a row older than the newest
    int off_side;               ///< stamps are off the line: -1 before it, 1 after it, 0 they are not;
    int n_off;                  ///< so many in a row,
    double off_device;          ///< since this device time
    double off_host;            ///< and host time,
    struct {
        double device, host;
    } early;           ///< the earliest of them

    uint64_t n_steps;  ///< times the device's or host's clock was stepped
} ipe_clock_t;

/// Start with nothing known. wrap, min_rate_span [s] as in the struct.
void ipe_clock_init(ipe_clock_t* c, double wrap, double min_rate_span);

/// Learn from one pair and map it: device [s], host stamp [ns] -> host time of the device's instant [ns].
int64_t ipe_clock_map(ipe_clock_t* c, double device, int64_t host_ns);

/// Host time [ns] of a device time near the last one mapped, nothing learnt.
int64_t ipe_clock_at(const ipe_clock_t* c, double device);

#endif
