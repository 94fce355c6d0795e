// SPDX-License-Identifier: Apache-2.0
#include "command_handler.h"

#include "config_diff.h"
#include "data_path.h"
#include "health.h"
#include "message.h"

#include "inertiad_lcm_expectation_t.h"
#include "inertiad_lcm_order_item_t.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

typedef struct {
    bool is_done;
    char text[REASON_SIZE];
} answer_t;

static answer_t answer(bool is_done, const char* format, ...) __attribute__((format(printf, 2, 3)));

static answer_t answer(bool is_done, const char* format, ...)
{
    answer_t a = {.is_done = is_done};
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(a.text, sizeof a.text, format, arguments);
    va_end(arguments);
    return a;
}

static answer_t freeze(daemon_t* d, bool is_frozen)
{
    const uint64_t n = d->pipeline->estimator.estimate.n_windows;
    const char* state = is_frozen ? "frozen" : "learning";
    if (d->pipeline->is_frozen == is_frozen) { return answer(true, "%s already, %" PRIu64 " windows", state, n); }
    ipe_publish_order(&d->publisher, is_frozen ? IPE_COMMAND_FREEZE : IPE_COMMAND_RESUME, daemon_now(d), NULL);
    ipe_pipeline_freeze(d->pipeline, is_frozen);
    return answer(true, "%s after %" PRIu64 " windows", state, n);
}

static answer_t reset(daemon_t* d)
{
    const uint64_t n = d->pipeline->estimator.estimate.n_windows;
    ipe_publish_order(&d->publisher, IPE_COMMAND_RESET, daemon_now(d), NULL);
    health_carry(d, d->pipeline);
    ipe_pipeline_reset(d->pipeline);
    health_carried(d, d->pipeline);
    d->n_changes_reported = d->pipeline->estimator.change_detector.n_changes;
    return answer(true, "%" PRIu64 " windows discarded; starting from the prior%s", n,
                  d->pipeline->is_frozen ? " after resume" : "");
}

/// Publish and record with the configuration now in use.
static void publish_config(daemon_t* d)
{
    ipe_publish_configure(&d->publisher, &d->config);
    ipe_publish_received(&d->publisher, IPE_PUBLISH_CONFIG, daemon_now(d), d->config_bytes, d->n_config_bytes);
}

static answer_t tare(daemon_t* d)
{
    double bias[3];
    const double* was = d->config.gyro_bias;
    const char* reason = ipe_rest_detector_read(&d->rest, daemon_now(d), bias);
    if (reason != NULL) { return answer(false, "%s", reason); }
    const answer_t a = answer(true, "gyro_bias = [%.6f, %.6f, %.6f] rad/s, was [%.6f, %.6f, %.6f]", bias[0], bias[1],
                              bias[2], was[0], was[1], was[2]);
    daemon_set_gyro_bias(d, bias);
    ipe_publish_order(&d->publisher, IPE_COMMAND_TARE, daemon_now(d), bias);
    ipe_pipeline_set_gyro_bias(d->pipeline, bias);
    publish_config(d);
    return a;
}

/// Replace the pipeline in use by next, which was initialised with the new configuration.
static void switch_pipeline(daemon_t* d, ipe_pipeline_t* next, bool keeps_learnt)
{
    ipe_pipeline_t* last = d->pipeline;
    ipe_publish_order(&d->publisher, IPE_COMMAND_CONFIGURE, daemon_now(d), NULL);
    data_path_flush(d);  // rows that wait belong to the last pipeline
    health_carry(d, last);
    if (keeps_learnt) { ipe_pipeline_continue(next, &last->estimator, last->config.gyro_bias); }
    ipe_pipeline_freeze(next, last->is_frozen);
    d->pipeline = next;
    health_carried(d, next);
    d->n_changes_reported = next->estimator.change_detector.n_changes;
}

