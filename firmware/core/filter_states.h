// SPDX-License-Identifier: Apache-2.0
/// States of the filter on the platform, in blocks, and their equations:  y = [Y, -X, -G, -A] x + noise.
///
///   theta      10       inertial parameters about the IMU
///   attitude .. force gain  11 + 2m  systematic errors of the sensors, a block each, systematic.h
///   pattern    6        errors of the attachments' places: cable i's is sum_k pattern_k,i c_k, c_k [3] in P, m
///   wander     3        slow error of the attitude about its bias, P axes, rad: first-order Gauss-Markov
/// One table in filter_states.c holds the blocks: their sizes, prior sigmas and the robots that have them. The layout, made
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

/// Blocks of states, in their order in the filter. The systematic blocks follow each other in the order of systematic.h.
typedef enum {
    IPE_BLOCK_THETA,
    IPE_BLOCK_ATTITUDE,
    IPE_BLOCK_YAW,
    IPE_BLOCK_ACC_BIAS,
    IPE_BLOCK_ALIGNMENT,
    IPE_BLOCK_POSITION_DELAY,
    IPE_BLOCK_FORCE_OFFSET,
    IPE_BLOCK_FORCE_GAIN,
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
    int64_t t_ns;  ///< middle of the window that the states were last predicted to, 0: none
} ipe_filter_states_t;

/// Lay out the states of a robot with this configuration; no pattern chosen, no window seen.
void ipe_filter_states_init(ipe_filter_states_t* s, const ipe_config_t* config);

/// Name of a block: "theta", "attitude", ... Static storage.
const char* ipe_filter_states_name(ipe_block_t block);

/// One sigma [layout->n - IPE_NP] of each state after theta before any data, > 0.
void ipe_filter_states_std(const ipe_filter_layout_t* layout, const ipe_config_t* config,
                           double std[IPE_NX_MAX - IPE_NP]);

/// Predict the states to a window whose middle is t_ns: wander decays over its correlation time and is driven.
void ipe_filter_states_predict(ipe_filter_states_t* s, const ipe_config_t* config, int64_t t_ns, ipe_rls_t* rls);

/// Rows H [6][layout.n] of a window with regressor Y and systematic columns X. The first window chooses the patterns.
void ipe_filter_states_rows(ipe_filter_states_t* s, const ipe_config_t* config, const double Y[IPE_NY][IPE_NP],
                            const double X[IPE_NY][IPE_XI_MAX], double* H);

/// Rebuild the gain columns of H from tensions without their noise; f [m] are the measured ones, N.
///
///   innovation, S  of H [6], and its covariance by the states [6][6]
///   L              factor of the noise's covariance
///
/// With measured tensions a gain common to all cables correlates with their noise, and the estimated body becomes too
/// light: 1 % on a slow robot of 6 cables, at 3 sigma. The noise's part of the innovation, V (S + V)^-1 of it, is
/// attributed to the smallest change of tensions that explains it.
void ipe_filter_states_denoise_gain_columns(const ipe_filter_states_t* s, const double f[IPE_CABLES_MAX],
                                            const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                                            const double L[IPE_NY][IPE_NY], double* H);

#endif
