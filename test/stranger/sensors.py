# SPDX-License-Identifier: Apache-2.0
"""Sensors as laboratories have them: what they read of a true course of events, with every error of its kind.

Errors that robot.toml declares are drawn with the declared sigma. Beside them stand the faults of a scene, each with a
size; a size of 0 leaves the fault out.
"""

from dataclasses import dataclass, field
from typing import Any

import native
import numpy as np
from mechanics import UP, Track
from robots import G, Robot
from scipy import signal
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Faults:
    """What is wrong beyond the declared errors. SI units."""

    perfect: bool = False
    """no error at all, declared ones included, and next to no noise"""
    without: tuple[str, ...] = ()
    """names of declared errors that are not there although declared"""
    ahrs: str = ""
    """mahony, madgwick, kalman: a real filter instead of an attitude with declared errors"""
    ahrs_tilt: float = 0.0
    """rad rms that its gain is chosen for"""
    yaw_wander: float = 0.0
    attitude_delay: float = 0.0
    position_delay: float = 0.0
    force_delay: float = 0.0
    lowpass: str = ""
    """bessel or butterworth, before the force sensors' converters"""
    lowpass_hz: float = 10.0
    imu_off: float = 0.0
    """m: IMU position, in a random direction"""
    target_off: float = 0.0
    geometry_off: float = 0.0
    """m, one sigma of every coordinate of anchors and attachments"""
    common_gain: float = 0.0
    acc_scale: float = 0.0
    gyro_scale: float = 0.0
    friction: float = 0.0
    """share of the tension that the pulley of a mean wrap takes"""
    force_at: str = ""
    """where the cells really sit; default: as robot.toml says"""
    hysteresis: float = 0.0
    """share of the median tension"""
    offset_drift: float = 0.0
    """N / s, each cable with its own sign"""
    quantum: float = 0.0
    force_spikes: int = 0
    tracker_spikes: int = 0
    tracker_gaps: int = 0
    broken: str = ""
    """frozen, saturated or dead: cable 2 from 30 % of the run on"""
    hose: float = 0.0
    """N: constant pull of a hose, with a spring of a fifth of it per metre"""
    pushes: float = 0.0
    """N: somebody leans on the platform six times for a second or two"""
    payload: float = 0.0
    """share of the mass that is taken up in the middle"""
    cable_weight: float | None = None
    """N/m: the true one"""
    cable_inertia: bool = False
    """lumped-mass cables: the elastic plant moves the platform"""
    slack: float = 0.0
    """m: a winch pays out so much too much for some seconds"""


@dataclass(frozen=True)
class Course:
    """What truly happens, on a fine grid of time."""

    track: Track
    tension: np.ndarray
    """N [N, m] at the platform's end"""
    tension_top: np.ndarray
    """N [N, m] where the cable leaves the pulley"""
    wrap: np.ndarray
    length: np.ndarray
    """m [N, m], arc on the pulley included"""
    events: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Readings:
    """Columns of signals.csv and tracker.csv, and what was drawn for them."""

    signals: dict[str, np.ndarray]
    tracker: dict[str, np.ndarray]
    drawn: dict[str, Any]


class Draws:
    """Random errors with the declared sigmas; all zero in a perfect laboratory."""

    def __init__(self, robot: Robot, faults: Faults, seed: int):
        self.dice = np.random.default_rng([seed, 77, *robot.name.encode()])
        self.aside = np.random.default_rng([seed, 78, *robot.name.encode()])
        """for spikes and gaps: all else stays what it is without them"""
        self.std = {k: 0.0 if faults.perfect or k in faults.without else v for k, v in robot.std.items()}
        self.noise = 1e-3 if faults.perfect else 1.0
        self.drawn: dict[str, Any] = {}

    def normal(self, key: str, *shape: int) -> np.ndarray:
        """Errors of one kind, kept for truth.json."""
        value = self.std[key] * self.dice.standard_normal(shape)
        self.drawn[key] = value.tolist()
        return value

    def direction(self) -> np.ndarray:
        v = self.dice.standard_normal(3)
        return v / np.linalg.norm(v)

    def white(self, sigma: float, *shape: int) -> np.ndarray:
        return self.noise * sigma * self.dice.standard_normal(shape)

    def slow(self, sigma: float, t: np.ndarray, shape: int, time: float = 8.0) -> np.ndarray:
        """First-order Gauss-Markov noise [N, shape] with a correlation time [s]."""
        if sigma == 0.0:
            return np.zeros((len(t), shape))
        keep = np.exp(-np.diff(t).mean() / time)
        steps = sigma * np.sqrt(1.0 - keep**2) * self.dice.standard_normal((len(t), shape))
        steps[0] = sigma * self.dice.standard_normal(shape)
        return signal.lfilter([1.0], [1.0, -keep], steps, axis=0)


