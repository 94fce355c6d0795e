# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics: winches under a controller, elastic cables that swing and sag, a free platform.

The equations are those of host/eigen/include/inertiad/plant.hpp. The controller believes robot.toml and its [nominal]
body; the plant has the true geometry and body. Six cables and more are given tensions: computed torque with an
integral, distributed within the limits. Fewer leave the platform free to swing: they follow the lengths that the
trajectory's poses would have.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.base.text_files import read_toml
from inertiad.model.inverse_dynamics import Mechanics, below_hint, even_pull, required_wrench
from inertiad.model.payload import Payload
from inertiad.model.trajectory import Motion, Trajectory
from inertiad.robot import configuration
from inertiad.robot.description import Robot
from inertiad.robot.messages import Strict, nearest, validate
from inertiad.robot.value_types import Range

STEP_MAX = 1e-3
"""s, the longest step of integration"""


class Plant(Strict):
    """Cables, winches and controller of a simulated robot. A plant file is TOML with these keys."""

    stiffness: Annotated[float, Range(0, 1e10, "N")] = 0.0
    """N, EA of a cable: force per strain; 0: rigid"""
    damping_time: Annotated[float, Range(0, 0.1, "s")] = 1e-3
    """s, of the cable's material: force by strain rate over force by strain"""
    swings: bool = True
    """cables with weight oscillate across their line, driven by the platform"""
    swing_damping: Annotated[float, Range(0, 1)] = 0.01
    """1, damping ratio of a cable's lateral oscillation"""
    winch_hz: Annotated[float, Range(0.1, 100, "Hz")] = 20.0
    """Hz, bandwidth of a winch that follows its commanded tension"""
    control_hz: Annotated[float, Range(0.05, 20, "Hz")] = 1.5
    """Hz, bandwidth of the controller of the pose"""
    control_rate: Annotated[float, Range(10, 1e4, "Hz")] = 1000.0
    """Hz of commands to the winches"""


STIFF: Final = 200.0
"""EA over tension_max of the preset elastic: half a percent of strain at the greatest tension"""

PRESETS: Final = ("exact", "rigid", "elastic")
"""exact: the platform is where the trajectory says. rigid: winches make tensions. elastic: cables stretch as well."""


def plant(name: str, robot: Robot) -> Plant | None:
    """A preset by name, or a plant file by path; None: the trajectory is exact. InputError: neither."""
    if name == "exact":
        return None
    if name == "rigid":
        return Plant()
    if name == "elastic":
        return Plant(stiffness=min(STIFF * max(cable.tension_max for cable in robot.cable), 1e10))
    if not name.endswith(".toml"):
        hint = nearest(name, PRESETS)
        raise InputError(f'--plant "{name}": allowed: {", ".join(PRESETS)}, or a .toml file{hint}')
    return validate(Plant, read_toml(Path(name)), name)


@dataclass(frozen=True)
class Moved:
    """A motion that was integrated, at every step; a Trajectory that knows its tensions."""

    step: float
    """s between rows"""
    duration: float
    """s"""
    motion: Motion
    """[N] rows"""
    f: Array
    """true tensions [N, m], N"""
    n_infeasible: int
    """commands that no tensions within the limits could have met"""
    first_infeasible: float
    """s, the first of them; inf: none"""
    strays: float
    """m, the farthest that P was from the trajectory"""

    def at(self, t: Array) -> Motion:
        m, last = self.motion, len(self.motion.p) - 1
        k = np.clip(np.floor(t / self.step + 1e-6).astype(int), 0, last)
        u = np.clip(t - k * self.step, 0.0, self.step)[:, None]
        u = np.where(k[:, None] == last, 0.0, u)
        after = np.minimum(k + 1, last)
        jerk, twist = ((x[after] - x[k]) / self.step for x in (m.a, m.alpha))
        turn = (m.omega[k] + (m.alpha[k] / 2.0 + twist * u / 6.0) * u) * u
        return Motion(
            m.p[k] + (m.v[k] + (m.a[k] / 2.0 + jerk * u / 6.0) * u) * u,
            m.v[k] + (m.a[k] + jerk * u / 2.0) * u,
            m.a[k] + jerk * u,
            m.R[k] @ Rotation.from_rotvec(turn).as_matrix(),
            m.omega[k] + (m.alpha[k] + twist * u / 2.0) * u,
            m.alpha[k] + twist * u,
        )

    def tensions(self, t: Array) -> Array:
        """True tensions [N, m] at times t [N], N."""
        grid = self.step * np.arange(len(self.f))
        return np.asarray(CubicSpline(grid, self.f)(np.clip(t, 0.0, grid[-1])))


