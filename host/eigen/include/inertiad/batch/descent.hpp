// SPDX-License-Identifier: Apache-2.0
/// The way from the prior to the solution of a batch: damped Gauss-Newton under weights that are learnt on the way.
#pragma once

#include "problem.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace inertiad::detail {

constexpr double CONVERGED = 1e-3;  // posterior sigmas: chosen so that the next step is invisible in what is published
constexpr double TOLERATED = 0.05;  // posterior sigmas: where steps no longer get shorter, as the two digits of a sigma
constexpr int PATIENCE = 4;         // steps that may fail to halve the shortest one
constexpr double WEIGHT_SETTLED = 0.02;  // relative change of V_run's standard deviations
constexpr int WEIGHT_STEPS_MAX = 8;
constexpr double DAMPING_FIRST = 1e-3, DAMPING_LEAST = 1e-7, DAMPING_MAX = 1e8;

/// The way to the solution, see the top of this file.
class Descent {
public:
    Descent(Problem& problem, const BatchSettings& settings) : problem_(problem), settings_(settings) {}

    void run(BatchResult& result)
    {
        first_step();
        for (n_steps_ = 1; n_steps_ < settings_.n_steps_max; ++n_steps_) {
            const bool is_here = is_done() || !step();
            if (is_here && !is_settled_) {
                arrive(problem_.pass());  // under renewed weights
            } else if (is_here && !widen()) {
                break;
            }
        }
        result.n_steps = n_steps_;
        result.last_step = last_step_;
        result.is_converged = is_settled_ && last_step_ < TOLERATED;
        result.refused = refused_;
    }

private:
    /// Theta alone: linear, and its residuals give the first weights.
    void first_step()
    {
        const Problem::Pass pass = problem_.pass();
        problem_.move(problem_.scale.cwiseProduct(pass.weighted.solve_leading(IPE_NP * problem_.n_groups)));
        arrive(problem_.pass());
    }

    /// A trial step, damped until it is taken. False: no step is.
    bool step()
    {
        const Triangle here = triangle_;
        const Eigen::VectorXd g = here.gradient();
        const double cost = here.cost(), level = here.step_in_sigmas(g);
        const Problem::Point start = problem_.point();
        for (; damping_ < DAMPING_MAX; damping_ = std::max(10.0 * damping_, DAMPING_FIRST)) {
            problem_.move(problem_.scale.cwiseProduct(here.solve(damping_)));
            try {
                Problem::Pass pass = problem_.pass();
                const double cost_now = pass.weighted.cost();
                const double level_now = here.step_in_sigmas(pass.weighted.gradient());
                if (std::isfinite(cost_now) && (cost_now < cost || level_now < level)) {
                    damping_ = damping_ > DAMPING_LEAST ? 0.1 * damping_ : 0.0;
                    refused_.clear();
                    arrive(std::move(pass));
                    return true;
                }
            } catch (const std::invalid_argument& error) {
                refused_ = error.what();
            }
            problem_.go_to(start);
        }
        return false;
    }

    /// Where steps end, implausible priors become wider, and weights and steps start again from there. False: none is.
    bool widen()
    {
        if (!problem_.widen_priors()) { return false; }
        is_settled_ = false, n_renewed_ = 0, n_idle_ = 0, shortest_ = HUGE_VAL, damping_ = 0.0;
        arrive(problem_.pass());
        return true;
    }

    void arrive(Problem::Pass pass)
    {
        const bool is_renewed = settings_.is_weight_learnt && !is_settled_;
        is_settled_ = !is_renewed || pass.weight_change < WEIGHT_SETTLED || ++n_renewed_ == WEIGHT_STEPS_MAX;
        problem_.take(pass, is_renewed);
        triangle_ = is_renewed ? pass.renewed : pass.weighted;
        const Eigen::VectorXd u = triangle_.solve(0.0);
        last_step_ = (problem_.scale.cwiseProduct(u).array().abs() / problem_.P.diagonal().array().sqrt()).maxCoeff();
        if (!std::isfinite(last_step_)) { throw std::domain_error("the equations have no finite solution"); }
        n_idle_ = last_step_ < 0.5 * shortest_ ? 0 : n_idle_ + 1;
        shortest_ = std::min(shortest_, last_step_);
    }

    bool is_done() const
    {
        return is_settled_ && (last_step_ < CONVERGED || (last_step_ < TOLERATED && n_idle_ >= PATIENCE));
    }

    Problem& problem_;
    const BatchSettings& settings_;
    Triangle triangle_{0};
    double damping_ = 0.0, last_step_ = HUGE_VAL, shortest_ = HUGE_VAL;
    int n_steps_ = 0, n_renewed_ = 0, n_idle_ = 0;
    bool is_settled_ = false;
    std::string refused_;
};

}  // namespace inertiad::detail
