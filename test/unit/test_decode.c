// SPDX-License-Identifier: Apache-2.0
#include "decode.h"

#include "robot.h"

#include <stdio.h>

static ipe_config_t config;
static ipe_decode_t decode;
static ipe_sample_t sample;

void setUp(void)
{
    memset(&config, 0, sizeof config);
    memset(&decode, 0, sizeof decode);
    memset(&sample, 0, sizeof sample);
}

void tearDown(void)
{
}

static ipe_signal_t* add_signal(int quantity, uint32_t can_id, int start, int length)
{
    ipe_signal_t* s = &config.signal[config.n_signals++];
    *s = (ipe_signal_t){.quantity = quantity,
                        .can_id = can_id,
                        .frame_length = 8,
                        .start = start,
                        .length = length,
                        .scale = 1.0,
                        .mux_start = -1};
    return s;
}

static ipe_frame_t frame_of(uint32_t can_id, const uint8_t* data, int length)
{
    ipe_frame_t f = {.t_ns = 5, .can_id = can_id, .length = (uint8_t)length};
    memcpy(f.data, data, (size_t)length);
    return f;
}

/// The signal bit by bit, as the DBC format numbers bits.
static uint64_t raw_by_bits(const uint8_t* data, int start, int length, bool big_endian, bool is_signed)
{
    uint64_t raw = 0;
    int at = start;
    for (int i = 0; i < length; ++i) {
        const uint64_t bit = data[at / 8] >> (at % 8) & 1;
        if (big_endian) {
            raw = raw << 1 | bit;
            at = at % 8 == 0 ? at + 15 : at - 1;
        } else {
            raw |= bit << i;
            ++at;
        }
    }
    if (is_signed && length < 64 && raw >> (length - 1) & 1U) { raw |= ~0ULL << length; }
    return raw;
}

static void check_every_layout(bool big_endian)
{
    uint64_t seed = 7;
    uint8_t data[72] = {0};  // given: 64 bytes of noise
    for (int i = 0; i < 64; ++i) { data[i] = (uint8_t)(256.0 * uniform(&seed)); }
    for (int start = 0; start < 512; ++start) {
        const int first = big_endian ? start / 8 * 8 + 7 - start % 8 : start;
        for (int length = 1; length <= 64 && first + length <= 512; ++length) {
            for (int is_signed = 0; is_signed < 2; ++is_signed) {                      // when
                const uint64_t raw = ipe_decode_raw(data, start, length, big_endian, is_signed);
                if (raw != raw_by_bits(data, start, length, big_endian, is_signed)) {  // then
                    char layout[64];
                    (void)snprintf(layout, sizeof layout, "start %d length %d signed %d", start, length, is_signed);
                    TEST_FAIL_MESSAGE(layout);
                }
            }
        }
    }
}

static void test_decode_raw_every_intel_layout_matches_bit_by_bit(void)
{
    check_every_layout(false);
}

static void test_decode_raw_every_motorola_layout_matches_bit_by_bit(void)
{
    check_every_layout(true);
}

static void test_decode_raw_known_layouts_give_known_numbers(void)
{
    const uint8_t data[72] = {0x12, 0x34, 0x56, 0x78, 0x9A, 0xBC, 0xDE, 0xF0, 0x81};  // given

    TEST_ASSERT_EQUAL_HEX64(0x1234, ipe_decode_raw(data, 7, 16, true, false));        // when, then
    TEST_ASSERT_EQUAL_HEX64(0x3412, ipe_decode_raw(data, 0, 16, false, false));
    TEST_ASSERT_EQUAL_HEX64(0x234, ipe_decode_raw(data, 3, 12, true, false));
    TEST_ASSERT_EQUAL_HEX64(0x341, ipe_decode_raw(data, 4, 12, false, false));
    TEST_ASSERT_EQUAL_HEX64(0x123456789ABCDEF0, ipe_decode_raw(data, 7, 64, true, false));
    TEST_ASSERT_EQUAL_HEX64(0xF0DEBC9A78563412, ipe_decode_raw(data, 0, 64, false, true));
    TEST_ASSERT_EQUAL_HEX64(0x23456789ABCDEF08, ipe_decode_raw(data, 3, 64, true, false));
    TEST_ASSERT_EQUAL_HEX64(0x1F0DEBC9A7856341, ipe_decode_raw(data, 4, 64, false, false));
    TEST_ASSERT_EQUAL_INT64(-2, (int64_t)ipe_decode_raw((const uint8_t[72]){0xFE}, 0, 8, false, true));
    TEST_ASSERT_EQUAL_INT64(-1, (int64_t)ipe_decode_raw((const uint8_t[72]){0x10}, 4, 1, true, true));
}

