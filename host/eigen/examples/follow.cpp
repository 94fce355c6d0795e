// SPDX-License-Identifier: Apache-2.0
/// What a controller does: follow the daemon's estimate and feed forward the wrench for the motion it wants.
/// Prints one line per estimate until interrupted or a log ends.   Usage: follow LCM_URL [GRAVITY]
#include <inertiad/estimates.hpp>

#include <cstdio>
#include <cstdlib>
#include <exception>

int main(int argc, char** argv)
try {
    if (argc < 2 || argc > 3) {
        std::fprintf(stderr, "usage: %s LCM_URL [GRAVITY]\n", argv[0]);
        return 2;
    }
    const double gravity = argc == 3 ? std::atof(argv[2]) : 9.81;
    inertiad::Estimates estimates(argv[1]);
    const inertiad::Vector3 acceleration{0.5, 0.0, 0.0}, rate{0.0, 0.0, 0.1}, angular_acceleration{0.0, 0.2, 0.0};
    const inertiad::Matrix3 level = inertiad::Matrix3::Identity();
    for (int seen = 0; estimates.handle(100);) {
        if (estimates.count() == seen) { continue; }
        seen = estimates.count();
        const auto wrench =
            inertiad::feed_forward(estimates.theta(), level, acceleration, rate, angular_acceleration, gravity);
        std::printf("%.6f %.6f %.6f %.6f %.6f %.6f\n", wrench[0], wrench[1], wrench[2], wrench[3], wrench[4],
                    wrench[5]);
    }
    return 0;
} catch (const std::exception& e) {
    std::fprintf(stderr, "follow: %s\n", e.what());
    return 2;
}
