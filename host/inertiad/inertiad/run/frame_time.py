# SPDX-License-Identifier: Apache-2.0
"""Duration of a CAN frame on its bus."""


def frame_time(
    length: int, is_extended: bool, is_fd: bool, bitrate: float, data_bitrate: float, stuffed: bool = False
) -> float:
    """s that a frame of length bytes and the pause after it take, with none or the most stuff bits.

    FD frames switch to data_bitrate; the stuff bits at fixed places in their CRC are always there. Rates in bit/s.
    """
    if is_fd:
        arbitration, data = (36 if is_extended else 17), 5 + 8 * length
        check = 4 + (21 + 7 if length > 16 else 17 + 6) + 1
        dynamic = (arbitration - 1) // 4, (data + 4) // 4
        more = dynamic if stuffed else (0, 0)
        return (arbitration + more[0] + 12) / bitrate + (data + more[1] + check) / data_bitrate
    bits = (54 if is_extended else 34) + 8 * length
    return (bits + 13 + ((bits - 1) // 4 if stuffed else 0)) / bitrate
