# SPDX-License-Identifier: Apache-2.0
"""File formats of other tools, each with its writer and, beside it, its reader.

csv       one file per table: FILE holds the first, FILE's stem.TABLE.csv the others; heads with units
parquet   likewise; the unit is the metadata "unit" of each field
mcap      a channel per table, JSON messages with a JSON schema whose descriptions are the units: PlotJuggler, Foxglove;
          the robot in motion as Foxglove's messages (foxglove.py); beside it FILE's stem.foxglove.json and
          stem.plotjuggler.xml, layouts for Foxglove or Lichtblick and for PlotJuggler
mat       MATLAB 5: a struct per table, and a struct units; t in s, t_ns exact
mf4       ASAM MDF 4.1: a channel group per table, t_ns exact; CAN frames as bus logging, for tools that know DBC
candump   can-utils' log: the frames alone, stamps in us
"""

import gc
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np

from inertiad.base import extras, units
from inertiad.base.error import InputError
from inertiad.base.table import Table, at_ns
from inertiad.exchange import dataset, foxglove, layouts
from inertiad.exchange.dataset import Dataset
from inertiad.exchange.mcap_file import mcap_messages
from inertiad.run import canlog
from inertiad.run.canlog import CanLog

LAYOUTS: Final = (".foxglove.json", ".plotjuggler.xml")
"""endings of the layouts beside an MCAP file"""
NOTE: Final = "inertiad: SI units; W world, z up; I sensor axes; inertia as matrix entries about the CoG"


def dataset_of(found: list[Table], source: str, frames: CanLog | None = None) -> Dataset:
    """Dataset of a file's tables; a table of frames becomes CAN frames again. InputError: nothing, or it is damaged."""
    by_name = {table.name: table for table in found if len(table)}
    if "frames" in by_name:
        frames = dataset.frames_of(by_name.pop("frames"), source)
    if not by_name and frames is None:
        raise InputError(f"{source}: nothing of a run in it")
    return Dataset({name: by_name[name] for name in dataset.NAMES if name in by_name}, frames, source)


def _table(name: str, columns: dict[str, Any], source: str) -> Table:
    """A table from columns as a reader gives them; t_ns is exact, t serves where it is missing."""
    exact, t = columns.pop("t_ns", None), columns.pop("t", None)
    try:
        t_ns = (
            np.asarray(exact, np.int64) if exact is not None else np.rint(1e9 * np.asarray(t, float)).astype(np.int64)
        )
        return at_ns(name, t_ns, {key: dataset.typed(name, key, values) for key, values in columns.items()})
    except (TypeError, ValueError) as error:
        raise InputError(f"{source}: {name}: {error}") from None


# ---- one file per table: CSV, Parquet --------------------------------------------------------------------------------


def _beside(path: Path, name: str) -> Path:
    return path.with_name(f"{path.stem}.{name}{path.suffix}")


def all_written(path: Path) -> list[Path]:
    """Every file that a writer of FORMATS may write for path."""
    beside = [path.with_suffix(ending) for ending in LAYOUTS]
    return [path, *(_beside(path, name) for name in dataset.NAMES), *beside]


def _write_each(path: Path, data: Dataset, write: Callable[[Path, Table], None]) -> list[Path]:
    written: list[Path] = []
    for table in data.all():
        target = _beside(path, table.name) if written else path
        write(target, table)
        written.append(target)
    return written


def _read_each(path: Path, read: Callable[[Path], Table]) -> Dataset:
    beside = [_beside(path, name) for name in dataset.NAMES]
    return dataset_of([read(file) for file in (path, *beside) if file.exists()], str(path))


def write_csv(path: Path, data: Dataset) -> list[Path]:
    """Comma-separated text."""
    return _write_each(path, data, dataset.write_csv)


def read_csv(path: Path) -> Dataset:
    """The CSV files of an export, or one CSV file from anywhere."""
    return _read_each(path, dataset.read_csv)


def _write_parquet_table(path: Path, table: Table) -> None:
    arrow = extras.load("pyarrow", "parquet")
    columns = {"t": table.t, "t_ns": table.t_ns, **table.columns}
    arrays = {name: arrow.array(values) for name, values in columns.items()}
    fields = [arrow.field(name, a.type, metadata={"unit": units.of(name)}) for name, a in arrays.items()]
    schema = arrow.schema(fields, metadata={"sheet": table.name, "note": NOTE})
    extras.load("pyarrow.parquet", "parquet").write_table(
        arrow.table(arrays, schema=schema), path, write_page_checksum=True
    )


