# SPDX-License-Identifier: Apache-2.0
"""The tables of robot.toml: every key with its type, range, unit, default and meaning.

This is the one description of the keys: description.py checks with it, reference.py prints it, writes the JSON schema
and comments new files from it. The text below a key is its meaning.
W: world frame, z up; P: platform frame; I: IMU frame.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from inertiad.robot.messages import Strict
from inertiad.robot.value_types import Age, Axis, Delay, Far3, Inertia, Memory, Near3, Number3, Quaternion, Range, Unit

TENSION_MAX_DEFAULT = 1e6
"""N: no cable holds more; carries no information about the platform"""
SIGMA_MAX = 1e6


def inertia_matrix(elements: list[float] | np.ndarray) -> np.ndarray:
    """The 3 x 3 matrix of xx yy zz yz xz xy."""
    xx, yy, zz, yz, xz, xy = elements
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


class Cables(Strict):
    """Defaults for every cable."""

    pulley_radius: Annotated[float, Range(0, 10, "m")] = 0.0
    """Of the anchor's swivelling pulley, to the cable's centre line; 0: point anchor."""
    swivel_axis: Axis = [0.0, 0.0, 1.0]
    """Axis of the pulley's swivel, W: direction of the cable at the anchor, from winch to pulley."""
    weight_per_length: Annotated[float, Range(0, 1e4, "N/m")] = 0.0
    """Weight of the cable."""
    tension_min: Annotated[float, Range(0, 1e7, "N")] = 0.0
    """Least tension in operation."""
    tension_max: Annotated[float, Range(0, 1e8, "N")] = TENSION_MAX_DEFAULT
    """Greatest tension in operation; the default means: not known."""
    force_at: Literal["platform", "winch"] = "platform"
    """Place of the force sensor: between cable and platform, or behind the pulley at the winch."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.tension_min < self.tension_max:
            raise ValueError(f"tension_min = {self.tension_min:g} below tension_max = {self.tension_max:g} N")
        return self


class Cable(Cables):
    """One cable. Keys of [cables] may stand here, too, and then hold for this cable."""

    anchor: Far3
    """Where the cable enters the pulley or leaves the winch, W."""
    attachment: Near3
    """Where the cable is fixed to the platform, P."""


class Imu(Strict):
    """The inertial measurement unit on the platform."""

    position: Near3 = [0.0, 0.0, 0.0]
    """Of the accelerometer, P."""
    orientation: Quaternion = [1.0, 0.0, 0.0, 0.0]
    """Unit quaternion w x y z that turns vectors from I to P."""
    rate: Annotated[float, Range(0, 1e5, "Hz")] = 0.0
    """Sample rate; 0: measured from the first samples."""


class Tracker(Strict):
    """The point that a laser tracker or motion capture follows."""

    target: Near3 = [0.0, 0.0, 0.0]
    """Of the reflector or marker, P."""


class Nominal(Strict):
    """The platform as far as it is known, a rigid body; leave the table out where nothing is known."""

    mass: Annotated[float, Range(1e-6, 1e7, "kg")]
    """Mass of the platform with what it carries."""
    cog: Near3
    """Centre of gravity, P."""
    inertia_cog: Inertia
    """Inertia about the centre of gravity, P axes, as entries of the matrix: xx yy zz yz xz xy."""

    @model_validator(mode="after")
    def _is_a_body(self) -> Self:
        J = inertia_matrix(self.inertia_cog)
        least = float(np.linalg.eigvalsh(0.5 * np.trace(J) * np.eye(3) - J)[0])
        if least <= 0.0:
            raise ValueError(
                "inertia_cog of a rigid body: each principal moment below the sum of the other two, "
                f"here one is {-2.0 * least:.3g} kg m2 above"
            )
        return self


class Bus(Strict):
    """One CAN bus, in the order of the daemon's --bus; without any, the layout of `inertiactl encode` holds."""

    dbc: str | list[str]
    """DBC file of the bus, or a list of files, beside robot.toml."""
    bitrate: Annotated[float, Range(0, 1e8, "bit/s")] = 1e6
    """Bit rate; 0: the stamps are those of the samples, not of frames on a wire."""
    data_bitrate: Annotated[float, Range(1e4, 1e8, "bit/s")] = 5e6
    """Bit rate of the data phase of CAN FD."""

    @property
    def files(self) -> list[Path]:
        """Absolute paths of the bus's DBC files."""
        return [Path(name) for name in ([self.dbc] if isinstance(self.dbc, str) else self.dbc)]


