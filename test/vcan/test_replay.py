# SPDX-License-Identifier: Apache-2.0
"""Replay and verify on real SocketCAN; pacing beside canplayer's. Buses by tools/vcan, runs by prepare.py."""

import re
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

TOP = Path(__file__).resolve().parents[2]
CTL = TOP / "build/bin/inertiactl"
CLASSICAL, FD = (TOP / "build/vcan" / name / "run" for name in ("robot", "robot_fd"))
FD_FLAGS = re.compile("##(.)")  # newer kernels add bit 2, "is FD", to what was sent
LINE = re.compile(r"\((\d+)\.(\d+)\) \S+ (\S+)")


def stamps_and_frames(text: str) -> tuple[np.ndarray, list[str]]:
    """us, and what stands behind the interface, of candump lines."""
    found = LINE.findall(text)
    frames = [FD_FLAGS.sub(lambda m: f"##{int(m[1], 16) & 3:X}", f) for *_, f in found]
    return np.array([1_000_000 * int(s) + int(us) for s, us, _ in found]), frames


def played(command: list[object], n: int, dump: Path) -> tuple[np.ndarray, list[str]]:
    """Run a player; what candump sees of it on vcan0."""
    with dump.open("w") as file:
        listener = subprocess.Popen(["candump", "-L", "-r", "8000000", "-n", str(n), "vcan0"], stdout=file)
        time.sleep(2.0)  # it has to be there first; the player itself takes long to start in an emulated guest
        try:
            subprocess.run([str(c) for c in command], check=True, timeout=400)
            listener.wait(timeout=60)
        finally:
            listener.terminate()
            listener.wait()
    return stamps_and_frames(dump.read_text())


def late_us(t_us: np.ndarray, log_us: np.ndarray) -> np.ndarray:
    late = (t_us - t_us[0]) - (log_us - log_us[0])
    return late - np.percentile(late, 1)


def test_frames_arrive_whole_and_in_order_and_pacing_is_told(tmp_path: Path):
    text = "".join((CLASSICAL / "can.log").read_text().splitlines(keepends=True)[:6000])
    (tmp_path / "can.log").write_text(text)
    log_us, frames = stamps_and_frames(text)
    rows = {}
    for name, command in {
        "replay": [CTL, "replay", tmp_path, "--bus", "socketcan:vcan0", "--tracker", "none"],
        "canplayer": ["canplayer", "-I", tmp_path / "can.log", "vcan0=can0"],
    }.items():
        t_us, got = played(command, len(frames), tmp_path / name)
        assert got == frames, name
        rows[name] = np.percentile(np.abs(late_us(t_us, log_us)), [50, 99, 100])
    for name, row in rows.items():
        print(
            f"{name:10} {len(frames) / (1e-6 * (log_us[-1] - log_us[0])):.0f} frames/s  |late| p50 p99 max [us]",
            row.round(),
        )
    assert rows["replay"][0] < 5000  # an emulated guest is slow; the figure for a real machine is the bench's


def test_fd_frames_arrive_as_they_are(tmp_path: Path):
    frames = stamps_and_frames((FD / "can.log").read_text())[1]
    command = [CTL, "replay", FD, "--bus", "socketcan:vcan0", "--tracker", "none"]
    assert played(command, len(frames), tmp_path / "dump")[1] == frames


def test_two_interfaces_of_a_log_go_to_two_buses(tmp_path: Path):
    lines = [f"({1 + 0.001 * k:017.6f}) can{k % 2} 123#{k:04X}\n" for k in range(200)]
    (tmp_path / "can.log").write_text("".join(lines))
    buses = ["--bus", "socketcan:vcan1", "--bus", "socketcan:vcan0"]
    _, got = played([CTL, "replay", tmp_path, *buses], 100, tmp_path / "dump")
    assert got == [f"123#{k:04X}" for k in range(1, 200, 2)]


def test_absent_interface_is_one_line(tmp_path: Path):
    command = [str(CTL), "replay", str(CLASSICAL), "--bus", "socketcan:vcan9"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (result.returncode, result.stderr) == (2, "inertiactl: --bus socketcan:vcan9: No such device\n")


@pytest.mark.parametrize("run", [CLASSICAL, FD], ids=["classical", "fd"])
def test_live_run_verifies(run: Path, tmp_path: Path):
    command = [str(CTL), "verify", str(run), "--bus", "socketcan:vcan0", "--json", str(tmp_path / "verify.json")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=800)
    print(result.stdout, result.stderr)
    assert result.returncode == 0
