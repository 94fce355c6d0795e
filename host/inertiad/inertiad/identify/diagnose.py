# SPDX-License-Identifier: Apache-2.0
"""Mistakes of wiring, units and mounting, detected from the data, each named with its remedy.

Signals alone show some: nothing moves, a cable is slack, a sensor saturates, gravity has the wrong sign, positions are
in mm. Where they show none, mistake_fit.py fits every mistake of its table to the runs.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base import units
from inertiad.base.finding import Finding, Severity
from inertiad.base.table import Array
from inertiad.identify import mistake_fit
from inertiad.identify.mistake_fit import CORRECT
from inertiad.robot.configuration import typical_mass
from inertiad.robot.description import Robot
from inertiad.run import reader
from inertiad.run.reader import Recording

STUCK_SHARE: Final = 0.03
STUCK_BAND: Final = 1e-4
"""of a channel's range: values this close to each other are one"""
NEAR_END: Final = 0.05
"""of a channel's range: where a saturated sensor's values pile up"""
PILED: Final = 5.0
"""times as often as the channel's typical value: a turning point of a coarse sensor makes three"""
ROUNDING: Final = 1e-9
"""of a channel's range: by so much two equal readings may differ after interpolation"""
MOVING: Final = 0.02
"""rad/s"""
SLACK_SHARE: Final = 0.01
SLACK: Final = 0.5
"""of tension_min"""
STILL: Final = "no_excitation"
"""a finding that is no mistake"""
FORCE_UNITS: Final = (("kN", 1e3), ("kg", units.G), ("lbf", 4.4482), ("daN", 10.0), ("mN", 1e-3))
LOOK_AT_SENSOR: Final = "check this sensor: mounting, cable, amplifier, range; then repeat the run"
TAUT: Final = "keep the motion where all cables pull: inertiactl excite keeps every tension inside its limits"


def _tracker_unit(robot: Robot, run: Recording) -> list[str]:
    span = max(float(np.abs([c.anchor for c in robot.cable]).max()), 1.0)
    far = float(np.median(np.abs(run.rows.position).max(axis=1)))
    if far < 10.0 * span:
        return []
    return [f"{run.path}: tracked positions are {far:.0f} m away, the anchors {span:.1f} m: is the tracker in mm?"]


def _mean_specific_force(run: Recording) -> Array:
    """In W, m/s2 [3]."""
    return np.asarray(Rotation.from_quat(run.rows.q, scalar_first=True).apply(run.rows.acc).mean(axis=0))


def _differs_from_gravity(s: Array, g: float) -> bool:
    return bool(np.linalg.norm(s - [0.0, 0.0, g]) >= 0.3 * g)


def _gravity(robot: Robot, run: Recording) -> list[str]:
    """Mean specific force in W must be +g along z: what is wrong where its size or sign tells."""
    s, g = _mean_specific_force(run), robot.gravity
    if not _differs_from_gravity(s, g):
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
    return []


def _unclear_gravity(robot: Robot, run: Recording) -> list[str]:
    s, g = _mean_specific_force(run), robot.gravity
    if not _differs_from_gravity(s, g):
        return []
    return [
        f"{run.path}: mean specific force in the world is {s[0]:.2f}, {s[1]:.2f}, {s[2]:.2f} m/s2, not 0, 0, {g:.2f}: "
        "accelerometer and attitude do not belong together; look at axes and at the quaternion's order"
    ]


def _is_attitude_noisy(gyro: Array, turned: Array) -> bool:
    """An AHRS that follows acceleration turns too much: only the gyro over its rate falls below 1. [N, 3], rad/s."""
    common, square = float((gyro * turned).sum()), float((gyro * gyro).sum())
    return abs(common - square) < 0.3 * square and common**2 > 0.4 * square * float((turned * turned).sum())


