// SPDX-License-Identifier: Apache-2.0
/// The estimator: windows of averaged motion and wrench in, inertial parameters and systematic errors out.
///
///   predict   the states to the window's time                                     filter_states.h
///   update    equations -> innovation -> static? other payload? -> forget -> noise -> rows into the filter
///   publish   theta, P -> estimate                                                 estimate.h
/// A static pose carries information once: after 50 windows at rest it is only monitored. A payload change loosens theta to
/// what the robot can carry; while it is only suspected the windows are held back, change_detector.h. Where the estimate
/// moves more than its sigma allows, the published sigma is wider, misfit_score.h. The noise that whitens the equations is
/// the innovations' own long-run covariance. The daemon's pipeline and the host's rehearsal of a planned motion run this
/// same cycle. An update may be taken in parts, so that a processor without threads can do something else in between.
/// Everything it has learnt is in ipe_estimator_t, which holds no pointers: a checkpoint stores it whole.
/// Source: firmware/DESIGN.md, "Filter". 33 KB of state for 16 cables, 22 KB for 8, 90 us per window of 8 cables, no heap, one thread.
#ifndef IPE_ESTIMATOR_H
#define IPE_ESTIMATOR_H

#include "change_detector.h"
#include "config.h"
#include "consistency.h"
#include "eiv_correction.h"
#include "estimate.h"
#include "filter_states.h"
#include "misfit_score.h"
#include "noise.h"
#include "pose_dwell.h"
#include "rls.h"
#include "types.h"
#include "window.h"

/// Read freely, write never.
typedef struct {
    ipe_filter_states_t filter_states;
    ipe_rls_t rls;
    ipe_noise_t noise;
    ipe_eiv_correction_t eiv_correction;
    ipe_change_detector_t change_detector;
    ipe_pose_dwell_t pose_dwell;
    ipe_misfit_score_t misfit_score;
    double force_delay;  ///< s, estimated; the caller takes it out of the forces before they come here; 0: none
    int n_delays;        ///< times it was
    double nis;          ///< normalised innovation squared of the last window
    uint64_t n_excited;  ///< windows not at rest
    double restored[IPE_CABLES_MAX];      ///< last most probable reading of each failed sensor, N
    int64_t restored_ns[IPE_CABLES_MAX];  ///< middle of its window
    uint64_t n_weighted;                  ///< windows that counted for less because they stood out
    uint32_t unknown_force;               ///< of the last window, as in ipe_average_t
    uint64_t n_unknown_force;             ///< windows with a force unknown
    uint64_t n_rows;                      ///< rows the windows were made of, counted by the caller
    uint64_t n_refused;                   ///< estimates not published because a value was not finite
    ipe_estimate_t estimate;              ///< as last published; n_windows 0: none yet
} ipe_estimator_t;

/// An update that has begun: rows that wait to be folded in. The caller's, 3 KB for 8 cables.
typedef struct {
    double H[IPE_NY * IPE_NX_MAX];  ///< whitened equations z = H x
    double z[IPE_NY];
    int64_t t_ns;                   ///< the window's middle
    double prior_weight;            ///< of the prior's rows; 0: none is due
    int n_prior;                    ///< of them folded in
    bool is_scored;                 ///< by misfit_score.h
    bool is_folded;                 ///< H is in the filter: implausible priors are left to look for
} ipe_update_t;

/// Start from the configured prior, all counters 0. config must be checked.
///
/// IPE_OK; IPE_ERR_CONFIG: the prior shifted to the IMU is not positive definite, e not usable.
ipe_status_t ipe_estimator_init(ipe_estimator_t* e, const ipe_config_t* config);

/// Forget what was learnt and start from the prior; n_rows and n_refused go on.
void ipe_estimator_reset(ipe_estimator_t* e, const ipe_config_t* config);

/// Go on from an estimator of the same robot, sensors and priors, after a gap of unknown length.
void ipe_estimator_continue(ipe_estimator_t* e, const ipe_estimator_t* from);

/// Predict the states to the middle of the next window; before each ipe_estimator_update().
void ipe_estimator_predict(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average);

/// Forces of failed sensors become the most probable ones by the other cables, in average->f and average->y: the columns of
/// pose and attachments need them. Where all sensors are well, nothing changes.
///
/// IPE_OK, or IPE_ERR_*: refused as by ipe_estimator_update(), nothing changed.
ipe_status_t ipe_estimator_restore_forces(ipe_estimator_t* e, const ipe_config_t* config, ipe_average_t* average);

