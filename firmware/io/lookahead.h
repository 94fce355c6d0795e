// SPDX-License-Identifier: Apache-2.0
/// The next item of a recorded source, and the one after it if that is needed to recognise a wrong stamp.
///
/// An item whose stamp is over 1 s off the last one's while the following item is back is left out and counted: it would
/// delay every source that is merged with it. 32 B of state, no heap, one thread.
#ifndef IPE_LOOKAHEAD_H
#define IPE_LOOKAHEAD_H

#include "source.h"

#include <stddef.h>

typedef struct {
    bool has_head, has_ahead, has_last;
    int64_t last_ns;   ///< stamp of the last item taken

    uint64_t n_stray;  ///< items left out: stamp over 1 s off those around it
} ipe_lookahead_t;

/// Where the items come from and go to. They are size bytes each and begin with their stamp, an int64_t in ns.
typedef struct {
    ipe_source_status_t (*read)(void* source, void* item);  ///< READY: item is the next of the file
    void* source;
    void* head;
    void* ahead;
    size_t size;
} ipe_lookahead_items_t;

/// Have the next item in head. READY, WAIT: the source has nothing yet, END.
ipe_source_status_t ipe_lookahead_peek(ipe_lookahead_t* l, const ipe_lookahead_items_t* items);

/// Take the item in head, which stays there until the next peek.
void ipe_lookahead_take(ipe_lookahead_t* l, const ipe_lookahead_items_t* items);

#endif
