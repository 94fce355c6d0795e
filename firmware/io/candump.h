// SPDX-License-Identifier: Apache-2.0
/// One line of a candump log -> one CAN frame. Pure functions: no state, no I/O, any thread.
///
///   (sec.fraction) interface id#data        classical, 3 hex digits, 8 for extended identifiers
///   (sec.fraction) interface id#data_B      eight bytes sent with length code 9 to F
///   (sec.fraction) interface id#R5          remote frame, length 0..8 or none
///   (sec.fraction) interface id##1data      CAN FD, first digit: 1 bit-rate switch, 2 error state indicator
///   (sec.fraction) interface 20000004#data  error frame: bit 29 of the identifier
///
/// 1 to 9 fractional digits; " R" or " T" (received, transmitted) may follow; '#' and ';' begin a comment line; the
/// DROPCOUNT lines of `candump -d` are read too. Hex digits of either case.
#ifndef IPE_CANDUMP_H
#define IPE_CANDUMP_H

#include "types.h"

#include <stddef.h>

typedef enum {
    IPE_CANDUMP_FRAME,      ///< frame is filled in, but for frame->bus
    IPE_CANDUMP_COMMENT,    ///< comment or blank line
    IPE_CANDUMP_DROPS,      ///< the logger reports frames lost before this line: n_dropped
    IPE_CANDUMP_BAD_STAMP,  ///< no "(seconds.fraction)"
    IPE_CANDUMP_BAD_NAME,   ///< no interface name of 1 to 15 characters
    IPE_CANDUMP_BAD_ID,     ///< not 3 or 8 hex digits, or above 7FF or 1FFFFFFF
    IPE_CANDUMP_BAD_DATA,   ///< odd or foreign digits, or a length that CAN does not have
    IPE_CANDUMP_BAD_TAIL,   ///< something after the data
    IPE_CANDUMP_COUNT
} ipe_candump_t;

/// The interface's name: a view into the line.
typedef struct {
    const char* text;
    size_t length;
} ipe_candump_name_t;

/// Parse one line of length bytes, without its line end.
///
///   frame      out  complete on IPE_CANDUMP_FRAME but for bus, which is left alone; data past length is zero
///   name       out  on IPE_CANDUMP_FRAME
///   n_dropped  out  on IPE_CANDUMP_DROPS
///
/// Cost: about 60 ns for a frame of 8 bytes.
ipe_candump_t ipe_candump_parse(const char* line, size_t length, ipe_frame_t* frame, ipe_candump_name_t* name,
                                uint64_t* n_dropped);

/// The fault of the line in a few words, for the IPE_CANDUMP_BAD_* results.
const char* ipe_candump_reason(ipe_candump_t result);

#endif
