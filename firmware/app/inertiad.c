// SPDX-License-Identifier: Apache-2.0
/// The daemon: arguments -> configuration -> open -> loop -> close.
///
/// One epoll set in one thread, beside it liblcm's receiving thread and the writers of record and checkpoint; all state in the statics
/// below, no heap after start but in liblcm's thread.
/// Exit status: 0 end of input, SIGTERM or SIGINT; 1 estimate, checkpoint or the record of a replay not written;
/// 2 could not start.
#include "checkpoint.h"
#include "config_file.h"
#include "counters.h"
#include "estimate_file.h"
#include "message.h"
#include "pipeline.h"
#include "publish.h"
#include "realtime.h"
#include "record.h"
#include "replay.h"
#include "source_socketcan.h"
#include "url.h"

#include <errno.h>
#include <getopt.h>
#include <limits.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/signalfd.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum { STATUS_GOOD = 0, STATUS_NOT_WRITTEN = 1, STATUS_USAGE = 2 };
enum {
    REASON_SIZE = 512,
    ITEMS_PER_TURN = 4096,
    BATCHES_PER_TURN = 16,
    RECORD_LIMIT_MAX = 1000000,
    CPUS_MAX = 1024,
    CHECKPOINT_TICKS = 5
};
static const int64_t NS_PER_S = 1000000000;
static const double SPEED_MAX = 1e6;

/// What woke the loop. Interfaces follow the last one: WAKE_BUS + index.
enum { WAKE_SIGNAL, WAKE_SECOND, WAKE_PACE, WAKE_INPUT, WAKE_LCM, WAKE_BUS };

static struct {
    const char* config;
    const char* estimate;
    const char* lcm;
    const char* lcm_prefix;
    const char* record;
    const char* checkpoint;
    int priority;  ///< 0: not real time
    int cpu;       ///< -1: any
    char* tracker;
    char* bus[IPE_BUSES_MAX];
    unsigned n_buses;
} option = {.lcm = "udpm://239.255.76.67:7667?ttl=0", .lcm_prefix = "INERTIAD_", .cpu = -1};

static ipe_config_t config;
static ipe_pipeline_t pipeline;
static uint8_t config_bytes[IPE_CONFIG_FILE_MAX];
static size_t n_config_bytes;  // without the CRC
static ipe_publish_t publisher;
static ipe_record_t recorder;
static bool is_recording;
static ipe_checkpoint_t checkpoint;
static int n_ticks;  // since the last checkpoint
static ipe_replay_t replay;
static ipe_source_socketcan_t interface[IPE_BUSES_MAX];
static unsigned n_interfaces;  // 0: recorded input
static bool interface_was_up[IPE_BUSES_MAX];
static ipe_counters_t counters;

static int epoll_fd = -1, signal_fd = -1, second_fd = -1, pace_fd = -1;
static bool is_done;
static bool is_replay_runnable;
static bool is_damage_reported;
static int64_t data_ns;        // host time of the newest frame or position, 0: none yet
static int64_t health_due_ns;  // data time of the next HEALTH
static bool was_health_sent;   // since the last tick of the second timer
static int64_t first_row_ns, last_row_ns;
static uint64_t n_changes_reported;
static uint64_t n_lost_reported;  // messages that the record lacks
static bool is_losing_record;     // since a tick ago

// ---- arguments ------------------------------------------------------------------------------------------------------

