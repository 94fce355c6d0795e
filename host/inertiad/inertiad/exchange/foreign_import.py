# SPDX-License-Identifier: Apache-2.0
"""Recordings with other names, units and rates -> a run folder, by a mapping (channels.py) given or proposed.

signals.csv has rows at the IMU's samples, forces interpolated to them; tracker.csv the positions at their own times;
can.log, where a robot description is given, every sensor at its own rate.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.table import Array, Table
from inertiad.exchange import channels, dataset, motion_capture, second_recording
from inertiad.exchange.channels import Found, Mapping
from inertiad.exchange.foreign_csv import Channel, rate_of
from inertiad.robot import dbc, description
from inertiad.robot.dbc import Binding
from inertiad.run import canlog, encode, signals_csv, tracker_csv
from inertiad.run import folder as run_folder

GAP_PERIODS: Final = 3.0
GAP_LEAST: Final = 0.1
"""s: samples further apart than this and three periods are a gap, across which nothing is interpolated"""
SENSORS: Final = ("imu", "force", "pos")


@dataclass(frozen=True)
class Mapped:
    """A recording by sensors, SI."""

    sensors: dict[str, Table]
    """imu, force, pos: each over its own time"""
    source: str


@dataclass(frozen=True)
class Tracker:
    """Positions in a recording of their own."""

    file: Path
    start: float | None
    """s: time of the other recording at which its clock is 0; None: from the motion"""


def is_can_log(file: Path) -> bool:
    """Whether a file holds CAN frames, by its ending."""
    return file.suffix.lower() in (".log", *canlog.OTHER_FORMATS)


def _bound(robot_file: Path) -> tuple[list[Path], dict[str, str]]:
    """DBC files of a robot's buses, and the quantity of each "MESSAGE.signal"."""
    robot = description.load(robot_file)
    if not robot.bus:
        return [], {}
    files = [file for bus in robot.bus for file in bus.files]
    bindings = [b for b in dbc.bind(robot, str(robot_file)) if b.quantity not in channels.NOT_MAPPED]
    return files, {f"{b.message.name}.{b.signal.name}": b.quantity for b in bindings}


def _at(t: Array, name: str, channel: Channel) -> Array:
    """Values of a channel at times t, which lie within its own; angles without jumps."""
    value = np.unwrap(channel.value) if name in quantity.RPY else channel.value
    found = np.interp(t, channel.t, value)
    return (found + np.pi) % (2.0 * np.pi) - np.pi if name in quantity.RPY else found


def _is_near(t: Array, channel: Channel) -> NDArray[np.bool_]:
    """Is each time between two samples of the channel that are not a gap apart?"""
    gap = max(GAP_PERIODS * float(np.median(np.diff(channel.t))), GAP_LEAST) if len(channel.t) > 1 else 0.0
    after = np.searchsorted(channel.t, t)
    inside = (after > 0) & (after < len(channel.t))
    between = channel.t[np.where(inside, after, 0)] - channel.t[np.where(inside, after - 1, 0)]
    at_sample = np.isin(t, channel.t)
    return at_sample | (inside & (between <= gap))


def _overlap(t: Array, members: dict[str, Channel], remarks: list[str]) -> Array:
    """The times at which every channel has samples on both sides, none of them across a gap, which remarks names."""
    first, last = max(m.t[0] for m in members.values()), min(m.t[-1] for m in members.values())
    t = t[(t >= first) & (t <= last)]
    near = {name: _is_near(t, channel) for name, channel in members.items()}
    kept = np.all(list(near.values()), axis=0)
    silent = [name for name, own in near.items() if not own.all()]
    if silent:
        lost = t[~kept]
        where = f"between {lost[0]:.6g} and {lost[-1]:.6g} s"
        remarks.append(f"{len(lost)} of {len(t)} rows are left out, {where}: {', '.join(silent)} have gaps there")
    return np.asarray(t[kept])