static answer_t configure(daemon_t* d, const ipe_command_t* command)
{
    char text[REASON_SIZE];
    ipe_config_t config;
    memset(&config, 0, sizeof config);  // padding between fields is compared, too
    ipe_pipeline_t* next = &d->pipelines[d->pipeline == &d->pipelines[0] ? 1 : 0];
    if (ipe_config_from_bytes(command->config, command->n_config, &config, text, sizeof text) != IPE_OK ||
        !daemon_can_use(d, &config, text, sizeof text)) {
        return answer(false, "%s", text);
    }
    const ipe_config_diff_t difference = ipe_config_diff_compare(&d->config, &config, text, sizeof text);
    if (difference == IPE_CONFIG_DIFF_SAME) { return answer(true, "the same configuration, nothing changed"); }
    char reason[REASON_SIZE];
    if (ipe_pipeline_init(next, &config, reason, sizeof reason) != IPE_OK) { return answer(false, "%s", reason); }
    switch_pipeline(d, next, difference == IPE_CONFIG_DIFF_LEARNT_HOLDS);
    d->config = config;
    memcpy(d->config_bytes, command->config, command->n_config);
    d->n_config_bytes = command->n_config - IPE_CONFIG_CRC_BYTES;
    ipe_rest_detector_init(&d->rest);
    publish_config(d);
    if (d->option.checkpoint != NULL) { ipe_checkpoint_configure(&d->checkpoint, d->config_bytes, d->n_config_bytes); }
    const char* rejecting = NULL;
    for (unsigned i = 0; i < d->n_interfaces; ++i) {
        if (ipe_source_socketcan_filter(&d->interface[i], &d->config) != 0) { rejecting = d->interface[i].interface; }
    }
    return answer(true, "%s changed; %s%s%s", text,
                  difference == IPE_CONFIG_DIFF_LEARNT_HOLDS ? "the learnt state stays" : "starting from the prior",
                  rejecting == NULL ? "" : "; frames with the new identifiers are not received on ",
                  rejecting == NULL ? "" : rejecting);
}

static answer_t expect(daemon_t* d, const ipe_command_t* command)
{
    ipe_expectation_t expected;
    char text[REASON_SIZE];
    if (ipe_command_expectation(command, &expected) != 0) {
        return answer(false, "its content is no expectation_t of this version");
    }
    const ipe_announcement_t* before = d->pipeline->announcement;
    const bool replaces = before != NULL && before->state == IPE_ANNOUNCEMENT_WAITS;
    const int64_t now_ns = daemon_now(d);
    // the time of recorded input is another one
    const int64_t sent_ns = d->n_interfaces > 0 ? ipe_host_clock_map(&d->clock, command->t_ns) : now_ns;
    if (ipe_command_contact(command, &expected, sent_ns, &expected.t_ns) != 0) {
        return answer(false, "t_ns: is no host time; allowed: 0 to %" PRId64 " s, in ns",
                      (int64_t)IPE_TIME_MAX_NS / NS_PER_S);
    }
    const double ahead = 1e-9 * (double)(expected.t_ns - now_ns);
    enum { PAST = INERTIAD_LCM_EXPECTATION_T_PAST_MAX, AHEAD = INERTIAD_LCM_EXPECTATION_T_AHEAD_MAX };
    if (!(ahead >= -PAST && ahead <= AHEAD)) {
        return answer(false, "t_ns: %.3f s from now; allowed: %d to %d s", ahead, -PAST, AHEAD);
    }
    if (ipe_pipeline_expect(d->pipeline, &d->announcement, expected.number, expected.t_ns, text, sizeof text) !=
        IPE_OK) {
        return answer(false, "%s", text);
    }
    ipe_publish_expectation(&d->publisher, now_ns, &expected);
    d->announcement_reported = d->announcement.state;
    return answer(true, "%.4g +- %.2g kg in %.3f s%s", expected.number[0], expected.number[1], ahead,
                  replaces ? "; replaces the payload announced before" : "");
}

/// True if text is UTF-8 without control characters: it goes to terminals and into the record.
static bool is_printable(const char* text)
{
    static const uint32_t LEAST[] = {0, 0x80, 0x800, 0x10000};  // by the number of bytes that follow the first
    for (const uint8_t* at = (const uint8_t*)text; *at != 0;) {
        const int n = *at < 0x80 ? 0 : *at < 0xC0 ? -1 : *at < 0xE0 ? 1 : *at < 0xF0 ? 2 : *at < 0xF8 ? 3 : -1;
        if (n < 0) { return false; }
        uint32_t code = n == 0 ? *at : *at & (0x3FU >> n);
        ++at;
        for (int i = 0; i < n; ++i, ++at) {
            if ((*at & 0xC0U) != 0x80) { return false; }
            code = (code << 6) | (*at & 0x3FU);
        }
        const bool is_control = code < 0x20 || (code >= 0x7F && code < 0xA0) || code == 0x2028 || code == 0x2029;
        if (is_control || code < LEAST[n] || code > 0x10FFFF || (code >= 0xD800 && code < 0xE000)) { return false; }
    }
    return true;
}