def parquet_table(path: Path) -> Any:
    """A Parquet file as an arrow table, its pages' checksums checked. InputError: damaged."""
    arrow = extras.load("pyarrow", "parquet")
    try:
        return extras.load("pyarrow.parquet", "parquet").read_table(path, page_checksum_verification=True)
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise InputError(f"{path}: not a usable Parquet file: {' '.join(str(error).split())}") from None


def _read_parquet_table(path: Path) -> Table:
    table = parquet_table(path)
    if not {"t", "t_ns"} & set(table.column_names):
        raise InputError(f"{path}: no column t: allowed: t in s, or t_ns")
    metadata = table.schema.metadata or {}
    name = metadata.get(b"sheet", dataset.name_of(table.column_names).encode()).decode()
    return _table(name, {key: table[key].to_pylist() for key in table.column_names}, str(path))


def write_parquet(path: Path, data: Dataset) -> list[Path]:
    """Apache Parquet."""
    return _write_each(path, data, _write_parquet_table)


def read_parquet(path: Path) -> Dataset:
    """The Parquet files of an export, or one from anywhere."""
    return _read_each(path, _read_parquet_table)


# ---- MCAP ------------------------------------------------------------------------------------------------------------

_JSON_TYPE: Final = {"f": ["number", "null"], "i": "integer", "b": "boolean", "O": "string"}


def _json_schema(table: Table) -> bytes:
    properties = {
        name: {"type": _JSON_TYPE[values.dtype.kind], "description": units.of(name)}
        for name, values in table.columns.items()
    }
    stamp = {"type": "integer", "description": "ns"}
    schema = {"title": table.name, "type": "object", "properties": {"t_ns": stamp, **properties}, "description": NOTE}
    return json.dumps(schema).encode()


def _finite_or_none(values: Any) -> list[Any]:
    """JSON knows no NaN."""
    listed = values.tolist()
    return [v if np.isfinite(v) else None for v in listed] if values.dtype.kind == "f" else listed


def write_mcap(path: Path, data: Dataset) -> list[Path]:
    """MCAP with JSON messages; log time is host time."""
    Writer = extras.load("mcap.writer", "mcap").Writer
    drawn = _drawn(data)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="inertiad")
        for table in data.all():
            schema = writer.register_schema(table.name, "jsonschema", _json_schema(table))
            channel = writer.register_channel(f"/{table.name}", "json", schema)
            names = ("t_ns", *table.columns)
            lists = [table.t_ns.tolist(), *map(_finite_or_none, table.columns.values())]
            for k, row in enumerate(zip(*lists, strict=True)):
                message = json.dumps(dict(zip(names, row, strict=True))).encode()
                writer.add_message(channel, max(row[0], 0), message, max(row[0], 0), k)
            writer.add_metadata(f"units of {table.name}", {name: units.of(name) for name in names})
        _write_drawn(writer, drawn)
        writer.finish()
    beside = tuple(path.with_suffix(ending) for ending in LAYOUTS)
    beside[0].write_text(layouts.foxglove(data, bool(drawn)), encoding="utf-8")
    beside[1].write_text(layouts.plotjuggler(data), encoding="utf-8")
    return [path, *beside]


def _drawn(data: Dataset) -> list[foxglove.Message]:
    """The robot in motion; none where its description is missing."""
    extras.load("foxglove_schemas_protobuf", "mcap")
    return [] if data.robot is None else list(foxglove.messages(data, data.robot))


def _write_drawn(writer: Any, drawn: list[foxglove.Message]) -> None:
    register = extras.load("mcap_protobuf.schema", "mcap").register_schema
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for number, message in enumerate(drawn):
        kind = message.data.DESCRIPTOR.full_name
        if kind not in schemas:
            schemas[kind] = register(writer, type(message.data))
        if message.topic not in channels:
            channels[message.topic] = writer.register_channel(message.topic, "protobuf", schemas[kind])
        stamp = max(message.t_ns, 0)
        writer.add_message(channels[message.topic], stamp, message.data.SerializeToString(), stamp, number)


