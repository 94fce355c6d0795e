// SPDX-License-Identifier: Apache-2.0
#include "announcement.h"

#include "body.h"
#include "cable_inertia.h"
#include "smallmat.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define WINDOW \
    0.04  // s, at least 8 rows: chosen so that two of them are over before a controller of 1.5 Hz is 1 mm off
#define EARLY_NS 1000000000      // before the announced time: chosen over the error of a person's or a gripper's clock
#define PATIENCE_NS 30000000000  // after it: chosen longer than a crane driver hesitates
#define GAP_PERMILLE 300         // of a window, 2.4 rows at least: chosen so that one lost row restarts no window
#define CONTACT_MAX_NS 3000000000  // chosen over six times the contact of a load that is lowered at 0.1 m/s
#define FAILED_WINDOWS 5           // 50 ms at 200 Hz and more: chosen over a knock
#define SLOPE_WINDOWS 8            // 80 ms at 200 Hz and more, that the share is extrapolated by
#define SHARE_STD 0.02             // at least, of a share: chosen over the error of forces and motion in time, 1 ms
#define SLOPE_ERROR 0.25           // of an extrapolated step: chosen as what a load in an elastic sling varies it by
#define LEAD_MAX 0.05              // s beyond the newest row: chosen short against a contact of 0.5 s
#define RESTING 0.02               // of the share, between two halves of what is kept: chosen as SHARE_STD
#define AGREES 3.0                 // sigmas of a share from 1
#define RELATIVE_STD_MAX 0.5       // of the mass: what is less certain is no announcement; "half" in words

#define ROUNDING 1e-6              // of a sum of moments that was computed elsewhere

enum { MASS = 0, MASS_STD = 1, COG = 2, COG_STD = 5, INERTIA = 8, INERTIA_STD = 14 };

/// theta [10] about the IMU of a body's mass, CoG and inertia.
static void theta_at_imu(const ipe_config_t* config, double mass, const double cog[3], const double inertia[6],
                         double theta[IPE_NP])
{
    const double* imu = config->imu_position;
    const double d[3] = {cog[0] - imu[0], cog[1] - imu[1], cog[2] - imu[2]};
    memset(theta, 0, IPE_NP * sizeof theta[0]);
    theta[0] = mass;
    memcpy(theta + 4, inertia, 6 * sizeof inertia[0]);
    ipe_body_shift(d, theta, NULL);
}

/// Is tr(J)/2 E - J, the second moments of the mass, positive semidefinite but for rounding? J may be 0: of a point.
static bool has_second_moments(const double J[6])
{
    const double half = 0.5 * (J[0] + J[1] + J[2]);
    double largest = 0.0;
    for (int i = 0; i < 6; ++i) { largest = fmax(largest, fabs(J[i])); }
    const double e = ROUNDING * largest;
    double M[3][3] = {{half - J[0] + e}, {-J[5], half - J[1] + e}, {-J[4], -J[3], half - J[2] + e}};
    return largest == 0.0 || cholesky(&M[0][0], 3);
}

static const char* find_mistake(const double body[IPE_ANNOUNCEMENT_NUMBERS])
{
    const double mass = fabs(body[MASS]);
    bool is_negative = body[MASS_STD] < 0.0;
    for (int i = 0; i < 3; ++i) { is_negative |= body[COG_STD + i] < 0.0; }
    for (int i = 0; i < 6; ++i) { is_negative |= body[INERTIA_STD + i] < 0.0; }
    if (!all_finite(body, IPE_ANNOUNCEMENT_NUMBERS)) { return "a number is not finite"; }
    if (mass == 0.0) { return "mass: must not be 0"; }
    if (is_negative) { return "a standard deviation is negative"; }
    if (body[MASS_STD] > RELATIVE_STD_MAX * mass) { return "mass_std: must be at most half of the mass"; }
    if (!has_second_moments(body + INERTIA)) { return "inertia_cog: no body has these moments"; }
    return NULL;
}

ipe_status_t ipe_announcement_init(ipe_announcement_t* a, const ipe_config_t* config,
                                   const double body[IPE_ANNOUNCEMENT_NUMBERS], int64_t from_ns, double period,
                                   char* message, size_t size)
{
    const char* mistake = find_mistake(body);
    if (mistake != NULL) {
        (void)snprintf(message, size, "%s", mistake);
        return IPE_ERR_RANGE;
    }
    const double sign = body[MASS] < 0.0 ? -1.0 : 1.0, mass = fabs(body[MASS]);
    double changed[IPE_NP];
    memset(a, 0, sizeof *a);
    theta_at_imu(config, mass, body + COG, body + INERTIA, a->step);
    for (int k = 0; k < 9; ++k) {  // one sigma of each number of the CoG and the inertia, one at a time
        double cog[3], inertia[6];
        memcpy(cog, body + COG, sizeof cog);
        memcpy(inertia, body + INERTIA, sizeof inertia);
        *(k < 3 ? &cog[k] : &inertia[k - 3]) += k < 3 ? body[COG_STD + k] : body[INERTIA_STD + k - 3];
        theta_at_imu(config, mass, cog, inertia, changed);
        for (int i = 0; i < IPE_NP; ++i) { a->std[i] = hypot(a->std[i], changed[i] - a->step[i]); }
    }
    for (int i = 0; i < IPE_NP; ++i) { a->step[i] *= sign; }
    a->relative_std = body[MASS_STD] / mass;
    a->from_ns = from_ns;
    a->state = IPE_ANNOUNCEMENT_WAITS;
    ipe_window_init_length(&a->window, config, WINDOW, GAP_PERMILLE, period);
    return IPE_OK;
}