static void test_decode_frame_integer_is_scaled_and_signed(void)
{
    ipe_signal_t* s = add_signal(IPE_Q_ACC_X, 0x100, 0, 16);  // given: 0.5 per count, 10 off, and its unsigned twin
    s->is_signed = true, s->scale = 0.5, s->offset = 10.0;
    add_signal(IPE_Q_ACC_X + 1, 0x100, 0, 16);
    ipe_decode_init(&decode, &config);
    const ipe_frame_t f = frame_of(0x100, (const uint8_t[8]){0xFE, 0xFF}, 8);

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_decode_frame(&decode, &f, &sample));  // when

    TEST_ASSERT_EQUAL_INT(2, sample.n);                                     // then
    TEST_ASSERT_EQUAL_INT(IPE_Q_ACC_X, sample.item[0].quantity);
    TEST_ASSERT_EQUAL_DOUBLE(9.0, sample.item[0].value);
    TEST_ASSERT_EQUAL_DOUBLE(65534.0, sample.item[1].value);
    TEST_ASSERT_EQUAL_INT64(5, sample.t_ns);
}

static void test_decode_frame_floats_of_both_orders_are_read(void)
{
    ipe_signal_t* little = add_signal(0, 0x100, 0, 32);  // given: 1.5f Intel and -2.5f Motorola, one frame;
    ipe_signal_t* big = add_signal(1, 0x100, 39, 32);    // 0.1 as float64 in the other, Motorola, and at an
    ipe_signal_t* wide = add_signal(2, 0x101, 7, 64);    // odd start in a third
    ipe_signal_t* odd = add_signal(3, 0x102, 3, 64);
    little->kind = big->kind = IPE_FLOAT32;
    wide->kind = odd->kind = IPE_FLOAT64;
    big->big_endian = wide->big_endian = true;
    odd->frame_length = 12;
    ipe_decode_init(&decode, &config);
    const ipe_frame_t singles = frame_of(0x100, (const uint8_t[]){0, 0, 0xC0, 0x3F, 0xC0, 0x20, 0, 0}, 8);
    const ipe_frame_t one_tenth = frame_of(0x101, (const uint8_t[]){0x3F, 0xB9, 0x99, 0x99, 0x99, 0x99, 0x99, 0x9A}, 8);
    uint8_t shifted[12] = {0};
    const uint64_t bits = 0x3FB999999999999AULL;
    for (int i = 0; i < 64; ++i) { shifted[(i + 3) / 8] |= (uint8_t)((bits >> i & 1U) << ((i + 3) % 8)); }
    const ipe_frame_t at_odd_start = frame_of(0x102, shifted, 12);

    (void)ipe_decode_frame(&decode, &singles, &sample);  // when, then
    TEST_ASSERT_EQUAL_DOUBLE(1.5, sample.item[0].value);
    TEST_ASSERT_EQUAL_DOUBLE(-2.5, sample.item[1].value);
    (void)ipe_decode_frame(&decode, &one_tenth, &sample);
    TEST_ASSERT_EQUAL_DOUBLE(0.1, sample.item[0].value);
    (void)ipe_decode_frame(&decode, &at_odd_start, &sample);
    TEST_ASSERT_EQUAL_DOUBLE(0.1, sample.item[0].value);
}

static void test_decode_frame_nonfinite_floats_are_left_out_and_counted(void)
{
    const uint32_t bits[2] = {0x7FC00000U, 0xFF800000U};  // given: NaN, -Inf and a good value
    uint8_t data[12] = {0};
    memcpy(data, bits, sizeof bits);
    for (int i = 0; i < 3; ++i) {
        ipe_signal_t* s = add_signal(i, 0x100, 32 * i, 32);
        s->kind = IPE_FLOAT32, s->frame_length = 12, s->offset = 4.0;
    }
    ipe_decode_init(&decode, &config);
    const ipe_frame_t f = frame_of(0x100, data, 12);

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_decode_frame(&decode, &f, &sample));  // when

    TEST_ASSERT_EQUAL_INT(1, sample.n);                                     // then
    TEST_ASSERT_EQUAL_DOUBLE(4.0, sample.item[0].value);
    TEST_ASSERT_EQUAL_UINT64(2, decode.n_nonfinite);
    TEST_ASSERT_EQUAL_UINT64(1, decode.n_decoded);
}