static const char USAGE[] =
    "usage: inertiad --config robot.cfg --bus ADDRESS [--bus ADDRESS ...] [options]\n"
    "Estimates mass, centre of gravity and inertia of a cable-driven platform from its CAN buses.\n"
    "\n"
    "  --config FILE       compiled robot description, made by: inertiactl compile robot.toml -o robot.cfg\n"
    "  --bus ADDRESS       one per bus, in the order of the description:\n"
    "      socketcan:can0[?filter=off]            a CAN interface; off: receive frames nothing is bound to, too\n"
    "      file:can.log[?speed=1][&interface=can0]  a candump log, file:- stdin; speed 0 (default): as fast as possible,\n"
    "                                             1: as recorded; interface: take the frames of this one only\n"
    "  --tracker file:FILE positions of the tracked point, CSV with the columns t,x,y,z; default: from LCM\n"
    "  --lcm URL           where to publish, none: nowhere; default udpm://239.255.76.67:7667?ttl=0\n"
    "  --lcm-prefix TEXT   of every channel; default INERTIAD_\n"
    "  --record FILE[?rotate_mb=N][&rotate_s=N]\n"
    "                      an LCM log of all that is published, with or without --lcm, the tracker and the configuration;\n"
    "                      an earlier FILE, and one that reached a limit, is moved to FILE.1, FILE.2, ...\n"
    "  --estimate FILE     write the result as JSON on exit\n"
    "  --checkpoint FILE   keep what was learnt, every 5 s and on exit, and continue from it\n"
    "  --rt PRIORITY       run as SCHED_FIFO, 1 to 99, with all memory locked\n"
    "  --cpu N             run on this processor only, from 0\n"
    "  -h, --help          this text\n"
    "\n"
    "example:\n"
    "  inertiad --config robot.cfg --bus file:run/can.log --tracker file:run/tracker.csv --estimate run/estimate.json\n";

static int usage_error(const char* name, const char* reason)
{
    ipe_message("%s: %s; inertiad -h shows how", name, reason);
    return -1;
}

static int add_bus(char* address)
{
    if (option.n_buses == IPE_BUSES_MAX) { return usage_error("--bus", "more than 8"); }
    option.bus[option.n_buses++] = address;
    return 0;
}

static int read_number(const char* name, const char* text, int minimum, int maximum, int* number)
{
    char reason[REASON_SIZE];
    char* end;
    const long value = strtol(text, &end, 10);
    if (text[0] >= '0' && text[0] <= '9' && *end == '\0' && value >= minimum && value <= maximum) {
        *number = (int)value;
        return 0;
    }
    (void)snprintf(reason, sizeof reason, "\"%s\" is not a whole number from %d to %d", text, minimum, maximum);
    return usage_error(name, reason);
}

static int take_option(int letter, const char* text)
{
    switch (letter) {
    case 'c': option.config = optarg; return 0;
    case 'b': return add_bus(optarg);
    case 't': option.tracker = optarg; return 0;
    case 'l': option.lcm = optarg; return 0;
    case 'p': option.lcm_prefix = optarg; return 0;
    case 'R': return read_number("--rt", optarg, 1, 99, &option.priority);
    case 'C': return read_number("--cpu", optarg, 0, CPUS_MAX - 1, &option.cpu);
    case 'k': option.checkpoint = optarg; return 0;
    case 'r': option.record = optarg; return 0;
    case 'e': option.estimate = optarg; return 0;
    case ':': return usage_error(text, "needs a value");
    default: return usage_error(text, "unknown or ambiguous option");
    }
}

/// 0: go on; 1: help was asked for and given; -1: not usable, said why.
static int read_arguments(int argc, char** argv)
{
    static const struct option LONG[] = {
        {"config", required_argument, NULL, 'c'},
        {"bus", required_argument, NULL, 'b'},
        {"tracker", required_argument, NULL, 't'},
        {"lcm", required_argument, NULL, 'l'},
        {"lcm-prefix", required_argument, NULL, 'p'},
        {"record", required_argument, NULL, 'r'},
        {"estimate", required_argument, NULL, 'e'},
        {"checkpoint", required_argument, NULL, 'k'},
        {"rt", required_argument, NULL, 'R'},
        {"cpu", required_argument, NULL, 'C'},
        {"help", no_argument, NULL, 'h'},
        {NULL, 0, NULL, 0},
    };
    int letter;
    while ((letter = getopt_long(argc, argv, ":h", LONG, NULL)) != -1) {
        if (letter == 'h') { return fputs(USAGE, stdout) < 0 ? -1 : 1; }
        if (take_option(letter, argv[optind - 1]) != 0) { return -1; }
    }
    if (optind < argc) { return usage_error(argv[optind], "belongs to no option"); }
    if (option.config == NULL) { return usage_error("--config", "missing"); }
    if (option.n_buses == 0) { return usage_error("--bus", "missing"); }
    return 0;
}

// ---- open -----------------------------------------------------------------------------------------------------------

