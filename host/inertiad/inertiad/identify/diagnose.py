# SPDX-License-Identifier: Apache-2.0
"""Mistakes of wiring, units and mounting, detected from the data, each named with its remedy.

Three kinds of detection. Signals alone: nothing moves, a cable is slack, a sensor saturates, gravity has the wrong
sign, positions are in mm. Trials: the same runs are fitted again as if two channels were exchanged or the IMU turned;
a trial whose residual falls to less than half, and below every other trial's, is the mistake. Trials are plain weighted
least squares and cost milliseconds each. Joint fit of body and sensor errors, for the pulley radius: sensor errors
would hide it, so it is one more unknown of that fit.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.finding import Finding, Severity
from inertiad.base.table import Array
from inertiad.identify.fit import WEAK_PRIOR
from inertiad.robot.configuration import platform_size, typical_mass
from inertiad.robot.description import Robot
from inertiad.run import reader
from inertiad.run.reader import Recording

ROWS_MAX: Final = 4_000
"""rows of a run that trials look at"""
FALLS_TO: Final = 0.5
"""of the residual as it is: a trial that beats this names the mistake"""
WORTH_A_TRIAL: Final = 0.01
"""residual, of the weight, below which nothing is looked for"""
STUCK_SHARE: Final = 0.03
STUCK_BAND: Final = 1e-4
"""of a channel's range: values this close to each other are one"""
NEAR_END: Final = 0.05
"""of a channel's range: where a saturated sensor's values pile up"""
MOVING: Final = 0.02
"""rad/s"""
SLACK_SHARE: Final = 0.01
SLACK: Final = 0.5
"""of tension_min"""
RADIUS_STEP: Final = 0.05
RADIUS_MAX: Final = 0.5
RADIUS_DIFFERS: Final = 0.01
"""m: less than this is not worth a word"""
RADIUS_SURE: Final = 25.0
"""fall of the cost, five sigma: what this radius explains and no sensor error can"""
FORCE_UNITS: Final = (("kN", 1e3), ("kg", 9.80665), ("lbf", 4.4482), ("daN", 10.0), ("mN", 1e-3))
RADIUS_FALLS_TO: Final = 0.8
"""of the residual: a radius that leaves more explains too little to be named"""
CORRECT: Final = "correct robot.toml or the wiring, then record or fit again"
LOOK_AT_SENSOR: Final = "check this sensor: mounting, cable, amplifier, range; then repeat the run"
TAUT: Final = "keep the motion where all cables pull: inertiactl excite keeps every tension inside its limits"
TURN_NAMES: Final = {0: "x", 1: "y", 2: "z"}


@dataclass(frozen=True)
class Trial:
    """A way in which the data may have been meant."""

    words: str
    config: Any
    rows: list[Any]


def _short(rows: Any) -> Any:
    """The first rows, enough for a trial."""
    n = min(len(rows), ROWS_MAX)
    return _rows(rows, n, rows.f[:n])


def _rows(rows: Any, n: int, f: Array, acc: Array | None = None, position: Array | None = None) -> Any:
    t_ns = np.rint(1e9 * rows.t[:n]).astype(np.int64)
    acc = rows.acc[:n] if acc is None else acc
    position = rows.position[:n] if position is None else position
    values = (acc, rows.gyro[:n], rows.q[:n], position, f)
    acc, gyro, q, position, f = (np.ascontiguousarray(a) for a in values)
    return inertiad_core.Rows(t_ns, acc, gyro, q, position, f, rows.derives_force, rows.derives_rate)


def residual(config: Any, size: float, rows: list[Any]) -> float:
    """N: root mean square of the windows' residual force, and moment over the platform's size [m], of a plain fit."""
    weight = np.repeat([1.0, 1.0 / size], 3)
    windows = [inertiad_core.Windows(config, r) for r in rows]
    found = [(w.Y * weight[:, None], w.y * weight) for w in windows if len(w.y)]
    if not found:
        return np.inf
    Y = np.concatenate([y.reshape(-1, 10) for y, _ in found])
    y = np.concatenate([y.ravel() for _, y in found])
    e = y - Y @ np.linalg.lstsq(Y, y, rcond=1e-9)[0]
    return float(np.sqrt(6.0 * np.mean(e**2)))


