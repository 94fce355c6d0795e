// SPDX-License-Identifier: Apache-2.0
#include "findings.h"

#include "systematic.h"

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define FAR 4.0              // sigmas of a declaration, as in inertiad/identify/findings.py,
#define NAMED_MOST 3         // corrections,
#define IMPOSSIBLE_CARE 2.0  // squared distances to a body that can exist
#define IMPOSSIBLE_STOP 9.0
#define START_WINDOWS 50     // the same that the noise is learnt from before it counts
#define DEGREES (180.0 / 3.14159265358979323846)

static const char LOOK_AT_ROBOT[] =
    "look at geometry, friction of the pulleys and the force sensors; report RUN shows the residual over time";

const char* ipe_severity_name(ipe_severity_t severity)
{
    return severity == IPE_SEVERITY_STOP ? "stop" : severity == IPE_SEVERITY_CARE ? "care" : "good";
}

const char* ipe_severity_headline(ipe_severity_t severity)
{
    return severity == IPE_SEVERITY_STOP   ? "Do not use this result yet"
           : severity == IPE_SEVERITY_CARE ? "Usable with care"
                                           : "A good result";
}

/// The next free finding; the last one where there is no room, so that the first ones stay.
static ipe_finding_t* add(ipe_findings_t* found, const char* name, ipe_severity_t severity, const char* remedy)
{
    ipe_finding_t* next = &found->item[found->n < IPE_FINDINGS_MAX ? found->n++ : IPE_FINDINGS_MAX - 1];
    *next = (ipe_finding_t){.name = name, .severity = severity, .remedy = remedy};
    return next;
}

__attribute__((format(printf, 2, 3))) static void say(ipe_finding_t* f, const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(f->says, sizeof f->says, format, arguments);
    va_end(arguments);
}

__attribute__((format(printf, 2, 3))) static void show(ipe_finding_t* f, const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(f->evidence, sizeof f->evidence, format, arguments);
    va_end(arguments);
}

static void find_start(const ipe_estimate_t* estimate, ipe_findings_t* found)
{
    if (estimate->n_windows == 0) {
        ipe_finding_t* f = add(found, "no_estimate", IPE_SEVERITY_STOP,
                               "look at the counters for the stage that refuses the data; inertiactl verify RUN");
        say(f, "nothing was identified: no whole window in the data");
    } else if (estimate->n_windows < START_WINDOWS) {
        ipe_finding_t* f = add(found, "short_record", IPE_SEVERITY_CARE, "record half a minute or more");
        say(f, "only %" PRIu64 " windows were used: slow errors of the sensors do not average out",
            estimate->n_windows);
        show(f, "\"windows\": %" PRIu64, estimate->n_windows);
    }
}

static void find_misfit(const ipe_estimate_t* estimate, ipe_findings_t* found)
{
    if (estimate->is_misfit) {
        ipe_finding_t* f = add(found, "misfit", IPE_SEVERITY_CARE, "look for a push, a slack cable or a broken sensor");
        say(f, "no payload explains the forces of the last 5 s: the estimate is held, its sigmas are wider");
        show(f, "\"nis\": %.6g, \"sigma_factor\": %.4g", estimate->nis, estimate->sigma_factor);
    } else if (estimate->sigma_factor > IPE_MISFIT_MARKED) {
        ipe_finding_t* f = add(found, "misfit", IPE_SEVERITY_CARE, LOOK_AT_ROBOT);
        say(f, "unexplained misfit: the estimate moves more than noise moves it; sigma is widened %.2g times for it",
            estimate->sigma_factor);
        show(f, "\"nis\": %.6g, \"sigma_factor\": %.4g", estimate->nis, estimate->sigma_factor);
    }
}

static void find_contact(const ipe_estimate_t* estimate, ipe_findings_t* found)
{
    if (!estimate->is_provisional) { return; }
    ipe_finding_t* f = add(found, "contact", IPE_SEVERITY_CARE, "wait until the payload hangs freely");
    say(f,
        "an announced payload is coming into contact: the estimate is the body before with the share carried so far");
}

static void find_impossible(const ipe_estimate_t* estimate, ipe_findings_t* found)
{
    if (estimate->n_windows == 0 || estimate->consistent || estimate->distance <= IMPOSSIBLE_CARE) { return; }
    const ipe_severity_t severity = estimate->distance > IMPOSSIBLE_STOP ? IPE_SEVERITY_STOP : IPE_SEVERITY_CARE;
    ipe_finding_t* f =
        add(found, "impossible_body", severity, "more excitation, or look for a mistake in geometry and sensor axes");
    say(f, "the estimate is not physically consistent; the nearest consistent body is shown, %.1f sigma away",
        sqrt(estimate->distance));
    show(f, "\"distance\": %.6g", estimate->distance);
}

static void find_broken_sensors(const ipe_estimator_t* e, const ipe_config_t* config, ipe_findings_t* found)
{
    for (int i = 0; i < config->n_cables && e->estimate.n_windows > 0; ++i) {
        if (!(e->estimate.unknown_force >> (unsigned)i & 1U)) { continue; }
        ipe_finding_t* f = add(found, "broken_force_sensor", IPE_SEVERITY_CARE,
                               "check this sensor: mounting, cable, zero, amplifier; then repeat the run");
        say(f, "force sensor %d has failed: the estimate goes on without it; by the others it should read %.4g N",
            i + 1, e->restored[i]);
        show(f, "\"cable\": %d, \"most_probable_force\": %.6g, \"windows\": %" PRIu64, i + 1, e->restored[i],
             e->n_unknown_force);
    }
}

