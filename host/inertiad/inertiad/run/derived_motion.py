# SPDX-License-Identifier: Apache-2.0
"""Derived motion: quantities that a data set lacks, from those it has.

Attitude from a tracker that measures poses, by spherical interpolation. Rate from attitude: quaternions are fitted by a
quintic least-squares B-spline q(t), and omega = 2 vec(q* q')/|q|^2, which is the paper's equation (4) without its
singularity. Specific force from positions: the IMU point's path is fitted by such a spline x(t), and
s = R^T (x'' + g z). The spline is differentiated, never the samples, and the result is averaged over windows
afterwards, so noise in x enters as integral(phi'' x) would. Poses at rest, seconds apart, become one window each.

What is derived is as wrong as the attitude and the positions it comes from; rows that hold it say so, and the batch
solver treats it so (derived.hpp).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.spatial.transform import Rotation, Slerp

from inertiad.base import quantity
from inertiad.base.table import Array, Table
from inertiad.robot.configuration import delays
from inertiad.robot.description import Robot

KNOTS_PER_WINDOW = 4
"""knots of the spline per window of the weak form: the window resolves no more"""
POSE_SAMPLES = 9
"""rows that stand for one pose at rest: exactly one window"""
POSE_GAP = 10.0
"""s between them"""


@dataclass(frozen=True)
class Completed:
    """Signals with every column that rows need."""

    robot: Robot
    signals: Table
    positions: Table
    derives_force: bool = False
    """acc comes from positions and attitude"""
    derives_rate: bool = False
    """gyro comes from attitude"""
    notes: tuple[str, ...] = ()
    """the derived quantities, as text"""


def spline(t: Array, x: Array, knot_distance: float) -> BSpline:
    """Quintic least-squares spline of x [N, k] over t [N] s, N >= 12."""
    least = 2.5 * float(np.median(np.diff(t)))
    n = max(1, min(int((t[-1] - t[0]) / max(knot_distance, least)), len(t) // 2 - 6))
    inner = np.linspace(t[0], t[-1], n + 1)[1:-1]
    return make_lsq_spline(t, x, np.r_[[t[0]] * 6, inner, [t[-1]] * 6], k=5)


def _continuous(q: Array) -> Array:
    """Quaternions [N, 4] with the signs that make them continuous."""
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    return np.concatenate([q[:1], q[1:] * flips[:, None]])


def rate_from_attitude(t: Array, q: Array, knot_distance: float) -> Array:
    """Angular rate in the body axes of q, rad/s [N, 3], of unit quaternions w x y z [N, 4] body to world."""
    fitted = spline(t, _continuous(q), knot_distance)
    a, b = fitted(t), fitted(t, 1)
    vector = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    return 2.0 * vector / np.sum(a * a, axis=1, keepdims=True)


@dataclass(frozen=True)
class _Axes:
    """Rotations between I, P and W by the calibration; equations in wrench.h."""

    R_PI: Rotation
    attitude: Rotation
    """P axes to those that q turns"""
    yaw: Rotation

    def to_world(self, q: Array) -> Rotation:
        """P to W at quaternions w x y z [N, 4]."""
        return self.yaw * Rotation.from_quat(q, scalar_first=True) * self.attitude


def _axes(robot: Robot) -> _Axes:
    calibration = robot.calibration
    mounting = Rotation.from_quat(robot.imu.orientation, scalar_first=True)
    R_PI = Rotation.from_rotvec(calibration.imu_alignment) * mounting
    yaw = Rotation.from_euler("z", calibration.world_yaw)
    return _Axes(R_PI, R_PI.inv() * Rotation.from_rotvec(calibration.attitude_bias), yaw)


def platform_attitude(robot: Robot, signals: Table) -> Rotation:
    """The N rotations P to W at the signals' quaternions, by the calibration."""
    return _axes(robot).to_world(signals.stack(*quantity.QUATERNION))


