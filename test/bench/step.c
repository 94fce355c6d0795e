// SPDX-License-Identifier: Apache-2.0
/// Time of the core per sample, on a recorded run held in memory:  step robot.cfg can.log tracker.csv
///
/// Stages are timed one by one over the whole run, each on what the one before made of it, best of several passes; the
/// filter's share is what the whole pipeline needs beyond them.
#include "config_file.h"
#include "pipeline.h"
#include "replay.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { PASSES = 15 };

typedef struct {
    bool is_frame;
    ipe_frame_t frame;
    ipe_position_t position;
} item_t;

typedef struct {
    ipe_sensor_t sensor;
    ipe_reading_t reading;
} arrival_t;

static ipe_config_t config;
static item_t* item;
static size_t n_items, n_frames;
static arrival_t* arrival;
static size_t n_arrivals;
static ipe_row_t* row;
static size_t n_rows;
static ipe_motion_t* motion;
static ipe_wrench_t* wrench;
static ipe_pipeline_t pipeline;

static double now(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void* grown(void* array, size_t n, size_t size)
{
    if (n & (n - 1)) { return array; }
    void* larger = realloc(array, (n ? 2 * n : 1) * size);
    if (larger == NULL) { abort(); }
    return larger;
}

static void fail(const char* message)
{
    (void)fprintf(stderr, "step: %s\n", message);
    exit(2);
}

static void load(char** path)
{
    static ipe_replay_t replay;
    char message[512];
    ipe_replay_item_t next;
    if (ipe_config_load(path[1], &config, message, sizeof message) != IPE_OK) { fail(message); }
    if (ipe_source_file_open(&replay.bus[0], path[2], 0, NULL) != 0) { fail(path[2]); }
    if (ipe_source_tracker_file_open(&replay.tracker, path[3], -1, message, sizeof message) != 0) { fail(message); }
    replay.n_buses = 1;
    replay.has_tracker = true;
    for (ipe_replay_status_t s; (s = ipe_replay_next(&replay, &next)) != IPE_REPLAY_END;) {
        if (s == IPE_REPLAY_WAIT) {
            ipe_replay_fill(&replay);
            continue;
        }
        item = grown(item, n_items, sizeof *item);
        item[n_items].is_frame = s == IPE_REPLAY_FRAME;
        if (item[n_items].is_frame) {
            item[n_items].frame = *next.frame;
        } else {
            item[n_items].position = *next.position;
        }
        n_frames += item[n_items++].is_frame;
    }
    ipe_replay_close(&replay);
}

static void decode_all(void)
{
    static ipe_decode_t decode;
    ipe_sample_t sample;
    ipe_decode_init(&decode, &config);
    for (size_t i = 0; i < n_items; ++i) {
        if (item[i].is_frame) { (void)ipe_decode_frame(&decode, &item[i].frame, &sample); }
    }
}

/// Decoding again, and grouping.
static void group_all(void)
{
    static ipe_decode_t decode;
    static ipe_sample_assembler_t group[IPE_SENSOR_COUNT];
    ipe_sample_t sample;
    ipe_decode_init(&decode, &config);
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) { ipe_sample_assembler_init(&group[s], (ipe_sensor_t)s, &config); }
    n_arrivals = 0;
    for (size_t i = 0; i < n_items; ++i) {
        if (!item[i].is_frame) {
            arrival[n_arrivals].sensor = IPE_POSITION;
            arrival[n_arrivals].reading.has_device_time = false;
            arrival[n_arrivals].reading.t_ns = item[i].position.t_ns;
            memcpy(arrival[n_arrivals++].reading.value, item[i].position.position, sizeof item[i].position.position);
        } else if (ipe_decode_frame(&decode, &item[i].frame, &sample) == IPE_OK) {
            for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
                arrival[n_arrivals].sensor = (ipe_sensor_t)s;
                n_arrivals += ipe_sample_assembler_push(&group[s], &sample, &arrival[n_arrivals].reading) == IPE_OK;
            }
        }
    }
}

static void align_all(void)
{
    static ipe_align_t align;
    static ipe_clock_t clock_of[IPE_SENSOR_COUNT];
    ipe_align_init(&align, &config);
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        ipe_clock_init(&clock_of[s], ipe_config_wrap(&config, IPE_Q_IMU_TIME + s), IPE_CLOCK_RATE_SPAN);
    }
    n_rows = 0;
    for (size_t i = 0; i < n_arrivals; ++i) {
        const ipe_reading_t* r = &arrival[i].reading;
        const int64_t t_ns =
            r->has_device_time ? ipe_clock_map(&clock_of[arrival[i].sensor], r->device_time, r->t_ns) : r->t_ns;
        (void)ipe_align_push(&align, arrival[i].sensor, t_ns, r->value);
        while (ipe_align_pop(&align, &row[n_rows]) == IPE_OK) { ++n_rows; }
    }
}

