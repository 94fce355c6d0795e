// SPDX-License-Identifier: Apache-2.0
#include "lookahead.h"

#include <string.h>

static const int64_t FAR_NS = 1000000000;

static int64_t stamp_of(const void* item)
{
    int64_t t_ns;
    memcpy(&t_ns, item, sizeof t_ns);
    return t_ns;
}

static bool is_far(const ipe_lookahead_t* l, const void* item)
{
    const int64_t apart_ns = stamp_of(item) - l->last_ns;
    return apart_ns > FAR_NS || apart_ns < -FAR_NS;
}

/// Move the item ahead to the head.
static void advance(ipe_lookahead_t* l, const ipe_lookahead_items_t* items)
{
    memcpy(items->head, items->ahead, items->size);
    l->has_ahead = false;
    l->has_head = true;
}

/// The head is far from the last stamp: drop it if the item after it is not. WAIT: that one has not come yet.
static ipe_source_status_t drop_stray(ipe_lookahead_t* l, const ipe_lookahead_items_t* items)
{
    while (is_far(l, items->head)) {
        if (!l->has_ahead) {
            const ipe_source_status_t status = items->read(items->source, items->ahead);
            if (status == IPE_SOURCE_WAIT) { return status; }
            l->has_ahead = status == IPE_SOURCE_READY;
        }
        if (!l->has_ahead || is_far(l, items->ahead)) { break; }
        advance(l, items);
        l->n_stray++;
    }
    return IPE_SOURCE_READY;
}

ipe_source_status_t ipe_lookahead_peek(ipe_lookahead_t* l, const ipe_lookahead_items_t* items)
{
    if (!l->has_head && l->has_ahead) { advance(l, items); }
    if (!l->has_head) {
        const ipe_source_status_t status = items->read(items->source, items->head);
        if (status != IPE_SOURCE_READY) { return status; }
        l->has_head = true;
    }
    return l->has_last ? drop_stray(l, items) : IPE_SOURCE_READY;
}

void ipe_lookahead_take(ipe_lookahead_t* l, const ipe_lookahead_items_t* items)
{
    l->has_head = false;
    l->has_last = true;
    l->last_ns = stamp_of(items->head);
}
