// SPDX-License-Identifier: Apache-2.0
/// Event loop: waits for frames, messages, timers and signals and calls the part that handles each.
#ifndef IPE_LOOP_H
#define IPE_LOOP_H

#include "daemon.h"

/// Prepare the loop for every open source. 0, or -1 with the reason on stderr.
int loop_open(daemon_t* d);

/// Run until the input ends or a signal comes.
void loop_run(daemon_t* d);

#endif
