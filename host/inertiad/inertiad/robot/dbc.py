# SPDX-License-Identifier: Apache-2.0
"""CAN databases: bind quantities to DBC signals, convert their units to SI, and write a DBC for robots without one."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inertiad.base import python_can, quantity, units
from inertiad.base.error import InputError
from inertiad.robot.description import Robot
from inertiad.robot.keys import Bound, Scaled

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

EXTENDED_ID = 0x80000000
GENERATED_NAME = "generated.dbc"


@dataclass(frozen=True)
class Binding:
    """A quantity and the DBC signal that carries it: value [SI] = raw * scale + offset."""

    quantity: str
    bus: int
    message: Message
    signal: Signal
    scale: float
    offset: float
    minimum: float
    """SI, half a count below the DBC's; equal to maximum: no limits."""
    maximum: float
    source: str
    """File the signal comes from."""

    @property
    def can_id(self) -> int:
        """Identifier in SocketCAN's layout, bit 31 set for 29 bits."""
        return self.message.frame_id | (EXTENDED_ID if self.message.is_extended_frame else 0)

    @property
    def place(self) -> str:
        """FILE: MESSAGE.signal, for messages."""
        return f"{self.source}: {self.message.name}.{self.signal.name}"

    @property
    def mux(self) -> tuple[Signal, int] | None:
        """The multiplexer signal and the value that selects this one, or None."""
        ids = self.signal.multiplexer_ids
        name = self.signal.multiplexer_signal
        return None if not ids or name is None else (self.message.get_signal_by_name(name), ids[0])


@dataclass(frozen=True)
class BusDatabase:
    """The messages of one bus with the file each comes from."""

    messages: tuple[tuple[Message, str], ...]


def _cantools_database() -> Any:
    """cantools.database, which needs python-can in its package's first lines."""
    python_can.load()
    return importlib.import_module("cantools.database")


def load(paths: Iterable[Path]) -> BusDatabase:
    """Read the DBC files of one bus. InputError names the file and, where the parser knows it, the line."""
    cantools = _cantools_database()
    messages: list[tuple[Message, str]] = []
    for path in paths:
        try:
            database = cantools.load_file(path, database_format="dbc", strict=True)
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}") from None
        except Exception as error:  # the parser raises several unrelated types
            raise InputError(f"{path}: not a usable DBC: {' '.join(str(error).split())}") from None
        assert isinstance(database, cantools.can.Database)
        messages += [(message, path.name) for message in database.messages]
    return BusDatabase(tuple(messages))


def _limits(signal: Signal, factor: float, zero: float) -> tuple[float, float]:
    """The DBC's limits in SI, half a count wider: a value exactly on the limit must survive rounding.

    factor: SI value of one of the DBC's units; zero: SI value of zero in them.
    """
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or not low < high or not (math.isfinite(low) and math.isfinite(high)):
        return 0.0, 0.0
    half = 0.0 if signal.is_float else 0.5 * abs(float(signal.scale))
    margin = half + 1e-6 * (high - low) * signal.is_float
    ends = sorted(((float(low) - margin) * factor + zero, (float(high) + margin) * factor + zero))
    return ends[0], ends[1]


def _check_representable(name: str, message: Message, signal: Signal, source: str) -> None:
    where = f"signals.{name}: {source}: {message.name}.{signal.name}"
    if signal.is_float and signal.length not in (32, 64):
        raise InputError(f"{where}: float of {signal.length} bits: allowed: 32, 64")
    if signal.length > 64:
        raise InputError(f"{where}: {signal.length} bits: allowed: 1 to 64")
    if signal.multiplexer_ids and len(signal.multiplexer_ids) > 1:
        raise InputError(f"{where}: present for {len(signal.multiplexer_ids)} multiplexer values: allowed: one")
    selector = message.get_signal_by_name(signal.multiplexer_signal) if signal.multiplexer_signal else None
    if selector is not None and selector.multiplexer_ids:
        raise InputError(f"{where}: its multiplexer is itself multiplexed: allowed: one level")
    if message.length > 64:
        raise InputError(f"{where}: message of {message.length} bytes: allowed: 1 to 64")


