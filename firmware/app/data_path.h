// SPDX-License-Identifier: Apache-2.0
/// Data path: frame or position -> pipeline -> rows and estimates -> LCM and record.
#ifndef IPE_DATA_PATH_H
#define IPE_DATA_PATH_H

#include "daemon.h"

/// Use one frame, received at host time arrival_ns [ns]; 0: latency is not measured.
void data_path_frame(daemon_t* d, const ipe_frame_t* frame, int64_t arrival_ns);

/// Use one tracked position: host time [ns], position [3] in W, m; arrival_ns as above.
void data_path_position(daemon_t* d, int64_t t_ns, const double position[3], int64_t arrival_ns);

/// Let out the rows that wait for samples which will not come, and publish them: at the end of the input, and before another
/// pipeline takes over.
void data_path_flush(daemon_t* d);

#endif
