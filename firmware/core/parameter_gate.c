// SPDX-License-Identifier: Apache-2.0
#include "parameter_gate.h"

#include "consistency.h"
#include "smallmat.h"

#include <math.h>
#include <string.h>

#define NEW 4U             // of middle: the reader has not seen it
#define CARE 2             // verdict of ESTIMATE
#define AHEAD_NS 10000000  // 10 ms that a stamp may be ahead: chosen over the error between two clocks of one network

static double seconds(int64_t ns)
{
    return 1e-9 * (double)ns;
}

/// Share of a transition of some seconds that is over since begin_ns.
static double share(int64_t begin_ns, int64_t now_ns, double time)
{
    if (now_ns <= begin_ns) { return 0.0; }
    return seconds(now_ns - begin_ns) >= time ? 1.0 : seconds(now_ns - begin_ns) / time;
}

static void mix(const double a[IPE_NP], const double b[IPE_NP], double x, double c[IPE_NP])
{
    for (int i = 0; i < IPE_NP; ++i) { c[i] = (1.0 - x) * a[i] + x * b[i]; }
}

static void evaluate(const ipe_parameter_gate_t* g, const ipe_gate_segment_t* s, int64_t now_ns,
                     ipe_gate_parameters_t* p)
{
    const double T = g->limits.transition_time, x = share(s->begin_ns, now_ns, s->time);
    mix(s->from, s->to, x, p->theta);
    p->sequence = s->sequence;
    p->source = s->has_estimate ? IPE_GATE_LIVE : IPE_GATE_NOMINAL;
    p->age = s->has_estimate ? fmax(seconds(now_ns - s->begin_ns), 0.0) : -1.0;
    p->is_moving = s->has_estimate && x < 1.0;
    if (!s->has_estimate || p->age <= g->limits.age_max) { return; }
    if (g->limits.keep_last_good || s->keeps) {
        p->source = IPE_GATE_LAST_GOOD;
        return;
    }
    const double y = share(s->begin_ns + (int64_t)(1e9 * g->limits.age_max), now_ns, T);
    double theta[IPE_NP];
    memcpy(theta, p->theta, sizeof theta);
    mix(theta, g->nominal, y, p->theta);
    p->is_moving = y < 1.0;
    p->source = y < 1.0 ? IPE_GATE_FALLING_BACK : IPE_GATE_NOMINAL;
}

static bool is_finite(const ipe_gate_estimate_t* e)
{
    bool is_good = all_finite(e->theta, IPE_NP);
    for (int i = 0; i < IPE_NP; ++i) { is_good &= all_finite(e->covariance[i], IPE_NP); }
    return is_good;
}

static double largest(const double* x, int n)
{
    double max = 0.0;
    for (int i = 0; i < n; ++i) { max = fmax(max, x[i]); }
    return max;
}

static bool is_inertia_sharp(const ipe_gate_limits_t* l, const ipe_body_t* b)
{
    const double trace = b->inertia_cog[0] + b->inertia_cog[1] + b->inertia_cog[2];
    return largest(b->inertia_cog_std, 6) <= l->inertia_std * trace / 3.0;
}

static bool is_sharp(const ipe_gate_limits_t* l, const ipe_body_t* b, bool is_mass_enough)
{
    if (b->mass_std > l->mass_std * b->mass) { return false; }
    return is_mass_enough || (largest(b->cog_std, 3) <= l->cog_std && is_inertia_sharp(l, b));
}

static bool is_observable(const ipe_gate_estimate_t* e, bool is_mass_enough)
{
    for (int i = 0; i < (is_mass_enough ? 1 : IPE_NP); ++i) {
        if (!e->observable[i]) { return false; }
    }
    return true;
}

/// Does everything that is demanded without an announced change hold?
static bool is_whole(const ipe_gate_limits_t* l, const ipe_gate_estimate_t* e, const ipe_body_t* body)
{
    return e->verdict <= l->verdict_max && is_observable(e, false) && is_sharp(l, body, false);
}