/// Say what is wrong with an option's value.
static int refuse(const char* name, const char* reason)
{
    ipe_message("%s: %s", name, reason);
    return -1;
}

static bool is_interface_address(const char* address)
{
    return strncmp(address, "socketcan:", strlen("socketcan:")) == 0;
}

/// Every signal's bus must be there, and all buses recorded or all live.
static int check_buses(void)
{
    char reason[REASON_SIZE];
    for (int i = 0; i < config.n_signals; ++i) {
        if ((unsigned)config.signal[i].bus < option.n_buses) { continue; }
        (void)snprintf(reason, sizeof reason, "%s takes signals from bus %d, but only %u given", option.config,
                       config.signal[i].bus, option.n_buses);
        return refuse("--bus", reason);
    }
    for (unsigned i = 1; i < option.n_buses; ++i) {
        if (is_interface_address(option.bus[i]) == is_interface_address(option.bus[0])) { continue; }
        return refuse("--bus", "files and interfaces cannot be mixed: their times differ");
    }
    if (is_interface_address(option.bus[0]) && option.tracker != NULL) {
        return refuse("--tracker", "a file cannot go with interfaces: their times differ; send TRACKER over LCM");
    }
    return 0;
}

/// speed= of one file; all files that give one must agree.
static int read_speed(const char* text)
{
    static const char* given;
    char* end;
    const double speed = strtod(text, &end);
    if (end == text || *end != '\0' || !(speed >= 0.0 && speed <= SPEED_MAX)) {
        return refuse("--bus", "speed= must be a number from 0 to 1e6");
    }
    if (given != NULL && speed != replay.speed) { return refuse("--bus", "speed= must be the same for all files"); }
    given = text;
    replay.speed = speed;
    return 0;
}

static bool is_stdin_taken(void)
{
    for (unsigned i = 0; i < replay.n_buses; ++i) {
        if (replay.bus[i].lines.fd == STDIN_FILENO) { return true; }
    }
    return false;
}

static int open_log(const ipe_url_t* url)
{
    const unsigned i = replay.n_buses;
    const char* speed = ipe_url_option(url, "speed");
    if (speed != NULL && read_speed(speed) != 0) { return -1; }
    if (strcmp(url->path, "-") == 0 && is_stdin_taken()) { return refuse("--bus", "file:- can be given once only"); }
    if (ipe_source_file_open(&replay.bus[i], url->path, (uint8_t)i, ipe_url_option(url, "interface")) != 0) {
        return refuse(url->path, strerror(errno));
    }
    replay.n_buses++;
    return 0;
}

static int open_interface(const ipe_url_t* url)
{
    char reason[REASON_SIZE];
    const unsigned i = n_interfaces;
    const char* filter = ipe_url_option(url, "filter");
    if (filter != NULL && strcmp(filter, "on") != 0 && strcmp(filter, "off") != 0) {
        return refuse("--bus", "filter= must be on or off");
    }
    const bool is_filtered = filter == NULL || strcmp(filter, "on") == 0;
    if (ipe_source_socketcan_open(&interface[i], url->path, (uint8_t)i, is_filtered ? &config : NULL, reason,
                                  sizeof reason) != 0) {
        return refuse("--bus", reason);
    }
    interface_was_up[i] = interface[i].is_up;
    n_interfaces++;
    return 0;
}

static int open_bus(char* address)
{
    ipe_url_t url;
    char reason[REASON_SIZE];
    const bool is_interface = is_interface_address(address);
    if (!ipe_url_parse(&url, address, "file socketcan", is_interface ? "filter" : "speed interface", reason,
                       sizeof reason)) {
        return refuse("--bus", reason);
    }
    return is_interface ? open_interface(&url) : open_log(&url);
}

static int open_buses(void)
{
    for (unsigned i = 0; i < option.n_buses; ++i) {
        if (open_bus(option.bus[i]) != 0) { return -1; }
    }
    return 0;
}

