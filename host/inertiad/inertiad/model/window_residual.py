# SPDX-License-Identifier: Apache-2.0
"""What a body and its sensors' systematic errors leave unexplained of a run's windows, as wrench and as tensions.

e = y - Y theta       of every window of the weak form, sensors corrected by xi
W^+ e                 the smallest change of the cables' tensions that explains e
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

import inertiad_core
from inertiad.base.table import Array
from inertiad.robot import systematic


@dataclass(frozen=True)
class Residual:
    """Residuals of one run under an estimate."""

    t: Array
    """s since the first window [M]"""
    wrench: Array
    """N, N m [M, 6], P axes about the IMU"""
    tension: Array
    """N [M, m]"""


def wrench_matrices(windows: Any, n_cables: int) -> Array:
    """W [M, 6, m] about the IMU: an offset of a force sensor is a force too much."""
    X = windows.X(np.zeros(10))
    return np.asarray(-X[:, :, systematic.group("force_offset", n_cables).part])


def residual(config: Any, rows: Any, theta: Array, xi: Array | None, n_cables: int) -> Residual:
    """Of the windows of inertiad_core.Rows under theta [10] about the IMU, and xi, if any, as corrections to config."""
    if xi is not None:
        delays = (systematic.group(name, n_cables).first for name in ("position_delay", "force_delay"))
        rows = inertiad_core.undelayed(rows, *(xi[i] for i in delays))
        config = inertiad_core.calibrated(config, xi)
    windows = inertiad_core.Windows(config, rows)
    e = windows.y - windows.Y @ theta
    W = wrench_matrices(windows, n_cables)
    return Residual(windows.t, e, np.einsum("kij,kj->ki", np.linalg.pinv(W), e))
