// SPDX-License-Identifier: Apache-2.0
/// CAN frame -> values in SI, by a table made from DBC signals.
///
/// Any start bit, length 1..64, byte order, sign, IEEE float32/float64, scale, offset, one level of multiplexing.
/// The table is built once; a frame costs one hash probe and about 5 ns per signal. 2 KB of state (0.5 KB in the micro profile), one
/// thread.
#ifndef IPE_DECODE_H
#define IPE_DECODE_H

#include "config.h"
#include "types.h"

/// The values one frame carried, in the order of the table.
typedef struct {
    int64_t t_ns;      ///< the frame's host stamp
    double wire_time;  ///< s the frame took on the bus, 0: bit rate unknown
    int n;
    struct {
        uint8_t quantity;  ///< ipe_quantity_t
        double value;      ///< SI
    } item[IPE_SIGNALS_MAX];
} ipe_sample_t;

typedef struct {
    struct {
        uint32_t can_id;
        uint8_t bus, frame_length, first, n;  ///< order[first .. first + n - 1]; n = 0: empty slot
    } slot[IPE_DECODE_SLOTS];
    const ipe_config_t* config;
    uint8_t order[IPE_SIGNALS_MAX];  ///< indices of its signals, those of one message neighbours

    uint64_t n_frames;               ///< all frames: the sum of the five below
    uint64_t n_decoded;              ///< frames with a bound ID and its length; their signals may be refused
    uint64_t n_unknown;              ///< frames with an ID that no signal is bound to
    uint64_t n_remote;               ///< remote frames
    uint64_t n_error;                ///< error frames
    uint64_t n_bad_length;           ///< frames with a bound ID and another number of bytes
    uint64_t n_nonfinite;            ///< signals refused: NaN or Inf
    uint64_t n_out_of_range;         ///< signals refused: outside the limits of the DBC
} ipe_decode_t;

/// Build the table from config, which is kept by pointer and must outlive it. Cost: once, n_signals^2.
void ipe_decode_init(ipe_decode_t* d, const ipe_config_t* config);

/// Decode one frame. Signals that are not finite or out of range are left out of the sample and counted.
///
/// IPE_OK            sample holds at least one value
/// IPE_IGNORED       unknown ID, remote or error frame, or no value left; counted
/// IPE_ERR_LENGTH    known ID, wrong length; counted
ipe_status_t ipe_decode_frame(ipe_decode_t* d, const ipe_frame_t* frame, ipe_sample_t* sample);

/// The raw number of length bits at DBC position start, zero- or sign-extended to 64 bits.
///
///   data  in  72 bytes, readable past the frame's end
uint64_t ipe_decode_raw(const uint8_t data[72], int start, int length, bool big_endian, bool is_signed);

#endif
