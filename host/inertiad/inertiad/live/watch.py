# SPDX-License-Identifier: Apache-2.0
"""A live view of the daemon's messages: estimate, buses, latencies, losses, events. LCM in, terminal out."""

import time
from collections import deque
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from inertiad.base.body import NAMES, UNITS, of_message
from inertiad.live.lcm_network import connect
from inertiad.run import estimate_message
from inertiad_lcm import bus_t, estimate_t, event_t, health_t, host_t

SILENT_AFTER = 2.0
"""s without a message after which the table warns"""
EVENTS_SHOWN = 6


class Latest:
    """The newest message of each kind and when it came."""

    def __init__(self) -> None:
        self.estimate: estimate_t | None = None
        self.health: health_t | None = None
        self.before: health_t | None = None
        """the HEALTH before that, for rates"""
        self.host: host_t | None = None
        self.events: deque[event_t] = deque(maxlen=EVENTS_SHOWN)
        self.heard = time.monotonic()

    def on_estimate(self, _channel: str, data: bytes) -> None:
        self.estimate = estimate_message.decode(data)
        self.heard = time.monotonic()

    def on_health(self, _channel: str, data: bytes) -> None:
        self.before, self.health = self.health, health_t.decode(data)
        self.heard = time.monotonic()

    def on_host(self, _channel: str, data: bytes) -> None:
        self.host = host_t.decode(data)
        self.heard = time.monotonic()

    def on_event(self, _channel: str, data: bytes) -> None:
        self.events.append(event_t.decode(data))
        self.heard = time.monotonic()

    @property
    def silence(self) -> float:
        """s since the last message."""
        return time.monotonic() - self.heard


