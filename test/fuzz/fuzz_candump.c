// SPDX-License-Identifier: Apache-2.0
// A candump log: each line alone, the whole as a file, and as what a simulator sends in lock-step.
#define _GNU_SOURCE  // memfd_create
#include "candump.h"
#include "lock_step.h"
#include "source_file.h"
#include "text_file.h"

static ipe_source_file_t source;
static ipe_lock_step_t lock_step;

static void check_frame(const ipe_frame_t* f)
{
    REQUIRE(f->length <= IPE_DATA_MAX && f->t_ns >= 0 && f->t_ns / 1000000000 <= IPE_SECONDS_MAX);
    REQUIRE((f->flags & IPE_FRAME_FD) != 0 || f->length <= 8);
    for (int i = f->length; i < IPE_DATA_MAX; ++i) { REQUIRE(f->data[i] == 0); }
}

static void read_line(const char* line, size_t n)
{
    ipe_frame_t frame = {0};
    ipe_candump_name_t name;
    uint64_t n_dropped;
    const ipe_candump_t result = ipe_candump_parse(line, n, &frame, &name, &n_dropped);
    REQUIRE(result < IPE_CANDUMP_COUNT);
    if (result != IPE_CANDUMP_FRAME) { return; }
    check_frame(&frame);
    REQUIRE(name.text >= line && name.text + name.length <= line + n && name.length >= 1 && name.length <= 15);
}

static void read_file(const char* path, const char* interface)
{
    ipe_source_status_t status;
    REQUIRE(ipe_source_file_open(&source, path, 0, interface) == 0);
    source.limit.n = UINT32_MAX / 2;  // silent
    while ((status = ipe_source_file_peek(&source)) != IPE_SOURCE_END) {
        if (status == IPE_SOURCE_WAIT) {
            ipe_source_file_fill(&source);
            continue;
        }
        check_frame(&source.head);
        ipe_source_file_take(&source);
    }
    ipe_source_file_close(&source);
}

static void read_lock_step(const char* path)
{
    ipe_lock_step_item_t item;
    ipe_expectation_t expectation;
    lock_step = (ipe_lock_step_t){.limit = {.n = UINT32_MAX / 2}};
    REQUIRE(ipe_lines_open(&lock_step.lines, path) == 0);
    while ((item = ipe_lock_step_next(&lock_step)) != IPE_LOCK_STEP_END) {
        if (item == IPE_LOCK_STEP_WAIT) { ipe_lock_step_fill(&lock_step); }
        if (item == IPE_LOCK_STEP_FRAME) { REQUIRE(lock_step.frame.bus < IPE_BUSES_MAX); }
        if (item != IPE_LOCK_STEP_COMMAND) { continue; }
        const ipe_command_t* c = &lock_step.command;
        REQUIRE(c->config >= lock_step.message && c->config + c->n_config <= lock_step.message + lock_step.n_message);
        (void)ipe_command_expectation(c, &expectation);
    }
    ipe_lines_close(&lock_step.lines);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    const char* text = (const char*)data;
    for (size_t begin = 0; begin < size;) {
        const char* newline = memchr(text + begin, '\n', size - begin);
        const size_t n = newline != NULL ? (size_t)(newline - text) - begin : size - begin;
        read_line(text + begin, n);
        begin += n + 1;
    }
    const char* path = text_file(data, size);
    read_file(path, NULL);
    read_file(path, "can0");
    read_lock_step(path);
    return 0;
}
