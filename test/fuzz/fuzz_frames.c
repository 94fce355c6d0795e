// SPDX-License-Identifier: Apache-2.0
// Frames and positions through the whole pipeline. First byte: begin cold or warm, with the unit tests' robot or with one
// of small multiplexed integers. Then steps, each a byte and its arguments (step()).
#include "fuzz.h"
#include "motion.h"

#include <math.h>

enum { WARM = 1000, N_IDS = 8, SAMPLES_MAX = 800, ROBOTS = 2, EXPECT = 0xF0 };

static ipe_pipeline_t start[2 * ROBOTS], pipeline;

typedef struct {
    int64_t t_ns;
    unsigned number;     // of the next sample
    unsigned n_samples;  // pushed by this input
} state_t;

/// Integers of either byte order in frames of 8 bytes, some behind a multiplexer.
static void bind_narrow_signals(ipe_config_t* k)
{
    k->n_signals = 0;
    for (int i = 0; i < 24; ++i) {
        const int quantity = i < 10   ? IPE_Q_ACC_X + i
                             : i < 18 ? IPE_Q_F_1 + i - 10
                             : i < 21 ? IPE_Q_POS_X + i - 18
                                      : 14 + i;
        ipe_signal_t* s = &k->signal[k->n_signals++];
        *s = (ipe_signal_t){.quantity = quantity, .can_id = (uint32_t)(i / 3), .frame_length = 8};
        s->start = 8 + 16 * (i % 3);
        s->length = 16;
        s->big_endian = i % 2 != 0;
        s->start += s->big_endian ? 7 : 0;
        s->is_signed = quantity < IPE_Q_IMU_COUNTER;
        s->scale = 1e-3;
        s->mux_start = i < 6 ? 0 : -1;
        s->mux_length = 2;
        s->mux_value = i < 3 ? 1 : 2;
    }
    k->position_source = IPE_POSITION_CAN;
    k->attitude_estimate = IPE_ATTITUDE_FUSED;
    k->max_carry = 1.0;
}

static void prepare(void)
{
    motion_prepare();
    motion_warm(&start[0], 0);
    motion_warm(&start[1], WARM);
    bind_narrow_signals(&motion_config);
    motion_warm(&start[2], 0);
    motion_config = cogiro();
    motion_config.attitude_estimate = IPE_ATTITUDE_FUSED;
    motion_config.std_force_delay = 0.01;
    motion_config.std_friction = 0.05;
    motion_config.max_carry = 1.0;
    motion_warm(&start[3], WARM);
}

static void push_raw_frame(state_t* s, input_t* in)
{
    static const uint32_t ID[N_IDS] = {ID_IMU_A, ID_IMU_B, ID_FORCE, 0, 1, 2, 3, IPE_CAN_EFF | 0x123};
    const uint8_t which = take_u8(in), length = take_u8(in);
    ipe_frame_t f = {.can_id = ID[which % N_IDS], .length = length % (IPE_DATA_MAX + 1)};
    f.can_id |= (which & 0x40U) != 0 ? IPE_CAN_RTR : 0;
    f.can_id |= (which & 0x80U) != 0 ? IPE_CAN_ERR : 0;
    f.bus = (length & 0x80U) != 0 ? 1 : 0;
    f.flags = f.length > 8 ? IPE_FRAME_FD : 0;
    s->t_ns += (int64_t)take_u16(in) * 1000;
    f.t_ns = s->t_ns;
    take(in, f.data, f.length);
    (void)ipe_pipeline_push_frame(&pipeline, &f);
}

/// Good samples; patched: with one value of each of them replaced.
static void push_samples(state_t* s, input_t* in, bool is_patched)
{
    const unsigned n = is_patched ? take_u8(in) % 16U : take_u8(in) * 4U;
    const uint8_t which = is_patched ? take_u8(in) : 0;
    const double value = is_patched ? take_double(in) : 0.0;
    for (unsigned i = 0; i < n && s->n_samples < SAMPLES_MAX; ++i, ++s->n_samples, ++s->number) {
        ideal_t x = motion[s->number % MOTION_SAMPLES];
        if (is_patched) {
            memcpy((uint8_t*)&x + which % (sizeof x / sizeof value) * sizeof value, &value, sizeof value);
        }
        s->t_ns += MOTION_STEP_NS;
        motion_push(&pipeline, &x, s->number, s->t_ns);
        motion_step(&pipeline);
    }
}

