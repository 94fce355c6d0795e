// SPDX-License-Identifier: Apache-2.0
/// What small systematic errors of the sensors do to the weak equations: columns d(y - Y theta)/d xi.
///
/// xi holds corrections to add to the calibration in the configuration (same signs, units and axes as there):
///   attitude 3, world yaw 1, acc bias 3, IMU alignment 3, position delay 1, force offset m, force gain m
/// which the filter on the platform carries as states, and, for the host,
///   gyro bias 3 (better taken at rest), force delay 1 (no measurable effect on theta).
/// With xi true, y + X xi - Y theta is noise. The wrench's part is taken at the pose, tensions and slopes of the
/// window's middle, its derivative with respect to pose by central differences of the wrench matrix; Y's part is exact.
/// Source: firmware/DESIGN.md, "Systematic parameters". No state, any thread, about 5 us per window of 8 cables.
#ifndef IPE_SYSTEMATIC_H
#define IPE_SYSTEMATIC_H

#include "config.h"
#include "types.h"
#include "window.h"

enum {
    IPE_XI_ATTITUDE = 0,         ///< rad, P axes: R_true = R exp(xi)
    IPE_XI_YAW = 3,              ///< rad: R_true = Rz(xi) R
    IPE_XI_ACC_BIAS = 4,         ///< m/s2, I axes
    IPE_XI_ALIGNMENT = 7,        ///< rad, P axes: R_PI_true = exp(xi) R_PI, so s, w and the attitude turn
    IPE_XI_POSITION_DELAY = 10,  ///< s
    IPE_XI_FORCE = 11,  ///< offsets m [N], then gains m; after them gyro bias 3 [rad/s, I axes], force delay 1 [s]
};

/// Number of systematic parameters of a robot with n_cables, and how many of them, the first, the filter carries.
int ipe_systematic_count(int n_cables);
int ipe_systematic_filter_count(int n_cables);

/// Write the name of parameter index of a robot with n_cables into name: "acc_bias_x", "force_offset_3". Index below
/// ipe_systematic_count(n_cables).
enum { IPE_SYSTEMATIC_NAME_MAX = 24 };
void ipe_systematic_name(int n_cables, int index, char name[IPE_SYSTEMATIC_NAME_MAX]);

/// One sigma [ipe_systematic_count()] of each, from the configuration's std_*.
void ipe_systematic_std(const ipe_config_t* config, double std[IPE_XI_MAX]);

/// X [6][ipe_systematic_count()] = d(y - Y theta)/d xi of one window; theta about the IMU.
///
/// IPE_OK, or IPE_ERR_GEOMETRY: a cable has no direction near this pose, X not to be used.
ipe_status_t ipe_systematic_columns(const ipe_config_t* config, const ipe_average_t* average,
                                    const double theta[IPE_NP], double X[IPE_NY][IPE_XI_MAX]);

#endif
