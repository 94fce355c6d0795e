# SPDX-License-Identifier: Apache-2.0
"""Sigma from the spread between blocks holds the truth, also where the errors last nearly as long as the record."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inertiad.identify import block_statistics
from inertiad.robot import description

TOP = Path(__file__).resolve().parents[2]
ROBOT = description.load(TOP / "firmware/robots/cogiro/robot.toml")
N_BLOCKS, N_UNKNOWN = 24, 10
THETA = np.array([161.058, -0.161, -12.4, -19.0, 98.2, 91.1, 32.6, 2.7, -0.1, -0.4])


def _errors(correlation_time: float, seed: int) -> np.ndarray:
    """First-order process of unit variance, a value per second and unknown; its long-run variance is that time."""
    dice, keep = np.random.default_rng(seed), max((correlation_time - 1.0) / (correlation_time + 1.0), 0.0)
    x = dice.standard_normal((N_BLOCKS, N_UNKNOWN))
    for k in range(1, N_BLOCKS):
        x[k] = keep * x[k - 1] + np.sqrt(1.0 - keep**2) * x[k]
    return x


def _result(gradient: np.ndarray, correlation_time: float) -> dict[str, Any]:
    """As of the batch solver, whose weights take the errors for white ones."""
    blocks = [
        {"run": 0, "begin": float(k), "end": k + 0.9, "H": np.eye(N_UNKNOWN), "g": g} for k, g in enumerate(gradient)
    ]
    return {
        "fit": [{"correlation_time": correlation_time}],
        "blocks": blocks,
        "prior_std": np.ones(N_UNKNOWN),
        "prior_information": 1e-9 * np.eye(N_UNKNOWN),
        "body": [{"theta_possible": THETA}],
    }


@pytest.mark.parametrize("correlation_time", [0.5, 3.0, 6.0, 12.0])
def test_sigma_holds_the_truth_where_errors_last(correlation_time: float) -> None:
    n_inside, factors = 0, []
    for seed in range(60):
        x = _errors(correlation_time, seed)
        error = x.mean(axis=0)
        found = block_statistics.spread(ROBOT, _result(x - error, correlation_time))
        n_inside += int((np.abs(error) <= 1.96 * found.unknown / np.sqrt(N_BLOCKS)).sum())
        factors.append(np.median(found.unknown))
    assert n_inside >= 0.93 * 60 * N_UNKNOWN
    honest = np.sqrt(max(correlation_time, 1.0))
    assert np.median(factors) < 1.6 * honest, (np.median(factors), honest)
