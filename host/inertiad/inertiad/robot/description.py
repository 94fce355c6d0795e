# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions: robot.toml, read, completed with defaults and checked.

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
