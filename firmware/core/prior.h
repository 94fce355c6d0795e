// SPDX-License-Identifier: Apache-2.0
/// The configured prior of theta, as the filter needs it: about the IMU. No state, any thread.
///
/// The configuration gives mean and covariance about P; the equations of motion hold about the IMU. Forgetting divides the
/// filter's covariance, so the prior is folded in again from time to time with the weight that forgetting took from it.
/// Source: firmware/DESIGN.md, "Filter".
#ifndef IPE_PRIOR_H
#define IPE_PRIOR_H

#include "config.h"
#include "filter_states.h"
#include "rls.h"
#include "types.h"

/// Mean [10] and covariance [10][10] of theta about the IMU before any data.
void ipe_prior_at_imu(const ipe_config_t* config, double theta[IPE_NP], double P[IPE_NP][IPE_NP]);

/// Start the filter from the prior: theta about the IMU, every other state of `states` at 0 with its prior sigma.
///
/// IPE_OK; IPE_ERR_CONFIG: the covariance shifted to the IMU is not positive definite, rls not usable.
ipe_status_t ipe_prior_start(const ipe_config_t* config, const ipe_filter_states_t* states, ipe_rls_t* rls);

/// Fold the prior into the filter as one more row per state, each multiplied by weight, 0 .. 1: the rows of `count` states
/// from `first` on, so that a caller can fold it in parts. One after the other they equal all at once.
void ipe_prior_fold(const ipe_config_t* config, const ipe_filter_states_t* states, double weight, int first, int count,
                    ipe_rls_t* rls);

/// One sigma [10] of what an unknown payload adds to theta about the IMU, from the cables' strength and the platform's
/// size.
void ipe_prior_payload_std(const ipe_config_t* config, double std[IPE_NP]);

#endif
