// SPDX-License-Identifier: Apache-2.0
/// Tensions of an aligned row and the platform's pose -> wrench of the cables, P axes, at the IMU point.
///
///   f_i = (measured_i - offset_i)/(1 + gain_i)
///   F = sum R^T (f_i u_i + sag_i)    tau = sum (b_i - p_I) x R^T (f_i u_i + sag_i)
///   friction_i = f_i z_i,  z_i -> sgn(l_i') over 2 mm of travel (Dahl), l_i' = -u_i . (v + R (w x b_i)): speeds below
///                1.5 cm/s do not count as travel, so that at rest z_i stays
/// Source: firmware/DESIGN.md, "Cables". 2 KB of state, about 0.5 us for 8 cables, one thread.
#ifndef IPE_WRENCH_H
#define IPE_WRENCH_H

#include "cable.h"
#include "config.h"
#include "types.h"

typedef struct {
    const ipe_config_t* config;
    int64_t t_ns;                     ///< of the last row, 0: none yet
    double f[IPE_CABLES_MAX];         ///< last measured tensions, N: those of cables whose force is unknown
    double rest_speed;                ///< m/s, below which friction fades with the speed
    double friction[IPE_CABLES_MAX];  ///< z_i, -1 .. 1: 1 while the cable is paid out
    uint64_t n_rows;                  ///< rows turned into a wrench
    uint64_t n_geometry;              ///< rows refused: a cable without direction
    uint64_t n_slack;                 ///< rows used with a cable below its tension_min
    uint64_t n_overload;              ///< rows used with a cable above its tension_max
} ipe_wrench_stage_t;

/// config is kept by pointer and must outlive the stage.
void ipe_wrench_init(ipe_wrench_stage_t* w, const ipe_config_t* config);

/// A force that is unknown is held at its last measured value.
///
/// IPE_OK, or IPE_ERR_GEOMETRY: counted, wrench not to be used.
ipe_status_t ipe_wrench_from_row(ipe_wrench_stage_t* w, const ipe_row_t* row, const ipe_motion_t* motion,
                                 ipe_wrench_t* wrench);

/// Columns of the wrench matrix W [6][n_cables] and the weight's wrench sag [6] at the body point (P, m) for the pose
/// p, R: wrench = W f + sag, P axes.
///
/// IPE_OK or IPE_ERR_GEOMETRY. No state.
ipe_status_t ipe_wrench_matrix(const ipe_config_t* config, const double p[3], const double R[3][3],
                               const double point[3], double W[IPE_NY][IPE_CABLES_MAX], double sag[IPE_NY]);

#endif
