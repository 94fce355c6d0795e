# SPDX-License-Identifier: Apache-2.0
"""Buses and losses of a daemon, from HEALTH: rates, load, errors, latencies. One RAW block in a second is looked at."""

from collections.abc import Sequence
from typing import Any, Final

from inertiad.base.counters import is_loss
from inertiad.live import findings
from inertiad.live.findings import CONDITIONS
from inertiad.live.incoming import Decoder, finite, plain
from inertiad.run.frame_time import frame_time
from inertiad_lcm import health_t, raw_t

EXTENDED: Final = 1 << 31
FD: Final = 1
LOST: Final = ("dropped_by_kernel", "dropped_by_logger", "controller_overruns")
SHOWN_MOST: Final = 24
"""counters of losses listed"""


class BusLoad:
    """Mean duration of a frame on each bus, from the newest RAW block."""

    def __init__(self) -> None:
        self.newest: bytes | None = None
        """the newest RAW message, not decoded"""
        self._mean: dict[int, float] = {}

    def _measure(self, rates: Sequence[tuple[float, float]], decoder: Decoder) -> None:
        data, self.newest = self.newest, None
        message = None if data is None else decoder.decode(raw_t, data)
        if message is None:
            return
        took: dict[int, list[float]] = {}
        for frame in message.frame:
            if 0 <= frame.bus < len(rates) and rates[frame.bus][0] > 0.0 and frame.length >= 0:
                bitrate, data_bitrate = rates[frame.bus]
                kind = bool(frame.can_id & EXTENDED), bool(frame.flags & FD)
                took.setdefault(frame.bus, []).append(frame_time(frame.length, *kind, bitrate, data_bitrate or bitrate))
        self._mean |= {bus: sum(times) / len(times) for bus, times in took.items()}

    def take(
        self, now: health_t, before: health_t | None, rates: Sequence[tuple[float, float]], decoder: Decoder
    ) -> list[float | None]:
        """Share of time that each bus is busy, without stuff bits; None: unknown. rates: bit/s, nominal and data."""
        self._measure(rates, decoder)
        return [
            None if rate is None or i not in self._mean else round(rate * self._mean[i], 4)
            for i, rate in enumerate(frame_rates(now, before))
        ]


def frame_rates(now: health_t, before: health_t | None) -> list[float | None]:
    """Frames/s of each bus between two HEALTH messages; None: unknown."""
    new, old = findings.counters(now), findings.counters(before)
    seconds = 0.0 if before is None else 1e-9 * (now.t_ns - before.t_ns)
    if seconds <= 0.0:
        return [None] * len(now.bus)
    return [
        round((new.get(f"bus{i}.frames", 0) - old.get(f"bus{i}.frames", 0)) / seconds, 1) for i in range(len(now.bus))
    ]


def losses(health: health_t) -> dict[str, int]:
    """Counters of what was lost or refused, the greatest first."""
    found = {name: n for name, n in findings.counters(health).items() if n > 0 and is_loss(name)}
    return dict(sorted(found.items(), key=lambda item: -item[1])[:SHOWN_MOST])


def health_item(health: health_t, before: health_t | None, loads: list[float | None]) -> dict[str, Any]:
    """HEALTH for the page."""
    counted = findings.counters(health)
    buses = [
        {
            "name": plain(bus.name, 40),
            "state": CONDITIONS.get(bus.condition, "?") if bus.up else "down",
            "rate": rate,
            "load": load,
            "errors": counted.get(f"bus{i}.error_frames", 0),
            "lost": sum(counted.get(f"bus{i}.{cause}", 0) for cause in LOST),
        }
        for i, (bus, rate, load) in enumerate(zip(health.bus, frame_rates(health, before), loads, strict=True))
    ]
    latencies = [
        {"name": plain(x.name, 40), "n": x.n, "s": [x.p50, x.p99, x.p999, x.longest]}
        for x in health.latency
        if x.n > 0 and finite((x.p50, x.p99, x.p999, x.longest))
    ]
    return {
        "age": [round(a, 4) for a in health.age],
        "frozen": bool(health.frozen),
        "buses": buses,
        "latencies": latencies,
        "losses": list(losses(health).items()),
        "carried": counted.get("motion.carried", 0),
    }
