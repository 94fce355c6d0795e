// SPDX-License-Identifier: Apache-2.0
#include "lock_step.h"

#include "candump.h"
#include "record.h"

#include <assert.h>
#include <errno.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { POSITION_CHARS = 200 };
static const char POSITION[] = "position ", COMMAND[] = "command ", ANSWER[] = "answer";

int ipe_lock_step_open(ipe_lock_step_t* l)
{
    l->n_frames = l->n_positions = l->n_commands = l->n_answers = 0;
    l->n_too_long = l->n_cut = l->n_bad_frames = l->n_bad_positions = l->n_bad_commands = l->n_bad_times = 0;
    l->n_messages = 0, l->n_out = 0;
    l->limit = (ipe_message_limit_t){0};
    l->is_broken = false;
    return ipe_lines_open(&l->lines, "-");
}

/// A line that is of no use; n counts those like it.
static void report(ipe_lock_step_t* l, uint64_t* n, const char* reason)
{
    ++*n;
    if (ipe_message_allowed(&l->limit, "stdin")) { ipe_message("stdin:%" PRIu64 ": %s", l->lines.number, reason); }
}

/// can0 to can7.
static bool take_bus(ipe_candump_name_t name, uint8_t* bus)
{
    if (name.length != 4 || memcmp(name.text, "can", 3) != 0) { return false; }
    *bus = (uint8_t)(name.text[3] - '0');
    return *bus < IPE_BUSES_MAX;
}

static bool take_frame(ipe_lock_step_t* l, const char* text, size_t length)
{
    ipe_candump_name_t name;
    uint64_t n_dropped;
    const ipe_candump_t result = ipe_candump_parse(text, length, &l->frame, &name, &n_dropped);
    if (result == IPE_CANDUMP_FRAME && take_bus(name, &l->frame.bus)) { return true; }
    report(l, &l->n_bad_frames,
           result == IPE_CANDUMP_FRAME ? "the interface is none of can0 to can7" : ipe_candump_reason(result));
    return false;
}

static bool take_position(ipe_lock_step_t* l, const char* text, size_t length)
{
    char line[POSITION_CHARS + 1];
    char *at = line, *end;
    if (length > POSITION_CHARS) {
        report(l, &l->n_too_long, "is too long");
        return false;
    }
    memcpy(line, text, length);
    line[length] = '\0';
    l->position.t_ns = strtoll(at, &end, 10);
    bool is_good = end != at && *end == ' ';
    for (int i = 0; i < 3 && is_good; ++i) {
        at = end;
        l->position.position[i] = strtod(at, &end);
        is_good = end != at && *end == (i < 2 ? ' ' : '\0');
    }
    if (!is_good || end != line + length) {  // before it: a zero byte, which would hide the rest
        report(l, &l->n_bad_positions, "is no \"position T_NS X Y Z\"");
        return false;
    }
    if (l->position.t_ns < 0 || l->position.t_ns > IPE_TIME_MAX_NS) {
        report(l, &l->n_bad_times, "its time is no host time; allowed: 0 to 8999999999 s, in ns");
        return false;
    }
    return true;
}

/// 0 to 15, or -1: no hexadecimal digit.
static int digit(char c)
{
    const int letter = c | 0x20;
    return c >= '0' && c <= '9' ? c - '0' : letter >= 'a' && letter <= 'f' ? letter - 'a' + 10 : -1;
}

static bool take_command(ipe_lock_step_t* l, const char* text, size_t length)
{
    bool is_good = length % 2 == 0;
    l->n_message = length / 2;
    if (l->n_message > sizeof l->message) {
        report(l, &l->n_too_long, "is too long: a command has at most 1024 bytes, so CONFIGURE cannot be sent");
        return false;
    }
    static_assert(IPE_LOCK_STEP_MESSAGE == 1024, "the limit in words");
    for (size_t i = 0; is_good && i < l->n_message; ++i) {
        const int high = digit(text[2 * i]), low = digit(text[2 * i + 1]);
        is_good = high >= 0 && low >= 0;
        l->message[i] = (uint8_t)(16 * high + low);
    }
    if (is_good && ipe_command_decode(l->message, l->n_message, &l->command) == 0) { return true; }
    report(l, &l->n_bad_commands, "is no \"command HEX\" of a command_t of this version");
    return false;
}

