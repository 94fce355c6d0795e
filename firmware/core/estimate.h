// SPDX-License-Identifier: Apache-2.0
/// From a least-squares solution about the IMU to the estimate that is published: the only place with these rules.
///
///   1. take the spurious information of a noisy regressor out of theta and P          eiv_correction.h
///      then multiply P by what misfit demands
///   2. shift both from the IMU to P                                                   body.h
///   3. project theta onto the parameters of bodies that can exist, in the metric of P  consistency.h
///   4. add the uncertainty of the attachments' common place: P moves against them by std_geometry / sqrt(m);
///      and of the gain that all force sensors have in common, which scales theta: P += theta theta^T std^2
///   5. mass, CoG and inertia with their standard deviations; observable where the data halved the prior's
/// The filter on the platform, the fit on the host and the planner's prediction call it. No state, any thread, 25 us.
#ifndef IPE_ESTIMATE_H
#define IPE_ESTIMATE_H

#include "body.h"
#include "config.h"
#include "types.h"

/// A solution of the equations of motion, all about the IMU.
typedef struct {
    double theta[IPE_NP], covariance[IPE_NP][IPE_NP];              ///< as the equations and the prior give them
    double prior_theta[IPE_NP], prior_covariance[IPE_NP][IPE_NP];  ///< before the data
    double spurious[IPE_NP]
                   [IPE_NP];  ///< information that noise in the regressor pretends, ipe_eiv_correction_information()
    double inflation;         ///< of P for misfit, after the correction for the regressor's noise; at least 1
    double std_geometry;      ///< m, of an attachment's place; 0: the solution contains it already
    double std_common_gain;   ///< of the force sensors' mean gain; 0: the solution contains it already
} ipe_solution_t;

/// Estimated parameters of the platform. P: platform frame, C: centre of gravity; inertia xx yy zz yz xz xy, matrix entries.
typedef struct {
    int64_t t_ns;                       ///< middle of the last window used
    uint64_t n_windows, n_rows;         ///< used so far
    ipe_body_t body;                    ///< mass, CoG, inertia about C, with standard deviations
    double theta[IPE_NP];               ///< m, h, J about P
    double covariance[IPE_NP][IPE_NP];  ///< of theta
    int n_systematic;                   ///< systematic parameters, see systematic.h
    double systematic[IPE_XI_MAX];      ///< correction to the configured calibration
    double systematic_std[IPE_XI_MAX];
    bool observable[IPE_NP];            ///< of m, cog, inertia_cog: sigma at most half the prior's
    bool consistent;         ///< physically consistent; false: theta and body are the nearest consistent ones
    double distance;         ///< Mahalanobis distance squared to it, 0 if consistent
    double nis;              ///< normalised innovation squared of the last window
    uint64_t n_changes;      ///< payload changes noticed so far; a contact that is broken off is two, there and back
    uint32_t unknown_force;  ///< bit i: cable i's sensor has failed, the last window went on without it
    double sigma_factor;     ///< by which misfit widened the sigmas, at least 1: misfit_score.h, change_detector.h
    bool is_provisional;     ///< an announced payload is coming into contact, announcement.h
    bool is_misfit;  ///< held: neither this body nor another explains the windows of the last 5 s; the sigmas are wider
} ipe_estimate_t;

/// Apply the rules above. Writes theta, covariance, body, consistent, distance and observable of e; the rest is the caller's.
///
///   prior_body  body whose standard deviations `observable` compares with
///   measured    out, [10], may be NULL: theta about P before the projection
///
/// IPE_OK; IPE_ERR_NONFINITE: no consistent body near theta, mass not positive or a value not finite; e not to be used.
ipe_status_t ipe_estimate_publish(const ipe_config_t* config, const ipe_solution_t* solution,
                                  const ipe_body_t* prior_body, double measured[IPE_NP], ipe_estimate_t* e);

/// The first part of ipe_estimate_publish(): the solution corrected for noise in the regressor, as theta [10] about P and its
/// covariance. Between this and the last part the nearest consistent body is looked for, consistency.h.
void ipe_estimate_correct(const ipe_config_t* config, const ipe_solution_t* solution, double theta[IPE_NP],
                          double covariance[IPE_NP][IPE_NP]);

/// The last part: e has theta of a consistent body, covariance, consistent and distance; the rest as there.
ipe_status_t ipe_estimate_finish(const ipe_config_t* config, double std_geometry, double std_common_gain,
                                 const ipe_body_t* prior_body, ipe_estimate_t* e);

/// The configured prior as a body, about P; its standard deviations are what `observable` compares with.
void ipe_estimate_prior_body(const ipe_config_t* config, ipe_body_t* body);

/// Covariance [10][10] of a published estimate's mass, CoG and inertia about C; its diagonal is body's variances.
void ipe_estimate_body_covariance(const ipe_estimate_t* e, double body_covariance[IPE_NP][IPE_NP]);

#endif