static answer_t mark(const char* text)
{
    if (text[0] == '\0' || strlen(text) > IPE_COMMAND_TEXT_MAX) {
        return answer(false, "the text of a mark must have 1 to %d bytes", IPE_COMMAND_TEXT_MAX);
    }
    if (!is_printable(text)) { return answer(false, "the text of a mark must be one line of UTF-8"); }
    return answer(true, "%s", text);
}

/// True if the command is new. A repeated one gets no answer: its sender has one, and nobody else asked.
static bool is_new(daemon_t* d, const ipe_command_t* command, answer_t* a)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_REALTIME, &now);
    const int64_t now_ns = (int64_t)now.tv_sec * NS_PER_S + now.tv_nsec;
    const int limit = (int)(IPE_COMMAND_AGE_MAX / NS_PER_S);
    if (d->replay.is_lock_step) { return true; }  // its stamps are data time
    const int64_t listened_ns = ipe_host_clock_now(&d->clock) - d->listening_ns;
    switch (ipe_command_guard_check(&d->command_guard, command, now_ns, listened_ns)) {
    case IPE_COMMAND_OLD:
        d->n_commands_old++;
        *a = answer(false, "sent more than %d s ago by its time stamp; set the clocks of both hosts", limit);
        return false;
    case IPE_COMMAND_EARLY:
        d->n_commands_old++;
        *a =
            answer(false, "sent before the daemon began to listen by its time stamp; send it again, and set the clocks "
                          "of both hosts");
        return false;
    case IPE_COMMAND_AHEAD:
        d->n_commands_old++;
        *a = answer(false, "sent more than %d s in the future by its time stamp; set the clocks of both hosts", limit);
        return false;
    case IPE_COMMAND_REPEATED:
        d->n_commands_repeated++;
        *a = answer(false, "carried out before");
        return false;
    case IPE_COMMAND_TOO_MANY:
        *a = answer(false, "%d commands within %d s; send fewer", IPE_COMMANDS_KEPT, limit);
        return false;
    case IPE_COMMAND_NEW:
    default: return true;
    }
}

static answer_t execute(daemon_t* d, const ipe_command_t* command)
{
    switch (command->kind) {
    case IPE_COMMAND_FREEZE: return freeze(d, true);
    case IPE_COMMAND_RESUME: return freeze(d, false);
    case IPE_COMMAND_RESET: return reset(d);
    case IPE_COMMAND_TARE: return tare(d);
    case IPE_COMMAND_CONFIGURE: return configure(d, command);
    case IPE_COMMAND_MARK: return mark(command->text);
    case IPE_COMMAND_EXPECT: return expect(d, command);
    default: return answer(false, "unknown kind of command: %d", command->kind);
    }
}

static const char* name_of(int kind)
{
    static const char* const NAME[] = {"command", "freeze", "resume", "reset", "tare", "configure", "mark", "expect"};
    return NAME[kind >= IPE_COMMAND_FREEZE && kind <= IPE_COMMAND_EXPECT ? kind : 0];
}

void command_handler_execute(daemon_t* d, const ipe_inbox_item_t* item)
{
    char text[REASON_SIZE];
    const ipe_command_t* command = &item->command;
    ipe_publish_received(&d->publisher, IPE_PUBLISH_COMMAND, daemon_now(d), item->data, item->n);
    const uint64_t n_repeated = d->n_commands_repeated;
    answer_t a;
    if (is_new(d, command, &a)) { a = execute(d, command); }
    d->n_commands_done += a.is_done ? 1 : 0;
    d->n_commands_refused += a.is_done ? 0 : 1;
    (void)snprintf(text, sizeof text, "%s %s: %.*s", name_of(command->kind), a.is_done ? "done" : "refused",
                   REASON_SIZE - 32, a.text);
    if (a.is_done || ipe_message_allowed(&d->command_limit, "command")) { ipe_message("%s", text); }
    if (d->n_commands_repeated != n_repeated) { return; }
    ipe_publish_answer(&d->publisher, daemon_now(d), command, a.is_done, text);
}
