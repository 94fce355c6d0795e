// SPDX-License-Identifier: Apache-2.0
#include "counters.h"

#include "message.h"

#include <assert.h>
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

void ipe_counters_clear(ipe_counters_t* c)
{
    c->n = 0;
}

void ipe_counters_add(ipe_counters_t* c, const char* stage, const char* cause, uint64_t value)
{
    assert(c->n < IPE_COUNTERS_MAX);
    (void)snprintf(c->item[c->n].name, sizeof c->item[c->n].name, "%s%s%s", stage != NULL ? stage : "",
                   stage != NULL ? "." : "", cause);
    c->item[c->n].value = value;
    c->n++;
}

static int widest_name(const ipe_counters_t* c)
{
    size_t widest = 0;
    for (unsigned i = 0; i < c->n; ++i) {
        const size_t width = strlen(c->item[i].name);
        if (width > widest) { widest = width; }
    }
    return (int)widest;
}

void ipe_counters_print(const ipe_counters_t* c, bool with_zero)
{
    const int width = widest_name(c);
    for (unsigned i = 0; i < c->n; ++i) {
        if (c->item[i].value == 0 && !with_zero) { continue; }
        ipe_message("%-*s  %12" PRIu64, width, c->item[i].name, c->item[i].value);
    }
}
