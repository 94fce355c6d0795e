// SPDX-License-Identifier: Apache-2.0
/// Time of one update by 6 rows, the core's factored filter beside the textbook one with fixed-size Eigen matrices:
///   update ROWS
/// ROWS holds blocks of 6 rows [h (10), y], whitened, as native doubles. Prints "name ns difference" per filter, the
/// difference being the largest of the final parameters against the core's.
#include <inertiad/rls.hpp>

#include <Eigen/Dense>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <vector>

namespace {

using inertiad::Covariance;
using inertiad::Matrix6;
using inertiad::Regressor;
using inertiad::Theta;
using inertiad::Vector6;

struct Block {
    Regressor H;
    Vector6 y;
};

const Theta X0 = Theta::Zero();
const Covariance P0 = 1e4 * Covariance::Identity();
constexpr int PASSES = 20;

std::vector<Block> read(const char* path)
{
    std::ifstream file(path, std::ios::binary);
    const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    const auto* value = reinterpret_cast<const double*>(bytes.data());
    std::vector<Block> blocks(bytes.size() / (66 * sizeof(double)));
    for (Block& b : blocks) {
        for (int i = 0; i < 6; ++i, value += 11) {
            b.H.row(i) = Eigen::Map<const Eigen::Matrix<double, 1, 10>>(value);
            b.y[i] = value[10];
        }
    }
    return blocks;
}

/// Core: P = U D U^T.
struct Factored {
    Factored() : view(state) { view.init(X0, P0, Eigen::VectorXd(0)); }
    void update(const Block& b)
    {
        double nis;
        inertiad::Rls::Rows H = b.H;
        view.update(H, b.y, L, nis);
    }
    Theta x() const { return view.x(); }
    ipe_rls_t state{};
    inertiad::Rls view;
    Matrix6 L = Matrix6::Identity();
};

/// Full covariance, one scalar row after the other.
struct ScalarRows {
    void update(const Block& b)
    {
        for (int i = 0; i < 6; ++i) {
            const Theta g = P * b.H.row(i).transpose();
            const Theta k = g / (1.0 + b.H.row(i).dot(g));
            theta += k * (b.y[i] - b.H.row(i).dot(theta));
            P -= k * g.transpose();
        }
    }
    Theta x() const { return theta; }
    Theta theta = X0;
    Covariance P = P0;
};

/// Full covariance, all six rows at once: the Kalman filter's measurement update.
struct Kalman {
    void update(const Block& b)
    {
        const Eigen::Matrix<double, 10, 6> G = P * b.H.transpose();
        const Eigen::Matrix<double, 6, 6> S = b.H * G + Matrix6::Identity();
        const Eigen::Matrix<double, 10, 6> K = S.llt().solve(G.transpose()).transpose();
        theta += K * (b.y - b.H * theta);
        P -= K * G.transpose();
    }
    Theta x() const { return theta; }
    Theta theta = X0;
    Covariance P = P0;
};

template <typename Filter>
void measure(const char* name, const std::vector<Block>& blocks, const Theta& reference)
{
    double least = 1e300, difference = 0.0;
    for (int pass = 0; pass < PASSES; ++pass) {
        Filter filter;
        const auto start = std::chrono::steady_clock::now();
        for (const Block& b : blocks) { filter.update(b); }
        const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - start;
        least = std::min(least, took.count() / static_cast<double>(blocks.size()));
        difference = (filter.x() - reference).cwiseAbs().maxCoeff() / reference.cwiseAbs().maxCoeff();
    }
    std::printf("%s %.1f %.2e\n", name, least, difference);
}

}  // namespace

int main(int argc, char** argv)
{
    const std::vector<Block> blocks = argc == 2 ? read(argv[1]) : std::vector<Block>();
    if (blocks.empty()) {
        std::fputs("update: usage: update ROWS\n", stderr);
        return 2;
    }
    Factored reference;
    for (const Block& b : blocks) { reference.update(b); }
    measure<Factored>("core", blocks, reference.x());
    measure<ScalarRows>("scalar_rows", blocks, reference.x());
    measure<Kalman>("kalman", blocks, reference.x());
    std::printf("eigen_version %d.%d.%d 0\n", EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION);
    return 0;
}
