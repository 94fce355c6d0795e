// SPDX-License-Identifier: Apache-2.0
/// The factored filter against batch least squares by Householder QR in long double, on the same rows:
///   recursion WINDOWS SYSTEMATIC SEED
/// Random windows of a moving body with SYSTEMATIC further columns, unit noise. Prints the largest difference of a
/// state, in parts of the largest state.
#include <inertiad/body.hpp>
#include <inertiad/rls.hpp>

#include <Eigen/QR>

#include <cstdio>
#include <cstdlib>
#include <random>

namespace {

using Wide = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;

constexpr int WINDOWS_PER_STEP = 50;  // folded into the triangle at once
constexpr double PRIOR_STD = 100.0;

/// Rows [h, y] of any number, kept as the triangle of their QR factors.
class Batch {
public:
    explicit Batch(Eigen::Index n) : n_(n), stacked_(n + 1 + 6 * WINDOWS_PER_STEP, n + 1)
    {
        stacked_.setZero();
        stacked_.topLeftCorner(n, n).diagonal().setConstant(1.0L / PRIOR_STD);
    }
    void add(const inertiad::Rls::Rows& H, const inertiad::Vector6& y)
    {
        const Eigen::Index at = n_ + 1 + 6 * n_waiting_++;
        stacked_.block(at, 0, 6, n_) = H.cast<long double>();
        stacked_.block(at, n_, 6, 1) = y.cast<long double>();
        if (n_waiting_ == WINDOWS_PER_STEP) { fold(); }
    }
    Eigen::VectorXd solve()
    {
        fold();
        const auto R = stacked_.topLeftCorner(n_, n_).triangularView<Eigen::Upper>();
        return R.solve(stacked_.col(n_).head(n_)).cast<double>();
    }

private:
    void fold()
    {
        const Eigen::HouseholderQR<Eigen::Ref<Wide>> qr(stacked_);
        for (Eigen::Index j = 0; j <= n_; ++j) { stacked_.col(j).tail(stacked_.rows() - j - 1).setZero(); }
        n_waiting_ = 0;
    }
    Eigen::Index n_, n_waiting_ = 0;
    Wide stacked_;
};

}  // namespace

int main(int argc, char** argv)
{
    if (argc != 4) {
        std::fputs("recursion: usage: recursion WINDOWS SYSTEMATIC SEED\n", stderr);
        return 2;
    }
    const long n_windows = std::atol(argv[1]);
    const Eigen::Index n_xi = std::atol(argv[2]), n = IPE_NP + n_xi;
    std::mt19937_64 dice(static_cast<uint64_t>(std::atoll(argv[3])));
    std::normal_distribution<double> normal;
    const auto random3 = [&](double scale) {
        return inertiad::Vector3(scale * normal(dice), scale * normal(dice), scale * normal(dice));
    };
    static ipe_rls_t state;
    inertiad::Rls filter(state);
    const inertiad::Covariance P0 = PRIOR_STD * PRIOR_STD * inertiad::Covariance::Identity();
    if (filter.init(inertiad::Theta::Zero(), P0, Eigen::VectorXd::Constant(n_xi, PRIOR_STD)) != IPE_OK) { return 2; }
    Batch batch(n);
    const Eigen::VectorXd truth = Eigen::VectorXd::LinSpaced(n, 1.0, static_cast<double>(n));
    const inertiad::Matrix6 L = inertiad::Matrix6::Identity();
    inertiad::Rls::Rows H(6, n);
    for (long k = 0; k < n_windows; ++k) {
        H.leftCols<IPE_NP>() = inertiad::regressor(random3(5.0), random3(1.0), random3(1.0));
        for (Eigen::Index i = 0; i < 6 * n_xi; ++i) { H(i % 6, IPE_NP + i / 6) = normal(dice); }
        inertiad::Vector6 y = H * truth;
        for (Eigen::Index i = 0; i < 6; ++i) { y[i] += normal(dice); }
        batch.add(H, y);
        double nis;
        if (filter.update(H, y, L, nis) != IPE_OK) { return 2; }
    }
    const Eigen::VectorXd reference = batch.solve();
    std::printf("difference %.3e\n", (filter.x() - reference).cwiseAbs().maxCoeff() / reference.cwiseAbs().maxCoeff());
    return 0;
}
