// SPDX-License-Identifier: Apache-2.0
#include "lateness.h"

#include <math.h>

static const double ADVICE_STEP = 0.05;  // s

static int64_t larger(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

void ipe_lateness_push(ipe_lateness_t* l, uint64_t n_samples, int64_t newest_ns, int64_t imu_ns)
{
    if (n_samples == l->n_samples) { return; }
    const int64_t interval_ns = newest_ns - l->newest_ns, late_ns = imu_ns - newest_ns;
    const bool is_first = l->n_samples == 0;
    l->n_samples = n_samples;
    l->newest_ns = newest_ns;
    if (is_first || interval_ns <= 0) { return; }
    if (l->interval_ns == 0 || interval_ns < l->interval_ns) { l->interval_ns = interval_ns; }
    l->longest_ns = larger(l->longest_ns, late_ns);
    l->worst_ns = larger(l->worst_ns, late_ns);
}

ipe_lateness_change_t ipe_lateness_look(ipe_lateness_t* l, uint64_t n_lost, int64_t max_wait_ns)
{
    const bool was_late = l->is_late;
    const int64_t needed_ns = l->longest_ns + l->interval_ns;
    l->is_late = n_lost != l->n_lost && needed_ns > max_wait_ns;
    if (l->is_late) { l->needed_ns = larger(l->needed_ns, needed_ns); }
    l->n_lost = n_lost;
    l->longest_ns = l->interval_ns = 0;
    return l->is_late == was_late ? IPE_LATENESS_SAME : l->is_late ? IPE_LATENESS_BEGAN : IPE_LATENESS_ENDED;
}

double ipe_lateness_advice(const ipe_lateness_t* l)
{
    return ADVICE_STEP * ceil(1e-9 * (double)l->needed_ns / ADVICE_STEP);
}
