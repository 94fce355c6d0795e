// SPDX-License-Identifier: Apache-2.0
/// Stamps of CLOCK_REALTIME -> host time without jumps, even if the clock is set.
///
/// Host time is what CLOCK_REALTIME was at the start, running on as CLOCK_MONOTONIC does: both are slewed alike, so only a
/// step changes their difference, by the size of the step. A stamp from before a step that is read after it is recognised
/// by its age: of the two differences, the one is used that makes the stamp younger without moving it into the future. One
/// second after the step all older stamps have been read.
/// No heap, one thread; three clock readings per refresh, which are no system calls.
#ifndef IPE_HOST_CLOCK_H
#define IPE_HOST_CLOCK_H

#include <stdbool.h>
#include <stdint.h>
#include <time.h>

typedef struct {
    int64_t start_ns;                                  ///< CLOCK_REALTIME less CLOCK_MONOTONIC at the start
    int64_t offset_ns;                                 ///< the same now
    int64_t before_ns;                                 ///< the same before the last step
    int64_t stepped_ns;                                ///< CLOCK_MONOTONIC when that was noticed
    int64_t now_ns;                                    ///< CLOCK_MONOTONIC at the last refresh
    int (*read)(clockid_t clock, struct timespec* t);  ///< clock_gettime(), or a test's replacement

    uint64_t n_steps;                                  ///< times the host's clock was set
    int64_t step_ns;                                   ///< the last step, forward positive
} ipe_host_clock_t;

/// Start now. read: clock_gettime, or a replacement.
void ipe_host_clock_init(ipe_host_clock_t* c, int (*read)(clockid_t clock, struct timespec* t));

/// Read the clocks, before stamps are mapped. True: CLOCK_REALTIME was stepped, by c->step_ns, over 0.1 ms.
bool ipe_host_clock_refresh(ipe_host_clock_t* c);

/// Host time of a stamp of CLOCK_REALTIME, ns.
int64_t ipe_host_clock_map(const ipe_host_clock_t* c, int64_t stamp_ns);

/// Host time now, ns.
int64_t ipe_host_clock_now(const ipe_host_clock_t* c);

#endif
