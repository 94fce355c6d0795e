// SPDX-License-Identifier: Apache-2.0
#include "rest_detector.h"

#include "smallmat.h"

#include <string.h>

// Chosen: 1 s averages a swing; half a block missing is a gap; a bias is read at most half a block after its last one.
static const int64_t BLOCK_NS = 1000000000, GAP_NS = 500000000, AGE_NS = 1500000000;
static const double TURN = 3e-3;               // rad between two blocks: chosen over an AHRS's wander in 1 s
static const double SIGMA[2] = {0.02, 0.3};    // rad/s, m/s2: chosen over a MEMS sensor's noise at 1 kHz
static const double CHANGE[2] = {5e-3, 0.05};  // rad/s, m/s2: chosen over the noise of a block's mean

void ipe_rest_detector_init(ipe_rest_detector_t* r)
{
    memset(r, 0, sizeof *r);
}

static double dot4(const double a[4], const double b[4])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
}

static void add(ipe_rest_detector_block_t* b, const ipe_row_t* row)
{
    const double value[IPE_REST_DETECTOR_CHANNELS] = {row->gyro[0], row->gyro[1], row->gyro[2],
                                                      row->acc[0],  row->acc[1],  row->acc[2]};
    if (b->n_rows == 0) {
        b->begin_ns = row->t_ns;
        memcpy(b->origin, value, sizeof b->origin);
    }
    for (int i = 0; i < IPE_REST_DETECTOR_CHANNELS; ++i) {
        const double x = value[i] - b->origin[i];
        b->sum[i] += x;
        b->square[i] += x * x;
    }
    const double sign = dot4(b->q, row->q) < 0.0 ? -1.0 : 1.0;
    for (int i = 0; i < 4; ++i) { b->q[i] += sign * row->q[i]; }
    b->end_ns = row->t_ns;
    b->n_rows++;
}

void ipe_rest_detector_push(ipe_rest_detector_t* r, const ipe_row_t* row)
{
    const ipe_rest_detector_block_t* b = &r->open;
    if (b->n_rows > 0 && (row->t_ns <= b->end_ns || row->t_ns - b->end_ns > GAP_NS)) { ipe_rest_detector_init(r); }
    if (b->n_rows > 0 && row->t_ns - b->begin_ns >= BLOCK_NS) {
        r->before = r->last;
        r->last = r->open;
        memset(&r->open, 0, sizeof r->open);
    }
    add(&r->open, row);
}

static double mean(const ipe_rest_detector_block_t* b, int i)
{
    return b->origin[i] + b->sum[i] / b->n_rows;
}

static double variance(const ipe_rest_detector_block_t* b, int i)
{
    const double m = b->sum[i] / b->n_rows;
    return b->square[i] / b->n_rows - m * m;
}

static double turn(const ipe_rest_detector_block_t* a, const ipe_rest_detector_block_t* b)
{
    double apart2 = 0.0;
    const double sign = dot4(a->q, b->q) < 0.0 ? -1.0 : 1.0;
    const double na = sqrt(dot4(a->q, a->q)), nb = sqrt(dot4(b->q, b->q));
    for (int i = 0; i < 4; ++i) {
        const double d = a->q[i] / na - sign * b->q[i] / nb;
        apart2 += d * d;
    }
    return 4.0 * asin(fmin(1.0, 0.5 * sqrt(apart2)));
}

const char* ipe_rest_detector_read(const ipe_rest_detector_t* r, int64_t now_ns, double rate[3])
{
    static const char* const VARIES[2] = {"moving: the rate varies", "moving: the specific force varies"};
    const ipe_rest_detector_block_t *a = &r->before, *b = &r->last;
    if (a->n_rows < IPE_REST_DETECTOR_ROWS_MIN || b->n_rows < IPE_REST_DETECTOR_ROWS_MIN) {
        return "fewer than 2 s of rows in a row";
    }
    if (now_ns - r->open.end_ns > AGE_NS) { return "no rows now"; }
    if (!(turn(a, b) < TURN)) { return "moving: the attitude changes"; }
    for (int i = 0; i < IPE_REST_DETECTOR_CHANNELS; ++i) {
        const double limit2 = SIGMA[i / 3] * SIGMA[i / 3];
        const bool is_steady = variance(a, i) < limit2 && variance(b, i) < limit2;
        if (!is_steady || !(fabs(mean(a, i) - mean(b, i)) < CHANGE[i / 3])) { return VARIES[i / 3]; }
    }
    for (int i = 0; i < 3; ++i) { rate[i] = 0.5 * (mean(a, i) + mean(b, i)); }
    return NULL;
}