def _not_zero(value: float) -> float:
    if not 1e-12 <= abs(value) <= 1e12:
        raise ValueError("1e-12 to 1e12 in magnitude")
    return value


class Scaled(Strict):
    """A DBC signal whose unit is not the quantity's: SI = value in the DBC's unit * scale + offset."""

    signal: str
    """"MESSAGE.signal", or "bus1:MESSAGE.signal"."""
    scale: Annotated[float, AfterValidator(_not_zero)] = 1.0
    """SI value of one of the DBC's units."""
    offset: Annotated[float, Range(-1e9, 1e9)] = 0.0
    """SI value of zero."""


def _form(value: Any) -> str:
    return "table" if isinstance(value, dict | Scaled) else "list" if isinstance(value, list) else "text"


Bound = Annotated[
    Annotated[str, Tag("text")] | Annotated[list[str], Tag("list")] | Annotated[Scaled, Tag("table")],
    Discriminator(_form),
]
"""The right-hand side of a key in [signals]."""


class Position(Strict):
    """Where the position of the tracked point comes from."""

    source: Literal["tracker", "fixed", "can"] = "tracker"
    """LCM channel or file of a tracker, a platform that does not move, or signals pos_x..z on CAN."""
    fixed: Far3 | None = None
    """Position of the tracked point for source = "fixed", W."""

    @model_validator(mode="after")
    def _fixed_given(self) -> Self:
        if self.source == "fixed" and self.fixed is None:
            raise ValueError('fixed = [x, y, z] in m beside source = "fixed"')
        return self


class Attitude(Strict):
    """Where the attitude comes from."""

    source: Literal["quaternion", "rpy"] = "quaternion"
    """What the AHRS sends: q_w..z, or roll, pitch, yaw."""
    estimate: Literal["fused", "ahrs"] | None = None
    """"fused": from gyro, accelerometer and tracked position; "ahrs": as sent. Without it: fused where the position is
    measured."""


class LowPass(Strict):
    """A low-pass that a sensor's samples went through; its delay adds to the sensor's delay."""

    kind: Literal["bessel", "butterworth"]
    """Kind of filter."""
    order: Annotated[int, Field(ge=1, le=10)]
    """Order."""
    cutoff: Annotated[float, Range(0.1, 1e5, "Hz")]
    """Frequency at -3 dB."""

    @property
    def delay(self) -> float:
        """s: its group delay at frequencies far below the cut-off, the sum of -1/pole of H(s) = k / prod(s - pole)."""
        from scipy import signal  # half a second, for the robots that have one

        poles = signal.besselap(self.order, norm="mag")[1] if self.kind == "bessel" else signal.buttap(self.order)[1]
        return float(-np.sum(1.0 / poles).real) / (2.0 * math.pi * self.cutoff)


class Align(Strict):
    """How samples of different sensors are brought to common instants."""

    max_wait: Annotated[float, Range(0, 10, "s")] = 0.25
    """So long a row waits for the slowest sensor."""
    max_age_imu: Age = 0.1
    """Longest gap that interpolation bridges, IMU."""
    max_age_force: Age = 0.1
    """Longest gap that interpolation bridges, forces."""
    max_age_position: Age = 0.25
    """Longest gap that interpolation bridges, position."""
    max_carry: Annotated[float, Range(0, 10, "s")] = 0.5
    """So long attitude and IMU carry the position on when the tracker is silent; 0: not at all."""
    delay_imu: Delay = 0.0
    """From the measured instant to its stamp, IMU."""
    delay_force: Delay = 0.0
    """From the measured instant to its stamp, forces."""
    delay_position: Delay = 0.0
    """From the measured instant to its stamp, position."""
    delay_attitude: Delay = 0.0
    """So far the attitude lies behind the gyro of its sample."""
    filter_imu: LowPass | None = None
    """Low-pass of the IMU: { kind = "bessel", order = 4, cutoff = 10.0 }."""
    filter_force: LowPass | None = None
    """Low-pass of the force sensors."""
    filter_position: LowPass | None = None
    """Low-pass of the tracker."""
    filter_attitude: LowPass | None = None
    """Low-pass of the attitude."""


