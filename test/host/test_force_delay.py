# SPDX-License-Identifier: Apache-2.0
"""Forces that come later than the description says: the platform finds the delay and takes it out."""

import sys
from pathlib import Path
from typing import Any

import numpy as np

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/accept"))

import scenes  # noqa: E402

from inertiad.robot import description, systematic  # noqa: E402

LATE = 0.025  # s


def _found(later: float) -> dict[str, Any]:
    """The last estimate of a run whose forces are `later` than described."""
    folder = scenes.run(1000, "modern", 100.0, "fourier")
    robot = description.load(folder / "robot.toml")
    align = robot.align.model_copy(update={"delay_force": robot.align.delay_force - later})
    return dict(scenes.platform(folder, robot.model_copy(update={"align": align})).estimate)


def _delay(found: dict[str, Any]) -> float:
    return float(found["systematic"][systematic.names(8).index("force_delay")])


def test_late_forces_give_the_body_that_timely_ones_give():
    timely, late = _found(0.0), _found(LATE)
    assert abs(_delay(timely)) < 1e-3
    assert abs(_delay(late) - LATE) < 1e-3
    for name in ("mass", "cog", "inertia_cog"):
        apart = np.abs(np.subtract(late[name], timely[name])) / np.array(late[f"{name}_std"])
        assert apart.max() < 1.0, name


def test_delay_moved_begins_the_estimate_again():
    timely, late = _found(0.0), _found(LATE)
    assert 0.5 * timely["n_windows"] < late["n_windows"] < timely["n_windows"]