def _gyro_slope(run: Recording) -> float:
    """The gyro's rate over that of the attitude; 1 where that cannot be said."""
    rows = run.rows
    q = Rotation.from_quat(rows.q, scalar_first=True)
    step = max(1, round(0.1 / float(np.median(np.diff(rows.t))))) if len(rows) > 1 else 1
    if len(rows) < 4 * step:
        return 1.0
    elapsed = rows.t[step:] - rows.t[:-step]
    turned = (q[:-step].inv() * q[step:]).as_rotvec() / elapsed[:, None]
    turned[elapsed > 1.5 * float(np.median(elapsed))] = 0.0  # across a gap, as between poses at rest
    moving = np.linalg.norm(turned, axis=1)
    if moving.max() < 0.05:
        return 1.0
    middle = rows.gyro[step // 2 : step // 2 + len(turned)]
    slope = float((middle * turned).sum() / (turned * turned).sum())
    return 1.0 if abs(slope - 1.0) < 0.3 or _is_attitude_noisy(middle, turned) else slope


def _gyro_unit(run: Recording) -> list[str]:
    slope = _gyro_slope(run)
    if abs(slope / np.rad2deg(1.0) - 1.0) >= 0.3:
        return []
    return [f"{run.path}: the gyro is {slope:.1f} times the rate of the attitude: is it in deg/s?"]


def _unclear_gyro(run: Recording) -> list[str]:
    slope = _gyro_slope(run)
    if slope == 1.0:
        return []
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


def _failed(run: Recording, but: list[str]) -> list[str]:
    """Force sensors without which the fit goes on, and of which nothing else is said."""
    rows, has_failed, found = run.rows, run.rows.has_failed, []
    for i in np.flatnonzero(has_failed.any(axis=0)):
        if any(f"force sensor {i + 1} is" in said or f"cable {i + 1} is" in said for said in but):
            continue
        at = rows.t[has_failed[:, i]] - rows.t[0]
        found.append(
            f"{run.path}: force sensor {i + 1} has failed for {100.0 * len(at) / len(rows):.0f} % of the time, "
            f"first at {at[0]:.1f} s: the fit does without it there"
        )
    return found


def _slack(robot: Robot, run: Recording) -> list[str]:
    """Cables that do not pull. A failed sensor that reads nothing shows none."""
    f, has_failed, found = run.rows.f, run.rows.has_failed, []
    for i, cable in enumerate(robot.cable):
        is_slack = f[:, i] < SLACK * cable.tension_min
        is_measured = is_slack & ~has_failed[:, i]
        if cable.tension_min > 0.0 and is_measured.mean() > max(SLACK_SHARE, 0.5 * is_slack.mean()):
            found.append(
                f"{run.path}: cable {i + 1} is slack for {100 * is_slack.mean():.0f} % of the time: "
                f"{f[:, i].min():.1f} N at least, tension_min is {cable.tension_min:g} N"
            )
    return found if len(found) < robot.n_cables else []


def _piles(x: Array, moving: NDArray[np.bool_]) -> Iterator[tuple[float, float, bool]]:
    """Value, share of the samples, and whether it is the lower end: piles near the ends of a channel's range.

    At the end of its range a sensor gives one value, sample after sample. A tension that a controller holds at its
    limit has noise. A coarse sensor gives each of its values that often.
    """
    bend = np.abs(np.diff(x, 2, prepend=x[:1], append=x[-1:]))[moving]
    x = x[moving]
    band = STUCK_BAND * float(x.max() - x.min())
    often = float(np.median(np.unique(np.rint(x / band), return_counts=True)[1])) / len(x)
    for end, is_low in ((x.max(), False), (x.min(), True)):
        is_near = np.abs(x - end) <= NEAR_END * float(x.max() - x.min())
        values, counts = np.unique(np.rint(x[is_near] / band), return_counts=True)
        value = float(band * values[counts.argmax()])
        pile = np.abs(x - value) <= band
        if pile.mean() > PILED * often and np.median(bend[pile]) < ROUNDING * float(x.max() - x.min()):
            yield value, float(pile.mean()), is_low


def _saturated(robot: Robot, run: Recording) -> list[str]:
    """A channel whose values pile up at the end of its own range while the platform moves, or that never changes.

    A slack cable's pile is its own, and one at the lower end of a cable that has a least tension is the controller's.
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
            found += [
                f"{run.path}: {name} is saturated at {value:.6g} for {100 * share:.0f} % of the time it moves"
                for value, share, is_low in _piles(x, moving)
                if share > STUCK_SHARE and not (is_low and tension_min > 0.0 <= value)
            ]
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


def of_signals(robot: Robot, recordings: list[Recording]) -> list[Finding]:
    """Mistakes that signals alone show, the surest first."""
    found: list[Finding] = []
    for run in recordings:
        found += _findings("tracker_unit", _tracker_unit(robot, run))
    if found:
        return found
    for run in recordings:
        found += _findings("specific_force", _gravity(robot, run)) + _findings("gyro", _gyro_unit(run))
    unit = _findings("force_unit", _force_unit(robot, recordings))
    for run in recordings:
        saturated, slack = _saturated(robot, run), [] if unit else _slack(robot, run)
        found += _findings("saturated_sensor", saturated, do=LOOK_AT_SENSOR)
        found += _findings("slack_cable", slack, "care", TAUT)
        found += _findings("broken_force_sensor", _failed(run, saturated + slack), "care", LOOK_AT_SENSOR)
    still = _findings(STILL, _excitation(recordings), "care", "inertiactl excite ROBOT -o excite.csv")
    return found + unit + still


def unclear(robot: Robot, recordings: list[Recording]) -> list[Finding]:
    """What looks wrong with the IMU, of several possible causes."""
    found: list[Finding] = []
    for run in recordings:
        found += _findings("specific_force", _unclear_gravity(robot, run))
        found += _findings("gyro", _unclear_gyro(run))
    return found


def are_mistakes(found: list[Finding]) -> bool:
    """Is one of them more than a platform at rest?"""
    return any(finding.name != STILL for finding in found)


def diagnose(robot: Robot, recordings: list[Recording]) -> list[Finding]:
    """Mistakes, the surest first. Empty where nothing looks wrong."""
    found = of_signals(robot, recordings)
    if are_mistakes(found):
        return found
    explained = [] if found else mistake_fit.find(robot, recordings)
    return (explained or unclear(robot, recordings)) + found
