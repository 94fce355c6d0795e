# SPDX-License-Identifier: Apache-2.0
"""Parquet, MATLAB (5 and 7.3) and MDF files of other tools as channels, each over its own time.

Where a table or a struct has a column of time, its other columns of the same length are channels over it. A cell
without a value is no sample, so sensors of different rates in one table keep their own. Matrices of N rows become
columns: x y z of three, 0 .. 3 of four (a quaternion, w first), 1 .. k of others.
"""

import contextlib
import itertools
import struct
import traceback
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from inertiad.base import units
from inertiad.base.error import InputError
from inertiad.base.recognition import recognise
from inertiad.base.table import Array
from inertiad.exchange import dataset, file_formats
from inertiad.exchange.foreign_csv import Channel, split_head

EXPANDS_MOST: Final = 1000.0
"""bytes of content per byte of file: real recordings compress tenfold at most"""
EXPANDS_FROM: Final = 100e6
"""bytes of content below which nothing is refused"""
MAT5_HEAD: Final = 128
OPAQUE_BYTES: Final = 1024
"""bytes of a variable that hold the names of an object and its class"""
MI_COMPRESSED: Final = 15
DATA_CLASSES: Final = ("table", "timetable", "timeseries", "datetime", "duration")
"""of MATLAB, whose objects may hold what is wanted; others, as string, are left out"""
MX_OPAQUE: Final = b"\x11"
AXES: Final = {3: ("x", "y", "z"), 4: ("0", "1", "2", "3")}
Column = tuple[str, str, Array]
"""name, unit, values [N]"""


def in_order(path: Path, name: str, unit: str, t: Array, value: Array) -> Channel | None:
    """A channel of finite samples by increasing time; None: there is none. InputError: a time is there twice."""
    there = np.isfinite(t) & np.isfinite(value)
    t, value = t[there], value[there]
    if not len(t):
        return None
    order = np.argsort(t, kind="stable")
    t, value = t[order], value[order]
    twice = np.flatnonzero(np.diff(t) <= 0.0)
    if len(twice):
        raise InputError(f"{path}: {name}: two samples at t = {t[twice[0]]:.9g} s: allowed: one")
    return Channel(name, unit, t, value)


def over_time(path: Path, columns: list[Column], time: str | None, time_unit: str | None) -> Iterator[Channel]:
    """Channels of columns that belong together; none where none of them is a time."""
    named = [c for c in columns if (recognise(c[0].rpartition(".")[2], c[1]) == "t" if time is None else c[0] == time)]
    if not named:
        return
    name, unit, values = named[0]
    t = units.factor("t", time_unit or unit, f"{path}: {name}") * values
    for other, own_unit, own in columns:
        if other != name and len(own) == len(t):
            channel = in_order(path, other, own_unit, t, own)
            if channel is not None:
                yield channel


def needs_time(path: Path, found: list[Channel], names: list[str], time: str | None) -> list[Channel]:
    """The channels. InputError: none, as no column of time is there."""
    if not found and any(recognise(name.rpartition(".")[2]) == "t" if time is None else name == time for name in names):
        raise InputError(f"{path}: no row of numbers with a time; columns: {', '.join(names[:24])}")
    if not found:
        wanted = "no column of time, as t or time [s]," if time is None else f'no column "{time}"'
        listed = f"; columns: {', '.join(names[:24])}" if names else ""
        raise InputError(f"{path}: {wanted} with columns of numbers beside it{listed}")
    return found


def _objects_in(tree: dict[str, Any], place: str = "") -> Iterator[str]:
    """Names and classes of the MATLAB objects in nested structs."""
    for name, one in tree.items():
        if isinstance(one, dict):
            yield from _objects_in(one, f"{place}{name}.")
        elif isinstance(one, _Object):
            yield f"{place}{name} is a {one.kind}"


def _check_size(path: Path, n_bytes: float) -> None:
    """InputError: the file would expand to far more than a recording can."""
    size = path.stat().st_size
    if n_bytes > EXPANDS_FROM and n_bytes > EXPANDS_MOST * size:
        raise InputError(f"{path}: {size} bytes would expand to {n_bytes:.3g}: not a recording; save it uncompressed")


# ---- Parquet ---------------------------------------------------------------------------------------------------------


def _arrow_values(column: Any) -> Array | None:
    """Numbers of a column, NaN where it has none; times in s. None: neither numbers nor times."""
    import pyarrow

    kind = column.type
    if pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind):
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        whole = column.cast(pyarrow.int64())
        return np.where(whole.is_valid(), scale * whole.fill_null(0).to_numpy(), np.nan)
    if not (pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind) or pyarrow.types.is_boolean(kind)):
        return None
    return np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(), np.float64)


