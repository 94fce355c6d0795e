// SPDX-License-Identifier: Apache-2.0
/// Scheduling of the calling thread: processor, SCHED_FIFO priority, memory that stays in RAM.
///
/// Call once, when everything is open and every other thread runs: those keep their own scheduling.
#ifndef IPE_REALTIME_H
#define IPE_REALTIME_H

#include <stddef.h>

enum { IPE_REALTIME_STACK = 256 * 1024 };  ///< bytes touched in advance, so that no step meets a page fault

/// Run on this processor only. 0, or -1 with one line in message[size]: no such processor, or not allowed here.
int ipe_realtime_pin(int cpu, char* message, size_t size);

/// Lock all memory, present and future, touch the stack, then SCHED_FIFO with this priority, 1 to 99.
///
/// 0, or -1 with one line in message[size] that names the missing permission or limit. Children do not inherit it.
int ipe_realtime_start(int priority, char* message, size_t size);

#endif
