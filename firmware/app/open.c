// SPDX-License-Identifier: Apache-2.0
#include "open.h"

#include "estimate_file.h"
#include "lock.h"
#include "loop.h"
#include "message.h"
#include "output_files.h"
#include "realtime.h"
#include "url.h"

#include <errno.h>
#include <limits.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/signalfd.h>
#include <unistd.h>

enum { RECORD_LIMIT_MAX = 1000000 };
static const char TRACKER_HOST[] = "lcm", TRACKER_NETWORK[] = "lcm:network";
static const double SPEED_MAX = 1e6;
static const double FASTEST_BUS = 30000.0;  // frames/s: CAN FD, no data
static const double COLLECT_SHARE = 0.5;    // of a receive buffer, filled by frames that gather
static const int64_t WATCHDOG_MIN_NS = 2 * NS_PER_S;

static bool is_interface_address(const char* address)
{
    return strncmp(address, "socketcan:", strlen("socketcan:")) == 0;
}

/// Refuse what may work later: a disk that is full or read-only, a file that another daemon holds, a network that is not up.
static int refuse_for_now(daemon_t* d, const char* name, const char* reason)
{
    d->can_retry = true;
    return daemon_refuse(name, reason);
}

/// True if positions come as TRACKER messages.
static bool is_tracker_lcm(const daemon_t* d)
{
    const char* address = d->option.tracker;
    return address == NULL || strcmp(address, TRACKER_HOST) == 0 || strcmp(address, TRACKER_NETWORK) == 0;
}

/// All recorded or all live.
static int check_buses(const daemon_t* d)
{
    for (unsigned i = 1; i < d->option.n_buses; ++i) {
        if (is_interface_address(d->option.bus[i]) == is_interface_address(d->option.bus[0])) { continue; }
        return daemon_refuse("--bus", "files and interfaces cannot be mixed: their times differ");
    }
    if (is_interface_address(d->option.bus[0]) && !is_tracker_lcm(d)) {
        return daemon_refuse("--tracker",
                             "a file cannot go with interfaces: their times differ; send TRACKER over LCM");
    }
    return 0;
}

/// speed= of one file; all files that give one must agree.
static int read_speed(daemon_t* d, const char* text)
{
    static const char* given;
    char* end;
    const double speed = strtod(text, &end);
    if (end == text || *end != '\0' || !(speed >= 0.0 && speed <= SPEED_MAX)) {
        return daemon_refuse("--bus", "speed= must be a number from 0 to 1e6");
    }
    if (given != NULL && speed != d->replay.speed) {
        return daemon_refuse("--bus", "speed= must be the same for all files");
    }
    given = text;
    d->replay.speed = speed;
    return 0;
}

static bool is_stdin_taken(const daemon_t* d)
{
    for (unsigned i = 0; i < d->replay.n_buses; ++i) {
        if (d->replay.bus[i].lines.fd == STDIN_FILENO) { return true; }
    }
    return false;
}

static int open_log(daemon_t* d, const ipe_url_t* url)
{
    const unsigned i = d->replay.n_buses;
    const char* speed = ipe_url_option(url, "speed");
    if (speed != NULL && read_speed(d, speed) != 0) { return -1; }
    if (strcmp(url->path, "-") == 0 && is_stdin_taken(d)) {
        return daemon_refuse("--bus", "file:- can be given once only");
    }
    if (ipe_source_file_open(&d->replay.bus[i], url->path, (uint8_t)i, ipe_url_option(url, "interface")) != 0) {
        return daemon_refuse(url->path, strerror(errno));
    }
    d->replay.n_buses++;
    return 0;
}

static int open_interface(daemon_t* d, const ipe_url_t* url)
{
    char reason[REASON_SIZE];
    const unsigned i = d->n_interfaces;
    const char* filter = ipe_url_option(url, "filter");
    if (filter != NULL && strcmp(filter, "on") != 0 && strcmp(filter, "off") != 0) {
        return daemon_refuse("--bus", "filter= must be on or off");
    }
    const bool is_filtered = filter == NULL || strcmp(filter, "on") == 0;
    if (ipe_source_socketcan_open(&d->interface[i], url->path, (uint8_t)i, is_filtered ? &d->config : NULL, reason,
                                  sizeof reason) != 0) {
        return daemon_refuse("--bus", reason);
    }
    d->interface_was_up[i] = d->interface[i].is_up;
    d->n_interfaces++;
    return 0;
}

