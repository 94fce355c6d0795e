// SPDX-License-Identifier: Apache-2.0
/// The event loop: waits for frames, messages, timers and signals, and hands each to its part.
#ifndef IPE_LOOP_H
#define IPE_LOOP_H

#include "daemon.h"

/// Set up the loop over everything that is open. 0, or -1: said why.
int loop_open(daemon_t* d);

/// Listen to interface i, whose descriptor is new.
void loop_watch_interface(daemon_t* d, unsigned i);

/// Run until the input ends or a signal comes.
void loop_run(daemon_t* d);

#endif