def _estimate_table(estimate: estimate_t) -> Table:
    body = of_message(estimate)
    table = Table(title="platform", title_justify="left", min_width=52)
    for heading in ("", "value", "± std", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for name, unit, value, std in zip(NAMES, UNITS, body.value, body.std, strict=True):
        digits = 4 if unit == "m" else 3
        table.add_row(name, f"{value:.{digits}f}", f"{std:.{digits}f}", unit)
    return table


def _summary(estimate: estimate_t) -> Text:
    state = ("consistent", "green") if estimate.consistent else ("not a body that can exist", "red")
    counts = (
        f"{estimate.n_windows} windows, {estimate.n_rows} rows, {estimate.n_dropped} dropped, NIS {estimate.nis:.1f}   "
    )
    return Text.assemble(counts, state)


_AGE_NAMES = ("imu", "force", "position")
_CONDITIONS = {bus_t.ACTIVE: "active", bus_t.WARNING: "warning", bus_t.PASSIVE: "passive", bus_t.OFF: "bus-off"}
_LOSSES = ("dropped_by_kernel", "dropped_by_logger", "controller_overruns")
_UNWANTED = {
    "late",
    "missing",
    "overrun",
    "backwards",
    "not_finite",
    "incomplete",
    "bad_length",
    "duplicate",
    "dropped",
    "lost",
    "bad_quaternion",
    "bad_geometry",
    "signal_not_finite",
    "failed",
}


def _counters(health: health_t | None) -> dict[str, int]:
    return {} if health is None else {c.name: c.value for c in health.counter}


def _sensor_line(health: health_t) -> Text:
    ages = ", ".join(
        f"{name} {'none yet' if age < 0 else f'{1e3 * age:.0f} ms'}"
        for name, age in zip(_AGE_NAMES, health.age, strict=True)
    )
    return Text(f"age of last sample: {ages}", style="dim")


def _bus_table(health: health_t, before: health_t | None) -> Table:
    now, then = _counters(health), _counters(before)
    seconds = 1e-9 * (health.t_ns - before.t_ns) if before is not None else 0.0
    table = Table(title="buses", title_justify="left", min_width=52)
    for heading in ("", "state", "frames/s", "frames", "errors", "lost"):
        table.add_column(heading, justify="left" if heading in ("", "state") else "right")
    for i, bus in enumerate(health.bus):
        frames = now.get(f"bus{i}.frames", 0)
        rate = f"{(frames - then.get(f'bus{i}.frames', 0)) / seconds:.0f}" if seconds > 0 else ""
        lost = sum(now.get(f"bus{i}.{cause}", 0) for cause in _LOSSES)
        good = bus.up and bus.condition == bus_t.ACTIVE
        state = Text(_CONDITIONS.get(bus.condition, "?") if bus.up else "down", style="green" if good else "red")
        errors = str(now.get(f"bus{i}.error_frames", 0))
        table.add_row(bus.name, state, rate, str(frames), errors, Text(str(lost), style="red" if lost else ""))
    return table


def _latency_table(health: health_t) -> Table:
    table = Table(title="latency after the frame's arrival, µs", title_justify="left", min_width=52)
    for heading in ("", "p50", "p99", "p99.9", "longest", "n"):
        table.add_column(heading, justify="left" if heading == "" else "right")
    for x in health.latency:
        table.add_row(x.name, *(f"{1e6 * value:.1f}" for value in (x.p50, x.p99, x.p999, x.longest)), str(x.n))
    return table


def _loss_line(health: health_t) -> Text:
    """Counters of losses and refusals that are not 0."""
    lost = {
        name: n
        for name, n in _counters(health).items()
        if n and (name.rpartition(".")[2] in _UNWANTED or name.startswith("stuck."))
    }
    if not lost:
        return Text("nothing lost", style="green")
    return Text("lost: " + ", ".join(f"{name} {n}" for name, n in lost.items()), style="yellow")


def _event_line(event: event_t) -> Text:
    clock = time.strftime("%H:%M:%S", time.localtime(1e-9 * event.t_ns))
    style = {event_t.DONE: "green", event_t.REFUSED: "red"}.get(event.kind, "")
    return Text(f"{clock}  {event.source}: {event.text}", style=style)


def _host_line(host: host_t) -> Text:
    return Text("; ".join(f"{fact.name}: {fact.value}" for fact in host.fact), style="dim")


def _health_parts(health: health_t, before: health_t | None) -> list[Any]:
    parts: list[Any] = [_bus_table(health, before)]
    if any(x.n for x in health.latency):
        parts.append(_latency_table(health))
    parts += [_sensor_line(health), _loss_line(health)]
    if n_carried := _counters(health).get("motion.carried"):
        parts.append(Text(f"{n_carried} rows in tracker gaps, position carried by attitude and IMU", style="yellow"))
    if health.frozen:
        parts.append(Text("frozen: nothing is learnt", style="cyan"))
    return parts


def _view(latest: Latest, url: str) -> Group:
    parts: list[Any] = []
    if latest.estimate is None:
        parts.append(Text(f"waiting for an estimate on {url}", style="dim"))
    else:
        parts += [_estimate_table(latest.estimate), _summary(latest.estimate)]
    if latest.health is not None:
        parts += _health_parts(latest.health, latest.before)
    if latest.host is not None:
        parts.append(_host_line(latest.host))
    parts += [_event_line(event) for event in latest.events]
    if latest.silence > SILENT_AFTER:
        parts.append(Text(f"no message for {latest.silence:.0f} s", style="yellow"))
    return Group(*parts)


def watch(url: str, prefix: str, seconds: float | None) -> None:
    """Show the estimate until interrupted, for some seconds, or to the end of a log. InputError: see connect()."""
    bus = connect(url)
    latest = Latest()
    bus.subscribe(f"{prefix}ESTIMATE", latest.on_estimate)
    bus.subscribe(f"{prefix}HEALTH", latest.on_health)
    bus.subscribe(f"{prefix}EVENT", latest.on_event)
    bus.subscribe(f"{prefix}HOST", latest.on_host)
    end = None if seconds is None else time.monotonic() + seconds
    with Live(_view(latest, url), console=Console(), refresh_per_second=10, transient=False) as live:
        while end is None or time.monotonic() < end:
            try:
                bus.handle_timeout(100)
            except OSError:  # a log file has come to its end
                break
            live.update(_view(latest, url))
