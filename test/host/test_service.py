# SPDX-License-Identifier: Apache-2.0
"""The daemon as a service: what it tells the service manager, and what the unit file lets it do."""

import re
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest
from conftest import COGIRO, TOP

from inertiad.robot import configuration, description

DAEMON = TOP / "build/bin/inertiad"
UNIT = TOP / "firmware/packaging/inertiad.service"
EXPOSURE_MAX = 3.0
"""systemd calls up to 4 OK; a service without any of these settings has 9.6"""


class Manager:
    """The service manager's end of the notification socket."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))

    def next(self, seconds: float) -> dict[str, str] | None:
        """The next message; None: none came in time."""
        self.socket.settimeout(seconds)
        try:
            text = self.socket.recv(4096).decode()
        except TimeoutError:
            return None
        return dict(line.split("=", 1) for line in text.splitlines())


def test_ready_watchdog_and_stopping_over_a_real_socket(tmp_path):
    configuration.write(tmp_path / "robot.cfg", description.load(COGIRO / "robot.toml"), "robot.toml")
    manager = Manager(tmp_path / "notify")
    log = subprocess.Popen(["sleep", "60"], stdout=subprocess.PIPE)  # a bus on which nothing comes
    command = [DAEMON, "--config", tmp_path / "robot.cfg", "--bus", "file:-", "--lcm", "none"]
    tracker = tmp_path / "tracker.csv"
    tracker.write_text("t,x,y,z\n")
    environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1500000"}
    with subprocess.Popen(
        [*map(str, command), "--tracker", f"file:{tracker}"],
        stdin=log.stdout,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as daemon:
        assert manager.next(10)["READY"] == "1"
        for _ in range(2):
            message = manager.next(10)
            assert message["WATCHDOG"] == "1"
            assert message["STATUS"] == "0 frames/s, no estimate yet, 0 of 0 interfaces up"
        daemon.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        while manager.next(0.01) is not None:
            pass
        assert manager.next(1.5) is None  # a loop that hangs feeds nothing
        daemon.send_signal(signal.SIGCONT)
        assert manager.next(10)["WATCHDOG"] == "1"
        daemon.terminate()
        while (message := manager.next(10)) is not None and "STOPPING" not in message:
            pass
        assert message == {"STOPPING": "1"}
        stderr = daemon.communicate(timeout=20)[1]
    log.kill()
    log.communicate()
    assert daemon.returncode == 0
    assert "WatchdogSec=1.5 s: it is fed once a second only" in stderr


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit file with the program where it was built."""
    path = tmp_path / "inertiad.service"
    path.write_text(UNIT.read_text().replace("/usr/local/bin/inertiad", str(DAEMON)))
    return path


def test_unit_file_is_correct(unit):
    result = subprocess.run(["systemd-analyze", "verify", "--man=no", unit], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")


def test_unit_file_gives_no_more_than_it_needs(unit):
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", unit]
    result = subprocess.run(command, capture_output=True, text=True)
    found = re.search(r"Overall exposure level for inertiad.service: ([\d.]+)", result.stdout)
    assert found is not None, result.stderr
    assert float(found[1]) <= EXPOSURE_MAX
    text = UNIT.read_text()
    assert re.findall(r"CAP_\w+", text.split("AmbientCapabilities=")[1].splitlines()[0]) == [
        "CAP_NET_RAW",
        "CAP_NET_ADMIN",
        "CAP_SYS_NICE",
    ]
    assert "User=root" not in text


def test_unit_starts_the_daemon_with_options_it_knows():
    start = UNIT.read_text().split("ExecStart=")[1].split("\n#")[0].replace("\\\n", " ")
    known = subprocess.run([DAEMON, "--help"], capture_output=True, text=True).stdout
    options = re.findall(r"--[\w-]+", start)
    assert len(options) == 4 and all(f"{option} " in known for option in options)