class Std(Strict):
    """Sigmas of the errors that are left after calibration; the defaults are good modern sensors, not calibrated."""

    acc_bias: Annotated[float, Range(0, SIGMA_MAX, "m/s2")] = 0.02
    """Bias of the accelerometer."""
    gyro_bias: Annotated[float, Range(0, SIGMA_MAX, "rad/s")] = 1.75e-4
    """Bias of the gyroscope."""
    attitude: Annotated[float, Range(0, SIGMA_MAX, "rad")] = 5.2e-3
    """Constant error of roll and pitch."""
    world_yaw: Annotated[float, Range(0, SIGMA_MAX, "rad")] = 8.7e-3
    """Error of the heading of W."""
    imu_alignment: Annotated[float, Range(0, SIGMA_MAX, "rad")] = 3.5e-3
    """Error of the IMU's orientation in P."""
    imu_position: Annotated[float, Range(0, SIGMA_MAX, "m")] = 1e-3
    """Error of the IMU's position in P."""
    tracker_target: Annotated[float, Range(0, SIGMA_MAX, "m")] = 1e-3
    """Error of the tracked point's position in P."""
    force_offset: Annotated[float, Range(0, SIGMA_MAX, "N")] | None = None
    """Offset of each force sensor. Without it: 0.001 of the least tension_max, or 0.1 of a cable's share of the weight
    where no tension_max is declared."""
    force_gain: Annotated[float, Range(0, SIGMA_MAX)] | None = None
    """Gain error of each force sensor. Without it: 0.005, or 0.03 where no tension_max is declared."""
    force_offset_drift: Annotated[float, Range(0, SIGMA_MAX, "N/sqrt(s)")] | None = None
    """Random walk of the force offsets. Without it: force_offset in three hours."""
    force_delay: Annotated[float, Range(0, SIGMA_MAX, "s")] = 1e-3
    """Delay of the forces against the IMU."""
    position_delay: Annotated[float, Range(0, SIGMA_MAX, "s")] = 5e-3
    """Delay of the position against the IMU."""
    attitude_delay: Annotated[float, Range(0, SIGMA_MAX, "s")] = 5e-3
    """Delay of the attitude against the gyro."""
    friction: Annotated[float, Range(0, SIGMA_MAX)] | None = None
    """Pulley friction as a share of the tension. Without it: 0.02 with force sensors at the winch, else 0.005."""
    acc_scale: Annotated[float, Range(0, SIGMA_MAX)] = 3e-3
    """Scale error of the accelerometer."""
    gyro_scale: Annotated[float, Range(0, SIGMA_MAX)] = 3e-3
    """Scale error of the gyroscope."""
    geometry: Annotated[float, Range(0, SIGMA_MAX, "m")] = 1e-3
    """Error of anchors and attachments."""
    attitude_wander: Annotated[float, Range(0, SIGMA_MAX, "rad")] = 1.75e-3
    """Slow error of the attitude about its constant one; sets the default of [estimator] force_std."""


class Estimator(Strict):
    """Settings of the recursion; those without a default follow from the robot's size, strength and [nominal]."""

    window_length: Annotated[float, Range(0.01, 10, "s")] = 0.4
    """Length of the windows that the equations are averaged over."""
    estimate_rate: Annotated[float, Range(0.01, 1e4, "Hz")] = 50.0
    """Estimates published per second, at most."""
    memory: Memory = 1200.0
    """Seconds of excited time after which data count 1/e, 10 to 1e9; 0: for ever."""
    force_std: Annotated[float, Range(1e-9, SIGMA_MAX, "N")] | None = None
    """Slow residual force of the windows; refined while running."""
    moment_std: Annotated[float, Range(1e-9, SIGMA_MAX, "N m")] | None = None
    """Slow residual moment of the windows; refined while running."""
    prior_mass_std: Annotated[float, Range(1e-9, SIGMA_MAX, "kg")] | None = None
    """Sigma of the mass before any data."""
    prior_h_std: Annotated[float, Range(1e-9, SIGMA_MAX, "kg m")] | None = None
    """Sigma of mass times CoG before any data."""
    prior_inertia_std: Annotated[float, Range(1e-9, SIGMA_MAX, "kg m2")] | None = None
    """Sigma of the moments of inertia before any data."""
    prior_product_std: Annotated[float, Range(1e-9, SIGMA_MAX, "kg m2")] | None = None
    """Sigma of the products of inertia before any data."""