def _fastest(mechanics: Mechanics, motion: Motion, stiffness: float) -> float:
    """rad/s, the platform's fastest oscillation on its cables at the first instant of a motion."""
    W, _ = inertiad_core.wrench_matrix(mechanics.config, motion.p[:1], motion.R[:1], np.zeros(3))
    length = inertiad_core.cable_geometry(mechanics.config, motion.p[:1], motion.R[:1])[2]
    theta = configuration.theta_of(mechanics.body)
    unit = np.eye(3)
    none = np.zeros((1, 3))
    columns = [inertiad_core.regressor(s[None], none, none)[0] @ theta for s in unit]
    columns += [inertiad_core.regressor(none, none, alpha[None])[0] @ theta for alpha in unit]
    K = (W[0] * (stiffness / length[0])) @ W[0].T
    return float(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(np.column_stack(columns), K))).max()))


def step_of(mechanics: Mechanics, motion: Motion, plant: Plant, rate: float) -> float:
    """s: a whole part of the sample period, short enough for the fastest oscillation."""
    longest = STEP_MAX
    if plant.stiffness > 0.0:
        longest = min(longest, 0.5 / _fastest(mechanics, motion, plant.stiffness))
    return 1.0 / (rate * np.ceil(1.0 / (rate * longest) - 1e-9))


def unstrained(config: Any, robot: Robot, motion: Motion, f: Array, stiffness: float) -> Array:
    """Lengths [N, m] that cables with tensions f [N, m] would have without them, m."""
    u, free, length = inertiad_core.cable_geometry(config, motion.p, motion.R)
    weight = np.array([cable.weight_per_length for cable in robot.cable]) * np.hypot(u[:, :, 0], u[:, :, 1])
    l_0: Array = (length + (weight / f) ** 2 * free**3 / 24.0) / (1.0 + f / stiffness)
    return l_0


def _motion_at_rest(pose: Array) -> Motion:
    """p [3] m and a rotation vector [3], without any motion."""
    none = np.zeros((1, 3))
    R = Rotation.from_rotvec(pose[None, 3:]).as_matrix()
    return Motion(pose[None, :3], none, none, R, none, none)


def hang(mechanics: Mechanics, lengths: Array, guess: Motion, stiffness: float) -> tuple[Motion, Array]:
    """The rest (motion of one row, tensions [m]) of the true robot on cables of unstrained lengths [m].

    guess: a pose near it, one row. InputError: no such rest with every cable taut.
    """
    robot, config = mechanics.robot, mechanics.config

    def residual(x: Array) -> Array:
        motion, f = _motion_at_rest(x[:6]), x[6:]
        W, sag = inertiad_core.wrench_matrix(config, motion.p, motion.R, np.zeros(3))
        missing = W[0] @ f + sag[0] - required_wrench(motion, mechanics.body, robot.gravity)[0]
        gap = unstrained(config, robot, motion, f[None], stiffness)[0] - lengths
        return np.concatenate([missing, stiffness * gap])

    W, sag = inertiad_core.wrench_matrix(config, guess.p, guess.R, np.zeros(3))
    f = np.linalg.pinv(W[0]) @ (required_wrench(guess, mechanics.body, robot.gravity)[0] - sag[0])
    rotvec = Rotation.from_matrix(guess.R).as_rotvec()[0]
    try:
        found = root(residual, np.concatenate([guess.p[0], rotvec, f]), tol=1e-12)
    except ValueError as error:
        raise InputError(f"trajectory: start: {error}") from None
    size = mechanics.body.mass * robot.gravity
    if np.abs(residual(found.x)).max() > 1e-6 * size or found.x[6:].min() <= 0.0:
        raise InputError(f"trajectory: start: {robot.n_cables} cables of these lengths do not all hold it at rest")
    return _motion_at_rest(found.x[:6]), np.asarray(found.x[6:])


def control_instants(trajectory: Trajectory, step: float, per_control: int) -> Array:
    """s [K] from the start of the motion to its end."""
    period = step * per_control
    return period * np.arange(np.ceil(trajectory.duration / period - 1e-9) + 1.0)


def lengths_at_rest(believed: Mechanics, motion: Motion, plant: Plant) -> Array:
    """Unstrained lengths [K, m] that the poses of a motion would have at rest."""
    robot = believed.robot
    still = np.zeros_like(motion.p)
    rest = Motion(motion.p, still, still, motion.R, still, still)
    W, sag = inertiad_core.wrench_matrix(believed.config, motion.p, motion.R, np.zeros(3))
    f = even_pull(W, required_wrench(rest, believed.body, robot.gravity) - sag, np.zeros(robot.n_cables))
    floor = 1e-3 * believed.body.mass * robot.gravity
    return unstrained(believed.config, robot, motion, np.maximum(f, floor), plant.stiffness)


