// SPDX-License-Identifier: Apache-2.0
/// A snapshot of every counter of the daemon: "stage.cause" and its value, in the order of the stages.
///
/// For the summary, for HEALTH and for estimate.json alike. 29 KB, caller-allocated, no heap; one thread.
#ifndef IPE_COUNTERS_H
#define IPE_COUNTERS_H

#include <stdbool.h>
#include <stdint.h>

enum { IPE_COUNTERS_MAX = 512, IPE_COUNTER_NAME_MAX = 48 };

typedef struct {
    unsigned n;
    struct {
        char name[IPE_COUNTER_NAME_MAX];
        uint64_t value;
    } item[IPE_COUNTERS_MAX];
} ipe_counters_t;

/// Remove all.
void ipe_counters_clear(ipe_counters_t* c);

/// Append "stage.cause"; stage NULL: cause is the whole name. A name that does not fit is cut; there are never more
/// than IPE_COUNTERS_MAX.
void ipe_counters_add(ipe_counters_t* c, const char* stage, const char* cause, uint64_t value);

/// Write all, or those that are not zero, to stderr, aligned, one per line.
void ipe_counters_print(const ipe_counters_t* c, bool with_zero);

#endif
