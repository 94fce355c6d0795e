# SPDX-License-Identifier: Apache-2.0
"""Record a position instrument beside the platform: bytes in, TRACKER messages and a run folder out.

RUN/tracker.csv: valid positions or poses in host time; RUN/tracker.raw: every byte as it came; RUN/run.lcmlog: every
message of the channel prefix or of --channels, TRACKER (with device time and lost samples) and the commanded POSE among
them; RUN/header.json: host, and the state of its clock.
"""

import contextlib
import errno
import os
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

import inertiad_core
from inertiad.base import channels
from inertiad.base.error import InputError
from inertiad.live import incoming, lcm_network
from inertiad.live.byte_sources import Input, open_input
from inertiad.live.tracker_protocols import Layout, Parser, Sample
from inertiad.run import folder as run_folder
from inertiad.run import host_info, lcmlog, tracker_csv
from inertiad_lcm import tracker_t

FAR: Final = tracker_csv.FAR
UNBELIEVABLE: Final = 1e7
"""m: beyond it is not a wrong unit but wrong bytes"""
JUDGE_AFTER: Final = 20
"""samples, all of them out of range, after which the recording is refused"""
RATE_AFTER: Final = 2.0
"""s of host time after which device time must have run as fast"""
RATE_FACTOR: Final = 10.0
"""within which it must: units lie further apart, and a recorder that lags for lack of computing time may not look so"""
HOLD_NS: Final = 10_000_000_000
"""for which a row of tracker.csv waits at most for the clock's fit"""
SAME_FIT_NS: Final = 1_000_000_000
"""within which a fit that is the same but better may move a sample; more is another one"""
CHANNELS_SHOWN: Final = 100
LINE_MAX: Final = 8000
"""characters of a line shown: all channels"""
STEP_BACK: Final = 1.0
"""s of device time: more is a restart of the instrument, less a late duplicate"""


# ---- samples to messages --- -----------------------------------------------------------------------------------------


@dataclass
class Counts:
    """Counts since the start."""

    n_bytes: int = 0
    n_samples: int = 0
    n_published: int = 0
    n_invalid: int = 0
    """beam lost"""
    n_lost: int = 0
    """frame numbers left out"""
    n_repeated: int = 0
    """duplicates and samples out of order, left out"""
    n_far: int = 0
    """not believable: unit or byte order"""
    n_bad: int = 0
    """packets or lines that cannot be read"""
    latency_us: deque[float] = field(default_factory=lambda: deque(maxlen=10_000))
    """from the earliest possible arrival to the real one, by the clock's fit; the last 10000"""
    host_ns: deque[int] = field(default_factory=lambda: deque(maxlen=1000))
    """the last 1000"""

    def rate(self) -> float:
        """Hz over the last samples."""
        t = self.host_ns
        return (len(t) - 1) / (1e-9 * (t[-1] - t[0])) if len(t) > 1 and t[-1] > t[0] else 0.0


