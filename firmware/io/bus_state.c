// SPDX-License-Identifier: Apache-2.0
#include "bus_state.h"

#include <linux/can/error.h>
#include <stddef.h>

/// State of the controller by an error frame; -1: the frame has none.
static int condition_of(const ipe_frame_t* frame)
{
    const uint8_t status = frame->length > 1 ? frame->data[1] : 0;
    if ((frame->can_id & CAN_ERR_BUSOFF) != 0) { return IPE_BUS_OFF; }
    if ((frame->can_id & CAN_ERR_RESTARTED) != 0) { return IPE_BUS_ACTIVE; }
    if ((frame->can_id & CAN_ERR_CRTL) == 0) { return -1; }
    if ((status & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0) { return IPE_BUS_PASSIVE; }
    if ((status & (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0) { return IPE_BUS_WARNING; }
    return (status & CAN_ERR_CRTL_ACTIVE) != 0 ? IPE_BUS_ACTIVE : -1;
}

const char* ipe_bus_state_push(ipe_bus_state_t* s, const ipe_frame_t* frame)
{
    static const char* const NAME[] = {"error-active", "error-warning", "error-passive", "bus-off"};
    const int condition = condition_of(frame);
    const bool is_restart = (frame->can_id & CAN_ERR_RESTARTED) != 0;
    s->n_restarted += is_restart ? 1 : 0;
    if (condition < 0 || (condition == (int)s->condition && !is_restart)) { return NULL; }
    s->condition = (ipe_bus_condition_t)condition;
    s->n_warning += condition == IPE_BUS_WARNING ? 1 : 0;
    s->n_passive += condition == IPE_BUS_PASSIVE ? 1 : 0;
    s->n_off += condition == IPE_BUS_OFF ? 1 : 0;
    return is_restart ? "restarted" : NAME[condition];
}

void ipe_bus_state_open(ipe_bus_state_t* s)
{
    s->condition = IPE_BUS_ACTIVE;
}

const char* ipe_bus_state_counter(const ipe_bus_state_t* s, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"error_warning", s->n_warning},
        {"error_passive", s->n_passive},
        {"bus_off", s->n_off},
        {"restarted", s->n_restarted},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
