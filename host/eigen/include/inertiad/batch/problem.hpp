// SPDX-License-Identifier: Apache-2.0
/// The unknowns of a batch, and its equations at one point.
#pragma once

#include "drift.hpp"
#include "equations.hpp"
#include "long_run.hpp"
#include "motion_noise.hpp"
#include "triangle.hpp"

extern "C" {
#include "eiv_correction.h"
}

#include <Eigen/Cholesky>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace inertiad::detail {

constexpr double BLOCK_LENGTH = 1.0;  // s, at least: two windows and more
constexpr int BLOCKS_MAX = 48;        // of a run: chosen, a fiftieth of it locates a change well enough
constexpr double COMMON_GAIN = 1e-6;  // share of its sigma that a gain common to all force sensors may take
constexpr double SPEED_STD = 0.05;    // m/s, of the vertical speed's change over a run: chosen as a tracker's
constexpr double IMPLAUSIBLE = 3.0;   // sigmas, as in firmware/core/filter_states.c
constexpr double WELL_TOLD = 0.1;     // of a prior's variance: a sigma of the data of three of the prior's
constexpr double IMPLAUSIBLE_FAINT =
    6.0;  // sigmas, of places of which the data tell less: chosen so that other errors of the
          // model do not pass for one; friction passes for a delay beyond that, too
constexpr double LEAST_TOLD = 0.01;  // of a prior's variance, as in firmware/core/filter_states.c
constexpr double SPREAD_SURE =
    2.0;  // times the stated spread of gains: four sensors exceed it by chance once in 135 robots
constexpr double LOW_PASS_TOLD = 3.0;  // sigmas: chosen so that of 370 robots without a low-pass one seems to have one
constexpr double BEND_OF_NOISE =  // variance of white noise's second difference over windows, over that of one window:
    6.0 - (8.0 * 1191.0 - 2.0 * 120.0) / 2416.0;               // cubic B-splines a quarter of their length apart
constexpr double FORCE_DELAYS_TRIED[] = {-0.06, -0.03, 0.03,
                                         0.06,  0.1,   0.15};  // s: chosen so that a step leads from one to
                                                               // the next
constexpr double LASTING = 8.0;              // windows: healthy residuals, whose windows overlap, last for about one
constexpr std::size_t N_OVERLAPPING = 4;     // windows, of a hop of a quarter
constexpr double FORCE_DELAY_WORTH = 16.0;   // fall of the cost: four sigma
constexpr double FORCE_DELAY_UNKNOWN = 1.0;  // s, a prior sigma that says nothing
constexpr std::size_t WINDOWS_DRAWN = 4000;  // with noise: chosen so that its products are known to a fiftieth
constexpr std::size_t DRAWS_MAX = 8;
constexpr double GYRO_FLOOR = 1e-6;          // rad/s: chosen under the bias stability of any MEMS gyro

/// The unknowns: theta of every group about the IMU, the free xi, the attachments' errors; scaled by their prior sigmas in
/// the equations.
struct Problem {
    Problem(const Config& config_, const std::vector<BatchRun>& runs_, const BatchSettings& settings_,
            bool is_low_pass_free)
        : config(config_), runs(runs_), settings(settings_), n_groups(static_cast<int>(settings.payload.size()))
    {
        const int n_xi = ipe_systematic_count(config.n_cables());
        std_xi.resize(IPE_XI_MAX);
        ipe_systematic_std(&config.c(), std_xi.data());
        std_xi.conservativeResize(n_xi);
        for (int i = 0; i < n_xi; ++i) {
            const bool is_wanted = settings.is_wanted(i) && (is_low_pass_free || i != IPE_XI_FORCE_LOWPASS);
            if (is_wanted && std_xi[i] > 0.0) { free.push_back(i); }
        }
        at_geometry = IPE_NP * n_groups + static_cast<int>(free.size());
        n_geometry = free.empty() || config.c().std_geometry <= 0.0 ? 0 : 3 * config.n_cables();
        n = at_geometry + n_geometry;
        geometry = Eigen::VectorXd::Zero(n_geometry);
        set_prior();
        scale.tail(n_geometry).setConstant(config.c().std_geometry);
        xi = Eigen::VectorXd::Zero(n_xi);
        used_std = std_xi;
        V.assign(runs.size(), Eigen::Map<const Matrix6>(&config.c().residual_covariance[0][0]));
    }

    void set_prior()
    {
        const Vector3 to_imu = -Eigen::Map<const Vector3>(config.c().imu_position);
        scale = Eigen::VectorXd::Ones(n);
        for (int g = 0; g < n_groups; ++g) {
            Theta mean = Eigen::Map<const Theta>(config.c().prior_theta);
            Covariance P = Eigen::Map<const Covariance>(&config.c().prior_covariance[0][0]);
            loosen(settings.payload[static_cast<std::size_t>(g)], mean, P);
            prior_std_body.push_back(body_std(mean, P));
            P *= settings.theta_prior * settings.theta_prior;
            ipe_body_shift(to_imu.data(), mean.data(), as_array(P));
            prior_mean.push_back(mean);
            const Eigen::MatrixXd L = P.llt().matrixL();
            prior_rows.push_back(L.inverse());
            scale.segment<IPE_NP>(IPE_NP * g) = P.diagonal().cwiseSqrt();
        }
        theta = prior_mean;
        for (std::size_t i = 0; i < free.size(); ++i) {
            scale[IPE_NP * n_groups + static_cast<Eigen::Index>(i)] = std_xi[free[i]];
        }
    }