def _exchanges(robot: Robot, rows: list[Any]) -> Iterator[Trial]:
    config = reader.config_of(robot, robot.name)
    for i, j in combinations(range(robot.n_cables), 2):
        order = list(range(robot.n_cables))
        order[i], order[j] = j, i
        swapped = [_rows(r, len(r), r.f[:, order]) for r in rows]
        yield Trial(f"cables {i + 1} and {j + 1} look swapped: residual falls {{}} if exchanged", config, swapped)


def _right_angles() -> Iterator[tuple[str, Rotation]]:
    """Turns by right angles about one axis, by name."""
    for axis in range(3):
        for angle in (180, 90, -90):
            yield f"{angle} deg about {TURN_NAMES[axis]}", Rotation.from_rotvec(np.deg2rad(angle) * np.eye(3)[axis])


def _turns(robot: Robot, rows: list[Any]) -> Iterator[Trial]:
    mounted = Rotation.from_quat(robot.imu.orientation, scalar_first=True)
    for name, turn in _right_angles():
        q = (turn * mounted).as_quat(canonical=True, scalar_first=True).tolist()
        turned = robot.model_copy(update={"imu": robot.imu.model_copy(update={"orientation": q})})
        upside = " (mounted upside down)" if abs(turn.as_matrix()[2, 2] + 1.0) < 1e-9 else ""
        yield Trial(
            f"the IMU looks turned by {name} against robot.toml{upside}: residual falls {{}} with imu.orientation = "
            f"[{', '.join(f'{v:.4f}' for v in q)}]",
            reader.config_of(turned, robot.name),
            rows,
        )


@dataclass(frozen=True)
class Explained:
    """How well body and sensor errors together explain the runs with pulleys of one radius."""

    radius: float
    cost: float
    """chi squared of the windows and of the sensor errors' priors; inf: windows are lost"""
    rms: float
    """N: of the windows' residual force, and moment over the platform's size"""


def _with_radius(robot: Robot, radius: float) -> Robot:
    """The robot with pulleys of that radius [m], its attachments taken as they are."""
    cables = [c.model_copy(update={"pulley_radius": radius}) for c in robot.cable]
    std = robot.std.model_copy(update={"geometry": 0.0})
    return robot.model_copy(update={"cable": cables, "std": std})


def _explain(robot: Robot, rows: list[Any], radius: float) -> Explained:
    config = reader.config_of(_with_radius(robot, radius), robot.name)
    try:
        found = inertiad_core.batch(
            config, rows, [0] * len(rows), [0.0], theta_prior=WEAK_PRIOR, is_weight_learnt=False
        )
    except (ValueError, RuntimeError):  # nothing to solve, or no body
        return Explained(radius, np.inf, np.inf)
    if not found["converged"]:
        return Explained(radius, np.inf, np.inf)
    std, xi = np.array(inertiad_core.systematic_std(config)), np.array(found["xi"])
    known = std > 0.0
    cost = float(((xi[known] / std[known]) ** 2).sum())
    weight = np.repeat([1.0, 1.0 / platform_size(robot)], 3)
    n, square = 0, 0.0
    for fit in found["fit"]:
        n += fit["n_windows"]
        cost += fit["n_windows"] * float(((fit["rms"] / fit["noise_std"]) ** 2).sum())
        square += fit["n_windows"] * float(((fit["rms"] * weight) ** 2).sum())
    is_whole = n > 0 and all(fit["n_windows"] > 0 for fit in found["fit"])
    return Explained(radius, cost if is_whole else np.inf, float(np.sqrt(square / max(n, 1))))


