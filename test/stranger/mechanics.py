# SPDX-License-Identifier: Apache-2.0
"""Exact mechanics of a moved platform: a cloud of point masses, catenaries, pulleys by their tangent, in world axes.

Every function works on N instants at once.
"""

from dataclasses import dataclass

import numpy as np
from motions import Motion
from robots import Body, G, Robot
from scipy.optimize import lsq_linear

UP = np.array([0.0, 0.0, 1.0])
_EIGHTH = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_EIGHTH_2 = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
_H = 2e-3
"""s: step of the central differences of eighth order"""


@dataclass(frozen=True)
class Track:
    """The platform's motion at N instants."""

    t: np.ndarray
    p: np.ndarray
    """m, W [N, 3]: P"""
    R: np.ndarray
    """[N, 3, 3], body to world"""
    v: np.ndarray
    a: np.ndarray
    """m/s2, W: acceleration of P"""
    dR: np.ndarray
    ddR: np.ndarray

    @property
    def omega(self) -> np.ndarray:
        """rad/s, P [N, 3]."""
        return _vector_of(np.swapaxes(self.R, 1, 2) @ self.dR)

    def point(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration [N, 3], W, of a point fixed to the platform."""
        return self.p + self.R @ s, self.v + self.dR @ s, self.a + self.ddR @ s


def _vector_of(skew: np.ndarray) -> np.ndarray:
    """The vector of the skew part of matrices [N, 3, 3]."""
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.column_stack([0.5 * (skew[:, i, j] - skew[:, j, i]) for i, j in pairs])


def track_of(motion: Motion, t: np.ndarray) -> Track:
    """Positions and derivatives of a motion; the rotation's by central differences."""
    p, R = motion.pose(t)
    v, a = motion.position_rates(t)
    dR, ddR = np.zeros_like(R), np.zeros_like(R)
    for k in range(-4, 5):
        Rk = R if k == 0 else motion.pose(t + k * _H)[1]
        dR += _EIGHTH[k + 4] / _H * Rk
        ddR += _EIGHTH_2[k + 4] / _H**2 * Rk
    return Track(t, p, R, v, a, dR, ddR)


def needed_wrench(track: Track, body: Body) -> np.ndarray:
    """Force [N] and moment about P [N m], W [N, 6], that move the body so: Newton for each of its points."""
    force, moment = np.zeros_like(track.p), np.zeros_like(track.p)
    for m, s in zip(body.mass, body.point, strict=True):
        r, _, acceleration = track.point(s)
        push = m * (acceleration + G * UP)
        force += push
        moment += np.cross(r - track.p, push)
    return np.hstack([force, moment])


@dataclass(frozen=True)
class Cables:
    """Where the cables run, [N, m, 3] and [N, m]."""

    attachment: np.ndarray
    """m, W"""
    leave: np.ndarray
    """m, W: where the free cable leaves its pulley"""
    wrap: np.ndarray
    """rad of the pulley that the cable touches"""
    length: np.ndarray
    """m: anchor to attachment, arc included, without sag"""


def run_of(robot: Robot, p: np.ndarray, R: np.ndarray, anchor: np.ndarray, attachment: np.ndarray) -> Cables:
    """The cables of a pose. In the pulley's plane the free cable is the tangent from the attachment to the circle."""
    B = p[:, None, :] + np.einsum("nij,mj->nmi", R, attachment)
    d = B - anchor
    height = np.einsum("nmi,mi->nm", d, robot.axis)
    side = d - height[..., None] * robot.axis
    across = np.linalg.norm(side, axis=2)
    e = side / across[..., None]
    r = robot.pulley_radius
    to_centre = np.hypot(across - r, height)
    at = np.arctan2(height, across - r) + np.arccos(np.clip(r / to_centre, -1.0, 1.0))
    leave = anchor + e * (r + r * np.cos(at))[..., None] + robot.axis * (r * np.sin(at))[..., None]
    wrap = np.pi - at
    return Cables(B, leave, wrap, r * wrap + np.linalg.norm(B - leave, axis=2))


def catenary(leave: np.ndarray, end: np.ndarray, tension: np.ndarray, w: float) -> tuple[np.ndarray, np.ndarray]:
    """Force on the platform [..., 3], W, of a hanging cable of weight w [N/m], and its length [m].

    tension [N] is that at the platform's end. Solved for the horizontal component H = k dx by secant steps.
    """
    chord = leave - end
    dz = chord[..., 2]
    level = chord - dz[..., None] * UP
    dx = np.linalg.norm(level, axis=-1)
    length = np.hypot(dx, dz)
    if w == 0.0:
        return chord * (tension / length)[..., None], length

    def at_end(k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q = 0.5 * w / k
        sinh_ratio = np.where(q < 1e-4, 1.0 + q * q / 6.0, np.sinh(np.minimum(q, 50.0)) / q)
        q_coth = np.where(q < 1e-4, 1.0 + q * q / 3.0, q / np.tanh(q))
        s = np.sqrt(dz**2 + (dx * sinh_ratio) ** 2)
        return k * dz * q_coth - 0.5 * w * s, s

    k = tension / length
    for _ in range(30):
        up, s = at_end(k)
        error = np.hypot(k * dx, up) - tension
        eps = 1e-6 * k
        slope = (np.hypot((k + eps) * dx, at_end(k + eps)[0]) - np.hypot(k * dx, up)) / eps
        step = error / np.where(slope > 1e-9, slope, length)
        k = np.maximum(k - step, 0.3 * k)
        if np.abs(step / k).max() < 1e-12:
            break
    up, s = at_end(k)
    return level * k[..., None] + up[..., None] * UP, s


def _wrench_matrix(cables: Cables, p: np.ndarray, force: np.ndarray, f: np.ndarray) -> np.ndarray:
    """[N, 6, m]: columns are the directions of the cables' forces and their moments about P."""
    u = force / f[..., None]
    return np.concatenate([u, np.cross(cables.attachment - p[:, None, :], u)], axis=2).swapaxes(1, 2)


def reference_at_rest(robot: Robot, cables: Cables, p: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Tensions [m] of the first pose nearest the robot's reference, none below half of it, that hold the platform."""
    n = robot.n_cables
    f = np.full((1, n), max(robot.reference_tension, abs(wrench[0, 2]) / n))
    A = _wrench_matrix(
        cables, p, cables.leave - cables.attachment, np.linalg.norm(cables.leave - cables.attachment, axis=2)
    )
    heavy = 1e3 * A[0]
    low = robot.tension[0] if n == 6 else 0.5 * f[0, 0]
    best = lsq_linear(np.vstack([heavy, np.eye(n)]), np.r_[1e3 * wrench[0], f[0]], (low, robot.tension[1]))
    return best.x


def tensions(
    robot: Robot, cables: Cables, p: np.ndarray, wrench: np.ndarray, w: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tensions at the platform's end [N, m] that make the wrench [N, 6], near those of the first pose; their error.

    The direction of a hanging cable's force depends on its tension: a few rounds of the minimum-norm solution. The
    error [N] is the wrench that remains.
    """
    bend = reference_at_rest(robot, cables, p, wrench)
    f = np.tile(bend, (len(p), 1))
    remains = wrench
    for _ in range(12):
        load = np.maximum(np.abs(f), 1e-2)
        force, _ = catenary(cables.leave, cables.attachment, load, w)
        A = _wrench_matrix(cables, p, force, load)
        remains = wrench - np.einsum("nij,nj->ni", A, f)
        if np.abs(remains).max() < 1e-7 * np.abs(wrench).max():
            break
        f = bend + np.einsum("nij,nj->ni", np.linalg.pinv(A), wrench - A @ bend)
    return f, np.linalg.norm(remains[:, :3], axis=1)
