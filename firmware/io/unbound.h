// SPDX-License-Identifier: Apache-2.0
/// Frames that no signal is bound to, while none was: the identifiers that came, beside those that were expected.
///
/// For a log of another robot, with the buses in another order, or a wrong DBC. 0.1 KB, no heap, one thread.
#ifndef IPE_UNBOUND_H
#define IPE_UNBOUND_H

#include "config.h"
#include "types.h"

#include <stdbool.h>
#include <stddef.h>

enum { IPE_UNBOUND_MAX = 12 };

typedef struct {
    unsigned n;           ///< identifiers kept, in the order they came
    bool has_more;        ///< there were others
    struct {
        uint32_t can_id;  ///< SocketCAN's layout
        uint8_t bus;
    } item[IPE_UNBOUND_MAX];
} ipe_unbound_t;

/// Keep a frame's identifier, once. Error frames are passed over. Cost: a dozen comparisons.
void ipe_unbound_note(ipe_unbound_t* u, const ipe_frame_t* frame);

/// Text[size]: the identifiers that came and those that config's signals expect, by bus, in hexadecimal.
void ipe_unbound_describe(const ipe_unbound_t* u, const ipe_config_t* config, char* text, size_t size);

#endif
