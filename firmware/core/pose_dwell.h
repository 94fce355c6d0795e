// SPDX-License-Identifier: Apache-2.0
/// Time that the platform has been at rest in one pose: a static pose carries information once.
///
/// A window is of the same pose as those before if position and attitude are within 10 mm and 0.02 rad, and what the
/// attitude wanders, of where the pose was first seen. It is at rest if it is not the first few of its pose and turns by
/// less than 0.02 rad/s. A window that turns faster without leaving the pose, a knock, is not at rest, but those after it
/// are no news. Neither noise of the rate nor of its slope, which at 25 Hz is that of a slow motion, decides anything.
/// Source: firmware/DESIGN.md, "Filter". 0.1 KB of state, 20 ns per window.
#ifndef IPE_POSE_DWELL_H
#define IPE_POSE_DWELL_H

#include "config.h"
#include "types.h"
#include "window.h"

typedef struct {
    double p[3], R[3][3];  ///< the pose as first seen
    int n_slow;            ///< slow windows in it
} ipe_pose_dwell_t;

/// The next window is the first of a new pose.
void ipe_pose_dwell_restart(ipe_pose_dwell_t* s);

/// Windows at rest in this window's pose, this one included; 0: it moves.
int ipe_pose_dwell_push(ipe_pose_dwell_t* s, const ipe_config_t* config, const ipe_average_t* average);

#endif
