# SPDX-License-Identifier: Apache-2.0
"""The nearest possible body: the core's cutting planes against the semidefinite programme, and against chance."""

import numpy as np
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from motion import NOMINAL, theta_of

import inertiad_core as core
from inertiad.identify import physical_consistency


def impossible(seed):
    """A body's theta moved by up to a few sigma of a random covariance, and that covariance."""
    rng = np.random.default_rng(seed)
    unit = np.array([100.0, 20.0, 20.0, 20.0, 50.0, 50.0, 50.0, 20.0, 20.0, 20.0]) * 10.0 ** rng.uniform(-1.0, 0.5)
    A = np.diag(unit) @ (np.eye(10) + 0.5 * rng.normal(size=(10, 10)))
    return theta_of(**NOMINAL) + A @ rng.normal(size=10), A @ A.T


def least_eigenvalue(theta, of):
    """Of theta's pseudo-inertia, in parts of the trace that theta `of` is scaled by."""
    length = physical_consistency.radius_of_gyration(of)
    trace = 0.5 * abs(of[4:7].sum()) + abs(of[0]) * length**2
    return np.linalg.eigvalsh(physical_consistency.scaled_pseudo_inertia(theta, length))[0] / trace


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=936956954)  # needs more than 24 cuts
def test_cutting_planes_and_programme_find_the_same_body(seed):
    theta, P = impossible(seed)
    assume(theta[0] > 1.0 and not core.is_consistent(theta))
    q, distance = core.nearest_body(theta, P)
    exact, least = physical_consistency.nearest(theta, P)
    _, at_half = physical_consistency.nearest(theta, P, 0.5 * physical_consistency.MARGIN)
    # The core stops between half the margin and the whole of it, and short of the last digit (200 sweeps).
    assert at_half * (1.0 - 1e-6) <= distance <= least * (1.0 + 3e-3)
    # Both are possible at half the margin, and the metric is convex: this far from its minimum, so this far apart.
    apart = np.linalg.norm(np.linalg.solve(np.linalg.cholesky(P), q - exact))
    assert apart <= (np.sqrt(max(distance - at_half, 0.0)) + np.sqrt(max(least - at_half, 0.0))) * 1.01 + 1e-4
    assert least_eigenvalue(exact, theta) >= physical_consistency.MARGIN * (1.0 - 1e-4)
    assert least_eigenvalue(q, theta) >= 0.5 * physical_consistency.MARGIN * (1.0 - 1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_possible_body_is_nearer(seed):
    theta, P = impossible(seed)
    assume(theta[0] > 1.0 and not core.is_consistent(theta))
    exact, least = physical_consistency.nearest(theta, P)
    rng, L = np.random.default_rng(seed), np.linalg.cholesky(P)
    for step in 10.0 ** rng.uniform(-4.0, 0.0, 200):
        other = exact + step * L @ rng.normal(size=10)
        if least_eigenvalue(other, theta) >= physical_consistency.MARGIN:
            z = np.linalg.solve(L, other - theta)
            assert z @ z >= least * (1.0 - 1e-6)


def test_a_possible_body_is_left_as_it_is():
    theta = theta_of(**NOMINAL)
    for q, distance in (core.nearest_body(theta, np.eye(10)), physical_consistency.nearest(theta, np.eye(10))):
        assert np.array_equal(q, theta)
        assert distance == 0.0
