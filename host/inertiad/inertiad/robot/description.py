# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions: robot.toml, read, completed with defaults and checked.

key                                  default              meaning
===================================  ===================  ==============================================================
base                                                      another robot.toml whose keys hold where this one has none
name                                 required             up to 63 bytes
gravity                              9.81                 m/s2, along -z of W
[cables], or in any [[cable]]                             defaults for every cable
  pulley_radius                      0                    m, to the cable's centre line; 0: point anchor
  swivel_axis                        [0, 0, 1]            unit, W: cable travel at the anchor, winch to pulley
  weight_per_length                  0                    N/m
  tension_min, tension_max           0, 1e6               N
  force_at                           "platform"           where its force sensor sits: "platform", between cable and
                                                          platform; "winch", behind the pulley
[[cable]] anchor, attachment         required             m, W and P; 1 to 16 cables
[imu] position                       [0, 0, 0]            m, P
[imu] orientation                    [1, 0, 0, 0]         unit quaternion w x y z, I to P
[imu] rate                           0                    Hz, 0: measured from the first samples
[tracker] target                     [0, 0, 0]            m, P
[nominal] mass, cog, inertia_cog                          kg; m, P; kg m2 about the CoG, xx yy zz yz xz xy
[[bus]] dbc                          generated            file or list of files, beside robot.toml; buses in the
                                                          order of the daemon's --bus
[[bus]] bitrate                      1_000_000            bit/s, 0: stamps are those of the samples
[[bus]] data_bitrate                 5_000_000            bit/s of the data phase of CAN FD
[signals] QUANTITY = "MESSAGE.sig"   as generated         acc_x..z gyro_x..z q_w..z roll pitch yaw pos_x..z f_1..f_m,
                                                          {imu,force,pos}_counter, {imu,force,pos}_time;
                                                          "bus1:MESSAGE.sig" where a message is on several buses;
                                                          a list of signals for counters, device time being one
                                                          if its frame is the first of the sample;
                                                          { signal = "MESSAGE.sig", scale = 0.16, offset = 0 } for a
                                                          signal in counts, mV/V, the wrong sense or tick:
                                                          SI = value in the DBC's unit * scale + offset
[position] source                    "tracker"            "tracker", "fixed", "can"
[position] fixed                                          m, W, of the tracked point, for source "fixed"
[attitude] source                    "quaternion"         "quaternion", "rpy"
[attitude] estimate                  see right            "fused": gyro, accelerometer and tracked position; "ahrs": as
                                                          measured; fused where the position is measured
[align] max_wait                     0.25                 s a row waits for the slowest sensor
[align] max_age_{imu,force,position} 0.1, 0.1, 0.25       s interpolation may bridge
[align] max_carry                    0.5                  s that attitude and IMU carry the position on when the
                                                          tracker is silent, 0: not at all
[align] delay_{imu,force,position}   0                    s from the measured instant to its stamp
[align] delay_attitude               0                    s the attitude lies behind the gyro of its sample
[align] filter_{imu,force,position,                       low-pass that the sensor's samples went through:
                attitude}                                 { kind = "bessel", order = 4, cutoff = 10.0 }, Hz at -3 dB;
                                                          "bessel", "butterworth": its delay adds to the one above
[std] acc_bias, gyro_bias            0.02, 1.75e-4        m/s2, rad/s; all of [std]: one sigma left after calibration
[std] attitude, world_yaw            5.2e-3, 8.7e-3       rad
[std] imu_alignment, imu_position    3.5e-3, 1e-3         rad, m
[std] tracker_target                 1e-3                 m
[std] force_offset                   see right            N: 0.001 of the least tension_max; where none is declared
                                                          0.1 of a cable's share of the weight
[std] force_gain                     5e-3                 1; 0.03 where no tension_max is declared
[std] force_offset_drift             see right            N/sqrt(s), random walk: force_offset in three hours
[std] force_delay, position_delay    1e-3, 5e-3           s
[std] attitude_delay                 5e-3                 s
[std] friction                       see right            1, share of the tension: 0.02 at the winch, else 5e-3
[std] acc_scale, gyro_scale          3e-3, 3e-3           1
[std] external_force                 see right            N, each axis: 0.05 of the weight
[std] external_stiffness             see right            N/m, each axis: external_force over a quarter of the
                                                          anchors' rms distance from their mean
