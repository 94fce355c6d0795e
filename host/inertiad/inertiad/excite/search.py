# SPDX-License-Identifier: Apache-2.0
"""The search: an augmented Lagrangian around L-BFGS-B (scipy), from the best of many random Fourier series.

A result that is a little over a limit is drawn back towards the start pose until it is not.
"""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.optimize import minimize

from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.excite.problem import Problem

Progress = Callable[[str], None]

CANDIDATES = 24
"""random series a start chooses from"""
ROUNDS, ITERATIONS = 4, 22
"""of the augmented Lagrangian, and of L-BFGS-B in each"""


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
    return largest(problem, still, shape * reach)


def _within(problem: Problem, c: Array, tolerance: float = 0.0) -> bool:
    try:
        return bool(problem.checker.excess(*problem.coordinates(c))[0].max() <= tolerance)
    except (ValueError, InputError):
        return False


def largest(problem: Problem, inner: Array, outer: Array) -> Array:
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
    found = largest(problem, np.zeros_like(best), _improve(problem, best))
    return min(((problem.evaluate(c)[0], c) for c in (best, found)), key=lambda pair: pair[0])


def search_all(problem: Problem, n_starts: int, seed: int, progress: Progress) -> Array:
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