/// Do n values agree, each within so many standard deviations of their difference?
static bool agree(const double* a, const double* a_std, const double* b, const double* b_std, int n, double sigmas)
{
    for (int i = 0; i < n; ++i) {
        if (fabs(a[i] - b[i]) > sigmas * sqrt(a_std[i] * a_std[i] + b_std[i] * b_std[i])) { return false; }
    }
    return true;
}

static bool are_one_body(const ipe_body_t* a, const ipe_body_t* b, double sigmas)
{
    return agree(&a->mass, &a->mass_std, &b->mass, &b->mass_std, 1, sigmas) &&
           agree(a->cog, a->cog_std, b->cog, b->cog_std, 3, sigmas) &&
           agree(a->inertia_cog, a->inertia_cog_std, b->inertia_cog, b->inertia_cog_std, 6, sigmas);
}

/// Did the daemon that gave the estimate begin later than the one before?
static bool is_restart(const ipe_parameter_gate_t* g, const ipe_gate_estimate_t* e)
{
    return e->sequence <= g->last_sequence && e->t_ns > g->last_t_ns;
}

/// Is an announced change over? The estimate agrees with the one of the window before. Remembers this one.
static bool is_settled(ipe_parameter_gate_t* g, const ipe_gate_estimate_t* e, const ipe_body_t* body)
{
    const bool is_same_window = e->t_ns <= g->previous_t_ns;
    if (is_same_window && e->n_changes == g->previous_n_changes) { return false; }
    const bool is_good =
        e->n_changes == g->previous_n_changes && are_one_body(body, &g->previous, g->limits.step_sigmas);
    g->previous = *body, g->previous_t_ns = e->t_ns, g->previous_n_changes = e->n_changes;
    return is_good;
}

/// IPE_GATE_TAKEN: nothing speaks against it.
static ipe_gate_reason_t judge(const ipe_parameter_gate_t* g, const ipe_gate_estimate_t* e, int64_t now_ns,
                               bool is_live, ipe_body_t* body)
{
    const ipe_gate_limits_t* l = &g->limits;
    const bool is_new = g->known_n_changes >= 0 && e->n_changes != g->known_n_changes && !is_restart(g, e);
    const bool is_changed = is_new || g->is_changed;
    if (!is_finite(e)) { return IPE_GATE_NOT_FINITE; }
    if (e->t_ns < 0 || e->t_ns > IPE_TIME_MAX_NS) { return IPE_GATE_TOO_OLD; }
    if (e->sequence <= g->last_sequence && e->t_ns <= g->last_t_ns) { return IPE_GATE_OLD_SEQUENCE; }
    if (seconds(now_ns - e->t_ns) > l->age_max || e->t_ns - now_ns > AHEAD_NS) { return IPE_GATE_TOO_OLD; }
    if (e->verdict < 1 || e->verdict > (is_changed && l->verdict_max < CARE ? CARE : l->verdict_max)) {
        return IPE_GATE_VERDICT;
    }
    if (!is_observable(e, is_changed)) { return IPE_GATE_UNOBSERVABLE; }
    if (!ipe_consistency_check(e->theta) || ipe_body_from_theta(e->theta, e->covariance, body) != IPE_OK) {
        return IPE_GATE_INCONSISTENT;
    }
    if (!all_finite(&body->mass, sizeof *body / sizeof(double))) { return IPE_GATE_NOT_FINITE; }  // P not positive
    if (!is_sharp(l, body, is_changed)) { return IPE_GATE_SIGMA; }
    const bool may_differ = is_new || e->is_provisional || g->is_in_contact;
    if (is_live && !may_differ && !are_one_body(body, &g->last, l->step_sigmas)) { return IPE_GATE_CONTRADICTION; }
    return IPE_GATE_TAKEN;
}

/// How far apart two bodies are, for the parts of a transition: kg, with moments in units of the body's own size.
static double distance(const double a[IPE_NP], const double b[IPE_NP])
{
    const double length_2 = (a[4] + a[5] + a[6]) / a[0], length = sqrt(length_2);
    double sum = (a[0] - b[0]) * (a[0] - b[0]);
    for (int i = 1; i < 4; ++i) { sum += (a[i] - b[i]) * (a[i] - b[i]) / length_2; }
    for (int i = 4; i < IPE_NP; ++i) { sum += (a[i] - b[i]) * (a[i] - b[i]) / (length_2 * length * length); }
    return sqrt(sum);
}

