// SPDX-License-Identifier: Apache-2.0
/// Receiving from a Bosch M_CAN controller: FDCAN of STM32H7, MCAN of SAM E70 and TI AM243x. Receive FIFO 0 only.
///
/// Source: Bosch, M_CAN User's Manual, register map, and "Rx Buffer and FIFO Element". Setting up clocks, pins, bit
/// timing, filters and the message RAM is the board's; it ends with enabling the interrupt RF0N, "new message in FIFO 0".
/// Run in an emulator on registers in memory, never on a controller.
#ifndef IPE_FDCAN_H
#define IPE_FDCAN_H

#include "frame_ring.h"

enum {
    IPE_FDCAN_IR = 0x50 / 4,     ///< interrupt flags; a 1 written clears; as index of 32-bit registers
    IPE_FDCAN_RXF0S = 0xA4 / 4,  ///< bits 6:0 fill level, 13:8 index to get next, 25 message lost
    IPE_FDCAN_RXF0A = 0xA8 / 4,  ///< index that was read; frees the element
    IPE_FDCAN_REGISTERS = 0x100 / 4,
    IPE_FDCAN_RF0N = 1U << 0,    ///< IR: new message in FIFO 0
    IPE_FDCAN_RF0L = 1U << 3,    ///< IR: message lost, FIFO 0 was full
};

/// One controller.
typedef struct {
    volatile uint32_t* registers;      ///< first of its registers
    const volatile uint32_t* element;  ///< first element of receive FIFO 0 in the message RAM
    unsigned words;                    ///< of an element: 4 with 8 data bytes, 18 with 64 (RXESC)
    uint8_t bus;                       ///< of the configuration
    uint32_t n_lost;                   ///< times that the FIFO was full
} ipe_fdcan_t;

/// Interrupt: move every waiting frame into the ring, stamped with t_ns, host time in ns.
void ipe_fdcan_receive(ipe_fdcan_t* can, ipe_frame_ring_t* ring, int64_t t_ns);

/// One element of the FIFO as a frame of bus 0 without a stamp. Pure.
ipe_frame_t ipe_fdcan_frame(const volatile uint32_t* element);

#endif
