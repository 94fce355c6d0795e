// SPDX-License-Identifier: Apache-2.0
#include "estimate_file.h"

#include "atomic_file.h"
#include "findings.h"

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/// Text being built; is_full once something did not fit.
typedef struct {
    size_t n;
    bool is_full;
    char text[49152];
} text_t;

__attribute__((format(printf, 2, 3))) static void put(text_t* t, const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    const int n = vsnprintf(t->text + t->n, sizeof t->text - t->n, format, arguments);
    va_end(arguments);
    if (n < 0 || (size_t)n >= sizeof t->text - t->n) {
        t->is_full = true;
    } else {
        t->n += (size_t)n;
    }
}

static void put_vector(text_t* t, const double* value, int n)
{
    put(t, "[");
    for (int i = 0; i < n; ++i) { put(t, "%s%.17g", i > 0 ? ", " : "", value[i]); }
    put(t, "]");
}

static void put_quantity(text_t* t, const char* name, const double* value, const double* std, int n)
{
    put(t, "  \"%s\": {\"value\": ", name);
    put_vector(t, value, n);
    put(t, ", \"std\": ");
    put_vector(t, std, n);
    put(t, "},\n");
}

static void put_body(text_t* t, const ipe_body_t* body)
{
    put(t, "  \"mass\": {\"value\": %.17g, \"std\": %.17g},\n", body->mass, body->mass_std);
    put_quantity(t, "cog", body->cog, body->cog_std, 3);
    put_quantity(t, "inertia_cog", body->inertia_cog, body->inertia_cog_std, 6);
}

static void put_observable(text_t* t, const bool observable[IPE_NP])
{
    put(t, "  \"observable\": {\"mass\": %s", observable[0] ? "true" : "false");
    for (int i = 1; i < IPE_NP; ++i) {
        put(t, "%s%s",
            i == 1   ? ", \"cog\": ["
            : i == 4 ? "], \"inertia_cog\": ["
                     : ", ",
            observable[i] ? "true" : "false");
    }
    put(t, "]},\n");
}

/// Sensor errors: the configured calibration with the estimated correction. The alignment and the delay turn or shift what
/// is configured elsewhere, so they are given as corrections.
static void put_systematic(text_t* t, const ipe_estimate_t* e, const ipe_config_t* k)
{
    const struct {
        const char* name;
        const double* value;
        int count;
    } configured[] = {
        {"attitude_bias", k->attitude_bias, 3},
        {"world_yaw", &k->world_yaw, 1},
        {"acc_bias", k->acc_bias, 3},
        {"gyro_bias", k->gyro_bias, 3},
        {"force_offset", k->force_offset, k->n_cables},
        {"force_gain", k->force_gain, k->n_cables},
        {"imu_position", k->imu_position, 3},
        {"tracker_target", k->tracker_target, 3},
    };
    int n_kinds, first = 0;
    const ipe_systematic_kind_t* kinds = ipe_systematic_table(&n_kinds);
    for (const ipe_systematic_kind_t* kind = kinds; kind < kinds + n_kinds; ++kind) {
        const int count = kind->count + kind->count_per_cable * k->n_cables, at = first;
        double value[IPE_CABLES_MAX];
        first += count;
        if (e->systematic_std[at] == 0.0) { continue; }  // not estimated
        memcpy(value, &e->systematic[at], sizeof(double) * (size_t)count);
        for (size_t i = 0; i < sizeof configured / sizeof configured[0]; ++i) {
            if (strcmp(configured[i].name, kind->name) != 0) { continue; }
            for (int j = 0; j < configured[i].count; ++j) { value[j] += configured[i].value[j]; }
        }
        put_quantity(t, kind->name, value, &e->systematic_std[at], count);
    }
}

static void put_estimate(text_t* t, const ipe_estimate_t* estimate, const ipe_config_t* config)
{
    put_body(t, &estimate->body);
    put_systematic(t, estimate, config);
    put(t, "  \"consistent\": %s,\n", estimate->consistent ? "true" : "false");
    put_observable(t, estimate->observable);
    put(t, "  \"changes\": %" PRIu64 ",\n", estimate->n_changes);
    put(t, "  \"is_misfit\": %s,\n", estimate->is_misfit ? "true" : "false");
    put(t, "  \"sigma_factor\": %.17g,\n", estimate->sigma_factor);
}

static void put_no_estimate(text_t* t)
{
    put(t, "  \"mass\": null,\n  \"cog\": null,\n  \"inertia_cog\": null,\n  \"consistent\": false,\n");
    put(t, "  \"observable\": {\"mass\": false, \"cog\": [false, false, false], ");
    put(t, "\"inertia_cog\": [false, false, false, false, false, false]},\n");
}

static void put_finding(text_t* t, const ipe_finding_t* f)
{
    put(t, "\n    {\"name\": \"%s\", \"severity\": \"%s\", \"says\": \"%s\",", f->name, ipe_severity_name(f->severity),
        f->says);
    put(t, " \"evidence\": {%s}, \"do\": \"%s\"}", f->evidence, f->remedy);
}

static void put_findings(text_t* t, const ipe_pipeline_t* p)
{
    ipe_findings_t found;
    ipe_findings_of(&p->estimator, &p->config, &found);
    put(t, "  \"converged\": %s,\n", ipe_findings_has_converged(&p->estimator) ? "true" : "false");
    put(t, "  \"verdict\": \"%s\",\n  \"findings\": [", ipe_severity_name(ipe_findings_verdict(&found)));
    for (int i = 0; i < found.n; ++i) {
        if (i > 0) { put(t, ","); }
        put_finding(t, &found.item[i]);
    }
    put(t, "%s],\n", found.n > 0 ? "\n  " : "");
}

static void put_counters(text_t* t, const ipe_counters_t* counters)
{
    put(t, "  \"counters\": {");
    for (unsigned i = 0; i < counters->n; ++i) {
        put(t, "%s\n    \"%s\": %" PRIu64, i > 0 ? "," : "", counters->item[i].name, counters->item[i].value);
    }
    put(t, "\n  }\n");
}

static void put_run(text_t* t, const ipe_run_t* run)
{
    const ipe_estimate_t* estimate = &run->pipeline->estimator.estimate;
    put(t, "{\n  \"method\": \"rls\",\n");
    if (estimate->n_windows > 0) {
        put_estimate(t, estimate, &run->pipeline->config);
    } else {
        put_no_estimate(t);
    }
    put_findings(t, run->pipeline);
    put(t,
        "  \"samples\": {\"frames\": %" PRIu64 ", \"used\": %" PRIu64 ", \"rejected\": %" PRIu64
        ", \"windows\": %" PRIu64 "},\n",
        run->n_frames, run->pipeline->estimator.n_rows, run->n_rejected, estimate->n_windows);
    put(t, "  \"duration_s\": %.17g,\n", run->duration);
    put_counters(t, run->counters);
    put(t, "}\n");
}

bool ipe_estimate_file_check(const char* path, char* message, size_t size)
{
    return ipe_atomic_file_check(path, message, size);
}

int ipe_estimate_file_write(const char* path, const ipe_run_t* run, char* message, size_t size)
{
    static text_t text;
    text.n = 0;
    text.is_full = false;
    put_run(&text, run);
    if (text.is_full) {
        (void)snprintf(message, size, "%s: the result is longer than %zu bytes", path, sizeof text.text);
        return -1;
    }
    return ipe_atomic_file_write(path, text.text, text.n, message, size);
}