/// What a window shows.
typedef struct {
    int64_t t_ns;             ///< its middle
    double share, share_std;  ///< of the payload
    bool is_evident;          ///< it alone shows a share above 0
} shown_t;

/// False: no window ended. Not inlined, so that publishing, which goes deeper, does not stand on these locals.
static __attribute__((noinline)) bool look(ipe_announcement_t* a, ipe_estimator_t* e, const ipe_config_t* config,
                                           int64_t t_ns, const ipe_motion_t* motion, const ipe_wrench_t* wrench,
                                           shown_t* shown)
{
    ipe_average_t average;
    ipe_body_step_t sums;
    ipe_body_step_fit_t fit;
    const ipe_change_detector_t* d = &e->change_detector;
    const bool is_learnt = ipe_estimator_is_noise_learnt(e);
    if (ipe_window_push(&a->window, t_ns, motion, wrench, &average) != IPE_OK) { return false; }
    if (ipe_cable_inertia_add(config, &average) != IPE_OK) { return false; }
    *shown = (shown_t){.t_ns = average.t_ns, .share_std = 1.0};
    if (ipe_estimator_contrast(e, config, &average, &sums) != IPE_OK) { return true; }
    a->has_looked = true;
    ipe_body_step_along(&sums, a->step, ipe_change_detector_scale(d, is_learnt), &fit, &shown->share,
                        &shown->share_std);
    shown->is_evident = shown->share > 0.0 && ipe_change_detector_is_evident(d, is_learnt, &sums, &fit);
    return true;
}

static void keep_share(ipe_announcement_t* a, double t, double share)
{
    const int at = a->n_shares++ % IPE_ANNOUNCEMENT_SHARES;
    a->share[at] = share;
    a->t[at] = t;
}

/// Mean of the shares from the newest but `from` to the newest but `to`, and the mean of their times.
static double mean_share(const ipe_announcement_t* a, int from, int to, double* t)
{
    double share = 0.0;
    *t = 0.0;
    for (int k = to; k < from; ++k) {
        const int at = (a->n_shares - 1 - k) % IPE_ANNOUNCEMENT_SHARES;
        share += a->share[at] / (from - to);
        *t += a->t[at] / (from - to);
    }
    return share;
}

/// The share at time t, s since the contact, by the line through the newest ones: never over the whole, unless it is over it already.
static void extrapolate(ipe_announcement_t* a, double t, double share, double share_std)
{
    double t_mean, slope = 0.0, square = 0.0;
    const int n = a->n_shares < SLOPE_WINDOWS ? a->n_shares : SLOPE_WINDOWS;
    const double mean = mean_share(a, n, 0, &t_mean);
    for (int k = 0; k < n; ++k) {
        const int at = (a->n_shares - 1 - k) % IPE_ANNOUNCEMENT_SHARES;
        slope += (a->t[at] - t_mean) * (a->share[at] - mean);
        square += (a->t[at] - t_mean) * (a->t[at] - t_mean);
    }
    slope = square > 0.0 ? slope / square : 0.0;
    const double newest = a->t[(a->n_shares - 1) % IPE_ANNOUNCEMENT_SHARES];
    const double line = mean + slope * (t - t_mean);
    a->now = fmax(0.0, fmin(line, fmax(1.0, share)));
    a->now_std = fmax(fmax(share_std, SHARE_STD), SLOPE_ERROR * fabs(slope) * (t - newest));
}

/// Has the share been at rest for all that is kept?
static bool is_resting(const ipe_announcement_t* a, double share_std, double* share)
{
    enum { HALF = IPE_ANNOUNCEMENT_SHARES / 2 };
    double t;
    if (a->n_shares < IPE_ANNOUNCEMENT_SHARES) { return false; }
    const double before = mean_share(a, IPE_ANNOUNCEMENT_SHARES, HALF, &t), after = mean_share(a, HALF, 0, &t);
    *share = 0.5 * (before + after);
    return fabs(after - before) < fmax(RESTING, share_std);
}

