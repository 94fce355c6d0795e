// SPDX-License-Identifier: Apache-2.0
/// Is a sensor still there? Lost: silent for 10 of its periods and at least 0.2 s, or for 5 s before its first sample.
///
/// Looked at now and then, not per sample: the period comes from how many samples there were between two looks.
/// 64 B per sensor, no heap, one thread.
#ifndef IPE_PRESENCE_H
#define IPE_PRESENCE_H

#include <stdbool.h>
#include <stdint.h>

typedef enum { IPE_PRESENCE_SAME = 0, IPE_PRESENCE_LOST = 1, IPE_PRESENCE_BACK = 2 } ipe_presence_change_t;

typedef struct {
    bool is_looking;     ///< began_ns is known
    bool is_lost;
    int64_t began_ns;    ///< first look
    uint64_t n_samples;  ///< at the last look that saw new ones
    int64_t newest_ns;   ///< stamp of the newest sample then; 0: none yet
    int64_t period_ns;   ///< 0: not known
    int64_t silence_ns;  ///< how long it has been, or had been, silent

    uint64_t n_lost;     ///< times the sensor fell silent
} ipe_presence_t;

/// Look: n_samples so far, the newest stamped newest_ns, now being now_ns. Time that goes back starts again.
ipe_presence_change_t ipe_presence_look(ipe_presence_t* p, uint64_t n_samples, int64_t newest_ns, int64_t now_ns);

#endif
