// SPDX-License-Identifier: Apache-2.0
#include "candump.h"

#include "source.h"

#include <string.h>

enum { INTERFACE_NAME_MAX = 15, CLASSICAL_MAX = 8 };
static const int64_t NS_PER_S = 1000000000;

/// Rest of the line.
typedef struct {
    const char* at;
    const char* end;
} cursor_t;

/// Value of a hex digit + 1; 0: not a hex digit.
static const uint8_t HEX[256] = {
    ['0'] = 1,  ['1'] = 2,  ['2'] = 3,  ['3'] = 4,  ['4'] = 5,  ['5'] = 6,  ['6'] = 7,  ['7'] = 8,
    ['8'] = 9,  ['9'] = 10, ['a'] = 11, ['b'] = 12, ['c'] = 13, ['d'] = 14, ['e'] = 15, ['f'] = 16,
    ['A'] = 11, ['B'] = 12, ['C'] = 13, ['D'] = 14, ['E'] = 15, ['F'] = 16,
};

static unsigned hex(char digit)
{
    return HEX[(uint8_t)digit];
}

static bool is_decimal(char digit)
{
    return digit >= '0' && digit <= '9';
}

static bool is_space(char c)
{
    return c == ' ' || c == '\t' || c == '\r';
}

static void skip_spaces(cursor_t* c)
{
    while (c->at < c->end && is_space(*c->at)) { c->at++; }
}

static bool take_char(cursor_t* c, char wanted)
{
    if (c->at == c->end || *c->at != wanted) { return false; }
    c->at++;
    return true;
}

/// Up to max_digits decimal digits; how many there were.
static int take_decimal(cursor_t* c, int max_digits, int64_t* value)
{
    int n = 0;
    *value = 0;
    while (n < max_digits && c->at < c->end && is_decimal(*c->at)) {
        *value = *value * 10 + (*c->at - '0');
        c->at++;
        n++;
    }
    return n;
}

static bool take_stamp(cursor_t* c, int64_t* t_ns)
{
    int64_t seconds;
    int64_t fraction;
    if (!take_char(c, '(') || take_decimal(c, 10, &seconds) == 0 || !take_char(c, '.')) { return false; }
    int n = take_decimal(c, 9, &fraction);
    if (n == 0 || seconds > IPE_SECONDS_MAX || !take_char(c, ')')) { return false; }
    for (; n < 9; ++n) { fraction *= 10; }
    *t_ns = seconds * NS_PER_S + fraction;
    return true;
}

static bool take_name(cursor_t* c, ipe_candump_name_t* name)
{
    skip_spaces(c);
    name->text = c->at;
    while (c->at < c->end && !is_space(*c->at)) { c->at++; }
    name->length = (size_t)(c->at - name->text);
    return name->length >= 1 && name->length <= INTERFACE_NAME_MAX;
}

static bool take_id(cursor_t* c, uint32_t* can_id)
{
    uint32_t id = 0;
    int n = 0;
    while (n < 9 && c->at < c->end && hex(*c->at) != 0) {
        id = (id << 4) | (hex(*c->at) - 1U);
        c->at++;
        n++;
    }
    if (!take_char(c, '#') || (n != 3 && n != 8)) { return false; }
    if (n == 8 && (id & IPE_CAN_ERR) == 0) {
        *can_id = id | IPE_CAN_EFF;
        return id <= 0x1FFFFFFFU;
    }
    *can_id = id;
    return id <= (n == 8 ? 0x3FFFFFFFU : 0x7FFU);
}

static bool is_word_end(const cursor_t* c)
{
    return c->at == c->end || is_space(*c->at);
}

static void take_bytes(cursor_t* c, ipe_frame_t* frame, int max_bytes)
{
    int n = 0;
    for (; n < max_bytes && c->end - c->at >= 2 && hex(c->at[0]) != 0 && hex(c->at[1]) != 0; c->at += 2) {
        frame->data[n++] = (uint8_t)(((hex(c->at[0]) - 1U) << 4) | (hex(c->at[1]) - 1U));
    }
    frame->length = (uint8_t)n;
}

/// Eight bytes may carry "_B": the length code on the wire, 9 to F, which means 8 as well.
static bool take_classical(cursor_t* c, ipe_frame_t* frame)
{
    take_bytes(c, frame, CLASSICAL_MAX);
    if (frame->length == CLASSICAL_MAX && take_char(c, '_')) {
        if (c->at == c->end || hex(*c->at) <= 9U) { return false; }
        c->at++;
    }
    return is_word_end(c);
}

