# SPDX-License-Identifier: Apache-2.0
"""A run as tables: named columns with units over exact time, whatever file they come from or go to.

signals   t acc_x..z gyro_x..z q_w..z pos_x..z f_1..f_m    aligned rows, as measured, I axes; position of the target, W
tracker   t x y z, of poses q_w..z, of a record valid, t_device_ns   positions of the tracked point, W; attitude P to W
estimate  t mass cog_x..z inertia_cog_xx..xy with _std, systematic errors, n_windows, nis, ...
frames    t bus can_id flags length data                   CAN frames, SocketCAN's identifiers, data in hex
events    t source text
health    t and every counter
CONFIG and HOST describe the daemon and its machine, not the run: no table holds them.
"""

import csv
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inertiad.base import quantity, units
from inertiad.base.error import InputError
from inertiad.base.table import NS, Table, Values, at_ns, header, read_columns
from inertiad.robot.description import Robot
from inertiad.run import canlog, lcmlog, reader
from inertiad.run.canlog import CanLog

NAMES: Final = ("signals", "tracker", "estimate", "frames", "events", "health")
KEY_COLUMN: Final = {"signals": "acc_x", "tracker": "x", "estimate": "mass", "frames": "can_id", "events": "text"}
"""the column by which a table without a name is recognised"""
INERTIA: Final = ("xx", "yy", "zz", "yz", "xz", "xy")

_TEXT: Final = ("bus", "data", "source", "text")
_WHOLE: Final = r"can_id|flags|length|t_ns|t_device_ns|n_\w+"
_FLAGS: Final = ("consistent", "provisional", "valid")


def _truth(value: Any) -> bool:
    return value in (True, 1, "1", "True", "true")


def typed(kind: str, name: str, values: Iterable[Any]) -> Values:
    """Values of a column, from numbers or their text, in the kind its name has. ValueError: they are not of it."""
    listed = values.tolist() if isinstance(values, np.ndarray) else list(values)
    if name in _TEXT:
        return np.array([str(v) for v in listed], object)
    if name in _FLAGS:
        return np.array([_truth(v) for v in listed], np.bool_)
    if kind == "health" or re.fullmatch(_WHOLE, name):
        return np.array([int(v) for v in listed], np.int64)
    return np.array([float(v) for v in listed], np.float64)


# ---- from messages and logs ------------------------------------------------------------------------------------------


def _times(messages: list[Any]) -> NDArray[np.int64]:
    return np.array([m.t_ns for m in messages], dtype=np.int64)


def _vectors(names: Iterable[str], values: list[Any]) -> dict[str, Values]:
    stacked = np.array(values, dtype=np.float64)
    return {name: stacked[:, i].copy() for i, name in enumerate(names)}


def _scalars(kind: str, names: Iterable[str], messages: list[Any]) -> dict[str, Values]:
    return {name: typed(kind, name, [getattr(m, name) for m in messages]) for name in names}


def _signals(messages: list[Any]) -> Table:
    rows = [row for message in messages for row in message.row]
    if len({row.n_cables for row in rows}) > 1:
        raise InputError("signals: the number of cables changes within the run; export one robot at a time")
    return signals_of(_times(rows), [[*row.acc, *row.gyro, *row.q, *row.position, *row.f] for row in rows])


def signals_of(t_ns: NDArray[np.int64], rows: Any) -> Table:
    """The table of rows [N, 13 + m]: acc, gyro, q, position, f."""
    stacked = np.asarray(rows, dtype=np.float64).reshape(len(t_ns), -1)
    forces = quantity.forces(stacked.shape[1] - 13)
    names = quantity.ACC + quantity.GYRO + quantity.QUATERNION + quantity.POSITION + forces
    return at_ns("signals", t_ns, {name: stacked[:, i].copy() for i, name in enumerate(names)})


def _tracker(messages: list[Any]) -> Table:
    columns = _vectors("xyz", [m.position for m in messages])
    if any(m.has_q for m in messages):
        columns |= _vectors(quantity.QUATERNION, [m.q for m in messages])
    return at_ns("tracker", _times(messages), columns | _scalars("tracker", ("valid", "t_device_ns"), messages))


