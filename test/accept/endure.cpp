// SPDX-License-Identifier: Apache-2.0
/// The core over longer times and worse data than anyone would wait for, window by window:
///
///   endure rest|noise|bad ROBOT.cfg ROWS RATE WINDOWS SEED  acc gyro force position wander wander_time
///
///   rest   moves twice through ROWS, rests for WINDOWS in their first pose, moves again
///   noise  moves through ROWS again and again for WINDOWS; counts alarms, all of them false, and bytes of state
///   bad    short runs with up to 300 times the noise, until WINDOWS estimates were published; now and then a row or a
///          frame with NaN, Inf or a full-scale value, which must leave the filter as it is
/// ROWS holds rows without noise at RATE [Hz], native doubles: acc 3, gyro 3, q 4 (w x y z), position 3, f m; its motion
/// begins and ends in one pose, at rest. Noise: one sigma per sample, SI; wander: attitude, rad, correlated over s.
/// Prints "name value" lines.
#include <inertiad/body.hpp>
#include <inertiad/pipeline.hpp>
#include <inertiad/rls.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

namespace {

using inertiad::Config;

constexpr int64_t SECOND = 1000000000;
constexpr double DAY = 86400.0;
constexpr uint64_t CHECK_INTERVAL = 100000;  // windows between two looks at the whole covariance
constexpr uint64_t RUN_WINDOWS = 100;  // of one bad run: most estimates are young ones, where bodies are impossible
constexpr std::size_t RUN_ROWS = 3000;  // at most: under the loudest noise the attitude never settles
constexpr double WORST_NOISE = 300.0;
constexpr unsigned BAD_INTERVAL = 8;   // rows from one bad input to the next

struct Noise {
    double acc, gyro, force, position, wander, wander_time;
};

/// A pipeline that is fed with noisy rows, as the sensors would.
class Feed {
public:
    Feed(const Config& config, std::vector<double> rows, double rate, const Noise& noise, uint64_t seed)
        : config_(config), rows_(std::move(rows)), width_(13 + static_cast<std::size_t>(config.n_cables())),
          rate_(rate), noise_(noise), dice_(seed)
    {
        if (rows_.empty() || rows_.size() % width_ != 0) { throw std::invalid_argument("ROWS: not whole rows"); }
        start();
    }

    std::size_t n() const { return rows_.size() / width_; }
    void start()
    {
        view.init(config_);
        turn_ = noise_.wander * normal3();
        k_ = 0;
    }

    /// One row of the motion, then all steps it allows. True if a new estimate came of it.
    bool push(std::size_t at, double louder = 1.0)
    {
        double row[13 + IPE_CABLES_MAX];
        std::copy_n(&rows_[at % n() * width_], width_, row);
        for (std::size_t i = 0; i < 3; ++i) { row[i] += louder * noise_.acc * normal_(dice_); }
        for (std::size_t i = 3; i < 6; ++i) { row[i] += louder * noise_.gyro * normal_(dice_); }
        wander(row + 6, louder);
        for (std::size_t i = 10; i < 13; ++i) { row[i] += louder * noise_.position * normal_(dice_); }
        for (std::size_t i = 13; i < width_; ++i) { row[i] += louder * noise_.force * normal_(dice_); }
        const int64_t t_ns = now();
        (void)ipe_align_push(&state.align, IPE_IMU, t_ns, row);
        (void)ipe_align_push(&state.align, IPE_FORCE, t_ns, row + 13);
        (void)ipe_align_push(&state.align, IPE_POSITION, t_ns, row + 10);
        ++k_;
        return step();
    }

    bool step()
    {
        ipe_row_t row;
        bool is_new = false;
        for (ipe_status_t status; (status = view.step(row)) != IPE_NOT_READY;) { is_new |= status == IPE_OK; }
        return is_new;
    }

    int64_t now() const { return SECOND + static_cast<int64_t>(std::llround(1e9 * static_cast<double>(k_) / rate_)); }
    std::size_t width() const { return width_; }

    ipe_pipeline_t state{};
    inertiad::Pipeline view{state};

private:
    inertiad::Vector3 normal3() { return {normal_(dice_), normal_(dice_), normal_(dice_)}; }

