// SPDX-License-Identifier: Apache-2.0
/// What the fuzz targets share. Each target is a file fuzz_NAME.c with this one function; libFuzzer calls it with what it
/// makes up, replay.c with the files of corpus/NAME.
#ifndef TEST_FUZZ_H
#define TEST_FUZZ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

/// What must hold for every input; a crash where it does not.
#define REQUIRE(condition)                                                                       \
    do {                                                                                         \
        if (!(condition)) {                                                                      \
            (void)fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition); \
            abort();                                                                             \
        }                                                                                        \
    } while (0)

/// The rest of an input.
typedef struct {
    const uint8_t* at;
    size_t n;
} input_t;

/// The next bytes into a value; zeros past the end.
static inline void take(input_t* in, void* to, size_t n)
{
    const size_t n_there = n < in->n ? n : in->n;
    memset(to, 0, n);
    if (n_there == 0) { return; }
    memcpy(to, in->at, n_there);
    in->at += n_there;
    in->n -= n_there;
}

static inline uint8_t take_u8(input_t* in)
{
    uint8_t value;
    take(in, &value, sizeof value);
    return value;
}

static inline uint16_t take_u16(input_t* in)
{
    uint16_t value;
    take(in, &value, sizeof value);
    return value;
}

static inline double take_double(input_t* in)
{
    double value;
    take(in, &value, sizeof value);
    return value;
}

/// Change bytes of a file of n bytes: the input is places, u16, each with the 8 bytes that stand there from then on. A whole
/// file of many kB would be too much for a fuzzer to find a field in.
static inline void patch(input_t* in, uint8_t* file, size_t n)
{
    while (in->n > 0) {
        uint8_t bytes[8];
        const size_t at = take_u16(in) % n;
        take(in, bytes, sizeof bytes);
        memcpy(file + at, bytes, sizeof bytes < n - at ? sizeof bytes : n - at);
    }
}

#endif
