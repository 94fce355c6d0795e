# SPDX-License-Identifier: Apache-2.0
"""Recordings of messages as channels: MCAP (JSON and protobuf), ROS bags, CAN logs with the DBC files of their buses.

Every number of a message is a channel, named by topic and field: /imu/data.linear_acceleration.x; numbers of arrays
count from 0; a force vector has its length besides: /cable_1.wrench.force.norm. Its time is the stamp in the message,
where every message of the topic has one and not all are zero, else the recorder's. A CAN message that came
on several interfaces has a set of channels for each: can1:IMU.acc_x.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inertiad.base import extras
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.exchange import dataset
from inertiad.exchange.foreign_csv import Channel
from inertiad.exchange.foreign_tables import in_order
from inertiad.exchange.mcap_file import mcap_channels, mcap_messages
from inertiad.robot import dbc
from inertiad.run import canlog, encode
from inertiad.run.canlog import CanLog

ELEMENTS_MAX: Final = 64
"""of an array that become channels: images and point clouds are no signals"""
FORCE_X: Final = "force.x"
"""ends the name of a force vector's first component"""
STAMPS: Final = ("t_ns", "stamp", "timestamp", "t", "time")
LEFT_OUT: Final = ("header", "seq", "layout")
COVARIANCE: Final = "covariance"
"""ends the name of a field that is left out, too: orientation_covariance"""
UNITS: Final = (
    ("linear_acceleration", "m/s2"),
    ("angular_velocity", "rad/s"),
    ("orientation", ""),
    ("position", "m"),
    ("translation", "m"),
    ("wrench.force", "N"),
)
"""of fields of ROS's and Foxglove's messages, which are SI; others have none"""


class _Collected:
    """Numbers by topic and field, and the times of each topic's messages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.times: dict[str, tuple[list[float], list[float | None]]] = {}
        self.samples: dict[tuple[str, str], tuple[list[int], list[float]]] = {}

    def add(self, topic: str, logged: float, content: dict[str, Any]) -> None:
        """A message that was recorded at logged, s."""
        stamp, rest = _stamped(content)
        recorder, stamps = self.times.setdefault(topic, ([], []))
        for field, value in _numbers(rest):
            numbers, values = self.samples.setdefault((topic, field), ([], []))
            numbers.append(len(recorder))
            values.append(value)
        recorder.append(logged)
        stamps.append(stamp)

    def _t(self, topic: str) -> Array:
        """s, of a topic's messages. One clock for all: a sensor whose clock starts at 0 has stamps all the same."""
        recorder, stamps = self.times[topic]
        whole = [stamp for stamp in stamps if stamp is not None]
        return np.array(whole if len(whole) == len(stamps) and any(whole) else recorder, np.float64)

    def channels(self, is_si: bool) -> list[Channel]:
        """InputError: nothing of numbers."""
        found = []
        t = {topic: self._t(topic) for topic in self.times}
        for (topic, field), (numbers, value) in self.samples.items():
            name = f"{topic}.{field}"
            unit = next((u for part, u in UNITS if part in name), "") if is_si else ""
            channel = in_order(self.path, name, unit, t[topic][numbers], np.array(value))
            if channel is not None:
                found.append(channel)
        if not found:
            raise InputError(f"{self.path}: no message with numbers in it")
        return [*found, *_force_norms(found)]


def _force_norms(channels: list[Channel]) -> Iterator[Channel]:
    """The length of each force vector, as of a WrenchStamped: of a sensor in line with a cable it is the tension."""
    by_name = {channel.name: channel for channel in channels}
    for name, x in by_name.items():
        if name.endswith(FORCE_X):
            place = name.removesuffix("x")
            axes = [by_name.get(place + axis) for axis in "xyz"]
            if all(axis is not None and np.array_equal(axis.t, x.t) for axis in axes):
                values = [axis.value for axis in axes if axis is not None]
                yield Channel(f"{place}norm", x.unit, x.t, np.linalg.norm(values, axis=0))


