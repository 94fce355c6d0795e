# SPDX-License-Identifier: Apache-2.0
"""A mistake is named where it explains the runs, not where the joint fit explains them better."""

import sys
from pathlib import Path

import numpy as np
import pytest

from inertiad.base.finding import Finding
from inertiad.identify import identification
from inertiad.robot import systematic
from inertiad.run import reader
from inertiad.run.reader import Recording

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "accept"))
import scenes


@pytest.fixture(scope="module")
def run() -> Recording:
    return reader.read(scenes.run(1000, "modern", 100.0, "paper"))


def _late(run: Recording, residual: float, delay: float, found: float, least: float = 0.1) -> list[str]:
    """How a tracker that looks `delay` [s] late is named, where the fit leaves 3 N and finds another delay."""
    evidence = {"residual_without_N": residual, "residual_least_N": least, "numbers": [delay]}
    mistake = Finding("tracker_delay", "stop", "the positions look late", "", evidence)
    xi = np.zeros(len(systematic.names(run.robot.n_cables)))
    xi[systematic.group("position_delay", run.robot.n_cables).part] = found
    result = {"fit": [{"n_windows": 100, "rms": np.array([3.0, 0.0, 0.0, 0.1, 0.1, 0.1])}], "xi": xi}
    named = identification._beside(run.robot, mistake, result)
    return [f.severity for f in named]


def test_a_mistake_that_leaves_as_little_as_the_fit_is_named(run: Recording) -> None:
    assert _late(run, 3.5, 0.2, 0.0) == ["stop"]


def test_a_mistake_that_the_fit_finds_too_is_named_and_taken_out(run: Recording) -> None:
    assert _late(run, 15.0, 0.2, 0.19) == ["care"]


def test_a_mistake_that_leaves_more_than_the_fit_is_none(run: Recording) -> None:
    assert _late(run, 15.0, 0.2, 0.01) == []


def test_a_mistake_that_leaves_what_nothing_is_told_apart_from_is_named(run: Recording) -> None:
    assert _late(run, 15.0, 0.2, 0.01, least=6.0) == ["stop"]


def test_a_gyro_that_a_wandering_attitude_contradicts_is_left_alone(
    run: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """unclear() compares the gyro with the attitude's rate: where the fit has no symptom, the attitude is noisy."""
    unclear = [Finding("gyro", "stop", "the gyro is 0.52 times the rate of the attitude", "")]
    monkeypatch.setattr(identification.diagnose, "unclear", lambda *_: unclear)
    monkeypatch.setattr(identification.mistake_fit, "find", lambda *_: [])
    config = reader.config_of(run.robot, run.robot.name)
    solved = identification._solve(config, [identification.Part(run, run, 0.0, run.duration, 0)])
    assert identification.mistakes(run.robot, [run], solved.result, []) == []
    solved.result["converged"] = False
    assert identification.mistakes(run.robot, [run], solved.result, []) == unclear
    still = Finding("no_excitation", "care", "the platform is at rest throughout", "")
    assert identification.mistakes(run.robot, [run], solved.result, [still]) == [*unclear, still]
