// SPDX-License-Identifier: Apache-2.0
/// Batch identification: theta of one or more bodies and, if wanted, the systematic parameters xi of the sensors they share.
///
///   y(xi) - Y(xi) theta_g = e,   e ~ N(0, V_run);   theta_g ~ N(theta_0, P_0),  xi ~ N(0, diag(std^2))
/// Damped Gauss-Newton: each step runs rows -> wrench -> window again under the corrected calibration, so the residual is
/// exact, and takes [Y, -X] of systematic.h as its derivative. X is taken at the tensions nearest to the measured ones that
/// leave no residual: with the measured ones a common gain gets its column from the noise which it then makes smaller, and
/// the body with it (errors in variables; the mass 0.14 % low on the paper's motion with modern sensors). What of the motion
/// was derived instead of measured is smoothed for Y and X (derived.hpp).
/// Steps are solved by QR of the whitened, prior-scaled rows (least_squares.hpp). The first one moves theta alone. A step is
/// taken if the cost falls, or if the next step, in the present metric, is shorter (the natural level function of Deuflhard,
/// Newton Methods for Nonlinear Problems, 3.3: an instrument-like derivative has no cost whose minimum it leads to); else it
/// is damped more. V_run, the residuals' long-run covariance (long_run.hpp), starts from the residuals of theta alone, which
/// are the widest, and is renewed until it stays. Converged: weights at rest, the next undamped step below 0.001 posterior
/// sigmas of every unknown.
/// As soon as xi is estimated two more errors are modelled: where the attachments really are, known to std_geometry, is
/// unknown too, else a millimetre of it would pass for newtons of offset; and the attitude wanders about its bias, see
/// filter_states.h: a Kalman filter of that alone takes it out of the rows, which then are as independent as their noise. Known
/// differences of mass between groups are rows of their own, and so is what a gyro's mean says of its bias beside the
/// attitude. Heap: as much as the data need. No state, any thread.
#pragma once

#include "body.hpp"
#include "calibrated.hpp"
#include "derived.hpp"
#include "least_squares.hpp"
#include "long_run.hpp"
#include "windows.hpp"

extern "C" {
#include "eiv_correction.h"
#include "pose_dwell.h"
}

#include <Eigen/Cholesky>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>
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
    int n_steps_max = 40;
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
    double correlation_time;  ///< s: long-run variance over variance, in windows' steps; of the worst channel
    double n_lags;            ///< bandwidth of the long-run variance, windows
};

/// What a stretch of a run contributes to the equations at the solution, scaled by prior sigmas.
struct BatchBlock {
    int run;
    double begin, end;      ///< s since the run's first row: middle of the first and the last window
    std::size_t n_windows;
    Eigen::MatrixXd H;      ///< A^T A [n][n]
    Eigen::VectorXd g;      ///< A^T b [n]
};

struct BatchResult {
    std::vector<BatchBody> body;  ///< by group
    std::vector<BatchFit> fit;    ///< by run
    Eigen::VectorXd xi;           ///< corrections to the configured calibration
    Eigen::VectorXd xi_std;       ///< published
    Eigen::MatrixXd P;            ///< published covariance of all theta (about the IMU), the free xi, the attachments
    Eigen::VectorXd prior_std;    ///< of the same unknowns
    std::vector<int> free;        ///< indices of the free xi
    std::vector<BatchBlock> block;  ///< all windows, in order
    Eigen::MatrixXd H_prior;      ///< of priors, known mass differences and gyro means; scaled as the blocks
    int n_steps;
    double last_step;             ///< largest change of the next step in posterior sigmas
    bool is_converged;
    std::string refused;          ///< why the last trial step was refused by the configuration's ranges; empty: it was not
};