/// Time of a transition from theta to another body, s: what is left of the one under way, or the new part's share of the
/// whole time T if that is longer; at most T.
static double time_of(const ipe_parameter_gate_t* g, double T, const double theta[IPE_NP], const double to[IPE_NP],
                      int64_t now_ns)
{
    const double left = fmin(T, g->now.time * (1.0 - share(g->now.begin_ns, now_ns, g->now.time)));
    const double way = distance(theta, to), more = distance(g->now.to, to);
    return fmax(left, more < way ? T * more / way : T);
}

/// Give theta the inertia about the CoG that another body has.
static void keep_inertia(const double known[IPE_NP], double theta[IPE_NP])
{
    double about_c[IPE_NP], rho[3], back[3];
    memcpy(about_c, known, sizeof about_c);
    for (int i = 0; i < 3; ++i) {
        back[i] = -known[1 + i] / known[0];
        rho[i] = theta[1 + i] / theta[0];
    }
    ipe_body_shift(back, about_c, NULL);
    about_c[0] = theta[0];
    memset(about_c + 1, 0, 3 * sizeof(double));
    ipe_body_shift(rho, about_c, NULL);
    memcpy(theta, about_c, sizeof about_c);
}

/// Hand the writer's segment to the reader.
static void publish(ipe_parameter_gate_t* g)
{
    g->slot[g->writing] = g->now;
    g->writing = __atomic_exchange_n(&g->middle, (unsigned char)(g->writing | NEW), __ATOMIC_ACQ_REL) & 3U;
}

/// The nominal body is no longer there: an estimate in use stays. A fall-back that has begun goes on to it, lest theta
/// jumps.
static void leave_nominal(ipe_parameter_gate_t* g, ipe_gate_source_t source)
{
    g->was_changed = true;
    if (source != IPE_GATE_LIVE && source != IPE_GATE_LAST_GOOD) { return; }
    g->now.keeps = true;
    publish(g);
}

ipe_gate_limits_t ipe_parameter_gate_default(void)
{
    return (ipe_gate_limits_t){.mass_std = 0.02,
                               .cog_std = 0.02,
                               .inertia_std = 0.2,
                               .verdict_max = 1,
                               .age_max = 1.0,
                               .transition_time = 0.5,
                               .change_time = 0.02,
                               .step_sigmas = 6.0,
                               .n_return = 5};
}

ipe_status_t ipe_parameter_gate_init(ipe_parameter_gate_t* g, const ipe_gate_limits_t* limits,
                                     const double nominal[IPE_NP])
{
    const ipe_gate_limits_t* l = limits;
    const bool is_good = l->mass_std > 0.0 && l->cog_std > 0.0 && l->inertia_std > 0.0 && l->age_max > 0.0 &&
                         l->transition_time >= 0.0 && l->change_time >= 0.0 && l->step_sigmas > 0.0 &&
                         l->n_return >= 1 && l->verdict_max >= 1;
    if (!is_good || !ipe_consistency_check(nominal)) { return IPE_ERR_RANGE; }
    memset(g, 0, sizeof *g);
    g->limits = *limits;
    memcpy(g->nominal, nominal, sizeof g->nominal);
    memcpy(g->now.from, nominal, sizeof g->now.from);
    memcpy(g->now.to, nominal, sizeof g->now.to);
    g->now.sequence = -1;
    for (int i = 0; i < 3; ++i) { g->slot[i] = g->now; }
    g->writing = 0, g->middle = 1, g->reading = 2;
    g->last_sequence = -1, g->last_t_ns = INT64_MIN;
    g->known_n_changes = -1, g->previous_n_changes = -1, g->previous_t_ns = INT64_MIN;
    return IPE_OK;
}

