// SPDX-License-Identifier: Apache-2.0
/// Feed-forward for a controller from the daemon's own mathematics: load robot.cfg, take a body's parameters, and print
/// the wrench the cables must give for a wanted acceleration.   Usage: feedforward robot.cfg
#include <inertiad/body.hpp>
#include <inertiad/cable.hpp>
#include <inertiad/config.hpp>

#include <cstdio>
#include <exception>

int main(int argc, char** argv)
try {
    if (argc != 2) {
        std::fprintf(stderr, "usage: %s robot.cfg\n", argv[0]);
        return 2;
    }
    const auto config = inertiad::Config::load(argv[1]);
    const auto theta = Eigen::Map<const inertiad::Theta>(config.c().prior_theta);
    const inertiad::Vector3 acceleration{0.5, 0.0, 0.0};  // of P, W, m/s2
    const inertiad::Vector3 gravity{0.0, 0.0, -config.c().gravity};
    const auto Y = inertiad::regressor(acceleration - gravity, inertiad::Vector3::Zero(), inertiad::Vector3::Zero());
    const inertiad::Vector6 wrench = Y * theta;  // level platform: P axes are W axes
    std::printf("force  %9.3f %9.3f %9.3f N\n", wrench[0], wrench[1], wrench[2]);
    std::printf("moment %9.3f %9.3f %9.3f N m\n", wrench[3], wrench[4], wrench[5]);
    return 0;
} catch (const std::exception& e) {
    std::fprintf(stderr, "feedforward: %s\n", e.what());
    return 2;
}