static int open_bus(daemon_t* d, char* address)
{
    ipe_url_t url;
    char reason[REASON_SIZE];
    const bool is_interface = is_interface_address(address);
    if (!ipe_url_parse(&url, address, "file socketcan", is_interface ? "filter" : "speed interface", reason,
                       sizeof reason)) {
        return daemon_refuse("--bus", reason);
    }
    return is_interface ? open_interface(d, &url) : open_log(d, &url);
}

static int open_buses(daemon_t* d)
{
    for (unsigned i = 0; i < d->option.n_buses; ++i) {
        if (open_bus(d, d->option.bus[i]) != 0) { return -1; }
    }
    return 0;
}

/// A simulator on stdin has as many buses as the signals need, and the positions.
static int open_lock_step(daemon_t* d)
{
    if (ipe_lock_step_open(&d->replay.lock_step) != 0) { return daemon_refuse("--lock-step", strerror(errno)); }
    d->replay.is_lock_step = true;
    d->replay.has_tracker = d->config.position_source == IPE_POSITION_TRACKER;
    d->option.n_buses = 1;
    for (int i = 0; i < d->config.n_signals; ++i) {
        const unsigned n = (unsigned)d->config.signal[i].bus + 1;
        if (n > d->option.n_buses) { d->option.n_buses = n; }
    }
    for (unsigned i = 0; i < d->option.n_buses; ++i) { d->replay.bus[i].path = "stdin"; }
    d->replay.n_buses = d->option.n_buses;
    ipe_publish_lock_step(&d->publisher, &d->replay.lock_step);
    return 0;
}

/// Frames gather for as long as was asked for, but not so long that a small receive buffer could run over.
static void set_collecting(daemon_t* d)
{
    double longest = d->n_interfaces > 0 ? d->option.collect : 0.0;
    for (unsigned i = 0; i < d->n_interfaces; ++i) {
        const double bearable = COLLECT_SHARE * ipe_source_socketcan_capacity(&d->interface[i]) / FASTEST_BUS;
        if (bearable >= longest) { continue; }
        longest = bearable;
        ipe_message("--collect: %g s, not %g: %s has room for %d frames only", longest, d->option.collect,
                    d->interface[i].interface, ipe_source_socketcan_capacity(&d->interface[i]));
    }
    d->collect_ns = (int64_t)(1e9 * longest);
}

static bool is_stopped(const daemon_t* d)
{
    struct pollfd stop = {.fd = d->signal_fd, .events = POLLIN};
    return poll(&stop, 1, 0) > 0;
}

static int open_tracker(daemon_t* d)
{
    ipe_url_t url;
    char reason[REASON_SIZE];
    if (is_tracker_lcm(d)) { return 0; }
    if (!ipe_url_parse(&url, d->option.tracker, "file", "", reason, sizeof reason)) {
        return daemon_refuse("--tracker", reason);
    }
    if (d->config.position_source != IPE_POSITION_TRACKER) {
        ipe_message("--tracker: not used, %s takes the position from elsewhere", d->option.config);
        return 0;
    }
    if (strcmp(url.path, "-") == 0 && is_stdin_taken(d)) {
        return daemon_refuse("--tracker", "stdin is taken by --bus file:-");
    }
    if (ipe_source_tracker_file_open(&d->replay.tracker, url.path, d->signal_fd, reason, sizeof reason) != 0) {
        d->is_done = is_stopped(d);
        return daemon_refuse("--tracker", reason);
    }
    d->replay.has_tracker = true;
    return 0;
}

/// rotate_mb= or rotate_s=; 0 when it is not given.
static int read_limit(const ipe_url_t* url, const char* key, uint64_t unit, uint64_t* limit)
{
    char reason[REASON_SIZE];
    char* end;
    const char* text = ipe_url_option(url, key);
    *limit = 0;
    if (text == NULL) { return 0; }
    const unsigned long value = strtoul(text, &end, 10);
    if (text[0] >= '0' && text[0] <= '9' && *end == '\0' && value >= 1 && value <= RECORD_LIMIT_MAX) {
        *limit = value * unit;
        return 0;
    }
    (void)snprintf(reason, sizeof reason, "%s= must be a whole number from 1 to %d", key, RECORD_LIMIT_MAX);
    return daemon_refuse("--record", reason);
}

