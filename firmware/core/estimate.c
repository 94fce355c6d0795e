// SPDX-License-Identifier: Apache-2.0
#include "estimate.h"

#include "consistency.h"
#include "eiv_correction.h"
#include "smallmat.h"

#include <string.h>

#define OBSERVABLE_SHARE \
    2.0  // prior sigma over posterior: chosen so that at most half of what is published is the prior

/// The CoG is measured from P, which is where the attachments are: their errors' mean moves all of h.
static void add_geometry(const ipe_config_t* config, double std_geometry, double mass, double P[IPE_NP][IPE_NP])
{
    const double std = mass * std_geometry;
    for (int i = 1; i < 4; ++i) { P[i][i] += std * std / config->n_cables; }
}

/// A gain that all force sensors have in common scales the whole wrench, and theta with it.
static void add_common_gain(double std, const double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) { P[i][j] += std * std * theta[i] * theta[j]; }
    }
}

static void judge_observability(const ipe_body_t* prior, const ipe_body_t* body, bool observable[IPE_NP])
{
    observable[0] = OBSERVABLE_SHARE * body->mass_std <= prior->mass_std;
    for (int i = 0; i < 3; ++i) { observable[1 + i] = OBSERVABLE_SHARE * body->cog_std[i] <= prior->cog_std[i]; }
    for (int i = 0; i < 6; ++i) {
        observable[4 + i] = OBSERVABLE_SHARE * body->inertia_cog_std[i] <= prior->inertia_cog_std[i];
    }
}

static bool is_finite(const ipe_estimate_t* e)
{
    return all_finite(e->theta, IPE_NP) && all_finite(&e->covariance[0][0], IPE_NP * IPE_NP) &&
           all_finite(&e->body.mass, sizeof e->body / sizeof(double));
}

void ipe_estimate_correct(const ipe_config_t* config, const ipe_solution_t* solution, double theta[IPE_NP],
                          double covariance[IPE_NP][IPE_NP])
{
    memcpy(theta, solution->theta, sizeof solution->theta);
    memcpy(covariance, solution->covariance, sizeof solution->covariance);
    ipe_eiv_correction_undo(solution->spurious, solution->prior_theta, solution->prior_covariance, theta, covariance);
    for (int i = 0; i < IPE_NP * IPE_NP; ++i) { covariance[i / IPE_NP][i % IPE_NP] *= solution->inflation; }
    ipe_body_shift(config->imu_position, theta, covariance);
}

ipe_status_t ipe_estimate_finish(const ipe_config_t* config, double std_geometry, double std_common_gain,
                                 const ipe_body_t* prior_body, ipe_estimate_t* e)
{
    add_geometry(config, std_geometry, e->theta[0], e->covariance);
    add_common_gain(std_common_gain, e->theta, e->covariance);
    if (ipe_body_from_theta(e->theta, (const double (*)[IPE_NP])e->covariance, &e->body) != IPE_OK || !is_finite(e)) {
        return IPE_ERR_NONFINITE;
    }
    judge_observability(prior_body, &e->body, e->observable);
    return IPE_OK;
}

ipe_status_t ipe_estimate_publish(const ipe_config_t* config, const ipe_solution_t* solution,
                                  const ipe_body_t* prior_body, double measured[IPE_NP], ipe_estimate_t* e)
{
    double theta[IPE_NP];
    ipe_estimate_correct(config, solution, theta, e->covariance);
    if (measured != NULL) { memcpy(measured, theta, sizeof theta); }
    e->consistent = ipe_consistency_check(theta);
    if (!ipe_consistency_project(theta, (const double (*)[IPE_NP])e->covariance, e->theta, &e->distance)) {
        return IPE_ERR_NONFINITE;
    }
    return ipe_estimate_finish(config, solution->std_geometry, solution->std_common_gain, prior_body, e);
}

void ipe_estimate_prior_body(const ipe_config_t* config, ipe_body_t* body)
{
    memset(body, 0, sizeof *body);
    (void)ipe_body_from_theta(config->prior_theta, config->prior_covariance, body);
}

/// out = A B, or A B^T.
static void product(const double A[IPE_NP][IPE_NP], const double B[IPE_NP][IPE_NP], bool is_transposed,
                    double out[IPE_NP][IPE_NP])
{
    for (int i = 0; i < IPE_NP; ++i) {
        for (int j = 0; j < IPE_NP; ++j) {
            out[i][j] = 0.0;
            for (int k = 0; k < IPE_NP; ++k) { out[i][j] += A[i][k] * (is_transposed ? B[j][k] : B[k][j]); }
        }
    }
}

void ipe_estimate_body_covariance(const ipe_estimate_t* e, double body_covariance[IPE_NP][IPE_NP])
{
    double G[IPE_NP][IPE_NP], GP[IPE_NP][IPE_NP];
    ipe_body_jacobian(e->theta, G);
    product((const double (*)[IPE_NP])G, e->covariance, false, GP);
    product((const double (*)[IPE_NP])GP, (const double (*)[IPE_NP])G, true, body_covariance);
}
