# SPDX-License-Identifier: Apache-2.0
"""The optimisation problem: cost and constraints of the spline's coefficients, with gradients.

Gradients: dS/dH in closed form, dH and the limits by differences over the 18 pose values of an instant, all instants at
once, so their cost does not depend on the number of coefficients.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import BSpline

from inertiad.base.table import Array
from inertiad.excite.constraints import Checker
from inertiad.identify.fisher_information import Model
from inertiad.model.trajectory import Motion, motion_of

Criterion = Literal["A", "D"]

REST = 0.5
"""s of rest before and after a motion"""
SPACING = 0.75
"""s between knots: nothing above about 0.6 Hz"""
HOP = 0.2
"""s between the instants at which a motion is judged while it is searched"""
STEP = 1e-5
"""m, rad and their derivatives, of differences"""


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
class Goal:
    """Weights of the criterion."""

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

    def sigma(self, c: Array) -> Array:
        """Predicted sigma [10] of mass, CoG, inertia for coefficients c, before systematic errors are rehearsed."""
        model = self.checker.model
        _, motion, f = self.checker.excess(*self.coordinates(c))
        P = np.linalg.inv(model.information(model.instants(motion, f), self.basis.weight))
        return np.asarray(np.sqrt(np.diag(model.E @ P @ model.E.T)))

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
