// SPDX-License-Identifier: Apache-2.0
#include "options.h"

#include "message.h"

#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { CPUS_MAX = 1024 };
static const double COLLECT_MAX = 0.1, COLLECT_DEFAULT = 0.005;  // s

static const char USAGE[] =
    "usage: inertiad --config robot.cfg --bus ADDRESS [--bus ADDRESS ...] [options]\n"
    "Estimates mass, centre of gravity and inertia of a cable-driven platform from its CAN buses.\n"
    "\n"
    "  --config FILE       compiled robot description, made by: inertiactl compile robot.toml -o robot.cfg\n"
    "  --bus ADDRESS       one per bus, in the order of the description:\n"
    "      socketcan:can0[?filter=off]            a CAN interface; off: receive frames nothing is bound to, too\n"
    "      file:can.log[?speed=1][&interface=can0]  a candump log, file:- stdin; speed 0 (default): as fast as possible,\n"
    "                                             1: as recorded; interface: take the frames of this one only\n"
    "  --tracker ADDRESS   positions of the tracked point: file:FILE, a CSV with the columns t,x,y,z; lcm (default): TRACKER\n"
    "                      messages of programs on this host; lcm:network: of other hosts, too\n"
    "  --lock-step         for simulators: instead of --bus, --tracker and --lcm take frames, positions and commands from\n"
    "                      stdin and answer with estimates and events on stdout; firmware/io/lock_step.h has the lines\n"
    "  --lcm URL           where to publish, none: nowhere; default udpm://239.255.76.67:7667?ttl=0\n"
    "  --lcm-prefix TEXT   of every channel; default INERTIAD_\n"
    "  --commands WHO      take commands from: off: nobody; local (default): programs on this host; network: other hosts, too\n"
    "  --record FILE[?rotate_mb=N][&rotate_s=N]\n"
    "                      an LCM log of all that is published, with or without --lcm, the tracker and the configuration;\n"
    "                      an earlier FILE, and one that reached a limit, is moved to FILE.1, FILE.2, ...\n"
    "  --estimate FILE     write the result as JSON on exit\n"
    "  --checkpoint FILE   keep what was learnt, every 5 s and on exit, and continue from it\n"
    "  --collect SECONDS   let frames of a busy interface gather for so long before they are read, 0 to 0.1; default 0.005,\n"
    "                      0: take each as it comes\n"
    "  --rt PRIORITY       run as SCHED_FIFO, 1 to 99, with all memory locked\n"
    "  --cpu N             run on this processor only, from 0\n"
    "  -v, --verbose       print the counters that are zero, too, at the end\n"
    "  --version           print the version\n"
    "  -h, --help          print this text\n"
    "\n"
    "exit status:\n"
    "  0  end of the input, or a signal such as SIGTERM\n"
    "  1  estimate, checkpoint or the record of a replay was not written, or no frame of a log belongs to a signal; with\n"
    "     --lock-step: nobody took the answers, or stdin had no line of use\n"
    "  2  options or files are unusable\n"
    "  3  cannot start now, may be able to later: record or checkpoint cannot be written or another daemon holds it, another\n"
    "     daemon uses the channels, LCM has no network\n"
    "\n"
    "example:\n"
    "  inertiad --config robot.cfg --bus file:run/can.log --tracker file:run/tracker.csv --estimate run/estimate.json\n";

static int usage_error(const char* name, const char* reason)
{
    ipe_message("%s: %s; inertiad -h shows how", name, reason);
    return -1;
}