ipe_gate_reason_t ipe_parameter_gate_offer(ipe_parameter_gate_t* g, const ipe_gate_estimate_t* e, int64_t now_ns)
{
    ipe_gate_parameters_t before;
    evaluate(g, &g->now, now_ns, &before);
    const bool is_live = before.source == IPE_GATE_LIVE;
    const bool has_restarted = is_restart(g, e);

    ipe_body_t body = {0};
    ipe_gate_reason_t reason = judge(g, e, now_ns, is_live && !has_restarted && !g->is_returning, &body);
    if (reason != IPE_GATE_NOT_FINITE && reason != IPE_GATE_OLD_SEQUENCE && reason != IPE_GATE_TOO_OLD) {
        g->last_sequence = e->sequence, g->last_t_ns = e->t_ns;
        g->is_returning |= has_restarted;
        if (has_restarted || g->known_n_changes < 0) { g->known_n_changes = e->n_changes, g->is_changed = false; }
        g->is_changed |= e->n_changes != g->known_n_changes;
        if (e->n_changes > 0 && !g->was_changed) { leave_nominal(g, before.source); }
    }
    const bool is_break = has_restarted || seconds(now_ns - g->acceptable_ns) > g->limits.age_max;
    g->n_in_a_row = reason != IPE_GATE_TAKEN ? 0 : is_break ? 1 : g->n_in_a_row + 1;
    if (reason == IPE_GATE_TAKEN) { g->acceptable_ns = now_ns; }
    bool waits = (!is_live || g->is_returning) && g->n_in_a_row < g->limits.n_return;
    const bool is_contact = e->is_provisional || g->is_in_contact;  // under way, or over with this one
    if (reason == IPE_GATE_TAKEN && e->n_changes != g->known_n_changes && !is_contact) {
        waits |= !is_settled(g, e, &body);
    }
    if (reason == IPE_GATE_TAKEN && waits) { reason = IPE_GATE_WAITS; }
    ++g->n[reason];
    if (reason != IPE_GATE_TAKEN) { return reason; }
    double theta[IPE_NP];
    memcpy(theta, e->theta, sizeof theta);
    if (!is_inertia_sharp(&g->limits, &body)) { keep_inertia(is_live ? g->now.to : before.theta, theta); }
    const double T = is_contact ? g->limits.change_time : g->limits.transition_time;
    g->now.time = is_live ? time_of(g, T, before.theta, theta, now_ns) : T;
    memcpy(g->now.from, before.theta, sizeof before.theta);
    memcpy(g->now.to, theta, sizeof theta);
    g->now.begin_ns = now_ns, g->now.sequence = e->sequence, g->now.has_estimate = true, g->now.keeps = g->was_changed;
    g->last = body, g->known_n_changes = e->n_changes;
    g->is_changed &= e->is_provisional || !is_whole(&g->limits, e, &body);
    g->is_in_contact = e->is_provisional;
    g->is_returning = false;
    publish(g);
    return IPE_GATE_TAKEN;
}

void ipe_parameter_gate_read(ipe_parameter_gate_t* g, int64_t now_ns, ipe_gate_parameters_t* parameters)
{
    if (__atomic_load_n(&g->middle, __ATOMIC_RELAXED) & NEW) {
        g->reading = __atomic_exchange_n(&g->middle, g->reading, __ATOMIC_ACQ_REL) & 3U;
    }
    evaluate(g, &g->slot[g->reading], now_ns, parameters);
}

const char* ipe_parameter_gate_text(ipe_gate_reason_t reason)
{
    static const char* const TEXT[IPE_GATE_REASONS] = {
        [IPE_GATE_TAKEN] = "taken",
        [IPE_GATE_WAITS] = "acceptable; more of them in a row are needed",
        [IPE_GATE_NOT_FINITE] = "a number is not finite",
        [IPE_GATE_OLD_SEQUENCE] = "not newer than the last estimate",
        [IPE_GATE_TOO_OLD] = "its time is too long ago, or ahead of the clock",
        [IPE_GATE_VERDICT] = "its verdict is worse than allowed",
        [IPE_GATE_UNOBSERVABLE] = "a parameter is not observable yet",
        [IPE_GATE_SIGMA] = "a standard deviation is over its limit",
        [IPE_GATE_INCONSISTENT] = "no body with these parameters can exist",
        [IPE_GATE_CONTRADICTION] = "it contradicts the last estimate, and no payload changed",
    };
    return (unsigned)reason < IPE_GATE_REASONS ? TEXT[reason] : "unknown";
}
