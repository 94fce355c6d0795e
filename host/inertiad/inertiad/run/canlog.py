# SPDX-License-Identifier: Apache-2.0
"""CAN logs as arrays: candump, Vector ASC and BLF, PEAK TRC, ASAM MF4, and the RAW messages of an LCM log."""

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import inertiad_replay
from inertiad.base import extras, python_can
from inertiad.base.channels import DEFAULT_PREFIX
from inertiad.base.error import InputError

EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
"""bits of an identifier in SocketCAN's layout"""
FD, BRS, ESI = 1, 2, 4
"""bits of flags, as in can_frame_t"""

OTHER_FORMATS: Final = (".asc", ".blf", ".trc", ".mf4")
LCM_FORMATS: Final = (".lcmlog", ".lcm")
LENGTH_MAX: Final = 64
"""bytes of a frame, CAN FD"""


@dataclass(frozen=True)
class CanLog:
    """N frames in the order of the log."""

    t_ns: NDArray[np.int64]
    """host time of each, ns"""
    can_id: NDArray[np.uint32]
    """SocketCAN's layout"""
    flags: NDArray[np.uint8]
    length: NDArray[np.uint8]
    bus: NDArray[np.uint8]
    """index into names"""
    data: NDArray[np.uint8]
    """[N, 8 or 64], zero past each frame's length"""
    names: tuple[str, ...]
    """interfaces, sorted"""
    source: str
    remarks: tuple[str, ...] = ()
    """damage of the log, one line each"""
    n_damaged: int = 0
    """lines or records that are no frame"""

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, chosen: Any) -> "CanLog":
        """The frames a mask or index chooses."""
        fields = ("t_ns", "can_id", "flags", "length", "bus", "data")
        return replace(self, **{name: getattr(self, name)[chosen] for name in fields})


def _by_name(log: CanLog) -> CanLog:
    """The same log with its interfaces in the order of their names: can0, can1, ..., can10."""
    order = sorted(range(len(log.names)), key=lambda i: (len(log.names[i]), log.names[i]))
    rank = np.zeros(max(len(order), 1), dtype=np.uint8)
    rank[order] = np.arange(len(order), dtype=np.uint8)
    return replace(log, bus=rank[log.bus], names=tuple(log.names[i] for i in order))


def read_candump(path: Path) -> CanLog:
    """A candump log; damaged lines are left out and counted."""
    found = inertiad_replay.parse_candump(path.read_bytes())
    remarks = []
    if found["n_bad"]:
        remarks.append(
            f"{path}: {found['n_bad']} lines left out, the first: {found['first_bad']}: {found['first_reason']}"
        )
    if found["n_reported_lost"]:
        remarks.append(f"{path}: the logger reports {found['n_reported_lost']} lost frames")
    arrays = {name: found[name] for name in ("t_ns", "can_id", "flags", "length", "bus", "data")}
    names = tuple(found["names"])
    return _by_name(CanLog(**arrays, names=names, source=str(path), remarks=tuple(remarks), n_damaged=found["n_bad"]))


Row = tuple[int, int, int, bytes, str, int]
"""t_ns, can_id, flags, data, interface, length"""


def from_rows(rows: Iterable[Row], source: str, remarks: tuple[str, ...] = ()) -> CanLog:
    """A log from frames one by one."""
    listed = list(rows)
    n, width = len(listed), 64 if any(row[5] > 8 for row in listed) else 8
    names = list(dict.fromkeys(row[4] for row in listed))
    number = {name: i for i, name in enumerate(names)}
    data = b"".join(row[3].ljust(width, b"\0") for row in listed)
    log = CanLog(
        np.array([row[0] for row in listed], dtype=np.int64),
        np.array([row[1] for row in listed], dtype=np.uint32),
        np.array([row[2] for row in listed], dtype=np.uint8),
        np.array([row[5] for row in listed], dtype=np.uint8),
        np.array([number[row[4]] for row in listed], dtype=np.uint8),
        np.frombuffer(data, dtype=np.uint8).reshape(n, width).copy(),
        tuple(names),
        source,
        remarks,
        len(remarks),
    )
    return _by_name(log)


def _row(message: Any) -> Row:
    """A python-can message."""
    can_id = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
    can_id |= (REMOTE if message.is_remote_frame else 0) | (ERROR if message.is_error_frame else 0)
    flags = 0 if not message.is_fd else FD | BRS * message.bitrate_switch | ESI * message.error_state_indicator
    channel = message.channel
    name = f"can{0 if channel is None else channel}" if not isinstance(channel, str) else channel
    data = b"" if message.is_remote_frame else bytes(message.data)
    return round(1e9 * message.timestamp), can_id, flags, data, name, message.dlc


