// SPDX-License-Identifier: Apache-2.0
/// From the publication of an ESTIMATE to parameters that a control thread can use:
///   hand_over LCM_URL SECONDS BUSY
/// One thread publishes at 50 Hz, one receives and offers to the gate. With BUSY 0, printed is the time from publishing until
/// the gate gives the parameters to whoever reads it; a loop of 1 kHz adds up to 1 ms of its own. A second line leaves out what
/// lay in a stall of the machine: on each CPU a thread of the highest priority does nothing but sleep, and its late
/// wake-ups are the hypervisor's and the kernel's, not ours. It needs the right to SCHED_FIFO. With BUSY of 1 or more as
/// many threads do nothing but compute, and another reads at 1 kHz. Printed is how long each reading takes, and how late it
/// begins. Lines: "n p50 p99 p99.9 longest" in us.
#include <inertiad/estimates.hpp>
#include <inertiad/parameter_gate.hpp>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <pthread.h>
#include <sched.h>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

namespace {

using namespace std::chrono;
constexpr milliseconds PERIOD{20};
constexpr milliseconds CONTROL_PERIOD{1};
constexpr microseconds WATCH_PERIOD{100};
constexpr microseconds STALL{300};  ///< chosen three times the period: timers of an idle CPU wake within 60 us

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

void print(std::vector<std::int64_t> ns)
{
    if (ns.empty()) { throw std::runtime_error("nothing arrived"); }
    std::sort(ns.begin(), ns.end());
    const auto us = [&](double x) {
        return 1e-3 * static_cast<double>(ns[static_cast<std::size_t>(x * static_cast<double>(ns.size() - 1))]);
    };
    std::printf("%zu %.2f %.2f %.2f %.2f\n", ns.size(), us(0.5), us(0.99), us(0.999), us(1.0));
}

/// When the CPUs of this machine did not run the most urgent thread they had.
class StallWatch {
public:
    StallWatch() : stalls_(std::max(1U, std::thread::hardware_concurrency()))
    {
        for (std::size_t cpu = 0; cpu < stalls_.size(); ++cpu) {
            threads_.emplace_back([this, cpu] { watch(cpu); });
            cpu_set_t one;
            CPU_ZERO(&one);
            CPU_SET(cpu, &one);
            sched_param most_urgent{};
            most_urgent.sched_priority = sched_get_priority_max(SCHED_FIFO);
            const pthread_t thread = threads_.back().native_handle();
            is_urgent_ &= pthread_setaffinity_np(thread, sizeof one, &one) == 0 &&
                          pthread_setschedparam(thread, SCHED_FIFO, &most_urgent) == 0;
        }
    }
    ~StallWatch() { stop(); }
    StallWatch(const StallWatch&) = delete;
    StallWatch& operator=(const StallWatch&) = delete;

    /// Ends the threads. Before it, has_stalled() has nothing to say.
    void stop()
    {
        is_over_ = true;
        for (std::thread& thread : threads_) { thread.join(); }
        threads_.clear();
    }
    /// Whether late wake-ups are the machine's: without SCHED_FIFO they can be our own.
    bool is_urgent() const { return is_urgent_; }
    bool has_stalled(std::int64_t from_ns, std::int64_t to_ns) const
    {
        return std::any_of(stalls_.begin(), stalls_.end(), [&](const auto& of_cpu) {
            return std::any_of(of_cpu.begin(), of_cpu.end(),
                               [&](const auto& stall) { return stall.first < to_ns && stall.second > from_ns; });
        });
    }

private:
    void watch(std::size_t cpu)
    {
        for (std::int64_t before = now_ns(); !is_over_;) {
            std::this_thread::sleep_for(WATCH_PERIOD);
            const std::int64_t after = now_ns();
            if (nanoseconds(after - before) > STALL) { stalls_[cpu].emplace_back(before, after); }
            before = after;
        }
    }

    std::vector<std::vector<std::pair<std::int64_t, std::int64_t>>> stalls_;  ///< of each CPU: from, to, ns
    std::vector<std::thread> threads_;
    std::atomic<bool> is_over_{false};
    bool is_urgent_ = true;
};

/// Publishes n estimates to a gate that a thread of its own fills, and another reads.
class Bench {
public:
    Bench(const char* url, std::size_t n) : url_(url), sent_(n + 1), used_(n + 1), gate_(nominal()) {}

    void run(int n_busy)
    {
        inertiad::Estimates estimates(url_, "BENCH_");
        std::thread receiver([&] { receive(estimates); });
        std::thread control([&] {
            if (n_busy > 0) { read_at_rate(); }
        });
        StallWatch machine;
        std::vector<std::thread> busy;
        for (int i = 0; i < n_busy; ++i) {
            busy.emplace_back([&] { compute(); });
        }
        publish();
        is_over_ = true;
        receiver.join();
        control.join();
        for (std::thread& thread : busy) { thread.join(); }
        machine.stop();
        if (n_busy > 0) {
            print(took_);
            print(late_);
            return;
        }
        std::vector<std::int64_t> until, without_stalls;
        for (std::size_t k = 1; k < sent_.size(); ++k) {
            if (used_[k] == 0) { continue; }
            until.push_back(used_[k] - sent_[k]);
            if (!machine.has_stalled(sent_[k], used_[k])) { without_stalls.push_back(until.back()); }
        }
        print(until);
        if (machine.is_urgent()) { print(without_stalls); }
    }

private:
    void publish()
    {
        Publisher publisher(url_);
        std::this_thread::sleep_for(milliseconds(200));
        for (std::size_t k = 1; k < sent_.size(); ++k) {
            sent_[k] = publisher.send(static_cast<std::int64_t>(k));
            std::this_thread::sleep_for(PERIOD);
        }
    }

    void receive(inertiad::Estimates& estimates)
    {
        for (int seen = 0; !is_over_;) {
            if (!estimates.handle(100) || estimates.count() == seen) { continue; }
            seen = estimates.count();
            (void)gate_.offer(estimates.newest(), now_ns());
            const std::int64_t sequence = gate_.read(now_ns()).sequence;
            if (sequence > 0) { used_[static_cast<std::size_t>(sequence)] = now_ns(); }
        }
    }

    void read_at_rate()
    {
        took_.reserve(sent_.size() * static_cast<std::size_t>(PERIOD / CONTROL_PERIOD + 1));
        late_.reserve(took_.capacity());
        for (auto due = steady_clock::now(); !is_over_; due += CONTROL_PERIOD) {
            std::this_thread::sleep_until(due);
            const auto begin = steady_clock::now();
            mass_ = gate_.read(now_ns()).theta[0];
            took_.push_back(duration_cast<nanoseconds>(steady_clock::now() - begin).count());
            late_.push_back(duration_cast<nanoseconds>(begin - due).count());
        }
    }

    void compute() const
    {
        volatile double x = 1.0;
        while (!is_over_) { x = x * 1.0000001; }
    }

    const char* url_;
    std::vector<std::int64_t> sent_, used_, took_, late_;  ///< ns
    inertiad::ParameterGate gate_;
    std::atomic<bool> is_over_{false};
    volatile double mass_ = 0.0;
};

}  // namespace

int main(int argc, char** argv)
try {
    if (argc != 4) { throw std::invalid_argument("usage: hand_over LCM_URL SECONDS BUSY"); }
    const auto n = static_cast<std::size_t>(std::atof(argv[2]) / duration<double>(PERIOD).count());
    Bench(argv[1], n).run(std::atoi(argv[3]));
    return 0;
} catch (const std::exception& e) {
    std::fprintf(stderr, "hand_over: %s\n", e.what());
    return 2;
}
