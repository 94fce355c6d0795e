# SPDX-License-Identifier: Apache-2.0
"""Run the daemon on a recorded run and collect everything it publishes.

From a file, it writes its messages into an LCM log, without loss. On a bus, they come over the LCM network, with large
queues, while the run is played in real time.
"""

import contextlib
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from inertiad.base.error import InputError
from inertiad.live import lcm_network, replay
from inertiad.run import canlog, lcmlog, tracker_csv
from inertiad.run.canlog import CanLog
from inertiad.run.lcmlog import Event
from inertiad_lcm import estimate_t, event_t, health_t, order_t, raw_t, signals_t, tracker_t

PREFIX: Final = "VERIFY_"
"""of the channels, so that another daemon on the network is not mistaken for ours"""
PATIENCE: Final = 60.0
"""s to wait for the daemon to say that it is there, and to take the last frame"""
SILENCE: Final = 1.0
"""s without a message after the daemon's end: nothing more will come"""
KINDS: Final = {
    "RAW": raw_t,
    "ORDER": order_t,
    "SIGNALS": signals_t,
    "ESTIMATE": estimate_t,
    "HEALTH": health_t,
    "EVENT": event_t,
    "TRACKER": tracker_t,
}


@dataclass
class Published:
    """The daemon's messages about one run, in the order of arrival."""

    messages: dict[str, list[Any]] = field(default_factory=lambda: {name: [] for name in KINDS})
    arrival_ns: dict[str, list[int]] = field(default_factory=lambda: {name: [] for name in KINDS})
    """host time"""
    n_gaps: Counter[str] = field(default_factory=Counter)
    """messages missing or out of order, by channel"""
    exit_status: int = 0
    summary: dict[str, int] = field(default_factory=dict)
    """the counters it printed at its end"""
    stderr: str = ""
    estimate_file: Path | None = None
    seconds: float = 0.0
    """it ran"""
    lateness: list[replay.Lateness] = field(default_factory=list)
    is_live: bool = False

    def add(self, event: Event) -> None:
        """Take one message."""
        name = event.channel.removeprefix(PREFIX)
        if name not in KINDS:
            return
        message = lcmlog.decode(KINDS[name], event, "daemon")
        expected = len(self.messages[name]) + self.n_gaps[name]
        if message.sequence != expected:
            self.n_gaps[name] += max(1, message.sequence - expected)
        self.messages[name].append(message)
        self.arrival_ns[name].append(1000 * event.t_us)

    def frames(self, n_buses: int) -> CanLog:
        """All frames of all RAW messages."""
        rows = [
            (f.t_ns, f.can_id & 0xFFFFFFFF, f.flags & 0xFF, bytes(f.data), f"can{f.bus}", f.length)
            for message in self.messages["RAW"]
            for f in message.frame
        ]
        return canlog.from_rows(rows, "RAW") if rows else _no_frames()


def _no_frames() -> CanLog:
    none = np.zeros(0, dtype=np.uint8)
    return CanLog(
        none.astype(np.int64), none.astype(np.uint32), none, none, none, np.zeros((0, 8), np.uint8), (), "RAW"
    )


@dataclass(frozen=True)
class Setup:
    """Files and options of a daemon's run."""

    run: Path
    folder: Path
    """for its output files"""
    config: Path
    daemon: Path
    n_buses: int
    with_tracker: bool
    url: str

    def command(self, buses: list[str], *options: str) -> list[str]:
        """Its command line."""
        command = [str(self.daemon), "--config", str(self.config), "--lcm-prefix", PREFIX]
        for bus in buses:
            command += ["--bus", bus]
        return [*command, "--estimate", str(self.folder / "estimate.json"), *options]


def _finish(published: Published, setup: Setup, process: subprocess.Popen[str], stderr: str) -> None:
    published.exit_status, published.stderr = process.returncode, stderr
    rows = [line.removeprefix("inertiad: ").split() for line in stderr.splitlines()]
    published.summary = {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}
    file = setup.folder / "estimate.json"
    published.estimate_file = file if file.exists() else None