def read_mcap(path: Path) -> Dataset:
    """The JSON channels of an MCAP file. InputError: damaged, or no JSON in it."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for _, channel, message in mcap_messages(path):
        if channel.message_encoding == "json":
            stamp = {"t_ns": message.log_time}
            rows.setdefault(channel.topic.strip("/"), []).append(stamp | json.loads(message.data))
    found = []
    for topic, listed in rows.items():
        name = topic if topic in dataset.NAMES else dataset.name_of(listed[0])
        columns = {key: [np.nan if row.get(key) is None else row[key] for row in listed] for key in listed[0]}
        found.append(_table(name, columns, str(path)))
    return dataset_of(found, str(path))


# ---- MATLAB ----------------------------------------------------------------------------------------------------------


def write_mat(path: Path, data: Dataset) -> list[Path]:
    """MATLAB 5: every column is N x 1; text is a cell array."""
    from scipy.io import savemat

    contents: dict[str, Any] = {"note": NOTE}
    named: dict[str, dict[str, str]] = {}
    for table in data.all():
        columns = {"t": table.t, "t_ns": table.t_ns, **table.columns}
        contents[table.name] = {name: values.reshape(-1, 1) for name, values in columns.items()}
        named[table.name] = {name: units.of(name) for name in columns}
    savemat(path, contents | {"units": named}, long_field_names=True, do_compression=True)
    return [path]


def _mat_column(values: Any) -> list[Any]:
    flat = np.asarray(values).ravel()
    return ["".join(np.asarray(cell).ravel().tolist()) for cell in flat] if flat.dtype == object else flat.tolist()


def read_mat(path: Path) -> Dataset:
    """The structs of a MATLAB 5 file that have a column t."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        contents = loadmat(path)
    except (ValueError, NotImplementedError, MatReadError, OSError, TypeError) as error:
        raise InputError(f"{path}: not a usable MATLAB 5 file: {error}") from None
    found = []
    for name in dataset.NAMES:
        if name in contents and contents[name].dtype.names and {"t", "t_ns"} & set(contents[name].dtype.names):
            struct = contents[name][0, 0]
            columns = {key: _mat_column(struct[key]) for key in struct.dtype.names}
            found.append(_table(name, columns, str(path)))
    return dataset_of(found, str(path))


# ---- ASAM MDF --------------------------------------------------------------------------------------------------------

MDF_MASTERS: Final = (2, 3)
"""types of channels that are the time itself, stored or virtual"""
_FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_FRAME_KINDS: Final = (("CAN_DataFrame", 0), ("CAN_RemoteFrame", canlog.REMOTE), ("CAN_ErrorFrame", canlog.ERROR))


FRAME_NAMES: Final = tuple(name for name, _ in _FRAME_KINDS)


def _start_us(data: Dataset) -> int:
    """Host time at which the file begins, us: MDF's times are seconds from there."""
    times = [table.t_ns for table in data.tables.values()] + ([data.frames.t_ns] if data.frames is not None else [])
    return min(int(t.min()) for t in times) // 1000


def _bus_records(log: CanLog, kind: str) -> Any:
    """Frames as the structured array that MDF's bus logging asks for."""
    width = log.data.shape[1]
    fields = [
        (f"{kind}.{name}", "<u1") for name in ("BusChannel", "IDE", "DLC", "DataLength", "EDL", "BRS", "ESI", "Dir")
    ]
    records = np.zeros(len(log), [*fields, (f"{kind}.ID", "<u4"), (f"{kind}.DataBytes", "<u1", (width,))])
    dlc = np.searchsorted(_FD_LENGTHS, log.length)
    is_remote = kind == "CAN_RemoteFrame"
    extended = (log.can_id & np.uint32(canlog.EXTENDED)) != 0
    values = {
        "BusChannel": log.bus,
        "ID": log.can_id & np.uint32(0x1FFFFFFF),
        "IDE": extended,
        "DLC": dlc,
        "DataLength": np.where(is_remote, 0, log.length),
        "EDL": (log.flags & canlog.FD) != 0,
        "BRS": (log.flags & canlog.BRS) != 0,
        "ESI": (log.flags & canlog.ESI) != 0,
        "DataBytes": log.data,
    }
    for name, column in values.items():
        records[f"{kind}.{name}"] = column
    return records


def _append_frames(mdf: Any, log: CanLog, start_us: int) -> None:
    from asammdf import Signal, Source

    bus = Source(name="CAN", path="CAN", comment="", source_type=2, bus_type=2)  # a bus, CAN
    for kind, bit in _FRAME_KINDS:
        chosen = (log.can_id & np.uint32(canlog.REMOTE | canlog.ERROR)) == np.uint32(bit)
        if not chosen.any() and bit:
            continue
        part = log[chosen]
        seconds = 1e-9 * (part.t_ns - 1000 * start_us)
        mdf.append(Signal(samples=_bus_records(part, kind), timestamps=seconds, name=kind, source=bus), comment=kind)


