// SPDX-License-Identifier: Apache-2.0
#include "fdcan.h"

enum { CLASSIC_BYTES = 8, STANDARD_SHIFT = 18 };
#define EXTENDED_ID 0x1FFFFFFFU
#define STANDARD_ID 0x7FFU
#define SOCKETCAN_EXTENDED (1U << 31)
#define SOCKETCAN_REMOTE (1U << 30)

ipe_frame_t ipe_fdcan_frame(const volatile uint32_t* element)
{
    static const uint8_t bytes_of_dlc[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
    const uint32_t r0 = element[0];
    const uint32_t r1 = element[1];
    const bool is_extended = (r0 >> 30) & 1U;
    const bool is_remote = (r0 >> 29) & 1U;
    const bool is_fd = (r1 >> 21) & 1U;
    ipe_frame_t frame = {0};
    frame.can_id = is_extended ? (r0 & EXTENDED_ID) | SOCKETCAN_EXTENDED : (r0 >> STANDARD_SHIFT) & STANDARD_ID;
    if (is_remote) { frame.can_id |= SOCKETCAN_REMOTE; }
    if (is_fd) {
        frame.flags = (uint8_t)(IPE_FRAME_FD | ((r1 >> 20) & 1U ? IPE_FRAME_BRS : 0) | (r0 >> 31 ? IPE_FRAME_ESI : 0));
    }
    const uint8_t length = bytes_of_dlc[(r1 >> 16) & 0xFU];
    frame.length = !is_fd && length > CLASSIC_BYTES ? CLASSIC_BYTES : length;
    for (unsigned i = 0; i < frame.length && !is_remote; ++i) {
        frame.data[i] = (uint8_t)(element[2 + i / 4] >> (8 * (i % 4)));
    }
    return frame;
}

void ipe_fdcan_receive(ipe_fdcan_t* can, ipe_frame_ring_t* ring, int64_t t_ns)
{
    const uint32_t flags = can->registers[IPE_FDCAN_IR];
    can->registers[IPE_FDCAN_IR] = flags & (IPE_FDCAN_RF0N | IPE_FDCAN_RF0L);
    if (flags & IPE_FDCAN_RF0L) { ++can->n_lost; }
    for (uint32_t state; ((state = can->registers[IPE_FDCAN_RXF0S]) & 0x7FU) != 0;) {
        const uint32_t index = (state >> 8) & 0x3FU;
        ipe_frame_t frame = ipe_fdcan_frame(can->element + (size_t)index * can->words);
        frame.bus = can->bus;
        frame.t_ns = t_ns;
        (void)ipe_frame_ring_put(ring, &frame);
        can->registers[IPE_FDCAN_RXF0A] = index;
#ifdef IPE_FDCAN_EMULATED
        can->registers[IPE_FDCAN_RXF0S] = 0;  // memory does not acknowledge by itself
#endif
    }
}
