// SPDX-License-Identifier: Apache-2.0
/// The command line as it was given; what the values mean is found out when they are opened.
#ifndef IPE_OPTIONS_H
#define IPE_OPTIONS_H

#include "types.h"

enum { REASON_SIZE = 512 };  ///< of one line that says what is wrong

typedef struct {
    const char* config;
    const char* estimate;
    const char* lcm;
    const char* lcm_prefix;
    const char* record;
    const char* checkpoint;
    int priority;    ///< 0: not real time
    int cpu;         ///< -1: any
    double collect;  ///< s
    char* tracker;
    char* bus[IPE_BUSES_MAX];
    unsigned n_buses;
} options_t;

/// Read the arguments, which are kept by pointer. 0: go on; 1: help was asked for and given; -1: not usable, said why.
int options_read(options_t* o, int argc, char** argv);

#endif
