# SPDX-License-Identifier: Apache-2.0
"""Play a recorded run again: frames to SocketCAN or as candump lines, tracker positions as LCM messages, in real time.

The whole schedule is computed before the first item is due; inertiad_replay.play() then only waits and writes.
"""

import contextlib
import os
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

import inertiad_replay
from inertiad.base import channels, quantity
from inertiad.base.error import InputError
from inertiad.live import lcm_network, tracker_protocols
from inertiad.live.tracker_protocols import Layout, Sample
from inertiad.run import canlog, tracker_csv
from inertiad.run.canlog import CanLog
from inertiad_lcm import tracker_t

Stamps = NDArray[np.int64]

LEAD: Final = 0.3
"""s between the end of preparations and the first item"""
SPIN: Final = 60e-6
"""s before each instant that are waited for actively"""
SPEED_MIN, SPEED_MAX = 1e-3, 1e3


@dataclass
class Items:
    """Output of one descriptor: N pieces of bytes, each with its time in the log."""

    name: str
    fd: int
    t_ns: NDArray[np.int64]
    data: NDArray[np.uint8]
    begin: NDArray[np.int64]
    """[N + 1]"""


@dataclass
class Lateness:
    """Lateness of one descriptor's items, after all loops."""

    name: str
    n: int
    p50_us: float
    p99_us: float
    max_us: float

    def __str__(self) -> str:
        late = f"late by {self.p50_us:.0f} us (p50), {self.p99_us:.0f} us (p99), {self.max_us:.0f} us (max)"
        return f"{self.name}: {self.n} sent, {late}"


@dataclass
class Played:
    """Result of a replay."""

    lateness: list[Lateness]
    n_waits: int
    """times a full queue made it wait"""
    n_unsent: int
    """items left over when it was stopped"""
    duration: float
    """s"""
    sent_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """ns, lateness of every item of the last loop"""


# ---- tracker over LCM ------------------------------------------------------------------------------------------------

_LCM_MAGIC: Final = 0x4C433032


def _packet_type(channel: str) -> np.dtype[Any]:
    """A TRACKER message as LCM puts it on the wire, big-endian, packed."""
    fields = [("magic", ">u4"), ("packet", ">u4"), ("channel", f"V{len(channel) + 1}"), ("fingerprint", "V8")]
    fields += [("sequence", ">i8"), ("t_ns", ">i8"), ("t_device_ns", ">i8"), ("valid", "u1")]
    return np.dtype([*fields, ("position", ">f8", 3), ("has_q", "u1"), ("q", ">f8", 4), ("n_dropped", ">i8")])


def tracker_packets(
    channel: str, t_device_ns: NDArray[np.int64], position: NDArray[np.float64], q: NDArray[np.float64] | None = None
) -> NDArray[Any]:
    """LCM packets of positions [N, 3] m, and attitudes [N, 4] w x y z if given; t_ns is still that of the log."""
    packets = np.zeros(len(position), dtype=_packet_type(channel))
    packets["magic"], packets["packet"] = _LCM_MAGIC, np.arange(len(position))
    packets["channel"] = np.void(channel.encode() + b"\0")
    packets["fingerprint"] = np.void(tracker_t().encode()[:8])
    packets["sequence"] = np.arange(len(position))
    packets["t_ns"] = packets["t_device_ns"] = t_device_ns
    packets["valid"], packets["position"] = 1, position
    if q is not None:
        packets["has_q"], packets["q"] = 1, q
    return packets


def _pieces(name: str, fd: int, t_ns: NDArray[np.int64], table: NDArray[Any]) -> Items:
    """Items of equal size, one per element of table."""
    size = table.dtype.itemsize
    begin = size * np.arange(len(table) + 1, dtype=np.int64)
    return Items(name, fd, t_ns, table.view(np.uint8).reshape(-1), begin)


# ---- schedule --------------------------------------------------------------------------------------------------------


@dataclass
class Schedule:
    """All items of all descriptors in the order they are due."""

    items: list[Items]
    t_ns: NDArray[np.int64]
    """log time, [N], not decreasing"""
    route: NDArray[np.uint8]
    """[N], index into items"""
    data: NDArray[np.uint8]
    begin: NDArray[np.int64]
    packets: list[NDArray[Any]]
    """views into data whose t_ns is set when the start is known"""

    @property
    def duration_ns(self) -> int:
        return int(self.t_ns[-1] - self.t_ns[0])


