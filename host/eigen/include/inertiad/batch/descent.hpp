// SPDX-License-Identifier: Apache-2.0
/// The way from the prior to the solution of a batch: damped Gauss-Newton under weights that are learnt on the way.
///
/// Two iterations are nested. Steps creep where the derivative is an instrument's and the residual large, each a share q of
/// the last: such a series is summed, u / (1 - q) (Aitken). Weights V and residuals depend on each other; the fixed point
/// V = learnt(V) is extrapolated (anderson.hpp). How far it still is to the solution is judged by the same sum: a short step
/// of a slow series is far from its end.
#pragma once

#include "anderson.hpp"
#include "problem.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace inertiad::detail {

constexpr double CONVERGED = 1e-3;  // posterior sigmas: chosen so that the way left is invisible in what is published
constexpr double TOLERATED = 0.05;  // posterior sigmas: where steps no longer get shorter, as the two digits of a sigma
constexpr double NEAR = 0.1;        // posterior sigmas: near enough for weights to be learnt from the residuals
constexpr int PATIENCE = 4;         // steps that may fail to halve the shortest one
constexpr int STEPS_UNDER_WEIGHTS = 4;   // before weights that are not settled are learnt again
constexpr double CREEP = 0.5;            // ratio of two steps, from which the geometric series is summed (Aitken),
constexpr double CREEP_MOST = 0.99;      // and where the way left is a hundred steps and more
constexpr double WEIGHT_SETTLED = 0.02;  // relative change of V_run's standard deviations
constexpr double DAMPING_FIRST = 1e-3, DAMPING_LEAST = 1e-7, DAMPING_MAX = 1e8;

/// The way to the solution, see the top of this file.
class Descent {
public:
    Descent(Problem& problem, const BatchSettings& settings) : problem_(problem), settings_(settings) {}

    void run(BatchResult& result)
    {
        if (problem_.is_weight_known) {
            pass_ = problem_.pass();
            arrive(problem_.weighted(pass_), false);
        } else {
            first_step();
        }
        int n_steps_under = 0;  // the present weights
        for (n_steps_ = 1; n_steps_ < settings_.n_steps_max; ++n_steps_) {
            const bool is_due = !is_settled() && n_steps_under >= STEPS_UNDER_WEIGHTS;
            if (is_far() && !is_due && step()) {
                ++n_steps_under;
            } else if (!is_settled()) {
                renew_weights();
                n_steps_under = 0;
            } else if (!widen()) {
                break;
            }
        }
        result.n_steps = n_steps_;
        result.last_step = remaining_;
        next_step_.cwiseAbs().maxCoeff(&result.slowest);
        result.weight_change = weight_change_;
        result.is_converged = is_settled() && remaining_ < TOLERATED;
        result.refused = refused_;
    }

private:
    /// Theta alone: linear, and its residuals give the first weights.
    void first_step()
    {
        const Triangle first = problem_.weighted(problem_.pass());
        problem_.move(problem_.scale.cwiseProduct(first.solve_leading(IPE_NP * problem_.n_groups)));
        pass_ = problem_.pass();
        if (settings_.is_weight_learnt) {
            problem_.set_log_std(problem_.learnt_log_std(pass_));
            problem_.is_weight_known = true;
        }
        arrive(problem_.weighted(pass_), false);
    }

    /// A trial step, longer where steps creep and damped until it is taken. False: no step is.
    bool step()
    {
        const Triangle here = triangle_;
        const bool is_creeping = is_series_ && ratio_ > CREEP && damping_ == 0.0;
        if (is_creeping && is_taken(here, here.solve(0.0) / (1.0 - ratio_), false)) { return true; }
        for (; damping_ < DAMPING_MAX; damping_ = std::max(10.0 * damping_, DAMPING_FIRST)) {
            if (is_taken(here, here.solve(damping_), true)) {
                damping_ = damping_ > DAMPING_LEAST ? 0.1 * damping_ : 0.0;
                return true;
            }
        }
        return false;
    }

