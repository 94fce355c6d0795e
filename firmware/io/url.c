// SPDX-License-Identifier: Apache-2.0
#include "url.h"

#include <stdio.h>
#include <string.h>

/// True if word stands in the space-separated list.
static bool is_listed(const char* list, const char* word)
{
    const size_t n = strlen(word);
    if (n == 0 || strchr(word, ' ') != NULL) { return false; }
    for (const char* at = list; (at = strstr(at, word)) != NULL; at += n) {
        const bool begins = at == list || at[-1] == ' ';
        if (begins && (at[n] == ' ' || at[n] == '\0')) { return true; }
    }
    return false;
}

static bool split_option(ipe_url_t* url, char* text, const char* keys, char* message, size_t size)
{
    char* equals = strchr(text, '=');
    if (equals != NULL) { *equals = '\0'; }
    if (equals == NULL || !is_listed(keys, text) || url->n_options == IPE_URL_OPTIONS_MAX) {
        (void)snprintf(message, size, "%s:%s: option \"%s\" is not key=value with key one of: %s", url->scheme,
                       url->path, text, keys);
        return false;
    }
    url->option[url->n_options].key = text;
    url->option[url->n_options].value = equals + 1;
    url->n_options++;
    return true;
}

bool ipe_url_parse(ipe_url_t* url, char* text, const char* schemes, const char* keys, char* message, size_t size)
{
    memset(url, 0, sizeof *url);
    char* rest = text;
    url->scheme = strsep(&rest, ":");
    if (rest == NULL || rest[0] == '\0' || rest[0] == '?' || !is_listed(schemes, url->scheme)) {
        if (rest != NULL) { rest[-1] = ':'; }
        (void)snprintf(message, size, "\"%s\" is not SCHEME:NAME with scheme one of: %s", text, schemes);
        return false;
    }
    char* question = strchr(rest, '?');
    url->path = rest;
    if (question == NULL) { return true; }
    *question = '\0';
    rest = question + 1;
    for (char* option; (option = strsep(&rest, "&")) != NULL;) {
        if (!split_option(url, option, keys, message, size)) { return false; }
    }
    return true;
}

const char* ipe_url_option(const ipe_url_t* url, const char* key)
{
    for (unsigned i = 0; i < url->n_options; ++i) {
        if (strcmp(url->option[i].key, key) == 0) { return url->option[i].value; }
    }
    return NULL;
}
