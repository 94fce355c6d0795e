# SPDX-License-Identifier: Apache-2.0
"""Fits the mistakes of mistake_table.py to runs, and names the one that explains them.

Windows of 0.5 s with a smooth kernel k hold for three laws, without a derivative of any signal:

    forces       mean k (W f + sag) = mean k Y(s, w, alpha) theta        alpha by parts: mean k alpha = -mean k' w
    kinematics   mean k R s - g z   = mean k'' p_I                       p_I: the IMU's position by the tracker
    rotation     mean k w           = mean k (rate at which the attitude turns)

The errors that sensors may have by robot.toml are unknowns with their priors under every law: offsets and gains of
forces, biases, attitude, tracker target, yaw of the tracker's world, delays. A mistake's free numbers are found by
Gauss-Newton. Its cost is n ln(rms of the residual) over the laws, with as many equations n as are independent, and the
priors' share.
A mistake is named where the cost falls by SURE and its number is beyond four declared standard deviations; a rival of
another kind whose cost is almost as low is named beside it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.finding import Finding
from inertiad.base.table import Array
from inertiad.identify.fit import WEAK_PRIOR
from inertiad.identify.mistake_table import Case, Mistake, Samples, about_z, earlier, mounting, table
from inertiad.identify.smooth_window import WINDOW, Windows, windows
from inertiad.robot import configuration, dbc
from inertiad.robot.configuration import platform_size
from inertiad.robot.description import Robot
from inertiad.run import reader
from inertiad.run.reader import Recording

PERIOD: Final = 0.04
"""s between the samples that are looked at: 12 to a window"""
ROWS_MAX: Final = 2_000
"""samples that are looked at, all runs together"""
CHOSEN: Final = 3
"""mistakes of a kind that one law has to choose from"""
FITTED: Final = 7
"""mistakes with free numbers that are fitted: those that promise the largest fall of the cost"""
INDEPENDENT: Final = 0.2
"""share of the windows' equations that count while numbers are found: windows overlap, and errors outlast them"""
STEP: Final = 1e-4
"""m, rad, s: of the samples' displacements"""
WINDOWS_MIN: Final = 30
"""windows that give more equations than there are unknowns"""
GROSS: Final = 5e-3
"""residual, of the weight, below which no plug, axis or unit is wrong"""
STEPS, HALVINGS, WORTH_A_STEP = 6, 4, 0.1
"""of Gauss-Newton: at most so many, halved at most so often, each for this fall of the cost at least"""
SURE: Final = (30.0, 150.0)
"""fall of the cost that names a mistake: where a law's residual falls by FALLS, and where none does"""
FALLS: Final = 1.25
"""times that a residual is larger than without the mistake"""
DECLARED: Final = 4.0
"""standard deviations: a smaller error is one that robot.toml declares"""
REFINED: Final = 0.15
"""of a number: step of the parabola through the joint fit's costs"""
RIVAL: Final = 10.0
"""of the cost: a rival that is nearer than this may be the mistake as well"""
MILD: Final = "give [align] delay_force if it is known; the fit takes it out of the forces"
CORRECT: Final = "correct robot.toml or the wiring, then record or fit again"


@dataclass(frozen=True)
class Law:
    """Equations of one law over all runs: y = A x + noise, x with priors [len x] of this std; inf: none."""

    y: Array
    A: Array
    std: Array
    floor: float
    """of the residual: less than this tells nothing"""

    @cached_property
    def solved(self) -> tuple[Array, float, float]:
        """x, rms of the residual, the priors' cost. The priors are weighed with the residual's own noise."""
        sigma, x = self.floor, np.zeros(self.A.shape[1])
        for _ in range(3):
            weight = np.sqrt(INDEPENDENT) / sigma
            A = np.vstack([weight * self.A, np.diag(1.0 / self.std)])
            x = np.linalg.lstsq(A, np.concatenate([weight * self.y, np.zeros(len(x))]), rcond=1e-12)[0]
            sigma = max(float(np.sqrt(np.mean((self.y - self.A @ x) ** 2))), self.floor)
        return x, sigma, float(((x / self.std) ** 2).sum())

    def independent(self, width: int) -> float:
        """Equations that count, by the correlation of the residual from window to window; width: equations of one."""
        x, _, _ = self.solved
        r = (self.y - self.A @ x).reshape(-1, width)
        rho = float((r[1:] * r[:-1]).sum() / max((r * r).sum(), 1e-300))
        return len(self.y) * max((1.0 - rho) / (1.0 + rho), 0.02) / 2.0