/// True if the line is an item.
static bool take_line(ipe_lock_step_t* l, const char* text, size_t length, ipe_lock_step_item_t* item)
{
    const size_t n = sizeof POSITION - 1;
    if (length == sizeof ANSWER - 1 && memcmp(text, ANSWER, length) == 0) {
        *item = IPE_LOCK_STEP_ANSWER;
        return true;
    }
    if (length > n && memcmp(text, POSITION, n) == 0) {
        *item = IPE_LOCK_STEP_POSITION;
        return take_position(l, text + n, length - n);
    }
    const size_t n_command = sizeof COMMAND - 1;
    if (length > n_command && memcmp(text, COMMAND, n_command) == 0) {
        *item = IPE_LOCK_STEP_COMMAND;
        return take_command(l, text + n_command, length - n_command);
    }
    *item = IPE_LOCK_STEP_FRAME;
    return take_frame(l, text, length);
}

static void count(ipe_lock_step_t* l, ipe_lock_step_item_t item)
{
    switch (item) {
    case IPE_LOCK_STEP_FRAME: l->n_frames++; break;
    case IPE_LOCK_STEP_POSITION: l->n_positions++; break;
    case IPE_LOCK_STEP_COMMAND: l->n_commands++; break;
    default: l->n_answers++; break;
    }
}

static void end(ipe_lock_step_t* l)
{
    if (l->lines.error != 0) {
        ipe_message("stdin: %s; read up to line %" PRIu64, strerror(l->lines.error), l->lines.number);
        l->is_broken = true;
    } else if (l->lines.number > 0 && l->n_frames + l->n_positions + l->n_commands + l->n_answers == 0) {
        ipe_message("stdin: none of %" PRIu64
                    " lines is of use: none is a frame of candump, a position, a command or \"%s\"",
                    l->lines.number, ANSWER);
        l->is_broken = true;
    }
}

ipe_lock_step_item_t ipe_lock_step_next(ipe_lock_step_t* l)
{
    for (;;) {
        const char* text;
        size_t length;
        ipe_lock_step_item_t item;
        switch (ipe_lines_next(&l->lines, &text, &length)) {
        case IPE_LINES_OK:
            if (!take_line(l, text, length, &item)) { break; }
            count(l, item);
            return item;
        case IPE_LINES_WAIT: return IPE_LOCK_STEP_WAIT;
        case IPE_LINES_LONG: report(l, &l->n_too_long, "is too long"); break;
        case IPE_LINES_UNENDED: report(l, &l->n_cut, "is cut off"); break;
        case IPE_LINES_END:
        default: end(l); return IPE_LOCK_STEP_END;
        }
    }
}

void ipe_lock_step_fill(ipe_lock_step_t* l)
{
    ipe_lines_fill(&l->lines);
}

static void write_out(ipe_lock_step_t* l)
{
    size_t done = 0;
    while (done < l->n_out && !l->is_broken) {
        const ssize_t n = write(STDOUT_FILENO, l->out + done, l->n_out - done);
        if (n >= 0) {
            done += (size_t)n;
        } else if (errno != EINTR) {
            l->is_broken = true;
            ipe_message("stdout: %s; nobody takes the answers", strerror(errno));
        }
    }
    l->n_out = 0;
}

static void append(ipe_lock_step_t* l, const void* bytes, size_t n)
{
    if (n > sizeof l->out - l->n_out) { write_out(l); }
    if (n > sizeof l->out) { return; }
    memcpy(l->out + l->n_out, bytes, n);
    l->n_out += n;
}

void ipe_lock_step_put(ipe_lock_step_t* l, const char* channel, int64_t t_ns, const uint8_t* data, size_t n)
{
    uint8_t header[IPE_RECORD_HEADER];
    const size_t n_channel = strlen(channel);
    ipe_record_put_header(header, l->n_messages++, t_ns / 1000, n_channel, n);
    append(l, header, sizeof header);
    append(l, channel, n_channel);
    if (n > 0) { append(l, data, n); }
}

bool ipe_lock_step_send(ipe_lock_step_t* l)
{
    write_out(l);
    return !l->is_broken;
}

const char* ipe_lock_step_counter(const ipe_lock_step_t* l, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"lines", l->lines.number},
        {"frames", l->n_frames},
        {"positions", l->n_positions},
        {"commands", l->n_commands},
        {"answers", l->n_answers},
        {"too_long", l->n_too_long},
        {"cut", l->n_cut},
        {"bad_frame", l->n_bad_frames},
        {"bad_position", l->n_bad_positions},
        {"bad_command", l->n_bad_commands},
        {"bad_time", l->n_bad_times},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