namespace detail {

constexpr double PRIOR_WINDOWS = 3.0;
constexpr double LEAST_NOISE = 0.1;  // of the innovations' variance, whatever of it wander explains
constexpr double CONVERGED = 1e-3;   // sigmas
constexpr double SMALLEST_STD = 1e-12;
constexpr double GYRO_FLOOR = 1e-6;  // rad/s
constexpr double WEIGHT_SETTLED = 0.02;  // relative change of V_run's standard deviations
constexpr int WEIGHT_STEPS_MAX = 8;
constexpr double DAMPING_FIRST = 1e-3, DAMPING_LEAST = 1e-7, DAMPING_MAX = 1e8;
constexpr double BLOCK_LENGTH = 1.0;  // s, at least
constexpr int BLOCKS_MAX = 48;        // of a run

using Square6 = Eigen::Matrix<double, 6, 6>;
using Column6 = Eigen::Matrix<double, 6, 1>;

/// The windows of one run under one calibration.
struct Linearised {
    std::vector<ipe_average_t> window;
    std::vector<bool> is_rest;
};

/// Equations of a run's windows: rows [A, b], six each, and d(b)/d(wander) of each window.
struct Equations {
    Eigen::MatrixXd rows;
    std::vector<Eigen::Matrix<double, 6, 3>> turn;

    Column6 residual(std::size_t k) const
    {
        return rows.col(rows.cols() - 1).segment<6>(6 * static_cast<Eigen::Index>(k));
    }
};

/// At rest, as the platform has it (pose_dwell.h), rate and acceleration are sensor noise: taken as they are they would wear
/// the inertia down. Only where rest prevails: few such windows do no harm, and a slow start taken for rest would.
inline void gate_rest(const Config& config, Linearised& run)
{
    ipe_pose_dwell_t still;
    ipe_pose_dwell_restart(&still);
    run.is_rest.clear();
    for (const ipe_average_t& a : run.window) {
        run.is_rest.push_back(ipe_pose_dwell_push(&still, &config.c(), &a) > 0);
    }
    const auto n_rest = static_cast<std::size_t>(std::count(run.is_rest.begin(), run.is_rest.end(), true));
    for (std::size_t k = 0; k < run.window.size() && 2 * n_rest > run.window.size(); ++k) {
        if (!run.is_rest[k]) { continue; }
        std::fill_n(run.window[k].w, 3, 0.0);
        std::fill_n(run.window[k].ww, 6, 0.0);
        std::fill_n(run.window[k].alpha, 3, 0.0);
    }
}

inline Linearised linearise(const Config& config, const Config& corrected, const BatchRun& run,
                            const Eigen::VectorXd& xi)
{
    return {windows_of(corrected, corrected_rows(config, corrected, xi, *run.rows, run.derived)), {}};
}

/// V_run from the innovations' long-run sum, the part of their variance that wander explains [6], as a sum, and, counting
/// for 3 windows, the configured covariance.
inline Square6 run_covariance(const Config& config, const Square6& sum, std::size_t n_windows, const Column6& explained)
{
    const Square6 C = Eigen::Map<const Matrix6>(&config.c().residual_covariance[0][0]);
    Square6 V = C;
    for (int i = 0; i < 6; ++i) {
        const double left = std::max({sum(i, i) - explained[i], LEAST_NOISE * sum(i, i), 0.0});
        const double learnt = (PRIOR_WINDOWS * C(i, i) + left) / (PRIOR_WINDOWS + static_cast<double>(n_windows));
        const double scale = std::sqrt(std::max(learnt / C(i, i), 1e-4));
        V.row(i) *= scale;
        V.col(i) *= scale;
    }
    return V;
}

/// W [6][m] at a window's pose: wrench = W f + weight. Throws where a cable has no direction.
inline Eigen::MatrixXd wrench_matrix(const ipe_config_t& c, const ipe_average_t& a)
{
    double W[IPE_NY][IPE_CABLES_MAX], sag[IPE_NY];
    if (ipe_wrench_matrix(&c, a.p, a.R, c.imu_position, W, sag) != IPE_OK) {
        throw std::domain_error("a cable has no direction near a window's pose");
    }
    return Eigen::Map<const Eigen::Matrix<double, 6, IPE_CABLES_MAX, Eigen::RowMajor>>(&W[0][0]).leftCols(c.n_cables);
}

/// d(wrench)/d(attachment) [6][3 m] of a window: a force that acts elsewhere.
inline Eigen::MatrixXd geometry_columns(const Eigen::MatrixXd& W, const ipe_average_t& a)
{
    Eigen::MatrixXd G = Eigen::MatrixXd::Zero(6, 3 * W.cols());
    for (Eigen::Index i = 0; i < W.cols(); ++i) {
        const Vector3 force = a.f[i] * W.col(i).head<3>();
        for (int k = 0; k < 3; ++k) { G.block<3, 1>(3, 3 * i + k) = Vector3::Unit(k).cross(force); }
    }
    return G;
}

/// The tensions nearest to a window's that pull as its residual [6] says they should.
inline SmoothWindow reproducing(const Eigen::MatrixXd& W, const Column6& residual, SmoothWindow a)
{
    Eigen::Map<Eigen::VectorXd>(a.average.f, W.cols()) -= W.completeOrthogonalDecomposition().solve(residual);
    return a;
}

/// The attitude's wander, taken out of equations window by window: a Kalman filter whose measurements are all columns of the
/// equations at once, since what it would estimate is linear in them.
class Wander {
public:
    Wander(double std, Eigen::Index n_columns) : std_(std), estimate_(Eigen::MatrixXd::Zero(3, n_columns)) {}

