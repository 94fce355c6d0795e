// SPDX-License-Identifier: Apache-2.0
#define _GNU_SOURCE  // sched_getaffinity
#include "host_facts.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/can/netlink.h>
#include <linux/ethtool.h>
#include <linux/if_link.h>
#include <linux/net_tstamp.h>
#include <linux/rtnetlink.h>
#include <linux/sockios.h>
#include <net/if.h>
#include <sched.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/timex.h>
#include <sys/utsname.h>
#include <unistd.h>

void ipe_host_facts_add(ipe_host_facts_t* f, const char* name, const char* format, ...)
{
    if (f->n == IPE_FACTS_MAX) { return; }
    va_list arguments;
    (void)snprintf(f->fact[f->n].name, sizeof f->fact[f->n].name, "%s", name);
    va_start(arguments, format);
    (void)vsnprintf(f->fact[f->n].value, sizeof f->fact[f->n].value, format, arguments);
    va_end(arguments);
    f->n++;
}

// ---- machine --------------------------------------------------------------------------------------------------------

/// First line of a file; false if it cannot be read.
static bool read_line(const char* path, char* line, size_t size)
{
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) { return false; }
    const ssize_t n = read(fd, line, size - 1);
    (void)close(fd);
    line[n > 0 ? n : 0] = '\0';
    line[strcspn(line, "\n")] = '\0';
    return n > 0;
}

static void add_file(ipe_host_facts_t* f, const char* name, const char* path)
{
    char line[IPE_FACT_VALUE_MAX];
    if (read_line(path, line, sizeof line)) { ipe_host_facts_add(f, name, "%s", line); }
}

/// State of the clock's synchronisation as the kernel has it, whoever synchronises: chrony, ntpd, ptp4l with phc2sys.
static void add_synchronisation(ipe_host_facts_t* f)
{
    struct timex t = {0};
    const int state = adjtimex(&t);
    if (state < 0) {
        ipe_host_facts_add(f, "clock.synchronised", "unknown: %s", strerror(errno));
        return;
    }
    const bool is_good = state != TIME_ERROR && (t.status & STA_UNSYNC) == 0;
    ipe_host_facts_add(f, "clock.synchronised", "%s", is_good ? "yes" : "no");
    if (is_good) { ipe_host_facts_add(f, "clock.error", "estimated %ld us, at most %ld us", t.esterror, t.maxerror); }
    ipe_host_facts_add(f, "clock.frequency", "%+.3f ppm", (double)t.freq / 65536.0);
}

/// VmLck of /proc/self/status.
static void add_locked(ipe_host_facts_t* f)
{
    char text[4096];
    const int fd = open("/proc/self/status", O_RDONLY | O_CLOEXEC);
    if (fd < 0) { return; }
    const ssize_t n = read(fd, text, sizeof text - 1);
    (void)close(fd);
    text[n > 0 ? n : 0] = '\0';
    const char* line = strstr(text, "VmLck:");
    if (line == NULL) { return; }
    ipe_host_facts_add(f, "memory.locked", "%lu kB", strtoul(line + strlen("VmLck:"), NULL, 10));
}

static void add_scheduling(ipe_host_facts_t* f)
{
    struct sched_param parameter = {0};
    cpu_set_t set;
    const int policy = sched_getscheduler(0) & ~SCHED_RESET_ON_FORK;
    (void)sched_getparam(0, &parameter);
    ipe_host_facts_add(f, "scheduling", policy == SCHED_FIFO ? "SCHED_FIFO %d" : "SCHED_OTHER",
                       parameter.sched_priority);
    if (sched_getaffinity(0, sizeof set, &set) == 0) {
        ipe_host_facts_add(f, "processors", "%d allowed of %ld", CPU_COUNT(&set), sysconf(_SC_NPROCESSORS_ONLN));
    }
}