/// Judge a window's equations and lay their rows ready in u. Nothing else may be done to e until they are folded in or given up.
///
/// IPE_UNFINISHED  ipe_estimator_go_on() until it is IPE_OK
/// IPE_OK          only monitored because the pose at rest is known, or held back in a misfit: publish, it is marked
/// IPE_NOT_READY   held back: a change of payload is suspected
/// IPE_ERR_*       refused: a cable has no direction, or a value is not finite (counted); the states are as predicted
ipe_status_t ipe_estimator_begin(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average,
                                 ipe_update_t* u);

/// Fold in some of the rows that ipe_estimator_begin() has laid ready. IPE_UNFINISHED, or IPE_OK: the update is done, publish.
ipe_status_t ipe_estimator_go_on(ipe_estimator_t* e, const ipe_config_t* config, ipe_update_t* u);

/// Update the states with a window's equations, all at once. Status as of ipe_estimator_begin(), never IPE_UNFINISHED.
ipe_status_t ipe_estimator_update(ipe_estimator_t* e, const ipe_config_t* config, const ipe_average_t* average);

/// Publish the states as of the window at t_ns into e->estimate.
///
/// IPE_OK; IPE_ERR_NONFINITE: a value is not finite or no body is near, counted, e->estimate as it was.
ipe_status_t ipe_estimator_publish(ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns);

/// A publication that has begun. The caller's, 3 KB.
typedef struct {
    int64_t t_ns;
    double theta[IPE_NP], covariance[IPE_NP][IPE_NP];  ///< about P, before the nearest consistent body is looked for
    double sigma_factor, distance;                     ///< of ipe_estimate_t
    bool is_provisional, is_consistent;
    ipe_status_t searched;                             ///< IPE_UNFINISHED: the nearest consistent body is not found yet
    ipe_projection_t search;
} ipe_publication_t;

/// The first part of ipe_estimator_publish(). With step and std, both NULL or [10], of a body that differs from the states' by
/// step +- std, about the IMU, in units of theta; marked as provisional. Both finite, std not negative; the states stay as they
/// are.
void ipe_estimator_begin_publication(const ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns,
                                     const double* step, const double* std, ipe_publication_t* publication);

/// The rest, the states being as at its begin. IPE_UNFINISHED: call again; else as of ipe_estimator_publish(): a body that cannot
/// exist is not published.
ipe_status_t ipe_estimator_go_on_publication(ipe_estimator_t* e, const ipe_config_t* config,
                                             ipe_publication_t* publication);

/// Sums of one window, shorter than the estimator's own, for body_step.h: its innovation under the present states, which stay
/// as they are. N, N m, about the IMU. The noise learnt is that of the own windows; that of a shorter one is larger. Forces of
/// failed sensors are restored in average and taken out of the sums.
///
/// IPE_OK; IPE_NOT_READY: there is no estimate yet, sums not written; IPE_ERR_*: refused as by ipe_estimator_update().
ipe_status_t ipe_estimator_contrast(ipe_estimator_t* e, const ipe_config_t* config, ipe_average_t* average,
                                    ipe_body_step_t* sums);

/// Is the noise learnt, not only declared?
bool ipe_estimator_is_noise_learnt(const ipe_estimator_t* e);

/// The body is another one now: theta moves by step [10] about the IMU, loosened by std [10]; NULL: as by any change of
/// payload. What is known of the sensors stays.
void ipe_estimator_move(ipe_estimator_t* e, const ipe_config_t* config, const double step[IPE_NP],
                        const double std[IPE_NP]);

/// Theta and P about the IMU with all that ipe_estimate_publish() needs.
void ipe_estimator_solution(const ipe_estimator_t* e, const ipe_config_t* config, ipe_solution_t* solution);

/// Move the forces' delay out of the states where it is sure and too large to be linear: it is added to e->force_delay.
/// Everything else that was learnt is forgotten, since it rests on wrong instants; e->estimate stays until the next one.
/// The caller takes e->force_delay out of the forces. At most 4 times; looks once in 50 windows. True: moved.
bool ipe_estimator_move_force_delay(ipe_estimator_t* e, const ipe_config_t* config);

/// A gap: the next window does not follow the last.
void ipe_estimator_restart_windows(ipe_estimator_t* e);

#endif
