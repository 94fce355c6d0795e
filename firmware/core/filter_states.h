// SPDX-License-Identifier: Apache-2.0
/// What the filter on the platform carries beside theta, and its equations:  y = [Y, -X, -G, -A] x + noise.
///
///   xi       11 + 2m  systematic errors of the sensors, systematic.h
///   pattern  6        attachments off their places, as far as it shows: cable i's by sum_k pattern_k,i c_k, c_k [3] in P, m
///   wander   3        slow error of the attitude about its bias, P axes, rad: first-order Gauss-Markov
/// A force F_i that acts e_i away from its attachment adds e_i x F_i to the moment. The pull along the resultant does so like
/// a shift of the CoG, which nothing tells apart; the two patterns are the cables' shares of the pull across it, taken from
/// the first window, and hold most of the rest. Attitude wander turns the whole weight and outlasts many windows: as noise
/// it would be the largest by far.
/// Source: firmware/DESIGN.md, "States". 0.3 KB, 1 us per window.
#ifndef IPE_FILTER_STATES_H
#define IPE_FILTER_STATES_H

#include "config.h"
#include "rls.h"
#include "systematic.h"
#include "types.h"

#define IPE_WANDER_TIME \
    20.0  ///< s, correlation time of wander; a third or three times as long changes no error by a tenth

enum { IPE_PATTERNS = 2 };

typedef struct {
    double pattern[IPE_PATTERNS][IPE_CABLES_MAX];  ///< orthonormal; all zero until the first window
    int64_t t_ns;                                  ///< middle of the last window, 0: none yet
} ipe_filter_states_t;

/// Number of states of a robot with n_cables: 30 + 2 n_cables.
int ipe_filter_states_count(int n_cables);

/// One sigma [ipe_filter_states_count() - IPE_NP] of each state beside theta before any data, > 0.
void ipe_filter_states_std(const ipe_config_t* config, double std[IPE_NX_MAX - IPE_NP]);

void ipe_filter_states_init(ipe_filter_states_t* s);

/// Rows H [6][ipe_filter_states_count()] of a window with regressor Y and systematic columns X.
void ipe_filter_states_rows(ipe_filter_states_t* s, const ipe_config_t* config, const double Y[IPE_NY][IPE_NP],
                            const double X[IPE_NY][IPE_XI_MAX], double* H);

/// Take the gain columns of H at tensions without the noise that stands in the measured ones f [m], N.
///
///   innovation, S  of H [6], and its covariance by the states [6][6]
///   L              factor of the noise's covariance
///
/// With the measured ones a gain common to all cables gets its column from the noise, which it makes smaller, and the body
/// with it: 1 % too light on a slow robot of 6 cables, at 3 sigma. The noise's part of the innovation, V (S + V)^-1 of it, is
/// explained by the smallest change of tensions.
void ipe_filter_states_denoise_gain_columns(const ipe_config_t* config, const double f[IPE_CABLES_MAX],
                                            const double innovation[IPE_NY], const double S[IPE_NY][IPE_NY],
                                            const double L[IPE_NY][IPE_NY], double* H);

/// Time goes on to a window at t_ns: what wanders fades and is driven on.
void ipe_filter_states_advance(ipe_filter_states_t* s, const ipe_config_t* config, int64_t t_ns, ipe_rls_t* rls);

#endif
