# SPDX-License-Identifier: Apache-2.0
"""Sigma under misfit, and stretches of data that disagree, from the information that each stretch of a run contributes.

The batch solver leaves, per block b of about a second, H_b = A^T A and g_b = A^T b of its whitened rows at the
solution, and H_0 of all priors. Everything here follows from these by one Newton step, so no run is read again:

    leave block b out     (H - H_b) d_b = -g_b
    jackknife             S = (B - 1)/B sum_b (d_b - mean d)(d_b - mean d)^T + H^-1 H_0 H^-1
    another value after a block, or in each run: the fall of the cost with a second copy of these unknowns

Blocks are joined until they last four correlation times of the residuals (their long-run variance over their variance,
in windows' steps, is two correlation times of a first-order process; such blocks show three quarters of its variance).
Source of the jackknife: Efron, Stein, Annals of Statistics 9(3), 1981; of its use on correlated data: Kuensch,
Annals of Statistics 17(3), 1989.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import stdtrit

import inertiad_core
from inertiad.base.table import Array
from inertiad.robot.description import Robot

Indices = NDArray[np.intp]

LONG: Final = 2.0
"""blocks over the correlation time as the solver gives it, which is twice that of a first-order process"""
BLOCKS_MIN: Final = 6
"""fewer say little about the spread between them"""
SURE: Final = 1.96
LEVEL: Final = 0.975


@dataclass(frozen=True)
class Blocks:
    """Stretches of all runs, joined to the length that makes them independent; unknowns in prior sigmas."""

    run: Indices
    begin: Array
    end: Array
    """s since the run's first row"""
    H: Array
    """[B, n, n]"""
    g: Array
    """[B, n]"""
    prior: Array
    """[n, n]"""

    @property
    def total(self) -> Array:
        return np.asarray(self.H.sum(axis=0) + self.prior)

    @property
    def prior_gradient(self) -> Array:
        """Of the priors at the solution, where all gradients sum to zero."""
        return np.asarray(-self.g.sum(axis=0))

    def __len__(self) -> int:
        return len(self.run)


def _join(parts: list[dict[str, Any]]) -> dict[str, Any]:
    whole = dict(parts[0])
    whole["end"], whole["H"] = parts[-1]["end"], sum(p["H"] for p in parts)
    whole["g"] = sum(p["g"] for p in parts)
    return whole


def blocks(result: dict[str, Any], length: float | None = None) -> Blocks:
    """Blocks of a batch result of at least length [s]; default: four correlation times of each run's residuals."""
    found: list[dict[str, Any]] = []
    for r, fit in enumerate(result["fit"]):
        least = LONG * fit["correlation_time"] if length is None else length
        waiting: list[dict[str, Any]] = []
        first = len(found)
        own = [b for b in result["blocks"] if b["run"] == r]
        for block, after in zip(own, [*own[1:], None], strict=True):
            waiting.append(block)
            until = block["end"] if after is None else after["begin"]
            if until - waiting[0]["begin"] >= least or (after is None and not found[first:]):
                found.append(_join(waiting))
                waiting = []
        if waiting and len(found) > first:
            found[-1] = _join([found[-1], *waiting])
    n = len(result["prior_std"])
    return Blocks(
        np.array([b["run"] for b in found], dtype=np.intp),
        np.array([b["begin"] for b in found]),
        np.array([b["end"] for b in found]),
        np.array([b["H"] for b in found]).reshape(-1, n, n),
        np.array([b["g"] for b in found]).reshape(-1, n),
        np.array(result["prior_information"]),
    )


def jackknife(of: Blocks) -> Array:
    """Covariance [n, n] of the solution, from the change when each block is left out and from the priors."""
    total, n = of.total, len(of)
    K = np.linalg.inv(total)
    known = K @ of.prior @ K
    if n < 2:
        return np.asarray(K)
    change = np.array([np.linalg.solve(total - H, -g) for H, g in zip(of.H, of.g, strict=True)])
    change = change - change.mean(axis=0)
    return np.asarray((n - 1) / n * change.T @ change + known)


def by_body(robot: Robot, theta: Array) -> Array:
    """d(mass, CoG, inertia) / d(theta about the IMU) [10, 10]; theta about P."""
    back = -np.array(robot.imu.position)
    shift = np.column_stack([inertiad_core.shift(column, back) for column in np.eye(10)])
    return np.asarray(inertiad_core.body_jacobian(theta) @ shift)


