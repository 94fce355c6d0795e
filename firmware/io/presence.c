// SPDX-License-Identifier: Apache-2.0
#include "presence.h"

static const int64_t FIRST_NS = 5000000000, LEAST_NS = 200000000;
enum { PERIODS = 10 };

static int64_t limit_of(const ipe_presence_t* p)
{
    if (p->newest_ns == 0) { return FIRST_NS; }
    return PERIODS * p->period_ns > LEAST_NS ? PERIODS * p->period_ns : LEAST_NS;
}

/// True if there are new samples.
static bool take_samples(ipe_presence_t* p, uint64_t n_samples, int64_t newest_ns)
{
    const uint64_t n = n_samples - p->n_samples;
    if (n == 0) { return false; }
    if (p->newest_ns != 0 && !p->is_lost) { p->period_ns = (newest_ns - p->newest_ns) / (int64_t)n; }
    p->n_samples = n_samples;
    p->newest_ns = newest_ns;
    return true;
}

ipe_presence_change_t ipe_presence_look(ipe_presence_t* p, uint64_t n_samples, int64_t newest_ns, int64_t now_ns)
{
    const bool is_stepped_back = now_ns < p->began_ns || newest_ns < p->newest_ns || n_samples < p->n_samples;
    if (!p->is_looking || is_stepped_back) {
        *p = (ipe_presence_t){.is_looking = true, .is_lost = p->is_lost, .began_ns = now_ns, .n_lost = p->n_lost};
    }
    if (take_samples(p, n_samples, newest_ns)) {
        const bool was_lost = p->is_lost;
        p->is_lost = false;
        return was_lost ? IPE_PRESENCE_BACK : IPE_PRESENCE_SAME;
    }
    p->silence_ns = now_ns - (p->newest_ns != 0 ? p->newest_ns : p->began_ns);
    if (p->is_lost || p->silence_ns <= limit_of(p)) { return IPE_PRESENCE_SAME; }
    p->is_lost = true;
    p->n_lost++;
    return IPE_PRESENCE_LOST;
}
