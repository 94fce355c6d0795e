// SPDX-License-Identifier: Apache-2.0
/// What goes into batch identification and what comes out of it.
#pragma once

#include "../derived.hpp"
#include "../types.hpp"

extern "C" {
#include "body.h"
}

#include <string>
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
    bool is_weight_learnt = true;   ///< V_run from the residuals; false: the configured covariance holds
    int n_steps_max = 160;

    bool is_wanted(int i) const { return is_free.empty() || is_free[static_cast<std::size_t>(i)]; }
};

/// What a group's data say about its body, about P.
struct BatchBody {
    Theta theta;              ///< as the data have it
    Theta theta_possible;     ///< the nearest in the metric of P that a body can have
    Covariance P;
    ipe_body_t body;          ///< of theta_possible
    bool is_consistent;
    double distance;          ///< Mahalanobis squared, theta to theta_possible
    ipe_body_t prior;         ///< its standard deviations are the prior's
    bool observable[IPE_NP];  ///< of mass, CoG, inertia about it: sigma at most half the prior's
};

/// How well a run agrees.
struct BatchFit {
    std::size_t n_rows, n_windows, n_rest;
    Vector6 rms;              ///< of the windows' residual, N, N m
    Vector6 noise_std;        ///< root of the diagonal of V_run
    double correlation_time;  ///< s: long-run variance over variance, in windows' steps; of the worst channel
    double n_lags;            ///< bandwidth of the long-run variance, windows
};

/// What a stretch of a run contributes to the equations at the solution, scaled by prior sigmas.
struct BatchBlock {
    int run;
    double begin, end;  ///< s since the run's first row: middle of the first and the last window
    std::size_t n_windows;
    Eigen::MatrixXd H;  ///< A^T A [n][n]
    Eigen::VectorXd g;  ///< A^T b [n]
};

struct BatchResult {
    std::vector<BatchBody> body;    ///< by group
    std::vector<BatchFit> fit;      ///< by run
    Eigen::VectorXd xi;             ///< corrections to the configured calibration
    Eigen::VectorXd xi_std;         ///< published
    Eigen::MatrixXd P;              ///< published covariance of all theta (about the IMU), the free xi, the attachments
    Eigen::VectorXd prior_std;      ///< of the same unknowns
    std::vector<int> free;          ///< indices of the free xi
    std::vector<BatchBlock> block;  ///< all windows, in order
    Eigen::MatrixXd H_prior;        ///< of priors, known mass differences and sensor means; scaled as the blocks
    int n_steps;
    double last_step;               ///< largest way left to the solution, in posterior sigmas
    Eigen::Index slowest;           ///< the unknown that has it
    double weight_change;           ///< largest relative change of V_run's standard deviations, were it learnt again
    bool is_converged;
    std::string refused;  ///< why the last trial step was refused by the configuration's ranges; empty: it was not
};

}  // namespace inertiad