def _until_damage(messages: Iterable[Any], remarks: list[str], path: Path) -> Iterator[Row]:
    """Frames up to the first record that cannot be read; remarks name it."""
    n = 0
    try:
        for message in messages:
            yield _row(message)
            n += 1
    except Exception as error:  # each format's reader raises its own types
        remarks.append(f"{path}: damaged after frame {n}: {' '.join(str(error).split())}")


def _read_other(path: Path) -> CanLog:
    if path.suffix.lower() == ".mf4":
        extras.require("asammdf", f"{path}: MF4")
    can = python_can.load()
    remarks: list[str] = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with python_can.mf4_reader(path) if path.suffix.lower() == ".mf4" else can.LogReader(path) as reader:
                rows = list(_until_damage(reader, remarks, path))
    except OSError:
        raise
    except Exception as error:
        raise InputError(f"{path}: not a usable {path.suffix} log: {' '.join(str(error).split())}") from None
    return from_rows(rows, str(path), tuple(remarks))


def _raw_rows(path: Path, prefix: str, remarks: list[str]) -> Iterator[Row]:
    from inertiad.run import lcmlog
    from inertiad_lcm import raw_t

    n_bad = 0
    for event in lcmlog.read(path, remarks):
        if event.channel != f"{prefix}RAW":
            continue
        for f in lcmlog.decode(raw_t, event, path).frame:
            if not 0 <= f.length == len(f.data) <= LENGTH_MAX:
                n_bad += 1
                continue
            yield f.t_ns, f.can_id & 0xFFFFFFFF, f.flags & 0xFF, bytes(f.data), f"can{f.bus}", f.length
    if n_bad:
        remarks.append(f"{path}: {n_bad} frames of {prefix}RAW left out: their length is not 0 to {LENGTH_MAX}")


def read_lcm(path: Path, prefix: str = DEFAULT_PREFIX) -> CanLog:
    """The frames of an LCM log's RAW messages."""
    remarks: list[str] = []
    rows = list(_raw_rows(path, prefix, remarks))
    return from_rows(rows, str(path), tuple(remarks))


def read(path: Path) -> CanLog:
    """A log of any known format, by its name's ending. InputError: unknown format, no frame in it."""
    ending = path.suffix.lower()
    if not path.exists():
        raise InputError(f"{path}: No such file or directory")
    if ending in OTHER_FORMATS:
        log = _read_other(path)
    elif ending in LCM_FORMATS:
        log = read_lcm(path)
    elif ending in (".log", ".txt", ""):
        log = read_candump(path)
    else:
        raise InputError(f"{path}: format: allowed: .log, {', '.join((*OTHER_FORMATS, *LCM_FORMATS))}")
    if len(log) == 0:
        why = f": {log.remarks[0]}" if log.remarks else ""
        raise InputError(f"{path}: no CAN frame in it{why}")
    return log


def find(run: Path) -> Path:
    """The CAN log of a run folder, or the file itself. InputError if there is none."""
    if run.is_file():
        return run
    if not run.is_dir():
        raise InputError(f"{run}: No such file or directory")
    names = ["can.log", *(f"can{ending}" for ending in OTHER_FORMATS), "run.lcmlog"]
    for name in names:
        if (run / name).exists():
            return run / name
    raise InputError(f"{run}: no CAN log: allowed: one of {', '.join(names)}")


def lines(log: CanLog) -> list[bytes]:
    """The log as candump lines, stamps in microseconds."""
    seconds, micros = np.divmod(log.t_ns // 1000, 1_000_000)
    columns = (seconds, micros, log.can_id, log.flags, log.length, log.bus)
    width = log.data.shape[1]
    text = log.data.tobytes().hex().upper()
    result = []
    for k, (s, us, can_id, flags, n, bus) in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
        wide = can_id & (EXTENDED | ERROR)
        name = f"{can_id & 0x3FFFFFFF:08X}" if wide else f"{can_id & 0x7FF:03X}"
        if can_id & REMOTE:
            body = f"#R{n if n else ''}"
            name = f"{can_id & 0x1FFFFFFF:08X}" if wide else name
        else:
            mark = f"##{flags >> 1:X}" if flags & FD else "#"
            body = mark + text[2 * k * width : 2 * (k * width + n)]
        result.append(f"({s:010d}.{us:06d}) {log.names[bus]} {name}{body}\n".encode())
    return result


def wire(log: CanLog) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Frames as a SocketCAN raw socket takes them: all bytes, and where each frame begins [N + 1]."""
    n = len(log)
    table = np.zeros((n, 72), dtype=np.uint8)
    table[:, 0:4] = log.can_id.astype("<u4").view(np.uint8).reshape(n, 4)
    table[:, 4] = log.length
    is_fd = (log.flags & FD) != 0
    table[:, 5] = np.where(is_fd, (log.flags >> 1) & 3, 0)
    table[:, 8 : 8 + log.data.shape[1]] = log.data
    size = np.where(is_fd, 72, 16)
    keep = np.arange(72)[None, :] < size[:, None]
    return table[keep], np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
