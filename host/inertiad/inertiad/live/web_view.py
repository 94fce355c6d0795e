# SPDX-License-Identifier: Apache-2.0
"""inertiactl live: a daemon's messages, or a recording at its own pace, on a web page.

LCM network | run.lcmlog -> Picture.take()   in a thread of the source
                            Picture.tick()   at 20 Hz -> Feed -> LiveServer, a thread per browser
"""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from inertiad.base.error import InputError
from inertiad.live import command, lcm_network, web_server
from inertiad.live.feed import Feed
from inertiad.live.picture import CHANNELS, KEPT, Picture
from inertiad.robot import description
from inertiad.run import lcmlog

TICK: Final = 0.05
"""s between pictures"""
PATIENCE: Final = 3.0
"""s to wait for a daemon's answer"""
BATCH: Final = 0.01
"""s by which messages of a recording may be early: they are handed on together"""
PLAYING: Final = "recording"
ENDED: Final = "the recording has ended"


@dataclass(frozen=True)
class Options:
    """Of the command line."""

    host: str
    port: int
    run: Path | None
    """recording to play instead of the network"""
    robot: Path | None
    url: str
    prefix: str
    seconds: float | None


def log_of(run: Path) -> Path:
    """The LCM log of a run. InputError: there is none."""
    log = run / "run.lcmlog" if run.is_dir() else run
    if not log.exists():
        raise InputError(f"{log}: No such file or directory; record one: inertiad --record {log.name}")
    if log.suffix != ".lcmlog":
        raise InputError(f"{log}: allowed: a run folder with run.lcmlog, or an .lcmlog")
    return log


class Player(threading.Thread):
    """Hands a recording's messages to take(channel, data) at the pace of its stamps."""

    def __init__(self, log: Path, take: Callable[[str, bytes], None], at_end: Callable[[str], None]) -> None:
        """at_end: is called with how it ended: the whole recording was played, or the place where it is damaged."""
        super().__init__(daemon=True)
        self._log, self._take, self._at_end = log, take, at_end
        self._is_over = threading.Event()

    def run(self) -> None:
        remarks: list[str] = []
        began, first, newest = time.monotonic(), 0, 0
        for event in lcmlog.read(self._log, remarks):
            first = first or event.t_us
            newest = max(newest, event.t_us)
            wait = began + 1e-6 * (newest - first) - time.monotonic()
            if wait > BATCH and self._is_over.wait(wait):
                return
            self._take(event.channel, event.data)
        self._at_end(remarks[0] if remarks else ENDED)

    def stop(self) -> None:
        """Play nothing more; back once the thread has ended."""
        self._is_over.set()
        self.join()


def _ticking(picture: Picture, is_over: threading.Event) -> None:
    due = time.monotonic()
    while not is_over.is_set():
        picture.tick(time.monotonic())
        due = max(due + TICK, time.monotonic() - TICK)
        is_over.wait(max(due - time.monotonic(), 0.0))


def _executed(options: Options) -> web_server.Command | None:
    """Commands to the daemon on the network; None for a recording."""
    if options.run is not None or not options.url.startswith("udpm://"):
        return None

    def execute(name: str, text: str | None) -> tuple[bool, str]:
        answer = command.send(command.make(name, text), options.url, options.prefix, PATIENCE)
        return (False, f"no answer within {PATIENCE:g} s") if answer is None else (answer.is_done, answer.text)

    return execute


def _described(options: Options) -> Path | None:
    if options.robot is not None or options.run is None:
        return options.robot
    beside = (options.run if options.run.is_dir() else options.run.parent) / "robot.toml"
    return beside if beside.exists() else None


def serve(options: Options, say: Callable[[str], None]) -> None:
    """Serve the page until interrupted, or for some seconds; say() gets its address.

    InputError: the address cannot be used, there is no such recording or description; see also lcm_network.connect().
    """
    log = log_of(options.run) if options.run is not None else None
    robot = _described(options)
    feed = Feed(KEPT)
    picture = Picture(feed, description.load(robot) if robot is not None else None, str(robot))

    def take(channel: str, data: bytes) -> None:
        if channel.startswith(options.prefix):
            picture.take(channel.removeprefix(options.prefix), data, time.monotonic())

    picture.note = PLAYING if log is not None else ""

    def end(how: str) -> None:
        picture.note = how

    server = web_server.LiveServer(options.host, options.port, feed, _executed(options))
    channels = f"{re.escape(options.prefix)}({'|'.join(CHANNELS)})"
    source = Player(log, take, end) if log is not None else lcm_network.Listener(options.url, channels, take)
    threads = [
        threading.Thread(target=server.serve_forever, daemon=True),
        threading.Thread(target=_ticking, args=(picture, server.is_over), daemon=True),
        source,
    ]
    say(f"{server.url}  Ctrl-C ends it")
    if not web_server.is_loopback(options.host):
        say("everyone who reaches this address sees the page; commands are off")
    for thread in threads:
        thread.start()
    try:
        server.is_over.wait(options.seconds)
    finally:
        server.is_over.set()
        source.stop()
        server.shutdown()
        server.server_close()