def _vertex(tried: list[Explained]) -> float:
    """The radius where a parabola through the three best has its minimum, within what a pulley may have."""
    best = sorted(tried, key=lambda e: e.cost)[:3]
    square, slope, _ = np.polyfit([e.radius for e in best], [e.cost for e in best], 2)
    return float(np.clip(-0.5 * slope / square, 0.0, RADIUS_MAX)) if square > 0.0 else best[0].radius


def _radius(robot: Robot, recordings: list[Recording], rival: float) -> list[str]:
    """The pulleys' radius as one more unknown; the cost is nearly a parabola in it. rival: what the best other mistake
    leaves of the residual; the radius must leave less."""
    rows = [_short(run.rows) for run in recordings]
    given = float(np.mean([c.pulley_radius for c in robot.cable]))
    before = _explain(robot, rows, given)
    if not np.isfinite(before.cost):
        return []
    steps = (-1.0, 1.0) if given >= RADIUS_STEP else (1.0, 2.0)
    tried = [before, *(_explain(robot, rows, given + step * RADIUS_STEP) for step in steps)]
    for _ in range(2):
        if not all(np.isfinite(e.cost) for e in tried):
            return []
        radius = _vertex(tried)
        if min(abs(radius - e.radius) for e in tried) < 0.1 * RADIUS_DIFFERS:
            break
        tried.append(_explain(robot, rows, radius))
    best = min(tried, key=lambda e: e.cost)
    if before.cost - best.cost < RADIUS_SURE or abs(best.radius - given) < RADIUS_DIFFERS:
        return []
    if best.rms > min(RADIUS_FALLS_TO, rival) * before.rms:
        return []
    return [
        f"pulley_radius looks wrong: residual falls from {before.rms:.3g} N to {best.rms:.3g} N with pulley_radius = "
        f"{best.radius:.3f} m instead of {given:g} m"
    ]


def _trials(robot: Robot, recordings: list[Recording]) -> tuple[list[Finding], float]:
    """The trial that explains the data best, if one does, and the share of the residual that the best one leaves."""
    rows = [_short(run.rows) for run in recordings]
    size = platform_size(robot)
    before = residual(reader.config_of(robot, robot.name), size, rows)
    if not before > WORTH_A_TRIAL * _force_scale(rows):
        return [], 1.0
    tried = [
        (residual(trial.config, size, trial.rows), name, trial.words)
        for name, make in (("swapped_cables", _exchanges), ("imu_orientation", _turns))
        for trial in make(robot, rows)
    ]
    now, name, words = min(tried, key=lambda entry: entry[0])
    if now >= FALLS_TO * before:
        return [], min(now / before, 1.0)
    return _findings(name, [words.format(f"from {before:.3g} N to {now:.3g} N")]), now / before


def _force_scale(rows: list[Any]) -> float:
    """N: mean of the sum of all cable forces."""
    return float(np.mean([np.abs(r.f).sum(axis=1).mean() for r in rows]))


def _tracker_unit(robot: Robot, run: Recording) -> list[str]:
    span = max(float(np.abs([c.anchor for c in robot.cable]).max()), 1.0)
    far = float(np.median(np.abs(run.rows.position).max(axis=1)))
    if far < 10.0 * span:
        return []
    return [f"{run.path}: tracked positions are {far:.0f} m away, the anchors {span:.1f} m: is the tracker in mm?"]


def _gravity(robot: Robot, run: Recording) -> list[str]:
    """Mean specific force in W must be +g along z."""
    q = Rotation.from_quat(run.rows.q, scalar_first=True)
    s = q.apply(run.rows.acc).mean(axis=0)
    g = robot.gravity
    if np.linalg.norm(s - [0.0, 0.0, g]) < 0.3 * g:
        return []
    if np.linalg.norm(s - np.array([0.0, 0.0, -g])) < 0.3 * g:
        return [
            f"{run.path}: at rest the accelerometer reads {s[2]:.2f} m/s2 along z of the world, expected +{g:.2f}: "
            "gravity has the wrong sign, or the IMU gives acceleration the other way round"
        ]
    if abs(np.linalg.norm(s) - 1.0) < 0.3:
        return [f"{run.path}: the accelerometer's mean is {np.linalg.norm(s):.2f} m/s2: is it in g?"]
    if np.linalg.norm(s) < 0.3 * g:
        return [f"{run.path}: the accelerometer shows no gravity: it must give specific force, not acceleration"]
    return [
        f"{run.path}: mean specific force in the world is {s[0]:.2f}, {s[1]:.2f}, {s[2]:.2f} m/s2, not 0, 0, {g:.2f}: "
        "accelerometer and attitude do not belong together; look at axes and at the quaternion's order"
    ]


