// SPDX-License-Identifier: Apache-2.0
#include "pose_dwell.h"

#include "smallmat.h"

#include <string.h>

#define RATE 0.02        // rad/s: chosen over the gyro noise of a window, under the slowest useful motion
#define DISTANCE 0.01    // m: chosen over tracker noise, 3 mm in the paper, and swing at rest
#define TURN 0.02        // rad: chosen as 10 mm at half a metre, and
#define WANDER_SIGMAS 6  // of the attitude's wander, which is no motion
#define FIRST_WINDOWS 5  // in a pose: chosen as one more than overlap the motion before; it may only be passed through
#define MOST 1000000     // windows counted, over a day: chosen so that the count cannot overflow

void ipe_pose_dwell_restart(ipe_pose_dwell_t* s)
{
    memset(s, 0, sizeof *s);
}

static double turn(const double A[3][3], const double B[3][3])
{
    double square = 0.0;
    for (int i = 0; i < 9; ++i) { square += (A[i / 3][i % 3] - B[i / 3][i % 3]) * (A[i / 3][i % 3] - B[i / 3][i % 3]); }
    return sqrt(0.5 * square);
}

static bool has_left(const ipe_pose_dwell_t* s, const ipe_config_t* config, const ipe_average_t* a)
{
    double moved[3];
    vec3_axpy(a->p, -1.0, s->p, moved);
    return vec3_norm(moved) > DISTANCE || turn(a->R, s->R) > TURN + WANDER_SIGMAS * config->std_attitude_wander;
}

int ipe_pose_dwell_push(ipe_pose_dwell_t* s, const ipe_config_t* config, const ipe_average_t* average)
{
    if (has_left(s, config, average)) {
        memcpy(s->p, average->p, sizeof s->p);
        memcpy(s->R, average->R, sizeof s->R);
        s->n_slow = 0;
    }
    if (!(vec3_norm(average->w) < RATE)) { return 0; }
    s->n_slow += s->n_slow < MOST;
    return s->n_slow > FIRST_WINDOWS ? s->n_slow - FIRST_WINDOWS : 0;
}
