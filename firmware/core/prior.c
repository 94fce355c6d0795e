// SPDX-License-Identifier: Apache-2.0
#include "prior.h"

#include "body.h"
#include "smallmat.h"

#include <string.h>

#define PAYLOAD_SHARE (1.0 / 12.0)  // of all tension_max: chosen so that 3 sigma is a quarter of what the cables hold
#define GRAVITY_MIN 1.0             // m/s2: chosen so that a robot in weightlessness has a finite payload

void ipe_prior_at_imu(const ipe_config_t* config, double theta[IPE_NP], double P[IPE_NP][IPE_NP])
{
    const double* imu = config->imu_position;
    const double to_imu[3] = {-imu[0], -imu[1], -imu[2]};
    memcpy(theta, config->prior_theta, sizeof config->prior_theta);
    memcpy(P, config->prior_covariance, sizeof config->prior_covariance);
    ipe_body_shift(to_imu, theta, P);
}

ipe_status_t ipe_prior_start(const ipe_config_t* config, const ipe_filter_states_t* states, ipe_rls_t* rls)
{
    double theta[IPE_NP], P[IPE_NP][IPE_NP], std[IPE_NX_MAX - IPE_NP];
    ipe_prior_at_imu(config, theta, P);
    ipe_filter_states_std(states, std);
    return ipe_rls_init(rls, theta, P, states->layout.n - IPE_NP, std);
}

/// Inverse of the lower Cholesky factor of P [10][10]: rows of unit variance that are the prior. False if P is singular.
static bool prior_rows(const double P[IPE_NP][IPE_NP], double rows[IPE_NP][IPE_NP])
{
    double L[IPE_NP][IPE_NP];
    memcpy(L, P, sizeof L);
    if (!cholesky(&L[0][0], IPE_NP)) { return false; }
    memset(rows, 0, sizeof L);
    for (int j = 0; j < IPE_NP; ++j) {
        rows[j][j] = 1.0 / L[j][j];
        for (int i = j + 1; i < IPE_NP; ++i) {
            for (int k = j; k < i; ++k) { rows[i][j] -= L[i][k] * rows[k][j]; }
            rows[i][j] /= L[i][i];
        }
    }
    return true;
}

void ipe_prior_fold(const ipe_config_t* config, const ipe_filter_states_t* states, double weight, int first, int count,
                    ipe_rls_t* rls)
{
    double row[IPE_NX_MAX], std[IPE_NX_MAX - IPE_NP], theta[IPE_NP], P[IPE_NP][IPE_NP], rows[IPE_NP][IPE_NP];
    ipe_prior_at_imu(config, theta, P);
    if (!prior_rows((const double (*)[IPE_NP])P, rows)) { return; }
    ipe_filter_states_std(states, std);
    for (int i = first; i < rls->n && i < first + count; ++i) {
        double y = 0.0;
        memset(row, 0, sizeof row);
        if (i < IPE_NP) {
            for (int j = 0; j <= i; ++j) {
                row[j] = weight * rows[i][j];
                y += row[j] * theta[j];
            }
        } else {
            row[i] = weight / std[i - IPE_NP];
        }
        ipe_rls_update_row(rls, row, y);
    }
}

void ipe_prior_payload_std(const ipe_config_t* config, double std[IPE_NP])
{
    double strength = 0.0, size2 = 0.0;
    for (int i = 0; i < config->n_cables; ++i) {
        const double* attachment = config->cable[i].attachment;
        strength += config->cable[i].tension_max;
        size2 += vec3_dot(attachment, attachment) / config->n_cables;
    }
    const double mass = PAYLOAD_SHARE * strength / fmax(config->gravity, GRAVITY_MIN);
    for (int i = 0; i < IPE_NP; ++i) {
        std[i] = i == 0 ? mass : i < 4 ? mass * sqrt(size2) : i < 7 ? mass * size2 : mass * size2 / 3.0;
    }
}
