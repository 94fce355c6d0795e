// SPDX-License-Identifier: Apache-2.0
// A compiled configuration: CoGiRo's, patched (fuzz.h) and with the right CRC; or, where the first byte is 255, the rest of
// the input as the file, once as it is and once with version and CRC put right. What is accepted must run.
#include "config_file.h"
#include "fuzz.h"
#include "pipeline.h"
#include "robot.h"
#include "wire.h"

enum { AS_IT_IS = 255, N_SAMPLES = 8 };

static ipe_config_t config;
static ipe_pipeline_t pipeline;

/// Frames of every signal, with other bytes each.
static void run(const ipe_config_t* k)
{
    char message[256];
    ipe_row_t row;
    if (ipe_pipeline_init(&pipeline, k, message, sizeof message) != IPE_OK) { return; }
    for (int n = 0; n < N_SAMPLES; ++n) {
        const double position[3] = {0.0, 0.0, 2.0};
        const int64_t t_ns = 1000000000 + n * INT64_C(2000000);
        for (int i = 0; i < k->n_signals; ++i) {
            const ipe_signal_t* s = &k->signal[i];
            ipe_frame_t f = {
                .t_ns = t_ns, .can_id = s->can_id, .bus = (uint8_t)s->bus, .length = (uint8_t)s->frame_length};
            f.flags = s->frame_length > 8 ? IPE_FRAME_FD : 0;
            memset(f.data, 17 * n, f.length);
            (void)ipe_pipeline_push_frame(&pipeline, &f);
        }
        (void)ipe_pipeline_push_position(&pipeline, t_ns, position);
        while (ipe_pipeline_step(&pipeline, &row, NULL) != IPE_NOT_READY) {}
    }
    ipe_pipeline_flush(&pipeline);
    while (ipe_pipeline_step(&pipeline, &row, NULL) != IPE_NOT_READY) {}
    REQUIRE(ipe_pipeline_invariants_hold(&pipeline));
}

/// True if it was accepted.
static bool load(const uint8_t* bytes, size_t n)
{
    char message[512] = "";
    memset(&config, 0, sizeof config);
    if (ipe_config_from_bytes(bytes, n, &config, message, sizeof message) != IPE_OK) {
        REQUIRE(strlen(message) > 0 && strlen(message) < sizeof message);
        return false;
    }
    REQUIRE(config.n_cables >= 1 && config.n_cables <= IPE_CABLES_MAX && config.n_signals <= IPE_SIGNALS_MAX);
    return true;
}

static void load_and_use(uint8_t* bytes, size_t n)
{
    const double bias[3] = {0.1, -0.1, 0.01};
    if (!load(bytes, n)) { return; }
    run(&config);
    REQUIRE(ipe_config_set_gyro_bias(bytes, n, bias) == IPE_OK && load(bytes, n));
    REQUIRE(memcmp(config.gyro_bias, bias, sizeof bias) == 0);
}

/// Version and CRC as a configuration of this version has them.
static void seal(uint8_t* bytes, size_t n)
{
    if (n < WIRE_HASH_BYTES + IPE_CONFIG_CRC_BYTES) { return; }
    wire_put_hash(bytes);
    wire_put_crc(bytes, n);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    static uint8_t base[IPE_CONFIG_FILE_MAX];
    static size_t n_base;
    if (n_base == 0) {
        const ipe_config_t good = cogiro();
        n_base = wire_encode(&good, base);
        REQUIRE(load(base, n_base));
    }
    input_t in = {data, size};
    if (size > 0 && data[0] == AS_IT_IS) {
        const size_t n = size - 1;
        uint8_t* file = malloc(size);
        REQUIRE(file != NULL);
        memcpy(file, data + 1, n);
        (void)load(file, n);
        seal(file, n);
        load_and_use(file, n);
        free(file);
        return 0;
    }
    uint8_t* file = malloc(n_base);
    REQUIRE(file != NULL);
    memcpy(file, base, n_base);
    patch(&in, file, n_base - IPE_CONFIG_CRC_BYTES);
    seal(file, n_base);
    load_and_use(file, n_base);
    free(file);
    return 0;
}