static bool take_remote(cursor_t* c, ipe_frame_t* frame)
{
    int64_t length;
    (void)take_decimal(c, 1, &length);
    frame->can_id |= IPE_CAN_RTR;
    frame->length = (uint8_t)length;
    return length <= CLASSICAL_MAX && is_word_end(c);
}

static bool is_fd_length(unsigned n)
{
    return n <= 8 || n == 12 || n == 16 || n == 20 || n == 24 || n == 32 || n == 48 || n == 64;
}

static bool take_fd(cursor_t* c, ipe_frame_t* frame)
{
    if (c->at == c->end || hex(*c->at) == 0) { return false; }
    const unsigned flags = hex(*c->at) - 1U;
    c->at++;
    frame->flags = IPE_FRAME_FD;
    if ((flags & 1U) != 0) { frame->flags |= IPE_FRAME_BRS; }
    if ((flags & 2U) != 0) { frame->flags |= IPE_FRAME_ESI; }
    take_bytes(c, frame, IPE_DATA_MAX);
    return is_word_end(c) && is_fd_length(frame->length);
}

static bool take_data(cursor_t* c, ipe_frame_t* frame)
{
    memset(frame->data, 0, sizeof frame->data);
    frame->flags = 0;
    if (take_char(c, '#')) { return take_fd(c, frame); }
    if (take_char(c, 'R')) { return take_remote(c, frame); }
    return take_classical(c, frame);
}

/// Nothing more, or one direction letter.
static bool take_tail(cursor_t* c)
{
    skip_spaces(c);
    if (c->at == c->end) { return true; }
    if (!take_char(c, 'R') && !take_char(c, 'T')) { return false; }
    skip_spaces(c);
    return c->at == c->end;
}

/// "DROPCOUNT: dropped 12 CAN frames on 'can0' socket (total drops 40)"
static bool take_drops(cursor_t* c, uint64_t* n_dropped)
{
    static const char PREFIX[] = "DROPCOUNT: dropped ";
    const size_t n = sizeof PREFIX - 1;
    int64_t value;
    if ((size_t)(c->end - c->at) < n || memcmp(c->at, PREFIX, n) != 0) { return false; }
    c->at += n;
    if (take_decimal(c, 10, &value) == 0) { return false; }
    *n_dropped = (uint64_t)value;
    return true;
}

ipe_candump_t ipe_candump_parse(const char* line, size_t length, ipe_frame_t* frame, ipe_candump_name_t* name,
                                uint64_t* n_dropped)
{
    cursor_t c = {line, line + length};
    skip_spaces(&c);
    if (c.at == c.end || *c.at == '#' || *c.at == ';') { return IPE_CANDUMP_COMMENT; }
    if (*c.at == 'D' && take_drops(&c, n_dropped)) { return IPE_CANDUMP_DROPS; }
    if (!take_stamp(&c, &frame->t_ns)) { return IPE_CANDUMP_BAD_STAMP; }
    if (!take_name(&c, name)) { return IPE_CANDUMP_BAD_NAME; }
    skip_spaces(&c);
    if (!take_id(&c, &frame->can_id)) { return IPE_CANDUMP_BAD_ID; }
    if (!take_data(&c, frame)) { return IPE_CANDUMP_BAD_DATA; }
    if (!take_tail(&c)) { return IPE_CANDUMP_BAD_TAIL; }
    frame->t_hw_ns = 0;
    return IPE_CANDUMP_FRAME;
}

const char* ipe_candump_reason(ipe_candump_t result)
{
    static const char* const REASON[IPE_CANDUMP_COUNT] = {
        [IPE_CANDUMP_BAD_STAMP] = "does not begin with (seconds.fraction)",
        [IPE_CANDUMP_BAD_NAME] = "has no interface name of 1 to 15 characters",
        [IPE_CANDUMP_BAD_ID] = "has no identifier of 3 or 8 hex digits up to 7FF or 1FFFFFFF and '#'",
        [IPE_CANDUMP_BAD_DATA] = "has data that are not pairs of hex digits of a length CAN has",
        [IPE_CANDUMP_BAD_TAIL] = "goes on after its data",
    };
    return REASON[result] != NULL ? REASON[result] : "is good";
}
