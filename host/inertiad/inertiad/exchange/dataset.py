# SPDX-License-Identifier: Apache-2.0
"""A run as sheets: named columns with units over exact time, whatever file they come from or go to.

signals   t acc_x..z gyro_x..z q_w..z pos_x..z f_1..f_m    aligned rows, as measured, I axes; position of the target, W
tracker   t x y z, of poses q_w..z, of a record valid, t_device_ns   positions of the tracked point, W; attitude P to W
estimate  t mass cog_x..z inertia_cog_xx..xy with _std, systematic errors, n_windows, nis, ...
frames    t bus can_id flags length data                   CAN frames, SocketCAN's identifiers, data in hex
events    t source text
health    t and every counter
CONFIG and HOST, which tell of the daemon and its machine and not of the run, are in none of them.
"""

import csv
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inertiad.base import quantity, units
from inertiad.base.error import InputError
from inertiad.run import canlog, lcmlog
from inertiad.run.canlog import CanLog

NAMES: Final = ("signals", "tracker", "estimate", "frames", "events", "health")
KEY_COLUMN: Final = {"signals": "acc_x", "tracker": "x", "estimate": "mass", "frames": "can_id", "events": "text"}
"""tells what a file is whose name does not say it"""
NS: Final = 1_000_000_000
INERTIA: Final = ("xx", "yy", "zz", "yz", "xz", "xy")

_TEXT: Final = ("bus", "data", "source", "text")
_WHOLE: Final = r"can_id|flags|length|t_ns|t_device_ns|n_\w+"
_FLAGS: Final = ("consistent", "valid")

Values = NDArray[Any]


@dataclass(frozen=True)
class Sheet:
    """Columns of equal length N over time. The unit of each: units.of(name)."""

    name: str
    t_ns: NDArray[np.int64]
    """host time, ns [N]"""
    columns: dict[str, Values]
    """float64, int64, bool or str (as object), by name: typed()"""

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def t(self) -> NDArray[np.float64]:
        """s, as near as a double comes."""
        return np.asarray(self.t_ns * 1e-9, np.float64)


def _truth(value: Any) -> bool:
    return value in (True, 1, "1", "True", "true")


def typed(sheet: str, name: str, values: Iterable[Any]) -> Values:
    """Values of a column, from numbers or their text, in the kind its name has. ValueError: they are not of it."""
    listed = values.tolist() if isinstance(values, np.ndarray) else list(values)
    if name in _TEXT:
        return np.array([str(v) for v in listed], object)
    if name in _FLAGS:
        return np.array([_truth(v) for v in listed], np.bool_)
    if sheet == "health" or re.fullmatch(_WHOLE, name):
        return np.array([int(v) for v in listed], np.int64)
    return np.array([float(v) for v in listed], np.float64)


# ---- from messages and logs ------------------------------------------------------------------------------------------


def _times(messages: list[Any]) -> NDArray[np.int64]:
    return np.array([m.t_ns for m in messages], dtype=np.int64)


def _vectors(names: Iterable[str], values: list[Any]) -> dict[str, Values]:
    table = np.array(values, dtype=np.float64)
    return {name: table[:, i].copy() for i, name in enumerate(names)}


def _scalars(sheet: str, names: Iterable[str], messages: list[Any]) -> dict[str, Values]:
    return {name: typed(sheet, name, [getattr(m, name) for m in messages]) for name in names}


def _signals(messages: list[Any]) -> Sheet:
    rows = [row for message in messages for row in message.row]
    if len({row.n_cables for row in rows}) > 1:
        raise InputError("signals: the number of cables changes within the run: allowed: one robot per run")
    return signals_of(_times(rows), [[*row.acc, *row.gyro, *row.q, *row.position, *row.f] for row in rows])


def signals_of(t_ns: NDArray[np.int64], rows: Any) -> Sheet:
    """The sheet of rows [N, 13 + m]: acc, gyro, q, position, f."""
    table = np.asarray(rows, dtype=np.float64).reshape(len(t_ns), -1)
    forces = quantity.forces(table.shape[1] - 13)
    names = quantity.ACC + quantity.GYRO + quantity.QUATERNION + quantity.POSITION + forces
    return Sheet("signals", t_ns, {name: table[:, i].copy() for i, name in enumerate(names)})


def _tracker(messages: list[Any]) -> Sheet:
    columns = _vectors("xyz", [m.position for m in messages])
    if any(m.has_q for m in messages):
        columns |= _vectors(quantity.QUATERNION, [m.q for m in messages])
    return Sheet("tracker", _times(messages), columns | _scalars("tracker", ("valid", "t_device_ns"), messages))


