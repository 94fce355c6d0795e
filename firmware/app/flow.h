// SPDX-License-Identifier: Apache-2.0
/// The data's way: frame or position -> pipeline -> rows and estimates -> LCM and record.
#ifndef IPE_FLOW_H
#define IPE_FLOW_H

#include "daemon.h"

/// Host time now: the clock for interfaces, the newest stamp for recorded input.
int64_t flow_now(const daemon_t* d);

/// Take one frame that came at host time arrival_ns, 0: latencies are not measured.
void flow_frame(daemon_t* d, const ipe_frame_t* frame, int64_t arrival_ns);

/// Take one tracked position: host time [ns], position [3] in W, m; arrival_ns as above.
void flow_position(daemon_t* d, int64_t t_ns, const double position[3], int64_t arrival_ns);

/// Step the pipeline while rows are ready, and publish what comes out.
void flow_step(daemon_t* d);

#endif