static int open_tracker_file(void)
{
    ipe_url_t url;
    char reason[REASON_SIZE];
    if (!ipe_url_parse(&url, option.tracker, "file", "", reason, sizeof reason)) { return refuse("--tracker", reason); }
    if (config.position_source != IPE_POSITION_TRACKER) {
        ipe_message("--tracker: not used, %s takes the position from elsewhere", option.config);
        return 0;
    }
    if (strcmp(url.path, "-") == 0 && is_stdin_taken()) {
        return refuse("--tracker", "stdin is taken by --bus file:-");
    }
    if (ipe_source_tracker_file_open(&replay.tracker, url.path, reason, sizeof reason) != 0) {
        return refuse("--tracker", reason);
    }
    replay.has_tracker = true;
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
    return refuse("--record", reason);
}

static int open_record(void)
{
    static char address[PATH_MAX + REASON_SIZE];
    char reason[REASON_SIZE];
    ipe_url_t url;
    uint64_t bytes, us;
    const bool has_scheme = strncmp(option.record, "file:", strlen("file:")) == 0;
    if (snprintf(address, sizeof address, "%s%s", has_scheme ? "" : "file:", option.record) >= (int)sizeof address) {
        return refuse("--record", strerror(ENAMETOOLONG));
    }
    if (!ipe_url_parse(&url, address, "file", "rotate_mb rotate_s", reason, sizeof reason)) {
        return refuse("--record", reason);
    }
    if (read_limit(&url, "rotate_mb", 1000000, &bytes) != 0 || read_limit(&url, "rotate_s", 1000000, &us) != 0) {
        return -1;
    }
    const ipe_record_options_t o = {.path = url.path,
                                    .config_channel = publisher.channel[IPE_PUBLISH_CONFIG],
                                    .config_bytes = config_bytes,
                                    .n_config_bytes = n_config_bytes,
                                    .rotate_bytes = bytes,
                                    .rotate_us = (int64_t)us,
                                    .waits = n_interfaces == 0 && replay.speed == 0.0};
    if (ipe_record_open(&recorder, &o, reason, sizeof reason) != 0) { return refuse("--record", reason); }
    is_recording = true;
    ipe_publish_record(&publisher, &recorder);
    return 0;
}

/// Continue from the checkpoint if it fits; otherwise say why not and start cold.
static int open_checkpoint(void)
{
    char reason[REASON_SIZE];
    if (ipe_checkpoint_open(&checkpoint, option.checkpoint, config_bytes, n_config_bytes, reason, sizeof reason) != 0) {
        return refuse("--checkpoint", reason);
    }
    const int status = ipe_checkpoint_load(&checkpoint, &pipeline, reason, sizeof reason);
    n_changes_reported = pipeline.detect.n_changes;
    if (status < 0) { ipe_message("--checkpoint: %s", reason); }
    if (status > 0) {
        ipe_message("--checkpoint: continuing from %s, %llu windows", option.checkpoint,
                    (unsigned long long)pipeline.estimate.n_windows);
    }
    return 0;
}

static void take_position(int64_t t_ns, const double position[3]);

/// LCM, and the tracker: from a file, from LCM, or not needed.
static int open_publisher_and_tracker(void)
{
    char reason[REASON_SIZE];
    if (ipe_publish_open(&publisher, option.lcm, option.lcm_prefix, &config, reason, sizeof reason) != 0) {
        return refuse("--lcm", reason);
    }
    if (option.tracker != NULL) { return open_tracker_file(); }
    if (config.position_source != IPE_POSITION_TRACKER) { return 0; }
    if (ipe_publish_subscribe(&publisher, take_position) == 0) { return 0; }
    return refuse("--lcm", "no tracker positions can come this way; give --tracker file:FILE");
}

static void watch(int fd, uint64_t wake, uint32_t events)
{
    struct epoll_event event = {.events = events, .data.u64 = wake};
    (void)epoll_ctl(epoll_fd, EPOLL_CTL_ADD, fd, &event);
}

/// Signals arrive through a descriptor. Blocked before LCM starts its thread, which inherits this.
static int open_signals(void)
{
    sigset_t set;
    sigemptyset(&set);
    sigaddset(&set, SIGINT);
    sigaddset(&set, SIGTERM);
    (void)signal(SIGPIPE, SIG_IGN);
    if (sigprocmask(SIG_BLOCK, &set, NULL) != 0) { return -1; }
    signal_fd = signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
    return signal_fd < 0 ? -1 : 0;
}