static void wrench_all(void)
{
    static ipe_wrench_stage_t stage;
    ipe_wrench_init(&stage, &config);
    for (size_t i = 0; i < n_rows; ++i) { (void)ipe_wrench_from_row(&stage, &row[i], &motion[i], &wrench[i]); }
}

static void window_all(void)
{
    static ipe_window_t window;
    ipe_average_t average;
    ipe_window_init(&window, &config);
    for (size_t i = 0; i < n_rows; ++i) {
        (void)ipe_window_push(&window, row[i].t_ns, &motion[i], &wrench[i], &average);
    }
}

static void take(const item_t* it)
{
    ipe_row_t out;
    if (it->is_frame) {
        (void)ipe_pipeline_push_frame(&pipeline, &it->frame);
    } else {
        (void)ipe_pipeline_push_position(&pipeline, it->position.t_ns, it->position.position);
    }
    while (ipe_pipeline_step(&pipeline, &out, NULL) != IPE_NOT_READY) {}
}

static void init_pipeline(void)
{
    char message[256];
    if (ipe_pipeline_init(&pipeline, &config, message, sizeof message) != IPE_OK) { fail(message); }
}

static void pipeline_all(void)
{
    init_pipeline();
    for (size_t i = 0; i < n_items; ++i) { take(&item[i]); }
}

/// Seconds of the fastest pass.
static double best(void (*pass)(void))
{
    double least = 1e9;
    for (int k = 0; k < PASSES; ++k) {
        const double start = now();
        pass();
        const double took = now() - start;
        least = took < least ? took : least;
    }
    return least;
}

static int ascending(const void* a, const void* b)
{
    const double x = *(const double*)a, y = *(const double*)b;
    return (x > y) - (x < y);
}

/// From a frame's arrival to the end of all it sets off.
static void print_latency(void)
{
    double* took = calloc(n_items, sizeof *took);
    if (took == NULL) { abort(); }
    init_pipeline();
    for (size_t i = 0; i < n_items; ++i) {
        const double start = now();
        take(&item[i]);
        took[i] = now() - start;
    }
    qsort(took, n_items, sizeof *took, ascending);
    const double share[] = {0.5, 0.99, 0.999};
    printf("  per frame or position:");
    for (int i = 0; i < 3; ++i) {
        printf(" p%g %.2f us", 100.0 * share[i], 1e6 * took[(size_t)(share[i] * (double)(n_items - 1))]);
    }
    printf(" (p99.9: one that ends a window and updates the filter)\n");
    free(took);
}

static void print_stage(const char* name, double seconds)
{
    printf("  %-26s %8.3f us\n", name, 1e6 * seconds / (double)n_rows);
}

static void print_sizes(void)
{
    const struct {
        const char* name;
        size_t bytes;
    } size[] = {
        {"config", sizeof pipeline.config},
        {"decode", sizeof pipeline.decode},
        {"assembler", sizeof pipeline.sample_assembler},
        {"clock", sizeof pipeline.clock},
        {"align", sizeof pipeline.align},
        {"wrench", sizeof pipeline.wrench},
        {"window", sizeof pipeline.window},
        {"estimator", sizeof pipeline.estimator},
    };
    printf("  state %zu B:", sizeof pipeline);
    for (size_t i = 0; i < sizeof size / sizeof size[0]; ++i) { printf(" %s %zu", size[i].name, size[i].bytes); }
    printf("\n");
}

int main(int argc, char** argv)
{
    if (argc != 4) { fail("usage: step robot.cfg can.log tracker.csv"); }
    load(argv);
    arrival = calloc(n_items + IPE_SENSOR_COUNT, sizeof *arrival);
    row = calloc(n_items, sizeof *row);
    motion = calloc(n_items, sizeof *motion);
    wrench = calloc(n_items, sizeof *wrench);
    if (arrival == NULL || row == NULL || motion == NULL || wrench == NULL) { abort(); }
    const double decode = best(decode_all), grouped = best(group_all), aligned = best(align_all);
    const double wrenches = best(wrench_all), windows = best(window_all), whole = best(pipeline_all);
    const double filter = whole - grouped - aligned - wrenches - windows;
    printf("Core, %d cables, %zu frames, %zu samples, %d filter states, one core; time per sample:\n", config.n_cables,
           n_frames, n_rows, pipeline.estimator.rls.n);
    print_stage("decode", decode);
    print_stage("group", grouped - decode);
    print_stage("clock, align", aligned);
    print_stage("wrench", wrenches);
    print_stage("window", windows);
    print_stage("equations, filter", filter);
    printf("  %-26s %8.3f us   (%.1f us per window of %g s)\n", "decode to estimate", 1e6 * whole / (double)n_rows,
           1e6 * filter / (double)pipeline.window.n_windows, pipeline.window.length);
    print_latency();
    print_sizes();
    return 0;
}
