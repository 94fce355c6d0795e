# SPDX-License-Identifier: Apache-2.0
"""Robots with a name and cables only: stand-ins for the rest, a motion they can make, a plan, and Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import COGIRO, TOP, minimal_toml

from inertiad.base.error import InputError
from inertiad.excite import search
from inertiad.model import forward_dynamics
from inertiad.robot import configuration, description, stand_in, template
from inertiad.simulate import request, simulator
from inertiad.simulate.request import Arguments


def new_robot(tmp_path, n):
    """robot.toml as `inertiactl init` writes it."""
    path = tmp_path / "robot.toml"
    path.write_text(template.text(template.Start("new", n)))
    return path


@pytest.mark.parametrize("n", [2, 4, 8])
def test_stand_ins_leave_prior_and_noise_as_they_were(tmp_path, n):
    robot = description.load(new_robot(tmp_path, n))
    completed = stand_in.complete(robot)
    assert completed.robot.nominal is None
    assert all(cable.tension_max < 1e6 for cable in completed.robot.cable)
    assert configuration.std(completed.robot) == configuration.std(robot)
    for was, now in zip(configuration.prior(robot), configuration.prior(completed.robot), strict=True):
        np.testing.assert_allclose(now, was, rtol=0.02)
    np.testing.assert_allclose(
        configuration.residual_std(completed.robot), configuration.residual_std(robot), rtol=0.02
    )
    assert [remark.split(":")[0] for remark in completed.remarks] == ["no [nominal]", "no tension_max"]


def test_a_complete_robot_needs_no_stand_in(cogiro):
    assert stand_in.complete(cogiro) == stand_in.Completed(cogiro, cogiro.nominal, ())


@pytest.mark.parametrize("n", [3, 4, 6, 7, 8, 12])
def test_new_robot_has_a_motion_and_a_plant(tmp_path, n):
    run, remarks = request.run_of(new_robot(tmp_path, n), Arguments(faults="ideal"))
    assert run.trajectory_name == "moves"
    assert run.trajectory.duration > 30.0
    assert (run.plant is not None) == (n < 6)
    assert any("--plant elastic" in remark for remark in remarks) == (n < 6)
    assert any(remark.startswith("no --trajectory: moves like the paper's") for remark in remarks)


def test_usual_motion_of_cogiro_is_the_papers():
    run, remarks = request.run_of(COGIRO / "robot.toml", Arguments())
    assert (run.trajectory_name, run.plant, remarks) == ("paper", None, [])


def test_robot_that_cannot_hold_its_platform_is_refused_with_the_place_to_look_at(robot_file):
    weak = minimal_toml(8).replace("tension_max = 1000", "tension_max = 2")
    with pytest.raises(InputError, match="check anchors, attachments and tensions"):
        request.run_of(
            robot_file(weak + "[nominal]\nmass = 90\ncog = [0, 0, 0]\ninertia_cog = [1, 1, 1, 0, 0, 0]\n"), Arguments()
        )


def test_exact_motion_on_four_cables_names_the_plant(tmp_path):
    words = Arguments(trajectory="hold", pose="0.3,0,1.2,0.2,0,0", duration=1.0, plant="exact", faults="ideal")
    run, _ = request.run_of(new_robot(tmp_path, 4), words)
    with pytest.raises(InputError, match="pass --plant elastic"):
        simulator.simulate(run, tmp_path / "run", lambda step: None)


@pytest.mark.slow
def test_simulated_minimal_robot_moves_within_its_tensions(tmp_path):
    words = Arguments(faults="ideal", trajectory="hold", pose="0.2,0.1,1.2,0,0,0", duration=2.0)
    run, _ = request.run_of(new_robot(tmp_path, 4), words)
    simulated = simulator.simulate(run, tmp_path / "run", lambda step: None)
    assert simulated.n_frames > 100
    truth = json.loads((tmp_path / "run/truth.json").read_text())
    assert truth["tension"]["min"] > 0.0
    assert truth["mass"] == run.body.mass
    assert "tension_max" not in (tmp_path / "run/robot.toml").read_text()
    assert forward_dynamics.plant("elastic", run.robot).stiffness < 1e8


@pytest.mark.slow
def test_excite_plans_rests_for_four_cables(inertiactl, tmp_path):
    done = inertiactl("excite", new_robot(tmp_path, 4), "--duration", "10", "-o", tmp_path / "plan.csv")
    assert done.returncode == 0, done.stderr
    for text in ("no [nominal]", "no tension_max", "4 cables: no motion can be commanded", "predicted sigma: mass"):
        assert text in done.stderr
    assert (tmp_path / "plan.csv").read_text().count("\n") > 100


def children(pid: int) -> list[int]:
    """Processes below a process."""
    try:
        direct = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
    return [*direct, *(below for child in direct for below in children(child))]


@pytest.mark.slow
def test_interrupted_search_ends_at_once_and_leaves_no_process(tmp_path):
    command = [sys.executable, "-m", "inertiad", "excite", COGIRO / "robot.toml", "--duration", "60", "--starts", "50"]
    started = subprocess.Popen(
        [*command, "-o", tmp_path / "plan.csv"], cwd=TOP, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    end = time.monotonic() + 60.0
    while len(children(started.pid)) < 2:  # the searching processes, beside multiprocessing's own tracker
        assert started.poll() is None
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(3.0)
    below = children(started.pid)
    os.killpg(started.pid, signal.SIGINT)
    _, errors = started.communicate(timeout=15.0)
    assert started.returncode == 130
    assert "Traceback" not in errors
    end = time.monotonic() + 15.0
    while any(Path(f"/proc/{pid}").exists() for pid in below):
        assert time.monotonic() < end, "a searching process is left over"
        time.sleep(0.05)
    assert not (tmp_path / "plan.csv").exists()


def test_progress_shows_a_bar_and_the_least_sigma():
    text = search._bar(0.25, np.array([0.4, 1e-3, 2e-3, 1e-3, *[0.5] * 6]))
    assert text == "plan #####...............  25%, best so far: mass 0.4 kg, CoG 2 mm, inertia 0.5 kg m2"