    /// Equations [6][n_columns] at t_ns, of which wander makes turn [6][3] times itself, become innovations; returns the
    /// covariance of wander's part in them. V: of the rest.
    Square6 take_out(int64_t t_ns, const Eigen::Matrix<double, 6, 3>& turn, const Square6& V,
                     Eigen::Ref<Eigen::MatrixXd> rows)
    {
        const double elapsed = t_ns_ == 0 ? HUGE_VAL : 1e-9 * static_cast<double>(t_ns - t_ns_) / IPE_WANDER_TIME;
        const double fade = std::exp(-elapsed);
        t_ns_ = t_ns;
        estimate_ *= fade;
        P_ = fade * fade * P_ + std_ * std_ * (1.0 - fade * fade) * Eigen::Matrix3d::Identity();
        const Square6 part = turn * P_ * turn.transpose();
        const Eigen::Matrix<double, 3, 6> gain = Square6(part + V).llt().solve(turn * P_).transpose();
        rows -= turn * estimate_;
        estimate_ += gain * rows;
        P_ -= (gain * turn * P_).eval();
        return part;
    }

private:
    double std_;
    int64_t t_ns_ = 0;
    Eigen::Matrix3d P_ = Eigen::Matrix3d::Zero();
    Eigen::MatrixXd estimate_;
};

/// The unknowns: theta of every group about the IMU, the free xi, the attachments' errors; scaled by their prior sigmas in
/// the equations.
struct Problem {
    Problem(const Config& config_, const std::vector<BatchRun>& runs_, const BatchSettings& settings_)
        : config(config_), runs(runs_), settings(settings_), n_groups(static_cast<int>(settings.payload.size()))
    {
        const int n_xi = ipe_systematic_count(config.n_cables());
        std_xi.resize(IPE_XI_MAX);
        ipe_systematic_std(&config.c(), std_xi.data());
        std_xi.conservativeResize(n_xi);
        std_xi = std_xi.cwiseMax(SMALLEST_STD);
        for (int i = 0; i < n_xi; ++i) {
            if (settings.is_free.empty() || settings.is_free[static_cast<std::size_t>(i)]) { free.push_back(i); }
        }
        at_geometry = IPE_NP * n_groups + static_cast<int>(free.size());
        n_geometry = free.empty() || config.c().std_geometry <= 0.0 ? 0 : 3 * config.n_cables();
        n = at_geometry + n_geometry;
        geometry = Eigen::VectorXd::Zero(n_geometry);
        set_prior();
        scale.tail(n_geometry).setConstant(config.c().std_geometry);
        xi = Eigen::VectorXd::Zero(n_xi);
        attenuation.resize(runs.size());
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

    /// Rows [A, b] of a run as measured, and what wander does to each window's.
    Equations equations(const Linearised& run, const BatchRun& of, const Config& corrected) const
    {
        Equations found;
        const Theta& x = theta[static_cast<std::size_t>(of.group)];
        found.rows = Eigen::MatrixXd::Zero(6 * static_cast<Eigen::Index>(run.window.size()), n + 1);
        const std::vector<SmoothWindow> smooth = smoothed(of.derived, run.window);
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            const ipe_average_t& a = run.window[k];
            auto block = found.rows.middleRows<6>(6 * static_cast<Eigen::Index>(k));
            Column6 y = Eigen::Map<const Vector6>(a.y);
            found.turn.push_back(Eigen::Matrix<double, 6, 3>::Zero());
            if (free.empty()) {
                block.middleCols<IPE_NP>(IPE_NP * of.group) = regressor(a);
                block.col(n) = y - regressor(a) * x;
                continue;
            }
            const Eigen::MatrixXd W = wrench_matrix(corrected.c(), a);
            if (n_geometry > 0) { y += geometry_columns(W, a) * geometry; }
            block.col(n) = y - regressor(a) * x;
            const Regressor Y = regressor(smooth[k].average);
            block.middleCols<IPE_NP>(IPE_NP * of.group) = Y;
            const SmoothWindow at = reproducing(W, y - Y * x, smooth[k]);
            const SystematicColumns X = systematic_columns(corrected, of.derived, at, x);
            found.turn.back() = -X.middleCols<3>(IPE_XI_ATTITUDE);
            if (n_geometry > 0) { block.middleCols(at_geometry, n_geometry) = -geometry_columns(W, at.average); }
            for (std::size_t i = 0; i < free.size(); ++i) {
                block.col(IPE_NP * n_groups + static_cast<Eigen::Index>(i)) = -X.col(free[i]);
            }
        }
        return found;
    }