@dataclass(frozen=True)
class Spread:
    """How much wider sigma is than the weights alone say."""

    body: list[Array]
    """by group: factor on each sigma of mass, CoG, inertia [10], at least 1"""
    unknown: Array
    """factor on each sigma of the unknowns [n]"""
    n_blocks: int
    length: float
    """s, median of the blocks"""


def _shorter(result: dict[str, Any], few: Blocks) -> tuple[Blocks, float]:
    """BLOCKS_MIN blocks or more, and the factor on their sigma; inf where the runs are too short for those as well."""
    duration = float((few.end - few.begin).sum())
    of = blocks(result, duration / (BLOCKS_MIN + 1))
    if len(of) < BLOCKS_MIN:
        return few, float(stdtrit(len(few) - 1, LEVEL)) / SURE if len(few) > 1 else np.inf
    wanted = LONG * max(fit["correlation_time"] for fit in result["fit"])
    share = max(wanted / float(np.median(of.end - of.begin)), 1.0)
    return of, float(stdtrit(len(of) - 1, LEVEL)) / SURE * float(np.sqrt(share))


def spread(robot: Robot, result: dict[str, Any]) -> Spread:
    """The jackknife's sigma over that of the weights, never below one.

    Where the residuals last too long for BLOCKS_MIN blocks, shorter ones stand in: wider by Student's t, and by the
    root of how much too short they are, since of a slow error they show no more than that share.
    """
    of, scale, n_groups = blocks(result), np.array(result["prior_std"]), len(result["body"])
    if len(of) == 0:
        return Spread([np.ones(10)] * n_groups, np.ones(len(scale)), 0, 0.0)
    n_blocks, length, few = len(of), float(np.median(of.end - of.begin)), 1.0
    if n_blocks < BLOCKS_MIN:
        of, few = _shorter(result, of)
    K, S = np.linalg.inv(of.total), jackknife(of)
    body = []
    for g in range(n_groups):
        part = slice(10 * g, 10 * g + 10)
        E = by_body(robot, np.array(result["body"][g]["theta_possible"])) * scale[part]
        ratio = np.sqrt(np.diag(E @ S[part, part] @ E.T) / np.diag(E @ K[part, part] @ E.T))
        body.append(few * np.maximum(ratio, 1.0))
    unknown = few * np.maximum(np.sqrt(np.diag(S) / np.diag(K)), 1.0)
    return Spread(body, unknown, n_blocks, length)


def standard_deviations(body: dict[str, Any]) -> Array:
    """Of mass, CoG, inertia [10] in a dict with mass_std, cog_std, inertia_cog_std."""
    return np.array([body["mass_std"], *body["cog_std"], *body["inertia_cog_std"]])


def widened(robot: Robot, result: dict[str, Any]) -> dict[str, Any]:
    """A batch result with the published sigma: the larger of the weights' and the jackknife's, at most the prior's."""
    found = spread(robot, result)
    scale = np.array(result["prior_std"])
    std = np.sqrt(np.diag(result["covariance"]))
    most = np.maximum(scale / std, 1.0)
    factor = np.minimum(found.unknown, most)
    bodies = []
    n_groups = len(result["body"])
    for g, (body, ratio) in enumerate(zip(result["body"], found.body, strict=True)):
        before = standard_deviations(body["prior"])
        ratio = np.minimum(ratio, np.maximum(before / standard_deviations(body), 1.0))
        E = np.asarray(inertiad_core.body_jacobian(np.array(body["theta_possible"])))
        turn = np.linalg.solve(E, ratio[:, None] * E)
        seen = [
            bool(s and 2.0 * k * now <= then)
            for s, k, now, then in zip(body["observable"], ratio, standard_deviations(body), before, strict=True)
        ]
        bodies.append({**body, "covariance": turn @ np.array(body["covariance"]) @ turn.T, "observable": seen})
        part = slice(10 * g, 10 * g + 10)
        factor[part] = 1.0
    T = np.diag(factor)
    for g, body in enumerate(result["body"]):
        part = slice(10 * g, 10 * g + 10)
        E = by_body(robot, np.array(body["theta_possible"]))
        ratio = np.minimum(
            found.body[g], np.maximum(standard_deviations(body["prior"]) / standard_deviations(body), 1.0)
        )
        T[part, part] = np.linalg.solve(E, ratio[:, None] * E)
    free = result["free"]
    xi_std = np.array(result["xi_std"])
    xi_std[free] *= factor[10 * n_groups : 10 * n_groups + len(free)]
    P = np.array(result["covariance"])
    return {**result, "body": bodies, "covariance": T @ P @ T.T, "xi_std": xi_std, "spread": found}


