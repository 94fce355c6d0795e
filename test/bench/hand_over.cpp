// SPDX-License-Identifier: Apache-2.0
/// From the publication of an ESTIMATE to parameters that a control thread can use:
///   hand_over LCM_URL SECONDS
/// One thread publishes at 50 Hz, one receives and offers to the gate, one reads the gate without pause, as a control loop of
/// infinite rate. Prints "n p50 p99 p99.9 longest" in us. A loop of 1 kHz adds up to 1 ms of its own.
#include <inertiad/estimates.hpp>
#include <inertiad/parameter_gate.hpp>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <thread>
#include <vector>

namespace {

using namespace std::chrono;
constexpr milliseconds PERIOD{20};

std::int64_t now_ns()
{
    return duration_cast<nanoseconds>(system_clock::now().time_since_epoch()).count();
}

inertiad::Theta nominal()
{
    inertiad::Theta theta;
    theta << 100.0, 0.0, 0.0, 0.0, 50.0, 50.0, 50.0, 0.0, 0.0, 0.0;
    return theta;
}

/// A good estimate as large as the daemon's for 8 cables.
class Publisher {
public:
    explicit Publisher(const char* url) : lcm_(lcm_create(url))
    {
        if (lcm_ == nullptr) { throw std::runtime_error("LCM_URL cannot be opened"); }
        e_.schema = INERTIAD_LCM_ESTIMATE_T_SCHEMA, e_.verdict = INERTIAD_LCM_ESTIMATE_T_GOOD;
        Eigen::Map<inertiad::Theta>(e_.theta) = nominal();
        for (int i = 0; i < IPE_NP; ++i) { e_.covariance[i][i] = 1e-3, e_.observable[i] = 1; }
        e_.n_systematic = SYSTEMATIC;
        for (char*& name : names_) { name = text_; }
        e_.systematic_name = names_.data(), e_.systematic = value_.data(), e_.systematic_std = value_.data();
    }
    ~Publisher() { lcm_destroy(lcm_); }
    Publisher(const Publisher&) = delete;
    Publisher& operator=(const Publisher&) = delete;

    /// The host time before it is sent.
    std::int64_t send(std::int64_t sequence)
    {
        e_.sequence = sequence, e_.t_ns = now_ns();
        const std::int64_t before = now_ns();
        (void)inertiad_lcm_estimate_t_publish(lcm_, "BENCH_ESTIMATE", &e_);
        return before;
    }

private:
    static constexpr int SYSTEMATIC = 56;
    lcm_t* lcm_;
    inertiad_lcm_estimate_t e_{};
    char text_[20] = "force_lowpass_here";
    std::array<char*, SYSTEMATIC> names_{};
    std::array<double, SYSTEMATIC> value_{};
};

}  // namespace

int main(int argc, char** argv)
try {
    if (argc != 3) { throw std::invalid_argument("usage: hand_over LCM_URL SECONDS"); }
    const auto n = static_cast<std::size_t>(std::atof(argv[2]) / duration<double>(PERIOD).count());
    std::vector<std::int64_t> sent(n + 1), used(n + 1);
    std::atomic<bool> is_over{false};
    inertiad::ParameterGate gate(nominal());
    inertiad::Estimates estimates(argv[1], "BENCH_");
    std::thread receiver([&] {
        for (int seen = 0; !is_over;) {
            if (!estimates.handle(100) || estimates.count() == seen) { continue; }
            seen = estimates.count();
            (void)gate.offer(estimates.newest(), now_ns());
        }
    });
    std::thread control([&] {
        for (std::int64_t last = -1; !is_over;) {
            const std::int64_t now = now_ns(), sequence = gate.read(now).sequence;
            if (sequence != last) { used[static_cast<std::size_t>(sequence)] = now_ns(); }
            last = sequence;
        }
    });
    Publisher publisher(argv[1]);
    std::this_thread::sleep_for(milliseconds(200));
    for (std::size_t k = 1; k <= n; ++k) {
        sent[k] = publisher.send(static_cast<std::int64_t>(k));
        std::this_thread::sleep_for(PERIOD);
    }
    is_over = true;
    receiver.join();
    control.join();
    std::vector<double> us;
    for (std::size_t k = 1; k <= n; ++k) {
        if (used[k] != 0) { us.push_back(1e-3 * static_cast<double>(used[k] - sent[k])); }
    }
    if (us.empty()) { throw std::runtime_error("nothing arrived"); }
    std::sort(us.begin(), us.end());
    const auto share = [&](double x) { return us[static_cast<std::size_t>(x * static_cast<double>(us.size() - 1))]; };
    std::printf("%zu %.0f %.0f %.0f %.0f\n", us.size(), share(0.5), share(0.99), share(0.999), us.back());
    return 0;
} catch (const std::exception& e) {
    std::fprintf(stderr, "hand_over: %s\n", e.what());
    return 2;
}
