# SPDX-License-Identifier: Apache-2.0
"""Sensor models: simulated measurements of the truth, with systematic faults and noise.

Systematic faults (biases, offsets, gains, misalignment, geometry) are drawn once per run from normal distributions with
the given standard deviations; noise is drawn per sample. A fault file is TOML with the keys of Faults; keys left out
are zero, "no fault".
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, model_validator
from scipy.spatial.transform import Rotation

from inertiad.base import quantity, units
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.base.text_files import read_toml
from inertiad.model.inverse_dynamics import Swing
from inertiad.model.random_errors import Dice, wander, white
from inertiad.robot.messages import Strict, nearest, validate
from inertiad.robot.value_types import Range

_MICRO_G: Final = 1e-6 * units.G

Level = Annotated[float, Range(0, 1e3)]
RateHz = Annotated[float, Range(1, 1e5, "Hz")]


Share = Annotated[float, Range(0, 1)]

SENSORS: Final = ("imu", "force", "pos")


def _sensor(value: str) -> str:
    known = ("", *SENSORS, "tracker", "bus", *quantity.QUANTITIES)
    if value not in known:
        raise ValueError(f"{', '.join(known[1:6])}, or a quantity such as f_3{nearest(value, known)}")
    return value


class Faults(Strict):
    """Levels of every fault. SI, else the unit is in the name; "each" means drawn per axis or cable, one sigma."""

    rate: RateHz = 1000.0
    """Hz of IMU and force samples, where --rate is not given"""
    acc_noise_density: Level = 0.0
    """m/s2/rtHz"""
    acc_bias: Level = 0.0
    """m/s2, each"""
    gyro_noise_density_deg: Level = 0.0
    """deg/s/rtHz"""
    gyro_bias_deg: Level = 0.0
    """deg/s, each"""
    imu_alignment_deg: Level = 0.0
    """deg, each axis of the IMU's rotation against robot.toml"""
    attitude_bias_deg: Level = 0.0
    """deg, each platform axis"""
    attitude_wander_deg: Level = 0.0
    """deg, slow random error, each platform axis"""
    attitude_wander_time: Annotated[float, Range(0.1, 1e4, "s")] = 20.0
    """s, its correlation time"""
    world_yaw_deg: Level = 0.0
    """deg, of the attitude's world frame against the tracker's"""
    force_noise: Level = 0.0
    """N, each sample"""
    force_noise_density: Level = 0.0
    """N/rtHz"""
    force_offset: Level = 0.0
    """N, each"""
    force_gain: Level = 0.0
    """1, each"""
    force_delay_max: Annotated[float, Range(0, 1, "s")] = 0.0
    """s; the forces' delay is drawn evenly from 0 to this"""
    tracker_rate: RateHz = 238.0
    """Hz"""
    tracker_noise: Level = 0.0
    """m, each axis of each sample"""
    tracker_delay: Annotated[float, Range(0, 1, "s")] = 0.0
    """s from the measured instant to its stamp"""
    geometry: Level = 0.0
    """m, each coordinate of each anchor and attachment against robot.toml"""
    cable_swing: Annotated[float, Range(0, 0.1, "rad")] = 0.0
    """rad, amplitude of each cable's lateral oscillation"""
    cable_swing_low_hz: Annotated[float, Range(0.01, 1e3, "Hz")] = 3.0
    cable_swing_high_hz: Annotated[float, Range(0.01, 1e3, "Hz")] = 5.0
    """Hz; each cable's frequency is drawn between the two"""
    clock_drift_ppm: Level = 0.0
    """ppm, of the sensors' clock against the host's"""
    stamp_jitter: Annotated[float, Range(0, 0.1, "s")] = 0.0
    """s, mean lateness of the host's frame stamps, exponentially distributed"""
    stamp_delay: Annotated[float, Range(0, 1, "s")] = 0.0
    """s, lateness of every frame stamp on top of that"""
    bus_timing: bool = False
    """frames are stamped when they have got through the bus, lowest identifier first, not at their sample's time"""
    release_jitter: Annotated[float, Range(0, 0.1, "s")] = 0.0
    """s, greatest lateness with which a node has its frames ready for the bus; needs bus_timing"""
    frame_loss: Share = 0.0
    """1, share of frames that never reach the host"""
    tracker_loss: Share = 0.0
    """1, share of tracker samples that never come"""
    dropout_hz: Annotated[float, Range(0, 100, "Hz")] = 0.0
    """Hz, how often the tracker loses sight"""
    dropout: Annotated[float, Range(0, 100, "s")] = 0.5
    """s for which it does, on average, exponentially distributed"""
    fault_start: Annotated[float, Range(0, 1e6, "s")] = 5.0
    """s from the start of the motion at which the faults below set in"""
    fault_duration: Annotated[float, Range(0, 1e6, "s")] = 2.0
    """s after which stuck and silent sensors come back"""
    stuck: Annotated[str, AfterValidator(_sensor)] = ""
    """imu, force, pos, or a quantity such as f_3: repeats its last value"""
    silent: Annotated[str, AfterValidator(_sensor)] = ""
    """imu, force, pos, tracker, bus, or a quantity such as f_3 with its whole message: sends nothing"""
    clock_step: Annotated[float, Range(-1e3, 1e3, "s")] = 0.0
    """s, jump of the sensors' clock"""
    stamp_step: Annotated[float, Range(-0.5, 1e3, "s")] = 0.0
    """s, jump of the host's clock that stamps frames"""

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if self.release_jitter > 0.0 and not self.bus_timing:
            raise ValueError("release_jitter with bus_timing = true")
        if self.cable_swing_low_hz > self.cable_swing_high_hz:
            raise ValueError("cable_swing_low_hz up to cable_swing_high_hz")
        return self

    def is_on(self, t: Array) -> NDArray[np.bool_]:
        """At which times t [N] of the motion a sensor is stuck or silent."""
        return np.asarray((t >= self.fault_start) & (t < self.fault_start + self.fault_duration))


