// SPDX-License-Identifier: Apache-2.0
/// What goes into batch identification and what comes out of it.
#pragma once

#include "../derived.hpp"
#include "../types.hpp"

extern "C" {
#include "body.h"
}

#include <vector>

namespace inertiad {

/// A recorded run: its rows, and which body hung on the robot.
struct BatchRun {
    const std::vector<ipe_row_t>* rows;
    int group;
    Derived derived;
};

struct BatchSettings {
    std::vector<double> payload;  ///< kg, of each group, beside what all groups have in common; size: number of groups
    double payload_std = 0.01;    ///< kg
    bool is_payload_known = false;  ///< mass differences between groups are data
    std::vector<bool> is_free;      ///< of each xi; empty: all
    double theta_prior = 1.0;       ///< factor on the prior sigmas of theta
    int n_weight_steps = 4;         ///< steps after which V_run is left alone; 0: the configured covariance holds
    int n_steps_max = 20;
};

/// What a group's data say about its body, about P.
struct BatchBody {
    Theta theta;              ///< as the data have it
    Theta theta_possible;     ///< the nearest in the metric of P that a body can have
    Covariance P;
    ipe_body_t body;          ///< of theta_possible
    bool is_consistent;
    double distance;          ///< Mahalanobis squared, theta to theta_possible
    bool observable[IPE_NP];  ///< of mass, CoG, inertia about it: sigma at most half the prior's
};

/// How well a run agrees.
struct BatchFit {
    std::size_t n_rows, n_windows, n_rest;
    Vector6 rms;        ///< of the windows' residual, N, N m
    Vector6 noise_std;  ///< root of the diagonal of V_run
};

struct BatchResult {
    std::vector<BatchBody> body;  ///< by group
    std::vector<BatchFit> fit;    ///< by run
    Eigen::VectorXd xi;           ///< corrections to the configured calibration
    Eigen::VectorXd xi_std;       ///< published
    Eigen::MatrixXd P;            ///< published covariance of all theta (about the IMU), the free xi, the attachments
    Eigen::VectorXd prior_std;    ///< of the same unknowns
    std::vector<int> free;        ///< indices of the free xi
    int n_steps;
    double last_step;             ///< largest change of the last step in posterior sigmas
};

}  // namespace inertiad