static int add_bus(options_t* o, char* address)
{
    if (o->n_buses == IPE_BUSES_MAX) { return usage_error("--bus", "more than 8"); }
    o->bus[o->n_buses++] = address;
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

static int read_seconds(const char* name, const char* text, double maximum, double* seconds)
{
    char reason[REASON_SIZE];
    char* end;
    const double value = strtod(text, &end);
    if (end != text && *end == '\0' && value >= 0.0 && value <= maximum) {
        *seconds = value;
        return 0;
    }
    (void)snprintf(reason, sizeof reason, "\"%s\" is not a number of seconds from 0 to %g", text, maximum);
    return usage_error(name, reason);
}

static int read_origin(const char* text, ipe_inbox_origin_t* origin)
{
    static const char* const NAME[] = {"off", "local", "network"};  // in the order of ipe_inbox_origin_t
    for (int i = 0; i < (int)(sizeof NAME / sizeof NAME[0]); ++i) {
        if (strcmp(text, NAME[i]) != 0) { continue; }
        *origin = (ipe_inbox_origin_t)i;
        return 0;
    }
    return usage_error("--commands", "must be off, local or network");
}

static int take_option(options_t* o, int letter, const char* text)
{
    switch (letter) {
    case 'c': o->config = optarg; return 0;
    case 'b': return add_bus(o, optarg);
    case 't': o->tracker = optarg; return 0;
    case 'l': o->lcm = optarg; return 0;
    case 'p': o->lcm_prefix = optarg; return 0;
    case 'o': return read_origin(optarg, &o->commands);
    case 'R': return read_number("--rt", optarg, 1, 99, &o->priority);
    case 'C': return read_number("--cpu", optarg, 0, CPUS_MAX - 1, &o->cpu);
    case 'g': return read_seconds("--collect", optarg, COLLECT_MAX, &o->collect);
    case 'k': o->checkpoint = optarg; return 0;
    case 'r': o->record = optarg; return 0;
    case 'e': o->estimate = optarg; return 0;
    case 's': o->is_lock_step = true; return 0;
    case 'v': o->is_verbose = true; return 0;
    case ':': return usage_error(text, "needs a value");
    default: return usage_error(text, "unknown or ambiguous option");
    }
}

static options_result_t print(const char* text)
{
    return fputs(text, stdout) < 0 ? OPTIONS_BAD : OPTIONS_PRINTED;
}

static options_result_t refuse(const char* name, const char* reason)
{
    (void)usage_error(name, reason);
    return OPTIONS_BAD;
}

options_result_t options_read(options_t* o, int argc, char** argv)
{
    static const struct option LONG[] = {
        {"config", required_argument, NULL, 'c'},
        {"bus", required_argument, NULL, 'b'},
        {"tracker", required_argument, NULL, 't'},
        {"lcm", required_argument, NULL, 'l'},
        {"lcm-prefix", required_argument, NULL, 'p'},
        {"commands", required_argument, NULL, 'o'},
        {"record", required_argument, NULL, 'r'},
        {"estimate", required_argument, NULL, 'e'},
        {"checkpoint", required_argument, NULL, 'k'},
        {"collect", required_argument, NULL, 'g'},
        {"lock-step", no_argument, NULL, 's'},
        {"rt", required_argument, NULL, 'R'},
        {"cpu", required_argument, NULL, 'C'},
        {"verbose", no_argument, NULL, 'v'},
        {"version", no_argument, NULL, 'V'},
        {"help", no_argument, NULL, 'h'},
        {NULL, 0, NULL, 0},
    };
    int letter;
    *o = (options_t){
        .lcm_prefix = "INERTIAD_", .commands = IPE_INBOX_ORIGIN_HOST, .cpu = -1, .collect = COLLECT_DEFAULT};
    while ((letter = getopt_long(argc, argv, ":hv", LONG, NULL)) != -1) {
        if (letter == 'h') { return print(USAGE); }
        if (letter == 'V') { return print("inertiad " INERTIAD_VERSION "\n"); }
        if (take_option(o, letter, argv[optind - 1]) != 0) { return OPTIONS_BAD; }
    }
    if (optind < argc) { return refuse(argv[optind], "belongs to no option"); }
    if (o->config == NULL) { return refuse("--config", "missing"); }
    if (o->is_lock_step && (o->n_buses > 0 || o->tracker != NULL || o->lcm != NULL)) {
        return refuse("--lock-step", "stands for --bus, --tracker and --lcm, which cannot be given as well");
    }
    if (o->lcm == NULL) { o->lcm = o->is_lock_step ? "none" : "udpm://239.255.76.67:7667?ttl=0"; }
    if (o->n_buses == 0 && !o->is_lock_step) { return refuse("--bus", "missing"); }
    return OPTIONS_RUN;
}
