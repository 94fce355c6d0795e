// SPDX-License-Identifier: Apache-2.0
/// What a controller does: offer the daemon's estimates to a gate, and feed forward the wrench for the motion it wants with
/// the parameters that the gate gives. Prints one line per estimate until interrupted or a log ends; says on stderr why an
/// estimate is not used, once per reason.   Usage: follow LCM_URL robot.cfg
#include <inertiad/config.hpp>
#include <inertiad/estimates.hpp>
#include <inertiad/feed_forward.hpp>
#include <inertiad/parameter_gate.hpp>

#include <chrono>
#include <cstdio>
#include <exception>
#include <string>

static std::int64_t wall_clock_ns()
{
    using namespace std::chrono;
    return duration_cast<nanoseconds>(system_clock::now().time_since_epoch()).count();
}

int main(int argc, char** argv)
try {
    if (argc != 3) {
        std::fprintf(stderr, "usage: %s LCM_URL robot.cfg\n", argv[0]);
        return 2;
    }
    const bool is_log = std::string(argv[1]).rfind("file:", 0) == 0;
    const auto config = inertiad::Config::load(argv[2]);
    inertiad::Estimates estimates(argv[1]);
    inertiad::ParameterGate gate(Eigen::Map<const inertiad::Theta>(config.c().prior_theta));
    const inertiad::Vector3 acceleration{0.5, 0.0, 0.0}, rate{0.0, 0.0, 0.1}, angular_acceleration{0.0, 0.2, 0.0};
    const inertiad::Matrix3 level = inertiad::Matrix3::Identity();
    auto reason = IPE_GATE_TAKEN;
    for (int seen = 0; estimates.handle(100);) {
        if (estimates.count() == seen) { continue; }
        seen = estimates.count();
        const std::int64_t now = is_log ? estimates.newest().t_ns : wall_clock_ns();
        const auto outcome = gate.offer(estimates.newest(), now);
        if (outcome != reason && outcome != IPE_GATE_TAKEN) {
            std::fprintf(stderr, "follow: not used: %s\n", ipe_parameter_gate_text(outcome));
        }
        reason = outcome;
        const auto wrench = inertiad::feed_forward(gate.read(now).theta, level, acceleration, rate,
                                                   angular_acceleration, config.c().gravity);
        std::printf("%.6f %.6f %.6f %.6f %.6f %.6f\n", wrench[0], wrench[1], wrench[2], wrench[3], wrench[4],
                    wrench[5]);
    }
    return 0;
} catch (const std::exception& e) {
    std::fprintf(stderr, "follow: %s\n", e.what());
    return 2;
}