def _systematic_names(n_cables: int) -> list[str]:
    """The filter's systematic errors, in the order of estimate_t."""
    names = [f"attitude_{a}" for a in "xyz"] + ["world_yaw"] + [f"acc_bias_{a}" for a in "xyz"]
    names += [f"imu_alignment_{a}" for a in "xyz"] + ["position_delay"]
    return names + [f"force_{what}_{i + 1}" for what in ("offset", "gain") for i in range(n_cables)]


def _estimate(messages: list[Any]) -> Sheet:
    columns: dict[str, Values] = {}
    vectors = {
        "cog": [f"cog_{a}" for a in "xyz"],
        "inertia_cog": [f"inertia_cog_{e}" for e in INERTIA],
        "systematic": _systematic_names((len(messages[0].systematic) - 11) // 2),
    }
    for end in ("", "_std"):
        columns |= _scalars("estimate", [f"mass{end}"], messages)
        for field, names in vectors.items():
            columns |= _vectors([f"{name}{end}" for name in names], [getattr(m, f"{field}{end}") for m in messages])
    counts = ("consistent", "distance", "nis", "n_windows", "n_rows", "n_dropped", "n_changes")
    return Sheet("estimate", _times(messages), columns | _scalars("estimate", counts, messages))


def _events(messages: list[Any]) -> Sheet:
    return Sheet("events", _times(messages), _scalars("events", ("source", "text"), messages))


def _health(messages: list[Any]) -> Sheet:
    counted = [{c.name.replace(".", "_"): c.value for c in m.counter} for m in messages]
    names = dict.fromkeys(name for counters in counted for name in counters)
    columns = {name: typed("health", name, [counters.get(name, 0) for counters in counted]) for name in names}
    return Sheet("health", _times(messages), columns)


_OF_CHANNEL: Final[dict[str, tuple[str, Callable[[list[Any]], Sheet]]]] = {
    "SIGNALS": ("signals_t", _signals),
    "TRACKER": ("tracker_t", _tracker),
    "ESTIMATE": ("estimate_t", _estimate),
    "EVENT": ("event_t", _events),
    "HEALTH": ("health_t", _health),
}
_NO_SHEET: Final = ("RAW", "CONFIG", "HOST", "COMMAND")  # frames, settings, the machine; answers to commands are events


def of_lcm(path: Path, prefix: str, remarks: list[str]) -> dict[str, Sheet]:
    """Every sheet of an LCM log's messages, up to its first damage. InputError: a message of another version."""
    import inertiad_lcm

    found: dict[str, list[Any]] = {}
    n_other, without_sheet = 0, set[str]()
    for event in lcmlog.read(path, remarks):
        name = event.channel.removeprefix(prefix)
        if event.channel.startswith(prefix) and name in _OF_CHANNEL:
            kind = getattr(inertiad_lcm, _OF_CHANNEL[name][0])
            found.setdefault(name, []).append(lcmlog.decode(kind, event, path))
        elif not event.channel.startswith(prefix):
            n_other += 1
        elif name not in _NO_SHEET:
            without_sheet.add(event.channel)
    if without_sheet:
        remarks.append(f"{path}: {', '.join(sorted(without_sheet))}: left out, no table holds them")
    if n_other:
        remarks.append(f"{path}: {n_other} messages of other channels than {prefix}... left out")
    sheets = [make(found[name]) for name, (_, make) in _OF_CHANNEL.items() if name in found]
    return {sheet.name: sheet for sheet in sheets if len(sheet)}


def of_frames(log: CanLog) -> Sheet:
    """CAN frames as a sheet; frames_of() is the way back."""
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
    return Sheet("frames", log.t_ns, columns)


def frames_of(sheet: Sheet, source: str) -> CanLog:
    """The frames of a sheet. InputError: a column is missing or is no frame."""
    names = ("can_id", "flags", "data", "bus", "length")
    missing = [name for name in names if name not in sheet.columns]
    if missing:
        raise InputError(f"{source}: frames: no column {missing[0]}: allowed: {', '.join(('t', *names))}")
    lists = [sheet.columns[name].tolist() for name in names]
    try:
        rows: list[canlog.Row] = [
            (t, int(i), int(f), bytes.fromhex(d), str(b), int(n))
            for t, i, f, d, b, n in zip(sheet.t_ns.tolist(), *lists, strict=True)
        ]
        return canlog.from_rows(rows, source)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{source}: frames: {error}") from None


# ---- CSV -------------------------------------------------------------------------------------------------------------


def time_text(t_ns: int) -> str:
    """s with nine decimals, exact."""
    sign, size = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{size // NS}.{size % NS:09d}"


def _time_ns(text: str) -> int:
    match = re.fullmatch(r"([+-]?)(\d+)(?:\.(\d{1,9})0*)?", text.strip())
    if not match:
        return round(float(text) * 1e9)
    size = int(match[2]) * NS + int((match[3] or "0").ljust(9, "0"))
    return -size if match[1] == "-" else size


def write_csv(path: Path, sheet: Sheet, with_units: bool = True) -> None:
    """One sheet; every number reads back the same. with_units: acc_x [m/s2] instead of acc_x."""
    names = ("t", *sheet.columns)
    lists = [v.astype(np.int64).tolist() if v.dtype == np.bool_ else v.tolist() for v in sheet.columns.values()]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(map(units.head, names) if with_units else names)
        writer.writerows(zip(map(time_text, sheet.t_ns.tolist()), *lists, strict=True))


def name_of(columns: Iterable[str]) -> str:
    """Which sheet has such columns."""
    known = set(columns)
    return next((name for name, key in KEY_COLUMN.items() if key in known), "health")


def _read_cells(path: Path) -> tuple[list[str], list[list[str]]]:
    """Heads and columns of a CSV file."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            rows = [row for row in csv.reader(file) if row]
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"{path}: not CSV: {error}") from None
    heads = rows[0] if rows else []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(heads):
            raise InputError(f"{path}: line {number}: {len(row)} values: allowed: {len(heads)}, one per column")
    return heads, [list(cells) for cells in zip(*rows[1:], strict=True)] or [[] for _ in heads]


def read_csv(path: Path, name: str | None = None) -> Sheet:
    """A sheet from a CSV file with a column t; heads may have units, others than SI are converted.

    InputError: file and column of what is wrong.
    """
    heads, cells = _read_cells(path)
    split = [units.split(text) for text in heads]
    names = [column for column, _ in split]
    if "t" not in names:
        raise InputError(f"{path}: line 1: no column t: allowed: a header such as {units.head('t')},...")
    found = name or name_of(names)
    columns = {}
    for (column, unit), values in zip(split, cells, strict=True):
        per_unit = units.factor(column, unit, str(path))
        try:
            if column == "t":
                t_ns = np.array([_time_ns(cell) for cell in values], np.int64)
            else:
                columns[column] = typed(found, column, values)
        except ValueError as error:
            raise InputError(f"{path}: {column}: {error}: allowed: a number") from None
        if per_unit != 1.0 and column == "t":
            t_ns = np.rint(t_ns * per_unit).astype(np.int64)
        elif per_unit != 1.0:
            columns[column] = columns[column] * per_unit
    return Sheet(found, t_ns, columns)


# ---- a run -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Dataset:
    """Everything of a run that can be exported."""

    sheets: dict[str, Sheet]
    """by name, in the order of NAMES; frames not among them"""
    frames: CanLog | None
    source: str

    def all(self) -> Iterator[Sheet]:
        """Every sheet, that of the frames included."""
        whole = self.sheets | ({"frames": of_frames(self.frames)} if self.frames is not None else {})
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


def _aligned(run: Path, robot_file: Path | None) -> Sheet:
    """Rows as the daemon aligns them, from the run's frames and positions."""
    from inertiad.run import reader

    rows = reader.read(run, robot_file).rows
    table = np.hstack([np.asarray(x) for x in (rows.acc, rows.gyro, rows.q, rows.position, rows.f)])
    return signals_of(np.rint(1e9 * np.asarray(rows.t)).astype(np.int64), table)


def _of_folder(run: Path, robot_file: Path | None, frames: CanLog | None, remarks: list[str]) -> dict[str, Sheet]:
    """What lies in a run folder beside its log."""
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


def read(run: Path, robot_file: Path | None, prefix: str, remarks: list[str]) -> Dataset:
    """A run folder, an LCM log or a CAN log. What it lacks or where it is damaged is told in remarks.

    InputError: there is nothing in it, or it was written with other message types.
    """
    if not run.exists():
        raise InputError(f"{run}: No such file or directory")
    log = run / "run.lcmlog" if run.is_dir() else run
    is_lcm = log.suffix.lower() in canlog.LCM_FORMATS and log.exists()
    sheets = of_lcm(log, prefix, remarks) if is_lcm else {}
    frames = _frames(run, prefix, remarks)
    if run.is_dir():
        sheets = _of_folder(run, robot_file, frames, remarks) | sheets
    if not sheets and frames is None:
        raise InputError(f"{run}: nothing to export: {'; '.join(remarks)}")
    return Dataset({name: sheets[name] for name in NAMES if name in sheets}, frames, str(run))
