# SPDX-License-Identifier: Apache-2.0
"""The offset between two recorders' clocks, and the vertical of one of them, from the motion that both recorded.

An accelerometer measures |a + g up| of its place, whatever its attitude; the second derivative of a tracked position
near it, with g up added, has about the same length. Their normalised correlation over all offsets peaks at the right
one (masked, so that both may have gaps and overlap in part: Padfield, IEEE Trans. Image Processing 21, 2012). The
distance between the two places and the platform's turning blur it; inertiactl sync estimates the rest of the delay.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import savgol_filter

from inertiad.base import units
from inertiad.base.table import Array

GRID_HZ: Final = 100.0
"""Hz: several samples within the fastest motion of a platform"""
SMOOTH: Final = 0.25
"""s: length of the polynomials that differentiate positions; 0.5 mm of noise at 100 Hz stay below 0.1 m/s2"""
GAP: Final = 0.1
"""s: samples further apart are a gap"""
OVERLAP_LEAST: Final = 5.0
"""s that both have in common at least, also for short recordings whose ends look alike"""
OVERLAP_SHARE: Final = 0.3
"""of the shorter recording, that both have in common at least"""
CORRELATION_LEAST: Final = 0.6
"""below, the two have hardly moved together; unrelated motions of half a minute reach 0.4"""
RIVAL_AWAY: Final = 0.3
"""s: a peak further away than this is another one"""
RIVAL_MOST: Final = 0.95
"""of the best correlation: a second peak above makes the offset ambiguous, as in periodic motions"""
GRID_MAX: Final = 4_000_000
"""samples of a recording on the grid, 11 hours: longer ones would need gigabytes"""


@dataclass(frozen=True)
class Offset:
    """Where a position's clock begins."""

    start: float
    """s: time of the accelerometer at which the position's time is 0"""
    correlation: float
    up: str
    """axis of the positions that points up: "y" or "z" """
    is_ambiguous: bool
    """another start explains the motion almost as well"""


class NoOffset(Exception):
    """The two recordings have no motion in common."""


def find(t_acc: Array, acc: Array, t: Array, position: Array) -> Offset:
    """Offset of positions [N, 3], m, at t [N] against specific forces acc [M, 3], m/s2, at t_acc [M], s.

    NoOffset: too short or too long, or nothing in common.
    """
    size, is_there = _on_grid(t_acc, np.linalg.norm(acc, axis=1)[:, None])
    size = savgol_filter(size[:, 0], _odd(SMOOTH), 3)
    place, is_seen = _on_grid(t, position)
    bend = savgol_filter(place, _odd(SMOOTH), 3, deriv=2, delta=1.0 / GRID_HZ, axis=0)
    found = [_best(size, is_there, np.linalg.norm(bend + units.G * up, axis=1), is_seen) for up in np.eye(3)[1:]]
    best = max(range(2), key=lambda k: found[k][1])
    lag, correlation, is_ambiguous = found[best]
    if correlation < CORRELATION_LEAST:
        raise NoOffset(f"positions and accelerations correlate with {correlation:.2f} at best")
    return Offset(lag / GRID_HZ + float(t_acc[0] - t[0]), correlation, "yz"[best], is_ambiguous)


def _odd(seconds: float) -> int:
    return 2 * round(0.5 * seconds * GRID_HZ) + 1


def _on_grid(t: Array, value: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Values [K, n] on the grid from t[0] on, and whether each is far enough from a gap to be smoothed."""
    if len(t) < 2 or (t[-1] - t[0]) * GRID_HZ > GRID_MAX or t[-1] - t[0] < OVERLAP_LEAST:
        raise NoOffset(f"recordings from {OVERLAP_LEAST:g} s to {GRID_MAX / GRID_HZ / 3600.0:.0f} h are compared")
    grid = np.arange(0.0, t[-1] - t[0], 1.0 / GRID_HZ)
    found = np.column_stack([np.interp(grid, t - t[0], column) for column in value.T])
    is_there = np.ones(len(grid), np.bool_)
    for k in np.flatnonzero(np.diff(t) > GAP):
        is_there[(grid > t[k] - t[0] - SMOOTH) & (grid < t[k + 1] - t[0] + SMOOTH)] = False
    edge = _odd(SMOOTH)
    is_there[:edge] = is_there[-edge:] = False
    return found, is_there


def _best(a: Array, a_there: NDArray[np.bool_], b: Array, b_there: NDArray[np.bool_]) -> tuple[float, float, bool]:
    """Lag of b against a in samples, correlation there, and whether another lag is nearly as good."""
    correlation = _correlation(a, a_there, b, b_there)
    k = int(np.argmax(correlation))
    peak = float(correlation[k])
    away = np.abs(np.arange(len(correlation)) - k) > RIVAL_AWAY * GRID_HZ
    is_ambiguous = bool((correlation[away] > RIVAL_MOST * peak).any())
    shift = 0.0
    if 0 < k < len(correlation) - 1:
        left, right = float(correlation[k - 1]), float(correlation[k + 1])
        bend = left - 2.0 * peak + right
        shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return k - (len(b) - 1) + float(np.clip(shift, -0.5, 0.5)), peak, is_ambiguous


def _centred(x: Array, is_there: NDArray[np.bool_]) -> Array:
    """x about its mean, 0 where it is not there."""
    return np.where(is_there, x - (x[is_there].mean() if is_there.any() else 0.0), 0.0)


def _correlation(a: Array, a_there: NDArray[np.bool_], b: Array, b_there: NDArray[np.bool_]) -> Array:
    """Normalised correlation of a[k + lag] with b[k], lags from 1 - len(b) to len(a) - 1; -1: too little in common."""
    n = next_fast_len(len(a) + len(b), real=True)
    ma, mb = a_there.astype(float), b_there.astype(float)
    a, b = _centred(a, a_there), _centred(b, b_there)

    def cross(x: Array, y: Array) -> Array:
        whole = irfft(rfft(x, n) * np.conj(rfft(y, n)), n)
        return np.concatenate([whole[n - len(b) + 1 :], whole[: len(a)]])

    both = np.rint(cross(ma, mb))
    least = max(OVERLAP_LEAST, OVERLAP_SHARE * min(a_there.sum(), b_there.sum()) / GRID_HZ) * GRID_HZ
    is_enough = both >= least
    count = np.where(is_enough, both, 1.0)
    sum_a, sum_b = cross(a, mb), cross(ma, b)
    joint = cross(a, b) - sum_a * sum_b / count
    spread_a, spread_b = cross(a * a, mb) - sum_a**2 / count, cross(ma, b * b) - sum_b**2 / count
    scale = np.sqrt(np.clip(spread_a, 0.0, None) * np.clip(spread_b, 0.0, None))
    floor = 1e-9 * max(float((a * a).sum()), 1e-300) ** 0.5 * max(float((b * b).sum()), 1e-300) ** 0.5
    return np.where(is_enough & (scale > floor), joint / np.maximum(scale, floor), -1.0)