def _is_attitude_noisy(gyro: Array, turned: Array) -> bool:
    """An AHRS that follows acceleration turns too much: only the gyro over its rate falls below 1. [N, 3], rad/s."""
    common, square = float((gyro * turned).sum()), float((gyro * gyro).sum())
    return abs(common - square) < 0.3 * square and common**2 > 0.4 * square * float((turned * turned).sum())


def _gyro_unit(run: Recording) -> list[str]:
    rows = run.rows
    q = Rotation.from_quat(rows.q, scalar_first=True)
    step = max(1, round(0.1 / float(np.median(np.diff(rows.t))))) if len(rows) > 1 else 1
    if len(rows) < 4 * step:
        return []
    elapsed = rows.t[step:] - rows.t[:-step]
    turned = (q[:-step].inv() * q[step:]).as_rotvec() / elapsed[:, None]
    turned[elapsed > 1.5 * float(np.median(elapsed))] = 0.0  # across a gap, as between poses at rest
    moving = np.linalg.norm(turned, axis=1)
    if moving.max() < 0.05:
        return []
    middle = rows.gyro[step // 2 : step // 2 + len(turned)]
    slope = float((middle * turned).sum() / (turned * turned).sum())
    if abs(slope - 1.0) < 0.3 or _is_attitude_noisy(middle, turned):
        return []
    if abs(slope / np.rad2deg(1.0) - 1.0) < 0.3:
        return [f"{run.path}: the gyro is {slope:.1f} times the rate of the attitude: is it in deg/s?"]
    return [f"{run.path}: the gyro is {slope:.2f} times the rate of the attitude: check its axes, sign and unit"]


def _force_unit(robot: Robot, recordings: list[Recording]) -> list[str]:
    """The force along gravity against the nominal mass, else against the cables' limits."""
    lifted = []
    light = [c.model_copy(update={"weight_per_length": 0.0}) for c in robot.cable]  # its weight has a unit of its own
    config = reader.config_of(robot.model_copy(update={"cable": light}), robot.name)
    for run in recordings:
        windows = inertiad_core.Windows(config, run.rows)
        if len(windows.y):
            lifted.append(float(np.median(np.linalg.norm(windows.y[:, :3], axis=1))))
    if not lifted or robot.gravity <= 0.0 or min(lifted) <= 0.0:
        return []
    measured, expected = float(np.median(lifted)), typical_mass(robot) * robot.gravity
    if robot.nominal is None and measured > 1e-2 * expected:
        return []
    name, factor = min(FORCE_UNITS, key=lambda unit: abs(np.log(measured * unit[1] / expected)))
    if abs(np.log(measured / expected)) < np.log(3.0) or abs(np.log(measured * factor / expected)) > np.log(1.6):
        return []
    return [
        f"the cables lift {measured:.4g} N, {expected:.4g} N are expected: are the forces in {name}? "
        f"They would lift {measured * factor:.4g} N"
    ]


def _slack(robot: Robot, run: Recording) -> list[str]:
    f, found = run.rows.f, []
    for i, cable in enumerate(robot.cable):
        share = float((f[:, i] < SLACK * cable.tension_min).mean())
        if cable.tension_min > 0.0 and share > SLACK_SHARE:
            found.append(
                f"{run.path}: cable {i + 1} is slack for {100 * share:.0f} % of the time: "
                f"{f[:, i].min():.1f} N at least, tension_min is {cable.tension_min:g} N"
            )
    return found if len(found) < robot.n_cables else []


def _pile(x: Array) -> tuple[float, float]:
    """The value near either end of a channel's range where most samples are, and their share."""
    band = STUCK_BAND * float(x.max() - x.min())
    best = (0.0, 0.0)
    for end in (x.max(), x.min()):
        near = np.rint(x[np.abs(x - end) <= NEAR_END * float(x.max() - x.min())] / band)
        values, counts = np.unique(near, return_counts=True)
        share = float(counts.max()) / len(x)
        best = max(best, (share, float(band * values[counts.argmax()])))
    return best[1], best[0]


def _saturated(robot: Robot, run: Recording) -> list[str]:
    """A channel whose values pile up near the end of its own range while the platform moves, or that never changes.

    A slack cable's pile is its own.
    """
    rows, found = run.rows, []
    channels = [(f"force sensor {i + 1}", rows.f[:, i], c.tension_min) for i, c in enumerate(robot.cable)]
    channels += [(f"accelerometer {a}", rows.acc[:, i], 0.0) for i, a in enumerate("xyz")]
    channels += [(f"gyro {a}", rows.gyro[:, i], 0.0) for i, a in enumerate("xyz")]
    moving = np.linalg.norm(rows.gyro, axis=1) > MOVING
    for name, x, tension_min in channels:
        if moving.sum() <= 100:
            continue
        if x.max() == x.min():
            if name.startswith("force"):
                found.append(f"{run.path}: {name} is stuck at {x[0]:.6g}")
        elif x[moving].max() > x[moving].min():
            value, share = _pile(x[moving])
            if share > STUCK_SHARE and not 0.0 <= value < SLACK * tension_min:
                found.append(
                    f"{run.path}: {name} is saturated at {value:.6g} for {100 * share:.0f} % of the time it moves"
                )
    return found


def _excitation(recordings: list[Recording]) -> list[str]:
    q = [Rotation.from_quat(run.rows.q, scalar_first=True) for run in recordings]
    tilt = np.concatenate([r.inv().apply([0.0, 0.0, 1.0]) for r in q])
    spread = float(np.rad2deg(np.linalg.norm(tilt - tilt.mean(axis=0), axis=1).max()))
    rate = max(float(np.percentile(np.linalg.norm(run.rows.gyro, axis=1), 95)) for run in recordings)
    if rate > 0.02:
        return []
    if spread < 2.0:
        return [
            "one pose only: mass and the CoG across gravity are seen, nothing else; tilt the platform by 10 deg or more"
        ]
    return ["no excitation: the platform is at rest throughout, so the inertia cannot be seen; move it"]


def _findings(name: str, lines: list[str], severity: Severity = "stop", do: str = CORRECT) -> list[Finding]:
    return [Finding(name, severity, line, do) for line in lines]


def diagnose(robot: Robot, recordings: list[Recording]) -> list[Finding]:
    """Mistakes, the surest first. Empty where nothing looks wrong."""
    found: list[Finding] = []
    for run in recordings:
        found += _findings("tracker_unit", _tracker_unit(robot, run))
    if found:
        return found
    for run in recordings:
        found += _findings("specific_force", _gravity(robot, run)) + _findings("gyro", _gyro_unit(run))
    unit = _findings("force_unit", _force_unit(robot, recordings))
    for run in recordings:
        found += _findings("saturated_sensor", _saturated(robot, run), do=LOOK_AT_SENSOR)
        found += [] if unit else _findings("slack_cable", _slack(robot, run), "care", TAUT)
    found += unit
    is_clean = not found
    found += _findings("no_excitation", _excitation(recordings), "care", "inertiactl excite ROBOT -o excite.csv")
    if not unit:
        trials, share = _trials(robot, recordings)
        found += trials
        if is_clean and not found:
            found += _findings("pulley_radius", _radius(robot, recordings, share))
    return found