static int open_record(daemon_t* d)
{
    static char address[PATH_MAX + REASON_SIZE];
    char reason[REASON_SIZE];
    ipe_url_t url;
    uint64_t bytes, us;
    const bool has_scheme = strncmp(d->option.record, "file:", strlen("file:")) == 0;
    if (snprintf(address, sizeof address, "%s%s", has_scheme ? "" : "file:", d->option.record) >= (int)sizeof address) {
        return daemon_refuse("--record", strerror(ENAMETOOLONG));
    }
    if (!ipe_url_parse(&url, address, "file", "rotate_mb rotate_s", reason, sizeof reason)) {
        return daemon_refuse("--record", reason);
    }
    if (read_limit(&url, "rotate_mb", 1000000, &bytes) != 0 || read_limit(&url, "rotate_s", 1000000, &us) != 0) {
        return -1;
    }
    const ipe_record_options_t o = {.path = url.path,
                                    .config_channel = d->publisher.channel[IPE_PUBLISH_CONFIG],
                                    .config_bytes = d->config_bytes,
                                    .n_config_bytes = d->n_config_bytes,
                                    .rotate_bytes = bytes,
                                    .rotate_us = (int64_t)us,
                                    .waits = d->n_interfaces == 0 && d->replay.speed == 0.0,
                                    .stop_fd = d->signal_fd};
    if (ipe_record_open(&d->recorder, &o, reason, sizeof reason) != 0) { return refuse_for_now(d, "--record", reason); }
    d->is_recording = true;
    ipe_publish_record(&d->publisher, &d->recorder);
    return 0;
}

/// Continue from the checkpoint if it fits; otherwise say why not and start cold.
static int open_checkpoint(daemon_t* d)
{
    char reason[REASON_SIZE];
    if (ipe_lock_file(d->option.checkpoint, reason, sizeof reason) < 0) {
        return refuse_for_now(d, "--checkpoint", reason);
    }
    if (ipe_checkpoint_open(&d->checkpoint, d->option.checkpoint, d->config_bytes, d->n_config_bytes, reason,
                            sizeof reason) != 0) {
        return refuse_for_now(d, "--checkpoint", reason);
    }
    const int status = ipe_checkpoint_load(&d->checkpoint, d->pipeline, reason, sizeof reason);
    d->n_changes_reported = d->pipeline->estimator.change_detector.n_changes;
    if (status < 0) { ipe_message("--checkpoint: %s", reason); }
    if (status > 0) {
        daemon_set_gyro_bias(d, d->pipeline->config.gyro_bias);
        ipe_message("--checkpoint: continuing from %s, %llu windows", d->option.checkpoint,
                    (unsigned long long)d->pipeline->estimator.estimate.n_windows);
    }
    return 0;
}

static int open_lcm(daemon_t* d)
{
    char reason[REASON_SIZE];
    if (ipe_publish_check_prefix(d->option.lcm_prefix, reason, sizeof reason) != 0) {
        return daemon_refuse("--lcm-prefix", reason);
    }
    const bool is_network = ipe_inbox_is_network(d->option.lcm);
    if (is_network) {
        struct sockaddr_in group;
        if (ipe_inbox_read_url(d->option.lcm, &group, reason, sizeof reason) != 0) {
            return daemon_refuse("--lcm", reason);
        }
        if (ipe_lock_channels(&group, d->option.lcm_prefix, reason, sizeof reason) < 0) {
            return refuse_for_now(d, "--lcm-prefix", reason);
        }
    }
    if (ipe_publish_open(&d->publisher, d->option.lcm, d->option.lcm_prefix, &d->config, reason, sizeof reason) != 0) {
        if (is_network) { return refuse_for_now(d, "--lcm", reason); }
        (void)snprintf(reason, sizeof reason, "%s: allowed: udpm://ADDRESS:PORT?ttl=N, none", d->option.lcm);
        return daemon_refuse("--lcm", reason);
    }
    const bool is_tracker_remote = d->option.tracker != NULL && strcmp(d->option.tracker, TRACKER_NETWORK) == 0;
    const ipe_inbox_options_t o = {
        .url = d->option.lcm,
        .tracker = d->publisher.channel[IPE_PUBLISH_TRACKER],
        .command = d->publisher.channel[IPE_PUBLISH_COMMAND],
        .tracker_from = is_tracker_remote ? IPE_INBOX_ORIGIN_NETWORK : IPE_INBOX_ORIGIN_HOST,
        .command_from = d->option.commands,
    };
    d->listening_ns = ipe_host_clock_now(&d->clock);
    if (ipe_inbox_open(&d->inbox, &o, reason, sizeof reason) != 0) { return refuse_for_now(d, "--lcm", reason); }
    return 0;
}

static bool is_ignored(int number)
{
    struct sigaction action;
    return sigaction(number, NULL, &action) == 0 && action.sa_handler == SIG_IGN;
}

