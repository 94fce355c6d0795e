// SPDX-License-Identifier: Apache-2.0
/// Decoder of command_t. Strings and bytes are views into the message, so nothing is allocated.
#ifndef IPE_COMMAND_H
#define IPE_COMMAND_H

#include "announcement.h"

#include <stddef.h>
#include <stdint.h>

/// The numbers are those of lcm_types/command_t.lcm.
typedef enum {
    IPE_COMMAND_FREEZE = 1,
    IPE_COMMAND_RESUME = 2,
    IPE_COMMAND_RESET = 3,
    IPE_COMMAND_TARE = 4,
    IPE_COMMAND_CONFIGURE = 5,
    IPE_COMMAND_MARK = 6,
    IPE_COMMAND_EXPECT = 7,
} ipe_command_kind_t;

enum { IPE_COMMAND_TEXT_MAX = 200 };  ///< bytes of a mark

typedef struct {
    int64_t sequence;       ///< the sender's count
    int64_t t_ns;           ///< host time of sending
    int64_t sender;
    int kind;               ///< ipe_command_kind_t, or any other number: not known here
    const char* text;       ///< terminated; a view into the message
    const uint8_t* config;  ///< n_config bytes; a view into the message
    size_t n_config;
} ipe_command_t;

/// A payload that is announced, expectation_t.lcm.
typedef struct {
    int64_t t_ns;                          ///< of the contact, by the sender's clock
    double
        number[IPE_ANNOUNCEMENT_NUMBERS];  ///< the others in their order, as in ipe_announcement_init(): kg, m, kg m2
} ipe_expectation_t;

/// Read the expectation_t in an EXPECT. 0, or -1: of another version, or cut. No state.
int ipe_command_expectation(const ipe_command_t* command, ipe_expectation_t* expectation);

/// Host time of the contact: as long after sending as the sender says, whose clock may have been set since. sent_ns: host time
/// of sending. 0, or -1: one of the times is no host time, *t_ns not written. No state.
int ipe_command_contact(const ipe_command_t* command, const ipe_expectation_t* expectation, int64_t sent_ns,
                        int64_t* t_ns);

/// Read a command_t of n bytes. 0, or -1: of another version, or cut. No state.
int ipe_command_decode(const uint8_t* data, size_t n, ipe_command_t* command);

#endif
