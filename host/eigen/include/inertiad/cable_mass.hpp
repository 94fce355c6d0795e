// SPDX-License-Identifier: Apache-2.0
/// The mass of the cables that a simulated platform moves.
///
/// Cable i is straight and inextensible, of mass per length sigma = w/g. Its free part, of length L, runs along e from the
/// pulley to the attachment B, whose velocity has the part v_t across e. All of the cable is paid out at L'. A piece at a
/// distance x from the pulley has the velocity L' e + x e', e' = v_t/L, and, as x' = L', the acceleration
///   (L'' - x |e'|^2) e + (x/L) a_t + (1 - x/L) c           a_t: of B across e    c = 2 L' v_t/L (Coriolis)
/// The moments of these forces of inertia about the pulley give the force across e on the platform, their sum along e the
/// difference between the tensions at the platform and at the winch:
///   F_t = -sigma L (a_t/3 + c/6)          f_platform = f_winch + sigma (L a_B . e + |v_t|^2/2)
/// As a sum over the modes of a taut string, n = 1, 2, ...: F_t = -sigma L sum 2/(n pi)^2 (a_t - (-1)^n c). A plant that
/// integrates the first mode (plant.hpp, swing) leaves its share to that.
/// Source: Newton's law for the pieces, above; modes: Rayleigh, Theory of Sound, vol. 1, ch. 6. Independent of
/// cable_inertia.h, which estimates with less: without c and |v_t|^2.
#pragma once

#include "cable.hpp"

namespace inertiad {

/// Force on the platform at B: -(mass a_B + rest), W.
struct CableMass {
    Matrix3 mass;  ///< kg
    Vector3 rest;  ///< N
};

/// Of a cable on this line to B, which moves at v_B [m/s], W. has_first_mode: that mode is felt elsewhere.
inline CableMass cable_mass(const ipe_cable_t& cable, const ipe_cable_line_t& line, double gravity, const Vector3& v_B,
                            bool has_first_mode)
{
    CableMass out{Matrix3::Zero(), Vector3::Zero()};
    if (!(cable.weight_per_length > 0.0 && gravity > 0.0)) { return out; }
    constexpr double pi = static_cast<double>(EIGEN_PI);
    const double first = has_first_mode ? 2.0 / (pi * pi) : 0.0;
    const double sigma = cable.weight_per_length / gravity;
    const Vector3 e = -Eigen::Map<const Vector3>(line.u);
    const double reeled = e.dot(v_B);
    const Vector3 v_t = v_B - reeled * e, c = 2.0 * reeled / line.free * v_t;
    out.mass = sigma * line.free * (1.0 / 3.0 - first) * (Matrix3::Identity() - e * e.transpose());
    out.rest = sigma * line.free * (1.0 / 6.0 - first) * c;
    if (cable.force_at == IPE_FORCE_AT_WINCH) {
        out.mass += sigma * line.free * e * e.transpose();
        out.rest += 0.5 * sigma * v_t.squaredNorm() * e;
    }
    return out;
}

/// Wrench of the mass of all cables on a platform in motion, about P, P axes, N and N m. p, v, a: of P, W; R: P to W; w,
/// alpha: P axes. Throws std::domain_error where a cable has no direction.
inline Vector6 cable_mass_wrench(const Config& config, const Vector3& p, const Vector3& v, const Vector3& a,
                                 const Matrix3& R, const Vector3& w, const Vector3& alpha)
{
    Vector6 wrench = Vector6::Zero();
    for (int i = 0; i < config.n_cables(); ++i) {
        const ipe_cable_t& cable = config.c().cable[i];
        if (!(cable.weight_per_length > 0.0)) { continue; }
        const Vector3 b = Eigen::Map<const Vector3>(cable.attachment), arm = R * b;
        const Vector3 a_B = a + R * (alpha.cross(b) + w.cross(w.cross(b)));
        const CableMass moved =
            cable_mass(cable, cable_line(cable, p + arm), config.c().gravity, v + R * w.cross(b), false);
        const Vector3 force = -R.transpose() * (moved.mass * a_B + moved.rest);
        wrench.head<3>() += force;
        wrench.tail<3>() += b.cross(force);
    }
    return wrench;
}

}  // namespace inertiad
