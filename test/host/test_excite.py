# SPDX-License-Identifier: Apache-2.0
"""Planned motions: the prediction is the daemon's own, gradients are right, limits hold, refusals name the limit."""

import json
import subprocess

import numpy as np
import pytest
from conftest import COGIRO, CORNERS, MINIMAL, TOP, minimal_toml
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base import body
from inertiad.base.error import InputError
from inertiad.excite import plan_file, planner, problem
from inertiad.excite import request as requests
from inertiad.excite import search as searching
from inertiad.excite.constraints import Checker
from inertiad.identify import fisher_information
from inertiad.identify.fisher_information import Model
from inertiad.model import forward_dynamics, trajectory
from inertiad.robot import description
from inertiad.run import reader
from inertiad.simulate import sensor_models, simulator

ROBOT = COGIRO / "robot.toml"


@pytest.fixture(scope="module")
def request_():
    robot = description.load(ROBOT)
    model = Model(robot, str(ROBOT), robot.nominal)
    limits = requests.limits_from(model, None, 30.0, 35.0, 4.0, 2.0)
    start = np.concatenate([0.5 * (limits.low + limits.high), np.zeros(3)])
    return planner.Request(Checker(model, limits), start, n_starts=2)


@pytest.fixture(scope="module")
def best(request_):
    """The best motion of 12 s."""
    return planner.optimal(request_, 12.0, lambda step: None)


def problem_of(request_, duration=11.0, criterion="A"):
    model = request_.checker.model
    goal = problem.goal_of(model, criterion, static=False)
    return problem.Problem(request_.checker, problem.motion_basis(duration, 0.2, model), goal, request_.start)


def log_inertia(sigma):
    return float(np.mean(np.log(sigma[4:])))


def daemon_sigma(run):
    """Standard deviations [10] that the daemon reports of a run folder."""
    build = TOP / "build/bin"
    subprocess.run([build / "inertiactl", "compile", run / "robot.toml", "-o", run / "robot.cfg"], check=True)
    files = ["--bus", f"file:{run}/can.log?speed=0", "--tracker", f"file:{run}/tracker.csv"]
    command = [build / "inertiad", "--config", run / "robot.cfg", *files, "--estimate", run / "estimate.json"]
    subprocess.run(command, check=True, capture_output=True)
    return np.array(body.read(run / "estimate.json").std)


@pytest.mark.parametrize("criterion", ["A", "D"])
def test_gradient_is_that_of_the_lagrangian(request_, criterion):
    p = problem_of(request_, criterion=criterion)
    c = 1.5 * searching.random_series(p, np.random.default_rng(1))
    multiplier = np.full_like(p.evaluate(c)[1], 0.1)
    along = np.random.default_rng(2).standard_normal(c.shape)
    step = 1e-5
    values = [p.lagrangian(c + s * step * along, multiplier, 10.0)[0] for s in (1, -1)]
    gradient = p.lagrangian(c, multiplier, 10.0)[1]
    assert (values[0] - values[1]) / (2 * step) == pytest.approx(float(np.sum(gradient * along)), rel=2e-3)


@pytest.mark.slow
def test_best_of_12_s_beats_the_paper_at_equal_time_and_random_series(request_, best):
    checker, path = request_.checker, trajectory.paper()
    t = fisher_information.sample_times(path)
    motion = path.at(t)
    f = checker.tensions(motion)
    whole = checker.model.sigma(checker.model.information(checker.model.windows(motion, f, 100.0)))
    t = fisher_information.sample_times(best.path)
    motion = best.path.at(t)
    f = checker.tensions(motion)
    ours = checker.model.sigma(checker.model.information(checker.model.windows(motion, f, 100.0)))
    per_time = np.sqrt(path.duration / best.path.duration)
    assert log_inertia(whole * per_time) - log_inertia(ours) > np.log(2.0)

    p, dice = problem_of(request_), np.random.default_rng(99)
    costs = [p.evaluate(searching.random_series(p, dice))[0] for _ in range(60)]
    doubled = np.log(2.0)  # windows come at half of the problem's hop
    assert p.cost(checker.model.windows(motion, f, 100.0))[0] + doubled < min(costs)


@pytest.mark.slow
def test_motion_keeps_every_limit_and_rests_at_both_ends(request_, best):
    t = np.arange(0.0, best.path.duration, 0.013)
    motion = best.path.at(t)
    f, limits = request_.checker.tensions(motion), request_.checker.limits
    assert f.min() >= 100.0
    assert f.max() <= 5000.0
    assert np.all(motion.p >= limits.low - 1e-3)
    assert np.all(motion.p <= limits.high + 1e-3)
    assert np.linalg.norm(motion.a, axis=1).max() < 2.0 * 1.02
    assert np.linalg.norm(motion.v, axis=1).max() < 4.0
    assert np.rad2deg(np.arccos(motion.R[:, 2, 2])).max() < 30.5
    ends = best.path.at(np.array([0.0, best.path.duration]))
    for values in (ends.v, ends.a, ends.omega, ends.alpha):
        assert np.abs(values).max() < 1e-9