class LeftOver(Strict):
    """Sigmas after `inertiactl calibrate`; they replace those of [std]."""

    acc_bias: Annotated[float, Range(0, SIGMA_MAX, "m/s2")] | None = None
    """Bias of the accelerometer."""
    gyro_bias: Annotated[float, Range(0, SIGMA_MAX, "rad/s")] | None = None
    """Bias of the gyroscope."""
    attitude: Annotated[float, Range(0, SIGMA_MAX, "rad")] | None = None
    """Constant error of roll and pitch."""
    world_yaw: Annotated[float, Range(0, SIGMA_MAX, "rad")] | None = None
    """Error of the heading of W."""
    imu_alignment: Annotated[float, Range(0, SIGMA_MAX, "rad")] | None = None
    """Error of the IMU's orientation in P."""
    force_offset: Annotated[float, Range(0, SIGMA_MAX, "N")] | None = None
    """Offset of each force sensor."""
    force_gain: Annotated[float, Range(0, SIGMA_MAX)] | None = None
    """Gain error of each force sensor."""
    force_delay: Annotated[float, Range(0, SIGMA_MAX, "s")] | None = None
    """Delay of the forces against the IMU."""
    position_delay: Annotated[float, Range(0, SIGMA_MAX, "s")] | None = None
    """Delay of the position against the IMU."""
    attitude_delay: Annotated[float, Range(0, SIGMA_MAX, "s")] | None = None
    """Delay of the attitude against the gyro."""


class Calibration(Strict):
    """Corrections of the sensors, as `inertiactl calibrate` and `inertiactl sync` estimate them."""

    file: str | None = None
    """TOML file with keys of this table, written by `inertiactl calibrate`; keys beside it hold before the file's."""
    sync: str | None = None
    """sync.json of `inertiactl sync`: the delays and their sigmas."""
    acc_bias: Annotated[Number3, Unit("m/s2")] = [0.0, 0.0, 0.0]
    """Bias of the accelerometer, I."""
    gyro_bias: Annotated[Number3, Unit("rad/s")] = [0.0, 0.0, 0.0]
    """Bias of the gyroscope, I."""
    attitude_bias: Annotated[Number3, Unit("rad")] = [0.0, 0.0, 0.0]
    """Error of the attitude, P: true = measured exp(bias)."""
    world_yaw: Annotated[float, Range(-7, 7, "rad")] = 0.0
    """Error of the heading: true = Rz(yaw) measured."""
    force_offset: list[Annotated[float, Range(-1e9, 1e9, "N")]] | None = None
    """One per cable: measured = (1 + gain) true + offset."""
    force_gain: list[Annotated[float, Range(-0.9, 9)]] | None = None
    """One per cable: measured = (1 + gain) true + offset."""
    imu_alignment: Annotated[Number3, Unit("rad")] = [0.0, 0.0, 0.0]
    """Rotation vector by which the orientation of [imu] is turned, P."""
    position_delay: Delay = 0.0
    """On top of [align] delay_position."""
    force_delay: Delay = 0.0
    """On top of [align] delay_force."""
    attitude_delay: Delay = 0.0
    """On top of [align] delay_attitude."""
    std: LeftOver = LeftOver()
    names: list[str] = []
    """Names of all corrections, for people and programs; not compiled."""
    covariance: list[list[float]] = []
    """Covariance of all corrections together; not compiled."""
    not_told: list[str] = []
    """Combinations of corrections that the runs could not show; not compiled."""