static void test_decode_frame_value_past_limits_is_left_out_and_counted(void)
{
    ipe_signal_t* limited = add_signal(0, 0x100, 0, 8);  // given: 10 .. 20; and no limits
    limited->minimum = 10.0, limited->maximum = 20.0;
    add_signal(1, 0x100, 8, 8);
    ipe_decode_init(&decode, &config);
    const int value[] = {9, 10, 20, 21};
    const int expected[] = {1, 2, 2, 1};
    for (int i = 0; i < 4; ++i) {
        const ipe_frame_t f = frame_of(0x100, (const uint8_t[8]){(uint8_t)value[i], 255}, 8);

        (void)ipe_decode_frame(&decode, &f, &sample);  // when

        TEST_ASSERT_EQUAL_INT(expected[i], sample.n);  // then
    }
    TEST_ASSERT_EQUAL_UINT64(2, decode.n_out_of_range);
}

static void test_decode_frame_of_only_refused_signals_is_ignored(void)
{
    ipe_signal_t* s = add_signal(0, 0x100, 0, 8);  // given
    s->minimum = 0.0, s->maximum = 1.0;
    ipe_decode_init(&decode, &config);
    const ipe_frame_t f = frame_of(0x100, (const uint8_t[8]){9}, 8);

    TEST_ASSERT_EQUAL_INT(IPE_IGNORED, ipe_decode_frame(&decode, &f, &sample));  // when, then
    TEST_ASSERT_EQUAL_INT(0, sample.n);
    TEST_ASSERT_EQUAL_UINT64(1, decode.n_decoded);
}

static void test_decode_frame_unknown_id_is_ignored_and_counted(void)
{
    add_signal(0, 0x100, 0, 8);  // given: standard 0x100 on bus 0
    ipe_decode_init(&decode, &config);
    ipe_frame_t f[3] = {{.can_id = 0x101, .length = 8},
                        {.can_id = 0x100 | IPE_CAN_EFF, .length = 8},
                        {.can_id = 0x100, .bus = 1, .length = 8}};
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_EQUAL_INT(IPE_IGNORED, ipe_decode_frame(&decode, &f[i], &sample));  // when, then
    }
    TEST_ASSERT_EQUAL_UINT64(3, decode.n_unknown);
    TEST_ASSERT_EQUAL_UINT64(0, decode.n_decoded);
}

static void test_decode_frame_wrong_length_is_refused_and_counted(void)
{
    add_signal(0, 0x100, 0, 8);  // given: 8 bytes
    ipe_decode_init(&decode, &config);
    for (unsigned length = 0; length <= 64; ++length) {
        const ipe_frame_t f = {.can_id = 0x100, .length = (uint8_t)length};
        const ipe_status_t status = ipe_decode_frame(&decode, &f, &sample);    // when
        TEST_ASSERT_EQUAL_INT(length == 8 ? IPE_OK : IPE_ERR_LENGTH, status);  // then
    }
    TEST_ASSERT_EQUAL_UINT64(64, decode.n_bad_length);
}

static void test_decode_frame_remote_and_error_frames_are_counted_apart(void)
{
    add_signal(0, 0x100, 0, 8);  // given
    ipe_decode_init(&decode, &config);
    const ipe_frame_t remote = {.can_id = 0x100 | IPE_CAN_RTR, .length = 8};
    const ipe_frame_t error = {.can_id = 0x100 | IPE_CAN_ERR, .length = 8};

    TEST_ASSERT_EQUAL_INT(IPE_IGNORED, ipe_decode_frame(&decode, &remote, &sample));  // when, then
    TEST_ASSERT_EQUAL_INT(IPE_IGNORED, ipe_decode_frame(&decode, &error, &sample));
    TEST_ASSERT_EQUAL_UINT64(1, decode.n_remote);
    TEST_ASSERT_EQUAL_UINT64(1, decode.n_error);
    TEST_ASSERT_EQUAL_UINT64(0, decode.n_unknown);
}

