// SPDX-License-Identifier: Apache-2.0
#include "histogram.h"

#include <math.h>

static int bucket_of(int64_t duration_ns)
{
    const double octaves = log2((double)duration_ns / 1e3);
    const int b = (int)floor(octaves * IPE_HISTOGRAM_OCTAVE);
    return b < 0 ? 0 : b < IPE_HISTOGRAM_BUCKETS ? b : IPE_HISTOGRAM_BUCKETS - 1;
}

void ipe_histogram_push(ipe_histogram_t* h, int64_t duration_ns)
{
    h->n++;
    h->n_bucket[duration_ns <= 1000 ? 0 : bucket_of(duration_ns)]++;
    if (duration_ns > h->longest_ns) { h->longest_ns = duration_ns; }
}

double ipe_histogram_quantile(const ipe_histogram_t* h, double share)
{
    const double longest = 1e-9 * (double)h->longest_ns;
    const double wanted = share * (double)h->n;
    uint64_t n = 0;
    for (int b = 0; b < IPE_HISTOGRAM_BUCKETS - 1; ++b) {
        n += h->n_bucket[b];
        if (n > 0 && (double)n >= wanted) { return fmin(longest, 1e-6 * exp2((b + 1.0) / IPE_HISTOGRAM_OCTAVE)); }
    }
    return longest;
}
