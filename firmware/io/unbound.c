// SPDX-License-Identifier: Apache-2.0
#include "unbound.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>

static void keep(ipe_unbound_t* u, uint32_t can_id, uint8_t bus)
{
    for (unsigned i = 0; i < u->n; ++i) {
        if (u->item[i].can_id == can_id && u->item[i].bus == bus) { return; }
    }
    if (u->n == IPE_UNBOUND_MAX) {
        u->has_more = true;
        return;
    }
    u->item[u->n].can_id = can_id;
    u->item[u->n].bus = bus;
    u->n++;
}

void ipe_unbound_note(ipe_unbound_t* u, const ipe_frame_t* frame)
{
    if (frame->can_id & IPE_CAN_ERR) { return; }
    keep(u, frame->can_id, frame->bus);
}

typedef struct {
    char* text;
    size_t size, at;
} writer_t;

__attribute__((format(printf, 2, 3))) static void write_text(writer_t* w, const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    const int n = vsnprintf(w->text + w->at, w->size - w->at, format, arguments);
    va_end(arguments);
    if (n > 0) { w->at = w->at + (size_t)n < w->size ? w->at + (size_t)n : w->size - 1; }
}

static void write_ids(writer_t* w, const ipe_unbound_t* u)
{
    for (unsigned i = 0; i < u->n; ++i) {
        const uint32_t can_id = u->item[i].can_id;
        const int width = can_id & IPE_CAN_EFF ? 8 : 3;
        const char* const remote = can_id & IPE_CAN_RTR ? " (remote)" : "";
        write_text(w, "%s%0*" PRIX32 " on bus %u%s", i == 0 ? "" : ", ", width, can_id & UINT32_C(0x1FFFFFFF),
                   u->item[i].bus, remote);
    }
    if (u->has_more) { write_text(w, ", ..."); }
}

void ipe_unbound_describe(const ipe_unbound_t* u, const ipe_config_t* config, char* text, size_t size)
{
    writer_t w = {text, size, 0};
    ipe_unbound_t expected = {0};
    for (unsigned i = 0; i < (unsigned)config->n_signals; ++i) {
        keep(&expected, config->signal[i].can_id, (uint8_t)config->signal[i].bus);
    }
    write_text(&w, "received ");
    write_ids(&w, u);
    write_text(&w, "; expected ");
    write_ids(&w, &expected);
}