[std] geometry                       1e-3                 m, anchors and attachments
[std] attitude_wander                1.75e-3              rad, slow error about the bias: sets the residual below
[external] constant                  false                true: a hose or an energy chain pulls on the platform with
                                                          a force that is constant in W: 3 unknowns
[external] stiffness                 false                true: and like a spring along each axis of W, 3 unknowns
[external] attachment                [0, 0, 0]            m, P: where
[external] reference                 the anchors' mean    m, W: the attachment's place at which the force is
                                                          the external_force that is published
[estimator] window_length            0.4                  s
[estimator] estimate_rate            50                   Hz
[estimator] memory                   1200                 s of excited time after which data count 1/e; 0: for ever
[estimator] force_std, moment_std    see Estimator        N, N m: slow residual of the windows, refined while running
[estimator] prior_*_std              see Estimator        kg, kg m, kg m2
[calibration] file                                        a TOML file with the keys below
[calibration] sync                                        a sync.json of `inertiactl sync`: the delays and their sigmas
[calibration] acc_bias, gyro_bias    [0, 0, 0]            m/s2, rad/s, I
[calibration] attitude_bias          [0, 0, 0]            rad, P: true = measured exp(bias)
[calibration] world_yaw              0                    rad: true = Rz(yaw) measured
[calibration] force_offset           zeros                N, one per cable
[calibration] force_gain             zeros                1: measured = (1 + gain) true + offset
[calibration] imu_alignment          [0, 0, 0]            rad, P: orientation of [imu] turned by this
[calibration] position_delay,
              force_delay,
              attitude_delay         0                    s, on top of [align]
[calibration.std] as in [std]                             sigmas after `inertiactl calibrate`, instead of [std]
[calibration] names, covariance,                          of all corrections together, and unobservable parameters:
              not_told                                    for people and programs, not compiled
===================================  ===================  ==============================================================
=======
keys.py has every key with its range, unit, default and meaning; ``inertiactl help robot.toml`` prints them.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.text_files import read_json, read_toml
from inertiad.robot.keys import (
    Align,
    Attitude,
    Bound,
    Bus,
    Cable,
    Cables,
    Calibration,
    Estimator,
    External,
    Imu,
    Nominal,
    Position,
    Std,
    Tracker,
)
from inertiad.robot.messages import Strict, nearest_or_known, shown, validate
from inertiad.robot.value_types import Range

BUSES_MAX = 8


