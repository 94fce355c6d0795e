// SPDX-License-Identifier: Apache-2.0
/// The daemon's result for people, at its end: ten numbers, verdict, what was lost.
#ifndef IPE_RESULT_H
#define IPE_RESULT_H

#include "daemon.h"

/// Print mass, CoG and inertia with their standard deviations, two digits of these, each on a line of its own; nothing where no
/// window was used. Then what was lost, by cause, in one line, and the verdict with what is not good. d->counters are counted.
void result_print(const daemon_t* d);

#endif