static void test_decode_frame_multiplexer_selects_its_signals(void)
{
    add_signal(0, 0x100, 56, 8);   // given: one signal always there, one for selector
    for (int i = 0; i < 2; ++i) {  // 3, one for 5, in the same bits
        ipe_signal_t* s = add_signal(1 + i, 0x100, 8, 8);
        s->mux_start = 7, s->mux_length = 4, s->mux_big_endian = true, s->mux_value = i == 0 ? 3 : 5;
    }
    ipe_decode_init(&decode, &config);
    const int selector[] = {3, 5, 4};
    const int quantity[] = {1, 2, -1};
    for (int i = 0; i < 3; ++i) {
        const ipe_frame_t f = frame_of(0x100, (const uint8_t[8]){(uint8_t)(selector[i] << 4), 77}, 8);

        TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_decode_frame(&decode, &f, &sample));  // when

        TEST_ASSERT_EQUAL_INT(quantity[i] < 0 ? 1 : 2, sample.n);               // then
        if (quantity[i] < 0) { continue; }
        TEST_ASSERT_EQUAL_INT(quantity[i], sample.item[1].quantity);
        TEST_ASSERT_EQUAL_DOUBLE(77.0, sample.item[1].value);
    }
}

static void test_decode_frame_many_messages_each_find_their_own_signal(void)
{
    uint64_t seed = 3;  // given: 64 messages, IDs of both kinds, 8 buses
    for (int i = 0; i < IPE_SIGNALS_MAX; ++i) {
        const uint32_t id = (uint32_t)(2000.0 * uniform(&seed));
        ipe_signal_t* s = add_signal(i % IPE_Q_COUNT, i % 2 ? id | IPE_CAN_EFF : id, 0, 8);
        s->bus = i % 8;
        s->offset = 1000.0 * i;
    }
    ipe_decode_init(&decode, &config);
    for (int i = 0; i < IPE_SIGNALS_MAX; ++i) {
        ipe_frame_t f = frame_of(config.signal[i].can_id, (const uint8_t[8]){9}, 8);
        f.bus = (uint8_t)config.signal[i].bus;

        TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_decode_frame(&decode, &f, &sample));  // when

        TEST_ASSERT_EQUAL_INT(1, sample.n);                                     // then
        TEST_ASSERT_EQUAL_DOUBLE(9.0 + 1000.0 * i, sample.item[0].value);
    }
}

static void test_decode_frame_same_id_on_other_buses_is_another_message(void)
{
    for (int bus = 0; bus < 8; ++bus) {  // given
        ipe_signal_t* s = add_signal(bus, 0x100, 0, 8);
        s->bus = bus;
        s->offset = 1000.0 * bus;
    }
    ipe_decode_init(&decode, &config);
    for (int bus = 0; bus < 8; ++bus) {
        ipe_frame_t f = frame_of(0x100, (const uint8_t[8]){9}, 8);
        f.bus = (uint8_t)bus;

        TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_decode_frame(&decode, &f, &sample));  // when

        TEST_ASSERT_EQUAL_INT(1, sample.n);                                     // then
        TEST_ASSERT_EQUAL_DOUBLE(9.0 + 1000.0 * bus, sample.item[0].value);
    }
}

static void test_decode_frame_of_a_full_table_is_looked_up_with_its_bus(void)
{
    enum { BUSES = 7 };
    const uint8_t data[8] = {9};
    while (config.n_signals < IPE_SIGNALS_MAX) {  // given: every message there is room for, few IDs on most buses
        const int i = config.n_signals;
        add_signal(i % IPE_Q_COUNT, (uint32_t)(i / BUSES), 0, 8)->bus = i % BUSES;
    }
    ipe_decode_init(&decode, &config);
    for (int i = 0; i < IPE_SIGNALS_MAX / BUSES * (BUSES + 1); ++i) {
        ipe_frame_t f = frame_of((uint32_t)(i / (BUSES + 1)), data, 8);
        f.bus = (uint8_t)(i % (BUSES + 1));
        const ipe_status_t status = ipe_decode_frame(&decode, &f, &sample);  // when
        if (f.bus == BUSES) {                                                // then
            TEST_ASSERT_EQUAL_INT(IPE_IGNORED, status);
        } else {
            TEST_ASSERT_EQUAL_INT(IPE_OK, status);
            TEST_ASSERT_EQUAL_INT(1, sample.n);
            TEST_ASSERT_EQUAL_INT(((int)f.can_id * BUSES + f.bus) % IPE_Q_COUNT, sample.item[0].quantity);
        }
    }
}

static void test_decode_frame_interleaved_signals_of_two_messages_stay_apart(void)
{
    for (int i = 0; i < 6; ++i) { add_signal(i, i % 2 ? 0x101 : 0x100, 8 * (i / 2), 8); }  // given
    ipe_decode_init(&decode, &config);
    const ipe_frame_t f = frame_of(0x101, (const uint8_t[8]){11, 22, 33}, 8);

    (void)ipe_decode_frame(&decode, &f, &sample);  // when

    TEST_ASSERT_EQUAL_INT(3, sample.n);            // then
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_EQUAL_INT(2 * i + 1, sample.item[i].quantity);
        TEST_ASSERT_EQUAL_DOUBLE(11.0 * (i + 1), sample.item[i].value);
    }
}

