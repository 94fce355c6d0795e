# SPDX-License-Identifier: Apache-2.0
"""Pages of `inertiactl watch`: each fits 80 x 24. Text of messages is made plain before it gets here or here."""

from collections.abc import Sequence
from typing import Any, Final

from rich.console import Group
from rich.table import Table
from rich.text import Text

from inertiad.base.body import NAMES, UNITS, of_message
from inertiad.base.finding import Severity
from inertiad.live import findings, load
from inertiad.live.findings import CONDITIONS, SENSORS
from inertiad.live.incoming import clock, plain
from inertiad.live.latest import Latest
from inertiad_lcm import bus_t, estimate_t, event_t, health_t

BLOCKS: Final = "▁▂▃▄▅▆▇█"
SPARK_WIDTH: Final = 24
EVENTS_ON_FIRST: Final = 2
FINDINGS_ON_FIRST: Final = 6
STYLES: Final[dict[Severity, str]] = {"stop": "red", "care": "yellow", "good": "green"}


def sparkline(values: Sequence[float], width: int = SPARK_WIDTH) -> str:
    """Values as blocks of eight heights between their least and greatest, the newest at the right."""
    if not values:
        return ""
    picked = [values[len(values) * k // width] for k in range(width)] if len(values) > width else list(values)
    low, high = min(picked), max(picked)
    step = (high - low) / (len(BLOCKS) - 1)
    return "".join(BLOCKS[round((v - low) / step) if step > 0.0 else 0] for v in picked)


def _one_line(text: Text) -> Text:
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


def _table(*heads: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for k, head in enumerate(heads):
        table.add_column(
            head, justify="right" if k and head not in ("unit", "state", "last 60 s") else "left", no_wrap=True
        )
    return table


def _numbers(latest: Latest, estimate: estimate_t) -> Table:
    body, observable = of_message(estimate), estimate.observable
    table = _table("platform", "value", "± σ", "unit", "last 60 s")
    for i, (name, unit, value, std) in enumerate(zip(NAMES, UNITS, body.value, body.std, strict=True)):
        digits = 4 if unit == "m" else 3
        spark = sparkline([values[i] for values in latest.history])
        style = "" if observable[i] else "dim"
        table.add_row(name, f"{value:.{digits}f}", f"{std:.{digits}f}", unit, Text(spark, style="cyan"), style=style)
    return table


def _quality(estimate: estimate_t) -> Text:
    state = ("consistent", "green") if estimate.consistent else ("not a body that can exist", "red")
    counts = f"{estimate.n_windows} windows, {estimate.n_rows} rows, {estimate.n_dropped} dropped, "
    changes = f"{estimate.n_changes} payload changes, "
    nis = f"\nNIS {estimate.nis:.1f}: misfit of the last window in its own σ, squared; 6 is expected, 17 rare"
    return Text.assemble(counts, changes, state, (nis, "dim"))


def estimate_page(latest: Latest, url: str) -> list[Any]:
    """The ten numbers, what is wrong, the newest events."""
    parts: list[Any] = []
    if latest.estimate is None:
        parts.append(Text(f"waiting for an estimate on {url}", style="dim"))
    else:
        parts += [_numbers(latest, latest.estimate), _quality(latest.estimate)]
    for finding in [x for x in findings.of(latest.state) if x.severity != "good"][:FINDINGS_ON_FIRST]:
        action = f"; {finding.do}" if finding.do else ""
        parts.append(_one_line(Text(f"{finding.severity}: {finding.says}{action}", style=STYLES[finding.severity])))
    return parts + [event_line(event) for event in list(latest.events)[-EVENTS_ON_FIRST:]]


def _buses(health: health_t, before: health_t | None) -> Table:
    counted = findings.counters(health)
    table = _table("bus", "state", "frames/s", "frames", "errors", "lost")
    for i, (bus, rate) in enumerate(zip(health.bus, load.frame_rates(health, before), strict=True)):
        good = bus.up and bus.condition == bus_t.ACTIVE
        state = Text(CONDITIONS.get(bus.condition, "?") if bus.up else "down", style="green" if good else "red")
        lost = sum(counted.get(f"bus{i}.{cause}", 0) for cause in load.LOST)
        numbers = [str(counted.get(f"bus{i}.{name}", 0)) for name in ("frames", "error_frames")]
        shown_rate = "" if rate is None else f"{rate:.0f}"
        table.add_row(plain(bus.name, 32), state, shown_rate, *numbers, Text(str(lost), style="red" if lost else ""))
    return table


def _latencies(health: health_t) -> Table:
    table = _table("latency, µs", "p50", "p99", "p99.9", "longest", "n")
    for x in health.latency:
        values = (f"{1e6 * value:.1f}" for value in (x.p50, x.p99, x.p999, x.longest))
        table.add_row(plain(x.name, 20), *values, str(x.n))
    return table


def bus_page(latest: Latest, _url: str) -> list[Any]:
    """Buses, latencies after a frame's arrival, the machine."""
    if latest.health is None:
        return [Text("no HEALTH yet: it comes once a second", style="dim")]
    parts: list[Any] = [_buses(latest.health, latest.before)]
    if any(x.n for x in latest.health.latency):
        parts += [Text(""), _latencies(latest.health)]
    if latest.host is not None:
        facts = "; ".join(f"{plain(fact.name, 40)}: {plain(fact.value)}" for fact in latest.host.fact)
        parts += [Text(""), Text(facts, style="dim")]
    return parts


def loss_page(latest: Latest, _url: str) -> list[Any]:
    """Sensors' ages, losses by cause."""
    if latest.health is None:
        return [Text("no HEALTH yet: it comes once a second", style="dim")]
    health = latest.health
    ages = ", ".join(
        f"{name} {'none yet' if age < 0 else f'{1e3 * age:.0f} ms'}"
        for name, age in zip(SENSORS, health.age, strict=True)
    )
    parts: list[Any] = [Text(f"age of last sample: {ages}")]
    if health.frozen:
        parts.append(Text("frozen: nothing is learnt", style="cyan"))
    if n_carried := findings.counters(health).get("motion.carried"):
        parts.append(Text(f"{n_carried} rows in tracker gaps, position carried by attitude and IMU", style="yellow"))
    lost = load.losses(health)
    named = ", ".join(f"{name} {n}" for name, n in lost.items())
    parts.append(Text(f"lost: {named}", style="yellow") if lost else Text("nothing lost", style="green"))
    if latest.n_undecodable:
        says = f"{latest.n_undecodable} messages could not be decoded: of another version, or no messages"
        parts.append(Text(says, style="yellow"))
    return parts


def event_line(event: event_t) -> Text:
    """Time of day, source, text, in one line."""
    style = {event_t.DONE: "green", event_t.REFUSED: "red"}.get(event.kind, "")
    return _one_line(Text(f"{clock(event.t_ns)}  {plain(event.source, 40)}: {plain(event.text)}", style=style))


def event_page(latest: Latest, _url: str) -> list[Any]:
    """The newest events, the last at the end."""
    return [event_line(event) for event in latest.events] or [Text("no events", style="dim")]


PAGES: Final = (("estimate", estimate_page), ("buses", bus_page), ("losses", loss_page), ("events", event_page))


def whole(latest: Latest, url: str) -> Group:
    """All pages, one below the other, for output that is no terminal. No line is cut."""
    parts: list[Any] = []
    for name, page in PAGES:
        parts += [Text(f"{name}", style="bold"), *page(latest, url), Text("")]
    for part in parts:
        if isinstance(part, Text):
            part.no_wrap = False
    return Group(*parts)


def screen(latest: Latest, url: str, number: int, height: int) -> Group:
    """One page with the list of pages above, at most `height` lines as long as no line wraps."""
    tabs = Text("")
    for k, (name, _) in enumerate(PAGES):
        tabs.append(f" {k + 1} {name} ", style="reverse" if k == number else "dim")
        tabs.append(" ")
    tabs.append("Tab, 1-4: page; q: end", style="dim")
    if latest.silence > findings.SILENT_AFTER:
        tabs.append(f"  silent {latest.silence:.0f} s", style="yellow")
    parts = PAGES[number][1](latest, url)
    if PAGES[number][0] == "events":
        parts = parts[-(height - 2) :]
    return Group(tabs, Text(""), *parts)