class Tracker:
    """Samples to host time, checked, counted."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.counts = Counts()
        self._clock = inertiad_core.Clock(layout.time_wrap)
        self._frame: int | None = None
        self._time: float | None = None
        self._began: tuple[float, int] | None = None
        """device [s] and host [ns] time of the first sample"""
        self._is_judged = False
        self._has_device_time = False

    def _check_rate(self, t_device: float, host_ns: int) -> None:
        """InputError: device time does not pass as host time does."""
        if self._is_judged:
            return
        if self._began is None or t_device < self._began[0]:
            self._began = t_device, host_ns
        passed = 1e-9 * (host_ns - self._began[1])
        if passed < RATE_AFTER:
            return
        rate = (t_device - self._began[0]) / passed
        if not 1.0 / RATE_FACTOR < rate < RATE_FACTOR:
            raise InputError(
                f"device time passes {rate:.4g} times as fast as the host's: allowed: about as fast; "
                "is --time-unit right? --no-device-time leaves it out"
            )
        self._is_judged = True

    def _is_repeated(self, sample: Sample) -> bool:
        """By frame number, else by device time; counts the frames left out."""
        if sample.frame is not None:
            step = 1 if self._frame is None else (sample.frame - self._frame + 2**31) % 2**32 - 2**31
            if -1000 < step <= 0:
                return True
            self.counts.n_lost += step - 1 if step > 1 else 0
            self._frame = sample.frame
        elif sample.t_device is not None:
            step_s = 1.0 if self._time is None else sample.t_device - self._time
            if -STEP_BACK < step_s <= 0.0:
                return True
            self._time = sample.t_device
        return False

    def _is_far(self, sample: Sample) -> bool:
        worst = max(abs(v) for v in sample.position)
        if worst <= FAR:
            return False
        c = self.counts
        c.n_far += 1
        if c.n_far >= JUDGE_AFTER and c.n_published == 0:
            if worst > UNBELIEVABLE:
                raise InputError(
                    f"positions such as {worst:.3g} m: allowed: within {FAR:g} m; is the byte order right?"
                )
            raise InputError(f"positions such as {worst:.6g} m: allowed: within {FAR:g} m; is it in mm? try --unit mm")
        return True

    def take(self, sample: Sample, host_ns: int) -> tracker_t | None:
        """The message for a sample that arrived at host_ns; None: left out. InputError: nothing but nonsense comes."""
        c = self.counts
        c.n_samples += 1
        c.host_ns.append(host_ns)
        if self._is_repeated(sample):
            c.n_repeated += 1
            return None
        if sample.valid and self._is_far(sample):
            return None
        message = tracker_t()
        message.t_ns = host_ns
        if sample.t_device is not None:
            self._has_device_time = True
            self._check_rate(sample.t_device, host_ns)
            message.t_ns = self._clock.map(sample.t_device, host_ns)
            message.t_device_ns = round(1e9 * sample.t_device)
            c.latency_us.append(1e-3 * (host_ns - message.t_ns))
        c.n_invalid += not sample.valid
        message.valid, message.position = sample.valid, list(sample.position)
        if sample.q is not None:
            message.has_q, message.q = True, list(sample.q)
        message.sequence, message.n_dropped = c.n_published, c.n_lost
        c.n_published += 1
        return message

    def is_settled(self) -> bool:
        """Can host times be relied on? Until the clock has seen prompt arrivals, they are late."""
        return not self._has_device_time or self._clock.is_settled

    def host_time(self, message: tracker_t) -> int:
        """Host time of a message as the clock is fitted now, ns; as published where device time started anew since."""
        if not self._has_device_time:
            return int(message.t_ns)
        t_ns = self._clock.at(1e-9 * message.t_device_ns)
        return int(t_ns if abs(t_ns - message.t_ns) < SAME_FIT_NS else message.t_ns)


# ---- LCM and files ---------------------------------------------------------------------------------------------------


class LcmRecorder:
    """Write every message whose channel matches a regular expression into a log, in a thread."""

    def __init__(self, url: str, channels: str, path: Path) -> None:
        self.log = lcmlog.Writer(path)
        self.n_by_channel: dict[str, int] = {}
        self._listener = lcm_network.Listener(url, channels, self._take)
        self._listener.start()

    def _take(self, channel: str, data: bytes) -> None:
        shown = channel if channel in self.n_by_channel or len(self.n_by_channel) < CHANNELS_SHOWN else "others"
        self.n_by_channel[shown] = self.n_by_channel.get(shown, 0) + 1
        self.log.write(time.time_ns() // 1000, channel, data)

    def stop(self) -> None:
        """Wait for messages on their way, and close the log."""
        time.sleep(0.2)
        self._listener.stop()
        self.log.close()


@dataclass(frozen=True)
class Options:
    """Options of `inertiactl record`."""

    address: str
    layout: Layout
    folder: Path
    url: str
    prefix: str = channels.DEFAULT_PREFIX
    seconds: float | None = None
    channels: str = ""
    """regular expression of the LCM channels to log; "": all of the prefix"""


class Recording:
    """Everything a recording writes to."""

    def __init__(self, options: Options) -> None:
        self.folder = run_folder.open_run(options.folder)
        for name in ("tracker.csv", "run.lcmlog"):
            if (self.folder / name).exists():
                raise InputError(f"{self.folder / name}: exists already; choose a new run folder")
        self.tracker = Tracker(options.layout)
        self.parser = Parser(options.layout)
        self.error = ""
        self.n_rows = self.n_out_of_order = self.n_unwritten = 0
        self._channel = f"{options.prefix}TRACKER"
        self.lcm = LcmRecorder(options.url, options.channels or f"{options.prefix}.*", self.folder / "run.lcmlog")
        self._link = lcm_network.connect(options.url)
        self._raw = (self.folder / "tracker.raw").open("wb", buffering=0)
        self._csv = (self.folder / "tracker.csv").open("wb", buffering=0)
        heads = tracker_csv.POSE_HEADER if options.layout.has_attitude else tracker_csv.HEADER
        self._write(self._csv, (heads + "\n").encode())
        self._last_ns = 0
        self._waiting: deque[tracker_t] = deque()
        host_info.write(self.folder)

    def _write(self, file: FileIO, data: bytes) -> bool:
        """All of data or, on a full disk, none of it: no half row is left behind. True: written."""
        try:
            n = file.write(data) or 0
            if n < len(data):
                file.seek(-n, os.SEEK_CUR)
                file.truncate()
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self.n_unwritten += 1
            self.error = f"{file.name}: {error.strerror}"
            return False
        return True

    def take(self, data: bytes, is_end: bool) -> None:
        """Bytes that have come now."""
        host_ns = time.time_ns()
        self.tracker.counts.n_bytes += len(data)
        self._write(self._raw, data)
        samples = self.parser.feed(data) + (self.parser.end() if is_end else [])
        self.tracker.counts.n_bad = self.parser.n_bad
        for sample in samples:
            message = self.tracker.take(sample, host_ns)
            if message is not None:
                self._link.publish(self._channel, message.encode())
                self._keep(message)

    def _keep(self, message: tracker_t) -> None:
        """A valid message becomes a row of tracker.csv once its time is final: a better fit moves it back."""
        if message.valid:
            self._waiting.append(message)
        while self._waiting and (self.tracker.is_settled() or message.t_ns - self._waiting[0].t_ns > HOLD_NS):
            self._write_row(self._waiting.popleft())

    def _write_row(self, message: tracker_t) -> None:
        """A row of tracker.csv, if it is later than the one before."""
        t_ns = self.tracker.host_time(message)
        if t_ns // 1000 <= self._last_ns // 1000:  # came together without device time
            self.n_out_of_order += 1
            return
        self._last_ns = t_ns
        s, us = divmod(t_ns // 1000, 1_000_000)
        values = [*message.position, *(message.q if message.has_q else ())]
        self.n_rows += self._write(self._csv, f"{s}.{us:06d},{','.join(f'{v:.9f}' for v in values)}\n".encode())

    def close(self) -> None:
        """Write the rows that wait, close all files."""
        while self._waiting:
            self._write_row(self._waiting.popleft())
        self.lcm.stop()
        self._raw.close()
        self._csv.close()


# ---- show ------------------------------------------------------------------------------------------------------------


def facts(source: Input, recording: Recording) -> Iterator[tuple[str, str]]:
    """Name and value of everything worth showing."""
    c = recording.tracker.counts
    yield "connected", f"{'yes' if source.is_connected else 'no'}, {source.n_connected} times"
    yield "samples", f"{c.n_samples} received, {c.n_published} published, {c.rate():.1f} Hz, {c.n_bytes} bytes"
    yield "lost, repeated", f"{c.n_lost} lost by frame number, {c.n_repeated} duplicates or out of order"
    yield "beam lost", f"{c.n_invalid} samples"
    bad = f"{c.n_bad} unreadable, {c.n_far} out of range, {source.n_foreign} from another sender"
    yield "left out", bad + (f"; last: {recording.parser.last_bad}" if c.n_bad else "")
    if c.latency_us:
        p50, p99, worst = np.percentile(c.latency_us, [50, 99, 100])
        yield "late", f"{p50:.0f} us (p50), {p99:.0f} us (p99), {worst:.0f} us (max) after the earliest arrivals"
    n = recording.n_out_of_order
    unordered = f", {n} left out: not later than the row before" if n else ""
    yield "tracker.csv", f"{recording.n_rows} rows{unordered}"
    log = recording.lcm.log
    channels = ", ".join(f"{k} {name}" for name, k in sorted(recording.lcm.n_by_channel.copy().items()))
    yield "LCM log", f"{log.n_events} messages ({channels or 'none yet'}), {log.n_failed} not written"
    error = recording.error or log.error
    if error:
        yield "not written", f"{recording.n_unwritten} pieces of tracker.raw and tracker.csv: {error}"


@dataclass(frozen=True)
class Summary:
    """The end of a recording."""

    lines: list[str]
    """for people"""
    document: dict[str, Any]
    """for programs: counts, rate in Hz, delays behind the earliest arrivals in s"""


def _document(source: Input, recording: Recording) -> dict[str, Any]:
    c = recording.tracker.counts
    late = [1e-6 * float(v) for v in np.percentile(c.latency_us, [50, 99, 100])] if c.latency_us else [None] * 3
    return {
        "run": str(recording.folder),
        "n_connected": source.n_connected,
        "n_samples": c.n_samples,
        "n_published": c.n_published,
        "rate": c.rate(),
        "n_bytes": c.n_bytes,
        "n_lost": c.n_lost,
        "n_repeated": c.n_repeated,
        "n_invalid": c.n_invalid,
        "n_bad": c.n_bad,
        "n_far": c.n_far,
        "n_foreign": source.n_foreign,
        "late": dict(zip(("p50", "p99", "max"), late, strict=True)),
        "n_rows": recording.n_rows,
        "n_out_of_order": recording.n_out_of_order,
        "n_by_channel": dict(recording.lcm.n_by_channel),
        "n_unwritten": recording.n_unwritten,
        "error": str(recording.error or recording.lcm.log.error or "") or None,
    }


def _view(source: Input, recording: Recording) -> Table:
    table = Table(title=Text(str(recording.folder)), title_justify="left", show_header=False)
    for name, value in facts(source, recording):
        table.add_row(name, Text(incoming.plain(value, LINE_MAX)))
    return table


def record(options: Options) -> Summary:
    """Record until interrupted or for options.seconds. InputError: see open_input(), Tracker.take()."""
    options.layout.check()
    source = open_input(options.address)
    recording = Recording(options)
    end = float("inf") if options.seconds is None else time.monotonic() + options.seconds
    console = Console(stderr=True)
    try:
        with contextlib.ExitStack() as stack:
            live = None
            if console.is_terminal:
                live = stack.enter_context(Live(_view(source, recording), console=console, refresh_per_second=4))
            shown = time.monotonic()
            while time.monotonic() < end:
                for data, is_end in source.receive():
                    recording.take(data, is_end)
                if live is not None and time.monotonic() - shown > 0.25:
                    shown = time.monotonic()
                    live.update(_view(source, recording))
    except KeyboardInterrupt:
        pass
    finally:
        source.close()
        recording.close()
    lines = [incoming.plain(f"{name}: {value}", LINE_MAX) for name, value in facts(source, recording)]
    return Summary(lines, _document(source, recording))