static int open_loop(void)
{
    const struct itimerspec each_second = {.it_interval.tv_sec = 1, .it_value.tv_sec = 1};
    epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    second_fd = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK);
    pace_fd = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK);
    if (epoll_fd < 0 || second_fd < 0 || pace_fd < 0 || timerfd_settime(second_fd, 0, &each_second, NULL) != 0) {
        return refuse("event loop", strerror(errno));
    }
    watch(signal_fd, WAKE_SIGNAL, EPOLLIN);
    watch(second_fd, WAKE_SECOND, EPOLLIN);
    watch(pace_fd, WAKE_PACE, EPOLLIN);
    if (ipe_publish_fileno(&publisher) >= 0) { watch(ipe_publish_fileno(&publisher), WAKE_LCM, EPOLLIN); }
    for (unsigned i = 0; i < n_interfaces; ++i) { watch(interface[i].fd, WAKE_BUS + i, EPOLLIN); }
    is_replay_runnable = n_interfaces == 0;
    return 0;
}

static int open_config(void)
{
    char reason[REASON_SIZE];
    const ssize_t n = ipe_config_read(option.config, config_bytes);
    if (n < 0) {
        (void)snprintf(reason, sizeof reason, "%s: %s", option.config, strerror(errno));
        return refuse("--config", reason);
    }
    if (ipe_config_from_bytes(config_bytes, (size_t)n, &config, reason, sizeof reason) != IPE_OK) {
        ipe_message("--config: %s: %s", option.config, reason);
        return -1;
    }
    n_config_bytes = (size_t)n - IPE_CONFIG_CRC_BYTES;
    return 0;
}

/// Last, when every other thread has been started with ordinary scheduling.
static int open_real_time(void)
{
    char reason[REASON_SIZE];
    if (option.cpu >= 0 && ipe_realtime_pin(option.cpu, reason, sizeof reason) != 0) { return refuse("--cpu", reason); }
    if (option.priority > 0 && ipe_realtime_start(option.priority, reason, sizeof reason) != 0) {
        return refuse("--rt", reason);
    }
    return 0;
}

static int open_all(void)
{
    char reason[REASON_SIZE];
    if (open_config() != 0) { return -1; }
    if (ipe_pipeline_init(&pipeline, &config, reason, sizeof reason) != IPE_OK) {
        return refuse(option.config, reason);
    }
    if (option.estimate != NULL && !ipe_estimate_file_check(option.estimate, reason, sizeof reason)) {
        return refuse("--estimate", reason);
    }
    if (open_signals() != 0) { return refuse("signals", strerror(errno)); }
    if (check_buses() != 0 || open_buses() != 0 || open_publisher_and_tracker() != 0) { return -1; }
    if (option.record != NULL && open_record() != 0) { return -1; }
    if (option.checkpoint != NULL && open_checkpoint() != 0) { return -1; }
    return open_loop() != 0 ? -1 : open_real_time();
}

// ---- counting -------------------------------------------------------------------------------------------------------

static void count_buses(void)
{
    char stage[16];
    uint64_t value = 0;
    const char* cause;
    for (unsigned i = 0; i < option.n_buses; ++i) {
        (void)snprintf(stage, sizeof stage, "bus%u", i);
        for (unsigned k = 0;; ++k) {
            cause = n_interfaces > 0 ? ipe_source_socketcan_counter(&interface[i], k, &value)
                                     : ipe_source_file_counter(&replay.bus[i], k, &value);
            if (cause == NULL) { break; }
            ipe_counters_add(&counters, stage, cause, value);
        }
    }
}

/// Everything that depends on the input only.
static void count_input(void)
{
    uint64_t value = 0;
    const char* cause;
    ipe_counters_clear(&counters);
    count_buses();
    for (unsigned k = 0;
         replay.has_tracker && (cause = ipe_source_tracker_file_counter(&replay.tracker, k, &value)) != NULL; ++k) {
        ipe_counters_add(&counters, "tracker", cause, value);
    }
    for (unsigned k = 0; (cause = ipe_pipeline_counter(&pipeline, k, &value)) != NULL; ++k) {
        ipe_counters_add(&counters, NULL, cause, value);
    }
}