def read_parquet(path: Path, time: str | None, time_unit: str | None) -> list[Channel]:
    """Columns of numbers of a Parquet file."""
    import pyarrow

    table = file_formats.parquet_table(path)
    columns: list[Column] = []
    for field in table.schema:
        values = _arrow_values(table[field.name])
        if values is None:
            continue
        name, unit = split_head(field.name)
        unit = unit or (field.metadata or {}).get(b"unit", b"").decode(errors="replace")
        is_time = pyarrow.types.is_timestamp(field.type) or pyarrow.types.is_duration(field.type)
        columns.append((name, "s" if is_time else unit, values))
    return needs_time(path, list(over_time(path, columns, time, time_unit)), [name for name, *_ in columns], time)


# ---- MATLAB ----------------------------------------------------------------------------------------------------------


def _matrix_columns(name: str, values: Any) -> Iterator[Column]:
    """Columns of a matrix; a row of many numbers is a column."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub" or array.ndim > 2 or array.size < 2:
        return
    array = np.atleast_2d(array.astype(np.float64))
    array = array.T if array.shape[0] == 1 else array
    n = array.shape[1]
    head, unit = split_head(name)
    if n == 1:
        yield head, unit, array[:, 0]
        return
    is_vector = n == 3 and recognise(f"{head}.1") is None
    is_quaternion = n == 4 and recognise(f"{head}.0") == "q_w"
    ends = AXES[n] if is_vector or is_quaternion else tuple(str(k + 1) for k in range(n))
    for k, end in enumerate(ends):
        yield f"{head}.{end}", unit, array[:, k]


def _of_tree(path: Path, tree: dict[str, Any], place: str, time: str | None, unit: str | None) -> Iterator[Channel]:
    """Channels of a struct and of those in it."""
    columns = [c for name, one in tree.items() if not isinstance(one, dict) for c in _matrix_columns(place + name, one)]
    yield from over_time(path, columns, time, unit)
    for name, one in tree.items():
        if isinstance(one, dict):
            yield from _of_tree(path, one, f"{place}{name}.", time, unit)


def _names_in(tree: dict[str, Any], place: str = "") -> Iterator[str]:
    for name, one in tree.items():
        yield from _names_in(one, f"{place}{name}.") if isinstance(one, dict) else [place + name]


def _of_struct(value: Any) -> Any:
    """A value of scipy's as nested dicts: structs of one element, arrays."""
    if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
        only = value.reshape(-1)[0]
        return {name: _of_struct(only[name]) for name in value.dtype.names}
    return value


@dataclass(frozen=True)
class _Object:
    """An object of a MATLAB class, as a table or timeseries: its layout is not published."""

    kind: str


def _mat5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatlabObject

    objects: dict[str, Any] = {name: _Object(kind) for name, kind in _opaque(path)}
    if objects:
        return objects
    _check_size(path, sum(8.0 * float(np.prod(shape)) for _, shape, _ in whosmat(path)))
    found: dict[str, Any] = {}
    for name, value in loadmat(path).items():
        if isinstance(value, MatlabObject):
            found[name] = _Object(str(value.classname))
        elif not name.startswith("__"):
            found[name] = _of_struct(value)
    return found


def _opaque(path: Path) -> Iterator[tuple[str, str]]:
    """Name and class of a MATLAB 5 file's variables that are objects of mxOPAQUE_CLASS, which scipy cannot list."""
    with path.open("rb") as file:
        if file.read(MAT5_HEAD)[-2:] != b"IM":  # little-endian, as every machine of today writes
            return
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack("<II", tag)
            head = file.read(min(size, OPAQUE_BYTES))
            file.seek(size - len(head), 1)
            if kind == MI_COMPRESSED:
                with contextlib.suppress(zlib.error):
                    head = zlib.decompressobj().decompress(head, OPAQUE_BYTES)[8:]
            if head[8:9] == MX_OPAQUE:
                words = list(itertools.islice(_mat5_texts(head[16:]), 3))
                if len(words) == 3 and words[2] not in ("", "FileWrapper__"):
                    yield words[0], words[2]


def _mat5_texts(data: bytes) -> Iterator[str]:
    """The texts of consecutive elements of a MATLAB 5 file."""
    while len(data) >= 8:
        kind, size = struct.unpack("<II", data[:8])
        if kind > 0xFFFF:  # up to four bytes stand within the tag
            text, step = data[4 : 4 + (kind >> 16)], 8
        else:
            text, step = data[8 : 8 + size], 8 + size + -size % 8
        yield text.decode("latin-1")
        data = data[step:]


def _text_of(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _of_group(path: Path, group: Any) -> dict[str, Any]:
    """Structs and matrices of a MATLAB 7.3 file; MATLAB stores matrices by columns."""
    import h5py

    found: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):
            continue
        if "MATLAB_object_decode" in item.attrs and _text_of(item.attrs["MATLAB_class"]) != "struct":
            kind = _text_of(item.attrs["MATLAB_class"])
            found |= {name: _Object(kind)} if kind in DATA_CLASSES else {}
        elif isinstance(item, h5py.Group):
            found[name] = _of_group(path, item)
        elif isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu" and not item.attrs.get("MATLAB_empty", 0):
            _check_size(path, float(item.size) * item.dtype.itemsize)
            found[name] = np.asarray(item[()]).T
    return found


