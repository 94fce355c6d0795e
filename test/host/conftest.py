# SPDX-License-Identifier: Apache-2.0
"""Robots and helpers shared by the host tests."""

import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from inertiad.robot import description
from inertiad.robot.description import Robot

TOP = Path(__file__).resolve().parents[2]
COGIRO = TOP / "firmware/robots/cogiro"

ISOLATED = [
    "unshare",
    "-n",
    "sh",
    "-c",
    'ip link set lo up multicast on; ip route add 224.0.0.0/4 dev lo; exec "$@"',
    "-",
]
"""before a command: a network of its own, in which LCM works"""

AFTER_IMU = 4 * 111e-6
"""s by which CoGiRo's forces are stamped later than its IMU, four frames of 111 bit after it on a bus of 1 Mbit/s"""

MINIMAL = """
name = "four"
[cables]
tension_min = 1
tension_max = 1000
"""
CORNERS = [(-2, -2), (2, -2), (2, 2), (-2, 2)]


def minimal_toml(n_cables: int, extra: str = "") -> str:
    """Text of a robot.toml with n cables from the corners of a square at 3 m to those of a box."""
    text = MINIMAL
    for i in range(n_cables):
        x, y = CORNERS[i % 4]
        z = 3.0 + 0.1 * (i // 4)
        text += f"[[cable]]\nanchor = [{x}, {y}, {z}]\nattachment = [{0.1 * x}, {0.1 * y}, {0.2 * (i // 4)}]\n"
    return text + extra


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules with slow tests first: the processors, each with a module of its own, then end at about the same time."""
    n_slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -n_slow[item.path])


@pytest.fixture
def cogiro() -> Robot:
    return description.load(COGIRO / "robot.toml")


@pytest.fixture
def robot_file(tmp_path: Path) -> Callable[[str], Path]:
    """Write text as robot.toml beside CoGiRo's DBC files."""

    def write(text: str) -> Path:
        for dbc in COGIRO.glob("*.dbc"):
            (tmp_path / dbc.name).write_bytes(dbc.read_bytes())
        path = tmp_path / "robot.toml"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def inertiactl() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the command line in a process of its own."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "inertiad", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=TOP)

    return run


@pytest.fixture(scope="session")
def can_over_udp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library that, preloaded into a program, gives it UDP sockets in place of CAN sockets; see can_over_udp.c."""
    library = tmp_path_factory.mktemp("can_over_udp") / "can_over_udp.so"
    source = TOP / "test/host/can_over_udp.c"
    subprocess.run(["cc", "-std=gnu11", "-O2", "-shared", "-fPIC", "-o", library, source], check=True)
    return library


def lock_step_lines(run: Path) -> list[str]:
    """Lines for the daemon in lock-step, in the order in which a replay of the run uses them."""
    lines = [(round(1e6 * float(line[1:18])), 0, line) for line in (run / "can.log").read_text().splitlines()]
    for line in (run / "tracker.csv").read_text().splitlines()[1:]:
        t, x, y, z = line.split(",")[:4]
        t_ns = round(1e6 * float(t)) * 1000
        lines.append((t_ns // 1000, 1, f"position {t_ns} {x} {y} {z}"))
    return [f"{line}\n" for _, _, line in sorted(lines, key=lambda item: item[:2])]
