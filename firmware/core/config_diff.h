// SPDX-License-Identifier: Apache-2.0
/// Compare two configurations: which keys differ, and whether the state learnt with one holds with the other.
///
/// Both must be of the same robot's world: geometry, sensors, calibration and priors. What may differ is how long rows
/// wait, how long data count, how long the windows are and how often the estimate goes out. Fields are compared as bytes,
/// so both must have been zeroed before they were filled. No state, any thread.
#ifndef IPE_CONFIG_DIFF_H
#define IPE_CONFIG_DIFF_H

#include "config.h"

typedef enum {
    IPE_CONFIG_DIFF_SAME = 0,
    IPE_CONFIG_DIFF_LEARNT_HOLDS = 1,  ///< only settings differ: ipe_pipeline_continue() may follow
    IPE_CONFIG_DIFF_NEW = 2,           ///< anything else differs: start from the prior
} ipe_config_diff_t;

/// Compare two checked configurations field by field.
///
///   names  out  of the fields that differ, "memory, estimate_rate"; size bytes, always terminated, cut where it ends
ipe_config_diff_t ipe_config_diff_compare(const ipe_config_t* a, const ipe_config_t* b, char* names, size_t size);

#endif
