# SPDX-License-Identifier: Apache-2.0
"""The batch solver: where it stops, and what drift, bad windows and silent sensors do to it."""

import sys
from pathlib import Path

import numpy as np
import pytest

import inertiad_core
from inertiad.identify import fit
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


def test_a_few_bad_windows_count_for_less(recording: Recording) -> None:
    """Three shocks of 0.1 s; with all windows of equal weight an inertia moves by 2.5 sigma."""
    f = recording.rows.f.copy()
    middle = [len(f) // 4, len(f) // 2, 3 * len(f) // 4]
    for k, cable in zip(middle, (0, 3, 5), strict=True):
        f[k : k + 10, cable] += 30.0
    clean, bad = (fit.of_batch("joint", _fit(run)).body for run in (recording, _with_forces(recording, f)))
    moved = np.abs(np.subtract(bad.value, clean.value)) / np.array(clean.std)
    assert moved.max() < 2.0
