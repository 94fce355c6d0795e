# SPDX-License-Identifier: Apache-2.0
"""The daemon's side of a full bus, on UDP sockets in place of CAN: nothing lost, and not a wake-up per frame."""

import os
import re
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import COGIRO, TOP

pytestmark = pytest.mark.slow

FRAME = struct.pack("=IBBBB64s", 0x123, 8, 0, 0, 0, bytes(64))
PORT = 29501  # of vcan0


@pytest.fixture
def robot(robot_file) -> Path:
    """CoGiRo in one place: it needs no tracker."""
    fixed = '[position]\nsource = "fixed"\nfixed = [0, 0, 1]\n'
    return robot_file((COGIRO / "robot.toml").read_text() + fixed)


class Daemon:
    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.n_sent = 0
        self.stderr = ""

    def send(self, n: int) -> None:
        for _ in range(n):
            self.socket.sendto(FRAME, ("127.0.0.1", PORT))
        self.n_sent += n

    def send_paced(self, rate: float, seconds: float) -> None:
        begin = time.monotonic()
        n = 0
        while (now := time.monotonic() - begin) < seconds:
            self.send(int(rate * now) - n)
            n = int(rate * now)
            time.sleep(50e-6)

    def wake_ups(self) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.findall(r"^voluntary_ctxt_switches:\s+(\d+)", status, re.M)[0])

    def counter(self, name: str) -> int:
        return int(re.findall(rf"^inertiad: {name} +(\d+)$", self.stderr, re.M)[0])


@contextmanager
def running(library: Path, robot: Path, inertiactl, *options: str, **environment: str) -> Iterator[Daemon]:
    """The daemon, recording; its stderr is known afterwards."""
    folder = robot.parent
    inertiactl("compile", robot, "-o", folder / "robot.cfg")
    command = [TOP / "build/bin/inertiad", "-v", *options, "--config", folder / "robot.cfg", "--bus", "socketcan:vcan0"]
    command += ["--lcm", "none", "--record", folder / "run.lcmlog"]
    environment |= os.environ | {"LD_PRELOAD": str(library)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        daemon = Daemon(process)
        while f":{PORT:04X} " not in Path("/proc/net/udp").read_text():
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.01)
        yield daemon
        time.sleep(0.5)
        process.send_signal(signal.SIGTERM)
        daemon.stderr = process.communicate(timeout=20)[1]


def wake_ups_per_second(daemon: Daemon, rate: float) -> float:
    """At that rate, once the daemon, which looks once a second, has seen it."""
    daemon.send_paced(rate, 2.5)
    before = daemon.wake_ups()
    daemon.send_paced(rate, 2.0)
    return (daemon.wake_ups() - before) / 2.0


@pytest.mark.parametrize(
    ("rate", "options", "least", "most"),
    [
        (20000.0, [], 0.0, 600.0),
        (2000.0, [], 0.0, 600.0),
        (2000.0, ["--collect", "0"], 1000.0, 1e9),
        (100.0, [], 50.0, 150.0),
        (0.0, [], 0.0, 20.0),
    ],
    ids=["full bus", "busy bus", "each as it comes", "quiet bus", "silence"],
)
def test_frames_gather_where_two_come_in_time(can_over_udp, robot, inertiactl, rate, options, least, most):
    with running(can_over_udp, robot, inertiactl, *options) as daemon:
        wake_ups = wake_ups_per_second(daemon, rate)
    assert daemon.counter("decode.frames") == daemon.n_sent
    assert daemon.counter("bus0.dropped_by_kernel") == 0
    assert least <= wake_ups < most


def test_frames_gather_for_no_longer_than_a_small_buffer_bears(can_over_udp, robot, inertiactl):
    with running(can_over_udp, robot, inertiactl, "--collect", "0.1", RECEIVE_BUFFER_MAX="212992") as daemon:
        daemon.send_paced(4000.0, 3.0)
    assert re.search(r"--collect: 0\.009\d+ s, not 0\.1: vcan0 has room for 554 frames only", daemon.stderr)
    assert daemon.counter("decode.frames") == daemon.n_sent


def test_a_burst_is_read_to_its_end(can_over_udp, robot, inertiactl):
    with running(can_over_udp, robot, inertiactl) as daemon:
        daemon.send(5000)
    assert daemon.counter("decode.frames") == 5000
