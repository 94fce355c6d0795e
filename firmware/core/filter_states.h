// SPDX-License-Identifier: Apache-2.0
/// States of the filter on the platform, in blocks, and their equations:  y = [Y, -X, -G, -A] x + noise.
///
///   theta      10       inertial parameters about the IMU
///   attitude .. cable inertia  up to 20  systematic errors of sensors and cables, a block each, systematic.h
///   external force, stiffness  up to 6  of a hose or an energy chain, W axes
///   force offset m     random walk of std_force_offset_drift
///   force gain m - 1   gains in an orthonormal basis of those that sum to zero: the common one scales theta and is not
///                      observable; its sigma is added when the estimate is published, estimate.h
///   friction   1       of all cables alike
///   pattern    6        errors of the attachments' places: cable i's is sum_k pattern_k,i c_k, c_k [3] in P, m
///   wander     3        slow error of the attitude about its bias, W axes, rad: first-order Gauss-Markov
/// One table in filter_states.c holds the blocks: their sizes, prior sigmas and the robots that have them; a block whose
/// prior sigma is 0 is not there. The layout, made
/// from it once, gives each block's first index; no index is written anywhere else.
/// A force F_i that acts e_i away from its attachment adds e_i x F_i to the moment. The part along the resultant acts like
/// a shift of the CoG and is not observable; the two patterns are the cables' shares of the force across the resultant,
/// taken from the first window, and hold most of the rest. Attitude wander turns the whole weight and outlasts many
/// windows: modelled as white noise it would dominate all others.
/// Source: firmware/DESIGN.md, "States". 0.4 KB, 1 us per window.
#ifndef IPE_FILTER_STATES_H
#define IPE_FILTER_STATES_H

#include "config.h"
#include "rls.h"
#include "systematic.h"
#include "types.h"

#define IPE_DRIFT_INTERVAL \
    5.0  // s between two steps of the offsets' random walk: chosen so that it costs next to nothing

/// Blocks of states, in their order in the filter. The systematic blocks follow each other in the order of systematic.h.
typedef enum {
    IPE_BLOCK_THETA,
    IPE_BLOCK_ATTITUDE,
    IPE_BLOCK_YAW,
    IPE_BLOCK_ACC_BIAS,
    IPE_BLOCK_ALIGNMENT,
    IPE_BLOCK_POSITION_DELAY,
    IPE_BLOCK_FORCE_DELAY,
    IPE_BLOCK_ATTITUDE_DELAY,
    IPE_BLOCK_IMU_POSITION,
    IPE_BLOCK_TRACKER_TARGET,
    IPE_BLOCK_CABLE_INERTIA,
    IPE_BLOCK_EXTERNAL_FORCE,
    IPE_BLOCK_EXTERNAL_STIFFNESS,
    IPE_BLOCK_FORCE_OFFSET,
    IPE_BLOCK_FORCE_GAIN,
    IPE_BLOCK_FRICTION,
    IPE_BLOCK_PATTERN,
    IPE_BLOCK_WANDER,
    IPE_BLOCKS,
} ipe_block_t;

/// Place of each block among the states of one robot.
typedef struct {
    int n;                  ///< states in all
    int first[IPE_BLOCKS];  ///< index of the block's first state
    int count[IPE_BLOCKS];  ///< its states; 0: this robot does not have it
} ipe_filter_layout_t;

typedef struct {
    ipe_filter_layout_t layout;
    bool has_patterns;                             ///< chosen, from the first window
    double pattern[IPE_PATTERNS][IPE_CABLES_MAX];  ///< orthonormal; all zero until chosen
    double std[IPE_BLOCKS];  ///< prior sigma of each block's states: as configured, or wider, ipe_filter_states_widen()
    double gain_basis[IPE_CABLES_MAX - 1][IPE_CABLES_MAX];  ///< [state][cable]: orthonormal, each sums to zero
    int64_t t_ns;        ///< middle of the window that the states were last predicted to, 0: none
    int64_t drifted_ns;  ///< time up to which the force offsets have been allowed their drift
} ipe_filter_states_t;

/// Lay out the states of a robot with this configuration; no pattern chosen, no window seen.
void ipe_filter_states_init(ipe_filter_states_t* s, const ipe_config_t* config);

/// Name of a block: "theta", "attitude", ... Static storage.
const char* ipe_filter_states_name(ipe_block_t block);

/// One sigma [layout.n - IPE_NP] of each state after theta before any data, > 0.
void ipe_filter_states_std(const ipe_filter_states_t* s, double std[IPE_NX_MAX - IPE_NP]);

/// Widen the prior of a delay, place, friction or external force whose estimate the prior makes implausible, beyond 3 sigma.
/// Its sigma becomes what the data alone say, as if it had been from the start. Such declarations are often wrong by factors, and a
/// Gaussian prior would pull the error into the body: forces 20 ms late under a sigma of 1 ms came out as 12 ms.
void ipe_filter_states_widen(ipe_filter_states_t* s, ipe_rls_t* rls);

/// Predict the states to the middle of a window: wander decays over its correlation time and is driven, both as the motion
/// stage says of its attitude; every 5 s the force offsets drift.
void ipe_filter_states_predict(ipe_filter_states_t* s, const ipe_config_t* config, const ipe_average_t* average,
                               ipe_rls_t* rls);

/// Rows H [6][layout.n] of a window with attitude R, regressor Y and systematic columns X. The first window chooses the
/// patterns.
void ipe_filter_states_rows(ipe_filter_states_t* s, const ipe_config_t* config, const double R[3][3],
                            const double Y[IPE_NY][IPE_NP], const double X[IPE_NY][IPE_XI_MAX], double* H);

/// Systematic errors xi [ipe_systematic_count()] and their standard deviations, from the states: gains and frictions of
/// each cable, the common gain's sigma included; of what is no state 0 and 0.
void ipe_filter_states_systematic(const ipe_filter_states_t* s, const ipe_config_t* config, const ipe_rls_t* rls,
                                  double xi[IPE_XI_MAX], double std[IPE_XI_MAX]);

/// One sigma of the gain that all cables have in common, the mean of m independent ones.
double ipe_filter_states_common_gain_std(const ipe_config_t* config);

/// Rebuild the gain columns of H from tensions without their noise; f [m] are the measured ones, N.
///
///   by_offset      columns of the force offsets [6][m], as in systematic.h
///   innovation, S  of H [6], and its covariance by the states [6][6]
///   L              factor of the noise's covariance
///
/// With measured tensions a gain common to all cables correlates with their noise, and the estimated body becomes too
/// light: 1 % on a slow robot of 6 cables, at 3 sigma. The noise's part of the innovation, V (S + V)^-1 of it, is
/// attributed to the smallest change of tensions that explains it.
void ipe_filter_states_denoise_gain_columns(const ipe_filter_states_t* s,
                                            const double by_offset[IPE_NY][IPE_CABLES_MAX],
                                            const double f[IPE_CABLES_MAX], const double innovation[IPE_NY],
                                            const double S[IPE_NY][IPE_NY], const double L[IPE_NY][IPE_NY], double* H);

#endif