def from_file(setup: Setup) -> Published:
    """As fast as it goes, from the run's files."""
    log = setup.run / "can.log"
    filters = [""] if setup.n_buses == 1 else [f"&interface=can{i}" for i in range(setup.n_buses)]
    out = setup.folder / "published.lcmlog"
    options = ["--lcm", f"file://{out}?mode=w"]
    if setup.with_tracker:
        options += ["--tracker", f"file:{setup.run / 'tracker.csv'}"]
    command = setup.command([f"file:{log}?speed=0{f}" for f in filters], *options)
    published, began = Published(), time.monotonic()
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        _, stderr = process.communicate()
    published.seconds = time.monotonic() - began
    _finish(published, setup, process, stderr)
    remarks: list[str] = []
    if out.exists():
        for event in lcmlog.read(out, remarks):
            published.add(event)
    return published


class _Collector:
    """Receive everything with our prefix, in a thread."""

    def __init__(self, url: str) -> None:
        self.events: list[Event] = []
        self.counters: dict[str, int] = {}
        self.heard = time.monotonic()
        self._listener = lcm_network.Listener(url, f"{PREFIX}.*", self._take)
        self._listener.start()

    def _take(self, channel: str, data: bytes) -> None:
        self.heard = time.monotonic()
        self.events.append(Event(len(self.events), time.time_ns() // 1000, channel, data))
        if channel == f"{PREFIX}HEALTH":
            self.counters = {c.name: c.value for c in health_t.decode(data).counter}

    def wait(self, condition: Any, seconds: float) -> bool:
        """Until condition() or for so long; True: it came."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def stop(self) -> None:
        """When nothing more comes."""
        self.wait(lambda: time.monotonic() - self.heard > SILENCE, 10 * SILENCE)
        self._listener.stop()


@contextlib.contextmanager
def _running(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def _taken(counters: dict[str, int]) -> int:
    """Frames the daemon has taken or counted as lost."""
    ends = (".frames", ".dropped_by_kernel")
    return sum(n for name, n in counters.items() if name.startswith("bus") and name.endswith(ends))


def live(setup: Setup, buses: list[str], n_frames: int) -> Published:
    """In real time, over SocketCAN. InputError: an unusable bus, no multicast, or the daemon does not start."""
    published = Published(is_live=True)
    collector = _Collector(setup.url)
    command = setup.command([f"{bus}?filter=off" for bus in buses], "--lcm", setup.url)
    began = time.monotonic()
    with _running(command) as process:
        if not collector.wait(lambda: collector.counters or process.poll() is not None, PATIENCE) or process.poll():
            process.kill()
            raise InputError(f"{setup.daemon}: does not start: {' '.join(process.communicate()[1].split())}")
        options = replay.Options(setup.run, buses, tracker=setup.with_tracker, url=setup.url, prefix=PREFIX)
        published.lateness = replay.replay(options, []).lateness
        collector.wait(lambda: _taken(collector.counters) >= n_frames or process.poll() is not None, PATIENCE / 4)
        process.send_signal(signal.SIGTERM)
        _, stderr = process.communicate(timeout=PATIENCE)
    published.seconds = time.monotonic() - began
    collector.stop()
    _finish(published, setup, process, stderr)
    for event in collector.events:
        published.add(event)
    return published


def positions_of(setup: Setup, published: Published) -> list[tuple[float, list[float]]]:
    """The positions the daemon was given: host time [s], [3] m."""
    if not setup.with_tracker:
        return []
    if published.is_live:
        return [(seconds(m.t_ns), list(m.position)) for m in published.messages["TRACKER"] if m.valid]
    table = tracker_csv.read(setup.run / "tracker.csv")
    times = [round(t, 9) for t in table.t.tolist()]
    return list(zip(times, table.stack("x", "y", "z").tolist(), strict=True))


def seconds(t_ns: int) -> float:
    """s nearest to t_ns, as a file of times in s gives them: since 1970 they are known to 0.2 us only."""
    return round(t_ns / 10**9, 9)
