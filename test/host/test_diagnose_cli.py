# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a lab, made in a simulated run and found by `inertiactl fit` in words one can act on."""

import subprocess
import sys
from pathlib import Path

import mistakes
import pytest
from test_fit import _static_poses
from typer.testing import CliRunner

from inertiad.base.error import InputError
from inertiad.cli.main import app
from inertiad.identify import diagnose
from inertiad.run import reader

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/accept"))
import scenes  # noqa: E402

pytestmark = pytest.mark.slow

SAID = {
    "channels exchanged": "cables 3 and 4 look swapped: residual falls from",
    "forces in kN": "are the forces in kN?",
    "forces in kg": "are the forces in kg?",
    "IMU upside down": "mounted upside down",
    "IMU turned": "the IMU looks turned by -90 deg about z",
    "gravity sign": "gravity has the wrong sign",
    "tracker in mm": "is the tracker in mm?",
    "pulley forgotten": "pulley_radius = 0.05",
    "pulley's diameter": "pulley_radius = 0.0",
    "slack cable": "cable 1 is slack for 10 % of the time",
    "saturated sensor": "force sensor 1 is saturated at",
}


def _fit(*arguments: object) -> tuple[int, str]:
    """Exit code and stderr of inertiactl fit, in this process: a dozen starts of Python take longer than all of it."""
    result = CliRunner().invoke(app, ["fit", *map(str, arguments)])
    return (2, str(result.exception)) if isinstance(result.exception, InputError) else (result.exit_code, result.stderr)


@pytest.mark.parametrize("name", mistakes.MISTAKES)
def test_a_mistake_is_named(name: str, tmp_path: Path) -> None:
    folder = mistakes.make(name, scenes.run(1000, "modern", 100.0, "fourier"), tmp_path / "run")
    code, said = _fit(folder)
    if name == "tracker in mm":  # no position is within reach of the cables: nothing to fit
        assert code == 2 and SAID[name] in said
        return
    stops = [line for line in said.splitlines() if line.startswith("stop: ")]
    cares = [line for line in said.splitlines() if line.startswith("care: ")]
    assert code == (1 if stops else 0)
    assert SAID[name] in (stops or cares)[0], said


def test_a_wrong_pulley_radius_is_found_to_a_few_millimetres(tmp_path: Path) -> None:
    for name in ("pulley forgotten", "pulley's diameter"):
        folder = mistakes.make(name, scenes.run(1001, "modern", 100.0, "fourier"), tmp_path / name)
        run = reader.read(folder)
        finding = diagnose.diagnose(run.robot, [run])[0]
        radius = float(finding.says.split("pulley_radius = ")[1].split()[0])
        assert radius == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize(
    ("level", "rate", "motion"),
    [("ideal", 100.0, "fourier"), ("modern", 50.0, "paper"), ("paper", 25.0, "fourier"), ("paper", 25.0, "paper")],
)
def test_good_runs_have_no_finding(level: str, rate: float, motion: str) -> None:
    for seed in range(1000, 1003):
        run = reader.read(scenes.run(seed, level, rate, motion))
        assert diagnose.diagnose(run.robot, [run]) == [], seed


def test_holding_one_pose_is_said_and_what_is_not_observable(tmp_path: Path) -> None:
    simulate = ["simulate", str(scenes.COGIRO), "--trajectory", "hold", "--duration", "20", "--rate", "100"]
    assert CliRunner().invoke(app, [*simulate, "-o", str(tmp_path / "run")]).exit_code == 0
    result = CliRunner().invoke(app, ["fit", str(tmp_path / "run")])
    assert result.exit_code == 0
    assert "care: one pose only" in result.stderr and "tilt the platform" in result.stderr
    blind = [line.split("  ")[0] for line in result.stdout.splitlines() if "not observable" in line]
    assert {"J xx", "J yy", "J zz", "J yz", "J xz", "J xy"} <= set(blind)
    assert "mass" not in blind


def test_a_finding_is_said_although_there_is_no_fit(tmp_path: Path) -> None:
    simulate = ["simulate", str(scenes.COGIRO), "--trajectory", "hold", "--duration", "10", "--faults", "ideal"]
    assert CliRunner().invoke(app, [*simulate, "--rate", "100", "-o", str(tmp_path / "run")]).exit_code == 0
    program = [str(TOP / "build/bin/inertiactl"), "fit", str(tmp_path / "run"), "--method", "iv"]
    done = subprocess.run(program, capture_output=True, text=True)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("inertiactl: --method iv: ") and "one pose only" in line


def test_poses_at_rest_are_said_to_hold_no_inertia(tmp_path: Path) -> None:
    file = _static_poses(tmp_path / "poses.csv", reader.read(scenes.run(1000, "ideal", 100.0, "fourier")))
    code, said = _fit(file, "--robot", scenes.COGIRO)
    assert code == 0
    assert "20 poses at rest: no inertia in them" in said
    assert "care: no excitation" in said
