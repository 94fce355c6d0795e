// SPDX-License-Identifier: Apache-2.0
// A checkpoint of a pipeline that has learnt. First byte: 0 patched with the right CRC, 1 patched, 2 cut at the place
// that follows, 3 the rest of the input as the file. One that is loaded must run on.
//
// A place is a field and a byte in it, i16, negative ones from the field's end. An input names a field by the lower
// half of the CRC-32 of its name in FIELDS: what is in the corpus means the same field in any layout of the state.
// seeds.py reads the names here. A patch is a place and the 8 bytes that stand there from then on, to the field's end.
#define _GNU_SOURCE  // memfd_create
#include "checkpoint.h"
#include "config_file.h"
#include "motion.h"
#include "text_file.h"

enum { WARM = 1500, MORE = 300, FILE_BYTES = sizeof(ipe_checkpoint_state_t) + IPE_CONFIG_CRC_BYTES };

typedef struct {
    const char* name;
    size_t at, size;
} field_t;

#define FIELD(path) {#path, offsetof(ipe_checkpoint_state_t, path), sizeof((ipe_checkpoint_state_t*)NULL)->path}
/// All of the state, in its order.
static const field_t FIELDS[] = {
    FIELD(magic),
    FIELD(version),
    FIELD(size),
    FIELD(fingerprint),
    FIELD(estimator.filter_states.layout.n),
    FIELD(estimator.filter_states.layout.first),
    FIELD(estimator.filter_states.layout.count),
    FIELD(estimator.filter_states.has_patterns),
    FIELD(estimator.filter_states.pattern),
    FIELD(estimator.filter_states.std),
    FIELD(estimator.filter_states.gain_basis),
    FIELD(estimator.filter_states.t_ns),
    FIELD(estimator.filter_states.drifted_ns),
    FIELD(estimator.rls.n),
    FIELD(estimator.rls.x),
    FIELD(estimator.rls.D),
    FIELD(estimator.rls.U),
    FIELD(estimator.rls.n_updates),
    FIELD(estimator.rls.n_nonfinite),
    FIELD(estimator.noise.prior),
    FIELD(estimator.noise.factor),
    FIELD(estimator.noise.sum),
    FIELD(estimator.noise.n_summed),
    FIELD(estimator.noise.past),
    FIELD(estimator.noise.n_past),
    FIELD(estimator.noise.L),
    FIELD(estimator.eiv_correction.sum),
    FIELD(estimator.eiv_correction.n),
    FIELD(estimator.change_detector.level),
    FIELD(estimator.change_detector.n_level),
    FIELD(estimator.change_detector.cusum),
    FIELD(estimator.change_detector.n_contest),
    FIELD(estimator.change_detector.n_restless),
    FIELD(estimator.change_detector.n_calm),
    FIELD(estimator.change_detector.n_steps),
    FIELD(estimator.change_detector.n_since_change),
    FIELD(estimator.change_detector.contest_square),
    FIELD(estimator.change_detector.step.information),
    FIELD(estimator.change_detector.step.projected),
    FIELD(estimator.change_detector.step.square),
    FIELD(estimator.change_detector.step.n_windows),
    FIELD(estimator.change_detector.n_held),
    FIELD(estimator.change_detector.n_misfit),
    FIELD(estimator.change_detector.n_changes),
    FIELD(estimator.change_detector.n_rejected),
    FIELD(estimator.pose_dwell.p),
    FIELD(estimator.pose_dwell.R),
    FIELD(estimator.pose_dwell.n_slow),
    FIELD(estimator.misfit_score.before),
    FIELD(estimator.misfit_score.variance_before),
    FIELD(estimator.misfit_score.begin_ns),
    FIELD(estimator.misfit_score.change),
    FIELD(estimator.misfit_score.variance),
    FIELD(estimator.misfit_score.ratio),
    FIELD(estimator.misfit_score.n_blocks),
    FIELD(estimator.force_delay),
    FIELD(estimator.n_delays),
    FIELD(estimator.nis),
    FIELD(estimator.n_excited),
    FIELD(estimator.restored),
    FIELD(estimator.restored_ns),
    FIELD(estimator.n_weighted),
    FIELD(estimator.unknown_force),
    FIELD(estimator.n_unknown_force),
    FIELD(estimator.n_rows),
    FIELD(estimator.n_refused),
    FIELD(estimator.estimate.t_ns),
    FIELD(estimator.estimate.n_windows),
    FIELD(estimator.estimate.n_rows),
    FIELD(estimator.estimate.body),
    FIELD(estimator.estimate.theta),
    FIELD(estimator.estimate.covariance),
    FIELD(estimator.estimate.n_systematic),
    FIELD(estimator.estimate.systematic),
    FIELD(estimator.estimate.systematic_std),
    FIELD(estimator.estimate.observable),
    FIELD(estimator.estimate.consistent),
    FIELD(estimator.estimate.distance),
    FIELD(estimator.estimate.nis),
    FIELD(estimator.estimate.n_changes),
    FIELD(estimator.estimate.unknown_force),
    FIELD(estimator.estimate.sigma_factor),
    FIELD(estimator.estimate.is_provisional),
    FIELD(estimator.estimate.is_misfit),
    FIELD(gyro_bias),
    FIELD(period),
};
enum { N_FIELDS = sizeof FIELDS / sizeof FIELDS[0] };