static void count_all(void)
{
    uint64_t value = 0;
    const char* cause;
    count_input();
    for (unsigned k = 0; (cause = ipe_publish_counter(&publisher, k, &value)) != NULL; ++k) {
        ipe_counters_add(&counters, "lcm", cause, value);
    }
    for (unsigned k = 0; option.record != NULL && (cause = ipe_record_counter(&recorder, k, &value)) != NULL; ++k) {
        ipe_counters_add(&counters, "record", cause, value);
    }
    for (unsigned k = 0; option.checkpoint != NULL && (cause = ipe_checkpoint_counter(&checkpoint, k, &value)) != NULL;
         ++k) {
        ipe_counters_add(&counters, "checkpoint", cause, value);
    }
}

static const ipe_bus_counts_t* bus_counts(unsigned i)
{
    return n_interfaces > 0 ? &interface[i].counts : &replay.bus[i].counts;
}

static uint64_t count_frames(void)
{
    uint64_t n = 0;
    for (unsigned i = 0; i < option.n_buses; ++i) { n += bus_counts(i)->n_frames; }
    return n;
}

/// IMU samples that were complete and did not become a used row.
static uint64_t count_rejected_rows(void)
{
    const ipe_align_t* a = &pipeline.align;
    uint64_t n = a->n_overrun + a->n_bad_quaternion + pipeline.wrench.n_geometry + pipeline.window.n_backwards;
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) { n += a->n_missing[s] + a->n_late[s]; }
    return n + a->n_backwards[IPE_IMU] + a->n_nonfinite[IPE_IMU];
}

/// Frames lost before they reached us, incomplete samples, and rows.
static uint64_t count_dropped(void)
{
    uint64_t n = count_rejected_rows();
    for (unsigned i = 0; i < option.n_buses; ++i) {
        n += bus_counts(i)->n_dropped + bus_counts(i)->n_controller_overruns;
    }
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) { n += pipeline.group[s].n_incomplete; }
    return n;
}

// ---- data -----------------------------------------------------------------------------------------------------------

static int64_t wall_ns(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_REALTIME, &t);
    return (int64_t)t.tv_sec * NS_PER_S + t.tv_nsec;
}

/// Host time now: the clock for interfaces, the newest stamp for recorded input.
static int64_t host_ns(void)
{
    return n_interfaces > 0 ? wall_ns() : data_ns;
}

static double age_of(ipe_sensor_t sensor, int64_t now_ns)
{
    const ipe_ring_t* ring = &pipeline.align.ring[sensor];
    if (ring->head == 0) { return -1.0; }
    return (double)(now_ns - ring->t_ns[(ring->head - 1) % IPE_RING]) / (double)NS_PER_S;
}

static void send_health(int64_t now_ns)
{
    double age[IPE_SENSOR_COUNT];
    for (int s = 0; s < IPE_SENSOR_COUNT; ++s) { age[s] = age_of((ipe_sensor_t)s, now_ns); }
    count_all();
    ipe_publish_health(&publisher, now_ns, &counters, age);
    was_health_sent = true;
}

/// Move data time on; HEALTH goes out once per second of it.
static void advance_to(int64_t t_ns)
{
    data_ns = t_ns;
    if (t_ns < health_due_ns && t_ns >= health_due_ns - NS_PER_S) { return; }
    if (health_due_ns != 0) { send_health(t_ns); }
    health_due_ns = t_ns + NS_PER_S;
}

/// Tell that the payload changed, when it did.
static void report_change(int64_t t_ns)
{
    if (pipeline.detect.n_changes == n_changes_reported) { return; }
    n_changes_reported = pipeline.detect.n_changes;
    ipe_publish_event(&publisher, t_ns, "detect", "payload changed");
}

static void take_row(const ipe_row_t* row)
{
    if (first_row_ns == 0) { first_row_ns = row->t_ns; }
    last_row_ns = row->t_ns;
    publisher.n_input_dropped = count_dropped();
    report_change(row->t_ns);
    ipe_publish_row(&publisher, row);
    ipe_publish_estimate(&publisher, row->t_ns, &pipeline.estimate);
}