def _numbers(value: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Every number in nested dicts and lists with its name."""
    if isinstance(value, bool | int | float | np.number):
        yield place, float(value)
    elif isinstance(value, dict):
        for key, one in value.items():
            if key not in LEFT_OUT and not str(key).endswith(COVARIANCE):
                yield from _numbers(one, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= ELEMENTS_MAX:
        for number, one in enumerate(value):
            yield from _numbers(one, f"{place}.{number}")


def _seconds(stamp: Any) -> float | None:
    """A stamp as s: {sec, nanosec} in its spellings, or a number; None: it is none."""
    if isinstance(stamp, dict):
        whole = next((stamp[k] for k in ("sec", "secs", "seconds") if k in stamp), None)
        part = next((stamp[k] for k in ("nanosec", "nsec", "nsecs", "nanos") if k in stamp), 0)
        return None if whole is None else float(whole) + 1e-9 * float(part)
    return float(stamp) if isinstance(stamp, int | float) and not isinstance(stamp, bool) else None


def _stamped(message: dict[str, Any]) -> tuple[float | None, dict[str, Any]]:
    """A message's own time, s, and what of it is no time. None: it has none."""
    header = message.get("header")
    stamp = _seconds(header.get("stamp")) if isinstance(header, dict) else None
    if stamp is not None:
        return stamp, message
    for name in STAMPS:
        seconds = _seconds(message.get(name))
        if seconds is not None:
            return 1e-9 * seconds if name == "t_ns" else seconds, {k: v for k, v in message.items() if k != name}
    return None, {k: v for k, v in message.items() if k not in STAMPS}


# ---- MCAP ------------------------------------------------------------------------------------------------------------


def _of_protobuf(message: Any) -> dict[str, Any]:
    """A protobuf message as nested dicts; text, bytes and enumerations are left out."""
    found: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.type in (field.TYPE_STRING, field.TYPE_BYTES, field.TYPE_ENUM):
            continue
        if field.is_repeated:
            listed = list(value[: ELEMENTS_MAX + 1])
            found[field.name] = [_of_protobuf(one) for one in listed] if field.type == field.TYPE_MESSAGE else listed
        elif field.type == field.TYPE_MESSAGE:
            if message.HasField(field.name):
                found[field.name] = _of_protobuf(value)
        else:
            found[field.name] = value
    return found


def _of_json(path: Path, topic: str, data: bytes) -> Any:
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: {topic}: a message that is not JSON: {error}") from None


def read_mcap(path: Path) -> list[Channel]:
    """Channels of an MCAP file's JSON and protobuf messages. InputError: damaged, or messages of neither kind."""
    collected, others = _Collected(path), set[str]()
    decoder = extras.load("mcap_protobuf.decoder", "mcap").DecoderFactory()
    for schema, channel, message in mcap_messages(path):
        if channel.message_encoding == "json":
            content = _of_json(path, channel.topic, message.data)
        elif channel.message_encoding == "protobuf":
            decode = decoder.decoder_for("protobuf", schema)
            content = _of_protobuf(decode(message.data))
        else:
            others.add(channel.message_encoding)
            continue
        if isinstance(content, dict):
            collected.add(channel.topic, 1e-9 * message.log_time, content)
    if not collected.samples and others:
        hint = "; of a ROS 2 bag pass its folder" if "cdr" in others else ""
        raise InputError(f"{path}: messages in {', '.join(sorted(others))}: allowed: json, protobuf{hint}")
    return collected.channels(True)


def is_own_mcap(path: Path) -> bool:
    """Whether an MCAP file is of export: a topic of it is one of a run's tables."""
    names = {channel.topic.strip("/") for channel in mcap_channels(path)}
    return bool(names & set(dataset.NAMES))


# ---- ROS bags --------------------------------------------------------------------------------------------------------


def _of_ros(message: Any) -> Any:
    """A ROS message as nested dicts, lists and numbers."""
    if hasattr(message, "__dataclass_fields__"):
        return {name: _of_ros(getattr(message, name)) for name in message.__dataclass_fields__ if name[0] != "_"}
    if isinstance(message, np.ndarray):
        return message if message.dtype.kind in "fiu" else []
    if isinstance(message, list):
        return [_of_ros(one) for one in message[: ELEMENTS_MAX + 1]]
    return message


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS 2 bag, its folder or its .db3, or a ROS 1 bag."""
    return (path.is_dir() and (path / "metadata.yaml").exists()) or path.suffix.lower() in (".bag", ".db3")


def read_bag(path: Path) -> list[Channel]:
    """Channels of a ROS bag's messages. InputError: damaged, or its messages are of no known type."""
    highlevel = extras.load("rosbags.highlevel", "rosbag2")
    typesys = extras.load("rosbags.typesys", "rosbag2")
    bag = path.parent if path.suffix.lower() == ".db3" else path
    collected, unknown = _Collected(path), set[str]()
    try:
        with highlevel.AnyReader([bag], default_typestore=typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)) as reader:
            for connection, logged, raw in reader.messages():
                if connection.msgtype not in reader.typestore.fielddefs:
                    unknown.add(connection.msgtype)
                    continue
                content = _of_ros(reader.deserialize(raw, connection.msgtype))
                collected.add(connection.topic, 1e-9 * logged, content)
    except InputError:
        raise
    except Exception as error:  # its readers, SQLite and zstd raise many unrelated types on damaged bags
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a usable ROS bag: {reason}") from None
    if not collected.samples and unknown:
        raise InputError(f"{path}: messages of unknown types: {', '.join(sorted(unknown))}")
    return collected.channels(True)


