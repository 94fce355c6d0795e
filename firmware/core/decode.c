// SPDX-License-Identifier: Apache-2.0
#include "decode.h"

#include <math.h>
#include <string.h>

static unsigned hash(uint32_t can_id, unsigned bus)
{
    return ((can_id * 2654435761U) >> 24 ^ bus * 37U) % IPE_DECODE_SLOTS;
}

/// Index of the slot that holds (bus, can_id), or of the empty one where it would be.
static unsigned find_slot(const ipe_decode_t* d, uint32_t can_id, unsigned bus)
{
    unsigned i = hash(can_id, bus);
    while (d->slot[i].n > 0 && (d->slot[i].can_id != can_id || d->slot[i].bus != bus)) {
        i = (i + 1) % IPE_DECODE_SLOTS;
    }
    return i;
}

static bool same_message(const ipe_signal_t* a, const ipe_signal_t* b)
{
    return a->can_id == b->can_id && a->bus == b->bus;
}

void ipe_decode_init(ipe_decode_t* d, const ipe_config_t* config)
{
    memset(d, 0, sizeof *d);
    d->config = config;
    int n = 0;
    for (int i = 0; i < config->n_signals; ++i) {
        const ipe_signal_t* head = &config->signal[i];
        const unsigned at = find_slot(d, head->can_id, (unsigned)head->bus);
        if (d->slot[at].n > 0) { continue; }
        d->slot[at].can_id = head->can_id;
        d->slot[at].bus = (uint8_t)head->bus;
        d->slot[at].frame_length = (uint8_t)head->frame_length;
        d->slot[at].first = (uint8_t)n;
        for (int j = i; j < config->n_signals; ++j) {
            if (same_message(head, &config->signal[j])) { d->order[n++] = (uint8_t)j; }
        }
        d->slot[at].n = (uint8_t)(n - d->slot[at].first);
    }
}

// Written out, compilers make one load of it, and a byte swap where needed.
static uint64_t load_little_endian(const uint8_t* p)
{
    return (uint64_t)p[0] | (uint64_t)p[1] << 8 | (uint64_t)p[2] << 16 | (uint64_t)p[3] << 24 | (uint64_t)p[4] << 32 |
           (uint64_t)p[5] << 40 | (uint64_t)p[6] << 48 | (uint64_t)p[7] << 56;
}

static uint64_t load_big_endian(const uint8_t* p)
{
    return (uint64_t)p[0] << 56 | (uint64_t)p[1] << 48 | (uint64_t)p[2] << 40 | (uint64_t)p[3] << 32 |
           (uint64_t)p[4] << 24 | (uint64_t)p[5] << 16 | (uint64_t)p[6] << 8 | (uint64_t)p[7];
}

uint64_t ipe_decode_raw(const uint8_t data[72], int start, int length, bool big_endian, bool is_signed)
{
    const unsigned byte = (unsigned)start / 8U, bit = (unsigned)start % 8U, n = (unsigned)length;
    uint64_t raw;
    if (big_endian) {
        const unsigned lead = 7U - bit;
        raw = load_big_endian(data + byte) << lead;
        if (lead > 0U) { raw |= (uint64_t)data[byte + 8] >> (8U - lead); }
        raw >>= 64U - n;
    } else {
        raw = load_little_endian(data + byte) >> bit;
        if (bit > 0U) { raw |= (uint64_t)data[byte + 8] << (64U - bit); }
        if (n < 64U) { raw &= (1ULL << n) - 1U; }
    }
    if (is_signed && n < 64U && (raw >> (n - 1U) & 1U)) { raw |= ~0ULL << n; }
    return raw;
}

static double value_of(const ipe_signal_t* s, const uint8_t* data)
{
    const uint64_t raw = ipe_decode_raw(data, s->start, s->length, s->big_endian, s->is_signed);
    double value;
    if (s->kind == IPE_FLOAT64) {
        memcpy(&value, &raw, sizeof value);
    } else if (s->kind == IPE_FLOAT32) {
        const uint32_t bits = (uint32_t)raw;
        float single;
        memcpy(&single, &bits, sizeof single);
        value = (double)single;
    } else {
        value = s->is_signed ? (double)(int64_t)raw : (double)raw;
    }
    return value * s->scale + s->offset;
}

static bool is_present(const ipe_signal_t* s, const uint8_t* data)
{
    return s->mux_start < 0 ||
           (int64_t)ipe_decode_raw(data, s->mux_start, s->mux_length, s->mux_big_endian, false) == s->mux_value;
}

static void decode_signal(ipe_decode_t* d, const ipe_signal_t* s, const uint8_t* data, ipe_sample_t* sample)
{
    if (!is_present(s, data)) { return; }
    const double value = value_of(s, data);
    if (!isfinite(value)) {
        ++d->n_nonfinite;
    } else if (s->minimum < s->maximum && (value < s->minimum || value > s->maximum)) {
        ++d->n_out_of_range;
    } else {
        sample->item[sample->n].quantity = (uint8_t)s->quantity;
        sample->item[sample->n].value = value;
        ++sample->n;
    }
}

/// Time on the wire of a data frame with the pause after it, fixed stuff bits included, others not: those depend on the
/// content, and the clock follows the frames that came through quickest.
static double wire_time(const ipe_config_t* config, const ipe_frame_t* frame)
{
    const double rate = config->bus_bitrate[frame->bus], data_rate = config->bus_data_bitrate[frame->bus];
    const bool is_extended = (frame->can_id & IPE_CAN_EFF) != 0;
    const int data = 8 * frame->length;
    if (rate <= 0.0) { return 0.0; }
    if (!(frame->flags & IPE_FRAME_FD)) { return ((is_extended ? 67 : 47) + data) / rate; }
    const int phase = data + (frame->length > 16 ? 38 : 33);  // ESI, DLC, stuff count, CRC of 21 or 17, its delimiter
    return (is_extended ? 48 : 29) / rate +
           phase / ((frame->flags & IPE_FRAME_BRS) && data_rate > 0.0 ? data_rate : rate);
}

ipe_status_t ipe_decode_frame(ipe_decode_t* d, const ipe_frame_t* frame, ipe_sample_t* sample)
{
    ++d->n_frames;
    if (frame->can_id & IPE_CAN_ERR) {
        ++d->n_error;
        return IPE_IGNORED;
    }
    if (frame->can_id & IPE_CAN_RTR) {
        ++d->n_remote;
        return IPE_IGNORED;
    }
    const unsigned at = find_slot(d, frame->can_id, frame->bus);
    if (d->slot[at].n == 0) {
        ++d->n_unknown;
        return IPE_IGNORED;
    }
    if (frame->length != d->slot[at].frame_length) {
        ++d->n_bad_length;
        return IPE_ERR_LENGTH;
    }
    uint8_t data[72] = {0};
    memcpy(data, frame->data, frame->length);
    sample->t_ns = frame->t_ns;
    sample->wire_time = wire_time(d->config, frame);
    sample->n = 0;
    const uint8_t* order = &d->order[d->slot[at].first];
    for (unsigned i = 0; i < d->slot[at].n; ++i) { decode_signal(d, &d->config->signal[order[i]], data, sample); }
    ++d->n_decoded;
    return sample->n > 0 ? IPE_OK : IPE_IGNORED;
}
