# SPDX-License-Identifier: Apache-2.0
"""Motions that tell mass, centre of gravity and inertia as well as a robot's limits allow.

    minimise  log tr(W S)  (A)  or  log det(W S) / 10  (D)     S: covariance of mass, CoG, inertia, information.py
    over      q(t) = q_0 + B(t) c      quintic B-splines in x y z roll pitch yaw, at rest at both ends
    subject to every limit of limits.py at every instant
W puts 0.2 % of the mass, 1 mm and 1 % of the mean moment of inertia on a par. Gradients: dS/dH in closed form, dH and
the limits by differences over the 18 pose values of an instant, all instants at once, so their cost does not depend on
the number of coefficients. Limits enter by an augmented Lagrangian around L-BFGS-B (scipy), from the best of many
random Fourier series. A result that is a little over a limit is drawn back towards the start pose until it is not.
Static poses: the same with q free at every pose and no derivatives.
"""

import itertools
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import minimize

from inertiad import dynamics, information, trajectory, underactuated
from inertiad import robot as description
from inertiad.dynamics import Moved
from inertiad.error import InputError
from inertiad.estimate import NAMES, UNITS
from inertiad.information import Model
from inertiad.limits import Checker, Limits, check_pose
from inertiad.table import Array
from inertiad.trajectory import Motion, Moves, Trajectory, motion_of

Criterion = Literal["A", "D"]
Progress = Callable[[str], None]

REST = 0.5
"""s of rest before and after a motion"""
SPACING = 0.75
"""s between knots: nothing above about 0.6 Hz"""
HOP = 0.2
"""s between the instants at which a motion is judged while it is searched"""
STEP = 1e-5
"""m, rad and their derivatives, of differences"""
CANDIDATES = 24
"""random series a start chooses from"""
ROUNDS, ITERATIONS = 4, 22
"""of the augmented Lagrangian, and of L-BFGS-B in each"""
LONGEST = 120.0
"""s, the longest motion tried for a wanted accuracy"""
FINE_RATE = 50.0
"""Hz at which a found motion is checked against the limits"""


@dataclass(frozen=True)
class Basis:
    """q = q_0 + B0 c, its derivatives B1 c and B2 c, over N instants; c [n, 6]."""

    t: Array
    B0: Array
    B1: Array
    B2: Array
    weight: float
    """windows that an instant stands for"""


def _spline(duration: float) -> tuple[Array, int]:
    """Knots, and number of free coefficients per coordinate: three are held at each end for rest."""
    n_free = max(3, round(duration / SPACING) - 1)
    inner = np.linspace(0.0, duration, n_free + 2)
    return np.concatenate([[0.0] * 5, inner, [duration] * 5]), n_free


def motion_basis(duration: float, hop: float, model: Model) -> Basis:
    """B-splines over a duration [s], looked at every hop [s]."""
    knots, n_free = _spline(duration)
    t = np.linspace(0.0, duration, int(np.ceil(duration / hop)) + 1)
    spline = BSpline(knots, np.eye(n_free + 6), 5)
    B = [np.nan_to_num(spline(t, d))[:, 3:-3] for d in range(3)]
    return Basis(t, B[0], B[1], B[2], (t[1] - t[0]) / (0.25 * model.robot.estimator.window_length))


def pose_basis(n_poses: int, hold: float, model: Model) -> Basis:
    """Independent poses at rest, each held [s]."""
    none = np.zeros((n_poses, n_poses))
    weight = hold / (0.25 * model.robot.estimator.window_length)
    return Basis(np.arange(float(n_poses)), np.eye(n_poses), none, none, weight)


@dataclass(frozen=True)
class Goal:
    """What counts as well known."""

    criterion: Criterion
    scale: Array
    """[10] of mass, CoG, inertia: one of these is as good as another; inf: does not count"""


def goal_of(model: Model, criterion: Criterion, static: bool) -> Goal:
    """0.2 % of the mass, 1 mm, 1 % of the mean moment; no inertia where nothing turns."""
    moment = float(np.mean(model.body.inertia_cog[:3]))
    inertia = np.full(6, np.inf if static else 0.01 * moment)
    return Goal(criterion, np.concatenate([[0.002 * model.body.mass], np.full(3, 1e-3), inertia]))