void ipe_host_facts_read(ipe_host_facts_t* f)
{
    struct utsname u;
    if (uname(&u) == 0) {
        ipe_host_facts_add(f, "host", "%s", u.nodename);
        ipe_host_facts_add(f, "kernel", "%s %s %s %s", u.sysname, u.release, u.version, u.machine);
    }
    add_file(f, "kernel.realtime", "/sys/kernel/realtime");
    add_file(f, "kernel.rmem_max", "/proc/sys/net/core/rmem_max");
    add_file(f, "clock.source", "/sys/devices/system/clocksource/clocksource0/current_clocksource");
    add_synchronisation(f);
    add_scheduling(f);
    add_locked(f);
}

// ---- interface: ethtool ---------------------------------------------------------------------------------------------

static void add_of(ipe_host_facts_t* f, const char* interface, const char* name, const char* value)
{
    char whole[IPE_FACT_NAME_MAX];
    (void)snprintf(whole, sizeof whole, "%s.%s", interface, name);
    ipe_host_facts_add(f, whole, "%s", value);
}

static bool ask(int fd, const char* interface, void* command)
{
    struct ifreq request = {0};
    (void)snprintf(request.ifr_name, sizeof request.ifr_name, "%s", interface);
    request.ifr_data = command;
    return ioctl(fd, SIOCETHTOOL, &request) == 0;
}

static void add_driver(ipe_host_facts_t* f, int fd, const char* interface)
{
    char text[IPE_FACT_VALUE_MAX];
    struct ethtool_drvinfo info = {.cmd = ETHTOOL_GDRVINFO};
    if (!ask(fd, interface, &info)) { return; }
    (void)snprintf(text, sizeof text, "%.31s, firmware %.31s, at %.31s", info.driver, info.fw_version, info.bus_info);
    add_of(f, interface, "driver", text);
}

static void add_stamps(ipe_host_facts_t* f, int fd, const char* interface)
{
    char text[IPE_FACT_VALUE_MAX];
    struct ethtool_ts_info info = {.cmd = ETHTOOL_GET_TS_INFO};
    if (!ask(fd, interface, &info)) {
        add_of(f, interface, "stamps", "unknown");
        return;
    }
    (void)snprintf(text, sizeof text, "software %s, hardware %s, clock %s%d",
                   (info.so_timestamping & SOF_TIMESTAMPING_RX_SOFTWARE) != 0 ? "yes" : "no",
                   (info.so_timestamping & SOF_TIMESTAMPING_RX_HARDWARE) != 0 ? "yes" : "no",
                   info.phc_index < 0 ? "none, index " : "/dev/ptp", info.phc_index);
    add_of(f, interface, "stamps", text);
}

/// Frames that the controller collects before it wakes the kernel are stamped late.
static void add_coalescing(ipe_host_facts_t* f, int fd, const char* interface)
{
    char text[IPE_FACT_VALUE_MAX];
    struct ethtool_coalesce info = {.cmd = ETHTOOL_GCOALESCE};
    if (!ask(fd, interface, &info)) { return; }
    (void)snprintf(text, sizeof text, "up to %u frames or %u us", info.rx_max_coalesced_frames, info.rx_coalesce_usecs);
    add_of(f, interface, "coalescing", text);
}

// ---- interface: bit timing ------------------------------------------------------------------------------------------

/// The attribute of a kind among n bytes; NULL: not there, or shorter than size.
static const void* find(const void* attributes, size_t n, unsigned short kind, size_t size)
{
    for (size_t at = 0; at + sizeof(struct rtattr) <= n;) {
        const struct rtattr* a = (const struct rtattr*)((const char*)attributes + at);
        if (a->rta_len < sizeof *a || a->rta_len > n - at) { break; }
        if ((a->rta_type & NLA_TYPE_MASK) == kind && RTA_PAYLOAD(a) >= size) { return a; }
        at += RTA_ALIGN((size_t)a->rta_len);
    }
    return NULL;
}

static const void* inside(const struct rtattr* a)
{
    return a == NULL ? NULL : RTA_DATA(a);
}

