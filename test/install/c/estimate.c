// SPDX-License-Identifier: Apache-2.0
/// A C program on the installed library: a recorded run through the core.   estimate robot.cfg can.log tracker.csv
/// Prints the ten parameters theta of the last estimate, about P, as C99 hexadecimal numbers.
#include <inertiad/candump.h>
#include <inertiad/config_file.h>
#include <inertiad/pipeline.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static ipe_config_t config;
static ipe_pipeline_t pipeline;
static ipe_estimate_t newest;

static void step_all(void)
{
    ipe_row_t row;
    while (ipe_pipeline_step(&pipeline, &row, &newest) != IPE_NOT_READY) {}
}

/// The next position of the tracker's file; false at its end.
static bool next_position(FILE* file, int64_t* t_ns, double position[3])
{
    double t;
    if (fscanf(file, "%lf,%lf,%lf,%lf", &t, &position[0], &position[1], &position[2]) != 4) { return false; }
    *t_ns = (int64_t)llround(1e9 * t);
    return true;
}

int main(int argc, char** argv)
{
    char message[512] = "usage: estimate robot.cfg can.log tracker.csv";
    if (argc != 4 || ipe_config_load(argv[1], &config, message, sizeof message) != IPE_OK ||
        ipe_pipeline_init(&pipeline, &config, message, sizeof message) != IPE_OK) {
        fprintf(stderr, "estimate: %s\n", message);
        return 2;
    }
    FILE* log = fopen(argv[2], "r");
    FILE* tracker = fopen(argv[3], "r");
    char line[256];
    if (log == NULL || tracker == NULL || fgets(line, sizeof line, tracker) == NULL) {
        perror("estimate");
        return 2;
    }
    int64_t t_ns;
    double position[3];
    bool is_tracked = next_position(tracker, &t_ns, position);
    while (fgets(line, sizeof line, log) != NULL) {
        ipe_frame_t frame = {0};
        ipe_candump_name_t name;
        uint64_t n_dropped;
        if (ipe_candump_parse(line, strcspn(line, "\r\n"), &frame, &name, &n_dropped) != IPE_CANDUMP_FRAME) {
            continue;
        }
        for (; is_tracked && t_ns <= frame.t_ns; is_tracked = next_position(tracker, &t_ns, position)) {
            (void)ipe_pipeline_push_position(&pipeline, t_ns, position);
        }
        (void)ipe_pipeline_push_frame(&pipeline, &frame);
        step_all();
    }
    ipe_pipeline_flush(&pipeline);
    step_all();
    for (int i = 0; i < IPE_NP; ++i) { printf("%a\n", newest.theta[i]); }
    return 0;
}