_MODERN: Final = Faults(
    acc_noise_density=100 * _MICRO_G,
    acc_bias=0.02,
    gyro_noise_density_deg=0.008,
    gyro_bias_deg=0.01,
    imu_alignment_deg=0.2,
    attitude_bias_deg=0.3,
    attitude_wander_deg=0.1,
    world_yaw_deg=0.5,
    force_noise_density=0.1,
    force_offset=5.0,
    force_gain=0.005,
    force_delay_max=0.001,
    tracker_noise=0.001,
    tracker_delay=0.005,
    geometry=0.001,
    clock_drift_ppm=20.0,
    stamp_jitter=20e-6,
    bus_timing=True,
)

_PAPER: Final = Faults(
    rate=25.0,
    acc_noise_density=200 * _MICRO_G,
    acc_bias=0.1,
    gyro_noise_density_deg=0.02,
    gyro_bias_deg=0.3,
    imu_alignment_deg=1.0,
    attitude_bias_deg=1.0,
    attitude_wander_deg=0.5,
    world_yaw_deg=3.0,
    force_noise=15.0,
    force_offset=15.0,
    force_gain=0.005,
    force_delay_max=0.010,
    tracker_noise=0.003,
    tracker_delay=0.020,
    geometry=0.003,
    cable_swing=0.003,
    clock_drift_ppm=20.0,
    stamp_jitter=200e-6,
    bus_timing=True,
)


def _modern(**fault: object) -> Faults:
    """Modern sensors with a fault on top."""
    return _MODERN.model_copy(update=fault)


PRESETS: Final[dict[str, Faults]] = {
    "ideal": Faults(),
    "modern": _MODERN,
    "paper": _PAPER,
    "lossy": _modern(frame_loss=0.01, tracker_loss=0.02, release_jitter=300e-6),
    "dropouts": _modern(dropout_hz=0.2, tracker_loss=0.01),
    "stuck": _modern(stuck="f_3"),
    "silent": _modern(silent="force"),
    "blind": _modern(silent="tracker"),
    "drift": _modern(clock_drift_ppm=500.0),
    "clockstep": _modern(clock_step=0.05),
    "late": _modern(stamp_jitter=2e-3, stamp_delay=5e-3, tracker_delay=0.08),
}
"""ideal: no fault at all. modern: good sensors of today, as built in. paper: like those of the ICRA 2017 paper. The
others are modern with one thing broken: frames lost; tracker out of sight now and then; one force sensor stuck, all
forces silent, tracker silent, for 2 s each; sensors' clock fast or slow, jumping; host and tracker late."""


