// SPDX-License-Identifier: Apache-2.0
#include "source_file.h"

#include <assert.h>
#include <inttypes.h>
#include <stddef.h>
#include <string.h>

int ipe_source_file_open(ipe_source_file_t* s, const char* path, uint8_t bus, const char* interface)
{
    memset(s, 0, offsetof(ipe_source_file_t, lines));
    memset(&s->limit, 0, sizeof *s - offsetof(ipe_source_file_t, limit));
    s->path = strcmp(path, "-") == 0 ? "stdin" : path;
    s->interface = interface;
    s->bus = bus;
    return ipe_lines_open(&s->lines, path);
}

static void report(ipe_source_file_t* s, const char* reason, const char* text, size_t length)
{
    enum { EXCERPT = 60 };
    if (!ipe_message_allowed(&s->limit, s->path)) { return; }
    ipe_message("%s:%" PRIu64 ": line %s: \"%.*s\"%s", s->path, s->lines.number, reason,
                (int)(length < EXCERPT ? length : EXCERPT), text, length < EXCERPT ? "" : "...");
}

static bool is_wanted(ipe_source_file_t* s, ipe_candump_name_t name)
{
    if (s->interface == NULL) { return true; }
    if (strlen(s->interface) == name.length && memcmp(s->interface, name.text, name.length) == 0) { return true; }
    s->n_other_interface++;
    return false;
}

/// True if the line is a frame for us, now in *frame.
static bool parse(ipe_source_file_t* s, ipe_frame_t* frame, const char* text, size_t length, bool is_ended)
{
    ipe_candump_name_t name;
    uint64_t n_dropped = 0;
    const ipe_candump_t result = ipe_candump_parse(text, length, frame, &name, &n_dropped);
    if (result == IPE_CANDUMP_FRAME) {
        s->n_result[result]++;
        return is_wanted(s, name);
    }
    s->counts.n_dropped += n_dropped;
    if (result > IPE_CANDUMP_DROPS) { report(s, ipe_candump_reason(result), text, length); }
    if (result > IPE_CANDUMP_DROPS && !is_ended) {
        s->n_cut++;
    } else {
        s->n_result[result]++;
    }
    return false;
}

static ipe_source_status_t end(ipe_source_file_t* s)
{
    if (s->lines.error != 0) {
        ipe_message("%s: %s; read up to line %" PRIu64, s->path, strerror(s->lines.error), s->lines.number);
    }
    s->lines.error = 0;
    return IPE_SOURCE_END;
}

/// The next frame of the file.
static ipe_source_status_t read_frame(void* source, void* item)
{
    ipe_source_file_t* s = source;
    ipe_frame_t* frame = item;
    for (;;) {
        const char* text;
        size_t length;
        const ipe_lines_status_t found = ipe_lines_next(&s->lines, &text, &length);
        if (found == IPE_LINES_WAIT) { return IPE_SOURCE_WAIT; }
        if (found == IPE_LINES_END) { return end(s); }
        if (found == IPE_LINES_LONG) {
            s->n_too_long++;
            report(s, "is too long", text, length);
        } else if (parse(s, frame, text, length, found == IPE_LINES_OK)) {
            frame->bus = s->bus;
            return IPE_SOURCE_READY;
        }
    }
}

static_assert(offsetof(ipe_frame_t, t_ns) == 0, "the stamp comes first");

static ipe_lookahead_items_t items_of(ipe_source_file_t* s)
{
    return (ipe_lookahead_items_t){
        .read = read_frame, .source = s, .head = &s->head, .ahead = &s->ahead, .size = sizeof s->head};
}

ipe_source_status_t ipe_source_file_peek(ipe_source_file_t* s)
{
    const ipe_lookahead_items_t items = items_of(s);
    return ipe_lookahead_peek(&s->lookahead, &items);
}

void ipe_source_file_take(ipe_source_file_t* s)
{
    const ipe_lookahead_items_t items = items_of(s);
    ipe_lookahead_take(&s->lookahead, &items);
    ipe_bus_count(&s->counts, &s->head);
}

void ipe_source_file_fill(ipe_source_file_t* s)
{
    ipe_lines_fill(&s->lines);
}

void ipe_source_file_close(ipe_source_file_t* s)
{
    ipe_lines_close(&s->lines);
}

const char* ipe_source_file_counter(const ipe_source_file_t* s, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"lines", s->lines.number},
        {"frames", s->counts.n_frames},
        {"error_frames", s->counts.n_error_frames},
        {"comments", s->n_result[IPE_CANDUMP_COMMENT]},
        {"drop_reports", s->n_result[IPE_CANDUMP_DROPS]},
        {"other_interface", s->n_other_interface},
        {"dropped_by_logger", s->counts.n_dropped},
        {"controller_overruns", s->counts.n_controller_overruns},
        {"bad_stamp", s->n_result[IPE_CANDUMP_BAD_STAMP]},
        {"bad_name", s->n_result[IPE_CANDUMP_BAD_NAME]},
        {"bad_id", s->n_result[IPE_CANDUMP_BAD_ID]},
        {"bad_data", s->n_result[IPE_CANDUMP_BAD_DATA]},
        {"bad_tail", s->n_result[IPE_CANDUMP_BAD_TAIL]},
        {"stray_stamp", s->lookahead.n_stray},
        {"too_long", s->n_too_long},
        {"cut", s->n_cut},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
