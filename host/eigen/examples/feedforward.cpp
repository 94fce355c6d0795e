// SPDX-License-Identifier: Apache-2.0
/// Feed-forward for a controller from the daemon's own mathematics: load robot.cfg, take a body's parameters, and print
/// the wrench the cables must give for a wanted acceleration, and the tensions that give it at a place.
/// Usage: feedforward robot.cfg [X Y Z]
#include <inertiad/feed_forward.hpp>

#include <cstdio>
#include <cstdlib>
#include <exception>

int main(int argc, char** argv)
try {
    if (argc != 2 && argc != 5) {
        std::fprintf(stderr, "usage: %s robot.cfg [X Y Z]\n", argv[0]);
        return 2;
    }
    const auto config = inertiad::Config::load(argv[1]);
    const auto theta = Eigen::Map<const inertiad::Theta>(config.c().prior_theta);
    const inertiad::Vector3 acceleration{0.5, 0.0, 0.0};  // of P, W, m/s2
    const inertiad::Vector3 none = inertiad::Vector3::Zero();
    const inertiad::Matrix3 level = inertiad::Matrix3::Identity();
    const auto wrench = inertiad::feed_forward(theta, level, acceleration, none, none, config.c().gravity);
    std::printf("force  %9.3f %9.3f %9.3f N\n", wrench[0], wrench[1], wrench[2]);
    std::printf("moment %9.3f %9.3f %9.3f N m\n", wrench[3], wrench[4], wrench[5]);
    if (argc != 5) { return 0; }
    const inertiad::Vector3 place{std::atof(argv[2]), std::atof(argv[3]), std::atof(argv[4])};
    inertiad::Tensions f;
    const bool is_held = inertiad::feed_forward_tensions(config, wrench, theta[0], place, level, f);
    for (int i = 0; i < config.n_cables(); ++i) { std::printf("cable %d %9.3f N\n", i + 1, f[i]); }
    if (!is_held) { std::printf("cut off: no tensions within the limits give this wrench here\n"); }
    return is_held ? 0 : 1;
} catch (const std::exception& e) {
    std::fprintf(stderr, "feedforward: %s\n", e.what());
    return 2;
}