def _mat73(path: Path) -> dict[str, Any]:
    import h5py

    with h5py.File(path, "r") as file:
        return _of_group(path, file)


def _guarded(path: Path, kind: str, read: Callable[[Path], Any]) -> Any:
    """What a reader of another package gives. InputError: it fails, by whatever type of error."""
    try:
        return read(path)
    except InputError:
        raise
    except Exception as error:  # these readers raise many unrelated types on damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        traceback.clear_frames(error.__traceback__)  # else a half-made reader's destructor complains at the end
        raise InputError(f"{path}: not a usable {kind} file: {reason}") from None


def is_hdf5(path: Path) -> bool:
    """Whether a .mat file is of MATLAB 7.3: its head says so, or HDF5's own mark is where it may be."""
    with path.open("rb") as file:
        head = file.read(520)
    return head.startswith((b"MATLAB 7.3", b"\x89HDF")) or head[512:].startswith(b"\x89HDF")


def read_mat(path: Path, time: str | None, time_unit: str | None) -> list[Channel]:
    """Vectors and matrices of a MATLAB file, over the time of their own struct or of the file."""
    tree = _guarded(path, "MATLAB 7.3", _mat73) if is_hdf5(path) else _guarded(path, "MATLAB 5", _mat5)
    objects = list(_objects_in(tree))
    if objects:
        raise InputError(
            f"{path}: {', '.join(objects)}: only MATLAB reads its own classes; there: "
            'parquetwrite("log.parquet", T) for a table or timetable T, T = timeseries2timetable(X) first for a '
            "timeseries; import that, or save without them"
        )
    return needs_time(path, list(_of_tree(path, tree, "", time, time_unit)), list(_names_in(tree)), time)


def is_own_mat(path: Path) -> bool:
    """Whether a MATLAB file is of export: a variable of it is one of a run's tables."""
    from scipy.io import whosmat

    if is_hdf5(path) or _guarded(path, "MATLAB 5", lambda file: list(_opaque(file))):
        return False
    return bool(set(dataset.NAMES) & {name for name, *_ in _guarded(path, "MATLAB 5", whosmat)})


# ---- ASAM MDF --------------------------------------------------------------------------------------------------------


def _mf4_channels(path: Path) -> Iterator[tuple[str, str, Array, Array]]:
    """Name, unit, time and values of each channel of numbers."""
    from asammdf import MDF

    with MDF(path) as opened:
        mdf: Any = opened
        for index, group in enumerate(mdf.groups):
            for k, channel in enumerate(group.channels):
                if channel.channel_type in file_formats.MDF_MASTERS:
                    continue
                signal = mdf.get(group=index, index=k)
                if signal.samples.dtype.kind in "fiub" and signal.samples.ndim == 1:
                    head, unit = split_head(signal.name)
                    times = np.asarray(signal.timestamps, np.float64)
                    yield head, str(signal.unit or unit), times, signal.samples.astype(np.float64)


def read_mf4(path: Path) -> list[Channel]:
    """Channels of an MDF 4 file."""
    with file_formats.silent_destructors():
        found = _guarded(path, "MDF 4", lambda file: list(_mf4_channels(file)))
    channels = [in_order(path, *one) for one in found]
    named = [c for c in channels if c is not None]
    seen: dict[str, int] = {}
    for number, channel in enumerate(named):
        n = seen[channel.name] = seen.get(channel.name, 0) + 1
        if n > 1:
            named[number] = Channel(f"{channel.name} ({n})", channel.unit, channel.t, channel.value)
    if not named:
        raise InputError(f"{path}: no channel of numbers in it")
    return named


def is_own_mf4(path: Path) -> bool:
    """Whether an MDF file is of export, or of a bus logger."""
    from asammdf import MDF

    def names(file: Path) -> set[str]:
        with MDF(file) as opened:
            mdf: Any = opened
            groups = {str(group.channel_group.acq_name) for group in mdf.groups}
            return groups | {str(channel.name) for group in mdf.groups for channel in group.channels}

    with file_formats.silent_destructors():
        found: set[str] = _guarded(path, "MDF 4", names)
    return bool(found & {*dataset.NAMES, *file_formats.FRAME_NAMES})


def is_own_parquet(path: Path) -> bool:
    """Whether a Parquet file is of export, or has the columns of one."""
    schema = file_formats.parquet_table(path).schema
    has_time = bool({"t", "t_ns"} & set(schema.names))
    return b"sheet" in (schema.metadata or {}) or (
        has_time and any(key in schema.names for key in (*dataset.KEY_COLUMN.values(), "f_1"))
    )