# ---- CAN logs --------------------------------------------------------------------------------------------------------


def _raw(data: NDArray[np.uint8], signal: Any) -> Array:
    """Raw values [N] of a signal."""
    bits = np.zeros(len(data), np.uint64)
    for i, (byte, bit) in enumerate(encode.bit_positions(signal)):
        bits |= ((data[:, byte] >> np.uint8(bit)) & np.uint8(1)).astype(np.uint64) << np.uint64(i)
    if signal.is_float:
        if signal.length == 32:
            return bits.astype(np.uint32).view(np.float32).astype(np.float64)
        return bits.view(np.float64)
    if signal.is_signed and signal.length < 64:
        return (
            bits.astype(np.int64) - ((bits >> np.uint64(signal.length - 1)).astype(np.int64) << signal.length)
        ) * 1.0
    return (bits.view(np.int64) if signal.is_signed else bits).astype(np.float64)


def _can_id(message: Any) -> int:
    """In SocketCAN's layout."""
    return int(message.frame_id) | (dbc.EXTENDED_ID if message.is_extended_frame else 0)


def _of_message(log: CanLog, message: Any, path: Path) -> Iterator[Channel]:
    """Channels of one message's signals, for each interface on which it came."""
    part = log[(log.can_id == np.uint32(_can_id(message))) & (log.length >= message.length)]
    interfaces = np.unique(part.bus)
    for bus in interfaces:
        place = f"{log.names[bus]}:{message.name}" if len(interfaces) > 1 else message.name
        yield from _of_frames(part[part.bus == bus], message, place, path)


def _of_frames(part: CanLog, message: Any, place: str, path: Path) -> Iterator[Channel]:
    """Channels of the signals of one message's frames; place names the message."""
    t = (1e-9 * part.t_ns).astype(np.float64)
    for signal in message.signals:
        if signal.is_float and signal.length not in (32, 64):
            continue
        there = np.ones(len(part), np.bool_)
        if signal.multiplexer_ids and signal.multiplexer_signal:
            selector = message.get_signal_by_name(signal.multiplexer_signal)
            there = np.isin(_raw(part.data, selector), signal.multiplexer_ids)
        value = _raw(part.data[there], signal) * float(signal.scale) + float(signal.offset)
        once = np.diff(t[there], prepend=-np.inf) > 0.0  # a log in us may stamp two frames alike
        found = in_order(
            path,
            f"{place}.{signal.name}",
            signal.unit or "",
            t[there][once],
            value[once],
        )
        if found is not None:
            yield found


def _check_once(known: dbc.BusDatabase) -> None:
    """InputError: two DBC files describe a message of the same name or identifier."""
    seen: dict[str, str] = {}
    for message, file in known.messages:
        can_id = _can_id(message)
        for what in (f"message {message.name}", f"identifier {can_id & 0x1FFFFFFF:X}{'x' * (can_id >> 31)}"):
            other = seen.setdefault(what, file)
            if other != file:
                raise InputError(
                    f"--dbc: {other} and {file} both describe {what}: allowed: each once; "
                    "import the log of each bus by itself, with its own DBC"
                )


def read_can(path: Path, dbcs: list[Path]) -> list[Channel]:
    """Signals of a CAN log by DBC files.

    InputError: damaged, no frame of the log is in them, or two of them describe the same message.
    """
    log, known = canlog.read(path), dbc.load(dbcs)
    _check_once(known)
    found = [channel for message, _ in known.messages for channel in _of_message(log, message, path)]
    if not found:
        there = ", ".join(f"{can_id & 0x1FFFFFFF:X}" for can_id in np.unique(log.can_id)[:8])
        raise InputError(f"{path}: no frame of it is in the DBC files; identifiers in the log: {there}")
    return found
