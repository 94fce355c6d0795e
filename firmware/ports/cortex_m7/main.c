// SPDX-License-Identifier: Apache-2.0
/// The core on a microcontroller: frames come by interrupt through a ring, the main loop steps the pipeline.
///
/// A recorded run stands in for the robot: each frame is laid into the receive FIFO of a controller in memory, and its
/// interrupt is raised. `make m7` compares the estimates bit by bit with those of the same program on a workstation.
#include "board.h"
#include "config_file.h"
#include "fdcan.h"
#include "pipeline.h"

#include <stdbool.h>
#include <string.h>

enum { FRAME = 1, POSITION = 2 };

/// One item of the recorded input, as tools/m7.py writes it.
typedef struct {
    int64_t t_ns;
    uint32_t can_id;
    uint8_t kind, length, flags, spare;
    union {
        uint8_t data[24];
        double position[3];
    } content;
} item_t;

static ipe_config_t config;
static ipe_pipeline_t pipeline;
static ipe_frame_ring_t ring;
static uint8_t config_file[IPE_CONFIG_FILE_MAX];

static volatile uint32_t registers[IPE_FDCAN_REGISTERS];
static volatile uint32_t fifo[4];
static ipe_fdcan_t can = {.registers = registers, .element = fifo, .words = 4};
static volatile int64_t now_ns;

static struct {
    uint32_t n_frames, n_rows, n_estimates, worst;
    uint64_t ticks;
} measured;

void board_interrupt(void)
{
    ipe_fdcan_receive(&can, &ring, now_ns);
}

/// The controller has received a frame of up to 8 bytes with an 11-bit identifier.
static void deliver(const item_t* item)
{
    now_ns = item->t_ns;
    fifo[0] = item->can_id << 18;
    fifo[1] = (uint32_t)item->length << 16;
    for (int i = 0; i < 2; ++i) {
        uint32_t word;
        memcpy(&word, item->content.data + 4 * i, sizeof word);
        fifo[2 + i] = word;
    }
    registers[IPE_FDCAN_RXF0S] = 1;
    registers[IPE_FDCAN_IR] = IPE_FDCAN_RF0N;
    board_raise_interrupt();
    ++measured.n_frames;
}

static void write_hex(uint64_t value)
{
    char text[17];
    for (int i = 0; i < 16; ++i) { text[i] = "0123456789abcdef"[(value >> (60 - 4 * i)) & 0xFU]; }
    text[16] = ' ';
    board_write(text, sizeof text);
}

static void write_bits(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    write_hex(bits);
}

static void write_estimate(const ipe_estimate_t* e)
{
    write_hex((uint64_t)e->t_ns);
    for (int i = 0; i < IPE_NP; ++i) { write_bits(e->theta[i]); }
    for (int i = 0; i < IPE_NP; ++i) { write_bits(e->covariance[i][i]); }
    board_write("\n", 1);
    ++measured.n_estimates;
}

/// One part of a row's work. False: no row is ready. Each call is measured.
static bool step(void)
{
    const uint32_t start = board_ticks();
    ipe_row_t row;
    const ipe_status_t status = ipe_pipeline_step_part(&pipeline, &row, NULL);
    const uint32_t ticks = board_ticks() - start;
    if (status == IPE_NOT_READY) { return false; }
    measured.ticks += ticks;
    measured.worst = ticks > measured.worst ? ticks : measured.worst;
    measured.n_rows += status != IPE_UNFINISHED;
    if (status == IPE_OK) { write_estimate(&pipeline.estimator.estimate); }
    return true;
}

/// Main loop, one turn: frames that the interrupt has left, then one part of the work, so that the ring is soon looked at again.
/// False: no row is ready.
static bool turn(void)
{
    for (const ipe_frame_t* frame; (frame = ipe_frame_ring_oldest(&ring)) != NULL; ipe_frame_ring_drop(&ring)) {
        const uint32_t start = board_ticks();
        (void)ipe_pipeline_push_frame(&pipeline, frame);
        measured.ticks += board_ticks() - start;
    }
    return step();
}

int main(void)
{
    uint32_t size = 0;
    char message[128];
    if (board_read(&size, sizeof size) != sizeof size || size > sizeof config_file ||
        board_read(config_file, size) != size ||
        ipe_config_from_bytes(config_file, size, &config, message, sizeof message) != IPE_OK ||
        ipe_pipeline_init(&pipeline, &config, message, sizeof message) != IPE_OK) {
        board_exit(2);
    }
    board_mark_stack();
    for (item_t item; board_read(&item, sizeof item) == sizeof item; (void)turn()) {
        if (item.kind == FRAME) {
            deliver(&item);
        } else {
            (void)ipe_pipeline_push_position(&pipeline, item.t_ns, item.content.position);
        }
    }
    while (turn()) {}
    ipe_pipeline_flush(&pipeline);
    while (turn()) {}
    const uint64_t result[] = {measured.n_frames, measured.n_rows,    measured.n_estimates, measured.ticks,
                               measured.worst,    board_stack_used(), sizeof pipeline};
    for (size_t i = 0; i < sizeof result / sizeof *result; ++i) { write_hex(result[i]); }
    board_write("\n", 1);
    board_exit(measured.n_estimates > 0 ? 0 : 1);
}
