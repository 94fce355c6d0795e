// SPDX-License-Identifier: Apache-2.0
// A checkpoint of a pipeline that has learnt. First byte: 0 patched (fuzz.h) with the right CRC, 1 patched, 2 cut to the u16
// that follows, 3 the rest of the input as the file. One that is loaded must run on.
#define _GNU_SOURCE  // memfd_create
#include "checkpoint.h"
#include "config_file.h"
#include "motion.h"
#include "text_file.h"

enum { WARM = 1500, MORE = 300, FILE_BYTES = sizeof(ipe_checkpoint_state_t) + IPE_CONFIG_CRC_BYTES };

static ipe_checkpoint_t checkpoint;
static ipe_pipeline_t cold, pipeline;
static uint8_t good[FILE_BYTES], file[FILE_BYTES];

/// The file of a warm pipeline, by the writer itself.
static void prepare(void)
{
    static ipe_pipeline_t warm;
    char path[] = "/tmp/inertiad-XXXXXX", message[256];
    motion_prepare();
    motion_warm(&cold, 0);
    motion_warm(&warm, WARM);
    const int fd = mkstemp(path);
    REQUIRE(fd >= 0 && close(fd) == 0);
    REQUIRE(ipe_checkpoint_open(&checkpoint, path, (const uint8_t*)"robot", 5, message, sizeof message) == 0);
    REQUIRE(ipe_checkpoint_close(&checkpoint, &warm) == 0);
    FILE* written = fopen(path, "rb");
    REQUIRE(written != NULL && fread(good, 1, sizeof good, written) == sizeof good);
    (void)fclose(written);
    (void)unlink(path);
}

static void load(size_t n)
{
    char message[256] = "";
    checkpoint.path = text_file(file, n);
    pipeline = cold;
    const int result = ipe_checkpoint_load(&checkpoint, &pipeline, message, sizeof message);
    if (result != 1) {
        REQUIRE(result == -1 && strlen(message) > 0 && memcmp(&pipeline, &cold, sizeof cold) == 0);
        return;
    }
    REQUIRE(n == sizeof file);
    for (unsigned k = 0; k < MORE; ++k) {
        motion_push(&pipeline, &motion[k], k, 2 * MOTION_BEGIN_NS + (WARM + k) * MOTION_STEP_NS);
        motion_step(&pipeline);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    static bool is_prepared;
    input_t in = {data, size};
    if (!is_prepared) { prepare(); }
    is_prepared = true;
    const int kind = take_u8(&in) % 4;
    memcpy(file, good, sizeof file);
    size_t n = sizeof file;
    if (kind < 2) { patch(&in, file, sizeof(ipe_checkpoint_state_t)); }
    if (kind == 0) {
        const uint32_t crc = ipe_config_crc(file, sizeof(ipe_checkpoint_state_t));
        memcpy(file + sizeof(ipe_checkpoint_state_t), &crc, sizeof crc);
    }
    if (kind == 2) { n = take_u16(&in) % sizeof file; }
    if (kind == 3) {
        n = in.n < sizeof file ? in.n : sizeof file;
        take(&in, file, n);
    }
    load(n);
    return 0;
}