def _continuous(columns: dict[str, Channel]) -> dict[str, Channel]:
    """Quaternions over one time with the signs that let them be interpolated."""
    names = [name for name in quantity.QUATERNION if name in columns]
    if len(names) < 4 or any(len(columns[n].t) != len(columns[names[0]].t) for n in names):
        return columns
    q = np.column_stack([columns[name].value for name in names])
    sign = np.cumprod(np.r_[1.0, np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)])
    turned = {name: Channel(name, "", columns[name].t, columns[name].value * sign) for name in names}
    return columns | turned


def _table(columns: dict[str, Channel], t: Array, source: str) -> Table:
    """The columns at times t; quaternions of unit length."""
    found = {name: _at(t, name, channel) for name, channel in _continuous(columns).items()}
    if all(name in found for name in quantity.QUATERNION):
        norm = np.sqrt(np.sum([found[name] ** 2 for name in quantity.QUATERNION], axis=0))
        if (norm < 0.5).any():
            raise InputError(f"{source}: a quaternion of length {norm.min():.3g}: allowed: about 1")
        found |= {name: found[name] / norm for name in quantity.QUATERNION}
    return Table(t, found, source)


def by_sensor(mapped: dict[str, Channel], source: str, remarks: list[str]) -> Mapped:
    """Tables of the sensors, each at the times of its first channel. InputError: channels of a sensor never overlap.

    remarks: rows left out because a channel has a gap there.
    """
    sensors = {}
    for sensor in SENSORS:
        columns = {name: channel for name, channel in mapped.items() if quantity.sensor(name) == sensor}
        if columns:
            t = _overlap(next(iter(columns.values())).t, columns, remarks)
            if len(t) < 2:
                raise InputError(f"{source}: the {sensor} channels have no time in common")
            if t[0] < 0.0:
                raise InputError(f"{source}: t = {t[0]:g} s: allowed: 0 and later; shift the column of time")
            table = _table(columns, t, source)
            sensors[sensor] = signals_csv.with_attitude(table) if sensor == "imu" else table
    if not sensors:
        raise InputError(f"{source}: no channel is mapped to a quantity; write a mapping and pass --map")
    return Mapped(sensors, source)


def joined(found: Mapped, remarks: list[str]) -> Table | None:
    """Signals at the IMU's samples, else at those of the forces; None: neither is there. remarks: rows left out."""
    parts = [found.sensors[name] for name in ("imu", "force") if name in found.sensors]
    if not parts:
        return None
    columns = {name: Channel(name, "", part.t, values) for part in parts for name, values in part.columns.items()}
    t = _overlap(parts[0].t, columns, remarks)
    if len(t) < 2:
        raise InputError(f"{found.source}: IMU and forces have no time in common")
    return signals_csv.with_attitude(_table(columns, t, found.source))


def _rate_remarks(found: Mapped) -> Iterator[str]:
    imu, force = found.sensors.get("imu"), found.sensors.get("force")
    if imu is not None and force is not None and (len(imu) != len(force) or not np.array_equal(imu.t, force.t)):
        yield (
            f"forces at {rate_of(force.t):.4g} Hz are interpolated to the IMU's {rate_of(imu.t):.4g} Hz in "
            "signals.csv; can.log keeps both rates"
        )


# ---- files -----------------------------------------------------------------------------------------------------------


def _shared_message(bindings: list[Binding]) -> str | None:
    """Name of a message that carries quantities of several sensors, which then need one rate."""
    owner: dict[tuple[int, int], str] = {}
    for binding in bindings:
        sensor = quantity.sensor(binding.quantity)
        if owner.setdefault((binding.bus, binding.can_id), sensor) != sensor:
            return str(binding.message.name)
    return None