    /// Attitude error, first-order Gauss-Markov: q exp(turn).
    void wander(double* q, double louder)
    {
        const double keep = std::exp(-1.0 / (rate_ * noise_.wander_time));
        turn_ = keep * turn_ + std::sqrt(1.0 - keep * keep) * noise_.wander * normal3();
        const inertiad::Vector3 half = 0.5 * louder * turn_;
        const double w = q[0];
        const inertiad::Vector3 v(q[1], q[2], q[3]);
        const inertiad::Vector3 turned = v + w * half + v.cross(half);
        q[0] = w - v.dot(half);
        std::copy_n(turned.data(), 3, q + 1);
        const double norm = std::sqrt(q[0] * q[0] + turned.squaredNorm());
        for (int i = 0; i < 4; ++i) { q[i] /= norm; }
    }

    const Config& config_;
    std::vector<double> rows_;
    std::size_t width_;
    double rate_;
    Noise noise_;
    std::mt19937_64 dice_;
    std::normal_distribution<double> normal_;
    inertiad::Vector3 turn_;
    uint64_t k_ = 0;
};

using Inertia = Eigen::Matrix<double, 6, 1>;

Inertia inertia_of(const Feed& feed)
{
    return Eigen::Map<const Inertia>(feed.state.estimator.estimate.theta + 4);
}

/// Largest eigenvalue of P in units of P0: at most 1 where P <= P0.
double share_of_prior(const Feed& feed, const Eigen::MatrixXd& P0)
{
    ipe_rls_t copy = feed.state.estimator.rls;
    const Eigen::MatrixXd L = P0.llt().matrixL(), P = inertiad::Rls(copy).P();
    const Eigen::MatrixXd half = L.triangularView<Eigen::Lower>().solve(P);
    const Eigen::MatrixXd whole = L.triangularView<Eigen::Lower>().solve(half.transpose());
    return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(whole, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
}

void move(Feed& feed, int n_times)
{
    for (std::size_t i = 0; i < static_cast<std::size_t>(n_times) * feed.n(); ++i) { feed.push(i); }
}

void rest(Feed& feed, uint64_t n_windows)
{
    ipe_rls_t first = feed.state.estimator.rls;
    const Eigen::MatrixXd P0 = inertiad::Rls(first).P();
    move(feed, 2);
    const Inertia before = inertia_of(feed);
    const uint64_t at_rest = feed.state.window.n_windows;
    const auto per_day = static_cast<uint64_t>(DAY / (0.25 * feed.state.window.length));
    double moved = 0.0, share = 0.0;
    bool is_finite = true;
    Inertia yesterday = before;
    while (feed.state.window.n_windows - at_rest < n_windows) {
        if (!feed.push(0)) { continue; }
        const uint64_t n = feed.state.window.n_windows - at_rest;
        if (n % per_day == 0 || n == n_windows) {
            moved = std::max(moved, (inertia_of(feed) - yesterday).cwiseAbs().maxCoeff());
            yesterday = inertia_of(feed);
        }
        if (n % CHECK_INTERVAL == 0) {
            share = std::max(share, share_of_prior(feed, P0));
            is_finite &= ipe_pipeline_invariants_hold(&feed.state);
        }
    }
    const double moved_altogether = (inertia_of(feed) - before).cwiseAbs().maxCoeff();
    const uint64_t n_refused = feed.state.estimator.rls.n_nonfinite + feed.state.estimator.n_refused;
    move(feed, 4);
    is_finite &= ipe_pipeline_invariants_hold(&feed.state);
    share = std::max(share, share_of_prior(feed, P0));
    std::printf("windows %llu\n", static_cast<unsigned long long>(n_windows));
    std::printf("days %.2f\n", static_cast<double>(n_windows) / static_cast<double>(per_day));
    std::printf("moved_per_day %.6g\nmoved_altogether %.6g\n", moved, moved_altogether);
    std::printf("share_of_prior %.15g\nis_finite %d\n", share, is_finite);
    std::printf("n_refused %llu\n", static_cast<unsigned long long>(n_refused));
    std::printf("n_changes %llu\n", static_cast<unsigned long long>(feed.state.estimator.change_detector.n_changes));
    for (int i = 0; i < IPE_NP; ++i) { std::printf("theta_%d %.17g\n", i, feed.state.estimator.estimate.theta[i]); }
}

/// What the filter filled with numbers: it starts as all zero.
std::size_t bytes_in_use(const ipe_rls_t& s)
{
    const auto not_zero = [](double v) { return v != 0.0; };
    const auto n = std::count_if(std::begin(s.x), std::end(s.x), not_zero) +
                   std::count_if(std::begin(s.D), std::end(s.D), not_zero) +
                   std::count_if(std::begin(s.U), std::end(s.U), not_zero);
    return static_cast<std::size_t>(n) * sizeof(double);
}

void noise(Feed& feed, uint64_t n_windows)
{
    for (std::size_t i = 0; feed.state.window.n_windows < n_windows; ++i) { feed.push(i); }
    const ipe_change_detector_t& d = feed.state.estimator.change_detector;
    std::printf("hours %.3f\n", static_cast<double>(n_windows) * 0.25 * feed.state.window.length / 3600.0);
    std::printf("n_changes %llu\n", static_cast<unsigned long long>(d.n_changes));
    std::printf("n_held %llu\n", static_cast<unsigned long long>(d.n_held));
    std::printf("filter_bytes %zu\npipeline_bytes %zu\n", bytes_in_use(feed.state.estimator.rls), sizeof feed.state);
}

/// What must not change when an input is refused: the filter but for its counters, and the estimate.
struct Remembered {
    explicit Remembered(const ipe_pipeline_t& p) : rls(p.estimator.rls), estimate(p.estimator.estimate) {}
    bool holds(const ipe_pipeline_t& p) const
    {
        return std::memcmp(rls.x, p.estimator.rls.x, sizeof rls.x) == 0 &&
               std::memcmp(rls.D, p.estimator.rls.D, sizeof rls.D) == 0 &&
               std::memcmp(rls.U, p.estimator.rls.U, sizeof rls.U) == 0 && rls.n_updates == p.estimator.rls.n_updates &&
               std::memcmp(&estimate, &p.estimator.estimate, sizeof estimate) == 0;
    }
    ipe_rls_t rls;
    ipe_estimate_t estimate;
};

/// Set bits of a signal in data to those of raw.
void set_raw(const ipe_signal_t& s, uint64_t raw, uint8_t* data)
{
    int at = s.start;
    for (int i = 0; i < s.length; ++i) {
        const int shift = s.big_endian ? s.length - 1 - i : i;
        const auto bit = static_cast<uint8_t>(1U << (at % 8));
        data[at / 8] = static_cast<uint8_t>((data[at / 8] & ~bit) | ((raw >> shift & 1U) ? bit : 0U));
        at = !s.big_endian ? at + 1 : at % 8 == 0 ? at + 15 : at - 1;
    }
}

/// The code that a saturated sensor sends: the largest or the smallest.
uint64_t full_scale(const ipe_signal_t& s, bool is_low)
{
    const uint64_t all = ~0ULL >> (64 - s.length), largest = s.is_signed ? all >> 1 : all;
    return is_low ? largest ^ all : largest;
}

/// Inputs that a broken sensor gives, one by one.
class BadInputs {
public:
    explicit BadInputs(const Config& config) : config_(config) {}

    /// One of them into the pipeline. False if it was taken as good.
    bool push(Feed& feed, std::size_t number)
    {
        const std::size_t n_values = feed.width(), n_kinds = 3 * n_values;
        number %= n_kinds + 2 * static_cast<std::size_t>(config_.c().n_signals);
        if (number >= n_kinds) {
            return push_full_scale(feed, config_.c().signal[(number - n_kinds) / 2], number % 2 == 0);
        }
        const double bad[] = {NAN, INFINITY, -INFINITY};
        double row[13 + IPE_CABLES_MAX] = {0.0, 0.0, 9.81, 0.0, 0.0, 0.0, 1.0};
        const std::size_t i = number % n_values;
        row[i] = bad[number / n_values];
        const ipe_sensor_t sensor = i < 10 ? IPE_IMU : i < 13 ? IPE_POSITION : IPE_FORCE;
        return ipe_align_push(&feed.state.align, sensor, feed.now(), row + (i < 10 ? 0 : i < 13 ? 10 : 13)) < IPE_OK;
    }

private:
    /// Only what measures; a counter or a quaternion may well be at the end of its range.
    bool push_full_scale(Feed& feed, const ipe_signal_t& s, bool is_low) const
    {
        const bool measures =
            s.quantity < IPE_Q_QUAT_W || (s.quantity >= IPE_Q_POS_X && s.quantity < IPE_Q_IMU_COUNTER);
        if (!measures || s.kind != IPE_INTEGER) { return true; }
        ipe_frame_t frame{};
        frame.t_ns = feed.now();
        frame.can_id = s.can_id;
        frame.bus = static_cast<uint8_t>(s.bus);
        frame.length = static_cast<uint8_t>(s.frame_length);
        for (int i = 0; i < config_.c().n_signals; ++i) {  // the others in the middle of their range
            const ipe_signal_t& other = config_.c().signal[i];
            if (other.can_id == s.can_id && other.bus == s.bus) {
                set_raw(other, full_scale(other, false) / 2, frame.data);
            }
        }
        set_raw(s, full_scale(s, is_low), frame.data);
        const uint64_t before = feed.state.decode.n_out_of_range;
        (void)feed.view.push_frame(frame);
        return feed.state.decode.n_out_of_range == before + 1;
    }

    const Config& config_;
};

bool is_body(const ipe_estimate_t& e)
{
    const inertiad::Theta theta = Eigen::Map<const inertiad::Theta>(e.theta);
    const inertiad::PseudoInertia Pi = inertiad::pseudo_inertia(theta);
    const Eigen::Map<const inertiad::Covariance> P(&e.covariance[0][0]);
    const bool is_positive = Pi.llt().info() == Eigen::Success && P.llt().info() == Eigen::Success;
    return theta.allFinite() && P.allFinite() && is_positive && e.body.mass > 0.0;
}

void bad(Feed& feed, const Config& config, uint64_t n_estimates, uint64_t seed)
{
    BadInputs broken(config);
    std::mt19937_64 dice(seed + 1);
    std::uniform_real_distribution<double> share(0.0, 1.0);
    uint64_t n = 0, n_projected = 0, n_impossible = 0, n_bad = 0, n_taken = 0, n_disturbed = 0, n_refused = 0;
    while (n < n_estimates) {
        feed.start();
        const double louder = std::pow(WORST_NOISE, share(dice));
        const auto first = static_cast<std::size_t>(share(dice) * static_cast<double>(feed.n()));
        for (std::size_t i = first; feed.state.window.n_windows < RUN_WINDOWS && i < first + RUN_ROWS; ++i) {
            if (feed.push(i, louder)) {
                ++n;
                n_projected += !feed.state.estimator.estimate.consistent;
                n_impossible += !is_body(feed.state.estimator.estimate);
            }
            if (i % BAD_INTERVAL != 0) { continue; }
            const Remembered before(feed.state);
            n_taken += !broken.push(feed, n_bad++);
            (void)feed.step();
            n_disturbed += !before.holds(feed.state);
        }
        n_refused += feed.state.estimator.n_refused;
    }
    const struct {
        const char* name;
        uint64_t value;
    } count[] = {{"estimates", n},        {"n_projected", n_projected}, {"n_impossible", n_impossible},
                 {"bad_inputs", n_bad},   {"n_taken", n_taken},         {"n_disturbed", n_disturbed},
                 {"n_refused", n_refused}};
    for (const auto& c : count) { std::printf("%s %llu\n", c.name, static_cast<unsigned long long>(c.value)); }
}

std::vector<double> read(const char* path)
{
    std::ifstream file(path, std::ios::binary);
    const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    std::vector<double> values(bytes.size() / sizeof(double));
    std::memcpy(values.data(), bytes.data(), values.size() * sizeof(double));
    return values;
}

}  // namespace

int main(int argc, char** argv)
{
    if (argc != 13) {
        std::fputs("endure: usage: endure rest|noise|bad ROBOT.cfg ROWS RATE WINDOWS SEED NOISE[6]\n", stderr);
        return 2;
    }
    const std::string what = argv[1];
    double number[9];
    for (int i = 0; i < 9; ++i) { number[i] = std::atof(argv[4 + i]); }
    const auto n_windows = static_cast<uint64_t>(number[1]), seed = static_cast<uint64_t>(number[2]);
    const Noise sigma{number[3], number[4], number[5], number[6], number[7], number[8]};
    try {
        const Config config = Config::load(argv[2]);
        Feed feed(config, read(argv[3]), number[0], sigma, seed);
        if (what == "rest") { rest(feed, n_windows); }
        if (what == "noise") { noise(feed, n_windows); }
        if (what == "bad") { bad(feed, config, n_windows, seed); }
    } catch (const std::exception& error) {
        std::fprintf(stderr, "endure: %s\n", error.what());
        return 2;
    }
    return 0;
}
