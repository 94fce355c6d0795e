# SPDX-License-Identifier: Apache-2.0
"""Planning: seconds for a motion of 20 s on CoGiRo, its predicted sigma of the inertia against the paper's four
trajectories at equal duration and against the best of 400 random Fourier series."""

import time
from pathlib import Path

import numpy as np

from inertiad import excite, information, trajectory
from inertiad.excite import Asked
from inertiad.trajectory import Trajectory

ROBOT = Path("firmware/robots/cogiro/robot.toml")
N_SERIES = 400


def sigma_of(request: excite.Request, path: Trajectory) -> np.ndarray:
    """Reported sigma [10] of a path."""
    motion = path.at(information.sample_times(path))
    f = request.checker.tensions(motion)
    covariance = request.checker.model.rehearse(motion, f, information.REHEARSAL_RATE)
    return np.sqrt(np.diag(covariance))


def spread(ratio: np.ndarray) -> str:
    """Least and greatest of the inertia's six."""
    return f"{ratio[4:].min():.1f} .. {ratio[4:].max():.1f}"


def main() -> None:
    start = time.monotonic()
    request, plan = excite.plan(ROBOT, Asked(), 4, 0, lambda step: None)
    seconds = time.monotonic() - start
    model, paper = request.checker.model, trajectory.paper()
    at_equal_duration = sigma_of(request, paper) * np.sqrt(paper.duration / plan.path.duration)
    ratio, longer = at_equal_duration / plan.sigma, sigma_of(request, paper) / plan.sigma

    goal = excite.goal_of(model, "A", static=False)
    moving = plan.path.duration - 2.0 * excite.REST
    problem = excite.Problem(request.checker, excite.motion_basis(moving, excite.HOP, model), goal, request.start)
    dice = np.random.default_rng(1)
    series = min((excite.random_series(problem, dice) for _ in range(N_SERIES)), key=lambda c: problem.evaluate(c)[0])
    random = sigma_of(request, excite.Splined(request.start, series, moving)) / plan.sigma
    print(f"excite: 20 s for CoGiRo planned in {seconds:.0f} s (goal 120)")
    print(f"excite: sigma of J, paper at equal duration / ours: {spread(ratio)} (goal 2)")
    print(f"excite: sigma of J, paper's 45.6 s / ours: {spread(longer)}")
    print(f"excite: sigma of J, best of {N_SERIES} random / ours: {spread(random)} (goal 1)")


if __name__ == "__main__":
    main()
