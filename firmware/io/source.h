// SPDX-License-Identifier: Apache-2.0
/// Types common to the sources of recorded data.
#ifndef IPE_SOURCE_H
#define IPE_SOURCE_H

#include "types.h"

#include <stdbool.h>
#include <stdint.h>

/// State of a source.
typedef enum {
    IPE_SOURCE_READY = 0,
    IPE_SOURCE_WAIT = 1,  ///< nothing until the descriptor is readable
    IPE_SOURCE_END = 2,   ///< nothing any more
} ipe_source_status_t;

#endif