def faults(name: str) -> Faults:
    """A preset by name, or a fault file by path. InputError: neither, or an unusable file."""
    if name in PRESETS:
        return PRESETS[name]
    if not name.endswith(".toml"):
        hint = nearest(name, PRESETS)
        raise InputError(f'--faults "{name}": allowed: {", ".join(PRESETS)}, or a .toml file{hint}')
    return validate(Faults, read_toml(Path(name)), name)


@dataclass(frozen=True)
class Drawn:
    """The systematic errors of one run."""

    acc_bias: Array
    """m/s2 [3], I axes"""
    gyro_bias: Array
    """rad/s [3], I axes"""
    imu_alignment: Array
    """rad [3], rotation vector in I axes: true R_PI = R_PI of robot.toml * exp(this)"""
    attitude_bias: Array
    """rad [3], P axes: true R = measured R * exp(this)"""
    world_yaw: float
    """rad: true R = Rz(this) * measured R"""
    force_offset: Array
    """N [m]"""
    force_gain: Array
    """1 [m]: measured = (1 + gain) true + offset"""
    force_delay: float
    """s"""
    anchor_error: Array
    """m [m, 3], W: true anchor - that of robot.toml"""
    attachment_error: Array
    """m [m, 3], P"""
    swing: Swing | None
    """of the cables; None: they do not"""
    clock_drift: float
    """1: the sensors' clock gains this much"""


def _draw_swing(level: Faults, n_cables: int, dice: np.random.Generator) -> Swing:
    hz = dice.uniform(level.cable_swing_low_hz, level.cable_swing_high_hz, (n_cables, 2))
    return Swing(level.cable_swing, hz, dice.uniform(0.0, 2.0 * np.pi, (n_cables, 2)))


def draw(level: Faults, n_cables: int, dice: Dice) -> Drawn:
    """Draw a run's systematic errors."""
    deg = np.pi / 180.0
    geometry = dice["geometry"]
    return Drawn(
        acc_bias=level.acc_bias * dice["acc_bias"].standard_normal(3),
        gyro_bias=level.gyro_bias_deg * deg * dice["gyro_bias"].standard_normal(3),
        imu_alignment=level.imu_alignment_deg * deg * dice["imu_alignment"].standard_normal(3),
        attitude_bias=level.attitude_bias_deg * deg * dice["attitude_bias"].standard_normal(3),
        world_yaw=level.world_yaw_deg * deg * float(dice["world_yaw"].standard_normal()),
        force_offset=level.force_offset * dice["force_offset"].standard_normal(n_cables),
        force_gain=level.force_gain * dice["force_gain"].standard_normal(n_cables),
        force_delay=level.force_delay_max * float(dice["force_delay"].random()),
        anchor_error=level.geometry * geometry.standard_normal((n_cables, 3)),
        attachment_error=level.geometry * geometry.standard_normal((n_cables, 3)),
        swing=_draw_swing(level, n_cables, dice["swing"]) if level.cable_swing > 0.0 else None,
        clock_drift=1e-6 * level.clock_drift_ppm * float(dice["clock_drift"].standard_normal()),
    )


@dataclass(frozen=True)
class Noise:
    """What changes from sample to sample of a run's N samples."""

    acc: Array
    """m/s2 [N, 3], I axes"""
    gyro: Array
    """rad/s [N, 3], I axes"""
    wander: Array
    """rad [N, 3], of the attitude about its bias, P axes"""
    force: Array
    """N [N, m]"""
    position: Array
    """m [N, 3], of positions that come with the samples"""

    def part(self, rows: slice) -> "Noise":
        """That of some samples."""
        return Noise(self.acc[rows], self.gyro[rows], self.wander[rows], self.force[rows], self.position[rows])


