// SPDX-License-Identifier: Apache-2.0
// Addresses: of buses and trackers (first byte even) and of LCM (odd).
#include "fuzz.h"
#include "inbox.h"
#include "url.h"

static const char SCHEMES[] = "file socketcan", KEYS[] = "speed filter interface a b";

static bool is_inside(const char* part, const char* text, size_t n)
{
    return part >= text && part <= text + n;
}

static void parse(char* text, size_t n)
{
    ipe_url_t url;
    char message[300] = "";
    if (!ipe_url_parse(&url, text, SCHEMES, KEYS, message, sizeof message)) {
        REQUIRE(strlen(message) > 0);
        return;
    }
    REQUIRE(is_inside(url.scheme, text, n) && is_inside(url.path, text, n) && url.path[0] != '\0');
    REQUIRE(url.n_options <= IPE_URL_OPTIONS_MAX);
    for (unsigned i = 0; i < url.n_options; ++i) {
        REQUIRE(is_inside(url.option[i].key, text, n) && is_inside(url.option[i].value, text, n));
        REQUIRE(ipe_url_option(&url, url.option[i].key) != NULL);
    }
    REQUIRE(ipe_url_option(&url, "none of them") == NULL);
}

static void parse_group(const char* text)
{
    struct sockaddr_in group;
    char message[300] = "";
    if (!ipe_inbox_is_network(text)) { return; }
    if (ipe_inbox_read_url(text, &group, message, sizeof message) != 0) {
        REQUIRE(strlen(message) > 0);
    } else {
        REQUIRE(group.sin_family == AF_INET && group.sin_port != 0);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    if (size == 0) { return 0; }
    char* text = malloc(size);
    REQUIRE(text != NULL);
    memcpy(text, data + 1, size - 1);
    text[size - 1] = '\0';
    if (data[0] % 2 == 0) {
        parse(text, size);
    } else {
        parse_group(text);
    }
    free(text);
    return 0;
}