@dataclass(frozen=True)
class Fitted:
    mistake: Mistake
    cost: float
    numbers: Array
    laws: list[Law]

    @property
    def rms(self) -> float:
        """Of the residual force, N."""
        return self.laws[0].solved[1] * float(np.sqrt(6.0))

    @property
    def least(self) -> float:
        """The smallest rms that is told apart from none, N."""
        return self.laws[0].floor * float(np.sqrt(6.0))

    def cost_with(self, equations: list[float]) -> float:
        """Cost where so many equations of each law are independent."""
        cost = 2.0 * len(self.numbers)
        for law, n in zip(self.laws, equations, strict=True):
            _, sigma, priors = law.solved
            cost += 2.0 * n * float(np.log(sigma / law.floor)) + priors
        return cost


def _pose(robot: Robot, run: Samples) -> tuple[Array, Array]:
    """p [N, 3] of P in W and R [N, 3, 3] P to W."""
    R = run.R @ mounting(robot).T
    return run.position - R @ np.array(robot.tracker.target), R


def _turned(R: Array, axis: int, angle: float) -> Array:
    return np.asarray(R @ Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix())


def _blocks(arrays: list[Array]) -> Array:
    return np.concatenate([a.reshape(-1, a.shape[-1]) for a in arrays])


class Judge:
    """Fits mistakes to one set of runs."""

    def __init__(self, robot: Robot, recordings: list[Recording]) -> None:
        self.size = platform_size(robot)
        self.bindings = dbc.bind(robot, robot.name)
        self.std, self.displacement_std = configuration.std(robot), displacement_std(robot)
        share = max(1, ROWS_MAX // len(recordings))
        self.case = Case(robot, tuple(_samples(run, share) for run in recordings))
        self.windows = [windows(run.t) for run in self.case.runs]
        self.weight = float(np.mean([np.abs(run.f).sum(axis=1).mean() for run in self.case.runs]))
        self.n = INDEPENDENT * 6.0 * sum(len(w.rows) for w in self.windows)

    def _config(self, robot: Robot) -> Any:
        return inertiad_core.Config(configuration.to_bytes(configuration.config_of(robot, self.bindings)))

    def forces(self, case: Case) -> Law:
        """Newton and Euler about the IMU, P axes."""
        robot, m = case.robot, case.robot.n_cables
        config, point = self._config(robot), np.array(robot.imu.position)
        mount, scale = mounting(robot), np.repeat([1.0, 1.0 / self.size], 3)
        D = inertiad_core.regressor(np.zeros((3, 3)), np.zeros((3, 3)), np.eye(3))
        E = inertiad_core.regressor(np.ascontiguousarray(mount.T), np.zeros((3, 3)), np.zeros((3, 3)))
        zero_sum = np.linalg.svd(np.ones((1, m)))[2][1:].T  # a common gain only scales the body
        y, A = [], []
        for run, w in zip(case.runs, self.windows, strict=True):
            p, R = _pose(robot, run)
            s, rate = run.acc @ mount.T, run.gyro @ mount.T

            def pull(p: Array, R: Array, f: Array) -> tuple[Array, Array]:
                W, sag = inertiad_core.wrench_matrix(config, np.ascontiguousarray(p), np.ascontiguousarray(R), point)
                return W, np.einsum("nij,nj->ni", W, f) + sag

            W, wrench = pull(p, R, run.f)
            columns = [w.mean(w.k, W), w.mean(w.k, W * run.f[:, None, :]) @ zero_sum]
            for moved in _displaced(robot, run):
                change = pull(*_pose(robot, moved), moved.f)[1] - wrench
                columns.append(w.mean(w.k, change)[:, :, None] / STEP)
            if case.extra is not None:
                force = np.einsum("nji,j->ni", R, case.extra)
                wrench = wrench + np.hstack([force, np.cross(-point, force)])
            Y = w.mean(w.k, inertiad_core.regressor(s, rate, np.zeros_like(s)))
            columns.insert(0, Y - np.einsum("wa,aij->wij", w.mean(w.slope, rate), D))
            y.append(w.mean(w.k, wrench) * scale)
            A.append(np.concatenate(columns, axis=2) * scale[:, None])
        bodies, bias = [], []
        for wrench, columns in zip(y, A, strict=True):  # each run may have a body of its own
            Y = columns[:, :, :10].reshape(-1, 10)
            theta = np.linalg.lstsq(Y, wrench.ravel(), rcond=1e-9)[0]
            bodies.append(Y)
            bias.append(np.tile(np.einsum("aij,j->ia", E, theta) * scale[:, None], (len(wrench), 1)))
        target = np.concatenate(y).ravel()
        stacked = np.hstack([block_diag(*bodies), _blocks([columns[:, :, 10:] for columns in A])])
        std = self.std
        priors = [np.full(10 * len(y), np.inf), np.full(m, max(std["force_offset"], 1e-3 * self.weight / m))]
        priors += [
            np.full(m - 1, max(std["force_gain"], 2e-3)),
            self.displacement_std,
            np.full(3, max(std["acc_bias"], 0.02)),
        ]
        return Law(target, np.hstack([stacked, np.concatenate(bias)]), np.concatenate(priors), 2e-4 * self.weight)

    def kinematics(self, case: Case) -> Law:
        """Specific force against the second derivative of the position, W."""
        robot, g = case.robot, case.robot.gravity

        def difference(run: Samples, w: Windows) -> Array:
            p, R = _pose(robot, run)
            s = np.einsum("nij,nj->ni", run.R, run.acc)
            return w.mean(w.k, s) - [0.0, 0.0, g] - w.mean(w.curvature, p + R @ np.array(robot.imu.position))

        y, A = [], []
        for run, w in zip(case.runs, self.windows, strict=True):
            y.append(difference(run, w))
            moved = [(difference(d, w) - y[-1])[:, :, None] / STEP for d in _displaced(robot, run)]
            A.append(-np.concatenate([-w.mean(w.k, run.R), *moved], axis=2))
        priors = [np.full(3, max(self.std["acc_bias"], 0.02)), self.displacement_std]
        return Law(np.concatenate(y).ravel(), _blocks(A), np.concatenate(priors), 0.01)

    def rotation(self, case: Case) -> Law:
        """The gyro against the rate at which the attitude turns, I axes."""

        def difference(run: Samples, w: Windows) -> Array:
            turn = Rotation.from_matrix(np.swapaxes(run.R[:-1], 1, 2) @ run.R[1:]).as_rotvec()
            middle = 0.5 * (run.gyro[1:] + run.gyro[:-1]) - turn / np.diff(run.t)[:, None]
            return w.mean(w.k, np.vstack([middle, middle[-1:]]))

        y, A = [], []
        for run, w in zip(case.runs, self.windows, strict=True):
            y.append(difference(run, w))
            late = replace(run, R=run.R @ Rotation.from_rotvec(STEP * run.gyro).as_matrix())
            delay = (y[-1] - difference(late, w))[:, :, None] / STEP
            A.append(np.concatenate([np.tile(np.eye(3), (len(w.rows), 1, 1)), delay], axis=2))
        priors = [*3 * [max(self.std["gyro_bias"], 1e-3)], max(self.std["attitude_delay"], 2e-3)]
        return Law(np.concatenate(y).ravel(), _blocks(A), np.array(priors), 2e-3)

    def laws(self, case: Case) -> list[Law]:
        """The laws of a case; empty: a cable has no direction, or there is no such robot."""
        try:
            return [self.forces(case), self.kinematics(case), self.rotation(case)]
        except ValueError:
            return []

    def cost(self, laws: list[Law]) -> float:
        """Of the residuals and the priors; inf without laws."""
        cost = 0.0 if laws else np.inf
        for law, share in zip(laws, (1.0, 0.5, 0.5), strict=False):
            _, sigma, priors = law.solved
            cost += share * self.n * 2.0 * float(np.log(sigma / law.floor)) + priors
        return cost

    def fit(self, mistake: Mistake) -> Fitted:
        """Its free numbers by Gauss-Newton on all laws, each step halved until the cost falls."""
        x = np.zeros(len(mistake.steps))
        laws = self.laws(mistake.apply(self.case, x))
        cost = self.cost(laws)
        for _ in range(STEPS if mistake.steps and laws else 0):
            step = self._step(mistake, x, laws)
            for _ in range(HALVINGS):
                tried = np.clip(x + step, -mistake.limit, mistake.limit)
                there = self.laws(mistake.apply(self.case, tried))
                now = self.cost(there)
                if now < cost:
                    break
                step = 0.5 * step
            if not now < cost - WORTH_A_STEP:
                break
            x, laws, cost = tried, there, now
        return Fitted(mistake, cost + 2.0 * len(x), x, laws)

    def best_by_law(self, mistakes: list[Mistake]) -> list[Mistake]:
        """Those without a law of choice, and of each kind with one the few that fit its law best."""
        chosen = [c for c in mistakes if not c.law]
        for kind in dict.fromkeys(c.kind for c in mistakes if c.law):
            rivals = [c for c in mistakes if c.kind == kind]
            rms = [getattr(self, c.law)(c.apply(self.case, np.zeros(0))).solved[1] for c in rivals]
            chosen += [rivals[i] for i in np.argsort(rms)[:CHOSEN]]
        return chosen

    def expected(self, mistake: Mistake, laws: list[Law]) -> float:
        """Fall of the cost that a first step promises."""
        normal, right = self._equations(mistake, np.zeros(len(mistake.steps)), laws)
        fall = float(right @ np.linalg.lstsq(normal, right, rcond=1e-9)[0])
        n = INDEPENDENT * sum(len(law.y) for law in laws)
        return -n * np.log1p(-min(fall / n, 1.0 - 1e-9))

    def _step(self, mistake: Mistake, x: Array, laws: list[Law]) -> Array:
        """Of Gauss-Newton."""
        normal, right = self._equations(mistake, x, laws)
        return np.asarray(np.linalg.lstsq(normal, right, rcond=1e-9)[0])

    def _equations(self, mistake: Mistake, x: Array, laws: list[Law]) -> tuple[Array, Array]:
        """The laws' residuals against the free numbers, sensors' errors eliminated."""
        changed = [
            self.laws(mistake.apply(self.case, x + h * e)) for h, e in zip(mistake.steps, np.eye(len(x)), strict=True)
        ]
        if not laws or not all(changed):
            return np.eye(len(x)), np.zeros(len(x))
        normal, right = np.zeros((len(x), len(x))), np.zeros(len(x))
        for i, law in enumerate(laws):
            a, sigma, _ = law.solved
            weight = np.sqrt(INDEPENDENT) / sigma
            n = law.A.shape[1]
            columns = [(c[i].y - law.y - (c[i].A - law.A) @ a) / h for c, h in zip(changed, mistake.steps, strict=True)]
            A = weight * np.hstack([law.A, -np.column_stack(columns)])
            H = A.T @ A + np.diag(np.concatenate([law.std**-2.0, np.zeros(len(x))]))
            r = weight * A.T @ (law.y - law.A @ a) - np.concatenate([a / law.std**2, np.zeros(len(x))])
            gain = np.linalg.lstsq(H[:n, :n], np.column_stack([H[:n, n:], r[:n]]), rcond=1e-12)[0]
            normal += H[n:, n:] - H[n:, :n] @ gain[:, :-1]
            right += r[n:] - H[n:, :n] @ gain[:, -1]
        return normal, right


def _displaced(robot: Robot, run: Samples) -> Iterator[Samples]:
    """A run with its samples displaced by STEP, in the order of displacement_std(): attitude about the three axes of P,
    target along them, the tracker's world about the vertical, delays of forces, attitude and position."""
    mount = mounting(robot)
    R = run.R @ mount.T
    for axis in np.eye(3):
        yield replace(run, R=R @ Rotation.from_rotvec(STEP * axis).as_matrix() @ mount)
    for axis in np.eye(3):
        yield replace(run, position=run.position + STEP * R @ axis)
    yield replace(run, position=run.position @ about_z(STEP).T)
    yield replace(run, f=earlier(run.t, run.f, STEP))
    yield replace(run, R=run.R @ Rotation.from_rotvec(STEP * run.gyro).as_matrix())
    yield replace(run, position=earlier(run.t, run.position, STEP))


def displacement_std(robot: Robot) -> Array:
    """Standard deviations of _displaced(), by robot.toml, where that is not better than sensors are."""
    std = robot.std
    target = float(np.hypot(max(std.tracker_target, 1e-3), max(std.geometry, 1e-3)))
    attitude, yaw = max(std.attitude, 0.01), max(std.world_yaw, 1e-3)
    delays = [max(d, 2e-3) for d in (std.force_delay, std.attitude_delay, std.position_delay)]
    return np.array([*3 * [attitude], *3 * [target], yaw, *delays])


def _samples(run: Recording, n_max: int) -> Samples:
    """Every so many samples of a run, averaged over the step, at most n_max of them."""
    rows = run.rows
    step = max(1, round(PERIOD / float(np.median(np.diff(rows.t)))))
    n = min(len(rows) // step, n_max)

    def mean(x: Array) -> Array:
        return np.asarray(x[: n * step].reshape(n, step, -1).mean(axis=1))

    middle = np.arange(n) * step + step // 2
    t = mean(rows.t)[:, 0]
    turn = Rotation.from_rotvec((t - rows.t[middle])[:, None] * rows.gyro[middle])
    R = (Rotation.from_quat(rows.q[middle], scalar_first=True) * turn).as_matrix()
    return Samples(t, mean(rows.acc), mean(rows.gyro), R, mean(rows.position), mean(rows.f))


NOTHING: Final = Mistake("none", "", lambda case, _: case)


def explain(judge: Judge) -> list[Fitted]:
    """All mistakes that were fitted and the runs as they are (NOTHING), the best first; empty: no fit is possible."""
    tried = table(judge.case.robot)
    found = [judge.fit(NOTHING)]
    if not found[0].laws:
        return []
    if found[0].rms > GROSS * judge.weight:
        found += [judge.fit(c) for c in judge.best_by_law([c for c in tried if not c.steps])]
    free, laws = [c for c in tried if c.steps], found[0].laws
    expected = [(judge.expected(c, laws), i) for i, c in enumerate(free)]
    found += [judge.fit(free[i]) for _, i in sorted(expected, reverse=True)[:FITTED]]
    found = [f for f in found if f.laws]
    best = min(found, key=lambda f: f.cost)
    equations = [law.independent(width) for law, width in zip(best.laws, (6, 3, 3), strict=True)]
    return sorted((replace(f, cost=f.cost_with(equations)) for f in found), key=lambda f: f.cost)


def _joint_cost(robot: Robot, recordings: list[Recording]) -> float:
    """Chi squared of the joint fit of body and all sensor errors, their priors included; inf: there is none."""
    config = reader.config_of(robot, robot.name)
    rows = [run.rows for run in recordings]
    try:
        found = inertiad_core.batch(
            config, rows, [0] * len(rows), [0.0], theta_prior=WEAK_PRIOR, is_weight_learnt=False
        )
    except (ValueError, RuntimeError):  # nothing to solve, or no body
        return np.inf
    std, xi = np.array(inertiad_core.systematic_std(config)), np.array(found["xi"])
    chi2 = sum(fit["n_windows"] * float(((fit["rms"] / fit["noise_std"]) ** 2).sum()) for fit in found["fit"])
    return chi2 + float(((xi[std > 0.0] / std[std > 0.0]) ** 2).sum())


def refined(best: Fitted, case: Case, recordings: list[Recording]) -> Array:
    """The number of a mistake of the robot's geometry where the joint fit's cost, a parabola in it, is least."""
    if len(best.numbers) != 1 or best.mistake.apply(case, best.numbers).runs is not case.runs:
        return best.numbers
    x = float(best.numbers[0])
    tried = x + REFINED * abs(x) * np.array([-1.0, 0.0, 1.0])
    cost = [_joint_cost(best.mistake.apply(case, np.array([t])).robot, recordings) for t in tried]
    square, slope, _ = np.polyfit(tried, cost, 2) if np.isfinite(cost).all() else (0.0, 0.0, 0.0)
    return best.numbers if square <= 0.0 else np.clip([-0.5 * slope / square], 2.0 * tried[0] - x, 2.0 * tried[2] - x)


def _is_mistake(fitted: Fitted) -> bool:
    """Is it more than what robot.toml declares?"""
    mistake = fitted.mistake
    return not mistake.steps or bool(np.abs(fitted.numbers).max() > DECLARED * mistake.std)


def _fall(now: Fitted, best: Fitted) -> float:
    """Times that the residual of the law that falls most is larger as the runs are."""
    return max(a.solved[1] / b.solved[1] for a, b in zip(now.laws, best.laws, strict=True))


def _is_enough(recordings: list[Recording]) -> bool:
    """Samples of every sensor, and more windows than unknowns."""
    if any(run.rows.derives_force or run.rows.derives_rate or len(run.rows) < 2 for run in recordings):
        return False
    return sum(run.duration for run in recordings) > WINDOWS_MIN * WINDOW / 2.0


def find(robot: Robot, recordings: list[Recording]) -> list[Finding]:
    """The mistake that explains the runs, with a rival if that is as likely; empty: no mistake does."""
    if not _is_enough(recordings):
        return []
    judge = Judge(robot, recordings)
    found = explain(judge)
    if not found:
        return []
    now = next(f for f in found if f.mistake is NOTHING)
    best = found[0]
    if now.cost - best.cost < SURE[_fall(now, best) < FALLS] or not _is_mistake(best):
        return []
    numbers = refined(best, judge.case, recordings)
    falls = f": residual falls from {now.rms:.3g} N to {best.rms:.3g} N"
    rivals = [f for f in found if f.mistake.kind not in ("none", best.mistake.kind)]
    rival = min(rivals, key=lambda f: f.cost, default=now)
    doubt = f"; or {rival.mistake.says(rival.numbers)}" if rival.cost - best.cost < RIVAL else ""
    evidence = {"cost_fall": now.cost - best.cost, "rival": rival.mistake.kind, "rival_cost": rival.cost - best.cost}
    evidence |= {"residual_N": float(now.rms), "residual_without_N": float(best.rms), "numbers": numbers.tolist()}
    evidence["residual_least_N"] = best.least
    is_mild = best.mistake.severity == "care"
    says = best.mistake.says(numbers) + falls + doubt
    return [Finding(best.mistake.kind, "care" if is_mild else "stop", says, MILD if is_mild else CORRECT, evidence)]
