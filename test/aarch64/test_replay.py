# SPDX-License-Identifier: Apache-2.0
"""A log gives the same estimates, bit by bit, on x86-64 and on aarch64 under qemu-user."""

import subprocess
from pathlib import Path

import pytest

from inertiad.robot import configuration, description

TOP = Path(__file__).resolve().parents[2]
ROBOTS = TOP / "firmware/robots/cogiro"
COMMANDS = {
    "this machine": [str(TOP / "build/test/accept/replay")],
    "aarch64": ["qemu-aarch64", str(TOP / "build/aarch64/replay")],
}


def estimates(run: Path, config: Path) -> dict[str, bytes]:
    """Text of every estimate, 17 digits per number, by machine."""
    arguments = [str(path) for path in (config, run / "can.log", run / "tracker.csv")]
    return {
        name: subprocess.run([*command, *arguments], check=True, capture_output=True).stdout
        for name, command in COMMANDS.items()
    }


def check(run: Path, tmp_path: Path, n_least: int) -> None:
    configuration.write(tmp_path / "robot.cfg", description.load(run / "robot.toml"), "robot.toml")
    found = estimates(run, tmp_path / "robot.cfg")
    lines = {name: text.splitlines() for name, text in found.items()}
    assert len(lines["this machine"]) >= n_least
    different = [k for k, pair in enumerate(zip(*lines.values(), strict=True)) if pair[0] != pair[1]]
    assert not different, f"{len(different)} estimates differ, the first is number {different[0]}"
    assert found["this machine"] == found["aarch64"]


def test_old_log(tmp_path):
    check(TOP / "test/host/logs/estimate_v1", tmp_path, 10)


@pytest.mark.parametrize(
    ("robot", "options"),
    [
        ("robot.toml", ["--faults", "modern"]),
        ("robot.toml", ["--faults", "modern", "--plant", "rigid", "--payload", "20@5"]),
        ("robot_fd.toml", ["--faults", "paper"]),
    ],
)
def test_simulated_log(tmp_path, robot, options):
    run = tmp_path / "run"
    command = [TOP / "build/bin/inertiactl", "simulate", ROBOTS / robot, "-o", run, "--seed", "7", "--duration", "10"]
    subprocess.run([*map(str, command), *options], check=True, capture_output=True)
    check(run, tmp_path, 50)
