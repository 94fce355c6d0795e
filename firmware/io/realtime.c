// SPDX-License-Identifier: Apache-2.0
#define _GNU_SOURCE  // sched_setaffinity, SCHED_RESET_ON_FORK
#include "realtime.h"

#include <errno.h>
#include <sched.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>

int ipe_realtime_pin(int cpu, char* message, size_t size)
{
    cpu_set_t set;
    CPU_ZERO(&set);
    if (cpu >= 0 && cpu < CPU_SETSIZE) { CPU_SET((size_t)cpu, &set); }
    if (sched_setaffinity(0, sizeof set, &set) == 0) { return 0; }
    (void)snprintf(message, size, "%d: no such processor, or not allowed to this process: %s", cpu, strerror(errno));
    return -1;
}

static void touch_stack(void)
{
    volatile char stack[IPE_REALTIME_STACK];
    for (size_t i = 0; i < sizeof stack; i += 1024) { stack[i] = 0; }
}

int ipe_realtime_start(int priority, char* message, size_t size)
{
    const struct sched_param parameter = {.sched_priority = priority};
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
        (void)snprintf(message, size, "cannot lock memory: %s; needs CAP_IPC_LOCK or LimitMEMLOCK=infinity",
                       strerror(errno));
        return -1;
    }
    touch_stack();
    if (sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &parameter) == 0) { return 0; }
    (void)snprintf(message, size, "cannot use SCHED_FIFO %d: %s; needs CAP_SYS_NICE or LimitRTPRIO=%d", priority,
                   strerror(errno), priority);
    (void)munlockall();
    return -1;
}