def _gather(data: NDArray[np.uint8], begin: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The pieces of data in another order, one behind the other."""
    size = np.diff(begin)[order]
    end = np.cumsum(size)
    shift = np.repeat(begin[:-1][order] - (end - size), size)
    return data[np.arange(int(end[-1]) if len(end) else 0) + shift]


def schedule_of(items: list[Items]) -> Schedule:
    """Merge by time; at equal times in the order of items. Stamps that go back are due at once."""
    t_ns = np.concatenate([np.maximum.accumulate(i.t_ns) for i in items])
    route = np.repeat(np.arange(len(items), dtype=np.uint8), [len(i.t_ns) for i in items])
    offset = np.cumsum([0, *(len(i.data) for i in items)])
    begin = np.concatenate([*(i.begin[:-1] + offset[k] for k, i in enumerate(items)), offset[-1:]])
    data = np.concatenate([i.data for i in items])
    order = np.argsort(t_ns, kind="stable")
    size = np.diff(begin)[order]
    sorted_begin = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    return Schedule(items, t_ns[order], route[order], _gather(data, begin, order), sorted_begin, [])


def _restamp(schedule: Schedule, channel: str, start_wall_ns: int, speed: float, loop: int) -> None:
    """Set the host time of every TRACKER packet to the instant it is due, and count on from the loop before."""
    kind = _packet_type(channel)
    for number, items in enumerate(schedule.items):
        if items.name != channel:
            continue
        chosen = np.flatnonzero(schedule.route == number)
        at = schedule.begin[chosen][:, None] + np.arange(kind.itemsize)
        packets = schedule.data[at].copy().view(kind).reshape(-1)
        packets["t_ns"] = start_wall_ns + np.rint((schedule.t_ns[chosen] - schedule.t_ns[0]) / speed).astype(np.int64)
        packets["sequence"] = packets["packet"] = loop * len(chosen) + np.arange(len(chosen))
        schedule.data[at] = packets.view(np.uint8).reshape(len(chosen), -1)


# ---- inputs and outputs ----------------------------------------------------------------------------------------------


def _cut(t_ns: NDArray[np.int64], first_ns: int, start: float, stop: float | None) -> NDArray[np.bool_]:
    """Mask of the stamps from start to stop, s after first_ns."""
    last_ns = np.inf if stop is None else first_ns + 1e9 * stop
    return (t_ns >= first_ns + 1e9 * start) & (t_ns <= last_ns)


def _can_socket(interface: str) -> socket.socket:
    link = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        link.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        link.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")  # it only sends
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        link.bind((interface,))
    except OSError as error:
        link.close()
        raise InputError(f"--bus socketcan:{interface}: {error.strerror}") from None
    return link


def _open_can(address: str) -> socket.socket:
    scheme, _, interface = address.partition(":")
    if scheme != "socketcan" or not interface:
        raise InputError(f"--bus {address}: allowed: socketcan:INTERFACE, or - for candump lines on stdout")
    try:
        return _can_socket(interface)
    except OSError as error:  # a kernel without CAN
        raise InputError(f"--bus {address}: {error.strerror}") from None


def _on_can(address: str, link: socket.socket, log: CanLog) -> Items:
    data, begin = canlog.wire(log)
    return Items(address, link.fileno(), log.t_ns, data, begin)


def _as_lines(log: CanLog) -> Items:
    lines = canlog.lines(log)
    begin = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64)
    data = np.frombuffer(b"".join(lines), dtype=np.uint8).copy()
    return Items("stdout", sys.stdout.fileno(), log.t_ns, data, begin)


def _bus_items(addresses: list[str], log: CanLog, stack: contextlib.ExitStack) -> Iterator[Items]:
    """The log's interfaces in the order of their names to the buses in the order given; all to one if alone."""
    if 1 < len(addresses) < len(log.names):
        raise InputError(
            f"--bus: {len(addresses)} given, the log has {len(log.names)} interfaces: {', '.join(log.names)}"
        )
    for number, address in enumerate(addresses):
        mine = log if len(addresses) == 1 else log[log.bus == number]
        yield _as_lines(mine) if address == "-" else _on_can(address, stack.enter_context(_open_can(address)), mine)


@dataclass(frozen=True)
class Options:
    """Options of `inertiactl replay`."""

    run: Path
    buses: list[str]
    speed: float = 1.0
    loop: int = 1
    start: float = 0.0
    stop: float | None = None
    tracker: bool = True
    url: str = channels.DEFAULT_URL
    prefix: str = channels.DEFAULT_PREFIX
    instrument: Layout | None = None
    """play tracker.csv as this instrument instead of over LCM"""
    instrument_address: str = ""

    @property
    def channel(self) -> str:
        return f"{self.prefix}TRACKER"


PEER_WAIT: Final = 30.0
"""s to wait for a recorder to connect"""


def _open_instrument(address: str) -> Any:
    """Destination of an emulated instrument: udp:HOST:PORT, tcp:HOST:PORT, tcp-listen:[HOST:]PORT, file:PATH."""
    scheme, _, place = address.partition(":")
    host, _, port = place.rpartition(":")
    try:
        if scheme == "udp":
            link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            link.connect((host or "127.0.0.1", int(port)))
            return link
        if scheme == "tcp":
            return socket.create_connection((host or "127.0.0.1", int(port)), timeout=PEER_WAIT)
        if scheme == "tcp-listen":
            with socket.create_server((host, int(port))) as server:
                server.settimeout(PEER_WAIT)
                return server.accept()[0]
        if scheme == "file":
            return open(place, "ab", buffering=0)  # closed by the caller's stack
    except ValueError:
        raise InputError(f"--tracker {address}: port: allowed: 1 to 65535") from None
    except TimeoutError:
        raise InputError(f"--tracker {address}: nobody connected within {PEER_WAIT:g} s") from None
    except OSError as error:
        raise InputError(f"--tracker {address}: {error.strerror}") from None
    raise InputError(f"--tracker {address}: allowed: udp:HOST:PORT, tcp:HOST:PORT, tcp-listen:PORT, file:PATH")


@dataclass(frozen=True)
class Tracked:
    """Positions of tracker.csv."""

    t_ns: Stamps
    """[N]"""
    position: NDArray[np.float64]
    """m [N, 3]"""
    q: NDArray[np.float64] | None
    """w x y z [N, 4], P to W"""

    def __getitem__(self, chosen: Any) -> Self:
        q = None if self.q is None else self.q[chosen]
        return replace(self, t_ns=self.t_ns[chosen], position=self.position[chosen], q=q)


EMULATED: Final = {
    "text": Layout("text"),
    "struct": Layout("struct", ("frame", "t", "x", "y", "z"), struct="<Id3d"),
    "spatialanalyzer": Layout("spatialanalyzer"),
    "emscon": Layout("emscon"),
    "dtrack": Layout("dtrack"),
    "natnet": Layout("natnet"),
}
"""text: t,x,y,z in s and m; struct: <Id3d frame,t,x,y,z"""


def emulated(tracker: str | None) -> tuple[Layout | None, str]:
    """Layout and address of --tracker FORMAT=ADDRESS; (None, "") for the other choices. InputError: none of them."""
    if tracker in (None, "lcm", "none"):
        return None, ""
    form, _, address = (tracker or "").partition("=")
    if form not in EMULATED or not address:
        known = ", ".join(f"{name}=ADDRESS" for name in EMULATED)
        raise InputError(f"--tracker {tracker}: allowed: lcm, none, {known}")
    return EMULATED[form], address


def _instrument_bytes(layout: Layout, tracked: Tracked) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """The instrument's bytes, and the beginning of each piece [N + 1]; its clock is the log's time."""
    turns = [None] * len(tracked.t_ns) if tracked.q is None else [tuple(q) for q in tracked.q.tolist()]
    rows = zip(tracked.t_ns.tolist(), tracked.position.tolist(), turns, strict=True)
    pieces = [
        tracker_protocols.encode(layout, Sample((x, y, z), 1e-9 * t, q=q), k)
        for k, (t, (x, y, z), q) in enumerate(rows, start=1)
    ]
    begin = np.concatenate([[0], np.cumsum([len(p) for p in pieces])]).astype(np.int64)
    return np.frombuffer(b"".join(pieces), dtype=np.uint8).copy(), begin


def _tracker_items(options: Options, tracked: Tracked, stack: contextlib.ExitStack) -> Items:
    t_ns = tracked.t_ns
    if options.instrument is not None:
        data, begin = _instrument_bytes(options.instrument, tracked)
        link = stack.enter_context(_open_instrument(options.instrument_address))
        name = f"{options.instrument.format}={options.instrument_address}"
        return Items(name, link.fileno(), t_ns, data, begin)
    link = stack.enter_context(lcm_network.udp_socket(options.url))
    packets = tracker_packets(options.channel, t_ns, tracked.position, tracked.q)
    return _pieces(options.channel, link.fileno(), t_ns, packets)


def _tracker_of(options: Options) -> Tracked | None:
    path = options.run / "tracker.csv"
    if not options.tracker or not path.exists():
        return None
    tracker = tracker_csv.read(path)
    q = tracker.stack(*quantity.QUATERNION) if tracker_csv.has_attitude(tracker) else None
    return Tracked(np.rint(1e9 * tracker.t).astype(np.int64), tracker.stack("x", "y", "z"), q)


def _items(options: Options, stack: contextlib.ExitStack, remarks: list[str]) -> list[Items]:
    """Everything to be sent, cut to --start and --stop."""
    log = canlog.read(canlog.find(options.run)) if options.buses else None
    tracker = _tracker_of(options)
    if log is None and tracker is None:
        raise InputError(f"{options.run}: nothing to play; pass --bus, or put tracker.csv into the run")
    first_ns = min([int(log.t_ns.min())] if log is not None else [], default=None)
    first_ns = int(tracker.t_ns[0]) if first_ns is None and tracker is not None else first_ns
    assert first_ns is not None
    found: list[Items] = []
    if log is not None:
        remarks += log.remarks
        found += _bus_items(options.buses, log[_cut(log.t_ns, first_ns, options.start, options.stop)], stack)
    if tracker is not None:
        chosen = _cut(tracker.t_ns, first_ns, options.start, options.stop)
        found.append(_tracker_items(options, tracker[chosen], stack))
    if not sum(len(i.t_ns) for i in found):
        raise InputError(f"{options.run}: nothing between --start {options.start:g} and --stop {options.stop}")
    return found


# ---- play ------------------------------------------------------------------------------------------------------------


def play(schedule: Schedule, options: Options) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Play all loops. Lateness [ns] and route of every item sent, [2, M], and the last loop's result."""
    due_ns = np.rint((schedule.t_ns - schedule.t_ns[0]) / options.speed).astype(np.int64)
    pause_ns = int(due_ns[-1]) + 1_000_000  # 1 ms between the loops
    fds = [i.fd for i in schedule.items]
    parts, n_waits = [], 0
    start_ns = time.monotonic_ns() + round(1e9 * LEAD)
    for loop in range(options.loop):
        start_wall_ns = time.time_ns() + start_ns - time.monotonic_ns()
        _restamp(schedule, options.channel, start_wall_ns, options.speed, loop)
        result = inertiad_replay.play(
            schedule.data, schedule.begin, due_ns, schedule.route, fds, start_ns, round(1e9 * SPIN)
        )
        late = result["lateness_ns"]
        parts.append(np.stack([late, schedule.route[: len(late)].astype(np.int64)]))
        n_waits += result["n_waits"]
        if len(late) < len(due_ns):
            break
        start_ns += pause_ns
    return np.hstack(parts), result | {"n_waits": n_waits}


def _lateness(name: str, late_ns: NDArray[np.int64]) -> Lateness:
    if len(late_ns) == 0:
        return Lateness(name, 0, 0.0, 0.0, 0.0)
    p50, p99 = np.percentile(late_ns, [50, 99]) / 1e3
    return Lateness(name, len(late_ns), float(p50), float(p99), float(late_ns.max()) / 1e3)


def _check(options: Options) -> None:
    if not SPEED_MIN <= options.speed <= SPEED_MAX:
        raise InputError(f"--speed {options.speed:g}: allowed: {SPEED_MIN:g} to {SPEED_MAX:g}")
    if options.stop is not None and options.stop <= options.start:
        raise InputError(f"--stop {options.stop:g}: allowed: above --start = {options.start:g} s")
    if len(options.buses) > 1 and "-" in options.buses:
        raise InputError("--bus - cannot be combined with another --bus: all interfaces of the log go to stdout")


def _failure(result: dict[str, Any], items: list[Items]) -> str:
    """The reason of a failed write, in one line."""
    return f"{items[result['route']].name}: {os.strerror(result['error'])}"


def replay(options: Options, remarks: list[str]) -> Played:
    """Play a run. InputError: an unusable run or address, or a bus or reader that went away."""
    _check(options)
    with contextlib.ExitStack() as stack:
        items = _items(options, stack, remarks)
        schedule = schedule_of(items)
        began = time.monotonic()
        late, result = play(schedule, options)
    if result["error"]:
        raise InputError(_failure(result, items))
    per_route = [_lateness(i.name, late[0, late[1] == k]) for k, i in enumerate(items)]
    n_unsent = options.loop * len(schedule.t_ns) - late.shape[1]
    return Played(per_route, result["n_waits"], n_unsent, time.monotonic() - began - LEAD, late[0])
