// SPDX-License-Identifier: Apache-2.0
#include "command.h"

#include "config_file.h"
#include "inertiad_lcm_command_t.h"
#include "inertiad_lcm_expectation_t.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

static_assert(IPE_COMMAND_FREEZE == INERTIAD_LCM_COMMAND_T_FREEZE && IPE_COMMAND_MARK == INERTIAD_LCM_COMMAND_T_MARK &&
                  IPE_COMMAND_EXPECT == INERTIAD_LCM_COMMAND_T_EXPECT,
              "the numbers of the message");
static_assert(IPE_COMMAND_TEXT_MAX == INERTIAD_LCM_COMMAND_T_TEXT_MAX &&
                  IPE_CONFIG_FILE_MAX == INERTIAD_LCM_COMMAND_T_CONFIG_MAX,
              "the limits of the message");

static_assert(sizeof(inertiad_lcm_expectation_t) == sizeof(int64_t) + sizeof(double) * IPE_ANNOUNCEMENT_NUMBERS,
              "the numbers of the message");

/// Rest of the message. Reading past its end gives zeros and is remembered.
typedef struct {
    const uint8_t* at;
    size_t n;
    bool is_short;
} rest_t;

static const uint8_t* take(rest_t* r, size_t n)
{
    static const uint8_t NOTHING[8] = {0};
    if (r->is_short || n > r->n) {
        r->is_short = true;
        return NOTHING;
    }
    const uint8_t* bytes = r->at;
    r->at += n;
    r->n -= n;
    return bytes;
}

static uint64_t take_number(rest_t* r, size_t n)
{
    const uint8_t* bytes = take(r, n);
    uint64_t value = 0;
    for (size_t i = 0; i < n; ++i) { value = (value << 8) | bytes[i]; }
    return value;
}

/// The bytes that a length of 4 bytes announces.
static const uint8_t* take_counted(rest_t* r, size_t* n)
{
    *n = take_number(r, 4);
    return take(r, *n);
}

int ipe_command_decode(const uint8_t* data, size_t n, ipe_command_t* command)
{
    rest_t r = {data, n, false};
    size_t n_text;
    if (take_number(&r, 8) != (uint64_t)__inertiad_lcm_command_t_get_hash()) { return -1; }
    command->sequence = (int64_t)take_number(&r, 8);
    command->t_ns = (int64_t)take_number(&r, 8);
    command->sender = (int64_t)take_number(&r, 8);
    command->kind = (int8_t)take_number(&r, 1);
    command->text = (const char*)take_counted(&r, &n_text);
    if (r.is_short || n_text == 0 || command->text[n_text - 1] != '\0') { return -1; }
    command->config = take_counted(&r, &command->n_config);
    return r.is_short || r.n != 0 ? -1 : 0;
}

int ipe_command_expectation(const ipe_command_t* command, ipe_expectation_t* expectation)
{
    rest_t r = {command->config, command->n_config, false};
    const size_t n = sizeof expectation->number / sizeof expectation->number[0];
    if (take_number(&r, 8) != (uint64_t)__inertiad_lcm_expectation_t_get_hash()) { return -1; }
    expectation->t_ns = (int64_t)take_number(&r, 8);
    for (size_t i = 0; i < n; ++i) {
        const uint64_t bits = take_number(&r, 8);
        memcpy(&expectation->number[i], &bits, sizeof bits);
    }
    return r.is_short || r.n != 0 ? -1 : 0;
}

static bool is_time(int64_t t_ns)
{
    return t_ns >= 0 && t_ns <= IPE_TIME_MAX_NS;
}

int ipe_command_contact(const ipe_command_t* command, const ipe_expectation_t* expectation, int64_t sent_ns,
                        int64_t* t_ns)
{
    if (!is_time(command->t_ns) || !is_time(expectation->t_ns) || !is_time(sent_ns)) { return -1; }
    const int64_t after_ns = expectation->t_ns - command->t_ns;
    if (after_ns < -sent_ns || after_ns > IPE_TIME_MAX_NS - sent_ns) { return -1; }
    *t_ns = sent_ns + after_ns;
    return 0;
}