static uint16_t key[N_FIELDS];  // by which inputs name them
static ipe_checkpoint_t checkpoint;
static ipe_pipeline_t cold, pipeline;
static uint8_t good[FILE_BYTES], file[FILE_BYTES];

/// Between the fields is padding only, and no two have the same key.
static void prepare_fields(void)
{
    size_t end = 0;
    for (unsigned i = 0; i < N_FIELDS; ++i) {
        const field_t* f = &FIELDS[i];
        REQUIRE(f->at >= end && f->at - end < sizeof(uint64_t));
        end = f->at + f->size;
        key[i] = (uint16_t)ipe_config_crc((const uint8_t*)f->name, strlen(f->name));
        for (unsigned k = 0; k < i; ++k) { REQUIRE(key[k] != key[i]); }
    }
    REQUIRE(end == sizeof(ipe_checkpoint_state_t));
}

/// Any number that is no field's key names one, too, so that a fuzzer need not guess them.
static const field_t* take_field(input_t* in)
{
    const uint16_t wanted = take_u16(in);
    for (unsigned i = 0; i < N_FIELDS; ++i) {
        if (key[i] == wanted) { return &FIELDS[i]; }
    }
    return &FIELDS[wanted % N_FIELDS];
}

/// Bytes from the file's start to a place. At most `most` from the field's start.
static size_t take_place(input_t* in, const field_t* f, size_t most)
{
    const int16_t byte = (int16_t)take_u16(in);
    const size_t from_end = f->size - (size_t)-byte % f->size;
    return f->at + (byte < 0 ? from_end % f->size : (size_t)byte % most);
}

static void patch_fields(input_t* in)
{
    while (in->n > 0) {
        uint8_t bytes[8];
        const field_t* f = take_field(in);
        const size_t at = take_place(in, f, f->size), n_left = f->at + f->size - at;
        take(in, bytes, sizeof bytes);
        memcpy(file + at, bytes, sizeof bytes < n_left ? sizeof bytes : n_left);
    }
}

/// The file of a warm pipeline, by the writer itself.
static void prepare(void)
{
    static ipe_pipeline_t warm;
    char path[] = "/tmp/inertiad-XXXXXX", message[256];
    prepare_fields();
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
    if (kind < 2) { patch_fields(&in); }
    if (kind == 0) {
        const uint32_t crc = ipe_config_crc(file, sizeof(ipe_checkpoint_state_t));
        memcpy(file + sizeof(ipe_checkpoint_state_t), &crc, sizeof crc);
    }
    if (kind == 2) {
        const field_t* f = take_field(&in);
        n = take_place(&in, f, sizeof file - f->at);
    }
    if (kind == 3) {
        n = in.n < sizeof file ? in.n : sizeof file;
        take(&in, file, n);
    }
    load(n);
    return 0;
}