def attitude_from_poses(robot: Robot, tracker: Table, t: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Quaternions I to W [K, 4] at those of the times t [N] that lie between two poses of a tracker; which these are.

    The tracker's are platform to world. The delays of [align] and [calibration] are taken off both. Between poses
    further apart than max_age_position there is nothing.
    """
    delay = delays(robot)
    late = delay["position"] - delay["imu"]
    at = t + late
    after = np.clip(np.searchsorted(tracker.t, at), 1, len(tracker.t) - 1)
    near = np.diff(tracker.t)[after - 1] <= robot.align.max_age_position
    chosen = near & (at >= tracker.t[0]) & (at <= tracker.t[-1])
    body = Slerp(tracker.t, Rotation.from_quat(tracker.stack(*quantity.QUATERNION), scalar_first=True))
    turned = body(at[chosen]) * _axes(robot).R_PI
    return turned.as_quat(scalar_first=True), chosen


def _imu_path(robot: Robot, signals: Table, positions: Table) -> tuple[Array, Array]:
    """Times [K] s and positions [K, 3] of the IMU point in W, at the tracker's samples within the signals' time."""
    delay = delays(robot)
    t = positions.t - delay["position"] + delay["imu"]
    inside = (t >= signals.t[0]) & (t <= signals.t[-1])
    t, x = t[inside], positions.stack("x", "y", "z")[inside]
    R = Slerp(signals.t, platform_attitude(robot, signals))
    lever = np.array(robot.imu.position) - np.array(robot.tracker.target)
    return t, x + R(t).apply(lever)


def force_from_positions(robot: Robot, signals: Table, positions: Table, knot_distance: float) -> Array:
    """Specific force at the signals' times, I axes, m/s2 [N, 3], with the calibration's bias."""
    t, x = _imu_path(robot, signals, positions)
    at, axes = np.clip(signals.t, t[0], t[-1]), _axes(robot)
    s = spline(t, x, knot_distance)(at, 2) + np.array([0.0, 0.0, robot.gravity])
    R_WI = axes.to_world(signals.stack(*quantity.QUATERNION)) * axes.R_PI
    return R_WI.inv().apply(s) + np.array(robot.calibration.acc_bias)


def _gyro_from_attitude(robot: Robot, signals: Table, knot_distance: float) -> Array:
    """Angular rate at the signals' times, I axes, rad/s [N, 3], with the calibration's bias."""
    axes = _axes(robot)
    rate = rate_from_attitude(signals.t, signals.stack(*quantity.QUATERNION), knot_distance)
    return (axes.attitude * axes.R_PI).inv().apply(rate) + np.array(robot.calibration.gyro_bias)


def _poses(robot: Robot, signals: Table, positions: Table) -> Completed:
    """Each row as one window at rest."""
    dt = robot.estimator.window_length / (POSE_SAMPLES - 1)
    start = POSE_GAP * np.arange(1, len(signals.t) + 1)
    t = (start[:, None] + dt * np.arange(POSE_SAMPLES)).ravel()
    derives_force = quantity.ACC[0] not in signals.columns
    if derives_force:
        axes = _axes(robot)
        R_WI = axes.to_world(signals.stack(*quantity.QUATERNION)) * axes.R_PI
        acc = R_WI.inv().apply([0.0, 0.0, robot.gravity]) + np.array(robot.calibration.acc_bias)
    else:
        acc = signals.stack(*quantity.ACC)
    columns = dict(zip(quantity.ACC, acc.T, strict=True)) | {name: np.zeros(len(start)) for name in quantity.GYRO}
    kept = {**signals.columns, **columns}
    nearest = np.abs(positions.t[:, None] - signals.t).argmin(axis=0)
    xyz = {a: positions.columns[a][nearest] for a in ("x", "y", "z")}
    robot = robot.model_copy(update={"imu": robot.imu.model_copy(update={"rate": 1.0 / dt})})
    repeated = Table(t, {name: np.repeat(v, POSE_SAMPLES) for name, v in kept.items()}, signals.name)
    held = Table(t, {a: np.repeat(v, POSE_SAMPLES) for a, v in xyz.items()}, positions.name)
    note = f"{len(signals.t)} poses at rest: no inertia in them"
    return Completed(robot, repeated, held, derives_force, False, (note,))


def completed(robot: Robot, signals: Table, positions: Table) -> Completed:
    """Signals with every column the rows need. Samples further apart than a window are taken as poses at rest.

    Specific force derived from positions cannot carry them through gaps.
    """
    if len(signals.t) < 2 or float(np.median(np.diff(signals.t))) > robot.estimator.window_length:
        return _poses(robot, signals, positions)
    notes: list[str] = []
    distance = robot.estimator.window_length / KNOTS_PER_WINDOW
    columns = dict(signals.columns)
    derives_rate, derives_force = quantity.GYRO[0] not in columns, quantity.ACC[0] not in columns
    if derives_rate:
        rate = _gyro_from_attitude(robot, signals, distance)
        columns |= dict(zip(quantity.GYRO, rate.T, strict=True))
        notes.append("rate derived from attitude")
    if derives_force:
        s = force_from_positions(robot, signals, positions, distance)
        columns |= dict(zip(quantity.ACC, s.T, strict=True))
        robot = robot.model_copy(update={"align": robot.align.model_copy(update={"max_carry": 0.0})})
        notes.append("specific force derived from positions")
    whole = Table(signals.t, columns, signals.name)
    return Completed(robot, whole, positions, derives_force, derives_rate, tuple(notes))
