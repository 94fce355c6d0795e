// SPDX-License-Identifier: Apache-2.0
/// When were samples taken that carry no device time? Host stamps alone are late by what the host or the bus was busy.
///
/// A sensor paces itself: sample number times period is its device time, and a clock (clock.h) maps that to host time.
/// Numbers come from the sensor's counter, or samples are counted; a gap without counter may be lost samples or late
/// ones; only the samples that follow decide it. Until then the samples are held:
///   stamps come back to the line                          they were late, none is missing
///   four or more are late by the same number of periods   so many samples were lost: more, where stamps are seldom prompt,
///                                                         or where more are lost meanwhile
///   a stamp is before its line                            fewer were lost than that
///   neither within 1 s and 64 samples                     the sensor changed its period or phase: measured again
///   stamps are before their line again and again          the period was measured over lost samples: measured again
///   samples seem lost again and again, while intervals    the period is too short: the line starts anew with theirs
///   between stamps are longer than the line's
/// A sample whose instant cannot be determined is dropped and counted. 104 B of state beside the clock, one thread.
#ifndef IPE_SAMPLE_TIMING_H
#define IPE_SAMPLE_TIMING_H

#include "clock.h"
#include "types.h"

typedef struct {
    double period;        ///< s; 0: not measured yet
    uint64_t index;       ///< of the newest settled sample
    int n_waiting;        ///< newer samples, not settled; the newest IPE_SAMPLE_TIMING_HOLD of them are held
    float prompt;         ///< share of the last hundred or so that came within half a period of their time
    float interval;       ///< s, mean of the stamps' intervals but for those over which a sample was lost,
    int n_intervals;      ///< of so many
    int n_missing;        ///< lost samples that would explain how late the least late of the newest are,
    int n_since;          ///< so many of them,
    int n_agree;          ///< of these so many are late by just that;
    int last_missing;     ///< the same for the newest of all,
    int n_same;           ///< and so many in a row, up to it, that are late by more than n_missing
    int n_early;          ///< samples before their line, since it has held for a second
    int64_t first_ns;     ///< while the period is measured: stamp of the first one waiting,
    int64_t last_ns;      ///< and of the last one
    int n_irregular;      ///< intervals that did not fit,
    float irregularity;   ///< and of the mean, how far off is the one of the others that is furthest off

    uint64_t n_lost;      ///< samples lost by the gaps, where there is no counter; after long gaps about
    uint64_t n_dropped;   ///< samples whose instant could not be determined
    uint64_t n_restarts;  ///< times the pace changed: period or phase is learnt again
} ipe_sample_timing_t;

void ipe_sample_timing_init(ipe_sample_timing_t* p);

/// Take the host stamp of the next sample.
///
///   clock  of this sensor, written by nobody else
///   step   samples since the one before by the sensor's counter, 1: the next; 0: it has no counter, or that jumped
///
/// Number of the newest samples, this one included, whose instants are known now; 0: hold it. Samples older than these that
/// were held are to be dropped. Cost: as ipe_clock_map().
int ipe_sample_timing_push(ipe_sample_timing_t* p, ipe_clock_t* clock, int64_t host_ns, uint64_t step);

/// Host time [ns] of the sample so many before the newest settled one.
int64_t ipe_sample_timing_instant(const ipe_sample_timing_t* p, const ipe_clock_t* clock, int before);

/// No more samples will come: those waiting are dropped.
void ipe_sample_timing_end(ipe_sample_timing_t* p);

#endif
