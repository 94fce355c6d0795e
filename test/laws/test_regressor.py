# SPDX-License-Identifier: Apache-2.0
"""The regressor and the body's conversions against pinocchio and against a rigid body's momentum."""

import numpy as np
import pinocchio as pin
from motion import GRAVITY, NOMINAL, Motion, derivative, matrix_of, random_body, theta_of

import inertiad_core as core

FROM_PIN = [0, 1, 2, 3, 4, 6, 9, 8, 7, 5]  # pinocchio: m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz


def pin_inertia(theta):
    return pin.Inertia.FromDynamicParameters(theta[np.argsort(FROM_PIN)])


def theta_from_pin(inertia):
    return inertia.toDynamicParameters()[FROM_PIN]


def test_regressor_equals_pinocchio_over_10000_states(measured):
    rng = np.random.default_rng(1)
    n = 10_000
    s, w, alpha = rng.normal(0, [[9.0]], (n, 3)), rng.normal(0, 2, (n, 3)), rng.normal(0, 5, (n, 3))
    velocity = rng.normal(0, 2, (n, 3))  # of the point: must not matter

    Y = core.regressor(s, w, alpha)

    largest = 0.0
    for k in range(n):
        spatial = s[k] - np.cross(w[k], velocity[k])  # pinocchio's acceleration is the spatial one
        reference = pin.bodyRegressor(pin.Motion(velocity[k], w[k]), pin.Motion(spatial, alpha[k]))[:, FROM_PIN]
        largest = max(largest, np.abs(Y[k] - reference).max() / np.abs(reference).max())
    measured(f"regressor against pinocchio {pin.__version__}: largest relative difference {largest:.1e} of {n} states")
    assert largest <= 1e-12


def test_regressor_is_the_derivative_of_momentum():
    rng = np.random.default_rng(2)
    for _ in range(20):
        mass, cog, inertia_cog = random_body(rng)
        motion, t = Motion.random(rng), rng.uniform(0, 20, 5)
        point = rng.normal(0, 0.3, 3)  # of the IMU, body axes

        def momentum(u, mass=mass, cog=cog, inertia_cog=inertia_cog, motion=motion):
            """Linear, and angular about the world's origin, [n, 6]."""
            R = motion.R(u)
            centre = lambda v: motion.p(v) + motion.R(v) @ cog  # noqa: E731
            linear = mass * derivative(centre, u)
            spin = np.einsum("nij,jk,nk->ni", R, inertia_cog, motion.rate(u))
            return np.concatenate([linear, spin + np.cross(centre(u), linear)], axis=1)

        change = derivative(momentum, t)
        R, p = motion.R(t), motion.p(t)
        weight = np.array([0.0, 0.0, -mass * GRAVITY])
        force = change[:, :3] - weight
        moment = change[:, 3:] - np.cross(p + R @ cog, weight) - np.cross(p + R @ point, force)
        expected = np.concatenate([np.einsum("nji,nj->ni", R, force), np.einsum("nji,nj->ni", R, moment)], axis=1)

        Y = core.regressor(motion.specific_force(t, point), motion.rate(t), motion.angular_acceleration(t))
        theta = theta_of(mass, cog - point, inertia_cog)
        np.testing.assert_allclose(Y @ theta, expected, rtol=1e-6, atol=1e-6 * mass)


def test_pseudo_inertia_equals_pinocchio(measured):
    rng = np.random.default_rng(3)
    largest = 0.0
    for _ in range(1000):
        theta = theta_of(*random_body(rng))
        reference = pin.PseudoInertia.FromDynamicParameters(theta[np.argsort(FROM_PIN)]).toMatrix()
        largest = max(largest, np.abs(core.pseudo_inertia(theta) - reference).max() / np.abs(reference).max())
    measured(f"pseudo-inertia against pinocchio: largest relative difference {largest:.1e} of 1000 bodies")
    assert largest <= 1e-12


def test_consistency_is_that_all_eigenvalues_are_positive():
    rng = np.random.default_rng(4)
    nominal = theta_of(**NOMINAL)
    seen = set()
    for _ in range(5000):
        theta = nominal + 25.0 * rng.normal(size=10)
        smallest = np.linalg.eigvalsh(core.pseudo_inertia(theta))[0]
        if abs(smallest) > 1e-9:
            assert core.is_consistent(theta) == (smallest > 0)
            seen.add(smallest > 0)
    assert seen == {True, False}


def test_body_equals_pinocchio():
    rng = np.random.default_rng(5)
    for _ in range(1000):
        theta = theta_of(*random_body(rng))
        reference = pin_inertia(theta)
        body = core.body(theta, np.eye(10))
        np.testing.assert_allclose(body["mass"], reference.mass, rtol=1e-14)
        np.testing.assert_allclose(body["cog"], reference.lever, rtol=0, atol=1e-13)
        np.testing.assert_allclose(matrix_of(body["inertia_cog"]), reference.inertia, rtol=0, atol=1e-10)


def test_shift_equals_pinocchios_action_on_inertias(measured):
    rng = np.random.default_rng(6)
    largest = 0.0
    for _ in range(1000):
        theta, d = theta_of(*random_body(rng)), rng.normal(0, 1, 3)
        reference = theta_from_pin(pin_inertia(theta).se3Action(pin.SE3(np.eye(3), d)))
        largest = max(largest, np.abs(core.shift(theta, d) - reference).max() / np.abs(reference).max())
    measured(f"shift of the reference point against pinocchio: largest relative difference {largest:.1e}")
    assert largest <= 1e-12


def test_body_jacobian_carries_covariance_to_first_order():
    rng = np.random.default_rng(7)
    theta = theta_of(*random_body(rng))
    scatter = theta + 1e-3 * rng.normal(size=(20_000, 10))
    bodies = [core.body(x, np.eye(10)) for x in scatter]
    values = np.array([[b["mass"], *b["cog"], *b["inertia_cog"]] for b in bodies])
    G = core.body_jacobian(theta)
    np.testing.assert_allclose(np.sqrt(np.diag(G @ G.T)), values.std(axis=0) / 1e-3, rtol=0.03)