static void push_position(state_t* s, input_t* in)
{
    double position[3];
    const int64_t t_ns = s->t_ns + (int16_t)take_u16(in) * INT64_C(100000);
    take(in, position, sizeof position);
    (void)ipe_pipeline_push_position(&pipeline, t_ns, position);
}

static void jump(state_t* s, input_t* in)
{
    int64_t t_ns;
    take(in, &t_ns, sizeof t_ns);
    s->t_ns = t_ns;
    if (s->t_ns < 0 || s->t_ns > IPE_TIME_MAX_NS) {
        const ipe_frame_t f = {.t_ns = t_ns, .can_id = ID_IMU_B, .length = LENGTH_IMU_B};
        REQUIRE(ipe_pipeline_push_frame(&pipeline, &f) == IPE_ERR_TIME);
        s->t_ns = MOTION_BEGIN_NS;
    }
}

/// A payload of 30 kg within 3 s, one of its numbers replaced.
static void expect(const state_t* s, input_t* in)
{
    static ipe_announcement_t announcement;
    double number[IPE_ANNOUNCEMENT_NUMBERS] = {30.0, 1.0, 0.1, 0.2, 0.3, 0.01, 0.01, 0.01, 1.0, 1.0, 1.0};
    char message[256];
    const uint8_t which = take_u8(in);
    const int64_t from_ns = s->t_ns + (int64_t)take_u16(in) % 3000 * INT64_C(1000000);
    if (which < IPE_ANNOUNCEMENT_NUMBERS) { number[which] = take_double(in); }
    (void)ipe_pipeline_expect(&pipeline, &announcement, number, from_ns, message, sizeof message);
}

static void command(const state_t* s, input_t* in)
{
    const double bias[3] = {0.01, -0.01, 0.0};
    const uint8_t which = take_u8(in);
    if (which >= EXPECT) {
        expect(s, in);
        return;
    }
    switch (which % 6) {
    case 0: ipe_pipeline_freeze(&pipeline, true); break;
    case 1: ipe_pipeline_freeze(&pipeline, false); break;
    case 2: ipe_pipeline_reset(&pipeline); break;
    case 3: ipe_pipeline_set_gyro_bias(&pipeline, bias); break;
    case 4: ipe_pipeline_continue(&pipeline, &pipeline.estimator, bias); break;
    default: ipe_pipeline_flush(&pipeline); break;
    }
}

static void step(state_t* s, input_t* in)
{
    switch (take_u8(in) % 7) {
    case 0: push_raw_frame(s, in); break;
    case 1: push_position(s, in); break;
    case 2: push_samples(s, in, false); break;
    case 3: push_samples(s, in, true); break;
    case 4: jump(s, in); break;
    case 5: s->t_ns += (int16_t)take_u16(in) * INT64_C(10000); break;
    default: command(s, in); break;
    }
    if (s->t_ns > IPE_TIME_MAX_NS - (MOTION_STEP_NS * SAMPLES_MAX)) { s->t_ns = MOTION_BEGIN_NS; }
    motion_step(&pipeline);
}

static void check_estimate(const ipe_estimate_t* e)
{
    if (e->n_windows == 0) { return; }
    REQUIRE(isfinite(e->body.mass) && isfinite(e->body.mass_std));
    for (int i = 0; i < 3; ++i) { REQUIRE(isfinite(e->body.cog[i])); }
    for (int i = 0; i < 6; ++i) { REQUIRE(isfinite(e->body.inertia_cog[i])); }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    static bool is_prepared;
    input_t in = {data, size};
    if (!is_prepared) { prepare(); }
    is_prepared = true;
    pipeline = start[take_u8(&in) % (sizeof start / sizeof start[0])];
    state_t s = {.t_ns = MOTION_BEGIN_NS + WARM * MOTION_STEP_NS, .number = WARM};
    while (in.n > 0) { step(&s, &in); }
    ipe_pipeline_flush(&pipeline);
    motion_step(&pipeline);
    REQUIRE(ipe_pipeline_invariants_hold(&pipeline));
    check_estimate(&pipeline.estimator.estimate);
    return 0;
}