@dataclass(frozen=True)
class Problem:
    """Cost and limits of coefficients c [n, 6], with gradients."""

    checker: Checker
    basis: Basis
    goal: Goal
    start: Array
    """q_0 [6]"""

    def coordinates(self, c: Array) -> tuple[Array, Array, Array]:
        b = self.basis
        return self.start + b.B0 @ c, b.B1 @ c, b.B2 @ c

    def cost(self, H: Array) -> tuple[float, Array]:
        """Cost of H [N, 6, n], and its gradient [N, 6, n]."""
        model, counts = self.checker.model, np.isfinite(self.goal.scale)
        E = model.E[counts] / self.goal.scale[counts, None]
        P = np.linalg.inv(model.information(H, self.basis.weight))
        S = E @ P @ E.T
        inner = np.linalg.inv(S) / len(S) if self.goal.criterion == "D" else np.eye(len(S)) / np.trace(S)
        value = np.linalg.slogdet(S)[1] / len(S) if self.goal.criterion == "D" else np.log(np.trace(S))
        N = P @ E.T @ inner @ E @ P
        slope = -2.0 * self.basis.weight * (H / model.residual_std[:, None] ** 2) @ N
        return float(value), slope

    def evaluate(self, c: Array) -> tuple[float, Array]:
        """(cost, g [N, limits])"""
        g, motion, f = self.checker.excess(*self.coordinates(c))
        return self.cost(self.checker.model.instants(motion, f))[0], g

    def lagrangian(self, c: Array, multiplier: Array, rho: float) -> tuple[float, Array]:
        """cost + sum max(0, rho g + multiplier)^2 / (2 rho), and its gradient [n, 6]."""
        model, n = self.checker.model, len(self.basis.t)
        z = np.hstack(self.coordinates(c))
        moved = z[None] + STEP * np.concatenate([np.zeros((1, 18)), np.eye(18)])[:, None, :]
        flat = moved.reshape(-1, 18)
        g, motion, f = self.checker.excess(flat[:, :6], flat[:, 6:12], flat[:, 12:], 7 * n)
        H = model.instants(motion, f).reshape(19, n, 6, -1)
        g = g.reshape(19, n, -1)
        value, slope = self.cost(H[0])
        push = np.maximum(rho * g[0] + multiplier, 0.0)
        by_z = np.einsum("aknx,knx->ka", H[1:] - H[0], slope) + np.einsum("akc,kc->ka", g[1:] - g[0], push)
        by_z /= STEP
        b = self.basis
        gradient = b.B0.T @ by_z[:, :6] + b.B1.T @ by_z[:, 6:12] + b.B2.T @ by_z[:, 12:]
        return value + float(np.sum(push**2)) / (2.0 * rho), gradient


