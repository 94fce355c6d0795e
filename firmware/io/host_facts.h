// SPDX-License-Identifier: Apache-2.0
/// Properties of the machine and its CAN interfaces, as `uname -a`, `ethtool -i -T -c`, `ip -details link` and `adjtimex`
/// report them.
///
/// Read once before the start, as text, for the record. What cannot be read is left out; a fact that matters and is missing
/// is told so. 14 KB, caller-allocated, no heap, one thread.
/// Source: linux/ethtool.h, linux/can/netlink.h, adjtimex(2).
#ifndef IPE_HOST_FACTS_H
#define IPE_HOST_FACTS_H

enum { IPE_FACTS_MAX = 64, IPE_FACT_NAME_MAX = 48, IPE_FACT_VALUE_MAX = 160 };

typedef struct {
    unsigned n;
    struct {
        char name[IPE_FACT_NAME_MAX];
        char value[IPE_FACT_VALUE_MAX];
    } fact[IPE_FACTS_MAX];
} ipe_host_facts_t;

/// Append a fact; its value is cut where it does not fit, and a fact beyond the last is left out.
void ipe_host_facts_add(ipe_host_facts_t* f, const char* name, const char* format, ...)
    __attribute__((format(printf, 3, 4)));

/// Append the facts of the machine and of this thread's scheduling.
void ipe_host_facts_read(ipe_host_facts_t* f);

/// Append the facts of a network interface; each name begins with the interface's.
void ipe_host_facts_read_interface(ipe_host_facts_t* f, const char* interface);

#endif
