# SPDX-License-Identifier: Apache-2.0
"""Windows with a smooth kernel, which take the derivative of a signal by parts."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from inertiad.base.table import Array

WINDOW: Final = 0.5
"""s"""


@dataclass(frozen=True)
class Windows:
    """Windows of one run: index of their rows [windows, n], kernel and its derivatives [n], 1, 1/s and 1/s^2."""

    rows: Array
    k: Array
    slope: Array
    curvature: Array

    def mean(self, weight: Array, x: Array) -> Array:
        """Of the run's samples x [N, ...], weighed [n] over each window: [windows, ...]."""
        return np.einsum("k,wk...->w...", weight, x[self.rows])


def windows(t: Array) -> Windows:
    """Windows of half overlap, none across a gap. k = (1 + cos)^2/1.5 over WINDOW: its slope ends at 0."""
    dt = float(np.median(np.diff(t)))
    n = max(8, round(WINDOW / dt))
    first = np.arange(0, len(t) - n + 1, max(1, n // 2))
    rows = first[:, None] + np.arange(n)
    whole = np.diff(t[rows], axis=1).max(axis=1) < 1.8 * dt if len(rows) else np.zeros(0, bool)
    x = 2.0 * np.pi * (np.arange(n) + 0.5) / n - np.pi
    k = (1.0 + np.cos(x)) ** 2
    rate = 2.0 * np.pi / (n * dt)
    slope = -2.0 * (1.0 + np.cos(x)) * np.sin(x) * rate
    curvature = 2.0 * (np.sin(x) ** 2 - (1.0 + np.cos(x)) * np.cos(x)) * rate**2
    return Windows(rows[whole], k / k.sum(), slope / k.sum(), curvature / k.sum())
