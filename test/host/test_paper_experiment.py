# SPDX-License-Identifier: Apache-2.0
"""paper: the moves are the paper's, its method is as far off as it was, the page is drawn."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from browser import browser
from conftest import TOP

from inertiad.base.installation import example_robot
from inertiad.check import paper_experiment
from inertiad.check.paper_experiment import Reproduction
from inertiad.identify import two_step
from inertiad.model import trajectory
from inertiad.report import reproduction

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found() -> Reproduction:
    return paper_experiment.reproduce(example_robot(), 1000, 6, 2, lambda step: None)


def test_eight_moves_go_forward_and_back_between_the_papers_poses() -> None:
    path, spans = trajectory.paper(), trajectory.paper_spans()
    assert spans.shape == (8, 2)
    start, end = (path.at(spans[:, i]).p for i in range(2))
    for k, (first, last) in enumerate(trajectory.PAPER_PAIRS):
        np.testing.assert_allclose([start[2 * k], end[2 * k]], [first[:3], last[:3]], atol=1e-9)
        np.testing.assert_allclose([start[2 * k + 1], end[2 * k + 1]], [last[:3], first[:3]], atol=1e-9)
    assert np.abs(path.at(spans.ravel()).v).max() < 1e-9


def test_two_step_result_is_the_median_over_the_moves(found: Reproduction) -> None:
    for e in found.experiments:
        np.testing.assert_allclose(e.two_step.value, np.median(e.moves, axis=0), rtol=1e-12)


def test_paper_method_is_far_off_and_the_joint_fit_on_the_same_data_is_not(found: Reproduction) -> None:
    two, ours = (np.median(np.abs(error), axis=0) for error in (found.two_step_error, found.joint_error))
    assert two[1:4].max() > 0.08 and found.n_impossible >= 5
    assert ours[1:4].max() < 0.012 and (ours[4:7] < [8.0, 8.0, 8.0]).all()
    assert (np.abs(found.joint_error) < 4.0 * found.joint_std).all()


def test_a_seed_alone_gives_what_it_gives_among_others(found: Reproduction) -> None:
    alone = paper_experiment.experiment(example_robot(), 1003)
    assert alone.joint == found.experiments[3].joint and alone.two_step == found.experiments[3].two_step


def test_table_iii_is_no_body() -> None:
    assert reproduction.slack(two_step.NOMINAL[4:]) > 0.0 > reproduction.slack(two_step.ESTIMATED[4:])


def test_page_is_drawn_and_says_how_many_are_impossible(found: Reproduction, tmp_path: Path) -> None:
    file = tmp_path / "paper.html"
    reproduction.write(found, file, None, "inertiactl paper --seeds 6")
    assert file.stat().st_size < 8e6
    with browser() as shown:
        shown.show(1200, 900)
        shown.open(file)
        assert shown.complaints == []
        assert f"{found.n_impossible} of 6" in shown.ask("document.querySelector('#verdict').innerText")
        circles = shown.ask("document.querySelectorAll('#figure-errors .point').length")
        assert circles == 10 * 2 * 6


def test_command_prints_the_table_and_writes_the_page(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "inertiad", "paper", "--seeds", "2", "-o", str(tmp_path / "p.html")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=TOP)
    assert done.returncode == 0, done.stderr
    mass = next(line for line in done.stdout.splitlines() if line.startswith("mass"))
    assert re.findall(r"[-+]?\d+\.\d+", mass)[:3] == ["161.06", "170.74", "+9.68"]
    assert re.search(r"\d of 2 two-step results are no body", done.stdout)
    assert "inertiactl paper --seeds 2" in (tmp_path / "p.html").read_text()