static void test_decode_frame_knows_its_time_on_the_wire(void)
{
    config.bus_bitrate[0] = 1e6;  // given: 1 Mbit/s on bus 0, unknown on bus 1
    config.bus_data_bitrate[0] = 5e6;
    add_signal(0, 0x100, 0, 8);
    add_signal(0, 0x100 | IPE_CAN_EFF, 0, 8);
    add_signal(0, 0x100, 0, 8)->bus = 1;
    add_signal(0, 0x101 | IPE_CAN_EFF, 0, 8)->frame_length = 64;
    ipe_decode_init(&decode, &config);
    const ipe_frame_t f[] = {{.can_id = 0x100, .length = 8},
                             {.can_id = 0x100 | IPE_CAN_EFF, .length = 8},
                             {.can_id = 0x100, .length = 8, .bus = 1},
                             {.can_id = 0x100, .length = 8, .flags = IPE_FRAME_FD},
                             {.can_id = 0x100, .length = 8, .flags = IPE_FRAME_FD | IPE_FRAME_BRS},
                             {.can_id = 0x101 | IPE_CAN_EFF, .length = 64, .flags = IPE_FRAME_FD | IPE_FRAME_BRS}};
    const double expected[] = {111e-6, 131e-6, 0.0, 126e-6, 29e-6 + 97e-6 / 5, 48e-6 + 550e-6 / 5};
    for (int i = 0; i < 6; ++i) {
        (void)ipe_decode_frame(&decode, &f[i], &sample);                  // when
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, expected[i], sample.wire_time);  // then
    }
}

static void test_decode_frame_counters_add_up(void)
{
    uint64_t seed = 11;  // given: a table and random frames
    add_signal(0, 3, 0, 8);
    ipe_decode_init(&decode, &config);
    for (int i = 0; i < 10000; ++i) {  // when
        const uint32_t kind[] = {0, IPE_CAN_EFF, IPE_CAN_RTR, IPE_CAN_ERR};
        const ipe_frame_t f = {.can_id = (uint32_t)(8.0 * uniform(&seed)) | kind[(int)(4.0 * uniform(&seed))],
                               .length = (uint8_t)(65.0 * uniform(&seed)),
                               .bus = (uint8_t)(256.0 * uniform(&seed))};
        (void)ipe_decode_frame(&decode, &f, &sample);
    }
    const ipe_decode_t* d = &decode;  // then
    TEST_ASSERT_EQUAL_UINT64(10000, d->n_frames);
    TEST_ASSERT_EQUAL_UINT64(10000, d->n_decoded + d->n_unknown + d->n_remote + d->n_error + d->n_bad_length);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_decode_raw_every_intel_layout_matches_bit_by_bit);
    RUN_TEST(test_decode_raw_every_motorola_layout_matches_bit_by_bit);
    RUN_TEST(test_decode_raw_known_layouts_give_known_numbers);
    RUN_TEST(test_decode_frame_integer_is_scaled_and_signed);
    RUN_TEST(test_decode_frame_floats_of_both_orders_are_read);
    RUN_TEST(test_decode_frame_nonfinite_floats_are_left_out_and_counted);
    RUN_TEST(test_decode_frame_value_past_limits_is_left_out_and_counted);
    RUN_TEST(test_decode_frame_of_only_refused_signals_is_ignored);
    RUN_TEST(test_decode_frame_unknown_id_is_ignored_and_counted);
    RUN_TEST(test_decode_frame_wrong_length_is_refused_and_counted);
    RUN_TEST(test_decode_frame_remote_and_error_frames_are_counted_apart);
    RUN_TEST(test_decode_frame_multiplexer_selects_its_signals);
    RUN_TEST(test_decode_frame_many_messages_each_find_their_own_signal);
    RUN_TEST(test_decode_frame_same_id_on_other_buses_is_another_message);
    RUN_TEST(test_decode_frame_of_a_full_table_is_looked_up_with_its_bus);
    RUN_TEST(test_decode_frame_interleaved_signals_of_two_messages_stay_apart);
    RUN_TEST(test_decode_frame_knows_its_time_on_the_wire);
    RUN_TEST(test_decode_frame_counters_add_up);
    return UNITY_END();
}