def believed_by_controller(robot: Robot, source: str, mechanics: Mechanics) -> Mechanics:
    """robot.toml as it is, with its [nominal] body; the true body where it has none."""
    config = inertiad_core.Config(configuration.compile_robot(robot, source))
    return Mechanics(config, robot, robot.nominal or mechanics.body)


def payload_rows(payloads: tuple[Payload, ...]) -> Array:
    """t, ramp and change of theta of each [J, 12]."""
    return np.array([[p.time, p.ramp, *p.theta] for p in payloads]).reshape(-1, 12)


def move(mechanics: Mechanics, believed: Mechanics, trajectory: Trajectory, plant: Plant, rate: float) -> Moved:
    """Forward dynamics of the robot under its controller along a trajectory, for samples at rate [Hz].

    InputError: it cannot start, a cable loses its direction, the motion is unstable.
    """
    n_cables, holds_length = mechanics.robot.n_cables, mechanics.robot.n_cables < 6
    if holds_length and plant.stiffness == 0.0:
        raise InputError(
            f"--plant: {n_cables} cables leave the platform free to swing, rigid ones would have to follow it: "
            "allowed: elastic, or a file with a stiffness"
        )
    step = step_of(mechanics, trajectory.at(np.zeros(1)), plant, rate)
    per_control = max(1, round(1.0 / (plant.control_rate * step)))
    t = control_instants(trajectory, step, per_control)
    wanted = trajectory.at(t)
    lengths, first = np.zeros((0, n_cables)), wanted
    if holds_length:
        lengths = lengths_at_rest(believed, wanted, plant)
        rest, _ = hang(mechanics, lengths[0], trajectory.at(np.zeros(1)), plant.stiffness)
        first = Motion(*(np.concatenate([getattr(rest, n), getattr(wanted, n)[1:]]) for n in Motion.__annotations__))
    swing = mechanics.swing
    tilt = np.zeros((2, n_cables)) if swing is None else swing.amplitude * np.sin(swing.phase.T)
    found = inertiad_core.forward(
        mechanics.config,
        believed.config,
        configuration.theta_of(mechanics.body),
        configuration.theta_of(believed.body),
        payload_rows(mechanics.payloads),
        first.p,
        first.v,
        first.a,
        np.ascontiguousarray(first.R),
        first.omega,
        first.alpha,
        lengths,
        np.ascontiguousarray(tilt),
        step=step,
        steps_per_control=per_control,
        EA=plant.stiffness,
        damping_time=plant.damping_time,
        winch_rate=2.0 * np.pi * plant.winch_hz,
        control_rate=2.0 * np.pi * plant.control_hz,
        swing_damping=plant.swing_damping,
        swings=plant.swings,
        holds_length=holds_length,
    )
    if found["stopped"]:
        raise InputError(f"trajectory: {found['stopped']}{below_hint(mechanics.robot, float(first.p[0, 2]))}")
    motion = Motion(*(found[name] for name in Motion.__annotations__))
    at = found["first_infeasible"]
    strays = np.linalg.norm(motion.p[::per_control] - wanted.p, axis=1).max()
    return Moved(
        step,
        trajectory.duration,
        motion,
        found["f"],
        found["n_infeasible"],
        float(t[at]) if at >= 0 else float("inf"),
        float(strays),
    )


def summary(moved: Moved, robot: Robot) -> list[str]:
    """Summary of a motion: deviation from the trajectory, tensions, and where they reach their limits."""
    tensions = f"tensions {moved.f.min():.0f} to {moved.f.max():.0f} N"
    lines = [f"P at most {1e3 * moved.strays:.1f} mm off the trajectory, {tensions}"]
    low = np.array([cable.tension_min for cable in robot.cable])
    high = np.array([cable.tension_max for cable in robot.cable])
    beyond = np.argwhere((moved.f < low) | (moved.f > high))
    if len(beyond):
        k, i = beyond[0]
        lines.append(
            f"cable {i + 1} = {moved.f[k, i]:.0f} N at t = {k * moved.step:.2f} s: "
            f"its limits are {low[i]:g} to {high[i]:g} N"
        )
    if moved.n_infeasible:
        lines.append(
            f"from t = {moved.first_infeasible:.2f} s on, {moved.n_infeasible} commands had no tensions within the "
            "limits and were cut off there"
        )
    return lines
