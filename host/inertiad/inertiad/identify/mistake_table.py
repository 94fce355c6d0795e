# SPDX-License-Identifier: Apache-2.0
"""The table of mistakes: wiring, mounting, units, geometry, delays, each as a change to the samples or to the robot.

A mistake without free numbers is there or not, such as two cables that are swapped. One with free numbers has a size,
such as the pulley's radius; mistake_fit.py finds it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from inertiad.base import units
from inertiad.base.finding import Severity
from inertiad.base.table import Array
from inertiad.robot import configuration
from inertiad.robot.description import Robot


@dataclass(frozen=True)
class Samples:
    """One run's samples."""

    t: Array
    """s [N]"""
    acc: Array
    """I axes, m/s2 [N, 3]"""
    gyro: Array
    """I axes, rad/s [N, 3]"""
    R: Array
    """I to W [N, 3, 3]"""
    position: Array
    """of the tracker's target, W, m [N, 3]"""
    f: Array
    """N [N, m]"""


@dataclass(frozen=True)
class Case:
    """Runs and their robot, as described or as a mistake has them."""

    robot: Robot
    runs: tuple[Samples, ...]
    extra: Array | None = None
    """force on P that no cable gives [3], W, N"""

    def each(self, change: Callable[[Samples], Samples]) -> "Case":
        return replace(self, runs=tuple(change(run) for run in self.runs))

    def with_robot(self, **update: Any) -> "Case":
        return replace(self, robot=self.robot.model_copy(update=update))


@dataclass(frozen=True)
class Mistake:
    """A way in which the runs may have been meant."""

    kind: str
    """name of the finding; mistakes of one kind are not rivals"""
    words: str
    """with {} for each number, given + found"""
    apply: Callable[[Case, Array], Case]
    """the case as it would be right, for free numbers [n]"""
    steps: tuple[float, ...] = ()
    """of each free number, for derivatives"""
    given: tuple[float, ...] = ()
    """by robot.toml"""
    std: float = 0.0
    """that robot.toml declares of each number: what is within four of them is no mistake"""
    limit: float = np.inf
    """largest number that makes sense"""
    severity: Severity = "stop"
    """care: the joint fit takes it out by itself"""
    law: str = ""
    """kinematics or rotation: the law by which the best few of the kind are chosen first"""

    def says(self, numbers: Array) -> str:
        return self.words.format(*(np.array(self.given) + numbers))


def mounting(robot: Robot) -> Array:
    """R_PI [3, 3], I to P."""
    return np.asarray(Rotation.from_quat(robot.imu.orientation, scalar_first=True).as_matrix())


def about_z(angle: float) -> Array:
    return np.asarray(Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix())


def earlier(t: Array, x: Array, delay: float) -> Array:
    """The samples of a signal that came too late by a delay [s]."""
    return np.column_stack([np.interp(t + delay, t, column) for column in x.T])


BESSEL: Final = 14.0
"""half the variance of a Bessel low-pass of order 4 is its delay squared over this"""


def before_lowpass(t: Array, x: Array, delay: float) -> Array:
    """The samples of a signal that a Bessel low-pass of this delay [s] has smoothed, to second order."""
    curvature = np.gradient(np.gradient(x, t, axis=0), t, axis=0)
    return earlier(t, x - delay * abs(delay) / BESSEL * curvature, delay)


def _with_cables(case: Case, update: Callable[[int], dict[str, Any]]) -> Case:
    return case.with_robot(cable=[c.model_copy(update=update(i)) for i, c in enumerate(case.robot.cable)])


