// SPDX-License-Identifier: Apache-2.0
/// Histogram of durations in fixed memory: eight buckets per octave from 1 us to 134 s.
///
/// Bucket b holds durations from 2^(b/8) us up to 2^((b+1)/8) us, so a quantile is resolved to 9 %; shorter ones are in the
/// first, longer ones in the last. 1.8 KB, caller-allocated, no heap; 20 ns per duration, one thread.
#ifndef IPE_HISTOGRAM_H
#define IPE_HISTOGRAM_H

#include <stdint.h>

enum { IPE_HISTOGRAM_OCTAVE = 8, IPE_HISTOGRAM_BUCKETS = 27 * IPE_HISTOGRAM_OCTAVE };

typedef struct {
    uint64_t n;  ///< durations counted
    int64_t longest_ns;
    uint64_t n_bucket[IPE_HISTOGRAM_BUCKETS];
} ipe_histogram_t;

/// Count one duration; a negative one counts as 0.
void ipe_histogram_push(ipe_histogram_t* h, int64_t duration_ns);

/// A duration [s] that the share, 0 .. 1, of all is at most: the upper edge of its bucket, never above the longest. 0 if
/// there are none.
double ipe_histogram_quantile(const ipe_histogram_t* h, double share);

#endif