def draw_noise(level: Faults, n: int, n_cables: int, rate: float, dice: Dice) -> Noise:
    """Draw the noise of a run's n samples at rate [Hz]."""
    force = white(level.force_noise_density, rate, (n, n_cables), dice["force_noise_density"])
    return Noise(
        acc=white(level.acc_noise_density, rate, (n, 3), dice["acc_noise"]),
        gyro=white(np.deg2rad(level.gyro_noise_density_deg), rate, (n, 3), dice["gyro_noise"]),
        wander=wander(
            np.deg2rad(level.attitude_wander_deg), level.attitude_wander_time, rate, n, dice["attitude_wander"]
        ),
        force=force + level.force_noise * dice["force_noise"].standard_normal((n, n_cables)),
        position=level.tracker_noise * dice["tracker_noise"].standard_normal((n, 3)),
    )


def imu_axes(R_PI: Array, drawn: Drawn) -> Array:
    """Rotation [3, 3] of the IMU's true axes to P; R_PI: that of robot.toml."""
    axes: Array = R_PI @ Rotation.from_rotvec(drawn.imu_alignment).as_matrix()
    return axes


def measure_imu(
    s: Array, omega: Array, R: Array, R_PI: Array, drawn: Drawn, noise: Noise
) -> tuple[Array, Array, Array]:
    """Simulated IMU samples.

    s [N, 3] specific force at the IMU and omega [N, 3], P axes; R [N, 3, 3] P to W; R_PI [3, 3] I to P of robot.toml.
    Returns acceleration [N, 3] and rate [N, 3] in I axes, unit quaternion [N, 4] w x y z, I to W.
    """
    R_true = imu_axes(R_PI, drawn)
    acc = s @ R_true + drawn.acc_bias + noise.acc
    gyro = omega @ R_true + drawn.gyro_bias + noise.gyro
    body = Rotation.from_matrix(R) * Rotation.from_rotvec(-drawn.attitude_bias - noise.wander)
    q = Rotation.from_euler("z", -drawn.world_yaw) * body * Rotation.from_matrix(R_true)
    return acc, gyro, q.as_quat(scalar_first=True)


def measure_forces(f: Array, drawn: Drawn, noise: Noise) -> Array:
    """Simulated force samples of true tensions f [N, m], N."""
    return (1.0 + drawn.force_gain) * f + drawn.force_offset + noise.force


def measure_positions(target: Array, level: Faults, dice: Dice) -> Array:
    """Simulated tracker positions of the target's true ones [N, 3], m."""
    return target + level.tracker_noise * dice["tracker_noise"].standard_normal(target.shape)


def out_of_sight(level: Faults, t: Array, dice: Dice) -> NDArray[np.bool_]:
    """Mask [N] of the tracker samples at times t [N] of the motion that are lost."""
    lost = dice["tracker_loss"].random(len(t)) < level.tracker_loss
    if level.silent == "tracker":
        lost |= level.is_on(t)
    drops = dice["dropout"]
    n = drops.poisson(level.dropout_hz * t[-1])
    for begin, length in zip(drops.uniform(0.0, t[-1], n), drops.exponential(level.dropout, n), strict=True):
        lost |= (t >= begin) & (t < begin + length)
    return np.asarray(lost)


class Freezer:
    """Holds the columns of the stuck sensor at their last value, sample after sample."""

    def __init__(self, level: Faults) -> None:
        self._level = level
        self._last: dict[str, float] = {}

    def freeze(self, t: Array, columns: dict[str, Array]) -> dict[str, Array]:
        """Columns [N] over the next times t [N] of the motion, those of the stuck sensor held while it is."""
        if not self._level.stuck or len(t) == 0:
            return columns
        on = self._level.is_on(t)
        held = dict(columns)
        for name, value in columns.items():
            if self._level.stuck in (name, quantity.sensor(name)):
                free = np.flatnonzero(~on)
                before = free[free < np.argmax(on)] if on.any() else free
                last = value[before[-1]] if len(before) else self._last.get(name, value[0])
                held[name] = np.where(on, last, value)
                self._last[name] = float(held[name][-1]) if on[-1] else float(value[-1])
        return held