def _find(name: str, reference: str, buses: list[BusDatabase]) -> tuple[int, Message, Signal, str]:
    """Bus, message, signal and file of "MESSAGE.signal" or "busN:MESSAGE.signal"."""
    prefix, _, path = reference.rpartition(":")
    message_name, _, signal_name = path.partition(".")
    only = _bus_number(name, reference, prefix, len(buses)) if prefix else None
    found = [
        (bus, message, source)
        for bus, database in enumerate(buses)
        for message, source in database.messages
        if message.name == message_name and only in (None, bus)
    ]
    where = f'signals.{name} = "{reference}"'
    if not found:
        known = sorted({m.name for b in buses for m, _ in b.messages})
        raise InputError(f"{where}: no such message: allowed: one of {', '.join(known[:16])}")
    if len(found) > 1:
        on = " or ".join(f'"bus{bus}:{path}"' for bus, _, _ in found)
        raise InputError(f"{where}: the message is on several buses: allowed: {on}")
    bus, message, source = found[0]
    for signal in message.signals:
        if signal.name == signal_name:
            return bus, message, signal, source
    names = ", ".join(f"{message_name}.{s.name}" for s in message.signals[:16])
    raise InputError(f"{where}: no such signal in {source}: allowed: {names}")


def _bus_number(name: str, reference: str, prefix: str, n_buses: int) -> int:
    number = prefix.removeprefix("bus")
    if not (prefix.startswith("bus") and number.isdecimal() and int(number) < n_buses):
        raise InputError(f'signals.{name} = "{reference}": bus: allowed: bus0 to bus{n_buses - 1}')
    return int(number)


def _unit_of(name: str, signal: Signal, place: str) -> float:
    """SI value of one of the signal's units. InputError: it is of another dimension than the quantity."""
    if name in quantity.COUNTER:  # compared for equality only, never measured
        return 1.0
    try:
        return units.unit_factor(signal.unit, quantity.dimension(name))
    except KeyError as error:
        raise InputError(
            f'signals.{name}: {place}: unit "{signal.unit}": allowed: {error.args[0]}, or another with '
            f'{name} = {{ signal = "...", scale = ... }}'
        ) from None


def _bind(name: str, bound: str | Scaled, buses: list[BusDatabase]) -> Binding:
    bus, message, signal, source = _find(name, bound.signal if isinstance(bound, Scaled) else bound, buses)
    _check_representable(name, message, signal, source)
    if isinstance(bound, Scaled):
        factor, zero = bound.scale, bound.offset
    else:
        factor, zero = _unit_of(name, signal, f"{source}: {message.name}.{signal.name}"), 0.0
    scale, offset = float(signal.scale) * factor, float(signal.offset) * factor + zero
    low, high = _limits(signal, factor, zero)
    if name in quantity.COUNTER or name in quantity.TIME:
        low = high = 0.0
    return Binding(name, bus, message, signal, scale, offset, low, high, source)


def carries_time(binding: Binding, bindings: Iterable[Binding]) -> bool:
    """Is the binding's signal a device time? A time that distinguishes samples may be bound as their counter, too."""
    times = (b for b in bindings if b.quantity in quantity.TIME)
    return any((b.bus, b.can_id, b.signal.name) == (binding.bus, binding.can_id, binding.signal.name) for b in times)


def required(robot: Robot) -> tuple[str, ...]:
    """Quantities that must come over CAN for this robot."""
    attitude = quantity.QUATERNION if robot.attitude.source == "quaternion" else quantity.RPY
    position = quantity.POSITION if robot.position.source == "can" else ()
    return quantity.ACC + quantity.GYRO + attitude + position + quantity.forces(robot.n_cables)


def _missing(name: str) -> str:
    derived = " (only inertiactl fit SIGNALS.csv works without it)" if name in quantity.ACC + quantity.GYRO else ""
    return f'signals.{name}: missing; add {name} = "MESSAGE.signal"{derived}'