@pytest.mark.slow
def test_motion_driven_on_elastic_cables_keeps_the_tensions(best):
    moved = best.driven
    assert moved.duration == best.path.duration
    assert moved.n_infeasible == 0
    assert moved.f.min() >= 100.0
    assert moved.f.max() <= 5000.0
    assert moved.strays < 2e-3


def test_motion_that_breaks_a_tension_when_driven_is_refused(request_):
    checker = request_.checker
    robot = checker.model.robot
    tight = robot.model_copy(update={"cable": [c.model_copy(update={"tension_max": 1330.0}) for c in robot.cable]})
    model = Model(tight, str(ROBOT), robot.nominal)
    with pytest.raises(InputError, match=r"paper: driven by a controller on elastic cables: cable \d = \d+ N at t = "):
        planner.driven(Checker(model, checker.limits), trajectory.paper(), "paper")


@pytest.mark.slow
def test_file_is_what_simulate_reads_and_derivatives_belong_to_it(request_, best, tmp_path):
    plan_file.write_csv(tmp_path / "x.csv", request_, best)
    data = np.genfromtxt(tmp_path / "x.csv", delimiter=",", names=True)
    back = trajectory.read(tmp_path / "x.csv").at(data["t"])
    assert np.abs(back.p - np.column_stack([data["x"], data["y"], data["z"]])).max() < 1e-6
    assert np.abs(back.v[:, 0] - data["vx"]).max() < 1e-3
    assert np.abs(back.omega[:, 2] - data["omega_z"]).max() < 1e-3
    R = Rotation.from_euler("ZYX", np.column_stack([data["yaw"], data["pitch"], data["roll"]])).as_matrix()
    assert np.abs(back.R - R).max() < 1e-6


@pytest.mark.slow
def test_prediction_is_what_the_daemon_reports(inertiactl, request_, best, tmp_path):
    plan_file.write_csv(tmp_path / "x.csv", request_, best)
    reported = []
    for seed in range(3):
        run = tmp_path / f"run{seed}"
        options = ["--trajectory", tmp_path / "x.csv", "--rate", 200, "--seed", 100 + seed, "-o", run]
        assert inertiactl("simulate", ROBOT, *options).returncode == 0
        reported.append(daemon_sigma(run))
    ratio = np.median(reported, axis=0) / best.sigma
    # The rehearsed attitude has its final error as soon as it has settled.
    assert np.all((ratio > 1 / 1.3) & (ratio < 1.4)), ratio


@pytest.mark.slow
def test_same_seed_same_motion(request_):
    p = problem_of(request_, duration=5.0)
    a, b = (searching.search(p, 3, 0) for _ in range(2))
    assert a[0] == b[0]
    assert np.array_equal(a[1], b[1])


@pytest.mark.slow
def test_poses_at_rest_tell_mass_and_cog(request_):
    plan = planner.static_poses(request_, 5, 2.0, lambda step: None)
    prior = request_.checker.model.prior_sigma()
    assert np.all(plan.sigma[:4] < 0.05 * prior[:4])
    assert plan.tension[0] >= 100.0


def test_paper_there_and_back(tmp_path):
    _, plan = requests.plan(ROBOT, requests.Arguments(motion="paper"), 1, 0, lambda step: None)
    start, end = trajectory.PAPER_PAIRS[0]
    middle = plan.path.at(np.array([0.0, 0.5 * plan.path.duration])).p
    assert np.allclose(middle, [start[:3], end[:3]])


@pytest.mark.slow
def test_unreachable_sigma_names_what_limits_it(request_, best):
    wanted = requests.wanted_sigma("mass=0.01%", request_.checker.model)
    assert "[std] force_offset = 5" in planner._out_of_reach(request_.checker, best, wanted)


def test_wanted_sigma_in_units(request_):
    wanted = requests.wanted_sigma("mass=0.2%,cog=1mm", request_.checker.model)
    assert wanted[:4] == pytest.approx([0.322116, 1e-3, 1e-3, 1e-3])
    assert np.all(np.isinf(wanted[4:]))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (requests.Arguments(duration=0.0), "--duration 0: allowed: 5 to 600 s"),
        (requests.Arguments(box="1,1,1,0,2,2"), "allowed: every minimum below its maximum"),
        (requests.Arguments(box="1,1"), "allowed: 6 numbers"),
        (requests.Arguments(start="7,5,5,0,0,0"), "start pose: no rest within the limits: tension_min of cable"),
        (requests.Arguments(start="0,0,2,50,0,0"), "start pose: no rest within the limits: tilt"),
        (requests.Arguments(sigma="mass=3"), "allowed: mass=0.2% or kg"),
        (requests.Arguments(criterion="E"), "allowed: A, D"),
        (requests.Arguments(motion="circle"), "allowed: optimal, paper"),
        (requests.Arguments(motion="optimum"), "allowed: optimal, paper; did you mean optimal?"),
        (
            requests.Arguments(start="0.3,0.3,2,0,0,0", box="1,1,1,2,2,2"),
            "start pose: no rest within the limits: least x of the box",
        ),
        (requests.Arguments(acceleration=1e-4, motion="paper"), "keeps the limits of speed and acceleration"),
        (requests.Arguments(motion="paper", end="6,5,5,0,0,0"), "pose 2: no rest within the limits"),
    ],
)
def test_what_cannot_be_done_is_said(words, message):
    with pytest.raises(InputError) as error:
        requests.plan(ROBOT, words, 1, 0, lambda step: None)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_anchors_below_the_platform(robot_file):
    text = ROBOT.read_text()
    for height in ("5.3928", "5.4009", "5.3987", "5.4106", "5.4080", "5.4182", "5.3878", "5.3975"):
        text = text.replace(f"{height}]", f"-{height}]")
    with pytest.raises(InputError, match="every anchor is below the platform"):
        requests.plan(robot_file(text), requests.Arguments(), 1, 0, lambda step: None)


