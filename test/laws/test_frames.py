# SPDX-License-Identifier: Apache-2.0
"""A platform frame chosen otherwise changes the numbers of the answer, not the body they describe."""

import numpy as np
import pytest
from motion import NOMINAL, Motion, matrix_of, theta_of
from robots import checked, cogiro, frames
from scipy.spatial.transform import Rotation

import inertiad_core as core


def turn_of_theta(Q):
    """T with theta in turned axes = T theta."""
    T = np.zeros((10, 10))
    for j, e in enumerate(np.eye(10)):
        J = Q @ matrix_of(e[4:]) @ Q.T
        T[:, j] = [e[0], *(Q @ e[1:4]), J[0, 0], J[1, 1], J[2, 2], J[1, 2], J[0, 2], J[0, 1]]
    return T


def turned(config, Q):
    """The same robot with platform axes turned by Q: v' = Q v."""
    for cable in config.cable:
        cable.attachment = (Q @ cable.attachment).tolist()
    config.imu_position = (Q @ config.imu_position).tolist()
    w, x, y, z = config.imu_orientation
    mounted = Rotation.from_matrix(Q) * Rotation.from_quat([x, y, z, w])
    config.imu_orientation = mounted.as_quat()[[3, 0, 1, 2]].tolist()
    config.tracker_target = (Q @ config.tracker_target).tolist()
    T, B = turn_of_theta(Q), np.kron(np.eye(2), Q)
    config.prior_theta = (T @ config.prior_theta).tolist()
    covariance = T @ np.array(config.prior_covariance) @ T.T
    config.prior_covariance = ((covariance + covariance.T) / 2).tolist()
    residual = B @ np.array(config.residual_covariance) @ B.T
    config.residual_covariance = ((residual + residual.T) / 2).tolist()
    return config


def robot():
    config = cogiro()
    config.imu_position = [0.1, -0.2, 0.3]
    config.imu_orientation = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_quat()[[3, 0, 1, 2]].tolist()
    config.tracker_target = [0.3, 0.1, -0.2]
    return config


@pytest.fixture(scope="module")
def log():
    """12 s at 200 Hz with noise: (t_ns, frames, position)."""
    config, rng = robot(), np.random.default_rng(5)
    motion, t = Motion.random(rng, fastest=0.9), np.arange(2400) / 200.0
    p, R, w = motion.p(t), motion.R(t), motion.rate(t)
    W, sag = core.wrench_matrix(checked(config), p, R, np.zeros(3))
    y = core.regressor(motion.specific_force(t), w, motion.angular_acceleration(t)) @ theta_of(**NOMINAL)
    f = np.einsum("nij,nj->ni", np.linalg.pinv(W), y - sag) + rng.normal(0, 1.0, (len(t), 8))
    x, yq, z = config.imu_orientation[1:]
    R_PI = Rotation.from_quat([x, yq, z, config.imu_orientation[0]]).as_matrix()
    acc = motion.specific_force(t, config.imu_position) @ R_PI + rng.normal(0, 0.02, (len(t), 3))
    gyro = w @ R_PI + rng.normal(0, 0.001, (len(t), 3))
    q = Rotation.from_matrix(R @ R_PI).as_quat()[:, [3, 0, 1, 2]]
    position = p + R @ config.tracker_target
    stamps = np.rint(1e9 * (1.76e9 + t)).astype(np.int64)
    return [(int(n), list(frames(*row[:4])), row[4]) for n, *row in zip(stamps, acc, gyro, q, f, position, strict=True)]


def identify(config, log):
    run = core.Pipeline(checked(config))
    for t_ns, messages, position in log:
        for can_id, data in messages:
            assert run.push_frame(t_ns, 0, can_id, data, 1) == 0
        run.push_position(t_ns, position)
        while run.step() != 1:
            pass
    return run.estimate


def largest_difference(Q, log):
    """Of theta, in standard deviations, between the answer in turned axes and the turned answer."""
    T = turn_of_theta(Q)
    plain, other = identify(robot(), log), identify(turned(robot(), Q), log)
    assert abs(plain["mass"] - NOMINAL["mass"]) < 5.0  # it is an answer
    std = np.sqrt(np.diag(other["covariance"]))
    np.testing.assert_allclose(
        other["covariance"] / np.outer(std, std), T @ plain["covariance"] @ T.T / np.outer(std, std), atol=0.1
    )
    return np.abs((other["theta"] - T @ plain["theta"]) / std).max()


@pytest.mark.parametrize("rotvec", [[np.pi / 2, 0, 0], [0, np.pi / 2, 0], [0, 0, np.pi / 2], [np.pi, 0, 0]])
def test_axes_turned_by_right_angles_turn_the_answer(log, rotvec):
    assert largest_difference(np.rint(Rotation.from_rotvec(rotvec).as_matrix()), log) < 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_axes_turned_anyhow_turn_the_answer(log, seed):
    # Noise is learnt channel by channel, so only nearly the same rows count the same.
    Q = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    assert largest_difference(Q, log) < 0.2


@pytest.mark.parametrize("seed", range(10))
def test_least_squares_in_turned_axes_is_the_turned_least_squares(seed):
    rng = np.random.default_rng(seed)
    Q = Rotation.random(rng=rng).as_matrix()
    T, B = turn_of_theta(Q), np.kron(np.eye(2), Q)
    s, w, alpha = rng.normal(0, 2, (3, 100, 3))
    P0, L = np.diag([50.0, 15, 15, 15, 60, 60, 60, 20, 20, 20]) ** 2, np.diag([2.0, 2, 2, 1, 1, 1])
    plain, other = core.Rls(np.zeros(10), P0), core.Rls(np.zeros(10), T @ P0 @ T.T)
    theta = theta_of(**NOMINAL)
    for k in range(100):
        y = core.regressor(s[k : k + 1], w[k : k + 1], alpha[k : k + 1])[0] @ theta + L @ rng.normal(size=6)
        plain.update(core.regressor(s[k : k + 1], w[k : k + 1], alpha[k : k + 1])[0], y, L)
        turned_state = [np.ascontiguousarray(v[k : k + 1] @ Q.T) for v in (s, w, alpha)]
        other.update(core.regressor(*turned_state)[0], B @ y, L)
    np.testing.assert_allclose(other.x, T @ plain.x, atol=1e-9)
    np.testing.assert_allclose(other.P, T @ plain.P @ T.T, atol=1e-9)
