# SPDX-License-Identifier: Apache-2.0
"""Signals over time -> a run folder: CAN frames by the robot's DBC as a candump log, tracker CSV, robot.toml.

Frames are packed a whole column at a time; a signal costs one numpy pass per bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.table import Array, Table
from inertiad.robot import dbc
from inertiad.robot.dbc import Binding
from inertiad.robot.description import Robot, read_data
from inertiad.run import cable_lengths, signals_csv, tracker_csv
from inertiad.run.folder import open_run, write_robot

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

Bits = NDArray[np.uint64]


@dataclass(frozen=True)
class Frames:
    """All frames of one message (and one multiplexer value), one per sample, in order."""

    bus: int
    can_id: int
    """SocketCAN layout, bit 31 set for 29 bits."""
    is_fd: bool
    data: NDArray[np.uint8]
    """[N, length]"""


Stamp = Callable[[Array, list[Frames]], list[NDArray[np.int64]]]
"""Stamps [us] of every frame, from the sample times [s] and the frames of one bus in the order they are sent."""

LOST = -1
"""Stamp of a frame that is not in the log."""


def stamp_exactly(t: Array, frames: list[Frames]) -> list[NDArray[np.int64]]:
    """Every frame carries its sample's time."""
    t_us = np.rint(1e6 * t).astype(np.int64)
    return [t_us] * len(frames)


