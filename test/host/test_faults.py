# SPDX-License-Identifier: Apache-2.0
"""What test/vcan does to frames on a real bus, from files: the same faults, exact stamps, within seconds."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from inertiad.run import reader

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/vcan"))
import faults  # noqa: E402
import scenarios  # noqa: E402

OF_FRAMES = [s for s in scenarios.SCENARIOS if not s.actions and not s.options]
START = 100.0  # s

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("faults")


@pytest.fixture(scope="module")
def run(folder: Path) -> scenarios.Frames:
    return scenarios.simulate(folder)


def line(frame: scenarios.Frame, stamp: float) -> str:
    if frame.can_id & scenarios.ERROR:
        text = f"{frame.can_id:08X}#{frame.data.hex().upper()}"
    elif frame.can_id & scenarios.RTR:
        text = f"{frame.can_id & 0x7FF:03X}#R"
    else:
        text = f"{frame.can_id:03X}{'##1' if frame.is_fd else '#'}{frame.data.hex().upper()}"
    return f"({stamp:.6f}) can0 {text}\n"


def play(frames: scenarios.Frames, robot: Path) -> dict[str, int]:
    """Frames in the order they are due, stamped up to some ms late, through the daemon: its counters."""
    frames = sorted(frames, key=lambda f: f.due)
    late = np.random.default_rng(1).exponential(3e-4, len(frames))
    stamps = np.maximum.accumulate(START + np.array([f.due for f in frames]) + late)
    folder = robot.parent
    (folder / "can.log").write_text("".join(map(line, frames, stamps.tolist())))
    command = [TOP / "build/bin/inertiad", "-v", "--config", robot / "robot.cfg", "--lcm", "none",
               "--bus", f"file:{folder}/can.log", "--estimate", folder / "estimate.json"]  # fmt: skip
    result = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=True)
    return faults.read_summary(result.stderr)


@pytest.mark.parametrize("scenario", OF_FRAMES, ids=[s.name for s in OF_FRAMES])
def test_counters_add_up_and_estimate_holds(scenario: scenarios.Scenario, run: scenarios.Frames, folder: Path):
    counters = play(scenario.frames(run), folder / scenario.robot)  # when
    used, lost, wrong = faults.account(counters)  # then: every sample was used or is counted as lost
    assert wrong == []
    assert used + sum(lost.values()) == len(run)
    assert [name for name in scenario.counted if not counters[name]] == []
    told = json.loads((folder / "estimate.json").read_text())["samples"]["rejected"]
    assert reader.read(folder, folder / scenario.robot / "robot.toml").n_rejected == told  # as read back offline
    truth = json.loads((folder / "run/truth.json").read_text())
    assert faults.sigmas(folder / "estimate.json", truth) < 3.0


def test_bursts_after_stalls_without_device_time_change_nothing(run: scenarios.Frames, folder: Path):
    estimate = []
    for frames in (run, scenarios.stall(run)):  # given, when
        counters = play(frames, folder / "untimed")
        assert counters["align.rows"] > len(run) / 3 - 3  # three messages a row, less the ends
        estimate.append(json.loads((folder / "estimate.json").read_text()))
    for name in ("mass", "cog", "inertia_cog"):  # then
        value, other, std = (np.array(e[name][key]) for e, key in ((estimate[0], "value"), (estimate[1], "value"),
                                                                   (estimate[0], "std")))  # fmt: skip
        assert np.all(np.abs(value - other) < 0.1 * std)