def true_geometry(robot: Robot, faults: Faults, draws: Draws) -> tuple[np.ndarray, np.ndarray]:
    """Anchors and attachments as they are, not as robot.toml has them."""
    size = float(np.hypot(draws.std["geometry"], faults.geometry_off))
    off = size * draws.dice.standard_normal((2, robot.n_cables, 3))
    draws.drawn["geometry"] = off.tolist()
    return robot.anchor + off[0], robot.attachment + off[1]


def _at(t: np.ndarray, x: np.ndarray, when: np.ndarray) -> np.ndarray:
    """x over t, at other instants."""
    return make_interp_spline(t, x, k=3)(np.clip(when, t[0], t[-1]))


def _quaternions(R: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(R).as_quat(canonical=False, scalar_first=True)


def _rotations(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def _tilt_error(q: np.ndarray, R: np.ndarray) -> float:
    """rms angle [rad] between the true vertical and that of an attitude."""
    up = _rotations(q).inv().apply(UP)
    true = R[:, 2, :]
    return float(np.sqrt(np.mean(np.sum(np.cross(up, true) ** 2, axis=1))))


def _ahrs(faults: Faults, dt: float, acc: np.ndarray, gyro: np.ndarray, R: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """A real filter with the gain whose tilt error comes nearest the size asked for."""
    q0 = _quaternions(R[:1])[0]

    def run(gain: float) -> np.ndarray:
        return native.attitude_filter(faults.ahrs, dt, gain, G, acc, gyro, yaw, q0)

    gains = np.geomspace(*{"mahony": (0.01, 10.0), "madgwick": (1e-3, 2.0), "kalman": (2.0, 1e-3)}[faults.ahrs], 15)
    runs = [run(gain) for gain in gains]
    error = np.array([_tilt_error(q, R) for q in runs])
    return runs[int(np.argmin(np.abs(np.log(error / faults.ahrs_tilt))))]


def _imu(robot: Robot, faults: Faults, draws: Draws, track: Track) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Specific force and rate [N, 3] in the IMU's axes, and its true mounting."""
    place = np.array(robot.imu_position) + draws.normal("imu_position", 3) + faults.imu_off * draws.direction()
    mount = Rotation.from_rotvec(draws.normal("imu_alignment", 3)) * _rotations(np.array(robot.imu_orientation))
    _, _, acceleration = track.point(place)
    force = np.einsum("nji,nj->ni", track.R, acceleration + G * UP)
    n = len(track.t)
    acc = mount.inv().apply(force) * (1.0 + faults.acc_scale * draws.dice.choice([-1.0, 1.0], 3))
    gyro = mount.inv().apply(track.omega) * (1.0 + faults.gyro_scale * draws.dice.choice([-1.0, 1.0], 3))
    acc = acc + draws.normal("acc_bias", 3) + draws.white(robot.acc_noise, n, 3)
    gyro = gyro + draws.normal("gyro_bias", 3) + draws.white(robot.gyro_noise, n, 3)
    return acc, gyro, mount


def _attitude(
    faults: Faults, draws: Draws, track: Track, mount: Rotation, acc: np.ndarray, gyro: np.ndarray
) -> np.ndarray:
    """Quaternions [N, 4] of the IMU in the AHRS's world."""
    world = Rotation.from_rotvec(UP * draws.normal("world_yaw", 1))
    true = (Rotation.from_matrix(track.R) * mount).as_matrix()
    wander = draws.slow(draws.std["attitude_wander"], track.t, 3)
    bias = draws.normal("attitude", 3)
    if faults.ahrs:
        yaw = np.unwrap(np.arctan2(true[:, 1, 0], true[:, 0, 0])) + wander[:, 2]
        yaw += draws.slow(faults.yaw_wander, track.t, 1, 30.0)[:, 0] + draws.white(0.01, len(track.t))
        q = _ahrs(faults, float(np.diff(track.t).mean()), acc, gyro, true, yaw)
        draws.drawn["ahrs_tilt_rms"] = _tilt_error(q, true)
    else:
        q = (Rotation.from_matrix(true) * Rotation.from_rotvec(bias + wander)).as_quat(scalar_first=True)
    q = (world * _rotations(q)).as_quat(scalar_first=True)
    q *= np.where(np.cumsum(np.r_[0.0, np.sum(q[1:] * q[:-1], axis=1) < 0.0]) % 2 > 0, -1.0, 1.0)[:, None]
    if faults.attitude_delay:
        q = _at(track.t, q, track.t - faults.attitude_delay)
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def _at_the_cells(robot: Robot, faults: Faults, course: Course) -> np.ndarray:
    """Tension [N, m] that loads the cells: the platform's end, or behind the pulley with its friction."""
    if (faults.force_at or robot.force_at) == "platform":
        return course.tension
    dt, reach = float(np.diff(course.track.t).mean()), max(0.05 * robot.pulley_radius, 5e-4)
    z = np.column_stack([native.friction_state(s, dt, reach) for s in course.length.T])
    return course.tension_top * np.exp(-faults.friction * course.wrap / course.wrap.mean() * z)


def _broken(f: np.ndarray, kind: str) -> None:
    """Cable 2 fails for good after 30 % of the run."""
    first = int(0.3 * len(f))
    if kind == "frozen":
        f[first:, 1] = f[first, 1]
    elif kind == "saturated":
        f[:, 1] = np.minimum(f[:, 1], np.quantile(f[:first, 1], 0.6))
    elif kind == "dead":
        f[first:, 1] = 0.0


def _forces(robot: Robot, faults: Faults, draws: Draws, course: Course, when: np.ndarray) -> np.ndarray:
    """Readings [N, m] of the cells at the instants when."""
    t, f = course.track.t, _at_the_cells(robot, faults, course)
    if faults.lowpass:
        make = {"bessel": lambda *a, **k: signal.bessel(*a, norm="mag", **k), "butterworth": signal.butter}
        sos = make[faults.lowpass](4, faults.lowpass_hz, fs=1.0 / np.diff(t).mean(), output="sos")
        f = signal.sosfilt(sos, f - f[0], axis=0) + f[0]
    f = _at(t, f, when - faults.force_delay - float(draws.normal("force_delay", 1)[0]))
    middle = np.median(f, axis=0)
    if faults.hysteresis:
        spread = 0.1 * middle.mean()
        f = f + faults.hysteresis * middle * np.column_stack([native.bouc_wen(x, spread) for x in f.T])
    m, n = robot.n_cables, len(when)
    f = f * (1.0 + draws.normal("force_gain", m) + faults.common_gain) + draws.normal("force_offset", m)
    f += faults.offset_drift * when[:, None] * draws.dice.choice([-1.0, 1.0], m)
    f += draws.white(robot.force_noise, n, m)
    if faults.quantum:
        f = faults.quantum * np.rint(f / faults.quantum)
    if faults.force_spikes:
        where = draws.aside.choice(np.arange(n // 10, n - n // 20), faults.force_spikes, replace=False)
        size = middle.mean() * draws.aside.uniform(2.0, 6.0, len(where))
        f[where, draws.aside.integers(0, m, len(where))] += size
    _broken(f, faults.broken)
    return f


def _tracker(robot: Robot, faults: Faults, draws: Draws, track: Track) -> dict[str, np.ndarray]:
    """Positions of the target, late."""
    target = np.array(robot.target) + faults.target_off * draws.direction()
    place, _, _ = track.point(target)
    t = np.arange(0.0, track.t[-1] - 0.02, 1.0 / robot.tracker_rate)
    late = faults.position_delay + float(draws.normal("position_delay", 1)[0])
    x = _at(track.t, place, t - late) + draws.white(robot.tracker_noise, len(t), 3)
    if faults.tracker_spikes:
        where = draws.aside.choice(np.arange(len(t) // 10, len(t)), faults.tracker_spikes, replace=False)
        away = draws.aside.standard_normal((len(where), 3))
        x[where] += 8.0 * away / np.linalg.norm(away, axis=1, keepdims=True)
    keep = np.ones(len(t), dtype=bool)
    for _ in range(faults.tracker_gaps):
        first = draws.aside.uniform(0.2, 0.9) * t[-1]
        keep &= (t < first) | (t > first + draws.aside.uniform(0.1, 1.5))
    return {"t": t[keep], "x": x[keep, 0], "y": x[keep, 1], "z": x[keep, 2]}


def read(robot: Robot, faults: Faults, draws: Draws, course: Course) -> Readings:
    """What the laboratory records of a course of events."""
    step = max(round(1.0 / (robot.rate * np.diff(course.track.t).mean())), 1)
    fine = course.track
    track = Track(*(x[::step] for x in (fine.t, fine.p, fine.R, fine.v, fine.a, fine.dR, fine.ddR)))
    acc, gyro, mount = _imu(robot, faults, draws, track)
    q = _attitude(faults, draws, track, mount, acc, gyro)
    f = _forces(robot, faults, draws, course, track.t)
    columns = {"t": track.t}
    columns |= {f"acc_{a}": x for a, x in zip("xyz", acc.T, strict=True)}
    columns |= {f"gyro_{a}": x for a, x in zip("xyz", gyro.T, strict=True)}
    columns |= {f"q_{a}": x for a, x in zip("wxyz", q.T, strict=True)}
    columns |= {f"f_{i + 1}": x for i, x in enumerate(f.T)}
    return Readings(columns, _tracker(robot, faults, draws, fine), draws.drawn)