def random_series(problem: Problem, dice: np.random.Generator) -> Array:
    """Coefficients [n, 6] of a random Fourier series as large as the limits allow, or of none."""
    n, still = problem.basis.B0.shape[1], np.zeros((problem.basis.B0.shape[1], 6))
    u = (np.arange(n) + 1.0) / (n + 1.0)
    k = np.arange(1, max(2, n // 2) + 1)
    phase = dice.uniform(0.0, 2.0 * np.pi, (len(k), 6))
    size = dice.standard_normal((len(k), 6)) / np.sqrt(len(k))
    shape = np.einsum("kj,nkj->nj", size, np.sin(2.0 * np.pi * np.multiply.outer(u, k)[:, :, None] + phase))
    limits = problem.checker.limits
    reach = np.array([*(0.5 * (limits.high - limits.low)), limits.tilt, limits.tilt, limits.yaw])
    return _largest(problem, still, shape * reach)


def _within(problem: Problem, c: Array, tolerance: float = 0.0) -> bool:
    try:
        return bool(problem.checker.excess(*problem.coordinates(c))[0].max() <= tolerance)
    except (ValueError, InputError):
        return False


def _largest(problem: Problem, inner: Array, outer: Array) -> Array:
    """The point nearest to outer on the way from inner, which keeps the limits, that keeps them too."""
    low, high = 0.0, 1.0
    if _within(problem, outer):
        return outer
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _within(problem, inner + middle * (outer - inner)) else (low, middle)
    return inner + low * (outer - inner)


def _improve(problem: Problem, c: Array) -> Array:
    """Augmented Lagrangian around L-BFGS-B."""
    shape, rho = c.shape, 10.0
    multiplier = np.zeros_like(problem.evaluate(c)[1])

    def both(x: Array) -> tuple[float, Array]:
        try:
            value, gradient = problem.lagrangian(x.reshape(shape), multiplier, rho)
        except (ValueError, InputError):
            return 1e6, np.zeros(x.size)
        return value, gradient.ravel()

    for _ in range(ROUNDS):
        found = minimize(both, c.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
        c = found.x.reshape(shape)
        multiplier = np.maximum(multiplier + rho * problem.evaluate(c)[1], 0.0)
        rho *= 3.0
    return c


def search(problem: Problem, seed: int, index: int) -> tuple[float, Array]:
    """One start: the best of some random series, improved, within every limit. Same seed and index, same result."""
    dice = np.random.default_rng([seed, index])
    series = [random_series(problem, dice) for _ in range(CANDIDATES)]
    best = min(series, key=lambda c: problem.evaluate(c)[0])
    found = _largest(problem, np.zeros_like(best), _improve(problem, best))
    return min(((problem.evaluate(c)[0], c) for c in (best, found)), key=lambda pair: pair[0])


def _search_all(problem: Problem, n_starts: int, seed: int, progress: Progress) -> Array:
    """The best of n_starts searches [n, 6], on two processes."""
    results = []
    with _one_thread_each(), ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        for future in [pool.submit(search, problem, seed, index) for index in range(n_starts)]:
            results.append(future.result())
            progress(f"start {len(results)} of {n_starts}, best cost {min(r[0] for r in results):.3f}")
    return min(results, key=lambda result: result[0])[1]


class _one_thread_each:
    """Child processes started inside leave the other core to each other."""

    def __enter__(self) -> None:
        self._before = os.environ.get("OPENBLAS_NUM_THREADS")
        os.environ["OPENBLAS_NUM_THREADS"] = "1"

    def __exit__(self, *_: object) -> None:
        os.environ.pop("OPENBLAS_NUM_THREADS")
        if self._before is not None:
            os.environ["OPENBLAS_NUM_THREADS"] = self._before


class Splined:
    """B-splines in pose coordinates, with rests around them."""

    def __init__(self, start: Array, c: Array, duration: float) -> None:
        """start [6]; free coefficients c [n, 6] of a motion of duration [s]."""
        held = np.zeros((3, 6))
        self._spline = BSpline(_spline(duration)[0], start + np.concatenate([held, c, held]), 5)
        self._moving = duration
        self.duration = duration + 2.0 * REST

    def at(self, t: Array) -> Motion:
        tau = np.clip(t - REST, 0.0, self._moving)
        inside = ((t > REST) & (t < REST + self._moving))[:, None]
        return motion_of(
            self._spline(tau), np.where(inside, self._spline(tau, 1), 0.0), np.where(inside, self._spline(tau, 2), 0.0)
        )


@dataclass(frozen=True)
class Plan:
    """A motion and what a run of it will report."""

    path: Trajectory
    method: str
    sigma: Array
    """[10] mass, CoG, inertia"""
    covariance: Array
    """[10, 10]"""
    driven: Moved
    """what becomes of it on elastic cables, under a controller where there are cables enough for one"""
    tension: tuple[float, float]
    """N, least and greatest on the path itself"""
    binding: list[str] = field(default_factory=list)
    """limits that the motion touches, and where"""
    remarks: list[str] = field(default_factory=list)


def sampled(path: Trajectory, rate: float) -> tuple[Array, Motion]:
    t = information.sample_times(path, rate)
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
    moved = dynamics.move(mechanics, mechanics, path, plant, information.REHEARSAL_RATE)
    _, *broken = dynamics.spoken(moved, checker.model.robot)
    if broken:
        raise InputError(f"{method}: driven by a controller on elastic cables: {'; '.join(broken)}")
    return moved


def predicted(checker: Checker, path: Trajectory, method: str) -> Plan:
    """What a run of the path will report. InputError, with the limit and the place, if it breaks one."""
    f, g, binding = _checked(checker, path)
    if g.max() > 0.02:
        k, c = np.unravel_index(int(np.argmax(g)), g.shape)
        raise InputError(
            f"{method}: {checker.names[int(c)]} exceeded at t = {k / FINE_RATE:.2f} s by {100 * g[k, c]:.0f} %"
        )
    _, motion = sampled(path, information.REHEARSAL_RATE)
    covariance = checker.model.rehearse(motion, checker.tensions(motion), information.REHEARSAL_RATE)
    sigma, moved = np.sqrt(np.diag(covariance)), driven(checker, path, method)
    return Plan(path, method, sigma, covariance, moved, (float(f.min()), float(f.max())), binding)


@dataclass(frozen=True)
class Request:
    """What is asked for."""

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
    c = _search_all(problem, request.n_starts, request.seed, progress)
    fine = replace(problem, basis=motion_basis(moving, 1.0 / FINE_RATE, model))
    c = _largest(fine, np.zeros_like(c), c)
    return predicted(request.checker, Splined(request.start, c, moving), "optimal")


def shortest(request: Request, wanted: Array, progress: Progress) -> Plan:
    """The shortest motion found that brings every sigma [10] to what is wanted (inf: does not matter)."""
    quick = replace(request, n_starts=2)
    low, high, plan = 5.0, 10.0, optimal(quick, 10.0, progress)
    while np.any(plan.sigma > wanted):
        low, high = high, 1.6 * high
        if high > LONGEST:
            raise InputError(f"--sigma: {_out_of_reach(request.checker.model, plan, wanted)}")
        progress(f"{high:.0f} s")
        plan = optimal(quick, high, progress)
    for _ in range(3):
        middle = round(0.5 * (low + high), 1)
        trial = optimal(quick, middle, progress)
        good = bool(np.all(trial.sigma <= wanted))
        low, high, plan = (low, middle, trial) if good else (middle, high, plan)
    return plan


GROUPS = (
    ("attitude", slice(10, 13)),
    ("world_yaw", slice(13, 14)),
    ("acc_bias", slice(14, 17)),
    ("imu_alignment", slice(17, 20)),
    ("position_delay", slice(20, 21)),
)


def _out_of_reach(model: Model, plan: Plan, wanted: Array) -> str:
    """In words: which sigma stays too large, and what keeps it there."""
    worst = int(np.argmax(plan.sigma / wanted))
    _, motion = sampled(plan.path, information.REHEARSAL_RATE)
    f = Checker(model, None).tensions(motion)  # type: ignore[arg-type]  # no limits needed for tensions
    data = model.windows(motion, f, information.REHEARSAL_RATE)
    m, base = model.robot.n_cables, model.information(data)
    groups = [*GROUPS, ("force_offset", slice(21, 21 + m)), ("force_gain", slice(21 + m, 21 + 2 * m))]
    known = {}
    for name, columns in groups:
        better = base.copy()
        better[columns, columns] += np.diag(np.full(columns.stop - columns.start, 1e18))
        known[name] = float(model.sigma(better)[worst])
    name = min(known, key=lambda key: known[key])
    return (
        f"{NAMES[worst]} stays at {plan.sigma[worst]:.3g} {UNITS[worst]} after {plan.path.duration:.0f} s, wanted "
        f"{wanted[worst]:.3g}: what limits it is [std] {name} = {getattr(model.robot.std, name):g}: calibrate it first"
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
    """The same for a platform that only hangs, whose swings tell something, too."""
    checker, model = request.checker, request.checker.model
    progress("look for places to hang")
    scale = goal_of(model, request.criterion, static=True).scale
    dice = np.random.default_rng([request.seed, 4])
    path, moved = underactuated.rests(checker, n_poses, hold, scale, lambda a, b: move_time(checker, a, b), dice)
    motion, f = underactuated.sampled(moved)
    covariance = model.rehearse(motion, f, information.REHEARSAL_RATE)
    sigma = np.sqrt(np.diag(covariance))
    n_free = 6 - model.robot.n_cables
    remarks = [f"{model.robot.n_cables} cables leave {n_free} of 6 degrees of freedom free: lengths are planned"]
    untold = [name for name, s, prior in zip(NAMES, sigma, model.prior_sigma(), strict=True) if s > 0.5 * prior]
    if untold:
        remarks.append(f"hardly told better than before: {', '.join(untold)}")
    method = f"{n_poses} poses"
    return Plan(path, method, sigma, covariance, moved, (float(f.min()), float(f.max())), [], remarks)


def static_poses(request: Request, n_poses: int, hold: float, progress: Progress) -> Plan:
    """The N poses at rest that tell mass, CoG and force offsets best, in an order of short ways."""
    if request.checker.model.robot.n_cables < 6:
        return _hanging_poses(request, n_poses, hold, progress)
    check_pose(request.checker, request.start, "start pose")
    model = request.checker.model
    goal = goal_of(model, request.criterion, static=True)
    problem = Problem(request.checker, pose_basis(n_poses, hold, model), goal, request.start)
    c = _search_all(problem, request.n_starts, request.seed, progress)
    left, order = list(request.start + c), []
    here = request.start
    while left:
        nearest = min(range(len(left)), key=lambda k: float(np.linalg.norm(left[k] - here)))
        here = left.pop(nearest)
        order.append(here)
    return moves(request, np.array(order), hold, f"{n_poses} poses")


# ---- what the command line says --------------------------------------------------------------------------------------


def numbers(text: str, n: int, option: str, meaning: str) -> Array:
    """n numbers with commas between. InputError: they are not."""
    try:
        values = np.array([float(cell) for cell in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.shape != (n,) or not np.isfinite(values).all():
        raise InputError(f'{option} "{text}": allowed: {n} numbers, {meaning}')
    return values


def pose_from(text: str, option: str) -> Array:
    """x,y,z in m and roll,pitch,yaw in degrees -> [6], m and rad."""
    pose = numbers(text, 6, option, "x,y,z in m and roll,pitch,yaw in degrees")
    return np.concatenate([pose[:3], np.deg2rad(pose[3:])])


def default_box(model: Model) -> Array:
    """Least and greatest x y z [6], m: a quarter of the anchors' reach about their middle, 27 to 50 % of their height.

    Heights count from the world's z = 0, or from the lowest anchor where that is below it.
    """
    anchor = np.array([cable.anchor for cable in model.robot.cable])
    low, high = anchor.min(axis=0), anchor.max(axis=0)
    middle, reach = 0.5 * (low + high), 0.125 * (high - low)
    floor, top = min(0.0, low[2]), low[2]
    z = (floor + 0.27 * (top - floor), floor + 0.5 * (top - floor)) if top > floor else (high[2] + 1.0, high[2] + 2.0)
    return np.array([*(middle - reach)[:2], z[0], *(middle + reach)[:2], z[1]])


def wanted_sigma(text: str, model: Model) -> Array:
    """ "mass=0.2%,cog=1mm,inertia=1%" -> sigma [10]; percentages of the mass and of the mean moment of inertia."""
    wanted, moment = np.full(10, np.inf), float(np.mean(model.body.inertia_cog[:3]))
    kinds = {
        "mass": (slice(0, 1), {"%": 0.01 * model.body.mass, "kg": 1.0}),
        "cog": (slice(1, 4), {"mm": 1e-3, "m": 1.0}),
        "inertia": (slice(4, 10), {"%": 0.01 * moment, "kgm2": 1.0}),
    }
    for item in text.split(","):
        key, _, value = item.strip().partition("=")
        where, units = kinds.get(key, (slice(0), {}))
        unit = next((u for u in units if value.endswith(u)), None)
        try:
            number = float(value.removesuffix(unit or "?"))
        except ValueError:
            number = -1.0
        if unit is None or not number > 0.0:
            raise InputError(f'--sigma "{item}": allowed: mass=0.2% or kg, cog=1mm or m, inertia=1% or kgm2')
        wanted[where] = number * units[unit]
    return wanted


def limits_from(model: Model, box: str | None, tilt: float, yaw: float, speed: float, acceleration: float) -> Limits:
    """Limits of the command line; degrees, m, s. InputError: the box is empty."""
    edges = default_box(model) if box is None else numbers(box, 6, "--box", "x_min,y_min,z_min,x_max,y_max,z_max in m")
    if not np.all(edges[:3] < edges[3:]):
        raise InputError(f'--box "{box}": allowed: every minimum below its maximum')
    angle = np.deg2rad([tilt, yaw])
    return Limits(
        edges[:3], edges[3:], float(angle[0]), float(angle[1]), speed, acceleration, clearance=0.03, margin=0.1
    )


MOTIONS = ("optimal", "paper")


@dataclass(frozen=True)
class Asked:
    """The command line's words; see `inertiactl excite -h`."""

    motion: str = "optimal"
    duration: float = 20.0
    sigma: str | None = None
    poses: int = 0
    hold: float = 3.0
    start: str | None = None
    end: str | None = None
    criterion: str = "A"
    box: str | None = None
    tilt: float = 30.0
    yaw: float = 35.0
    speed: float = 4.0
    acceleration: float = 2.0


def _request(robot_file: Path, asked: Asked, n_starts: int, seed: int) -> Request:
    if asked.motion not in MOTIONS:
        hint = description.nearest(asked.motion, MOTIONS)
        raise InputError(f'--motion "{asked.motion}": allowed: {", ".join(MOTIONS)}{hint}')
    robot = description.load(robot_file)
    if robot.nominal is None:
        raise InputError(f"{robot_file}: no [nominal] body: excite needs one to plan tensions with")
    if asked.criterion not in ("A", "D"):
        raise InputError(f'--criterion "{asked.criterion}": allowed: A, D')
    model = Model(robot, str(robot_file), robot.nominal)
    limits = limits_from(model, asked.box, asked.tilt, asked.yaw, asked.speed, asked.acceleration)
    if asked.motion == "paper":  # the poses are given: only what the robot cannot do is refused
        far = np.full(3, 1e4)
        limits = replace(limits, low=-far, high=far, tilt=np.deg2rad(80.0), yaw=np.pi, margin=0.0)
    middle = np.concatenate([0.5 * (limits.low + limits.high), np.zeros(3)])
    start = middle if asked.start is None else pose_from(asked.start, "--start")
    criterion: Criterion = "A" if asked.criterion == "A" else "D"
    return Request(Checker(model, limits), start, criterion, n_starts, seed)


def _paper(request: Request, asked: Asked) -> Plan:
    """There and back between two poses, those of the paper where none are given."""
    start = request.start if asked.start is not None else trajectory.PAPER_PAIRS[0, 0]
    end = trajectory.PAPER_PAIRS[0, 1] if asked.end is None else pose_from(asked.end, "--end")
    return moves(request, np.array([start, end, start]), REST, "paper")


def plan(robot_file: Path, asked: Asked, n_starts: int, seed: int, progress: Progress) -> tuple[Request, Plan]:
    """What the command line asks for. InputError: it cannot be had, and which limit is in the way."""
    request = _request(robot_file, asked, n_starts, seed)
    if asked.poses:
        return request, static_poses(request, asked.poses, asked.hold, progress)
    if asked.motion == "paper":
        return request, _paper(request, asked)
    if asked.sigma is not None:
        return request, shortest(request, wanted_sigma(asked.sigma, request.checker.model), progress)
    return request, optimal(request, asked.duration, progress)
