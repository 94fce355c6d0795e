// SPDX-License-Identifier: Apache-2.0
/// Looks after what surrounds the data: tells on EVENT what changed, keeps the checkpoint fresh, feeds the watchdog.
#ifndef IPE_MONITOR_H
#define IPE_MONITOR_H

#include "daemon.h"

/// Tell when interface i went down or came back.
void monitor_interface(daemon_t* d, unsigned i);

/// Take a frame by which a controller tells its state.
void monitor_error_frame(daemon_t* d, const ipe_frame_t* frame);

/// Look at the clocks before stamps are mapped; tell when somebody set the host's.
void monitor_clock(daemon_t* d);

/// Data time moved on: ten times a second of it look whether every sensor is there. HOST goes out here first.
void monitor_advance(daemon_t* d, int64_t now_ns);

/// Tell when frames, messages of the record or of LCM begin to get lost, and when none were since the last look.
void monitor_losses(daemon_t* d);

/// Once a second of real time. HEALTH goes out here when no data moved it.
void monitor_tick(daemon_t* d);

#endif
