// SPDX-License-Identifier: Apache-2.0
/// Effect of small systematic errors of the sensors on the weak equations: columns d(y - Y theta)/d xi.
///
/// xi holds corrections to add to the configuration (same signs, units and axes as there); the table in systematic.c
/// has their order, names and prior sigmas. With xi true, y + X xi - Y theta is noise.
///   attitude, yaw, attitude delay   turn the pose about the tracked point; the delay by w per second
///   position delay, tracker target  move the pose by the velocity, or by -R e
///   acc bias, alignment, scales     change s, w and alpha: s_true = (1 - xi) s, w_true = (1 - xi) w
///   IMU position                    moves the place that s belongs to: s(reference) = s - ([alpha]x + [w]x[w]x) xi;
///                                   theta and the wrench stay about the configured place
///   force offset, gain, delay       change the tensions
///   force low-pass                  of the forces, of second order beyond its delay: half the variance of its impulse
///                                   response. Its column needs the windows around: the host has it (derived.hpp), here it is 0
///   external force, stiffness       F = force - diag(stiffness) (p + R b - reference) at b adds to the cables' wrench
///   friction, one of each cable     tension at the platform = measured (1 + xi share z), z = sgn(cable travel), wrench.h,
///                                   share of the pulley's wrap, cable.h
/// The wrench's part is taken at the pose, tensions and slopes of the window's middle, its derivative with respect to pose
/// by central differences of the wrench matrix; Y's part is exact.
/// Source: firmware/DESIGN.md, "States". No state, any thread, about 5 us per window of 8 cables.
#ifndef IPE_SYSTEMATIC_H
#define IPE_SYSTEMATIC_H

#include "config.h"
#include "types.h"
#include "window.h"

#include <stdbool.h>
#include <stddef.h>

enum {
    IPE_XI_ATTITUDE = 0,             ///< rad, P axes: R_true = R exp(xi)
    IPE_XI_YAW = 3,                  ///< rad: R_true = Rz(xi) R
    IPE_XI_ACC_BIAS = 4,             ///< m/s2, I axes
    IPE_XI_ALIGNMENT = 7,            ///< rad, P axes: R_PI_true = exp(xi) R_PI, so s, w and the attitude turn
    IPE_XI_POSITION_DELAY = 10,      ///< s
    IPE_XI_FORCE_DELAY = 11,         ///< s
    IPE_XI_ATTITUDE_DELAY = 12,      ///< s
    IPE_XI_IMU_POSITION = 13,        ///< m, P
    IPE_XI_TRACKER_TARGET = 16,      ///< m, P
    IPE_XI_ACC_SCALE = 19,           ///< 1
    IPE_XI_GYRO_SCALE = 20,          ///< 1
    IPE_XI_GYRO_BIAS = 21,           ///< rad/s, I axes
    IPE_XI_CABLE_INERTIA = 24,       ///< 1: the cables' inertia is (1 + xi) times that of cable_inertia.h
    IPE_XI_EXTERNAL_FORCE = 25,      ///< N, W: on the platform, with the attachment at external_reference
    IPE_XI_EXTERNAL_STIFFNESS = 28,  ///< N/m, W: what that force loses per metre away from there, each axis
    IPE_XI_FORCE_LOWPASS = 31,       ///< s2: f_true(t) = f(t + delay) - xi f'', beside the delay
    IPE_XI_FORCE = IPE_XI_FIXED,     ///< offsets m [N], then gains m [1], then frictions m [1]
};

/// Systematic parameters of one kind. Kinds lie in xi one after the other.
typedef struct {
    const char* name;     ///< as in estimate.json
    const char* unit;     ///< SI
    int count;            ///< numbers of the robot
    int count_per_cable;  ///< and of each of its cables
    size_t std;           ///< offset in ipe_config_t of their common sigma
    bool is_ahrs_only;    ///< absent where the motion stage estimates the attitude itself
} ipe_systematic_kind_t;

/// All kinds in the order of xi, and how many there are. Static.
const ipe_systematic_kind_t* ipe_systematic_table(int* n);

/// Number of systematic parameters of a robot with n_cables.
int ipe_systematic_count(int n_cables);

/// How many of them, the first, do not need the cables' speeds: all but the frictions.
int ipe_systematic_planned_count(int n_cables);

/// Write the name of parameter index of a robot with n_cables into name: "acc_bias_x", "force_offset_3". Index below
/// ipe_systematic_count(n_cables).
enum { IPE_SYSTEMATIC_NAME_MAX = 24 };
void ipe_systematic_name(int n_cables, int index, char name[IPE_SYSTEMATIC_NAME_MAX]);

/// One sigma [ipe_systematic_count()] of each, from the configuration's std_*; 0: known, or not a parameter of this robot.
/// With the fused attitude the motion stage has the scales and there is no attitude delay.
void ipe_systematic_std(const ipe_config_t* config, double std[IPE_XI_MAX]);

/// X [6][ipe_systematic_count()] = d(y - Y theta)/d xi of one window; theta about the IMU.
///
/// IPE_OK, or IPE_ERR_GEOMETRY: a cable has no direction near this pose, X not to be used.
ipe_status_t ipe_systematic_columns(const ipe_config_t* config, const ipe_average_t* average,
                                    const double theta[IPE_NP], double X[IPE_NY][IPE_XI_MAX]);

#endif
