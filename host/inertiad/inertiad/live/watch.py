# SPDX-License-Identifier: Apache-2.0
"""inertiactl watch: the daemon's messages in a terminal, page by page, or as lines of JSON. LCM in, text out."""

import json
import math
import os
import re
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

from rich.console import Console
from rich.live import Live

from inertiad.live.incoming import plain
from inertiad.live.latest import Latest
from inertiad.live.lcm_network import connect
from inertiad.live.watch_pages import PAGES, screen, whole
from inertiad_lcm import bus_t, counter_t, estimate_t, event_t, fact_t, health_t, host_t, latency_t

CHANNELS: Final = ("ESTIMATE", "HEALTH", "EVENT", "HOST")
POLL: Final = 0.1
"""s between looks at keys and clock"""
_LENGTHS: Final = {f"n_{name}" for name in ("systematic", "counters", "buses", "latencies", "buckets", "facts")}
_STRUCTS: Final = (bus_t, counter_t, estimate_t, event_t, fact_t, health_t, host_t, latency_t)


def _plain(value: Any) -> Any:
    """A message or a part of it as JSON has it: names and values in place of counters and facts, null for no number."""
    match value:
        case str():
            return plain(value, len(value))
        case float():
            return value if math.isfinite(value) else None
        case list() | tuple():
            if value and isinstance(value[0], counter_t | fact_t):
                return {plain(item.name, 200): _plain(item.value) for item in value}
            return [_plain(item) for item in value]
    if isinstance(value, _STRUCTS):
        return {name: _plain(getattr(value, name)) for name in value.__slots__ if name not in _LENGTHS}
    return value


def json_line(channel: str, message: Any) -> str:
    """One message as one line: its fields as in lcm_types, SI units, and "message": ESTIMATE, HEALTH, EVENT or HOST."""
    return json.dumps({"message": channel, **_plain(message)}, allow_nan=False)


class _Link:
    """Messages of a daemon, handed on one by one."""

    def __init__(self, url: str, prefix: str, take: Callable[[str, bytes], None]) -> None:
        self._bus = connect(url)
        for channel in CHANNELS:
            self._bus.subscribe(re.escape(f"{prefix}{channel}"), lambda c, data: take(c.removeprefix(prefix), data))

    def is_open_after(self, seconds: float) -> bool:
        """Hand on what comes within so long; False: a log has come to its end."""
        try:
            self._bus.handle_timeout(max(1, int(1e3 * seconds)))
        except OSError:
            return False
        return True


@contextmanager
def _keys() -> Iterator[Callable[[], str]]:
    """A function that returns the key pressed since, "" for none; keys are not shown meanwhile."""
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd)
        yield lambda: os.read(fd, 16).decode(errors="ignore") if select.select([fd], [], [], 0.0)[0] else ""
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)


def turned(page: int, key: str) -> int:
    """The page after a key."""
    if key in ("\t", "\x1b[C", " "):
        return (page + 1) % len(PAGES)
    if key in ("\x1b[D", "\x1b[Z"):
        return (page - 1) % len(PAGES)
    return int(key) - 1 if key.isdigit() and 1 <= int(key) <= len(PAGES) else page


def _shown(latest: Latest, link: _Link, url: str, console: Console, is_time: Callable[[], bool]) -> None:
    """Pages in the terminal until the time is over, the log has ended, or q."""
    page, is_open = 0, True
    with _keys() as key, Live(console=console, screen=True, auto_refresh=False) as live:
        while is_open and is_time():
            drawn = time.monotonic() + POLL
            while is_open and (left := drawn - time.monotonic()) > 0.0:
                is_open = link.is_open_after(left)
            pressed = key()
            if pressed in ("q", "Q"):
                return
            page = turned(page, pressed)
            live.update(screen(latest, url, page, console.size.height), refresh=True)


def watch(url: str, prefix: str, seconds: float | None, as_json: bool) -> bool:
    """Show the estimate until interrupted, for some seconds, or to the end of a log. False: no message came.

    InputError: see connect().
    """
    latest = Latest()
    end = math.inf if seconds is None else time.monotonic() + seconds

    def take(channel: str, data: bytes) -> None:
        message = latest.take(channel, data)
        if as_json and message is not None:
            print(json_line(channel, message), flush=True)

    def is_time() -> bool:
        return time.monotonic() < end

    link, console = _Link(url, prefix, take), Console()
    if console.is_terminal and not as_json:
        _shown(latest, link, url, console, is_time)
        console.print(screen(latest, url, 0, console.size.height))
    else:
        while is_time() and link.is_open_after(POLL):
            pass
        if not as_json:
            console.print(whole(latest, url))
    return latest.is_heard
