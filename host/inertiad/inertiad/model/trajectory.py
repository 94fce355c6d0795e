# SPDX-License-Identifier: Apache-2.0
"""Trajectories of the platform with exact derivatives.

    pose (p, R) over t  ->  velocity and acceleration of P in W;  omega and alpha in platform axes

Rest-to-rest moves follow p0 + (pF - p0) s(t) and the same for roll, pitch, yaw (R = Rz Ry Rx), s a polynomial of
degree 9 with four derivatives zero at both ends; omega = E eta', alpha = E' eta' + E eta''. Poses from a file run
through quintic splines of position and quaternion; the quaternion's norm drops out of omega = 2 Im(Q* Q') / |Q|^2.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from inertiad.base import quantity, table
from inertiad.base.error import InputError
from inertiad.base.table import Array

POSE_NAMES = ("x", "y", "z", "roll", "pitch", "yaw")
DERIVATIVE_NAMES = tuple(f"{kind}{axis}" for kind in ("v", "a", "omega_", "alpha_") for axis in "xyz")
"""Velocity and acceleration of P in W, m/s and m/s2; angular rate and acceleration, P axes, rad/s and rad/s2."""


@dataclass(frozen=True)
class Motion:
    """The platform over N instants."""

    p: Array
    """position of P in W, m [N, 3]"""
    v: Array
    """its velocity in W, m/s [N, 3]"""
    a: Array
    """its acceleration in W, m/s2 [N, 3]"""
    R: Array
    """P to W [N, 3, 3]"""
    omega: Array
    """angular rate, P axes, rad/s [N, 3]"""
    alpha: Array
    """angular acceleration, P axes, rad/s2 [N, 3]"""


class Trajectory(Protocol):
    """Something that moves the platform from t = 0 to t = duration [s]."""

    @property
    def duration(self) -> float: ...

    def at(self, t: Array) -> Motion:
        """The motion at times t [N]; at rest in the first and last pose outside of the duration."""
        ...


def _rest_to_rest(degree: int = 9) -> tuple[Polynomial, Polynomial, Polynomial]:
    """s on [0, 1] from 0 to 1 with (degree - 1) / 2 derivatives zero at both ends, and its first two derivatives."""
    k = (degree - 1) // 2
    shape = Polynomial([0, 1]) ** k * Polynomial([1, -1]) ** k
    s = shape.integ()
    s = s / s(1.0)
    return s, s.deriv(), s.deriv(2)


_S, _S1, _S2 = _rest_to_rest()


def _euler_matrix(rpy: Array, rate: Array) -> tuple[Array, Array]:
    """E [N, 3, 3] with omega = E eta', P axes, and its time derivative."""
    phi, theta = rpy[:, 0], rpy[:, 1]
    sp, cp, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    dphi, dtheta = rate[:, 0], rate[:, 1]
    one, zero = np.ones_like(phi), np.zeros_like(phi)
    E = np.array([[one, zero, -st], [zero, cp, ct * sp], [zero, -sp, ct * cp]])
    dE = np.array(
        [
            [zero, zero, -ct * dtheta],
            [zero, -sp * dphi, -st * sp * dtheta + ct * cp * dphi],
            [zero, -cp * dphi, -st * cp * dtheta - ct * sp * dphi],
        ]
    )
    return np.moveaxis(E, 2, 0), np.moveaxis(dE, 2, 0)


def motion_of(x: Array, dx: Array, ddx: Array) -> Motion:
    """The motion of pose coordinates x y z [m] roll pitch yaw [rad], [N, 6], and their first two derivatives."""
    rpy, rate, acceleration = x[:, 3:], dx[:, 3:], ddx[:, 3:]
    E, dE = _euler_matrix(rpy, rate)
    omega = np.einsum("nij,nj->ni", E, rate)
    alpha = np.einsum("nij,nj->ni", dE, rate) + np.einsum("nij,nj->ni", E, acceleration)
    R = Rotation.from_euler("ZYX", rpy[:, ::-1]).as_matrix()
    return Motion(x[:, :3], dx[:, :3], ddx[:, :3], R, omega, alpha)