/// Step while rows are ready.
static void step(void)
{
    ipe_row_t row;
    ipe_status_t status;
    while ((status = ipe_pipeline_step(&pipeline, &row, NULL)) != IPE_NOT_READY) {
        if (status >= IPE_OK) { take_row(&row); }
    }
}

static void take_frame(const ipe_frame_t* frame)
{
    ipe_publish_frame(&publisher, frame);
    (void)ipe_pipeline_push_frame(&pipeline, frame);  // what it refuses, it counts
    step();
    advance_to(frame->t_ns);
}

static void take_position(int64_t t_ns, const double position[3])
{
    (void)ipe_pipeline_push_position(&pipeline, t_ns, position);  // what it refuses, it counts
    step();
}

// ---- loop -----------------------------------------------------------------------------------------------------------

/// Wait until fd is readable; false if it always is, as files are.
static bool wait_for_input(int fd)
{
    struct epoll_event event = {.events = EPOLLIN | EPOLLONESHOT, .data.u64 = WAKE_INPUT};
    return epoll_ctl(epoll_fd, EPOLL_CTL_MOD, fd, &event) == 0 || epoll_ctl(epoll_fd, EPOLL_CTL_ADD, fd, &event) == 0;
}

static void wait_until(int64_t due_ns)
{
    const struct itimerspec due = {.it_value = {.tv_sec = due_ns / NS_PER_S, .tv_nsec = due_ns % NS_PER_S}};
    (void)timerfd_settime(pace_fd, TFD_TIMER_ABSTIME, &due, NULL);
}

/// One item of the recorded input. False when it has to wait.
static bool replay_item(void)
{
    ipe_replay_item_t item;
    switch (ipe_replay_next(&replay, &item)) {
    case IPE_REPLAY_FRAME: take_frame(item.frame); return true;
    case IPE_REPLAY_POSITION:
        ipe_publish_position(&publisher, item.position->t_ns, item.position->position);
        take_position(item.position->t_ns, item.position->position);
        return true;
    case IPE_REPLAY_WAIT:
        if (wait_for_input(item.fd)) { return false; }
        ipe_replay_fill(&replay);
        return true;
    case IPE_REPLAY_EARLY: wait_until(item.due_ns); return false;
    case IPE_REPLAY_END:
    default: is_done = true; return false;
    }
}

/// Recorded input, a turn of it: signals and LCM are looked at in between.
static void run_replay(void)
{
    for (int i = 0; i < ITEMS_PER_TURN && is_replay_runnable; ++i) { is_replay_runnable = replay_item(); }
}

static void report_interface(unsigned i)
{
    if (interface[i].is_up == interface_was_up[i]) { return; }
    interface_was_up[i] = interface[i].is_up;
    ipe_publish_event(&publisher, host_ns(), interface[i].interface,
                      interface[i].is_up ? "interface is up" : "interface is down");
}

static void read_interface(unsigned i)
{
    int n = 1;
    for (int batch = 0; batch < BATCHES_PER_TURN && n > 0; ++batch) {
        n = ipe_source_socketcan_read(&interface[i]);
        for (int k = 0; k < n; ++k) { take_frame(&interface[i].frame[k]); }
    }
    report_interface(i);
}

static void tick_interface(unsigned i)
{
    const int fd = interface[i].fd;
    ipe_source_socketcan_tick(&interface[i]);
    if (interface[i].fd != fd) { watch(interface[i].fd, WAKE_BUS + i, EPOLLIN); }
    report_interface(i);
}

/// A wrong number in the state is a fault of this program or of the machine: say so, once.
static void check_invariants(void)
{
    if (is_damage_reported || ipe_pipeline_invariants_hold(&pipeline)) { return; }
    is_damage_reported = true;
    ipe_message("internal state is damaged; estimates are not to be trusted");
    ipe_publish_event(&publisher, host_ns(), "pipeline", "internal state is damaged");
}

/// Tell once when messages begin to miss in the record, and again after a second in which none did.
static void report_record(void)
{
    const uint64_t n_lost = ipe_record_lost(&recorder);
    const bool was_losing = is_losing_record;
    is_losing_record = n_lost != n_lost_reported;
    n_lost_reported = n_lost;
    if (!is_losing_record || was_losing) { return; }
    char text[REASON_SIZE];
    const int cause = atomic_load(&recorder.error);
    (void)snprintf(text, sizeof text, "messages are lost: %s", cause != 0 ? strerror(cause) : "the queue is full");
    ipe_message("--record: %s", text);
    ipe_publish_event(&publisher, host_ns(), "record", text);
}

