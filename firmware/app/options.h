// SPDX-License-Identifier: Apache-2.0
/// Command line, as given. Addresses and files are checked when they are opened.
#ifndef IPE_OPTIONS_H
#define IPE_OPTIONS_H

#include "inbox.h"
#include "types.h"

#include <stdbool.h>

enum { REASON_SIZE = 512 };  ///< bytes of one line of an error message

typedef struct {
    const char* config;
    const char* estimate;
    const char* lcm;
    const char* lcm_prefix;
    const char* record;
    const char* checkpoint;
    ipe_inbox_origin_t commands;  ///< from whom COMMAND is taken
    int priority;                 ///< 0: not real time
    int cpu;                      ///< -1: any
    double collect;               ///< s
    bool is_verbose;
    bool is_lock_step;            ///< a simulator on stdin and stdout instead of buses, tracker and LCM
    char* tracker;
    char* bus[IPE_BUSES_MAX];
    unsigned n_buses;
} options_t;

typedef enum {
    OPTIONS_RUN = 0,
    OPTIONS_PRINTED = 1,  ///< help or version; the program is to end
    OPTIONS_BAD = -1,     ///< the reason was printed
} options_result_t;

/// Read the arguments, which are kept by pointer.
options_result_t options_read(options_t* o, int argc, char** argv);

#endif
