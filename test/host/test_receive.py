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

FRAME = struct.pack("=IBBBB64s", 0x123, 8, 0, 0, 0, bytes(64))
PORT = 29501  # of vcan0


@pytest.fixture(scope="module")
def can_over_udp(tmp_path_factory) -> Path:
    library = tmp_path_factory.mktemp("can_over_udp") / "can_over_udp.so"
    source = TOP / "test/host/can_over_udp.c"
    subprocess.run(["cc", "-std=gnu11", "-O2", "-shared", "-fPIC", "-o", library, source], check=True)
    return library


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
def running(library: Path, robot: Path, inertiactl) -> Iterator[Daemon]:
    """The daemon, recording; its stderr is known afterwards."""
    folder = robot.parent
    inertiactl("compile", robot, "-o", folder / "robot.cfg")
    command = [TOP / "build/bin/inertiad", "--config", folder / "robot.cfg", "--bus", "socketcan:vcan0"]
    command += ["--lcm", "none", "--record", folder / "run.lcmlog"]
    environment = os.environ | {"LD_PRELOAD": str(library)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        daemon = Daemon(process)
        while f":{PORT:04X} " not in Path("/proc/net/udp").read_text():
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.01)
        yield daemon
        time.sleep(0.5)
        process.send_signal(signal.SIGTERM)
        daemon.stderr = process.communicate(timeout=20)[1]


def test_frames_of_a_full_bus_are_collected(can_over_udp, robot, inertiactl):
    rate = 20000.0
    with running(can_over_udp, robot, inertiactl) as daemon:
        daemon.send_paced(rate, 2.5)  # it looks at the rate once a second
        before = daemon.wake_ups()
        daemon.send_paced(rate, 2.0)
        wake_ups = (daemon.wake_ups() - before) / 2.0
    assert daemon.counter("decode.frames") == daemon.n_sent
    assert daemon.counter("bus0.dropped_by_kernel") == 0
    assert wake_ups < 1200.0


def test_a_burst_is_read_to_its_end(can_over_udp, robot, inertiactl):
    with running(can_over_udp, robot, inertiactl) as daemon:
        daemon.send(5000)
    assert daemon.counter("decode.frames") == 5000