/// Once a second of real time. HEALTH goes out here when no data moved it.
static void tick(void)
{
    for (unsigned i = 0; i < n_interfaces; ++i) { tick_interface(i); }
    check_invariants();
    if (is_recording) { report_record(); }
    if (option.checkpoint != NULL && ++n_ticks >= CHECKPOINT_TICKS) {
        n_ticks = 0;
        ipe_checkpoint_save(&checkpoint, &pipeline);
    }
    if (!was_health_sent) {
        ipe_publish_flush(&publisher);
        send_health(host_ns());
    }
    was_health_sent = false;
}

static void acknowledge(int timer_fd)
{
    uint64_t n_expirations;
    (void)!read(timer_fd, &n_expirations, sizeof n_expirations);  // nothing to read: it was read before
}

static void handle(uint64_t wake)
{
    switch (wake) {
    case WAKE_SIGNAL: is_done = true; break;
    case WAKE_SECOND:
        acknowledge(second_fd);
        tick();
        break;
    case WAKE_PACE:
        acknowledge(pace_fd);
        is_replay_runnable = true;
        break;
    case WAKE_INPUT:
        ipe_replay_fill(&replay);
        is_replay_runnable = true;
        break;
    case WAKE_LCM: ipe_publish_receive(&publisher); break;
    default: read_interface((unsigned)(wake - WAKE_BUS)); break;
    }
}

static void run(void)
{
    while (!is_done) {
        struct epoll_event event[8];
        const int n = epoll_wait(epoll_fd, event, sizeof event / sizeof event[0], is_replay_runnable ? 0 : -1);
        for (int i = 0; i < n; ++i) { handle(event[i].data.u64); }
        if (is_replay_runnable) { run_replay(); }
    }
}

// ---- close ----------------------------------------------------------------------------------------------------------

static int write_estimate(void)
{
    char reason[REASON_SIZE];
    count_input();
    const ipe_run_t result = {.pipeline = &pipeline,
                              .counters = &counters,
                              .n_frames = count_frames(),
                              .n_rejected = count_rejected_rows(),
                              .duration = (double)(last_row_ns - first_row_ns) / (double)NS_PER_S};
    if (ipe_estimate_file_write(option.estimate, &result, reason, sizeof reason) == 0) { return 0; }
    return refuse("--estimate", reason);
}

/// False if a replay's record lacks anything.
static bool close_record(void)
{
    if (!is_recording) { return true; }
    report_record();
    ipe_publish_record(&publisher, NULL);
    const bool is_whole = ipe_record_close(&recorder) == 0;
    if (!is_whole) { ipe_message("--record: %s is not complete", recorder.option.path); }
    return is_whole || n_interfaces > 0;
}

/// Let out what waits, tell the world a last time, write the result, print the summary.
static int close_all(void)
{
    int status = STATUS_GOOD;
    ipe_pipeline_flush(&pipeline);
    step();
    for (unsigned i = 0; i < n_interfaces; ++i) { ipe_source_socketcan_close(&interface[i]); }
    ipe_replay_close(&replay);
    if (option.estimate != NULL && write_estimate() != 0) { status = STATUS_NOT_WRITTEN; }
    if (option.checkpoint != NULL && ipe_checkpoint_close(&checkpoint, &pipeline) != 0) { status = STATUS_NOT_WRITTEN; }
    ipe_publish_last(&publisher, &pipeline.estimate);
    send_health(host_ns());
    if (!close_record()) { status = STATUS_NOT_WRITTEN; }
    count_all();
    ipe_publish_close(&publisher);
    ipe_counters_print(&counters);
    return status;
}

int main(int argc, char** argv)
{
    const int help = read_arguments(argc, argv);
    if (help != 0) { return help > 0 ? STATUS_GOOD : STATUS_USAGE; }
    if (open_all() != 0) { return STATUS_USAGE; }
    run();
    return close_all();
}
