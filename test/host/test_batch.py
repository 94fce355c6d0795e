# SPDX-License-Identifier: Apache-2.0
"""The batch solver: where it stops, and what drift, bad windows and silent sensors do to it."""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.ndimage

import inertiad_core
from inertiad.identify import fit, identification
from inertiad.robot import systematic
from inertiad.robot.description import Robot
from inertiad.run import reader
from inertiad.run.reader import Recording

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/accept"))
import scenes  # noqa: E402

GYRO_BIAS = slice(21, 24)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return reader.read(scenes.run(1000, "modern", 100.0, "fourier"))


def _with_forces(recording: Recording, f: np.ndarray, robot: Robot | None = None, **derived: bool) -> Recording:
    rows = recording.rows
    t_ns = np.rint(1e9 * rows.t).astype(np.int64)
    other = inertiad_core.Rows(t_ns, rows.acc, rows.gyro, rows.q, rows.position, f, **derived)
    return Recording(recording.path, robot or recording.robot, other, 0, 0, {})


def _fit(run: Recording) -> dict[str, object]:
    return fit.batch(reader.config_of(run.robot, "test"), [run])


def test_a_rate_from_attitude_says_nothing_of_a_gyro(recording: Recording) -> None:
    """A row on the gyro's bias that the bias does not change would pull on it for ever."""
    result = _fit(_with_forces(recording, recording.rows.f, derives_rate=True))
    assert result["converged"]
    assert np.abs(np.array(result["xi"])[GYRO_BIAS]).max() == 0.0


def test_offsets_that_drift_as_declared_leave_body_and_sigma_right(recording: Recording) -> None:
    std = recording.robot.std.model_copy(update={"force_offset_drift": 3.0})
    robot, rows = recording.robot.model_copy(update={"std": std}), recording.rows
    sign = np.random.default_rng(2).choice([-1.0, 1.0], rows.f.shape[1])
    t = rows.t - rows.t[0]
    drifting = rows.f + np.outer(3.0 / np.sqrt(t[-1]) * t, sign)  # as far as the walk goes in the run's time
    body = fit.of_batch("joint", _fit(_with_forces(recording, drifting, robot))).body
    z = (np.array(body.value) - scenes.truth(recording.path)) / np.array(body.std)
    assert np.abs(z).max() < 3.5


def _errors(run: Recording, result: dict[str, object]) -> np.ndarray:
    body = fit.of_batch("joint", result).body
    return np.abs(np.array(body.value) - scenes.truth(run.path)) / np.array(body.std)


def test_forces_behind_a_low_pass_are_taken_back(recording: Recording) -> None:
    """Smoothed by a Gaussian of 35 ms; without that unknown moments of inertia are up to 0.8 kg m2 off, 3.4 sigma."""
    smooth = scipy.ndimage.gaussian_filter1d(recording.rows.f, 3.5, axis=0, mode="nearest")
    result = _fit(_with_forces(recording, smooth))
    at = systematic.group("force_lowpass", recording.robot.n_cables).first
    found, std = np.array(result["xi"])[at], np.array(result["xi_std"])[at]
    assert result["converged"]
    assert abs(found - 0.5 * 0.035**2) < 3.0 * std and std < 0.2 * found
    assert _errors(recording, result).max() < 2.0
    body, truth = fit.of_batch("joint", result).body, scenes.truth(recording.path)
    assert np.abs(np.subtract(body.value, truth)[4:7]).max() < 0.2


def test_offsets_that_drift_more_than_stated_are_followed(recording: Recording) -> None:
    rows = recording.rows
    sign = np.random.default_rng(3).choice([-1.0, 1.0], rows.f.shape[1])
    t = rows.t - rows.t[0]
    run = _with_forces(recording, rows.f + np.outer(5.0 / t[-1] * t, sign))
    before = _fit(run)
    after = fit.with_drift([run], before, group=[0], payload=[0.0])
    assert "offset_drift" in after and "offset_drift" not in before
    assert _errors(run, after).max() < 3.5
    done = identification.joint(run.robot, reader.config_of(run.robot, "test"), [run], [])
    assert ("force_offset_drift", "care") in [(f.name, f.severity) for f in done.findings]
    body = [fit.of_batch("joint", result).body.std for result in (before, after)]
    assert np.median(np.divide(*body)) > 10.0  # sigma of misfit, as wide as the prior, against that of drift


def test_a_healthy_run_is_solved_once(recording: Recording) -> None:
    result = _fit(recording)
    assert fit.with_drift([recording], result, group=[0], payload=[0.0]) is result


def test_a_few_bad_windows_count_for_less(recording: Recording) -> None:
    """Three shocks of 0.1 s; with all windows of equal weight an inertia moves by 2.5 sigma."""
    f = recording.rows.f.copy()
    middle = [len(f) // 4, len(f) // 2, 3 * len(f) // 4]
    for k, cable in zip(middle, (0, 3, 5), strict=True):
        f[k : k + 10, cable] += 30.0
    clean, bad = (fit.of_batch("joint", _fit(run)).body for run in (recording, _with_forces(recording, f)))
    moved = np.abs(np.subtract(bad.value, clean.value)) / np.array(clean.std)
    assert moved.max() < 2.0