# ---- stretches that disagree -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Copies:
    """What another value of some unknowns in another part of the data explains."""

    fall: float
    """of the cost, chi squared under the weights"""
    size: int
    """unknowns that got another value"""
    step: Array
    """second value minus first [size], in prior sigmas"""


def _second_value(of: Blocks, later: NDArray[np.bool_], unknown: Indices) -> Copies:
    """Blocks later have another value of the unknowns."""
    n, k = of.prior.shape[0], len(unknown)
    H = np.zeros((n + k, n + k))
    g = np.zeros(n + k)
    own = np.arange(n)
    own[unknown] = n + np.arange(k)
    H[:n, :n] = of.prior + of.H[~later].sum(axis=0)
    g[:n] = of.prior_gradient + of.g[~later].sum(axis=0)
    H[np.ix_(own, own)] += of.H[later].sum(axis=0)
    g[own] += of.g[later].sum(axis=0)
    H[n:, n:] += of.prior[np.ix_(unknown, unknown)]
    g[n:] += of.prior_gradient[unknown]
    x = cho_solve(cho_factor(H), g)
    pull = of.prior_gradient[unknown]
    double = float(pull @ np.linalg.solve(of.prior[np.ix_(unknown, unknown)], pull))
    return Copies(float(g @ x) - double, k, x[n:] - x[unknown])


def is_significant(copies: Copies, n_tried: int, widening: float) -> bool:
    """More than chance, also where n_tried places were looked at: six sigma of chi squared and its logarithm.

    widening: spread of the residuals between blocks over what the weights say.
    """
    limit = copies.size + 6.0 * np.sqrt(2.0 * copies.size) + 2.0 * np.log(max(n_tried, 1)) + 10.0
    return bool(copies.fall > limit * widening**2)


@dataclass(frozen=True)
class Change:
    """The place in a run where another value of some unknowns explains most."""

    run: int
    at: float
    """s since the run's first row"""
    begin: float
    end: float
    """s: the blocks on either side; what changed did so between their middles"""
    kind: str
    copies: Copies
    is_significant: bool
    runner_up: str
    runner_up_fall: float


def change(of: Blocks, run: int, kinds: dict[str, Indices], widening: float) -> Change | None:
    """The best place for a change of one of the kinds of unknowns within a run; None: it is one block.

    A large change widens the residuals it is judged by and is not significant then: a fit of both stretches shows it.
    """
    inside = np.flatnonzero(of.run == run)
    best: dict[str, tuple[Copies, int]] = {}
    for k in range(1, len(inside)):
        later = np.zeros(len(of), dtype=bool)
        later[inside[k:]] = True
        for kind, unknown in kinds.items():
            if len(unknown) == 0:
                continue
            copies = _second_value(of, later, unknown)
            if kind not in best or copies.fall > best[kind][0].fall:
                best[kind] = (copies, k)
    if not best:
        return None
    order = sorted(best, key=lambda kind: best[kind][0].size - best[kind][0].fall)
    copies, k = best[order[0]]
    second = order[1] if len(order) > 1 else ""
    return Change(
        run,
        float(of.begin[inside[k]]),
        float(of.begin[inside[k - 1]]),
        float(of.end[inside[k]]),
        order[0],
        copies,
        is_significant(copies, len(inside) * len(kinds), widening),
        second,
        best[second][0].fall if second else 0.0,
    )


def other_in_run(of: Blocks, run: int, kinds: dict[str, Indices]) -> dict[str, Copies]:
    """By kind: what another value in one run than in all others explains."""
    return {kind: _second_value(of, of.run == run, unknown) for kind, unknown in kinds.items() if len(unknown)}