def bit_positions(signal: Signal) -> list[tuple[int, int]]:
    """(byte, bit) of every bit of a signal, least significant first; DBC numbering, bit 0 least significant."""
    if signal.byte_order == "little_endian":
        return [divmod(signal.start + i, 8) for i in range(signal.length)]
    first = 8 * (signal.start // 8) + 7 - signal.start % 8
    descending = range(first + signal.length - 1, first - 1, -1)
    return [(i // 8, 7 - i % 8) for i in descending]


def put_bits(data: NDArray[np.uint8], signal: Signal, raw: Bits) -> None:
    """Write the low bits of raw [N] into data [N, length] where the signal lies; its bits must be zero before."""
    if data.shape[1] <= 8:
        is_little = signal.byte_order == "little_endian"
        last = signal.start if is_little else 63 - bit_positions(signal)[0][0] * 8 - 7 + bit_positions(signal)[0][1]
        low = raw & np.uint64(2**signal.length - 1)
        word = (low << np.uint64(last)).astype("<u8" if is_little else ">u8")
        data |= word.view(np.uint8).reshape(-1, 8)[:, : data.shape[1]]
        return
    for i, (byte, bit) in enumerate(bit_positions(signal)):
        data[:, byte] |= ((raw >> np.uint64(i) & np.uint64(1)) << np.uint64(bit)).astype(np.uint8)


def _float_bits(signal: Signal, value: Array) -> Bits:
    if signal.length == 32:
        return value.astype(np.float32).view(np.uint32).astype(np.uint64)
    return value.view(np.uint64)


def _raw_range(signal: Signal) -> tuple[float, float]:
    if signal.is_float:
        top = float(np.finfo(np.float32 if signal.length == 32 else np.float64).max)
        return -top, top
    if signal.is_signed:
        return -(2.0 ** (signal.length - 1)), 2.0 ** (signal.length - 1) - 1.0
    return 0.0, 2.0**signal.length - 1.0


def raw_of(binding: Binding, t: Array, value: Array, source: str) -> Bits:
    """Raw bits [N] of a quantity's values [N] in SI. InputError if a value does not fit the signal."""
    signal = binding.signal
    counts = (value - binding.offset) / binding.scale
    counts = counts if signal.is_float else np.rint(counts)
    low, high = _raw_range(signal)
    outside = (counts < low) | (counts > high)
    if binding.minimum < binding.maximum:
        outside |= (value < binding.minimum) | (value > binding.maximum)
    if outside.any():
        raise InputError(_does_not_fit(binding, t, value, int(np.argmax(outside)), source))
    if signal.is_float:
        return _float_bits(signal, counts)
    return counts.astype(np.uint64 if not signal.is_signed else np.int64).view(np.uint64)


def _does_not_fit(binding: Binding, t: Array, value: Array, at: int, source: str) -> str:
    low, high = sorted(c * binding.scale + binding.offset for c in _raw_range(binding.signal))
    if binding.minimum < binding.maximum:
        low, high = max(low, binding.minimum), min(high, binding.maximum)
    return (
        f"{source}: t = {t[at]:.6f} s: {binding.quantity} = {value[at]:.6g}: "
        f"allowed: {low:.6g} to {high:.6g}, by {binding.place}"
    )


def _tick_of(binding: Binding, t_device: Array) -> Bits:
    """Device time [s] as the signal's counter, wrapped to its length."""
    if binding.signal.is_float:
        return _float_bits(binding.signal, (t_device - binding.offset) / binding.scale)
    ticks = np.rint((t_device - binding.offset) / binding.scale)
    return np.mod(ticks, 2.0**binding.signal.length).astype(np.uint64)


def _count_of(binding: Binding, first: int, n: int) -> Bits:
    """Sample counter first, first + 1 ... wrapped to the signal's length."""
    counter = np.arange(first, first + n, dtype=np.uint64)
    if binding.signal.is_float:
        return _float_bits(binding.signal, counter.astype(np.float64))
    return counter


def _bits_of(binding: Binding, signals: Table, t_device: Array, first: int) -> Bits:
    if binding.quantity in quantity.COUNTER:
        return _count_of(binding, first, len(signals.t))
    if binding.quantity in quantity.TIME:
        return _tick_of(binding, t_device)
    return raw_of(binding, signals.t, signals.columns[binding.quantity], signals.name)


def _pack_message(message: Message, bindings: list[Binding], bits: dict[int, Bits], n: int) -> NDArray[np.uint8]:
    """Payloads [n, length] of one message with these signals set, the rest zero."""
    data = np.zeros((n, message.length), dtype=np.uint8)
    for binding in bindings:
        put_bits(data, binding.signal, bits[id(binding)])
    selector = next((b.mux for b in bindings if b.mux is not None), None)
    if selector is not None:
        put_bits(data, selector[0], np.full(n, selector[1], dtype=np.uint64))
    return data


def pack(bindings: list[Binding], signals: Table, t_device: Array, first: int = 0) -> list[Frames]:
    """The frames of all bound messages, in the order they are sent: by bus, then by identifier.

    signals must have a column for every binding but counters and times; t_device [N] is the sensors' clock [s]; first:
    number of the first sample.
    """
    bindings = [b for b in bindings if b.quantity not in quantity.COUNTER or not dbc.carries_time(b, bindings)]
    bits = {id(b): _bits_of(b, signals, t_device, first) for b in bindings}
    groups: dict[tuple[int, int], list[Binding]] = {}
    for binding in bindings:
        groups.setdefault((binding.bus, binding.can_id), []).append(binding)
    frames = []
    for (bus, can_id), members in sorted(groups.items()):
        message = members[0].message
        selected = {b.mux[1] for b in members if b.mux is not None}
        for value in sorted(selected) or [0]:
            chosen = [b for b in members if b.mux is None or b.mux[1] == value]
            data = _pack_message(message, chosen, bits, len(signals.t))
            frames.append(Frames(bus, can_id, message.is_fd or message.length > 8, data))
    return frames


def lines_of(frames: Frames, t_us: NDArray[np.int64]) -> list[str]:
    """candump lines of frames, without the time stamp's order being looked at."""
    extended = frames.can_id & dbc.EXTENDED_ID
    identifier = f"{frames.can_id & 0x1FFFFFFF:08X}" if extended else f"{frames.can_id:03X}"
    head = f") can{frames.bus} {identifier}{'##1' if frames.is_fd else '#'}"
    text, width = frames.data.tobytes().hex().upper(), 2 * frames.data.shape[1]
    seconds, micros = (part.tolist() for part in np.divmod(t_us, 1_000_000))
    return [
        f"({s:010d}.{us:06d}{head}{text[i * width : (i + 1) * width]}\n"
        for i, (s, us) in enumerate(zip(seconds, micros, strict=True))
    ]


def write_can_log(path: Path, t: Array, frames: list[Frames], stamp: Stamp = stamp_exactly) -> int:
    """Write frames, one per sample time t [s] each, as a candump log in the order of their stamps.

    Returns the number of frames.
    """
    return write_parts(path, [(t, frames)], stamp)


def write_parts(path: Path, parts: list[tuple[Array, list[Frames]]], stamp: Stamp = stamp_exactly) -> int:
    """The same for several sensors, each with sample times t [s] of its own."""
    lines: list[str] = []
    stamps: list[NDArray[np.int64]] = []
    for t, frames in parts:
        for bus in sorted({f.bus for f in frames}):
            on_bus = [f for f in frames if f.bus == bus]
            for f, t_us in zip(on_bus, stamp(t, on_bus), strict=True):
                seen = t_us != LOST
                f, t_us = (f, t_us) if seen.all() else (replace(f, data=f.data[seen]), t_us[seen])
                lines += lines_of(f, t_us)
                stamps.append(t_us)
    order = np.argsort(np.concatenate(stamps), kind="stable").tolist()
    with path.open("w", encoding="ascii") as file:
        file.writelines(map(lines.__getitem__, order))
    return len(lines)


def encode(
    robot_file: Path, robot: Robot, signals_file: Path, tracker_file: Path | None, folder: Path
) -> tuple[int, tuple[str, ...]]:
    """CSV files -> run folder. Every frame is stamped with its sample's time. The number of frames, and notes."""
    notes: tuple[str, ...] = ()
    bindings = dbc.bind(robot, str(robot_file))
    signals = signals_csv.read(signals_file, robot)
    tracker = tracker_csv.read(tracker_file) if tracker_file else None
    if tracker is None and robot.position.source == "tracker":
        lengths = cable_lengths.find(signals, signals_file, robot)
        if lengths is None:
            raise InputError(
                f'{robot_file}: position.source = "tracker"; pass --tracker FILE, give columns '
                f'length_1 .. length_{robot.n_cables}, or set source to "fixed" or "can"'
            )
        found = cable_lengths.positions(robot, str(robot_file), signals, lengths)
        tracker, notes = found.positions, (found.note,)
    frames = pack(bindings, signals, signals.t)
    open_run(folder)
    write_robot(folder, robot, read_data(robot_file), bitrate=0.0)
    if tracker is not None:
        tracker_csv.write(folder / "tracker.csv", tracker)
    return write_can_log(folder / "can.log", signals.t, frames), notes