/// All these signals mean: end. They arrive through a descriptor. Blocked before LCM starts its thread, which inherits it.
static int open_signals(daemon_t* d)
{
    static const int ENDING[] = {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGALRM, SIGXCPU, SIGXFSZ};
    sigset_t set;
    sigemptyset(&set);
    for (size_t i = 0; i < sizeof ENDING / sizeof ENDING[0]; ++i) {
        if (ENDING[i] != SIGHUP || !is_ignored(SIGHUP)) { sigaddset(&set, ENDING[i]); }  // ignored: nohup
    }
    (void)signal(SIGPIPE, SIG_IGN);
    if (sigprocmask(SIG_BLOCK, &set, NULL) != 0) { return -1; }
    d->signal_fd = signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
    return d->signal_fd < 0 ? -1 : 0;
}

static int open_config(daemon_t* d)
{
    char reason[REASON_SIZE];
    const ssize_t n = ipe_config_read(d->option.config, d->config_bytes);
    if (n < 0) {
        (void)snprintf(reason, sizeof reason, "%s: %s", d->option.config, strerror(errno));
        return daemon_refuse("--config", reason);
    }
    if (ipe_config_from_bytes(d->config_bytes, (size_t)n, &d->config, reason, sizeof reason) != IPE_OK) {
        ipe_message("--config: %s: %s", d->option.config, reason);
        return -1;
    }
    d->n_config_bytes = (size_t)n - IPE_CONFIG_CRC_BYTES;
    return 0;
}

/// Last, when every other thread has been started with ordinary scheduling.
static int open_real_time(const daemon_t* d)
{
    char reason[REASON_SIZE];
    if (d->option.cpu >= 0 && ipe_realtime_pin(d->option.cpu, reason, sizeof reason) != 0) {
        return daemon_refuse("--cpu", reason);
    }
    if (d->option.priority > 0 && ipe_realtime_start(d->option.priority, reason, sizeof reason) != 0) {
        return daemon_refuse("--rt", reason);
    }
    return 0;
}

/// Whoever started us may want to know how we are; that alone is no reason not to run.
static void open_notify(daemon_t* d)
{
    if (ipe_notify_open(&d->notify) != 0) { ipe_message("NOTIFY_SOCKET: %s; going on without", strerror(errno)); }
    if (d->notify.watchdog_ns > 0 && d->notify.watchdog_ns < WATCHDOG_MIN_NS) {
        ipe_message("WatchdogSec=%.3g s: it is fed once a second only; make it 2 s or more",
                    (double)d->notify.watchdog_ns / (double)NS_PER_S);
    }
}

/// Facts that later explain the stamps, as they are once everything is set.
static void read_facts(daemon_t* d)
{
    char name[IPE_FACT_NAME_MAX];
    ipe_host_facts_read(&d->facts);
    for (unsigned i = 0; i < d->n_interfaces; ++i) {
        const ipe_source_socketcan_t* s = &d->interface[i];
        ipe_host_facts_read_interface(&d->facts, s->interface);
        (void)snprintf(name, sizeof name, "%s.receive_buffer", s->interface);
        ipe_host_facts_add(&d->facts, name, "%d B", s->receive_buffer);
    }
}

int daemon_open(daemon_t* d)
{
    char reason[REASON_SIZE];
    d->pipeline = &d->pipelines[0];
    ipe_rest_detector_init(&d->rest);
    ipe_host_clock_init(&d->clock, clock_gettime);
    open_notify(d);
    if (output_files_check(d) != 0 || open_config(d) != 0) { return -1; }
    if (ipe_pipeline_init(d->pipeline, &d->config, reason, sizeof reason) != IPE_OK) {
        return daemon_refuse(d->option.config, reason);
    }
    if (d->option.estimate != NULL && !ipe_estimate_file_check(d->option.estimate, reason, sizeof reason)) {
        return daemon_refuse("--estimate", reason);
    }
    if (open_signals(d) != 0) { return daemon_refuse("signals", strerror(errno)); }
    if (d->option.is_lock_step
            ? open_lcm(d) != 0 || open_lock_step(d) != 0
            : check_buses(d) != 0 || open_buses(d) != 0 || open_lcm(d) != 0 || open_tracker(d) != 0) {
        return -1;
    }
    set_collecting(d);
    if (!daemon_can_use(d, &d->config, reason, sizeof reason)) { return daemon_refuse(d->option.config, reason); }
    if (d->option.checkpoint != NULL && open_checkpoint(d) != 0) { return -1; }
    if (d->option.record != NULL && open_record(d) != 0) { return -1; }
    if (loop_open(d) != 0 || open_real_time(d) != 0) { return -1; }
    read_facts(d);
    return 0;
}