def _estimate(messages: list[Any]) -> Table:
    if any(m.systematic_name != messages[0].systematic_name for m in messages):
        raise InputError("estimate: the systematic parameters change within the run: allowed: one robot per run")
    columns: dict[str, Values] = {}
    vectors = {
        "cog": [f"cog_{a}" for a in "xyz"],
        "inertia_cog": [f"inertia_cog_{e}" for e in INERTIA],
        "systematic": list(messages[0].systematic_name),
    }
    for end in ("", "_std"):
        columns |= _scalars("estimate", [f"mass{end}"], messages)
        for field, names in vectors.items():
            columns |= _vectors([f"{name}{end}" for name in names], [getattr(m, f"{field}{end}") for m in messages])
    counts = ("consistent", "distance", "nis", "n_windows", "n_rows", "n_dropped", "n_changes", "provisional")
    return at_ns("estimate", _times(messages), columns | _scalars("estimate", counts, messages))


def _events(messages: list[Any]) -> Table:
    return at_ns("events", _times(messages), _scalars("events", ("source", "text"), messages))


def _health(messages: list[Any]) -> Table:
    counted = [{c.name.replace(".", "_"): c.value for c in m.counter} for m in messages]
    names = dict.fromkeys(name for counters in counted for name in counters)
    columns = {name: typed("health", name, [counters.get(name, 0) for counters in counted]) for name in names}
    return at_ns("health", _times(messages), columns)


_OF_CHANNEL: Final[dict[str, tuple[str, Callable[[list[Any]], Table]]]] = {
    "SIGNALS": ("signals_t", _signals),
    "TRACKER": ("tracker_t", _tracker),
    "ESTIMATE": ("estimate_t", _estimate),
    "EVENT": ("event_t", _events),
    "HEALTH": ("health_t", _health),
}
_NO_SHEET: Final = ("RAW", "ORDER", "CONFIG", "HOST", "COMMAND")  # frames, their order, settings, the machine; answers
# to commands are events


def of_lcm(path: Path, prefix: str, remarks: list[str]) -> dict[str, Table]:
    """Every table of an LCM log's messages, up to its first damage. InputError: a message of another version."""
    import inertiad_lcm

    found: dict[str, list[Any]] = {}
    n_other, without_table = 0, set[str]()
    for event in lcmlog.read(path, remarks):
        name = event.channel.removeprefix(prefix)
        if event.channel.startswith(prefix) and name in _OF_CHANNEL:
            kind = getattr(inertiad_lcm, _OF_CHANNEL[name][0])
            found.setdefault(name, []).append(lcmlog.decode(kind, event, path))
        elif not event.channel.startswith(prefix):
            n_other += 1
        elif name not in _NO_SHEET:
            without_table.add(event.channel)
    if without_table:
        remarks.append(f"{path}: {', '.join(sorted(without_table))}: left out, no table holds them")
    if n_other:
        remarks.append(f"{path}: {n_other} messages of other channels than {prefix}... left out")
    tables = [make(found[name]) for name, (_, make) in _OF_CHANNEL.items() if name in found]
    return {table.name: table for table in tables if len(table)}


def of_frames(log: CanLog) -> Table:
    """CAN frames as a table; frames_of() is the way back."""
    width = log.data.shape[1]
    text = log.data.tobytes().hex().upper()
    data = [text[2 * k * width : 2 * (k * width + n)] for k, n in enumerate(log.length.tolist())]
    columns = {
        "bus": np.array([log.names[i] for i in log.bus], object),
        "can_id": log.can_id.astype(np.int64),
        "flags": log.flags.astype(np.int64),
        "length": log.length.astype(np.int64),
        "data": np.array(data, object),
    }
    return at_ns("frames", log.t_ns, columns)


def frames_of(table: Table, source: str) -> CanLog:
    """The frames of a table. InputError: a column is missing or is no frame."""
    names = ("can_id", "flags", "data", "bus", "length")
    missing = [name for name in names if name not in table.columns]
    if missing:
        raise InputError(f"{source}: frames: no column {missing[0]}: allowed: {', '.join(('t', *names))}")
    lists = [table.columns[name].tolist() for name in names]
    try:
        rows: list[canlog.Row] = [
            (t, int(i), int(f), bytes.fromhex(d), str(b), int(n))
            for t, i, f, d, b, n in zip(table.t_ns.tolist(), *lists, strict=True)
        ]
        return canlog.from_rows(rows, source)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{source}: frames: {error}") from None


