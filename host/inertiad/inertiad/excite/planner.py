# SPDX-License-Identifier: Apache-2.0
"""Plans: motions checked against every limit, with their predicted results."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from inertiad.base.body import NAMES, UNITS
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.excite import underactuated
from inertiad.excite.constraints import Checker, check_pose
from inertiad.excite.problem import HOP, REST, SPACING, Criterion, Problem, Splined, goal_of, motion_basis, pose_basis
from inertiad.excite.search import Progress, largest, search_all
from inertiad.identify import fisher_information
from inertiad.model import forward_dynamics, trajectory
from inertiad.model.forward_dynamics import Moved
from inertiad.model.trajectory import Motion, Moves, Trajectory
from inertiad.robot import configuration, systematic

LONGEST = 120.0
"""s, the longest motion tried for a wanted accuracy"""
FINE_RATE = 50.0
"""Hz at which a found motion is checked against the limits"""


@dataclass(frozen=True)
class Plan:
    """A motion and its predicted result."""

    path: Trajectory
    method: str
    sigma: Array
    """[10] mass, CoG, inertia"""
    covariance: Array
    """[10, 10]"""
    driven: Moved
    """the motion on elastic cables, under a controller where there are cables enough for one"""
    tension: tuple[float, float]
    """N, least and greatest on the path itself"""
    binding: list[str] = field(default_factory=list)
    """limits that the motion touches, and where"""
    remarks: list[str] = field(default_factory=list)


def sampled(path: Trajectory, rate: float) -> tuple[Array, Motion]:
    t = fisher_information.sample_times(path, rate)
    return t, path.at(t)


def _checked(checker: Checker, path: Trajectory) -> tuple[Array, Array, list[str]]:
    """(tensions [N, m], g [N, limits], limits touched) at FINE_RATE."""
    t, motion = sampled(path, FINE_RATE)
    rpy = trajectory.Rotation.from_matrix(motion.R).as_euler("ZYX")[:, ::-1]
    q = np.hstack([motion.p, rpy])
    f = checker.tensions(motion)
    g = _excess_of(checker, q, motion, f)
    touched = np.flatnonzero(g.max(axis=0) > -0.02)
    return f, g, [f"{checker.names[c]} at t = {t[np.argmax(g[:, c])]:.2f} s" for c in touched]


def _excess_of(checker: Checker, q: Array, motion: Motion, f: Array) -> Array:
    """g of a motion that is known as such; see Checker.excess."""
    still = np.zeros_like(q)
    g = checker.excess(q, still, still)[0]
    m = checker.model.robot.n_cables
    low, high = checker.range
    scale = max(2.0 * checker.model.body.mass * checker.model.robot.gravity / m, 1.0)
    g[:, : 2 * m] = np.hstack([low - f, f - high]) / scale
    at = checker.names.index("speed of the platform")
    g[:, at : at + 4] = np.column_stack(checker.moving(motion))
    return g


def driven(checker: Checker, path: Trajectory, method: str) -> Moved:
    """The path under a controller on elastic cables. InputError, with cable and time: a tension breaks a limit."""
    mechanics, plant = checker.mechanics, underactuated.elastic(checker)
    moved = forward_dynamics.move(mechanics, mechanics, path, plant, fisher_information.REHEARSAL_RATE)
    _, *broken = forward_dynamics.summary(moved, checker.model.robot)
    if broken:
        raise InputError(f"{method}: driven by a controller on elastic cables: {'; '.join(broken)}")
    return moved


def predicted(checker: Checker, path: Trajectory, method: str) -> Plan:
    """Predicted result of a path. InputError, with the limit and the place, if it breaks one."""
    f, g, binding = _checked(checker, path)
    if g.max() > 0.02:
        k, c = np.unravel_index(int(np.argmax(g)), g.shape)
        raise InputError(
            f"{method}: {checker.names[int(c)]} exceeded at t = {k / FINE_RATE:.2f} s by {100 * g[k, c]:.0f} %"
        )
    _, motion = sampled(path, fisher_information.REHEARSAL_RATE)
    covariance = checker.model.rehearse(motion, checker.tensions(motion), fisher_information.REHEARSAL_RATE)
    sigma, moved = np.sqrt(np.diag(covariance)), driven(checker, path, method)
    return Plan(path, method, sigma, covariance, moved, (float(f.min()), float(f.max())), binding)


@dataclass(frozen=True)
class Request:
    """A request, checked."""

    checker: Checker
    start: Array
    """pose [6] where a motion starts and ends"""
    criterion: Criterion = "A"
    n_starts: int = 4
    seed: int = 0


def optimal(request: Request, duration: float, progress: Progress) -> Plan:
    """The best motion of a duration [s], rests included."""
    if not 4.0 * REST + 4.0 * SPACING <= duration <= 600.0:
        raise InputError(f"--duration {duration:g}: allowed: {4.0 * REST + 4.0 * SPACING:g} to 600 s")
    check_pose(request.checker, request.start, "start pose")
    model, moving = request.checker.model, duration - 2.0 * REST
    goal = goal_of(model, request.criterion, static=False)
    hop = max(HOP, moving / 300.0)
    problem = Problem(request.checker, motion_basis(moving, hop, model), goal, request.start)
    c = search_all(problem, request.n_starts, request.seed, progress)
    fine = replace(problem, basis=motion_basis(moving, 1.0 / FINE_RATE, model))
    c = largest(fine, np.zeros_like(c), c)
    return predicted(request.checker, Splined(request.start, c, moving), "optimal")


def shortest(request: Request, wanted: Array, progress: Progress) -> Plan:
    """The shortest motion found that reaches every wanted sigma [10] (inf: any)."""
    quick = replace(request, n_starts=2)
    low, high, plan = 5.0, 10.0, optimal(quick, 10.0, progress)
    while np.any(plan.sigma > wanted):
        low, high = high, 1.6 * high
        if high > LONGEST:
            raise InputError(f"--sigma: {_out_of_reach(request.checker, plan, wanted)}")
        progress(f"{high:.0f} s")
        plan = optimal(quick, high, progress)
    for _ in range(3):
        middle = round(0.5 * (low + high), 1)
        trial = optimal(quick, middle, progress)
        good = bool(np.all(trial.sigma <= wanted))
        low, high, plan = (low, middle, trial) if good else (middle, high, plan)
    return plan


def _declared(model: fisher_information.Model, group: systematic.Group) -> float:
    """The sigma of [std] of a kind of systematic parameter; cable_inertia has none."""
    return configuration.std(model.robot).get(group.std_key, float("nan"))


def _out_of_reach(checker: Checker, plan: Plan, wanted: Array) -> str:
    """Text: the sigma that stays too large, and the systematic error that limits it."""
    worst = int(np.argmax(plan.sigma / wanted))
    _, motion = sampled(plan.path, fisher_information.REHEARSAL_RATE)
    model = checker.model
    base = model.information(model.windows(motion, checker.tensions(motion), fisher_information.REHEARSAL_RATE))
    known = {}
    for group in systematic.planned_groups(model.robot.n_cables):
        if np.isnan(_declared(model, group)):
            continue
        columns, better = model.columns(group), base.copy()
        better[columns, columns] += np.diag(np.full(group.n, 1e18))
        known[group] = float(model.sigma(better)[worst])
    limit = min(known, key=lambda group: known[group])
    return (
        f"{NAMES[worst]} stays at {plan.sigma[worst]:.3g} {UNITS[worst]} after {plan.path.duration:.0f} s, wanted "
        f"{wanted[worst]:.3g}: the limit is [std] {limit.std_key} = {_declared(model, limit):g}: calibrate it first"
    )


def move_time(checker: Checker, start: Array, end: Array) -> float:
    """s of the fastest rest-to-rest move between poses [6] within speed and acceleration, at least 1 s."""
    for seconds in np.arange(1.0, 60.0, 0.25):
        path = Moves(np.array([start, end]), [float(seconds)], 0.0)
        _, motion = sampled(path, FINE_RATE)
        if max(g.max() for g in checker.moving(motion)) <= -0.05 and _turns_gently(motion):
            return float(seconds)
    raise InputError("no move between the poses within 60 s keeps the limits of speed and acceleration")


def _turns_gently(motion: Motion) -> bool:
    return bool(np.linalg.norm(motion.omega, axis=1).max() < 1.0)


def moves(request: Request, poses: Array, hold: float, method: str) -> Plan:
    """Rest-to-rest moves through poses [K, 6], held [s] at each."""
    for number, pose in enumerate(poses):
        check_pose(request.checker, pose, f"pose {number + 1}")
    times = [move_time(request.checker, a, b) for a, b in itertools.pairwise(poses)]
    return predicted(request.checker, Moves(poses, times, hold), method)


def _hanging_poses(request: Request, n_poses: int, hold: float, progress: Progress) -> Plan:
    """The same for a platform that only hangs, whose swings carry information, too."""
    checker, model = request.checker, request.checker.model
    progress("look for places to hang")
    scale = goal_of(model, request.criterion, static=True).scale
    dice = np.random.default_rng([request.seed, 4])
    path, moved = underactuated.rests(checker, n_poses, hold, scale, lambda a, b: move_time(checker, a, b), dice)
    motion, f = underactuated.sampled(moved)
    covariance = model.rehearse(motion, f, fisher_information.REHEARSAL_RATE)
    sigma = np.sqrt(np.diag(covariance))
    n_free = 6 - model.robot.n_cables
    remarks = [f"{model.robot.n_cables} cables leave {n_free} of 6 degrees of freedom free: lengths are planned"]
    untold = [name for name, s, prior in zip(NAMES, sigma, model.prior_sigma(), strict=True) if s > 0.5 * prior]
    if untold:
        remarks.append(f"not better known than before: {', '.join(untold)}")
    method = f"{n_poses} poses"
    return Plan(path, method, sigma, covariance, moved, (float(f.min()), float(f.max())), [], remarks)


def static_poses(request: Request, n_poses: int, hold: float, progress: Progress) -> Plan:
    """The N static poses with most information on mass, CoG and force offsets, in an order of short ways."""
    if request.checker.model.robot.n_cables < 6:
        return _hanging_poses(request, n_poses, hold, progress)
    check_pose(request.checker, request.start, "start pose")
    model = request.checker.model
    goal = goal_of(model, request.criterion, static=True)
    problem = Problem(request.checker, pose_basis(n_poses, hold, model), goal, request.start)
    c = search_all(problem, request.n_starts, request.seed, progress)
    left, order = list(request.start + c), []
    here = request.start
    while left:
        nearest = min(range(len(left)), key=lambda k: float(np.linalg.norm(left[k] - here)))
        here = left.pop(nearest)
        order.append(here)
    return moves(request, np.array(order), hold, f"{n_poses} poses")
