// SPDX-License-Identifier: Apache-2.0
/// Every counter of the pipeline in one table: its name, its place, and how it is judged.
///
/// Names are "stage.cause" or "stage.sensor.cause"; scripts read them, so they do not change when a stage is renamed.
/// HEALTH, estimate.json, the run reader and `inertiactl verify` take names and judgement from here. No state, any thread.
#ifndef IPE_COUNTER_TABLE_H
#define IPE_COUNTER_TABLE_H

#include "pipeline.h"

#include <stddef.h>

enum {
    IPE_COUNTER_REJECTED = 1,    ///< IMU samples or rows lost or refused: estimate.json adds them up as "rejected"
    IPE_COUNTER_BAD = 2,         ///< 0 on a good run
    IPE_COUNTER_INCOMPLETE = 4,  ///< samples of which frames were missing: HEALTH adds them up
};

typedef struct {
    const char* name;
    size_t offset;   ///< of its uint64_t in ipe_pipeline_t
    unsigned flags;  ///< IPE_COUNTER_*
} ipe_counter_t;

/// Counter by index, in the order of the stages. NULL past the last.
const ipe_counter_t* ipe_counter_table(unsigned index);

/// Name of a counter by the same index, and its value in p. NULL past the last, value untouched.
const char* ipe_pipeline_counter(const ipe_pipeline_t* p, unsigned index, uint64_t* value);

/// Sum of all counters that have one of these flags.
uint64_t ipe_pipeline_counter_sum(const ipe_pipeline_t* p, unsigned flags);

#endif