class Robot(Strict):
    """A robot description, complete and checked. Tables may be left out unless marked as required."""

    base: str | None = None
    """Another robot.toml, beside this one, whose keys hold where this one has none."""
    name: Annotated[str, Field(min_length=1)]
    """Name of the robot, up to 63 bytes."""
    gravity: Annotated[float, Range(0, 1e3, "m/s2")] = 9.81
    """Acceleration of gravity, along -z of W."""
    cables: Cables = Cables()
    cable: Annotated[list[Cable], Field(min_length=1, max_length=quantity.CABLES_MAX)]
    imu: Imu = Imu()
    tracker: Tracker = Tracker()
    nominal: Nominal | None = None
    bus: Annotated[list[Bus], Field(max_length=BUSES_MAX)] = []
    signals: Annotated[
        dict[str, Bound], Field(json_schema_extra={"propertyNames": {"enum": list(quantity.QUANTITIES)}})
    ] = {}
    """QUANTITY = "MESSAGE.signal" binds a quantity to a signal of the DBC; "bus1:MESSAGE.signal" where a message is on
    several buses; a list of signals for counters; { signal = "MESSAGE.signal", scale = 0.16, offset = 0 } for a signal
    in counts, mV/V, or with the wrong sign: SI = value in the DBC's unit * scale + offset. Device times count only
    where their frame is the first of the sample. Left out together with [[bus]]: the layout of `inertiactl encode`."""
    position: Position = Position()
    attitude: Attitude = Attitude()
    align: Align = Align()
    external: External = External()
    std: Std = Std()
    estimator: Estimator = Estimator()
    calibration: Calibration = Calibration()

    @property
    def n_cables(self) -> int:
        return len(self.cable)

    @model_validator(mode="before")
    @classmethod
    def _fill_cables(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Give every cable the defaults of [cables]."""
        shared, cable = data.get("cables", {}), data.get("cable")
        if isinstance(shared, dict) and isinstance(cable, list):
            known = {key: value for key, value in shared.items() if key in Cables.model_fields}
            data = {**data, "cable": [{**known, **c} if isinstance(c, dict) else c for c in cable]}
        return data

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        """All contradictions between keys, one a line."""
        problems = [*self._wrong_lengths(), *self._wrong_signals()]
        if self.attitude.estimate == "fused" and self.position.source == "fixed":
            problems.append('attitude.estimate = "ahrs" with a fixed position: "fused" needs a measured one')
        problems += self._undeclared_forces()
        if problems:
            raise ValueError("\n".join(problems))
        return self

    def _wrong_lengths(self) -> Iterator[str]:
        if len(self.name.encode()) > 63:
            yield f"name of at most 63 bytes, this one has {len(self.name.encode())}"
        for key in ("force_offset", "force_gain"):
            values = getattr(self.calibration, key)
            if values is not None and len(values) != self.n_cables:
                yield f"calibration.{key} with {self.n_cables} numbers, one per cable, not {len(values)}"

    def _undeclared_forces(self) -> Iterator[str]:
        for key, sigma in (("constant", "external_force"), ("stiffness", "external_stiffness")):
            if getattr(self.std, sigma) is not None and not getattr(self.external, key):
                yield f"external.{key} = true beside std.{sigma}"

    def _wrong_signals(self) -> Iterator[str]:
        others = [n for n in quantity.QUANTITIES if not n.startswith("f_")]
        for key, value in self.signals.items():
            if key.startswith("f_") and key not in quantity.forces(self.n_cables):
                yield f"signals.{key}: not a cable of this robot: allowed: f_1 to f_{self.n_cables}"
            elif not key.startswith("f_") and key not in others:
                yield f"signals.{key}: not a quantity{nearest_or_known(key, others)}"
            elif isinstance(value, list) and key not in quantity.COUNTER:
                yield f'signals.{key} = "MESSAGE.signal", one signal (lists are for counters)'
        if self.signals and not self.bus:
            yield "[[bus]] with the DBC file that [signals] refers to"
        if self.bus and not self.signals:
            yield "[signals] that bind quantities to signals of the DBC"


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """over's keys on top of base's; tables are merged, everything else is replaced."""
    result = dict(base)
    for key, value in over.items():
        old = result.get(key)
        result[key] = _merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return result


def _absolute(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The DBC paths of data, taken relative to the file they stand in."""

    def resolve(name: Any) -> Any:
        return str(folder / name) if isinstance(name, str) else name

    buses = data.get("bus")
    if isinstance(buses, list):
        for bus in buses:
            if isinstance(bus, dict) and "dbc" in bus:
                dbc = bus["dbc"]
                bus["dbc"] = [resolve(name) for name in dbc] if isinstance(dbc, list) else resolve(dbc)
    return data


def _calibration(keys: dict[str, Any], folder: Path) -> dict[str, Any]:
    """[calibration]: its own keys over those of its sync, and these over those of its file."""
    own = {k: v for k, v in keys.items() if k not in ("file", "sync")}
    for key, read in (("sync", _read_sync), ("file", read_toml)):
        if isinstance(keys.get(key), str):
            own = _merged(read(folder / keys[key]), own)
        elif key in keys:
            own[key] = keys[key]
    return own


def _read_sync(path: Path) -> dict[str, Any]:
    """The part of a sync.json that belongs into [calibration]."""
    data = read_json(path).get("calibration")
    if not isinstance(data, dict):
        raise InputError(f"{path}: no calibration in it: allowed: a file that inertiactl sync wrote")
    return data


def read_data(path: Path, depth: int = 0) -> dict[str, Any]:
    """The keys of a robot.toml with its base's under them, calibration file taken in and DBC paths absolute."""
    if depth > 8:
        raise InputError(f"{path}: base: more than 8 files deep")
    data = _absolute(read_toml(path), path.parent)
    if isinstance(data.get("calibration"), dict):
        data["calibration"] = _calibration(data["calibration"], path.parent)
    base = data.pop("base", None)
    if base is None:
        return data
    if not isinstance(base, str):
        raise InputError(f"{path}: base = {shown(base)}: allowed: a text in quotes")
    return _merged(read_data(path.parent / base, depth + 1), data)


def load(path: Path) -> Robot:
    """Read and check a robot description. InputError: a line per mistake with file, key, value and what is allowed."""
    return validate(Robot, read_data(path), str(path))