    /// A payload somewhere within the platform's size comes to the prior body.
    void loosen(double payload, Theta& mean, Covariance& P) const
    {
        double size2 = 0.0;
        for (int i = 0; i < config.n_cables(); ++i) {
            size2 += Eigen::Map<const Vector3>(config.c().cable[i].attachment).squaredNorm() / config.n_cables();
        }
        mean[0] += payload;
        for (int i = 0; i < IPE_NP; ++i) {
            const double std = i == 0 ? 0.1 * payload : i < 4 ? payload * std::sqrt(size2) : payload * size2;
            P(i, i) += std * std;
        }
    }

    static ipe_body_t body_std(const Theta& mean, const Covariance& P)
    {
        ipe_body_t b{};
        (void)ipe_body_from_theta(mean.data(), as_array(P), &b);
        return b;
    }

    /// What the parameters in which the equations are linear add to a window's wrench.
    Column6 linear_part(const Config& corrected, Derived derived, const SmoothWindow& window, const Theta& x) const
    {
        const SystematicColumns X = systematic_columns(corrected, derived, window, x);
        Column6 sum = Column6::Zero();
        for (const int i : linear_parameters(config.n_cables())) { sum += X.col(i) * xi[i]; }
        return sum;
    }

    /// Rows [A, b] of a run as measured, and what drift does to each window's.
    Equations equations(const RunWindows& run, const BatchRun& of, const Config& corrected) const
    {
        Equations found;
        const Theta& x = theta[static_cast<std::size_t>(of.group)];
        found.rows = Eigen::MatrixXd::Zero(6 * static_cast<Eigen::Index>(run.window.size()), n + 1);
        RestoredForces restored(corrected.c());
        const std::vector<SmoothWindow> smooth = smoothed(of.derived, run.window);
        if (!free.empty()) { found.at = smooth; }
        std::vector<SmoothWindow>& at = found.at;
        std::vector<Eigen::MatrixXd>& W = found.W;
        W.resize(run.window.size());
        std::vector<Column6> residual(run.window.size(), Column6::Zero());
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            const ipe_average_t& a = run.window[k];
            auto block = found.rows.middleRows<6>(6 * static_cast<Eigen::Index>(k));
            Column6 y = Eigen::Map<const Vector6>(a.y);
            found.by_drift.push_back(Eigen::MatrixXd::Zero(6, 3 + config.n_cables()));
            found.by_unknown.emplace_back(6, 0);
            if (free.empty() && a.unknown_force != 0) { continue; }  // only with the sensors' columns it says something
            if (free.empty()) {
                block.middleCols<IPE_NP>(IPE_NP * of.group) = regressor(a);
                block.col(n) = y - regressor(a) * x;
                continue;
            }
            W[k] = wrench_matrix(corrected.c(), a);
            if (n_geometry > 0) { y += geometry_columns(W[k], a) * geometry; }
            y += linear_part(corrected, of.derived, smooth[k], x);
            found.by_unknown.back() = restored.restore(y - regressor(a) * x, at[k], y);
            block.col(n) = y - regressor(a) * x;
            const Regressor Y = regressor(smooth[k].average);
            block.middleCols<IPE_NP>(IPE_NP * of.group) = Y;
            residual[k] = y - Y * x;
        }
        if (free.empty()) { return found; }
        bend_tensions(run.window, W, residual, share_of_motion(run.window, of.derived, x, residual), at);
        for (std::size_t k = 0; k < run.window.size(); ++k) { reproduce(W[k], residual[k], at[k].average); }
        add_columns(run, of, corrected, found);
        return found;
    }

    /// How the tensions of windows bend, for the low-pass's column. Measured tensions have the force sensors' noise. Tensions
    /// that the motion asks for have the motion sensors'. The residual [6] has both. Tensions in between, by the motion
    /// sensors' share [6] of the residual's noise, have none in common with it.
    static void bend_tensions(const std::vector<ipe_average_t>& measured, const std::vector<Eigen::MatrixXd>& W,
                              const std::vector<Column6>& residual, const Column6& share,
                              std::vector<SmoothWindow>& window)
    {
        std::vector<Eigen::VectorXd> f;
        for (std::size_t k = 0; k < window.size(); ++k) {
            ipe_average_t between = window[k].average;
            reproduce(W[k], (1.0 - share.array()).matrix().cwiseProduct(residual[k]), between);
            f.emplace_back(Eigen::Map<const Eigen::VectorXd>(between.f, W[k].cols()));
        }
        set_force_curvature(measured, f, window);
    }

    /// Share of the noise of the motion sensors in that of the residuals, whose quick changes are noise.
    Column6 share_of_motion(const std::vector<ipe_average_t>& window, Derived derived, const Theta& x,
                            const std::vector<Column6>& residual) const
    {
        if (bent_by != BentBy::BOTH) { return Column6::Constant(bent_by == BentBy::TENSIONS ? 1.0 : 0.0); }
        Column6 of_motion = Column6::Zero(), of_all = Column6::Constant(1e-300);
        for (std::size_t k = 1; k + 1 < window.size(); ++k) {
            if (!follows(window, k + 1, 2)) { continue; }
            of_all += (residual[k + 1] - 2.0 * residual[k] + residual[k - 1]).cwiseAbs2() / BEND_OF_NOISE;
            for (const Regressor& dY : regressor_noise(window[k], derived)) { of_motion += (dY * x).cwiseAbs2(); }
        }
        return of_motion.cwiseQuotient(of_all).cwiseMin(1.0);
    }

    /// Columns of the free xi and of the attachments, and what drift does.
    void add_columns(const RunWindows& run, const BatchRun& of, const Config& corrected, Equations& found) const
    {
        const Theta& x = theta[static_cast<std::size_t>(of.group)];
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            auto block = found.rows.middleRows<6>(6 * static_cast<Eigen::Index>(k));
            const SystematicColumns X = systematic_columns(corrected, of.derived, found.at[k], x);
            const Eigen::Matrix3d R = Eigen::Map<const Matrix3>(&run.window[k].R[0][0]);
            found.by_drift[k] << -X.middleCols<3>(IPE_XI_ATTITUDE) * R.transpose(),  // wander about W's axes
                -X.middleCols(IPE_XI_FORCE, config.n_cables());
            block.middleCols(IPE_NP * n_groups, n - IPE_NP * n_groups) =
                shared_columns(X, found.W[k], found.at[k].average);
        }
    }

    /// Columns [6][] of what all groups share: the free xi, from X, and the attachments.
    Eigen::MatrixXd shared_columns(const SystematicColumns& X, const Eigen::MatrixXd& W, const ipe_average_t& a) const
    {
        Eigen::MatrixXd found(6, n - IPE_NP * n_groups);
        for (std::size_t i = 0; i < free.size(); ++i) { found.col(static_cast<Eigen::Index>(i)) = -X.col(free[i]); }
        if (n_geometry > 0) { found.rightCols(n_geometry) = -geometry_columns(W, a); }
        return found;
    }

    /// V of a run from its residuals, wander taken out of them by what V was so far; how correlated they are goes to of.
    Square6 learnt_covariance(const RunWindows& run, const Equations& measured, const Square6& V_before,
                              BatchFit& of) const
    {
        Drift drift(config.c(), !free.empty(), is_weight_known, 1);
        std::vector<Column6> innovation;
        Column6 explained = Column6::Zero(), sum_squares = Column6::Constant(1e-300);
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            Eigen::MatrixXd e = measured.residual(k);
            const Drift::Spread spread =
                drift.take_out(run.window[k], measured.by_drift[k], measured.by_unknown[k], V_before, e);
            explained += spread.drift.diagonal();
            const double n_known = 6.0 - static_cast<double>(measured.by_unknown[k].cols());
            innovation.push_back(std::sqrt(6.0 / n_known * spread.weight) * e);
            sum_squares += innovation.back().cwiseAbs2();
        }
        const double L = bandwidth<6>(run.window, innovation);
        const Square6 sum = long_run_sum<6>(run.window, innovation, L);
        const double hop = run.window.empty() ? 0.0 : 0.25 * run.window.front().length;
        of.correlation_time = hop * std::max(1.0, (sum.diagonal().array() / sum_squares.array()).maxCoeff());
        of.n_lags = L;
        return run_covariance(config, sum, run.window.size(), explained);
    }

    /// The run's rows as independent ones of unit variance.
    Eigen::MatrixXd whitened(const RunWindows& run, Equations measured, const Square6& C) const
    {
        Drift drift(config.c(), !free.empty(), is_weight_known, n + 1);
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            auto block = measured.rows.middleRows<6>(6 * static_cast<Eigen::Index>(k));
            const Drift::Spread spread =
                drift.take_out(run.window[k], measured.by_drift[k], measured.by_unknown[k], C, block);
            const Square6 L = Square6(spread.drift + spread.noise).llt().matrixL();
            block = L.triangularView<Eigen::Lower>().solve(block.eval());
        }
        return scaled(measured.rows);
    }

    /// Independent values that the long-run variances are made of: Bartlett weights count for 2/3 of their length.
    static double n_independent(const std::vector<BatchFit>& of)
    {
        double n = 0.0;
        for (const BatchFit& f : of) {
            const double L = f.n_windows > 0 ? std::max(1.0, f.n_lags) : 1.0;
            n += 6.0 * (PRIOR_WINDOWS + static_cast<double>(f.n_windows)) / (2.0 / 3.0 * (L + 1.0));
        }
        return n;
    }

    Eigen::MatrixXd scaled(Eigen::MatrixXd Ab) const
    {
        Ab.leftCols(n) = Ab.leftCols(n) * scale.asDiagonal();
        return Ab;
    }

    /// A gain that all force sensors have in common scales theta, and only known payloads tell it: elsewhere it stays 0,
    /// and its sigma is added when the body is published.
    bool has_common_gain() const { return !settings.is_payload_known && !gains().empty(); }

    /// Places of the free gains among the unknowns; none unless all are free.
    std::vector<Eigen::Index> gains() const
    {
        const int first = IPE_XI_FORCE + config.n_cables(), end = first + config.n_cables();
        std::vector<Eigen::Index> found;
        for (std::size_t i = 0; i < free.size(); ++i) {
            if (free[i] >= first && free[i] < end) {
                found.push_back(IPE_NP * n_groups + static_cast<Eigen::Index>(i));
            }
        }
        return static_cast<int>(found.size()) == config.n_cables() ? found : std::vector<Eigen::Index>{};
    }

    /// Sigma of the common gain, which no data tell. Gains that differ by more than stated come from worse sensors than
    /// stated: what these have in common is as much worse.
    double common_gain_std() const
    {
        if (!has_common_gain()) { return 0.0; }
        double square = 0.0;
        for (const Eigen::Index at : gains()) {
            const int i = free[static_cast<std::size_t>(at - IPE_NP * n_groups)];
            square += xi[i] * xi[i] / (std_xi[i] * std_xi[i]);
        }
        const double spread = std::sqrt(square / std::max(config.n_cables() - 1.0, 1.0));
        return ipe_filter_states_common_gain_std(&config.c()) * (spread > SPREAD_SURE ? spread : 1.0);
    }

    /// What is not known of the common gain, in the gains' covariance.
    void add_common_gain(Eigen::MatrixXd& covariance) const
    {
        const double std = common_gain_std();
        for (const Eigen::Index i : gains()) {
            for (const Eigen::Index j : gains()) { covariance(i, j) += std * std; }
        }
    }

    /// The gains sum to zero.
    Eigen::MatrixXd common_gain_row() const
    {
        const double std = COMMON_GAIN * config.c().std_force_gain * std::sqrt(static_cast<double>(config.n_cables()));
        Eigen::MatrixXd Ab = Eigen::MatrixXd::Zero(has_common_gain() ? 1 : 0, n + 1);
        for (const Eigen::Index i : gains()) {
            if (Ab.rows() == 0) { break; }
            Ab(0, i) = 1.0 / std;
            Ab(0, n) -= xi[free[static_cast<std::size_t>(i - IPE_NP * n_groups)]] / std;
        }
        return scaled(Ab);
    }

    /// Prior sigma of xi i for the next step: as in the last, or, as on the platform, what the data alone say where the
    /// prior makes the estimate of a delay, low-pass, place, friction or external force implausible (ipe_filter_states_widen()).
    double prior_std(int i) const
    {
        const bool is_delay = (i >= IPE_XI_POSITION_DELAY && i <= IPE_XI_ATTITUDE_DELAY) || i == IPE_XI_FORCE_LOWPASS;
        const bool is_place = i >= IPE_XI_IMU_POSITION && i < IPE_XI_ACC_SCALE;
        const bool is_friction = i >= IPE_XI_FORCE + 2 * config.n_cables();
        const bool is_external = i >= IPE_XI_EXTERNAL_FORCE && i < IPE_XI_FORCE_LOWPASS;
        const bool is_unsure = is_delay || is_place || is_friction || is_external;
        const Eigen::Index at = place(i);
        if (!is_unsure || P.size() == 0 || at < 0) { return std_xi[i]; }
        const double variance = used_std[i] * used_std[i], told = variance - P(at, at);
        const bool is_well_told = told > WELL_TOLD * variance;
        const bool is_told = is_well_told || (is_place && told > LEAST_TOLD * variance);
        const double limit = is_well_told ? IMPLAUSIBLE : IMPLAUSIBLE_FAINT;
        const bool is_implausible = is_told && xi[i] * xi[i] > limit * limit * told;
        return is_implausible ? std::abs(xi[i]) * variance / told : used_std[i];
    }

    /// Widen the priors of xi that are implausible. True: one was.
    bool widen_priors()
    {
        const Eigen::VectorXd before = used_std;
        for (const int i : free) { used_std[i] = std::max(prior_std(i), used_std[i]); }
        return used_std != before;
    }

    /// Priors of theta and xi, known mass differences, and the gains' zero sum.
    Eigen::MatrixXd prior() const
    {
        const Eigen::MatrixXd common = common_gain_row();
        const int n_known = settings.is_payload_known ? n_groups - 1 : 0;
        Eigen::MatrixXd Ab = Eigen::MatrixXd::Zero(n + n_known, n + 1);
        for (int g = 0; g < n_groups; ++g) {
            const auto at = static_cast<std::size_t>(g);
            Ab.block(IPE_NP * g, IPE_NP * g, IPE_NP, IPE_NP) = prior_rows[at];
            Ab.col(n).segment(IPE_NP * g, IPE_NP) = prior_rows[at] * (prior_mean[at] - theta[at]);
        }
        for (std::size_t i = 0; i < free.size(); ++i) {
            const Eigen::Index row = IPE_NP * n_groups + static_cast<Eigen::Index>(i);
            const double std = used_std[free[i]];
            Ab(row, row) = 1.0 / std;
            Ab(row, n) = -xi[free[i]] / std;
        }
        for (int i = 0; i < n_geometry; ++i) {
            Ab(at_geometry + i, at_geometry + i) = 1.0 / scale[at_geometry + i];
            Ab(at_geometry + i, n) = -geometry[i] / scale[at_geometry + i];
        }
        for (int g = 1; g <= n_known; ++g) {
            const auto at = static_cast<std::size_t>(g);
            Ab(n + g - 1, IPE_NP * g) = 1.0 / settings.payload_std;
            Ab(n + g - 1, 0) = -1.0 / settings.payload_std;
            Ab(n + g - 1, n) =
                (settings.payload[at] - settings.payload[0] - theta[at][0] + theta[0][0]) / settings.payload_std;
        }
        Eigen::MatrixXd all(Ab.rows() + common.rows(), n + 1);
        all << scaled(Ab), common;
        return all;
    }

    /// Mean difference between the gyro and the change of attitude: the gyro's bias, three rows; none where it is not free.
    Eigen::MatrixXd gyro_rows(const std::vector<ipe_average_t>& window) const
    {
        const auto at = std::find(free.begin(), free.end(), static_cast<int>(IPE_XI_GYRO_BIAS));
        std::vector<Eigen::Vector3d> d;
        std::vector<ipe_average_t> kept;
        for (std::size_t k = 4; k < window.size(); ++k) {
            if (!follows(window, k, 4)) { continue; }
            const Eigen::Matrix3d before = Eigen::Map<const Matrix3>(&window[k - 4].R[0][0]);
            const Eigen::Matrix3d after = Eigen::Map<const Matrix3>(&window[k].R[0][0]);
            const double dt = 1e-9 * static_cast<double>(window[k].t_ns - window[k - 4].t_ns);
            d.push_back(Eigen::Map<const Vector3>(window[k - 2].w) - rotation_vector(before.transpose() * after) / dt);
            kept.push_back(window[k]);
        }
        if (at == free.end() || d.size() < 2 * IPE_NOISE_LAGS) { return Eigen::MatrixXd(0, n + 1); }
        Eigen::Vector3d mean = Eigen::Vector3d::Zero();
        for (const Eigen::Vector3d& v : d) { mean += v / static_cast<double>(d.size()); }
        for (Eigen::Vector3d& v : d) { v -= mean; }
        const double count = static_cast<double>(d.size());
        const double variance = long_run_sum<3>(kept, d, IPE_NOISE_LAGS).trace() / 3.0 / (count * count);
        const double std = std::sqrt(std::max(variance, 0.0) + GYRO_FLOOR * GYRO_FLOOR);
        const double* q = config.c().imu_orientation;
        const Eigen::Matrix3d R_PI = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
        Eigen::MatrixXd Ab = Eigen::MatrixXd::Zero(3, n + 1);
        Ab.middleCols(IPE_NP * n_groups + (at - free.begin()), 3) = R_PI / std;
        Ab.col(n) = mean / std;
        return scaled(Ab);
    }

    /// Place of systematic parameter i among the unknowns, -1: it is not free.
    Eigen::Index place(int i) const
    {
        const auto at = std::find(free.begin(), free.end(), i);
        return at == free.end() ? -1 : IPE_NP * n_groups + static_cast<Eigen::Index>(at - free.begin());
    }

    /// The accelerometer's scale: the mean of its vertical part is gravity and the change of the vertical speed, a row for
    /// every stretch of windows without a gap. Its sigma is that of the tracked speeds, and of the attitude, which turns
    /// horizontal acceleration into the vertical.
    Eigen::MatrixXd gravity_rows(const std::vector<ipe_average_t>& window) const
    {
        const Eigen::Index scale_at = place(IPE_XI_ACC_SCALE), bias_at = place(IPE_XI_ACC_BIAS);
        Eigen::MatrixXd Ab(0, n + 1);
        if (scale_at < 0) { return Ab; }
        for (std::size_t first = 0, end = 1; first < window.size(); first = end++) {
            while (end < window.size() && follows(window, end, 1)) { ++end; }
            if (end - first < 2 * IPE_NOISE_LAGS) { continue; }
            Ab.conservativeResize(Ab.rows() + 1, Eigen::NoChange);
            Ab.bottomRows<1>() = gravity_row(window, first, end, scale_at, bias_at);
        }
        return scaled(Ab);
    }

    /// What a run's means say of its motion sensors: gyro_rows() and gravity_rows().
    Eigen::MatrixXd mean_rows(const std::vector<ipe_average_t>& window, Derived derived) const
    {
        const Eigen::MatrixXd gyro = derived.rate ? Eigen::MatrixXd(0, n + 1) : gyro_rows(window);
        const Eigen::MatrixXd gravity = derived.force ? Eigen::MatrixXd(0, n + 1) : gravity_rows(window);
        Eigen::MatrixXd Ab(gyro.rows() + gravity.rows(), n + 1);
        Ab << gyro, gravity;
        return Ab;
    }

    Eigen::RowVectorXd gravity_row(const std::vector<ipe_average_t>& window, std::size_t first, std::size_t end,
                                   Eigen::Index scale_at, Eigen::Index bias_at) const
    {
        const double* q = config.c().imu_orientation;
        const Eigen::Matrix3d R_PI = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
        const double count = static_cast<double>(end - first);
        Eigen::Vector3d up = Eigen::Vector3d::Zero();
        double vertical = 0.0, horizontal2 = 0.0;
        for (std::size_t k = first; k < end; ++k) {
            const Eigen::Matrix3d R = Eigen::Map<const Matrix3>(&window[k].R[0][0]);
            const Eigen::Vector3d force = R * Eigen::Map<const Vector3>(window[k].s);
            up += R_PI.transpose() * R.row(2).transpose() / count;
            vertical += force.z() / count;
            horizontal2 += force.head<2>().squaredNorm() / count;
        }
        const double T = 1e-9 * static_cast<double>(window[end - 1].t_ns - window[first].t_ns);
        const double rise = (window[end - 1].velocity[2] - window[first].velocity[2]) / T;
        const double std = std::hypot(SPEED_STD / T, config.c().std_attitude * std::sqrt(horizontal2));
        Eigen::RowVectorXd row = Eigen::RowVectorXd::Zero(n + 1);
        row[scale_at] = config.c().gravity / std;
        if (bias_at >= 0) { row.segment<3>(bias_at) = up.transpose() / std; }
        row[n] = (vertical - config.c().gravity - rise - config.c().gravity * xi[IPE_XI_ACC_SCALE]) / std;
        return row;
    }

    /// The equations of all runs at the present point, not weighted yet.
    struct Pass {
        std::vector<RunWindows> run;
        std::vector<Equations> measured;
        std::vector<Eigen::MatrixXd> means;  ///< mean_rows() of each run
        std::vector<BatchFit> fit;
    };

    /// Throws std::invalid_argument where the calibration leaves its ranges, std::domain_error where a cable vanishes.
    Pass pass() const
    {
        Pass p;
        const Config corrected = calibrated(config, xi);
        for (std::size_t r = 0; r < runs.size(); ++r) {
            p.run.push_back(windows_under(config, corrected, runs[r], xi));
            RunWindows& run = p.run.back();
            p.means.push_back(mean_rows(run.window, runs[r].derived));
            gate_rest(config, run);
            p.measured.push_back(equations(run, runs[r], corrected));
            p.fit.push_back(fit_of(run, r, p.measured.back()));
        }
        return p;
    }

    /// A pass of the present point under the present weights.
    Triangle weighted(const Pass& p) const
    {
        Triangle found(n);
        for (std::size_t r = 0; r < runs.size(); ++r) {
            if (!p.run[r].window.empty()) { found.add(whitened(p.run[r], p.measured[r], V[r])); }
            if (p.means[r].rows() > 0) { found.add(p.means[r]); }
        }
        found.add(prior());
        return found;
    }

    /// Logarithms of the weights' standard deviations [6 runs], those of V.
    Eigen::VectorXd log_std() const
    {
        Eigen::VectorXd found(6 * static_cast<Eigen::Index>(V.size()));
        for (std::size_t r = 0; r < V.size(); ++r) { of_run(found, r) = 0.5 * V[r].diagonal().array().log().matrix(); }
        return found;
    }

    void set_log_std(Eigen::VectorXd to)
    {
        const Square6 C = Eigen::Map<const Matrix6>(&config.c().residual_covariance[0][0]);
        for (std::size_t r = 0; r < V.size(); ++r) {
            const Column6 scale_of = (of_run(to, r).array().exp() / C.diagonal().array().sqrt()).matrix();
            V[r] = scale_of.asDiagonal() * C * scale_of.asDiagonal();
        }
    }

    /// The same [6 runs] from the residuals of a pass under the present weights; how correlated they are goes to its fit.
    /// Each unknown that the data determine has taken its share of the residuals.
    Eigen::VectorXd learnt_log_std(Pass& p) const
    {
        Eigen::VectorXd found(6 * static_cast<Eigen::Index>(V.size()));
        for (std::size_t r = 0; r < V.size(); ++r) {
            const Square6 of = learnt_covariance(p.run[r], p.measured[r], V[r], p.fit[r]);
            of_run(found, r) = 0.5 * of.diagonal().array().log().matrix();
        }
        return found.array() + 0.5 * std::log1p(n_observed / std::max(n_independent(p.fit), 1.0));
    }

    static Eigen::VectorBlock<Eigen::VectorXd, 6> of_run(Eigen::VectorXd& all, std::size_t r)
    {
        return all.segment<6>(6 * static_cast<Eigen::Index>(r));
    }

    /// What noise of a run's motion sensors does to a group's theta.
    struct Pretended {
        Covariance information = Covariance::Zero();  ///< C of eiv_correction.h: what it pretends to know
        Theta pull = Theta::Zero();                   ///< on theta, beside C's, in the normal equations
    };

    /// Noise as strong as the run's own is drawn into its rows and goes the whole way to the equations, which change by dA and
    /// db. The attitude follows a part of it, drift takes a part, and so do the other unknowns: the IMU's place, for instance,
    /// most of what noise of the angular acceleration says of the CoG. C is the sum of dA^T V^-1 dA. Were db only -dA theta,
    /// C would say all.
    Pretended pretended(const RunWindows& run, const Equations& measured, std::size_t r, const Config& corrected) const
    {
        Pretended sum;
        if (run.window.empty()) { return sum; }
        const std::size_t n_draws = std::clamp(WINDOWS_DRAWN / run.window.size(), std::size_t{1}, DRAWS_MAX);
        const std::vector<NoiseShares> share = noise_shares(run, measured, r);
        std::mt19937_64 generator(1);
        for (std::size_t i = 0; i < n_draws; ++i) {
            const std::vector<ipe_row_t> rows =
                noisy_rows(config, *runs[r].rows, runs[r].derived, run.window, share, generator);
            const BatchRun drawn{&rows, runs[r].group, runs[r].derived};
            RunWindows noisy = windows_under(config, corrected, drawn, xi);
            hold_rest_of(run, noisy);
            add_pretended(run, measured, noisy, equations(noisy, drawn, corrected), r, sum);
        }
        sum.information /= static_cast<double>(n_draws);
        sum.pull /= static_cast<double>(n_draws);
        return sum;
    }

    /// Shares of a run's noise that can be noise. What shakes the platform looks like it, and is none: the cables pull with it.
    /// Noise leaves residuals, so it is at most what leaves as much as V says (eiv_correction.h).
    std::vector<NoiseShares> noise_shares(const RunWindows& run, const Equations& measured, std::size_t r) const
    {
        const Theta& x = theta[static_cast<std::size_t>(runs[r].group)];
        Drift drift(config.c(), !free.empty(), is_weight_known, 1);
        std::vector<NoiseShares> found(run.window.size());
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            Eigen::MatrixXd e = measured.residual(k);
            const Drift::Spread spread =
                drift.take_out(run.window[k], measured.by_drift[k], measured.by_unknown[k], V[r], e);
            const Eigen::LLT<Square6> L(Square6(spread.drift + spread.noise));
            const auto dY = regressor_noise(run.window[k], runs[r].derived);
            for (std::size_t i = 0; i < NOISE_CHANNELS; ++i) {
                const double left = L.matrixL().solve(Column6(dY[i] * x)).norm();
                found[k][i] = 1.0 / std::max(1.0, left);
            }
        }
        return found;
    }

    /// Add what one draw of noise does to the normal equations of a group's theta.
    void add_pretended(const RunWindows& run, const Equations& measured, const RunWindows& noisy,
                       const Equations& drawn, std::size_t r, Pretended& sum) const
    {
        const int group = runs[r].group;
        const Eigen::MatrixXd taken = taken_by_others(group);
        Drift drift(config.c(), !free.empty(), is_weight_known, IPE_NP + 2);
        for (std::size_t k = 0, j = 0; k < run.window.size(); ++k) {
            while (j < noisy.window.size() && noisy.window[j].t_ns < run.window[k].t_ns) { ++j; }
            Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(6, IPE_NP + 2);
            if (j < noisy.window.size() && noisy.window[j].t_ns == run.window[k].t_ns) {
                const Eigen::MatrixXd change = drawn.rows.middleRows<6>(6 * static_cast<Eigen::Index>(j)) -
                                               measured.rows.middleRows<6>(6 * static_cast<Eigen::Index>(k));
                rows.leftCols<IPE_NP>() = change.middleCols<IPE_NP>(IPE_NP * group) +
                                          change.middleCols(IPE_NP * n_groups, n - IPE_NP * n_groups) * taken;
                rows.col(IPE_NP) = change.col(n);
            }
            rows.col(IPE_NP + 1) = measured.residual(k);
            const Drift::Spread spread =
                drift.take_out(run.window[k], measured.by_drift[k], measured.by_unknown[k], V[r], rows);
            Eigen::LLT<Square6>(Square6(spread.drift + spread.noise)).matrixL().solveInPlace(rows);
            const auto dA = rows.leftCols<IPE_NP>();
            const Covariance C = dA.transpose() * dA;
            sum.information += C;
            sum.pull += C * theta[static_cast<std::size_t>(group)] + dA.transpose() * rows.col(IPE_NP);
        }
    }

    /// What a change of theta of a group moves the unknowns that all groups share by [][10].
    Eigen::MatrixXd taken_by_others(int group) const
    {
        const Eigen::Index at = IPE_NP * group, first = IPE_NP * n_groups;
        const Eigen::MatrixXd with = P.block(at, first, IPE_NP, n - first);
        return P.block<IPE_NP, IPE_NP>(at, at).ldlt().solve(with).transpose();
    }

    BatchFit fit_of(const RunWindows& run, std::size_t r, const Equations& measured) const
    {
        Vector6 sum = Vector6::Zero();
        const std::size_t n_windows = run.window.size();
        for (std::size_t k = 0; k < n_windows; ++k) { sum += measured.residual(k).cwiseAbs2(); }
        const auto n_rest = static_cast<std::size_t>(std::count(run.is_rest.begin(), run.is_rest.end(), true));
        BatchFit of{};
        of.n_rows = runs[r].rows->size(), of.n_windows = n_windows, of.n_rest = n_rest;
        of.rms = (sum / std::max<double>(1.0, static_cast<double>(n_windows))).cwiseSqrt();
        of.noise_std = V[r].diagonal().cwiseSqrt();
        return of;
    }

    /// Take the covariance of a pass of the present point, triangle under the present weights, and how well it fits. Returns
    /// the weights that its residuals teach, as log_std().
    Eigen::VectorXd take(Pass& p, const Triangle& triangle)
    {
        const Eigen::MatrixXd unit = triangle.covariance();
        P = scale.asDiagonal() * unit * scale.asDiagonal();
        n_observed = static_cast<double>(n) - unit.diagonal().cwiseQuotient(prior_variance()).sum();
        const Eigen::VectorXd learnt = learnt_log_std(p);
        fit = p.fit;
        for (std::size_t r = 0; r < fit.size(); ++r) { fit[r].noise_std = V[r].diagonal().cwiseSqrt(); }
        return learnt;
    }

    /// Prior variances of the unknowns in the present step, of the scale's squares: widened ones are above 1.
    Eigen::VectorXd prior_variance() const
    {
        Eigen::VectorXd found = Eigen::VectorXd::Ones(n);
        for (std::size_t i = 0; i < free.size(); ++i) {
            const double ratio = used_std[free[i]] / std_xi[free[i]];
            found[IPE_NP * n_groups + static_cast<Eigen::Index>(i)] = ratio * ratio;
        }
        return found;
    }

    /// Cost that one step from the start leaves if the forces are late by `delay` [s], whatever is stated of it. Infinite where
    /// no calibration can have it.
    double cost_with_force_delay(double delay) const
    {
        Problem start(*this);
        start.go_to({prior_mean, Eigen::VectorXd::Zero(xi.size()), Eigen::VectorXd::Zero(n_geometry)});
        start.xi[IPE_XI_FORCE_DELAY] = delay;
        start.used_std[IPE_XI_FORCE_DELAY] = FORCE_DELAY_UNKNOWN;
        try {
            return start.weighted(start.pass()).least_cost();
        } catch (const std::invalid_argument&) {
            return HUGE_VAL;
        }
    }

    /// A delay [s] of the forces under which one step from the start leaves less than there is here. None: 0.
    double better_force_delay() const
    {
        double best = 0.0;
        if (place(IPE_XI_FORCE_DELAY) < 0) { return best; }
        double least = weighted(pass()).cost() - FORCE_DELAY_WORTH;
        for (const double delay : FORCE_DELAYS_TRIED) {
            const double cost = cost_with_force_delay(delay);
            if (cost < least) { best = delay, least = cost; }
        }
        return best;
    }

    /// Start there, its prior as wide.
    void start_with_force_delay(double delay)
    {
        xi[IPE_XI_FORCE_DELAY] = delay;
        used_std[IPE_XI_FORCE_DELAY] = std::max(used_std[IPE_XI_FORCE_DELAY], std::abs(delay));
    }

    /// Do residuals last longer than windows overlap?
    bool has_lasting_residuals() const
    {
        return std::any_of(fit.begin(), fit.end(), [&](const BatchFit& of) {
            return of.correlation_time > LASTING * config.c().window_length;
        });
    }

    /// Start where another problem has ended, as if what lasts of its residuals were wander and none of it noise: their
    /// weights are those of what changes from a window to the next that it does not overlap.
    void start_as_if_wander_lasts(const Problem& other)
    {
        go_to(other.point());
        used_std = other.used_std, V = other.V, is_weight_known = true;
        const Pass p = pass();
        Eigen::VectorXd to = log_std();
        for (std::size_t r = 0; r < runs.size(); ++r) {
            Column6 sum = Column6::Zero();
            std::size_t n_changes = 0;
            for (std::size_t k = N_OVERLAPPING; k < p.run[r].window.size(); ++k) {
                if (!follows(p.run[r].window, k, N_OVERLAPPING)) { continue; }
                sum += (p.measured[r].residual(k) - p.measured[r].residual(k - N_OVERLAPPING)).cwiseAbs2();
                ++n_changes;
            }
            if (n_changes == 0) { continue; }
            const Column6 variance = sum / (2.0 * static_cast<double>(n_changes));
            of_run(to, r) = of_run(to, r).cwiseMin(0.5 * variance.array().max(1e-300).log().matrix());
        }
        set_log_std(to);
    }

    /// Logarithm of the product of the standard deviations of all channels of all runs.
    double log_noise() const { return log_std().sum(); }

    /// Cost at another problem's point, under the weights and priors here.
    double cost_at(const Problem& other) const
    {
        Problem there(*this);
        there.go_to(other.point());
        there.used_std[IPE_XI_FORCE_DELAY] = other.used_std[IPE_XI_FORCE_DELAY];
        return there.weighted(there.pass()).cost();
    }

    /// A low-pass of the forces seen from where a problem without one has ended, whose columns this problem has and one more.
    struct LowPass {
        bool is_told;
        Eigen::VectorXd effect;  ///< on the other unknowns, of one sigma of it
    };

    /// Measured tensions in its column make the low-pass too low. Tensions that the motion asks for make it too high. Both have
    /// noise in common with the residual. The low-pass is told where both give the same sign, LOW_PASS_TOLD sigmas from none.
    LowPass low_pass(const Problem& without)
    {
        theta = without.theta, xi = without.xi, geometry = without.geometry;
        V = without.V, is_weight_known = without.is_weight_known;
        const Eigen::Index at = place(IPE_XI_FORCE_LOWPASS);
        LowPass found;
        const auto sigmas = [&](BentBy by) {
            bent_by = by;
            const Triangle here = weighted(pass());
            const Eigen::MatrixXd covariance = here.covariance();
            const double std = std::sqrt(covariance(at, at));
            found.effect = scale.cwiseProduct(covariance.col(at)) / std;
            return here.solve(0.0)[at] / std;
        };
        const double by_tensions = sigmas(BentBy::TENSIONS), by_motion = sigmas(BentBy::MOTION);
        found.is_told =
            by_tensions * by_motion > 0.0 && std::min(std::abs(by_tensions), std::abs(by_motion)) > LOW_PASS_TOLD;
        const Eigen::VectorXd behind = found.effect.tail(n - at - 1);
        found.effect.conservativeResize(n - 1);
        found.effect.tail(n - at - 1) = behind;
        return found;
    }

    /// Where the unknowns are.
    struct Point {
        std::vector<Theta> theta;
        Eigen::VectorXd xi, geometry;
    };
    Point point() const { return {theta, xi, geometry}; }
    void go_to(const Point& p) { theta = p.theta, xi = p.xi, geometry = p.geometry; }

    /// What each stretch of the runs contributes at the present point, under the present weights; and spurious.
    void blocks(std::vector<BatchBlock>& block, Eigen::MatrixXd& H_prior)
    {
        const Pass p = pass();
        const Eigen::MatrixXd Ab = prior();
        H_prior = Ab.leftCols(n).transpose() * Ab.leftCols(n);
        spurious.clear();
        for (std::size_t r = 0; r < runs.size(); ++r) {
            const auto means = p.means[r].leftCols(n);
            H_prior += means.transpose() * means;
            if (!p.run[r].window.empty()) { cut(p.run[r], r, whitened(p.run[r], p.measured[r], V[r]), block); }
            spurious.push_back(free.empty() ? Pretended{}
                                            : pretended(p.run[r], p.measured[r], r, calibrated(config, xi)));
        }
    }

    /// A run's whitened rows as blocks of equal length.
    void cut(const RunWindows& run, std::size_t r, const Eigen::MatrixXd& rows, std::vector<BatchBlock>& block) const
    {
        const int64_t first = run.window.front().t_ns, start = runs[r].rows->front().t_ns;
        const double duration = 1e-9 * static_cast<double>(run.window.back().t_ns - first);
        const double length = std::max(BLOCK_LENGTH, duration / (BLOCKS_MAX - 1));
        int64_t now = -1;
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            const double t = 1e-9 * static_cast<double>(run.window[k].t_ns - start);
            const auto at = static_cast<int64_t>(1e-9 * static_cast<double>(run.window[k].t_ns - first) / length);
            if (at != now) {
                block.push_back({static_cast<int>(r), t, t, 0, Eigen::MatrixXd::Zero(n, n), Eigen::VectorXd::Zero(n)});
                now = at;
            }
            BatchBlock& b = block.back();
            const auto A = rows.middleRows<6>(6 * static_cast<Eigen::Index>(k));
            b.H.noalias() += A.leftCols(n).transpose() * A.leftCols(n);
            b.g.noalias() += A.leftCols(n).transpose() * A.col(n);
            b.end = t, ++b.n_windows;
        }
    }

    void move(const Eigen::VectorXd& dz)
    {
        for (int g = 0; g < n_groups; ++g) { theta[static_cast<std::size_t>(g)] += dz.segment<IPE_NP>(IPE_NP * g); }
        for (std::size_t i = 0; i < free.size(); ++i) {
            xi[free[i]] += dz[IPE_NP * n_groups + static_cast<Eigen::Index>(i)];
        }
        geometry += dz.tail(n_geometry);
    }

    enum class BentBy { BOTH, TENSIONS, MOTION };
    BentBy bent_by = BentBy::BOTH;  ///< tensions that the low-pass's column is made of: between, measured, asked for
    const Config& config;
    const std::vector<BatchRun>& runs;
    const BatchSettings& settings;
    int n_groups, at_geometry = 0, n_geometry = 0, n = 0;
    std::vector<int> free;
    Eigen::VectorXd std_xi, used_std, scale, xi, geometry;
    std::vector<Theta> prior_mean, theta;
    std::vector<Eigen::MatrixXd> prior_rows;
    std::vector<ipe_body_t> prior_std_body;
    std::vector<Square6> V;
    std::vector<Pretended> spurious;  ///< what noise of each run's motion sensors does to theta
    bool is_weight_known = false;     ///< V is learnt: windows that stand out count for less
    double n_observed =
        0.0;  ///< unknowns that the data determine, and so fit to their noise; a prior that stays counts for none
    std::vector<BatchFit> fit;
    Eigen::MatrixXd P;
};

}  // namespace inertiad::detail
