// SPDX-License-Identifier: Apache-2.0
/// Watches buses, losses, clock and sensors and reports changes on EVENT; sends HEALTH and HOST, saves the checkpoint, feeds
/// the watchdog.
#ifndef IPE_MONITOR_H
#define IPE_MONITOR_H

#include "daemon.h"

/// After reading interface i: report if it went down or came back.
void monitor_interface(daemon_t* d, unsigned i);

/// After a frame was used: report a change of the bus state or of the payload, and, by data time, check ten times a second
/// whether every sensor is present, once a second whether it is late, and send HEALTH.
void monitor_frame(daemon_t* d, const ipe_frame_t* frame);

/// Read the clocks, before stamps are mapped; report if the host's clock was stepped.
void monitor_clock(daemon_t* d);

/// Once a second of real time: losses, checkpoint, watchdog. Sends HEALTH if monitor_frame() did not.
void monitor_second(daemon_t* d);

/// At the end of the input: report losses and a payload change not reported yet.
void monitor_end(daemon_t* d);

#endif