class Moves:
    """Rest-to-rest moves between poses, with rests between them."""

    def __init__(self, poses: Array, move_time: list[float], rest_time: float) -> None:
        """poses [K, 6] x y z [m] roll pitch yaw [rad]; K - 1 move times [s]; a rest [s] before, between and after."""
        self._poses = poses
        self._start = np.cumsum([rest_time, *(d + rest_time for d in move_time)])[:-1]
        self._time = np.array(move_time)
        self.duration = float(self._start[-1] + move_time[-1] + rest_time) if move_time else rest_time

    def _pose(self, t: Array) -> tuple[Array, Array, Array]:
        """Pose coordinates [N, 6] and their first two derivatives."""
        if len(self._time) == 0:
            still = np.zeros((len(t), 6))
            return still + self._poses[0], still, still
        k = np.clip(np.searchsorted(self._start, t, side="right") - 1, 0, len(self._time) - 1)
        duration = self._time[k]
        tau = np.clip((t - self._start[k]) / duration, 0.0, 1.0)
        delta = self._poses[k + 1] - self._poses[k]
        s, s1, s2 = _S(tau), _S1(tau) / duration, _S2(tau) / duration**2
        return self._poses[k] + delta * s[:, None], delta * s1[:, None], delta * s2[:, None]

    @property
    def spans(self) -> Array:
        """Start and end of every move, s [K - 1, 2]."""
        return np.column_stack([self._start, self._start + self._time])

    def at(self, t: Array) -> Motion:
        return motion_of(*self._pose(t))


def _times_conjugate(a: Array, b: Array) -> Array:
    """Vector part of a* b for quaternions w x y z [N, 4] -> [N, 3]."""
    return a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])


class Spline:
    """Poses from a file, joined by quintic splines; at rest before and after."""

    def __init__(self, t: Array, p: Array, q: Array) -> None:
        """t [N] s, increasing; p [N, 3] m; q [N, 4] unit quaternions w x y z, P to W; N >= 6."""
        flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
        q = np.concatenate([q[:1], q[1:] * flips[:, None]])
        self._spline: BSpline = make_interp_spline(t - t[0], np.hstack([p, q]), k=5)
        self.duration = float(t[-1] - t[0])

    def at(self, t: Array) -> Motion:
        inside = ((t >= 0.0) & (t <= self.duration))[:, None]
        x = self._spline(np.clip(t, 0.0, self.duration))
        dx = np.where(inside, self._spline(np.clip(t, 0.0, self.duration), 1), 0.0)
        ddx = np.where(inside, self._spline(np.clip(t, 0.0, self.duration), 2), 0.0)
        Q, dQ, ddQ = x[:, 3:], dx[:, 3:], ddx[:, 3:]
        norm2 = np.sum(Q * Q, axis=1, keepdims=True)
        omega = 2.0 * _times_conjugate(Q, dQ) / norm2
        alpha = 2.0 * _times_conjugate(Q, ddQ) / norm2 - 2.0 * omega * np.sum(Q * dQ, axis=1, keepdims=True) / norm2
        R = Rotation.from_quat(Q, scalar_first=True).as_matrix()
        return Motion(x[:, :3], dx[:, :3], ddx[:, :3], R, omega, alpha)


def _pose(x: float, y: float, z: float, roll_deg: float, pitch_deg: float, yaw_deg: float) -> list[float]:
    return [x, y, z, *np.deg2rad([roll_deg, pitch_deg, yaw_deg])]


PAPER_PAIRS = np.array(
    [
        [_pose(0.01, -0.01, 1.55, -18.80, 24.87, -30.74), _pose(1.01, 1.49, 2.55, 21.20, -10.13, 29.26)],
        [_pose(-1.20, 0.60, 2.30, 17.00, 16.00, 20.00), _pose(0.80, -0.90, 1.50, -18.00, -17.00, -25.00)],
        [_pose(0.90, 0.80, 1.60, -16.00, -18.00, 28.00), _pose(-0.80, -0.60, 2.50, 19.00, 18.00, -24.00)],
        [_pose(-0.70, -1.20, 1.70, 20.00, -16.00, -20.00), _pose(0.60, 1.00, 2.40, -19.00, 17.00, 26.00)],
    ]
)
"""Start and end poses [4, 2, 6] of the paper protocol, m and rad: first the published one, the others are ours."""

