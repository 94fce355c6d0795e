# SPDX-License-Identifier: Apache-2.0
"""Projection of an estimate to the nearest physically consistent body, by a semidefinite programme.

    minimise (q - theta)^T P^-1 (q - theta)   subject to   Pi(q) >= eps E
Pi is the pseudo-inertia (firmware/core/consistency.h) with lengths in radii of gyration, eps 0.002 of its trace; P is
the covariance of the fit, so the least observable directions move most. A consistent body costs one Cholesky factor.
The filter on the platform approximates it by cutting planes; here it is the exact minimum (interior point, Clarabel).
"""

from typing import Any, Final

import numpy as np

import inertiad_core
from inertiad.base.table import Array

MARGIN: Final = 2e-3
"""smallest eigenvalue of the scaled pseudo-inertia, of its trace; as in firmware/core/consistency.c"""
UPPER: Final = np.tril_indices(4)[::-1]
"""rows and columns of the upper triangle, column by column: the order of Clarabel's cone"""


def scaled_pseudo_inertia(theta: Array, length: float) -> Array:
    """Pi [4, 4] of theta [10] with lengths in units of length [m], kg m2."""
    scale = np.array([1.0, 1.0, 1.0, length])
    return np.asarray(inertiad_core.pseudo_inertia(theta)) * np.outer(scale, scale)


def radius_of_gyration(theta: Array) -> float:
    """m; 1 where theta has none."""
    squared = 0.5 * theta[4:7].sum() / theta[0]
    return float(np.sqrt(squared)) if np.isfinite(squared) and squared > 1e-12 else 1.0


def _vector(symmetric: Array) -> Array:
    """Upper triangle [10] of a matrix [4, 4], whose inner product is the matrices'."""
    return np.where(UPPER[0] == UPPER[1], 1.0, np.sqrt(2.0)) * symmetric[UPPER]


def _programme(at: Array, columns: Array) -> Any:
    """The solver for min |z|^2 with at + columns z [10, 10] in the cone."""
    import clarabel
    from scipy import sparse

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    two = sparse.csc_matrix(2.0 * np.eye(10))
    cone = [clarabel.PSDTriangleConeT(4)]
    return clarabel.DefaultSolver(two, np.zeros(10), sparse.csc_matrix(-columns), at, cone, settings)


def nearest(theta: Array, P: Array, margin: float = MARGIN) -> tuple[Array, float]:
    """The parameters [10] nearest to theta [10] about P in the metric of P [10, 10], and the distance squared.

    theta itself, 0 if it can exist. ArithmeticError: the solver found no solution, theta or P are not usable.
    """
    if inertiad_core.is_consistent(theta):
        return theta, 0.0
    length = radius_of_gyration(theta)
    trace = 0.5 * abs(theta[4:7].sum()) + abs(theta[0]) * length**2
    L = np.linalg.cholesky(P)
    at = _vector(scaled_pseudo_inertia(theta, length) - margin * trace * np.eye(4))
    columns = np.column_stack([_vector(scaled_pseudo_inertia(column, length)) for column in L.T])
    solution = _programme(at / trace, columns / trace).solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        raise ArithmeticError(f"no nearest body: {solution.status}")
    z = np.array(solution.x)
    return theta + L @ z, float(z @ z)
