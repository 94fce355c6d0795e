// SPDX-License-Identifier: Apache-2.0
/// estimate.json: the result of a run, for people and programs.
///
///   {"method", "mass": {"value", "std"}, "cog": {...}, "inertia_cog": {...},
///    "attitude_bias", "world_yaw", "acc_bias", "imu_alignment", "position_delay", "force_offset", "force_gain": {...},
///    "consistent", "observable": {...}, "changes", "is_misfit", "sigma_factor",
///    "converged", "verdict": "good"|"care"|"stop", "findings": [{"name", "severity", "says", "evidence": {...}, "do"}],
///    "samples": {"frames", "used", "rejected", "windows"}, "duration_s", "counters": {...}}
///
/// kg, m, kg m2; P to C; xx yy zz yz xz xy, matrix entries; std is one standard deviation; sensor errors as in
/// robot_config_t. Without an estimate the three quantities are null and the sensor errors left out. A quantity is
/// observable where the data at least halved the prior's standard deviation.
/// The content depends on the input only, so the same log gives the same bytes. 48 KB of static buffer, one thread.
#ifndef IPE_ESTIMATE_FILE_H
#define IPE_ESTIMATE_FILE_H

#include "counters.h"
#include "pipeline.h"

#include <stddef.h>

/// Content of the file beside the pipeline's estimate.
typedef struct {
    const ipe_pipeline_t* pipeline;
    const ipe_counters_t* counters;
    uint64_t n_frames;    ///< CAN frames received
    uint64_t n_rejected;  ///< rows lost or refused, all causes
    double duration;      ///< s of data, first to last row
} ipe_run_t;

/// True if the file can be written, tried by creating and removing path.tmp; otherwise the reason is in message.
bool ipe_estimate_file_check(const char* path, char* message, size_t size);

/// Write the file in one piece: path.tmp, fsync, rename. After a power cut it is the old one or the new one. A path that
/// is there and no regular file (a pipe, /dev/stdout) is written to directly.
///
/// 0, or -1 with the reason in message; then the file is as it was.
int ipe_estimate_file_write(const char* path, const ipe_run_t* run, char* message, size_t size);

#endif
