// SPDX-License-Identifier: Apache-2.0
/// A recorded run through the core, every estimate as text:  replay robot.cfg can.log tracker.csv
/// No LCM, no system beyond the C library, so that any target that has a compiler and an emulator can run it.
#include "config_file.h"
#include "pipeline.h"
#include "replay.h"

#include <inttypes.h>
#include <stdio.h>

static ipe_config_t config;
static ipe_pipeline_t pipeline;
static ipe_replay_t replay;

static void print_estimate(const ipe_estimate_t* e)
{
    printf("%" PRId64, e->t_ns);
    for (int i = 0; i < IPE_NP; ++i) { printf(" %.17g", e->theta[i]); }
    for (int i = 0; i < IPE_NP; ++i) { printf(" %.17g", e->covariance[i][i]); }
    for (int i = 0; i < e->n_systematic; ++i) { printf(" %.17g", e->systematic[i]); }
    printf("\n");
}

static void step_all(void)
{
    ipe_row_t row;
    ipe_status_t status;
    while ((status = ipe_pipeline_step(&pipeline, &row, NULL)) != IPE_NOT_READY) {
        if (status == IPE_OK) { print_estimate(&pipeline.estimator.estimate); }
    }
}

static void play(void)
{
    ipe_replay_item_t item;
    for (ipe_replay_status_t s; (s = ipe_replay_next(&replay, &item)) != IPE_REPLAY_END;) {
        if (s == IPE_REPLAY_WAIT) {
            ipe_replay_fill(&replay);
        } else if (s == IPE_REPLAY_FRAME) {
            (void)ipe_pipeline_push_frame(&pipeline, item.frame);
        } else {
            (void)ipe_pipeline_push_position(&pipeline, item.position->t_ns, item.position->position);
        }
        step_all();
    }
    ipe_pipeline_flush(&pipeline);
    step_all();
}

int main(int argc, char** argv)
{
    char message[512] = "usage: replay robot.cfg can.log tracker.csv";
    if (argc != 4 || ipe_config_load(argv[1], &config, message, sizeof message) != IPE_OK ||
        ipe_pipeline_init(&pipeline, &config, message, sizeof message) != IPE_OK ||
        ipe_source_tracker_file_open(&replay.tracker, argv[3], -1, message, sizeof message) != 0) {
        (void)fprintf(stderr, "replay: %s\n", message);
        return 2;
    }
    if (ipe_source_file_open(&replay.bus[0], argv[2], 0, NULL) != 0) {
        perror(argv[2]);
        return 2;
    }
    replay.n_buses = 1;
    replay.has_tracker = true;
    play();
    ipe_replay_close(&replay);
    return 0;
}