/// Sigma [10] of share times the payload's parameters.
static void std_of(const ipe_announcement_t* a, double share, double share_std, double std[IPE_NP])
{
    for (int i = 0; i < IPE_NP; ++i) { std[i] = hypot(share * a->std[i], share_std * a->step[i]); }
}

static void step_of(const ipe_announcement_t* a, double share, double step[IPE_NP])
{
    for (int i = 0; i < IPE_NP; ++i) { step[i] = share * a->step[i]; }
}

/// The contact is over: theta moves.
static void take(ipe_announcement_t* a, ipe_estimator_t* e, const ipe_config_t* config, double share, double share_std)
{
    double step[IPE_NP], std[IPE_NP];
    const double error = fmax(share_std, SHARE_STD);
    const bool is_announced = fabs(share - 1.0) <= AGREES * hypot(a->relative_std, error);
    step_of(a, share, step);
    std_of(a, share, error, std);
    ipe_estimator_move(e, config, step, is_announced ? std : NULL);
    a->state = is_announced ? IPE_ANNOUNCEMENT_TAKEN : IPE_ANNOUNCEMENT_OTHER;
}

static void begin_contact(ipe_announcement_t* a, ipe_estimator_t* e, int64_t t_ns)
{
    a->state = IPE_ANNOUNCEMENT_CONTACT;
    a->contact_ns = t_ns;
    a->n_shares = 0, a->n_failed = 0;
    ++e->change_detector.n_changes;
    ipe_change_detector_restart(&e->change_detector);
}

/// The contact is broken off: the body is the one before again, which is one more change. What follows is suspected as usual.
static void break_off(ipe_announcement_t* a, ipe_estimator_t* e)
{
    a->state = IPE_ANNOUNCEMENT_FAILED;
    ++e->change_detector.n_changes;
}

/// One more window of the contact, at row time t_ns.
static void follow(ipe_announcement_t* a, ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns,
                   const shown_t* shown)
{
    const double now = 1e-9 * (double)(t_ns - a->contact_ns), next = now + fmin(1.0 / config->estimate_rate, LEAD_MAX);
    double resting;
    keep_share(a, 1e-9 * (double)(shown->t_ns - a->contact_ns), shown->share);
    extrapolate(a, next, shown->share, shown->share_std);  // to when the next estimate replaces this one
    if (is_resting(a, shown->share_std, &resting)) { take(a, e, config, resting, shown->share_std); }
}

void ipe_announcement_begin_publication(const ipe_announcement_t* a, const ipe_estimator_t* e,
                                        const ipe_config_t* config, ipe_publication_t* publication)
{
    double step[IPE_NP], std[IPE_NP];
    const bool is_moved = a->state == IPE_ANNOUNCEMENT_CONTACT;
    step_of(a, a->now, step);
    std_of(a, a->now, a->now_std, std);
    ipe_estimator_begin_publication(e, config, a->shown_ns, is_moved ? step : NULL, is_moved ? std : NULL, publication);
}

/// Whether windows end or not; or the clock was stepped back.
static bool is_too_long(const ipe_announcement_t* a, int64_t t_ns)
{
    return a->state == IPE_ANNOUNCEMENT_CONTACT && (t_ns < a->contact_ns || t_ns > a->contact_ns + CONTACT_MAX_NS);
}

ipe_status_t ipe_announcement_push(ipe_announcement_t* a, ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns,
                                   const ipe_motion_t* motion, const ipe_wrench_t* wrench)
{
    shown_t shown;
    if (a->state != IPE_ANNOUNCEMENT_WAITS && a->state != IPE_ANNOUNCEMENT_CONTACT) { return IPE_NOT_READY; }
    if (a->state == IPE_ANNOUNCEMENT_WAITS && t_ns > a->from_ns + PATIENCE_NS) { a->state = IPE_ANNOUNCEMENT_MISSED; }
    if (is_too_long(a, t_ns)) {
        break_off(a, e);
        a->shown_ns = t_ns;
        return IPE_OK;
    }
    if (t_ns < a->from_ns - EARLY_NS || a->state == IPE_ANNOUNCEMENT_MISSED) { return IPE_NOT_READY; }
    if (!look(a, e, config, t_ns, motion, wrench, &shown)) { return IPE_NOT_READY; }
    a->n_evident = shown.is_evident ? a->n_evident + 1 : 0;
    a->n_failed = shown.is_evident ? 0 : a->n_failed + 1;
    if (a->state == IPE_ANNOUNCEMENT_WAITS && a->n_evident < IPE_CHANGE_DETECTOR_SUDDEN_WINDOWS) {
        return IPE_NOT_READY;
    }
    if (a->state == IPE_ANNOUNCEMENT_WAITS) { begin_contact(a, e, shown.t_ns); }
    if (shown.is_evident) {
        follow(a, e, config, t_ns, &shown);
    } else if (a->n_failed >= FAILED_WINDOWS) {
        break_off(a, e);
    }
    a->shown_ns = shown.t_ns;
    return IPE_OK;
}
