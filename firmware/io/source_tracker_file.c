// SPDX-License-Identifier: Apache-2.0
#include "source_tracker_file.h"

#include <assert.h>
#include <errno.h>
#include <poll.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <stddef.h>
#include <string.h>

enum { CELL_MAX = 63, NO_COLUMN = -1 };
static const int64_t NS_PER_S = 1000000000;
static const char* const COLUMN[IPE_TRACKER_COLUMNS] = {"t", "x", "y", "z"};

/// Cells of a line, one by one.
typedef struct {
    const char* at;
    const char* end;
    bool is_done;
} cells_t;

static bool is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '"' || c == '\r';
}

/// The next cell without blanks and quotes around it, terminated; a cell that is too long becomes empty.
static bool next_cell(cells_t* c, char cell[CELL_MAX + 1])
{
    if (c->is_done) { return false; }
    const char* comma = memchr(c->at, ',', (size_t)(c->end - c->at));
    const char* begin = c->at;
    const char* end = comma != NULL ? comma : c->end;
    c->is_done = comma == NULL;
    c->at = comma != NULL ? comma + 1 : c->end;
    while (begin < end && is_blank(*begin)) { begin++; }
    while (begin < end && is_blank(end[-1])) { end--; }
    const size_t n = end - begin > CELL_MAX ? 0 : (size_t)(end - begin);
    memcpy(cell, begin, n);
    cell[n] = '\0';
    return true;
}

static bool read_number(const char* cell, double* value)
{
    char* end;
    *value = strtod(cell, &end);
    return end != cell && *end == '\0';
}

/// "1436509052.249713" in whole nanoseconds, without the rounding of a double. False for any other notation.
static bool read_decimal_seconds(const char* cell, int64_t* t_ns)
{
    const size_t whole = strspn(cell, "0123456789");
    const size_t fraction = cell[whole] == '.' ? strspn(cell + whole + 1, "0123456789") : 0;
    const size_t n = whole + (cell[whole] == '.' ? fraction + 1 : 0);
    if (whole == 0 || whole > 9 + 1 || cell[n] != '\0') { return false; }
    int64_t value = strtoll(cell, NULL, 10);
    for (size_t i = 1; i <= 9; ++i) { value = value * 10 + (i <= fraction ? cell[whole + i] - '0' : 0); }
    *t_ns = value;
    return true;
}

static bool read_time(const char* cell, int64_t* t_ns)
{
    double t;
    if (!read_number(cell, &t) || !(t >= 0.0 && t <= (double)IPE_SECONDS_MAX)) { return false; }
    if (!read_decimal_seconds(cell, t_ns)) { *t_ns = llround(t * (double)NS_PER_S); }
    return true;
}

static bool read_cell(const char* cell, int which, ipe_position_t* p)
{
    return which == 0 ? read_time(cell, &p->t_ns) : read_number(cell, &p->position[which - 1]);
}

static bool read_row(const ipe_source_tracker_file_t* s, const char* text, size_t length, ipe_position_t* p)
{
    cells_t cells = {text, text + length, false};
    char cell[CELL_MAX + 1];
    int n_read = 0;
    for (int i = 0; next_cell(&cells, cell); ++i) {
        for (int which = 0; which < IPE_TRACKER_COLUMNS; ++which) {
            if (s->column[which] != i) { continue; }
            if (!read_cell(cell, which, p)) { return false; }
            n_read++;
        }
    }
    return n_read == IPE_TRACKER_COLUMNS;
}

static bool find_columns(ipe_source_tracker_file_t* s, const char* text, size_t length, char* message, size_t size)
{
    cells_t cells = {text, text + length, false};
    char cell[CELL_MAX + 1];
    for (int which = 0; which < IPE_TRACKER_COLUMNS; ++which) { s->column[which] = NO_COLUMN; }
    for (int i = 0; next_cell(&cells, cell); ++i) {
        for (int which = 0; which < IPE_TRACKER_COLUMNS; ++which) {
            if (strcmp(cell, COLUMN[which]) != 0) { continue; }
            if (s->column[which] != NO_COLUMN) {
                (void)snprintf(message, size, "%s:1: column \"%s\" is there twice", s->path, cell);
                return false;
            }
            s->column[which] = i;
        }
    }
    for (int which = 0; which < IPE_TRACKER_COLUMNS; ++which) {
        if (s->column[which] != NO_COLUMN) { continue; }
        (void)snprintf(message, size, "%s:1: header has no column \"%s\"; needed: t,x,y,z", s->path, COLUMN[which]);
        return false;
    }
    return true;
}

