# SPDX-License-Identifier: Apache-2.0
"""A running inertiad, for the tests here: started on a bus, followed by its HEALTH messages, stopped by SIGTERM."""

import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lcm

from inertiad_lcm import bus_t, health_t

TOP = Path(__file__).resolve().parents[2]
BIN = TOP / "build/bin"
CLASSICAL = TOP / "build/vcan/robot"
URL = "udpm://239.255.76.67:7667?ttl=0"
PATIENCE = 60.0  # s; an emulated guest is slow


def run(*command: object) -> str:
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True, timeout=180).stdout


class Daemon:
    """A running inertiad, and of its latest HEALTH message the counters and the state of its first bus."""

    def __init__(self, *options: object, robot: Path = CLASSICAL, bus: str = "socketcan:vcan0"):
        self.counters: dict[str, int] = {}
        self.condition = bus_t.ACTIVE
        self.lcm = lcm.LCM(URL)
        self.lcm.subscribe("INERTIAD_HEALTH", self._on_health)
        command = [BIN / "inertiad", "-v", "--config", robot / "robot.cfg", "--bus", bus, "--lcm", URL, *options]
        self.process = subprocess.Popen([str(c) for c in command], stderr=subprocess.PIPE, text=True)

    def _on_health(self, _channel: str, data: bytes) -> None:
        health = health_t.decode(data)
        self.counters = {c.name: c.value for c in health.counter}
        self.condition = health.bus[0].condition

    def wait(self, condition: Callable[[dict[str, int]], bool]) -> None:
        """Until the counters fulfil a condition."""
        end = time.monotonic() + PATIENCE
        while not (self.counters and condition(self.counters)):
            assert time.monotonic() < end, f"waited in vain, latest counters: {self.counters}"
            assert self.process.poll() is None, "the daemon ended by itself"
            self.lcm.handle_timeout(100)

    def stop(self) -> dict[str, int]:
        """SIGTERM; the counters of the final summary."""
        self.process.send_signal(signal.SIGTERM)
        _, text = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == 0, text
        rows = [line.removeprefix("inertiad: ").split() for line in text.splitlines()]
        return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}


@contextmanager
def daemon(*options: object, **where: Any) -> Iterator[Daemon]:
    d = Daemon(*options, **where)
    try:
        d.wait(lambda _: True)  # it has said that it is there
        yield d
    finally:
        d.process.kill()
        d.process.communicate()
