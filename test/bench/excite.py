# SPDX-License-Identifier: Apache-2.0
"""Planning: seconds for a motion of 20 s on CoGiRo, its predicted sigma of the inertia against the paper's four
trajectories at equal duration and against the best of 400 random Fourier series; its tensions under forward dynamics,
and what runs of it with unseen seeds report against what was predicted."""

import resource
import tempfile
import time
from pathlib import Path

import numpy as np

import inertiad_core
from inertiad.base import body as estimate
from inertiad.excite import planner, problem
from inertiad.excite import request as requests
from inertiad.excite import search as searching
from inertiad.identify import fisher_information
from inertiad.model import forward_dynamics, trajectory
from inertiad.model.trajectory import Trajectory
from inertiad.robot import description
from inertiad.run import reader
from inertiad.simulate import sensor_models, simulator

ROBOT = Path("firmware/robots/cogiro/robot.toml")
N_SERIES = 400
SEEDS = range(7000, 7030)
"""seen by no one before"""
RATE = 500.0
"""Hz of the runs: a window averages noise as at 1 kHz, in half the time"""


def sigma_of(request: planner.Request, path: Trajectory) -> np.ndarray:
    """Reported sigma [10] of a path."""
    motion = path.at(fisher_information.sample_times(path))
    f = request.checker.tensions(motion)
    covariance = request.checker.model.rehearse(motion, f, fisher_information.REHEARSAL_RATE)
    return np.sqrt(np.diag(covariance))


def cpu_seconds() -> float:
    """Of this process and those that it waited for."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def spread(ratio: np.ndarray) -> str:
    """Least and greatest of the inertia's six."""
    return f"{ratio[4:].min():.1f} .. {ratio[4:].max():.1f}"


def reported(path: Trajectory, seed: int, folder: Path) -> np.ndarray:
    """(value, sigma) [2, 10] that the daemon's stages report of a run on elastic cables, modern sensors."""
    robot = description.load(ROBOT)
    plant, modern = forward_dynamics.plant("elastic", robot), sensor_models.PRESETS["modern"]
    run = simulator.Run(ROBOT, robot, robot.nominal, path, "plan", modern, "modern", RATE, seed, plant)
    simulator.simulate(run, folder, lambda step: None)
    config = reader.config_of(description.load(folder / "robot.toml"), str(folder))
    found = inertiad_core.read_run(config, [str(folder / "can.log")], [""], str(folder / "tracker.csv")).estimate
    return np.array([[found[f"mass{s}"], *found[f"cog{s}"], *found[f"inertia_cog{s}"]] for s in ("", "_std")])


def obtained(plan: planner.Plan) -> tuple[np.ndarray, np.ndarray]:
    """Reported sigma [10], median over SEEDS, and root mean square of the errors [10]."""
    body = description.load(ROBOT).nominal
    with tempfile.TemporaryDirectory() as folder:
        found = np.array([reported(plan.path, seed, Path(folder)) for seed in SEEDS])
    error = found[:, 0] - np.array([body.mass, *body.cog, *body.inertia_cog])
    return np.median(found[:, 1], axis=0), np.sqrt(np.mean(error**2, axis=0))


def main() -> None:
    start, cpu = time.monotonic(), cpu_seconds()
    request, plan = requests.plan(ROBOT, requests.Arguments(), 4, 0, lambda step: None)
    seconds, cpu = time.monotonic() - start, cpu_seconds() - cpu
    model, paper = request.checker.model, trajectory.paper()
    at_equal_duration = sigma_of(request, paper) * np.sqrt(paper.duration / plan.path.duration)
    ratio, longer = at_equal_duration / plan.sigma, sigma_of(request, paper) / plan.sigma

    goal = problem.goal_of(model, "A", static=False)
    moving = plan.path.duration - 2.0 * problem.REST
    found = problem.Problem(request.checker, problem.motion_basis(moving, problem.HOP, model), goal, request.start)
    dice = np.random.default_rng(1)
    series = min((searching.random_series(found, dice) for _ in range(N_SERIES)), key=lambda c: found.evaluate(c)[0])
    random = sigma_of(request, problem.Splined(request.start, series, moving)) / plan.sigma
    print(f"excite: 20 s for CoGiRo planned in {seconds:.0f} s, {0.5 * cpu:.0f} s of each of two cores (goal 120)")
    print(f"excite: sigma of J, paper at equal duration / ours: {spread(ratio)} (goal 2)")
    print(f"excite: sigma of J, paper's 45.6 s / ours: {spread(longer)}")
    print(f"excite: sigma of J, best of {N_SERIES} random / ours: {spread(random)} (goal 1)")
    moved, cable = plan.driven, model.robot.cable[0]
    print(
        f"excite: tensions under forward dynamics, elastic cables: {moved.f.min():.0f} to {moved.f.max():.0f} N "
        f"(limits {cable.tension_min:g} to {cable.tension_max:g} N)"
    )
    sigma, error = obtained(plan)
    ratio = sigma / plan.sigma
    found = f"{ratio.min():.2f} .. {ratio.max():.2f} (goal 0.77 .. 1.3)"
    print(f"excite: reported / predicted sigma, {len(SEEDS)} seeds on elastic cables: {found}")
    ratio = error / plan.sigma
    worst = estimate.NAMES[int(np.argmax(ratio))]
    print(f"excite: rms error / predicted sigma, the same runs: {ratio.min():.2f} .. {ratio.max():.2f} ({worst})")


if __name__ == "__main__":
    main()
