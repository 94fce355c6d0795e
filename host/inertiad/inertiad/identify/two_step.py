# SPDX-License-Identifier: Apache-2.0
"""The two-step method of the source paper (Tempel et al., ICRA 2017), for comparison.

    f_P = (1/m) F - ([alpha]x + [w]x [w]x) rho                        first 1/m and rho, from the forces
    tau - m rho x f_P = L(alpha) J_P + w x (L(w) J_P)                 then J_P, from the moments
alpha by central differences of the rate, every sample the same weight, one estimate per run, medians over runs.
Platform axes about P. It assumes perfect sensors: no offsets, no misalignment.
"""

from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.table import Array
from inertiad.robot.description import Robot
from inertiad.robot.keys import inertia_matrix

NOMINAL: Final = (161.058, -0.001, -0.077, -0.118, 94.955, 88.859, 31.635, 4.136, -0.085, -0.393)
ESTIMATED: Final = (170.740, 0.112, -0.134, -0.125, 102.982, 52.744, 46.589, 8.588, -0.132, -3.672)
"""Table III of Tempel et al., ICRA 2017, in the order of body.NAMES: nominal and estimated."""


def motion(robot: Robot, rows: Any) -> tuple[Array, Array, Array, Array, Array]:
    """Specific force at P, rate, angular acceleration [N, 3] in P axes, rotation [N, 3, 3] and position [N, 3] of P."""
    R_PI = Rotation.from_quat(robot.imu.orientation, scalar_first=True)
    R = Rotation.from_quat(rows.q, scalar_first=True) * R_PI.inv()
    w = R_PI.apply(rows.gyro)
    alpha = np.gradient(w, rows.t, axis=0)
    arm = -np.array(robot.imu.position)
    f_P = R_PI.apply(rows.acc) + np.cross(alpha, arm) + np.cross(w, np.cross(w, arm))
    return f_P, w, alpha, R.as_matrix(), rows.position - R.apply(robot.tracker.target)


def _skew(v: Array) -> Array:
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)


def _lambda(w: Array) -> Array:
    """L(w) [N, 3, 6] with L(w) J = J w for J as xx yy zz yz xz xy."""
    x, y, z = w.T
    o = np.zeros_like(x)
    return np.moveaxis(np.array([[x, o, o, o, z, y], [o, y, o, z, o, x], [o, o, z, y, x, o]]), 2, 0)


def two_step(f_P: Array, w: Array, alpha: Array, wrench: Array) -> Array:
    """m [kg], rho [3] m, J_C [6] kg m2 from motion [N, 3] each, wrench about P [N, 6]; NaN: mass not positive."""
    turn = _skew(alpha) + _skew(w) @ _skew(w)
    A = np.concatenate([wrench[:, :3, None], -turn], axis=2).reshape(-1, 4)
    inverse_mass, *rho_list = np.linalg.lstsq(A, f_P.ravel(), rcond=None)[0]
    if not inverse_mass > 0.0:
        return np.full(10, np.nan)
    m, rho = 1.0 / inverse_mass, np.array(rho_list)
    spin = _lambda(alpha) + _skew(w) @ _lambda(w)
    left = wrench[:, 3:] - m * np.cross(rho, f_P)
    J = inertia_matrix(np.linalg.lstsq(spin.reshape(-1, 6), left.ravel(), rcond=None)[0])
    J_C = J - m * (rho @ rho * np.eye(3) - np.outer(rho, rho))
    return np.array([m, *rho, J_C[0, 0], J_C[1, 1], J_C[2, 2], J_C[1, 2], J_C[0, 2], J_C[0, 1]])


def estimate(robot: Robot, config: Any, rows: Any) -> Array:
    """m, rho, J_C [10] of one run."""
    f_P, w, alpha, R, p = motion(robot, rows)
    W, sag = inertiad_core.wrench_matrix(config, np.ascontiguousarray(p), np.ascontiguousarray(R), np.zeros(3))
    offset = np.array(robot.calibration.force_offset or np.zeros(robot.n_cables))
    gain = np.array(robot.calibration.force_gain or np.zeros(robot.n_cables))
    wrench = np.einsum("nij,nj->ni", W, (rows.f - offset) / (1.0 + gain)) + sag
    return two_step(f_P, w, alpha, wrench)