def _mf4_samples(values: Any) -> Any:
    if values.dtype == object:
        encoded = [text.encode() for text in values]
        return np.array(encoded, dtype=f"S{max(1, *map(len, encoded))}")
    return values.astype(np.uint8) if values.dtype == np.bool_ else values


def write_mf4(path: Path, data: Dataset) -> list[Path]:
    """ASAM MDF 4.10."""
    from asammdf import MDF, Signal

    start_us = _start_us(data)
    with MDF(version="4.10") as mdf:
        mdf.header.start_time = _EPOCH + timedelta(microseconds=start_us)
        mdf.header.comment = NOTE
        for table in data.tables.values():
            seconds = 1e-9 * (table.t_ns - 1000 * start_us)
            group = [
                Signal(
                    _mf4_samples(v), seconds, unit=units.of(n), name=n, encoding="utf-8" if v.dtype == object else None
                )
                for n, v in {"t_ns": table.t_ns, **table.columns}.items()
            ]
            mdf.append(group, acq_name=table.name, comment=table.name, common_timebase=True)
        if data.frames is not None:
            _append_frames(mdf, data.frames, start_us)
        mdf.save(path, overwrite=True, compression=1)
    return [path]


def _mf4_table(mdf: Any, index: int, name: str, start_us: int) -> Table:
    channels = mdf.groups[index].channels
    signals = mdf.select([(None, index, k) for k, c in enumerate(channels) if c.channel_type not in MDF_MASTERS])
    columns = {
        s.name: [v.decode() for v in s.samples.tolist()] if s.samples.dtype.kind == "S" else s.samples for s in signals
    }
    t_ns = 1000 * start_us + np.rint(1e9 * signals[0].timestamps).astype(np.int64)
    return _table(name, {"t_ns": t_ns} | columns, str(mdf.name))


@contextmanager
def silent_destructors() -> Iterator[None]:
    """asammdf prints a traceback when it drops a file that it could not open."""
    was, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        yield
    finally:
        gc.collect()
        sys.unraisablehook = was


def read_mf4(path: Path) -> Dataset:
    """The channel groups named as tables, and the logged CAN frames."""
    with silent_destructors():
        found, has_frames, reason = _read_mf4(path)
    if reason:
        raise InputError(f"{path}: not a usable MDF 4 file: {reason}")
    return dataset_of(found, str(path), canlog.read(path) if has_frames else None)


def _read_mf4(path: Path) -> tuple[list[Table], bool, str]:
    """Sheets, whether there are frames, and why it is not usable, "" if it is."""
    from asammdf import MDF

    try:
        with MDF(path) as opened:
            mdf: Any = opened
            names = [group.channel_group.acq_name for group in mdf.groups]
            has_frames = any(c.name in dict(_FRAME_KINDS) for group in mdf.groups for c in group.channels)
            start_us = (mdf.header.start_time - _EPOCH) // timedelta(microseconds=1)
            return [_mf4_table(mdf, i, n, start_us) for i, n in enumerate(names) if n in dataset.NAMES], has_frames, ""
    except InputError:
        raise
    except Exception as error:  # its reader raises several unrelated types
        return [], False, " ".join(str(error).split()) or type(error).__name__


# ---- CAN logs --------------------------------------------------------------------------------------------------------


def write_candump(path: Path, data: Dataset) -> list[Path]:
    """The frames as candump lines. InputError: the run has none."""
    if data.frames is None:
        raise InputError(f"{data.source}: it has no CAN frames, so candump cannot be written")
    path.write_bytes(b"".join(canlog.lines(data.frames)))
    return [path]


def read_can(path: Path) -> Dataset:
    """The frames of a CAN log of any kind that canlog reads."""
    return dataset_of([], str(path), canlog.read(path))


@dataclass(frozen=True)
class Format:
    """A file format by name."""

    write: Callable[[Path, Dataset], list[Path]]
    """returns the files written: one per table, or the file and what belongs to it"""
    read: Callable[[Path], Dataset]
    ending: str
    is_per_table: bool = False


FORMATS: Final = {
    "csv": Format(write_csv, read_csv, ".csv", True),
    "parquet": Format(write_parquet, read_parquet, ".parquet", True),
    "mcap": Format(write_mcap, read_mcap, ".mcap"),
    "mat": Format(write_mat, read_mat, ".mat"),
    "mf4": Format(write_mf4, read_mf4, ".mf4"),
    "candump": Format(write_candump, read_can, ".log"),
}