/// The unit that people are shown for an SI unit, and the factor to it.
static const char* shown_unit(const char* si, double* factor)
{
    const struct {
        const char *si, *unit;
        double factor;
    } UNIT[] = {
        {"rad", "deg", DEGREES}, {"rad/s", "deg/s", DEGREES}, {"s", "ms", 1e3}, {"m", "mm", 1e3}, {"1", "%", 1e2}};
    *factor = 1.0;
    for (size_t i = 0; i < sizeof UNIT / sizeof UNIT[0]; ++i) {
        if (strcmp(si, UNIT[i].si) == 0) {
            *factor = UNIT[i].factor;
            return UNIT[i].unit;
        }
    }
    return si;
}

static void add_correction(int index, double value, double far, int n_cables, ipe_findings_t* found)
{
    int n, first = 0;
    double factor;
    char name[IPE_SYSTEMATIC_NAME_MAX];
    const ipe_systematic_kind_t* kind = ipe_systematic_table(&n);
    while (first + kind->count + kind->count_per_cable * n_cables <= index) {
        first += kind->count + kind->count_per_cable * n_cables;
        ++kind;
    }
    const char* unit = shown_unit(kind->unit, &factor);
    ipe_systematic_name(n_cables, index, name);
    ipe_finding_t* f =
        add(found, "correction_beyond_prior", IPE_SEVERITY_CARE,
            "look at this sensor, or correct its [std] in robot.toml; inertiactl calibrate keeps what was "
            "found");
    say(f, "%s = %.3g %s: %.0f times the standard deviation stated for it", name, factor * value, unit, far);
    show(f, "\"parameter\": \"%s\", \"value\": %.6g, \"prior_sigmas\": %.4g", name, value, far);
}

/// The furthest first. All cables have one friction: it counts once.
static void find_corrections(const ipe_estimate_t* estimate, const ipe_config_t* config, ipe_findings_t* found)
{
    double std[IPE_XI_MAX], last = INFINITY;
    const int n = IPE_XI_FORCE + 2 * config->n_cables + 1;
    if (estimate->n_windows < START_WINDOWS) { return; }
    ipe_systematic_std(config, std);
    for (int k = 0; k < NAMED_MOST; ++k) {
        int furthest = -1;
        double most = FAR;
        for (int i = 0; i < n; ++i) {
            const double far = std[i] > 0.0 ? fabs(estimate->systematic[i]) / std[i] : 0.0;
            if (far > most && far < last) { furthest = i, most = far; }
        }
        if (furthest < 0) { return; }
        add_correction(furthest, estimate->systematic[furthest], most, config->n_cables, found);
        last = most;
    }
}

static void find_unobservable(const ipe_estimate_t* estimate, ipe_findings_t* found)
{
    static const char* const NAME[IPE_NP] = {"mass", "cog x", "cog y", "cog z", "J xx",
                                             "J yy", "J zz",  "J yz",  "J xz",  "J xy"};
    char names[96] = "", quoted[128] = "";
    size_t n = 0, n_quoted = 0;
    for (int i = 0; i < IPE_NP && estimate->n_windows > 0; ++i) {
        if (estimate->observable[i]) { continue; }
        const char* separator = n > 0 ? ", " : "";
        n += (size_t)snprintf(names + n, sizeof names - n, "%s%s", separator, NAME[i]);
        n_quoted += (size_t)snprintf(quoted + n_quoted, sizeof quoted - n_quoted, "%s\"%s\"", separator, NAME[i]);
    }
    if (n == 0) { return; }
    ipe_finding_t* f =
        add(found, "poorly_observable", IPE_SEVERITY_CARE,
            "turn the platform faster about all axes: inertiactl excite ROBOT -o excite.csv plans such a motion");
    say(f, "poorly observable in this motion: %s; the sigma is more than half of the prior's", names);
    show(f, "\"parameters\": [%s]", quoted);
}

static void find_changes(const ipe_estimate_t* estimate, ipe_findings_t* found)
{
    if (estimate->n_changes == 0) { return; }
    ipe_finding_t* f = add(found, "payload_changed", IPE_SEVERITY_GOOD, "");
    say(f, "payload changes: %" PRIu64 "; the numbers are those of the last payload", estimate->n_changes);
    show(f, "\"changes\": %" PRIu64, estimate->n_changes);
}

/// Insertion sort: equally bad ones stay in order.
static void put_worst_first(ipe_findings_t* found)
{
    for (int i = 1; i < found->n; ++i) {
        const ipe_finding_t moved = found->item[i];
        int at = i;
        for (; at > 0 && found->item[at - 1].severity < moved.severity; --at) { found->item[at] = found->item[at - 1]; }
        found->item[at] = moved;
    }
}

void ipe_findings_of(const ipe_estimator_t* e, const ipe_config_t* config, ipe_findings_t* found)
{
    memset(found, 0, sizeof *found);
    find_start(&e->estimate, found);
    find_misfit(&e->estimate, found);
    find_contact(&e->estimate, found);
    find_impossible(&e->estimate, found);
    find_broken_sensors(e, config, found);
    find_corrections(&e->estimate, config, found);
    find_unobservable(&e->estimate, found);
    find_changes(&e->estimate, found);
    put_worst_first(found);
}

ipe_severity_t ipe_findings_verdict(const ipe_findings_t* found)
{
    return found->n > 0 ? found->item[0].severity : IPE_SEVERITY_GOOD;
}

bool ipe_findings_has_converged(const ipe_estimator_t* e)
{
    return e->estimate.n_windows >= START_WINDOWS && !e->estimate.is_misfit;
}