BODY = "\n[nominal]\nmass = 10\ncog = [0, 0, 0]\ninertia_cog = [1, 1, 1, 0, 0, 0]\n"


@pytest.mark.parametrize("words", [requests.Arguments(motion="paper"), requests.Arguments(sigma="mass=1%")])
def test_four_cables_cannot_follow_a_motion(robot_file, words):
    with pytest.raises(InputError, match=r"4 cables leave 2 of 6 degrees of freedom free, .*; use excite --poses N"):
        requests.plan(robot_file(minimal_toml(4, BODY)), words, 1, 0, lambda step: None)


FOUR = MINIMAL + "".join(
    f"[[cable]]\nanchor = [{x}, {y}, 3]\nattachment = [{0.15 * x}, {0.05 * y}, 0]\n" for x, y in CORNERS
)
FOUR += BODY.replace("cog = [0, 0, 0]", "cog = [0.03, -0.02, -0.1]")
"""Four cables that do not all point to one place, so that a millimetre leaves none of them slack."""


@pytest.mark.slow
def test_four_cables_get_rests_between_which_they_swing(robot_file, tmp_path):
    file = robot_file(FOUR)
    request, plan = requests.plan(file, requests.Arguments(poses=3, hold=1.5), 1, 0, lambda step: None)
    assert plan.remarks[0].startswith("4 cables leave 2 of 6 degrees of freedom free")
    assert np.abs(plan.driven.motion.omega).max() > 0.05
    assert plan.driven.f.min() >= 1.0
    assert np.all(plan.sigma[:4] < 0.5 * request.checker.model.prior_sigma()[:4])
    plan_file.write_csv(tmp_path / "p.csv", request, plan)
    assert (tmp_path / "p.csv").open().readline().strip().endswith("l_1,l_2,l_3,l_4")

    robot, modern = description.load(file), sensor_models.PRESETS["modern"]
    path, plant = trajectory.read(tmp_path / "p.csv"), forward_dynamics.plant("elastic", robot)
    reported = []
    for seed in range(3):
        run = simulator.Run(file, robot, robot.nominal, path, "p", modern, "modern", 200.0, seed, plant)
        simulator.simulate(run, tmp_path / "run", lambda step: None)
        config = reader.config_of(description.load(tmp_path / "run/robot.toml"), "run")
        log, positions = tmp_path / "run/can.log", tmp_path / "run/tracker.csv"
        pipeline = inertiad_core.read_run(config, [str(log)], [""], str(positions))
        found = pipeline.estimate
        wider = inertiad_core.track(config, inertiad_core.rows_of(pipeline))["sigma_factor"][-1]
        reported.append(np.array([found["mass_std"], *found["cog_std"]]) / wider)  # no plan foresees a misfit
    ratio = np.median(reported, axis=0) / plan.sigma[:4]
    assert np.all((ratio > 1 / 1.5) & (ratio < 1.5)), ratio


def test_four_cables_that_hang_nowhere_in_the_box(robot_file):
    words = requests.Arguments(poses=3, box="-0.1,-0.1,2.95,0.1,0.1,2.99")
    with pytest.raises(InputError, match="4 cables: nowhere in the box does the platform hang at rest"):
        requests.plan(robot_file(FOUR), words, 1, 0, lambda step: None)


@pytest.mark.slow
def test_command_writes_plan_prediction_and_picture(inertiactl, tmp_path):
    files = ["-o", tmp_path / "p.csv", "--picture", tmp_path / "p.png"]
    result = inertiactl("excite", ROBOT, "--motion", "paper", *files)
    assert result.returncode == 0, result.stderr
    assert result.stdout == ""
    found = json.loads((tmp_path / "p.json").read_text())
    assert found["predicted"]["mass"]["std"] > 0.0
    assert (tmp_path / "p.png").stat().st_size > 10_000
    assert found["driven"]["tension_N"]["min"] >= 100.0
    assert "driven by a controller on elastic cables" in result.stderr
