// SPDX-License-Identifier: Apache-2.0
#include "result.h"

#include "counter_table.h"
#include "findings.h"
#include "health.h"
#include "message.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/// Causes of the counters of buses and files that count lost input, beside those of the pipeline's table.
static const char* const LOST_INPUT[] = {
    "dropped_by_kernel",
    "dropped_by_logger",
    "controller_overruns",
    "bad_stamp",
    "bad_name",
    "bad_id",
    "bad_data",
    "bad_tail",
    "too_long",
    "cut",
    "refused",
    "bad_frame",
    "bad_position",
    "bad_time",
};

static const int DIGITS_MOST = 9;  ///< behind the point: a nanometre, a milligram

/// Digits behind the point that show two of a standard deviation.
static int digits_of(double std)
{
    if (!isfinite(std) || std <= 0.0) { return 3; }
    const int digits = 1 - (int)floor(log10(std));
    return digits < 0 ? 0 : digits > DIGITS_MOST ? DIGITS_MOST : digits;
}

static void print_quantity(const char* name, double value, double std, const char* unit, bool is_observable)
{
    const int digits = digits_of(std);
    ipe_message("%-5s  %12.*f +- %.*f %s%s", name, digits, value, digits, std, unit,
                is_observable ? "" : "  (hardly better than before the data)");
}

static void print_body(const daemon_t* d)
{
    static const char* const INERTIA[6] = {"J xx", "J yy", "J zz", "J yz", "J xz", "J xy"};
    static const char* const COG[3] = {"cog x", "cog y", "cog z"};
    const ipe_estimate_t* e = &d->pipeline->estimator.estimate;
    if (e->n_windows == 0) { return; }
    ipe_message("result of %" PRIu64 " windows, %" PRIu64 " samples:", e->n_windows, e->n_rows);
    print_quantity("mass", e->body.mass, e->body.mass_std, "kg", e->observable[0]);
    for (int i = 0; i < 3; ++i) {
        print_quantity(COG[i], e->body.cog[i], e->body.cog_std[i], "m", e->observable[1 + i]);
    }
    for (int i = 0; i < 6; ++i) {
        print_quantity(INERTIA[i], e->body.inertia_cog[i], e->body.inertia_cog_std[i], "kg m2", e->observable[4 + i]);
    }
}

/// Whether a counter counts what was lost or refused, for any cause but a clock or a tilt that settles.
static bool is_loss(const char* name)
{
    const char* cause = strrchr(name, '.');
    cause = cause != NULL ? cause + 1 : name;
    if (strcmp(cause, "unsettled") == 0) { return false; }
    const ipe_counter_t* counter;
    for (unsigned k = 0; (counter = ipe_counter_table(k)) != NULL; ++k) {
        if (strcmp(counter->name, name) == 0) { return counter->flags != 0 || strcmp(cause, "late") == 0; }
    }
    for (size_t k = 0; k < sizeof LOST_INPUT / sizeof *LOST_INPUT; ++k) {
        if (strcmp(cause, LOST_INPUT[k]) == 0) { return true; }
    }
    return false;
}

static void print_lost(const daemon_t* d)
{
    char text[REASON_SIZE] = "";
    size_t n = 0;
    for (unsigned i = 0; i < d->counters.n; ++i) {
        if (d->counters.item[i].value == 0 || !is_loss(d->counters.item[i].name)) { continue; }
        const int more = snprintf(text + n, sizeof text - n, "%s%s %" PRIu64, n > 0 ? ", " : "",
                                  d->counters.item[i].name, d->counters.item[i].value);
        if (more < 0 || (size_t)more >= sizeof text - n) {
            ipe_message("lost: %.*s and more, see the counters", (int)n, text);
            return;
        }
        n += (size_t)more;
    }
    ipe_message("lost: %s", n > 0 ? text : "nothing");
}

/// The verdict and what is not good, as inertiactl fit prints them.
static void print_verdict(const daemon_t* d)
{
    ipe_findings_t found;
    ipe_findings_of(&d->pipeline->estimator, &d->pipeline->config, &found);
    ipe_message("%s", ipe_severity_headline(ipe_findings_verdict(&found)));
    for (int i = 0; i < found.n; ++i) {
        const ipe_finding_t* f = &found.item[i];
        if (f->severity == IPE_SEVERITY_GOOD) { continue; }
        ipe_message("%s: %s; do: %s", ipe_severity_name(f->severity), f->says, f->remedy);
    }
}

/// The sensors without which nothing is identified, and of which no sample came.
static void print_missing(const daemon_t* d)
{
    static const char* const REMEDY[IPE_SENSOR_COUNT] = {
        "check [signals] and the bus",
        "check [signals] and the bus",
        "pass --tracker FILE, or publish TRACKER, as inertiactl record does",
    };
    if (d->pipeline->estimator.estimate.n_windows > 0) { return; }
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) {
        if (daemon_newest_sample(d, (ipe_sensor_t)s) == 0) {
            ipe_message("%s: no sample came; %s", health_sensor_name((ipe_sensor_t)s), REMEDY[s]);
        }
    }
}

void result_print(const daemon_t* d)
{
    print_body(d);
    print_lost(d);
    print_missing(d);
    print_verdict(d);
}