# ---- CSV -------------------------------------------------------------------------------------------------------------


def time_text(t_ns: int) -> str:
    """s with nine decimals, exact."""
    sign, size = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{size // NS}.{size % NS:09d}"


def write_csv(path: Path, table: Table, with_units: bool = True) -> None:
    """One table; every number reads back the same. with_units: acc_x [m/s2] instead of acc_x."""
    names = ("t", *table.columns)
    lists = [v.astype(np.int64).tolist() if v.dtype == np.bool_ else v.tolist() for v in table.columns.values()]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(map(units.head, names) if with_units else names)
        writer.writerows(zip(map(time_text, table.t_ns.tolist()), *lists, strict=True))


def name_of(columns: Iterable[str]) -> str:
    """Name of the table that has such columns."""
    known = set(columns)
    return next((name for name, key in KEY_COLUMN.items() if key in known), "health")


def read_csv(path: Path, name: str | None = None) -> Table:
    """A table of the dataset from a CSV file with a column t. InputError: see table.read_columns()."""
    found = name or name_of(header(path)[0])
    read = read_columns(path, partial(typed, found))
    return at_ns(found, read.t_ns, read.columns)


# ---- a run -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Dataset:
    """Everything of a run that can be exported."""

    tables: dict[str, Table]
    """by name, in the order of NAMES; frames not among them"""
    frames: CanLog | None
    source: str
    robot: Robot | None = None
    """the description that belongs to the run; None: there is none that can be used"""

    def all(self) -> Iterator[Table]:
        """Every table, that of the frames included."""
        whole = self.tables | ({"frames": of_frames(self.frames)} if self.frames is not None else {})
        return (whole[name] for name in NAMES if name in whole)


def _frames(run: Path, prefix: str, remarks: list[str]) -> CanLog | None:
    try:
        path = canlog.find(run)
        is_lcm = path.suffix.lower() in canlog.LCM_FORMATS
        log = canlog.read_lcm(path, prefix) if is_lcm else canlog.read(path)
    except InputError as error:
        remarks.append(f"no frames: {error}")
        return None
    remarks.extend(text for text in log.remarks if text not in remarks)
    return log if len(log) else None


def _aligned(run: Path, robot_file: Path | None) -> Table:
    """Rows as the daemon aligns them, from the run's frames and positions."""
    rows = reader.read(run, robot_file).rows
    stacked = np.hstack([np.asarray(x) for x in (rows.acc, rows.gyro, rows.q, rows.position, rows.f)])
    return signals_of(np.rint(1e9 * np.asarray(rows.t)).astype(np.int64), stacked)


def _of_folder(run: Path, robot_file: Path | None, frames: CanLog | None, remarks: list[str]) -> dict[str, Table]:
    """Tables of a run folder, beside those of its log."""
    found = {}
    for name in ("tracker", "signals"):
        if (run / f"{name}.csv").exists():
            found[name] = read_csv(run / f"{name}.csv", name)
    if "signals" not in found and frames is not None:
        try:
            found["signals"] = _aligned(run, robot_file)
        except InputError as error:
            remarks.append(f"no signals: {error}")
    return found


def _robot_of(run: Path, robot_file: Path | None) -> Robot | None:
    try:
        return reader.robot_of(run, robot_file)
    except (InputError, OSError):
        return None


def read(run: Path, robot_file: Path | None, prefix: str, remarks: list[str]) -> Dataset:
    """A run folder, an LCM log or a CAN log. remarks: missing parts and damage.

    InputError: there is nothing in it, or it was written with other message types.
    """
    if not run.exists():
        raise InputError(f"{run}: No such file or directory")
    log = run / "run.lcmlog" if run.is_dir() else run
    is_lcm = log.suffix.lower() in canlog.LCM_FORMATS and log.exists()
    tables = of_lcm(log, prefix, remarks) if is_lcm else {}
    frames = _frames(run, prefix, remarks)
    if run.is_dir():
        tables = _of_folder(run, robot_file, frames, remarks) | tables
    if not tables and frames is None:
        raise InputError(f"{run}: nothing to export: {'; '.join(remarks)}")
    robot = _robot_of(run, robot_file)
    return Dataset({name: tables[name] for name in NAMES if name in tables}, frames, str(run), robot)
