# SPDX-License-Identifier: Apache-2.0
"""Consistency of the force sensors: is there one that disagrees with the others?

    y = [Y, -X] z + e    of every window, z = theta and the systematic parameters, priors from robot.toml
Two looks at it. Residual per cable: the smallest change of tensions that explains e, W^+ e. Trial without cable i: its
force is unknown in every window, so each window's equations are projected on what W_i cannot reach; a sensor is broken
where that makes most of the residual vanish, for it alone. Offsets and gains that calibration explains do not count.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

import inertiad_core
from inertiad.base.body import Body
from inertiad.base.table import Array
from inertiad.identify.fisher_information import Model
from inertiad.identify.fit import Estimate
from inertiad.model import window_residual
from inertiad.model.window_residual import Residual, wrench_matrices
from inertiad.robot.configuration import platform_size, prior
from inertiad.run.reader import Recording

BROKEN_BELOW: Final = 0.7
"""residual without the sensor, of the residual with it"""
ALONE_BELOW: Final = 0.75
"""and of what leaving out any other leaves"""


@dataclass(frozen=True)
class ForceCheck:
    """Agreement of the force sensors over M windows of all runs."""

    rms: Array
    """N [m]: residual as tension of each cable"""
    without: Array
    """N [m]: residual wrench, moments over the platform's size, when this cable's force is taken as unknown"""
    everything: float
    """N: the same with all sensors"""
    broken: int | None
    """index of the sensor that does not fit"""
    body: Body | None = None
    """the estimate without it"""
    t: Array | None = None
    """s [M], one run after the other"""
    error: Array | None = None
    """N [M]: by how much it reads too much, from all others"""

    @property
    def worst(self) -> int:
        """Index of the cable to look at first."""
        return int(np.argmax(self.rms)) if self.broken is None else self.broken


def residual(config: Any, estimate: Estimate, run: Recording) -> Residual:
    """Of one run's windows, with the calibration that was estimated along."""
    theta = inertiad_core.shift(estimate.theta, -np.array(run.robot.imu.position))
    return window_residual.residual(config, run.rows, theta, estimate.xi, run.robot.n_cables)


@dataclass(frozen=True)
class _Equations:
    """Whitened windows of all runs."""

    H: Array
    """[M, 6, n]"""
    y: Array
    """[M, 6]"""
    W: Array
    """[M, 6, m]"""
    t: Array
    """s [M], one run after the other"""
    information: Array
    """[n, n] prior's"""
    mean: Array
    """[n] prior's"""

    def solve(self, v: Array | None) -> tuple[Array, Array, Array]:
        """z [n], its covariance, residuals [M, 6]; v: unit directions [M, 6] nothing is known of."""
        H, y = self.H, self.y
        if v is not None:
            H = H - v[:, :, None] * np.einsum("ki,kij->kj", v, H)[:, None, :]
            y = y - v * np.einsum("ki,ki->k", v, y)[:, None]
        rows = H.reshape(-1, H.shape[2])
        covariance = np.asarray(np.linalg.inv(rows.T @ rows + self.information), dtype=np.float64)
        z = covariance @ (rows.T @ y.ravel() + self.information @ self.mean)
        return z, covariance, y - H @ z


def _equations(model: Model, noise: Array, theta: Array, recordings: list[Recording]) -> _Equations:
    m, n_x = model.robot.n_cables, len(model.prior_information)
    H, y, W, t, elapsed = [], [], [], [], 0.0
    for run in recordings:
        windows = inertiad_core.Windows(model.config, run.rows)
        X = windows.X(theta)[:, :, : n_x - 10]
        H.append(np.concatenate([windows.Y, -X], axis=2) / noise[:, None])
        y.append(windows.y / noise)
        W.append(wrench_matrices(windows, m) / noise[:, None])
        t.append(elapsed + windows.t)
        elapsed += run.duration
    mean = np.zeros(n_x)
    mean[:10] = inertiad_core.shift(prior(model.robot)[0], np.array(model.robot.imu.position))
    stacked, known, wrench, times = (np.concatenate(parts) for parts in (H, y, W, t))
    return _Equations(stacked, known, wrench, times, model.prior_information, mean)


def _body(model: Model, z: Array, covariance: Array) -> Body | None:
    """The body of states about the IMU."""
    back = -np.array(model.robot.imu.position)
    T = np.column_stack([inertiad_core.shift(column, back) for column in np.eye(10)])
    try:
        d = inertiad_core.body(T @ z[:10], T @ covariance[:10, :10] @ T.T)
    except ValueError:
        return None
    return Body((d["mass"], *d["cog"], *d["inertia_cog"]), (d["mass_std"], *d["cog_std"], *d["inertia_cog_std"]))


def _rms(e: Array, noise: Array, size: float, n_equations: int) -> float:
    """N, of whitened residuals [M, 6] with so many equations a window."""
    scaled = e * noise / np.repeat([1.0, size], 3)
    return float(np.sqrt(np.sum(scaled**2) / (len(e) * n_equations / 6.0)))


def _without(equations: _Equations, cable: int) -> tuple[Array, Array, Array]:
    """solve() when a cable's force is unknown."""
    W_i = equations.W[:, :, cable]
    return equations.solve(W_i / np.linalg.norm(W_i, axis=1, keepdims=True))


def _found(model: Model, equations: _Equations, cable: int) -> tuple[Body | None, Array, Array]:
    """Estimate from all other sensors: the body and, over time, this sensor's error."""
    z, covariance, _ = _without(equations, cable)
    W_i = equations.W[:, :, cable]
    error = np.einsum("ki,ki->k", W_i, equations.y - equations.H @ z) / np.sum(W_i**2, axis=1)
    return _body(model, z, covariance), equations.t, error


def _broken(without: Array, everything: float) -> int | None:
    """The one sensor without which most of the residual is gone."""
    best, *others = np.argsort(without)
    if not others or without[best] > BROKEN_BELOW * everything or without[best] > ALONE_BELOW * without[others[0]]:
        return None
    return int(best)


def check(model: Model, estimate: Estimate, noise: Array, recordings: list[Recording], tension: Array) -> ForceCheck:
    """Compare the force sensors. noise: one sigma [6] of the windows; tension: residual tensions [M, m] of all runs."""
    size, m = platform_size(model.robot), model.robot.n_cables
    theta = inertiad_core.shift(estimate.theta, -np.array(model.robot.imu.position))
    equations = _equations(model, noise, theta, recordings)
    e = equations.solve(None)[2]
    everything = _rms(e, noise, size, 6)
    without = np.array([_rms(_without(equations, i)[2], noise, size, 5) for i in range(m)])
    rms = np.sqrt(np.mean(tension**2, axis=0))
    broken = _broken(without, everything)
    if broken is None:
        return ForceCheck(rms, without, everything, None)
    unexplained = float(np.sqrt(np.mean(e**2)))
    cleaner = _equations(model, noise * max(1.0, unexplained) * without[broken] / everything, theta, recordings)
    body, t, error = _found(model, cleaner, broken)
    is_left_out = unexplained > 1.0  # more than the fit's noise: it went on without the failed sensor, and better
    return ForceCheck(rms, without, everything, broken, estimate.body if is_left_out else body, t, error)
