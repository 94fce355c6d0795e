// SPDX-License-Identifier: Apache-2.0
/// CAN frames from an interrupt to the main loop: one writer, one reader, no lock, no interrupt disabled.
///
/// The writer owns `head`, the reader `tail`; each publishes its index after the frame (release) and reads the other's
/// before it (acquire). A full ring refuses the newest frame and counts it: the sample's counter then shows the gap.
#ifndef IPE_FRAME_RING_H
#define IPE_FRAME_RING_H

#include "types.h"

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

/// 64 frames of 8 bytes fill a bus of 1 Mbit/s for 7 ms. A processor that executes 480 million instructions per second needs
/// under 2 ms for the longest call of ipe_pipeline_step_part (`make m7` counts its instructions); a slower one needs a larger
/// ring.
enum { IPE_FRAME_RING = 64 };

typedef struct {
    ipe_frame_t frame[IPE_FRAME_RING];
    atomic_uint head;    ///< frames put in since the start
    atomic_uint tail;    ///< frames taken out
    atomic_uint n_lost;  ///< frames refused because the ring was full
    unsigned n_most;     ///< most frames that have waited at once; the reader's
} ipe_frame_ring_t;

/// Interrupt: put a frame in. False, and counted: the ring is full.
bool ipe_frame_ring_put(ipe_frame_ring_t* ring, const ipe_frame_t* frame);

/// Main loop: the oldest frame, NULL if there is none. Good until ipe_frame_ring_drop().
const ipe_frame_t* ipe_frame_ring_oldest(ipe_frame_ring_t* ring);

/// Main loop: done with the oldest frame.
void ipe_frame_ring_drop(ipe_frame_ring_t* ring);

#endif
