// SPDX-License-Identifier: Apache-2.0
/// Addresses of sources: scheme:path?key=value&key=value, as in "file:can.log?speed=1" and "socketcan:can0?filter=off".
#ifndef IPE_URL_H
#define IPE_URL_H

#include <stdbool.h>
#include <stddef.h>

enum { IPE_URL_OPTIONS_MAX = 4 };

/// Views into text, which ipe_url_parse() cut into pieces in place.
typedef struct {
    const char* scheme;
    const char* path;
    unsigned n_options;
    struct {
        const char* key;
        const char* value;
    } option[IPE_URL_OPTIONS_MAX];
} ipe_url_t;

/// Cut text into its parts. The first '?' begins the options, so a name cannot hold one.
///
///   text     in/out  terminated at each part; must outlive url
///   schemes  in      allowed schemes, separated by spaces
///   keys     in      allowed keys, separated by spaces
///   message  out     one line on failure; size bytes, always terminated
///
/// True when good. No state.
bool ipe_url_parse(ipe_url_t* url, char* text, const char* schemes, const char* keys, char* message, size_t size);

/// Value of an option, NULL when it is not given.
const char* ipe_url_option(const ipe_url_t* url, const char* key);

#endif