    /// Go the step u from the point of triangle here, and stay if the cost or the next step is smaller there. is_series: the
    /// next step continues the series of this one.
    bool is_taken(const Triangle& here, const Eigen::VectorXd& u, bool is_series)
    {
        const Problem::Point start = problem_.point();
        problem_.move(problem_.scale.cwiseProduct(u));
        try {
            Problem::Pass pass = problem_.pass();
            const Triangle there = problem_.weighted(pass);
            const double level = here.step_in_sigmas(here.gradient());
            const double level_now = here.step_in_sigmas(there.gradient());
            if (std::isfinite(there.cost()) && (there.cost() < here.cost() || level_now < level)) {
                refused_.clear();
                pass_ = std::move(pass);
                arrive(there, is_series);
                return true;
            }
        } catch (const std::invalid_argument& error) {
            refused_ = error.what();
        }
        problem_.go_to(start);
        return false;
    }

    /// The weights of the next steps, by extrapolation of those learnt at the points before.
    void renew_weights()
    {
        problem_.set_log_std(anderson_.next(problem_.log_std(), learnt_));
        start_again();
    }

    /// Where steps end, implausible priors become wider, and weights and steps start again from there. False: none is.
    bool widen()
    {
        if (!problem_.widen_priors()) { return false; }
        anderson_.restart();
        start_again();
        return true;
    }

    /// The equations of this point are others now.
    void start_again()
    {
        n_idle_ = 0, shortest_ = HUGE_VAL, damping_ = 0.0;
        ratio_ = 0.0;
        arrive(problem_.weighted(pass_), false);
    }

    /// The point of pass_ is the present one, its equations are triangle.
    void arrive(const Triangle& triangle, bool is_series)
    {
        triangle_ = triangle;
        learnt_ = problem_.take(pass_, triangle_);
        weight_change_ = settings_.is_weight_learnt ? (learnt_ - problem_.log_std()).cwiseAbs().maxCoeff() : 0.0;
        look_ahead(is_series);
    }

    /// The next step in posterior sigmas, and how far it is to where steps like it and the last one lead: |u| / (1 - ratio).
    void look_ahead(bool is_series)
    {
        const Eigen::VectorXd last = next_step_;
        next_step_ = problem_.scale.cwiseProduct(triangle_.solve(0.0)).cwiseQuotient(problem_.P.diagonal().cwiseSqrt());
        const double length = next_step_.cwiseAbs().maxCoeff();
        if (!std::isfinite(length)) { throw std::domain_error("the equations have no finite solution"); }
        is_series_ = is_series;
        if (is_series) { ratio_ = std::clamp(next_step_.dot(last) / last.squaredNorm(), 0.0, CREEP_MOST); }
        remaining_ = length / (1.0 - ratio_);
        n_idle_ = remaining_ < 0.5 * shortest_ ? 0 : n_idle_ + 1;
        shortest_ = std::min(shortest_, remaining_);
    }

    bool is_settled() const { return weight_change_ < WEIGHT_SETTLED; }

    bool is_far() const
    {
        const bool is_at_end = remaining_ < TOLERATED && n_idle_ >= PATIENCE;
        return !is_at_end && remaining_ > (is_settled() ? CONVERGED : NEAR);
    }

    Problem& problem_;
    const BatchSettings& settings_;
    Problem::Pass pass_;
    Triangle triangle_{0};
    Anderson anderson_;
    Eigen::VectorXd learnt_, next_step_;  ///< logarithms of the weights learnt here; step in posterior sigmas
    double damping_ = 0.0, weight_change_ = 0.0, ratio_ = 0.0, remaining_ = HUGE_VAL, shortest_ = HUGE_VAL;
    int n_steps_ = 0, n_idle_ = 0;
    bool is_series_ = false;  ///< ratio_ is that of the last two steps
    std::string refused_;
};

}  // namespace inertiad::detail
