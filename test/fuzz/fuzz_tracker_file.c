// SPDX-License-Identifier: Apache-2.0
// A tracker's CSV file: the input as it is, and as rows below a good header.
#define _GNU_SOURCE  // memfd_create
#include "source_tracker_file.h"
#include "text_file.h"
#include "types.h"

static const char HEADER[] = "t,x,y,z\n";
static ipe_source_tracker_file_t tracker;

static void read_file(const char* path)
{
    char message[256];
    ipe_source_status_t status;
    tracker = (ipe_source_tracker_file_t){.limit.n = 0};
    if (ipe_source_tracker_file_open(&tracker, path, -1, message, sizeof message) != 0) {
        REQUIRE(strlen(message) > 0);
        ipe_source_tracker_file_close(&tracker);
        return;
    }
    tracker.limit.n = UINT32_MAX / 2;  // silent
    while ((status = ipe_source_tracker_file_peek(&tracker)) != IPE_SOURCE_END) {
        if (status == IPE_SOURCE_WAIT) {
            ipe_source_tracker_file_fill(&tracker);
            continue;
        }
        REQUIRE(tracker.head.t_ns >= 0 && tracker.head.t_ns / 1000000000 <= IPE_SECONDS_MAX);
        ipe_source_tracker_file_take(&tracker);
    }
    ipe_source_tracker_file_close(&tracker);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    char* text = malloc(sizeof HEADER - 1 + size);
    REQUIRE(text != NULL);
    memcpy(text, HEADER, sizeof HEADER - 1);
    if (size > 0) { memcpy(text + sizeof HEADER - 1, data, size); }
    read_file(text_file(data, size));
    read_file(text_file(text, sizeof HEADER - 1 + size));
    free(text);
    return 0;
}