def _write_can(folder: Path, found: Mapped, robot_file: Path, remarks: list[str]) -> Iterator[str]:
    """robot.toml, and can.log if everything that the robot's signals need is there."""
    robot = description.load(robot_file)
    run_folder.write_robot(folder, robot, description.read_data(robot_file), bitrate=0.0)
    bindings = dbc.bind(robot, str(robot_file))
    there = {name for table in found.sensors.values() for name in table.columns}
    needed = [b.quantity for b in bindings if b.quantity not in quantity.COUNTER + quantity.TIME]
    missing = [name for name in dict.fromkeys(needed) if name not in there]
    if missing:
        remarks.append(f"no can.log: {', '.join(missing)} are not mapped, which [signals] of {robot_file} needs")
        return
    tables = dict(found.sensors)
    shared, signals = _shared_message(bindings), joined(found, [])
    if shared is not None and signals is not None:
        remarks.append(f"message {shared} carries several sensors: all go to can.log at the IMU's rate")
        tables = {"imu": signals}
    parts = []
    for sensor, table in tables.items():
        own = [b for b in bindings if shared is not None or quantity.sensor(b.quantity) == sensor]
        if own:
            parts.append((table.t, encode.pack(own, table, table.t)))
    yield f"{folder / 'can.log'}: {encode.write_parts(folder / 'can.log', parts)} frames"


def _write_tracker(path: Path, position: Table) -> Iterator[str]:
    columns = dict(zip("xyz", (position.columns[name] for name in quantity.POSITION), strict=True))
    tracker_csv.write(path, Table(position.t, columns, str(path)))
    yield f"{path}: {len(position)} rows, {rate_of(position.t):.4g} Hz"


def import_mapped(
    file: Path,
    folder: Path,
    robot: Path | None,
    mapping: Mapping | None,
    remarks: list[str],
    dbcs: Sequence[Path] = (),
    tracker: Tracker | None = None,
) -> list[str]:
    """A recording -> a run folder. Without a mapping the proposed one is used, and written beside it.

    dbcs: of a CAN log's buses; none: those of the robot, whose [signals] then say what is what. tracker: positions that
    were recorded elsewhere. remarks: every channel with its proposal, and assumptions. Returns a line per file.
    InputError: unusable.
    """
    bound = _bound(robot) if robot is not None else ([], {})
    known: list[Found] = channels.summary(file, mapping, dbcs or (bound[0] if is_can_log(file) else ()))
    known = channels.by_signals(known, bound[1])
    if tracker is not None:
        known = second_recording.joined(file, known, tracker.file, mapping, tracker.start, remarks)
    run_folder.open_run(folder)
    if mapping is None:
        mapping = channels.proposed_mapping(file, known)
        proposal = folder / f"{file.stem}.map.toml"
        options = "" if tracker is None else f" --tracker {tracker.file.name}"
        if proposal.exists():
            raise InputError(f"{proposal}: is there already; pass --map {proposal}, or remove it")
        proposal.write_text(channels.mapping_text(file, known, options), encoding="utf-8")
        remarks += [item.text for item in known]
        remarks += channels.unit_remarks(known)
        if motion_capture.kind(file) == "Motive":
            remarks.append("Motive exports y up unless told otherwise: check which channels are pos_y and pos_z")
        remarks.append(f"mapping proposed from names, units and values: check {proposal}, change it, pass --map")
    found = by_sensor(channels.mapped(file, known, mapping), str(file), remarks)
    remarks += _rate_remarks(found)
    written = []
    signals = joined(found, remarks)
    if signals is not None:
        dataset.write_csv(folder / "signals.csv", signals, with_units=False)
        written.append(f"{folder / 'signals.csv'}: {len(signals)} rows, {rate_of(signals.t):.4g} Hz")
    position = found.sensors.get("pos")
    if position is not None and all(name in position.columns for name in quantity.POSITION):
        written += _write_tracker(folder / "tracker.csv", position)
    if robot is not None:
        written += _write_can(folder, found, robot, remarks)
    return written
