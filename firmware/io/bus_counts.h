// SPDX-License-Identifier: Apache-2.0
/// Counters common to all sources of CAN frames.
#ifndef IPE_BUS_COUNTS_H
#define IPE_BUS_COUNTS_H

#include "types.h"

typedef struct {
    uint64_t n_frames;               ///< frames handed on, error frames included
    uint64_t n_error_frames;         ///< of these: error frames
    uint64_t n_controller_overruns;  ///< error frames that report an overflow of the controller's own buffer
    uint64_t n_dropped;  ///< frames lost before they reached this source, as far as kernel or logger report it
} ipe_bus_counts_t;

/// Count one frame that is handed on.
static inline void ipe_bus_count(ipe_bus_counts_t* c, const ipe_frame_t* frame)
{
    enum {
        CONTROLLER = 0x4U,
        RX_OVERFLOW = 0x1U
    };  // CAN_ERR_CRTL in the identifier, CAN_ERR_CRTL_RX_OVERFLOW in data[1]
    c->n_frames++;
    if ((frame->can_id & IPE_CAN_ERR) == 0) { return; }
    c->n_error_frames++;
    if ((frame->can_id & CONTROLLER) != 0 && (frame->data[1] & RX_OVERFLOW) != 0) { c->n_controller_overruns++; }
}

#endif