static size_t length_of(const struct rtattr* a)
{
    return a == NULL ? 0 : RTA_PAYLOAD(a);
}

static void add_timing(ipe_host_facts_t* f, const char* interface, const char* name, const void* attribute)
{
    char text[IPE_FACT_VALUE_MAX];
    struct can_bittiming b;
    if (attribute == NULL) { return; }
    memcpy(&b, inside(attribute), sizeof b);
    (void)snprintf(text, sizeof text,
                   "%u bit/s, sample point %.3f, tq %u ns, prop %u, phase1 %u, phase2 %u, sjw %u, brp %u", b.bitrate,
                   1e-3 * b.sample_point, b.tq, b.prop_seg, b.phase_seg1, b.phase_seg2, b.sjw, b.brp);
    add_of(f, interface, name, text);
}

/// Read the facts about a CAN interface from the kernel's link message of n bytes.
static void add_link(ipe_host_facts_t* f, const char* interface, const void* attributes, size_t n)
{
    static const char* const STATE[] = {"error-active", "error-warning", "error-passive",
                                        "bus-off",      "stopped",       "sleeping"};
    char text[IPE_FACT_VALUE_MAX];
    uint32_t value;
    const struct rtattr* info = find(attributes, n, IFLA_LINKINFO, 0);
    const struct rtattr* data = find(inside(info), length_of(info), IFLA_INFO_DATA, 0);
    if (data == NULL) { return; }
    const void* can = inside(data);
    const size_t n_can = length_of(data);
    add_timing(f, interface, "bit_timing", find(can, n_can, IFLA_CAN_BITTIMING, sizeof(struct can_bittiming)));
    add_timing(f, interface, "data_bit_timing",
               find(can, n_can, IFLA_CAN_DATA_BITTIMING, sizeof(struct can_bittiming)));
    const void* state = find(can, n_can, IFLA_CAN_STATE, sizeof value);
    if (state != NULL) {
        memcpy(&value, inside(state), sizeof value);
        add_of(f, interface, "state", value < sizeof STATE / sizeof STATE[0] ? STATE[value] : "unknown");
    }
    const void* restart = find(can, n_can, IFLA_CAN_RESTART_MS, sizeof value);
    if (restart != NULL) {
        memcpy(&value, inside(restart), sizeof value);
        (void)snprintf(text, sizeof text, value > 0 ? "%u ms after bus-off" : "never after bus-off", value);
        add_of(f, interface, "restart", text);
    }
}

static void add_bit_timing(ipe_host_facts_t* f, const char* interface)
{
    struct {
        struct nlmsghdr header;
        struct ifinfomsg link;
    } request = {.header = {.nlmsg_len = sizeof request, .nlmsg_type = RTM_GETLINK, .nlmsg_flags = NLM_F_REQUEST},
                 .link = {.ifi_family = AF_UNSPEC, .ifi_index = (int)if_nametoindex(interface)}};
    union {
        struct nlmsghdr header;
        char bytes[16384];
    } answer;
    const int fd = socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_ROUTE);
    if (fd < 0) { return; }
    const struct timeval patience = {.tv_sec = 1};
    (void)setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    const ssize_t n = send(fd, &request, sizeof request, 0) < 0 ? -1 : recv(fd, &answer, sizeof answer, 0);
    (void)close(fd);
    if (n < (ssize_t)sizeof request || answer.header.nlmsg_type != RTM_NEWLINK || answer.header.nlmsg_len > (size_t)n) {
        return;
    }
    add_link(f, interface, answer.bytes + sizeof request, answer.header.nlmsg_len - sizeof request);
}

void ipe_host_facts_read_interface(ipe_host_facts_t* f, const char* interface)
{
    const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (fd < 0) { return; }
    add_driver(f, fd, interface);
    add_stamps(f, fd, interface);
    add_coalescing(f, fd, interface);
    (void)close(fd);
    add_bit_timing(f, interface);
}
