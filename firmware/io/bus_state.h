// SPDX-License-Identifier: Apache-2.0
/// State of a CAN controller, from its error frames: error-active, warning, passive, bus-off, restarted.
///
/// 48 B per bus, no heap, one thread. Source: linux/can/error.h; ISO 11898-1, fault confinement.
#ifndef IPE_BUS_STATE_H
#define IPE_BUS_STATE_H

#include "types.h"

typedef enum {
    IPE_BUS_ACTIVE = 0,   ///< normal; also before any error frame
    IPE_BUS_WARNING = 1,  ///< an error counter reached 96
    IPE_BUS_PASSIVE = 2,  ///< ... 128
    IPE_BUS_OFF = 3,      ///< the controller took itself off the bus
} ipe_bus_condition_t;

typedef struct {
    ipe_bus_condition_t condition;
    uint64_t n_warning;    ///< times the controller entered error warning
    uint64_t n_passive;    ///< times the controller entered error passive
    uint64_t n_off;        ///< times the controller went bus-off
    uint64_t n_restarted;  ///< times the controller was restarted
} ipe_bus_state_t;

/// Use one frame that has IPE_CAN_ERR set. The new state as a static string, such as "bus-off"; NULL if it did not change.
const char* ipe_bus_state_push(ipe_bus_state_t* s, const ipe_frame_t* frame);

/// The interface was opened again: a controller starts error-active and sends no error frame that says so.
void ipe_bus_state_open(ipe_bus_state_t* s);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_bus_state_counter(const ipe_bus_state_t* s, unsigned index, uint64_t* value);

#endif