MOVE_TIME = 3.6
"""s of a forward or backward move: peaks of 1.8 m/s and 1.9 m/s2, inside the tracker's 4 m/s and 2 m/s2."""


def paper() -> Moves:
    """Four trajectories, each forward and backward, a transfer between them, rests of 0.5 s."""
    return there_and_back(PAPER_PAIRS, MOVE_TIME)


def there_and_back(pairs: Array, move_time: float) -> Moves:
    """Moves [s] from the start to the end pose of each pair [K, 2, 6] and back, transfers between them, rests."""
    poses, times = [pairs[0, 0]], []
    for number, (start, end) in enumerate(pairs):
        if number > 0:
            poses.append(start)
            times.append(move_time)
        poses += [end, start]
        times += [move_time, move_time]
    return Moves(np.array(poses), times, rest_time=0.5)


def paper_spans() -> Array:
    """Start and end of the eight moves of paper(), forward and backward in turn, the transfers left out, s [8, 2]."""
    spans = paper().spans
    return spans[np.arange(len(spans)) % 3 != 2]


def hold(pose: Array, duration: float) -> Moves:
    """At rest in a pose [6], x y z [m] roll pitch yaw [rad], for a duration [s]."""
    return Moves(np.array([pose]), [], rest_time=duration)


def read(path: Path) -> Spline:
    """A pose CSV: t [s], x y z [m], and roll pitch yaw [rad] or q_w q_x q_y q_z. InputError: not such a file.

    Columns of derivatives, DERIVATIVE_NAMES, and of lengths may be there and are not used.
    """
    lengths = quantity.lengths(quantity.CABLES_MAX)
    allowed = ["t", "x", "y", "z", *quantity.RPY, *quantity.QUATERNION, *DERIVATIVE_NAMES, *lengths]
    poses = table.read(path, allowed)
    have_q = all(name in poses.columns for name in quantity.QUATERNION)
    attitude = quantity.QUATERNION if have_q else quantity.RPY
    for name in ("x", "y", "z", *attitude):
        if name not in poses.columns:
            raise InputError(
                f"{path}: line 1: no column {name}: allowed: t,x,y,z and roll,pitch,yaw or q_w,q_x,q_y,q_z"
            )
    if len(poses.t) < 6:
        raise InputError(f"{path}: {len(poses.t)} poses: allowed: 6 or more")
    if have_q:
        rotation = Rotation.from_quat(_unit(poses.stack(*attitude), path), scalar_first=True)
    else:
        rotation = Rotation.from_euler("ZYX", poses.stack(*attitude)[:, ::-1])
    return Spline(poses.t, poses.stack("x", "y", "z"), rotation.as_quat(scalar_first=True))


def _unit(q: Array, path: Path) -> Array:
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    if np.any(np.abs(norm - 1.0) > 0.01):
        row = int(np.argmax(np.abs(norm - 1.0)))
        raise InputError(f"{path}: pose {row + 1}: |q| = {norm[row, 0]:.4g}: allowed: 1, within 1 %")
    return q / norm


def named(name: str, pose: str, duration: float) -> Trajectory:
    """The trajectory the command line means: "paper", "hold" in a pose "x,y,z,roll,pitch,yaw", or a pose CSV.

    InputError: none of these, or a pose that is not six numbers.
    """
    if name == "paper":
        return paper()
    if name == "hold":
        return hold(_parsed_pose(pose), duration)
    if not name.endswith(".csv"):
        raise InputError(f'--trajectory "{name}": allowed: paper, hold, or a .csv file')
    return read(Path(name))


def _parsed_pose(text: str) -> Array:
    try:
        pose = np.array([float(cell) for cell in text.split(",")])
    except ValueError:
        pose = np.empty(0)
    if pose.shape != (6,) or not np.isfinite(pose).all():
        raise InputError(f'--pose "{text}": allowed: six numbers, {",".join(POSE_NAMES)}, m and rad')
    return pose