/// Wait for the first line. WAIT: stop_fd became readable.
static ipe_lines_status_t wait_for_line(ipe_lines_t* lines, int stop_fd, const char** text, size_t* length)
{
    ipe_lines_status_t found;
    while ((found = ipe_lines_next(lines, text, length)) == IPE_LINES_WAIT) {
        struct pollfd input[] = {{.fd = lines->fd, .events = POLLIN}, {.fd = stop_fd, .events = POLLIN}};
        (void)poll(input, 2, -1);
        if ((input[1].revents & POLLIN) != 0) { return found; }
        if (input[0].revents != 0) { ipe_lines_fill(lines); }
    }
    return found;
}

int ipe_source_tracker_file_open(ipe_source_tracker_file_t* s, const char* path, int stop_fd, char* message,
                                 size_t size)
{
    static const char MARK[] = "\xEF\xBB\xBF";  // some spreadsheets begin a text file so
    memset(s, 0, sizeof *s);
    s->path = strcmp(path, "-") == 0 ? "stdin" : path;
    if (ipe_lines_open(&s->lines, path) != 0) {
        (void)snprintf(message, size, "%s: %s", path, strerror(errno));
        return -1;
    }
    const char* text;
    size_t length;
    const ipe_lines_status_t found = wait_for_line(&s->lines, stop_fd, &text, &length);
    if (found == IPE_LINES_WAIT) {
        (void)snprintf(message, size, "%s: stopped before the header line came", s->path);
        return -1;
    }
    if (found != IPE_LINES_OK) {
        (void)snprintf(message, size, "%s: no header line; needed: t,x,y,z", s->path);
        return -1;
    }
    const size_t skip = length >= 3 && memcmp(text, MARK, 3) == 0 ? 3 : 0;
    return find_columns(s, text + skip, length - skip, message, size) ? 0 : -1;
}

static void refuse(ipe_source_tracker_file_t* s)
{
    s->n_bad_rows++;
    if (!ipe_message_allowed(&s->limit, s->path)) { return; }
    ipe_message("%s:%" PRIu64 ": row has no readable t, x, y and z", s->path, s->lines.number);
}

/// The next position of the file.
static ipe_source_status_t read_position(void* source, void* item)
{
    ipe_source_tracker_file_t* s = source;
    ipe_position_t* position = item;
    for (;;) {
        const char* text;
        size_t length;
        const ipe_lines_status_t found = ipe_lines_next(&s->lines, &text, &length);
        if (found == IPE_LINES_WAIT) { return IPE_SOURCE_WAIT; }
        if (found == IPE_LINES_END) { return IPE_SOURCE_END; }
        if (found == IPE_LINES_OK && length == 0) { continue; }
        if (found != IPE_LINES_LONG && read_row(s, text, length, position)) { return IPE_SOURCE_READY; }
        refuse(s);
    }
}

static_assert(offsetof(ipe_position_t, t_ns) == 0, "the stamp comes first");

static ipe_lookahead_items_t items_of(ipe_source_tracker_file_t* s)
{
    return (ipe_lookahead_items_t){
        .read = read_position, .source = s, .head = &s->head, .ahead = &s->ahead, .size = sizeof s->head};
}

ipe_source_status_t ipe_source_tracker_file_peek(ipe_source_tracker_file_t* s)
{
    const ipe_lookahead_items_t items = items_of(s);
    return ipe_lookahead_peek(&s->lookahead, &items);
}

void ipe_source_tracker_file_take(ipe_source_tracker_file_t* s)
{
    const ipe_lookahead_items_t items = items_of(s);
    ipe_lookahead_take(&s->lookahead, &items);
    s->n_positions++;
}

void ipe_source_tracker_file_fill(ipe_source_tracker_file_t* s)
{
    ipe_lines_fill(&s->lines);
}

void ipe_source_tracker_file_close(ipe_source_tracker_file_t* s)
{
    ipe_lines_close(&s->lines);
}

const char* ipe_source_tracker_file_counter(const ipe_source_tracker_file_t* s, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {{"positions", s->n_positions}, {"bad_rows", s->n_bad_rows}, {"stray_time", s->lookahead.n_stray}};
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
