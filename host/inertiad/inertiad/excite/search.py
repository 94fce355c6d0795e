# SPDX-License-Identifier: Apache-2.0
"""The search: an augmented Lagrangian around L-BFGS-B (scipy), from the best of many random Fourier series.

A result that is a little over a limit is drawn back towards the start pose until it is not.
"""

import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.pool import Pool
from typing import Any, Final

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


Step = Callable[[float, Array], None]
"""A function that a search calls now and then, with its share done and its coefficients."""
CHOOSING = 0.3
"""of a search's time: for the random series"""
EVERY = 4
"""iterations between reports"""


def _improve(problem: Problem, c: Array, step: Step) -> Array:
    """Augmented Lagrangian around L-BFGS-B."""
    shape, rho = c.shape, 10.0
    multiplier = np.zeros_like(problem.evaluate(c)[1])
    n_done = 0

    def count(x: Array) -> None:
        nonlocal n_done
        n_done += 1
        if n_done % EVERY == 0:
            step(CHOOSING + (1.0 - CHOOSING) * n_done / (ROUNDS * ITERATIONS), x.reshape(shape))

    def both(x: Array) -> tuple[float, Array]:
        try:
            value, gradient = problem.lagrangian(x.reshape(shape), multiplier, rho)
        except (ValueError, InputError):
            return 1e6, np.zeros(x.size)
        return value, gradient.ravel()

    for number in range(ROUNDS):
        n_done = number * ITERATIONS
        options = {"maxiter": ITERATIONS}
        found = minimize(both, c.ravel(), jac=True, method="L-BFGS-B", options=options, callback=count)
        c = found.x.reshape(shape)
        multiplier = np.maximum(multiplier + rho * problem.evaluate(c)[1], 0.0)
        rho *= 3.0
    return c


def search(problem: Problem, seed: int, index: int, step: Step = lambda share, c: None) -> tuple[float, Array]:
    """One start: the best of some random series, improved, within every limit. Same seed and index, same result."""
    dice = np.random.default_rng([seed, index])
    series = []
    for number in range(CANDIDATES):
        series.append(random_series(problem, dice))
        if (number + 1) % EVERY == 0:
            step(CHOOSING * (number + 1) / CANDIDATES, series[-1])
    best = min(series, key=lambda c: problem.evaluate(c)[0])
    found = largest(problem, np.zeros_like(best), _improve(problem, best, step))
    result = min(((problem.evaluate(c)[0], c) for c in (best, found)), key=lambda pair: pair[0])
    step(1.0, result[1])
    return result


PROCESSES: Final = 2

_reports: Any = None
"""of a searching process: the queue to the one that waits; None in it: a process has begun"""


def _begin(reports: Any) -> None:
    global _reports
    _reports = reports
    reports.put(None)


def _search(problem: Problem, seed: int, index: int) -> tuple[float, Array]:
    return search(problem, seed, index, lambda share, c: _reports.put((index, share, problem.sigma(c))))


def search_all(problem: Problem, n_starts: int, seed: int, progress: Progress) -> Array:
    """The best of n_starts searches [n, 6], on two processes, which end at once where this one is interrupted."""
    context = multiprocessing.get_context("spawn")
    reports = context.Queue()
    with _one_thread_each(), _deaf_to_interrupts():
        pool = context.Pool(PROCESSES, _begin, (reports,))
    with pool:
        results = _all_of(pool, problem, n_starts, seed, reports, progress)
    return min(results, key=lambda result: result[0])[1]


def _all_of(
    pool: Pool, problem: Problem, n_starts: int, seed: int, reports: Any, progress: Progress
) -> list[tuple[float, Array]]:
    """The results of all searches. InputError: a searching process was killed; the pool puts another in its place, but
    the search that it had is lost."""
    pending = [pool.apply_async(_search, (problem, seed, index)) for index in range(n_starts)]
    n_begun, shares, best = 0, np.zeros(n_starts), None
    progress("plan: start the search")
    while not all(one.ready() for one in pending):
        try:
            report = reports.get(timeout=0.2)
        except queue.Empty:
            continue
        if report is None:
            n_begun += 1
            if n_begun > PROCESSES:
                raise InputError("excite: a searching process was killed; is memory short? Try --starts 1")
            continue
        index, shares[index], sigma = report
        if best is None or np.sum((sigma / problem.goal.scale) ** 2) < np.sum((best / problem.goal.scale) ** 2):
            best = sigma
        progress(_bar(float(shares.mean()), best))
    return [one.get() for one in pending]


def _bar(share: float, sigma: Array) -> str:
    """The share done as a bar, and the least sigma so far."""
    full = round(20 * min(share, 1.0))
    cog, inertia = 1e3 * float(sigma[1:4].max()), float(sigma[4:].max())
    found = f"best so far: mass {sigma[0]:.2g} kg, CoG {cog:.2g} mm, inertia {inertia:.2g} kg m2"
    return f"plan {'#' * full}{'.' * (20 - full)} {min(share, 1.0):4.0%}, {found}"


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Child processes started inside leave Ctrl-C to this one. Only the main thread can arrange it."""
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Child processes started inside leave the other core to each other."""
    before = os.environ.get("OPENBLAS_NUM_THREADS")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        os.environ.pop("OPENBLAS_NUM_THREADS")
        if before is not None:
            os.environ["OPENBLAS_NUM_THREADS"] = before
