// SPDX-License-Identifier: Apache-2.0
/// Does the platform rest, and what does the gyro show meanwhile?
///
/// Rows are averaged over blocks of 1 s. The platform rests when in the last two blocks, one right after the other,
///   the attitude's mean turned by less than 3 mrad             (independent of the gyro's bias)
///   no rate or specific force varied by more than 0.02 rad/s or 0.3 m/s2, one sigma
///   the mean rate and specific force changed by less than 5 mrad/s and 0.05 m/s2
/// The mean rate is then the gyro's bias, to 3 mrad/s in the worst case: a platform that turns slower than that.
/// 0.5 KB of state, about 20 ns per row, one thread.
#ifndef IPE_REST_DETECTOR_H
#define IPE_REST_DETECTOR_H

#include "types.h"

enum {
    IPE_REST_DETECTOR_CHANNELS = 6,  ///< rate x y z, specific force x y z
    IPE_REST_DETECTOR_ROWS_MIN = 10  ///< in a block
};

/// Sums over one block; the channels less those of its first row, so that their squares lose no digits.
typedef struct {
    int64_t begin_ns, end_ns;
    int n_rows;
    double origin[IPE_REST_DETECTOR_CHANNELS], sum[IPE_REST_DETECTOR_CHANNELS], square[IPE_REST_DETECTOR_CHANNELS];
    double q[4];  ///< sum of the quaternions, each in the first one's half
} ipe_rest_detector_block_t;

typedef struct {
    ipe_rest_detector_block_t open, last, before;
} ipe_rest_detector_t;

/// Forget all rows.
void ipe_rest_detector_init(ipe_rest_detector_t* r);

/// Take one aligned row. A gap of over 0.5 s, or time that goes back, starts again.
void ipe_rest_detector_push(ipe_rest_detector_t* r, const ipe_row_t* row);

/// The bias found by host time now_ns.
///
///   rate  out  mean rate of the two blocks, I axes, rad/s, as measured; written on NULL only
///
/// NULL: at rest; otherwise why that cannot be said, a string that needs no freeing: too few rows, too old, what moves.
const char* ipe_rest_detector_read(const ipe_rest_detector_t* r, int64_t now_ns, double rate[3]);

#endif