def bind(robot: Robot, source: str) -> list[Binding]:
    """Every binding of [signals], looked up in the robot's DBC files; without [[bus]], those of generate().

    source names the robot description in messages. InputError: a quantity without a signal, a signal that is not in
    the DBC or not unique, a unit of another dimension, a layout the decoder does not know.
    """
    if robot.bus:
        buses, signals = [load(bus.files) for bus in robot.bus], robot.signals
    else:
        text, signals = generate(robot)
        generated = _cantools_database().can.Database()
        generated.add_dbc_string(text)
        buses = [BusDatabase(tuple((message, GENERATED_NAME) for message in generated.messages))]
    bindings, wrong = [], list[str]()
    for name, value in signals.items():
        for bound in value if isinstance(value, list) else [value]:
            try:
                bindings.append(_bind(name, bound, buses))
            except InputError as error:
                wrong += error.lines
    wrong += [_missing(name) for name in required(robot) if name not in signals]
    if wrong:
        raise InputError(*(f"{source}: {line}" for line in wrong))
    if len(bindings) > 64:
        raise InputError(f"{source}: {len(bindings)} bindings in [signals]: allowed: up to 64")
    return bindings


def _fd_length(n_bytes: int) -> int:
    """The shortest CAN FD payload that holds n_bytes."""
    return next(size for size in (8, 12, 16, 20, 24, 32, 48, 64) if size >= n_bytes)


_FLOAT_LIMITS = {"m/s2": 1000, "rad/s": 100, "rad": 100, "m": 10000, "N": 10_000_000, "": 2}


def _generated_message(can_id: int, name: str, signals: list[tuple[str, str]]) -> tuple[str, list[str]]:
    """DBC text of a message with a counter, a time and float32 signals (name, unit), and its float signals' names."""
    n_bytes = _fd_length(6 + 4 * len(signals))
    lines = [
        f"BO_ {can_id} {name}: {n_bytes} SENSOR",
        ' SG_ counter : 0|16@1+ (1,0) [0|65535] "" Vector__XXX',
        ' SG_ time : 16|32@1+ (1,0) [0|4294967295] "us" Vector__XXX',
    ]
    for i, (signal, unit) in enumerate(signals):
        limit = _FLOAT_LIMITS[unit]
        lines.append(f' SG_ {signal} : {48 + 32 * i}|32@1- (1,0) [-{limit}|{limit}] "{unit}" Vector__XXX')
    return "\n".join(lines), [signal for signal, _ in signals]


def generate(robot: Robot) -> tuple[str, dict[str, Bound]]:
    """A DBC with wide CAN FD frames for a robot that names none, and the [signals] that go with it.

    IMU holds a sample counter, its time [us], acceleration, rate and attitude; POSITION the position, if it comes over
    CAN; FORCE_A and FORCE_B eight cable forces each. All values are float32 in SI.
    """
    unit = {"acceleration": "m/s2", "rate": "rad/s", "angle": "rad", "length": "m", "force": "N", "none": ""}
    names = required(robot)
    by_message = {
        "IMU": [n for n in names if quantity.sensor(n) == "imu"],
        "POSITION": [n for n in names if quantity.sensor(n) == "pos"],
        "FORCE_A": [n for n in names if quantity.sensor(n) == "force"][:8],
        "FORCE_B": [n for n in names if quantity.sensor(n) == "force"][8:],
    }
    text = ['VERSION ""', "", "NS_ :", "", "BS_:", "", "BU_: SENSOR", ""]
    types, formats = [], []
    signals: dict[str, Bound] = {}
    counters: dict[str, list[str]] = {}
    for i, (message, members) in enumerate((m, q) for m, q in by_message.items() if q):
        can_id = 0x100 + 0x10 * i
        body, floats = _generated_message(can_id, message, [(n, unit[quantity.dimension(n)]) for n in members])
        text += [body, ""]
        types += [f"SIG_VALTYPE_ {can_id} {signal} : 1;" for signal in floats]
        formats.append(f'BA_ "VFrameFormat" BO_ {can_id} 14;')
        sensor = quantity.sensor(members[0])
        signals |= {n: f"{message}.{n}" for n in members}
        signals.setdefault(f"{sensor}_time", f"{message}.time")
        counters.setdefault(f"{sensor}_counter", []).append(f"{message}.counter")
    text += ['BA_DEF_ BO_ "VFrameFormat" ENUM ' + _FRAME_FORMATS + ";", 'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";']
    return "\n".join(text + formats + types) + "\n", signals | counters


_FRAME_FORMATS = ",".join(
    ['"StandardCAN"', '"ExtendedCAN"'] + ['"reserved"'] * 12 + ['"StandardCAN_FD"', '"ExtendedCAN_FD"']
)