    /// V of a run from its residuals, wander taken out of them by what V was so far; how correlated they are goes to of.
    Square6 learnt_covariance(const Linearised& run, const Equations& measured, const Square6& V_before,
                              BatchFit& of) const
    {
        Wander wander(wander_std(), 1);
        std::vector<Column6> innovation;
        Column6 explained = Column6::Zero(), sum_squares = Column6::Constant(1e-300);
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            Eigen::MatrixXd e = measured.residual(k);
            explained += wander.take_out(run.window[k].t_ns, measured.turn[k], V_before, e).diagonal();
            innovation.push_back(e);
            sum_squares += e.cwiseAbs2();
        }
        const std::size_t L = bandwidth<6>(run.window, innovation);
        const Square6 sum = long_run_sum<6>(run.window, innovation, L);
        const double hop = run.window.empty() ? 0.0 : 0.25 * run.window.front().length;
        of.correlation_time = hop * std::max(1.0, (sum.diagonal().array() / sum_squares.array()).maxCoeff());
        of.n_lags = static_cast<double>(L);
        return run_covariance(config, sum, run.window.size(), explained);
    }

    /// The run's rows as independent ones of unit variance.
    Eigen::MatrixXd whitened(const Linearised& run, Equations measured, const Square6& C) const
    {
        Wander wander(wander_std(), n + 1);
        for (std::size_t k = 0; k < run.window.size(); ++k) {
            auto block = measured.rows.middleRows<6>(6 * static_cast<Eigen::Index>(k));
            const Square6 part = wander.take_out(run.window[k].t_ns, measured.turn[k], C, block);
            const Square6 L = Square6(part + C).llt().matrixL();
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

    double wander_std() const { return free.empty() ? 0.0 : config.c().std_attitude_wander; }

    Eigen::MatrixXd scaled(Eigen::MatrixXd Ab) const
    {
        Ab.leftCols(n) = Ab.leftCols(n) * scale.asDiagonal();
        return Ab;
    }

    /// Priors of theta and xi, and known mass differences.
    Eigen::MatrixXd prior() const
    {
        const int n_known = settings.is_payload_known ? n_groups - 1 : 0;
        Eigen::MatrixXd Ab = Eigen::MatrixXd::Zero(n + n_known, n + 1);
        for (int g = 0; g < n_groups; ++g) {
            const auto at = static_cast<std::size_t>(g);
            Ab.block(IPE_NP * g, IPE_NP * g, IPE_NP, IPE_NP) = prior_rows[at];
            Ab.col(n).segment(IPE_NP * g, IPE_NP) = prior_rows[at] * (prior_mean[at] - theta[at]);
        }
        for (std::size_t i = 0; i < free.size(); ++i) {
            const Eigen::Index row = IPE_NP * n_groups + static_cast<Eigen::Index>(i);
            Ab(row, row) = 1.0 / std_xi[free[i]];
            Ab(row, n) = -xi[free[i]] / std_xi[free[i]];
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
        return scaled(Ab);
    }

    /// Mean difference between the gyro and the change of attitude: the gyro's bias, three rows; none where it is not free.
    Eigen::MatrixXd gyro_rows(const std::vector<ipe_average_t>& window) const
    {
        const int first = IPE_XI_FORCE + 2 * config.n_cables();
        const auto at = std::find(free.begin(), free.end(), first);
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

    /// The equations of all runs at the present point.
    struct Pass {
        explicit Pass(Eigen::Index n) : weighted(n), renewed(n) {}
        Triangle weighted;               ///< under the weights as they are
        Triangle renewed;                ///< under V, learnt from the residuals at this point
        std::vector<Square6> V;
        std::vector<BatchFit> fit;
        std::vector<ipe_eiv_correction_t> attenuation;
        double weight_change = 0.0;      ///< largest relative change of a standard deviation, weights to V
    };

    /// Throws std::invalid_argument where the calibration leaves its ranges, std::domain_error where a cable vanishes.
    Pass pass() const
    {
        Pass p(n);
        const Config corrected = calibrated(config, xi);
        for (std::size_t r = 0; r < runs.size(); ++r) {
            Linearised run = linearise(config, corrected, runs[r], xi);
            const Eigen::MatrixXd gyro = gyro_rows(run.window);
            gate_rest(config, run);
            const Equations measured = equations(run, runs[r], corrected);
            BatchFit of = fit_of(run, r, measured);
            const double loss = n_told / std::max(n_independent(fit), 1.0);
            p.V.push_back((1.0 + loss) * learnt_covariance(run, measured, V[r], of));
            const Column6 ratio = p.V[r].diagonal().cwiseQuotient(V[r].diagonal()).cwiseSqrt();
            p.weight_change = std::max(p.weight_change, (ratio.array() - 1.0).abs().maxCoeff());
            if (!run.window.empty()) {
                p.weighted.add(whitened(run, measured, V[r]));
                p.renewed.add(whitened(run, measured, p.V[r]));
            }
            if (gyro.rows() > 0) { p.weighted.add(gyro), p.renewed.add(gyro); }
            p.attenuation.push_back(attenuation_of(run, runs[r].derived));
            p.fit.push_back(of);
        }
        p.weighted.add(prior());
        p.renewed.add(prior());
        return p;
    }

    static ipe_eiv_correction_t attenuation_of(const Linearised& run, const Derived& derived)
    {
        ipe_eiv_correction_t sum = {};
        for (const ipe_average_t& a : run.window) { ipe_eiv_correction_add(&sum, &a, 1.0); }
        if (derived.force) { std::fill_n(sum.sum, 3, 0.0F); }  // smoothed in Y instead
        if (derived.rate) { std::fill_n(sum.sum + 3, 3, 0.0F); }
        return sum;
    }

    BatchFit fit_of(const Linearised& run, std::size_t r, const Equations& measured) const
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

    /// The point of the pass is the present one: take its weights, if wanted, and its covariance.
    void take(const Pass& p, bool is_weight_renewed)
    {
        if (is_weight_renewed) { V = p.V; }
        fit = p.fit;
        for (std::size_t r = 0; r < fit.size(); ++r) { fit[r].noise_std = V[r].diagonal().cwiseSqrt(); }
        attenuation = p.attenuation;
        const Triangle& triangle = is_weight_renewed ? p.renewed : p.weighted;
        const Eigen::MatrixXd unit = triangle.covariance();
        P = scale.asDiagonal() * unit * scale.asDiagonal();
        n_told = static_cast<double>(n) - unit.trace();
    }

    /// Where the unknowns are.
    struct Point {
        std::vector<Theta> theta;
        Eigen::VectorXd xi, geometry;
    };
    Point point() const { return {theta, xi, geometry}; }
    void go_to(const Point& p) { theta = p.theta, xi = p.xi, geometry = p.geometry; }

    /// What each stretch of the runs contributes at the present point, under the present weights.
    void blocks(std::vector<BatchBlock>& block, Eigen::MatrixXd& H_prior) const
    {
        const Config corrected = calibrated(config, xi);
        const Eigen::MatrixXd Ab = prior();
        H_prior = Ab.leftCols(n).transpose() * Ab.leftCols(n);
        for (std::size_t r = 0; r < runs.size(); ++r) {
            Linearised run = linearise(config, corrected, runs[r], xi);
            const Eigen::MatrixXd gyro = gyro_rows(run.window);
            H_prior += gyro.leftCols(n).transpose() * gyro.leftCols(n);
            gate_rest(config, run);
            if (!run.window.empty()) { cut(run, r, whitened(run, equations(run, runs[r], corrected), V[r]), block); }
        }
    }

    /// A run's whitened rows as blocks of equal length.
    void cut(const Linearised& run, std::size_t r, const Eigen::MatrixXd& rows, std::vector<BatchBlock>& block) const
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

    const Config& config;
    const std::vector<BatchRun>& runs;
    const BatchSettings& settings;
    int n_groups, at_geometry = 0, n_geometry = 0, n = 0;
    std::vector<int> free;
    Eigen::VectorXd std_xi, scale, xi, geometry;
    std::vector<Theta> prior_mean, theta;
    std::vector<Eigen::MatrixXd> prior_rows;
    std::vector<ipe_body_t> prior_std_body;
    std::vector<Square6> V;
    std::vector<ipe_eiv_correction_t> attenuation;  ///< of the runs' regressors
    double n_told = 0.0;  ///< unknowns that the data determine, and so fit to their noise; a prior that stays counts for none
    std::vector<BatchFit> fit;
    Eigen::MatrixXd P;
};

/// Take what noise in the regressors of a group's runs pretended to know out of theta and P, about the IMU (eiv_correction.h);
/// the plain fit stays the plain fit.
inline void undo_attenuation(const Problem& problem, int group, Theta& theta, Covariance& P)
{
    const Theta& mean = problem.prior_mean[static_cast<std::size_t>(group)];
    const Covariance F = problem.prior_rows[static_cast<std::size_t>(group)].inverse();
    Covariance prior = F * F.transpose(), C = Covariance::Zero();
    for (std::size_t r = 0; r < problem.runs.size(); ++r) {
        if (problem.runs[r].group != group) { continue; }
        Matrix6 L = problem.V[r].llt().matrixL();
        ipe_eiv_correction_information(&problem.attenuation[r], as_array(L), 1.0, as_array(C));
    }
    ipe_eiv_correction_undo(as_array(C), mean.data(), as_array(prior), theta.data(), as_array(P));
}

/// What is published about one group's body, by the rules of pipeline.c.
inline BatchBody publish(const Problem& problem, int group)
{
    const ipe_config_t& c = problem.config.c();
    BatchBody b{};
    b.theta = problem.theta[static_cast<std::size_t>(group)];
    b.P = problem.P.block<IPE_NP, IPE_NP>(IPE_NP * group, IPE_NP * group);
    if (!problem.free.empty()) { undo_attenuation(problem, group, b.theta, b.P); }
    ipe_body_shift(c.imu_position, b.theta.data(), as_array(b.P));
    b.is_consistent = ipe_consistency_check(b.theta.data());
    if (!ipe_consistency_project(b.theta.data(), as_array(b.P), b.theta_possible.data(), &b.distance)) {
        throw std::domain_error("no body that can exist is near the estimate");
    }
    const double geometry = problem.n_geometry > 0 ? 0.0 : b.theta_possible[0] * c.std_geometry;
    for (int i = 1; i < 4; ++i) { b.P(i, i) += geometry * geometry / c.n_cables; }
    if (ipe_body_from_theta(b.theta_possible.data(), as_array(b.P), &b.body) != IPE_OK) {
        throw std::domain_error("mass is not positive");
    }
    const ipe_body_t& prior = problem.prior_std_body[static_cast<std::size_t>(group)];
    b.observable[0] = 2.0 * b.body.mass_std <= prior.mass_std;
    for (int i = 0; i < 3; ++i) { b.observable[1 + i] = 2.0 * b.body.cog_std[i] <= prior.cog_std[i]; }
    for (int i = 0; i < 6; ++i) { b.observable[4 + i] = 2.0 * b.body.inertia_cog_std[i] <= prior.inertia_cog_std[i]; }
    return b;
}

}  // namespace detail

namespace detail {

/// The way to the solution, see the top of this file.
class Descent {
public:
    Descent(Problem& problem, const BatchSettings& settings) : problem_(problem), settings_(settings) {}

    void run(BatchResult& result)
    {
        first_step();
        for (n_steps_ = 1; n_steps_ < settings_.n_steps_max && !has_converged(); ++n_steps_) {
            if (!step()) { break; }
        }
        result.n_steps = n_steps_;
        result.last_step = last_step_;
        result.is_converged = has_converged();
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

    void arrive(Problem::Pass pass)
    {
        const bool is_renewed = settings_.is_weight_learnt && !is_settled_;
        is_settled_ = !is_renewed || pass.weight_change < WEIGHT_SETTLED || ++n_renewed_ == WEIGHT_STEPS_MAX;
        problem_.take(pass, is_renewed);
        triangle_ = is_renewed ? pass.renewed : pass.weighted;
        const Eigen::VectorXd u = triangle_.solve(0.0);
        last_step_ = (problem_.scale.cwiseProduct(u).array().abs() / problem_.P.diagonal().array().sqrt()).maxCoeff();
        if (!std::isfinite(last_step_)) { throw std::domain_error("the equations have no finite solution"); }
    }

    bool has_converged() const { return is_settled_ && last_step_ < CONVERGED; }

    Problem& problem_;
    const BatchSettings& settings_;
    Triangle triangle_{0};
    double damping_ = 0.0, last_step_ = HUGE_VAL;
    int n_steps_ = 0, n_renewed_ = 0;
    bool is_settled_ = false;
    std::string refused_;
};

}  // namespace detail

/// Solve. result.is_converged says whether it is a solution. Throws std::domain_error with the reason where there is nothing
/// to solve or no body comes out.
inline BatchResult solve(const Config& config, const std::vector<BatchRun>& runs, const BatchSettings& settings)
{
    detail::Problem problem(config, runs, settings);
    BatchResult result{};
    detail::Descent(problem, settings).run(result);
    std::size_t n_windows = 0;
    for (const BatchFit& f : problem.fit) { n_windows += f.n_windows; }
    if (n_windows == 0) { throw std::domain_error("no whole window in the data"); }
    for (int g = 0; g < problem.n_groups; ++g) { result.body.push_back(detail::publish(problem, g)); }
    problem.blocks(result.block, result.H_prior);
    result.fit = problem.fit;
    result.free = problem.free;
    result.prior_std = problem.scale;
    result.P = problem.P;
    result.xi = problem.xi;
    result.xi_std = problem.std_xi;
    for (std::size_t i = 0; i < problem.free.size(); ++i) {
        const Eigen::Index at = IPE_NP * problem.n_groups + static_cast<Eigen::Index>(i);
        result.xi_std[problem.free[i]] = std::sqrt(result.P(at, at));
    }
    return result;
}

}  // namespace inertiad