def _signed_permutations() -> Iterator[tuple[str, Array]]:
    """All ways to name and orient three axes but the right one: names of the axes meant, matrix from given to meant."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.diag(signs) @ np.eye(3)[list(order)]
        if not np.array_equal(matrix, np.eye(3)):
            yield ", ".join(("-" if s < 0 else "") + "xyz"[i] for s, i in zip(signs, order, strict=True)), matrix


def _forces(robot: Robot) -> Iterator[Mistake]:
    m, gain = robot.n_cables, configuration.std(robot)["force_gain"]
    for i, j in combinations(range(m), 2):
        order = list(range(m))
        order[i], order[j] = j, i

        def exchange(case: Case, _: Array, order: list[int] = order) -> Case:
            return case.each(lambda run: replace(run, f=run.f[:, order]))

        yield Mistake("swapped_cables", f"cables {i + 1} and {j + 1} look swapped", exchange)
    for i in range(m):

        def scale(case: Case, x: Array, i: int = i) -> Case:
            return case.each(lambda run: replace(run, f=run.f * (1.0 + x[0] * np.eye(m)[i])))

        words = f"force sensor {i + 1} looks scaled: its force times {{:.3f}} fits"
        yield Mistake("force_gain", words, scale, (1e-3,), (1.0,), gain)

    def delay(case: Case, x: Array) -> Case:
        return case.each(lambda run: replace(run, f=earlier(run.t, run.f, x[0])))

    words = "the forces look {:.4f} s late"
    yield Mistake("force_delay", words, delay, (1e-3,), (0.0,), robot.std.force_delay, 0.3)

    def smooth(case: Case, x: Array) -> Case:
        return case.each(lambda run: replace(run, f=before_lowpass(run.t, run.f, x[0])))

    words = "the forces look smoothed by a low-pass that makes them {:.4f} s late"
    std = robot.std.force_delay
    yield Mistake("force_lowpass", words, smooth, (1e-3,), (0.0,), std, 0.3, severity="care")
    words = "a force of {:.3g}, {:.3g}, {:.3g} N (world axes) acts on the platform that no cable gives"
    yield Mistake("external_force", words, lambda case, x: replace(case, extra=x), (1.0,) * 3, (0.0,) * 3)


def _geometry(robot: Robot) -> Iterator[Mistake]:
    for i, key, axis in product(range(robot.n_cables), ("anchor", "attachment"), range(3)):
        given = np.array(getattr(robot.cable[i], key), float)

        def move(case: Case, x: Array, i: int = i, key: str = key, axis: int = axis, given: Array = given) -> Case:
            moved = (given + x[0] * np.eye(3)[axis]).tolist()
            return _with_cables(case, lambda k: {key: moved} if k == i else {})

        words = f"cable[{i + 1}].{key} looks wrong along {'xyz'[axis]}: {{:.4g}} m instead of {given[axis]:.4g} m fits"
        yield Mistake(key, words, move, (1e-4,), (float(given[axis]),), robot.std.geometry)
    radius, weight = (
        float(np.mean([getattr(c, key) for c in robot.cable])) for key in ("pulley_radius", "weight_per_length")
    )
    yield Mistake(
        "pulley_radius",
        f"pulley_radius looks wrong: pulley_radius = {{:.3f}} m instead of {radius:g} m fits",
        lambda case, x: _with_cables(case, lambda _: {"pulley_radius": max(radius + float(x[0]), 0.0)}),
        (1e-3,),
        (radius,),
        1e-3,
        0.5,
    )
    yield Mistake(
        "cable_weight",
        f"weight_per_length looks wrong: {{:.3g}} N/m instead of {weight:g} N/m fits",
        lambda case, x: _with_cables(case, lambda _: {"weight_per_length": max(weight + float(x[0]), 0.0)}),
        (0.01,),
        (weight,),
    )


def _turn(matrix: Array) -> str:
    """A turn by right angles in words, if it is about one axis."""
    rotvec = Rotation.from_matrix(matrix).as_rotvec(degrees=True)
    axis = int(np.argmax(np.abs(rotvec)))
    if np.abs(np.delete(rotvec, axis)).max() > 1.0:
        return "turned against robot.toml"
    angle = 180 if abs(rotvec[axis]) > 179.0 else round(rotvec[axis])
    upside = " (mounted upside down)" if matrix[2, 2] < -0.5 else ""
    return f"turned by {angle} deg about {'xyz'[axis]} against robot.toml{upside}"


def _imu(robot: Robot) -> Iterator[Mistake]:
    mount = mounting(robot)
    for name, matrix in _signed_permutations():
        if np.linalg.det(matrix) > 0.0:
            q = Rotation.from_matrix(matrix @ mount).as_quat(canonical=True, scalar_first=True)

            def remount(case: Case, _: Array, q: Array = q) -> Case:
                return case.with_robot(imu=case.robot.imu.model_copy(update={"orientation": q.tolist()}))

            shown = ", ".join(f"{v:.4f}" for v in q)
            yield Mistake(
                "imu_orientation", f"the IMU looks {_turn(matrix)}: imu.orientation = [{shown}] fits", remount
            )

        def acc(case: Case, _: Array, A: Array = matrix) -> Case:
            return case.each(lambda run: replace(run, acc=run.acc @ A.T))

        def gyro(case: Case, _: Array, A: Array = matrix) -> Case:
            return case.each(lambda run: replace(run, gyro=run.gyro @ A.T))

        yield Mistake("acc_axes", f"the accelerometer's axes look like {name}", acc, law="kinematics")
        yield Mistake("gyro_axes", f"the gyro's axes look like {name}", gyro, law="rotation")
    yield Mistake(
        "acc_unit",
        "the accelerometer looks like g instead of m/s2",
        lambda case, _: case.each(lambda run: replace(run, acc=units.G * run.acc)),
    )
    yield Mistake(
        "gyro_unit",
        "the gyro looks like deg/s instead of rad/s",
        lambda case, _: case.each(lambda run: replace(run, gyro=np.deg2rad(run.gyro))),
    )


def _reordered(R: Array, order: list[int], is_inverse: bool) -> Array:
    q = Rotation.from_matrix(R).as_quat(scalar_first=True)[:, order]
    meant = Rotation.from_quat(q, scalar_first=True)
    return np.asarray((meant.inv() if is_inverse else meant).as_matrix())


def _attitude(robot: Robot) -> Iterator[Mistake]:
    for words, order, is_inverse in (
        ("its order looks like x y z w", [3, 0, 1, 2], False),
        ("it looks inverse, world to IMU", [0, 1, 2, 3], True),
        ("its order looks like x y z w, and it looks inverse", [3, 0, 1, 2], True),
    ):

        def reorder(case: Case, _: Array, order: list[int] = order, is_inverse: bool = is_inverse) -> Case:
            return case.each(lambda run: replace(run, R=_reordered(run.R, order, is_inverse)))

        yield Mistake("quaternion", f"the attitude's quaternion: {words}", reorder)

    def delay(case: Case, x: Array) -> Case:
        return case.each(lambda run: replace(run, R=run.R @ Rotation.from_rotvec(x[0] * run.gyro).as_matrix()))

    yield Mistake(
        "attitude_yaw",
        "the attitude looks turned by {:.4f} rad about the vertical",
        lambda case, x: case.each(lambda run: replace(run, R=about_z(-x[0]) @ run.R)),
        (1e-3,),
        (0.0,),
        float(np.hypot(robot.std.attitude, robot.std.world_yaw)),
        np.pi,
    )
    words = "the attitude looks {:.4f} s late"
    yield Mistake("attitude_delay", words, delay, (1e-3,), (0.0,), robot.std.attitude_delay, 0.3)


def _tracker(robot: Robot) -> Iterator[Mistake]:
    for name, matrix in _signed_permutations():

        def rename(case: Case, _: Array, A: Array = matrix) -> Case:
            return case.each(lambda run: replace(run, position=run.position @ A.T))

        yield Mistake("tracker_axes", f"the tracker's axes look like {name}", rename, law="kinematics")
    yield Mistake(
        "tracker_yaw",
        "the tracker's world looks turned by {:.4f} rad about the vertical",
        lambda case, x: case.each(lambda run: replace(run, position=run.position @ about_z(-x[0]).T)),
        (1e-3,),
        (0.0,),
        robot.std.world_yaw,
        np.pi,
    )
    target = np.array(robot.tracker.target, float)

    def aim(case: Case, x: Array) -> Case:
        return case.with_robot(tracker=case.robot.tracker.model_copy(update={"target": (target + x).tolist()}))

    words = (
        f"the tracker looks at another point: target = [{{:.4g}}, {{:.4g}}, {{:.4g}}] m instead of {target.tolist()}"
    )
    yield Mistake("tracker_target", words, aim, (1e-3,) * 3, tuple(target), robot.std.tracker_target)
    yield Mistake(
        "tracker_origin",
        "the tracker's origin looks moved by {:.4g}, {:.4g}, {:.4g} m (world axes)",
        lambda case, x: case.each(lambda run: replace(run, position=run.position - x)),
        (1e-3,) * 3,
        (0.0,) * 3,
        robot.std.geometry,
    )
    yield Mistake(
        "tracker_delay",
        "the positions look {:.4f} s late",
        lambda case, x: case.each(lambda run: replace(run, position=earlier(run.t, run.position, x[0]))),
        (1e-3,),
        (0.0,),
        robot.std.position_delay,
        0.5,
    )


def table(robot: Robot) -> list[Mistake]:
    """Every mistake that is tried."""
    groups = [_forces, _geometry, _imu, _attitude]
    if robot.position.source != "fixed":
        groups.append(_tracker)
    return [mistake for make in groups for mistake in make(robot)]
