# SPDX-License-Identifier: Apache-2.0
"""The recursion against batch least squares and against other people's recursions on the same rows."""

import filterpy
import numpy as np
import padasip
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from motion import NOMINAL, theta_of

import inertiad_core as core


def problem(seed, n_blocks=200, n_xi=0):
    """Random equations of a moving body: H [n, 6, 10 + n_xi], y [n, 6], L [6, 6], and a prior."""
    rng = np.random.default_rng(seed)
    s, w, alpha = rng.normal(0, 2, (3, n_blocks, 3))
    s[:, 2] += 9.81
    H = np.concatenate([core.regressor(s, w, alpha), rng.normal(size=(n_blocks, 6, n_xi))], axis=2)
    L = np.tril(rng.normal(0, 0.3, (6, 6)), -1) + np.diag(rng.uniform(0.5, 3, 6))
    truth = np.concatenate([theta_of(**NOMINAL), 0.3 * rng.normal(size=n_xi)])
    y = H @ truth + rng.normal(size=(n_blocks, 6)) @ L.T
    A = rng.normal(size=(10, 10))
    return H, y, L, truth[:10] + 5 * rng.normal(size=10), 100 * A @ A.T + 25 * np.eye(10), rng.uniform(0.2, 2, n_xi)


def run_core(H, y, L, x0, P0, xi_std):
    rls = core.Rls(x0, P0, xi_std)
    for H_k, y_k in zip(H, y, strict=True):
        rls.update(H_k, y_k, L)
    return rls


def whitened(H, y, L):
    W = np.linalg.inv(L)
    return (W @ H).reshape(-1, H.shape[2]), (W @ y[:, :, None]).ravel()


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_blocks=st.integers(1, 300), n_xi=st.integers(0, 27))
def test_recursion_equals_batch_least_squares_with_prior_rows(seed, n_blocks, n_xi):
    H, y, L, x0, P0, xi_std = problem(seed, n_blocks, n_xi)
    rls = run_core(H, y, L, x0, P0, xi_std)

    prior = np.zeros((10 + n_xi, 10 + n_xi))
    prior[:10, :10] = np.linalg.inv(np.linalg.cholesky(P0))
    prior[10:, 10:] = np.diag(1 / xi_std)
    rows, right = whitened(H, y, L)
    A = np.vstack([prior, rows])
    b = np.concatenate([prior @ np.concatenate([x0, np.zeros(n_xi)]), right])
    reference = np.linalg.lstsq(A, b, rcond=None)[0]
    std = np.sqrt(np.diag(rls.P))
    np.testing.assert_array_less(np.abs(rls.x - reference), 1e-7 * std + 1e-10 * np.linalg.norm(reference))
    covariance = np.linalg.inv(A.T @ A)
    np.testing.assert_allclose(rls.P / np.outer(std, std), covariance / np.outer(std, std), atol=1e-7)


def largest_difference(x, reference):
    return np.abs(x - reference).max() / np.abs(reference).max()


def test_recursion_equals_padasip(measured):
    H, y, L, x0, _, xi_std = problem(1)
    P0 = 400.0 * np.eye(10)
    peer = padasip.filters.FilterRLS(10, mu=1.0, eps=1 / 400.0, w=x0)
    peer.run(*reversed(whitened(H, y, L)))
    difference = largest_difference(run_core(H, y, L, x0, P0, xi_std).x, peer.w)
    measured(f"recursion against padasip: relative difference {difference:.1e} after 1200 rows")
    assert difference <= 1e-10


def test_recursion_equals_filterpy(measured):
    H, y, L, x0, P0, xi_std = problem(2)
    peer = KalmanFilter(dim_x=10, dim_z=6)
    peer.x, peer.P, peer.R = x0.copy(), P0.copy(), L @ L.T
    for H_k, y_k in zip(H, y, strict=True):
        peer.update(y_k, H=H_k)
    rls = run_core(H, y, L, x0, P0, xi_std)
    difference = largest_difference(rls.x, peer.x)
    measured(f"recursion against filterpy {filterpy.__version__}: relative difference {difference:.1e} after 1200 rows")
    assert difference <= 1e-10
    assert largest_difference(rls.P, peer.P) <= 1e-8


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_order_of_blocks_changes_only_rounding(seed):
    H, y, L, x0, P0, xi_std = problem(seed)
    order = np.random.default_rng(seed).permutation(len(y))
    a, b = run_core(H, y, L, x0, P0, xi_std), run_core(H[order], y[order], L, x0, P0, xi_std)
    np.testing.assert_array_less(np.abs(a.x - b.x), 1e-8 * np.sqrt(np.diag(a.P)) + 1e-12)


def test_units_of_rows_change_only_rounding():
    H, y, L, x0, P0, xi_std = problem(3)
    unit = np.diag([1e3, 1.0, 1e-3, 1e2, 1e-2, 1.0])
    a, b = run_core(H, y, L, x0, P0, xi_std), run_core(unit @ H, y @ unit, unit @ L, x0, P0, xi_std)
    np.testing.assert_array_less(np.abs(a.x - b.x), 1e-8 * np.sqrt(np.diag(a.P)) + 1e-12)


def test_nonfinite_equations_are_refused():
    H, y, L, x0, P0, xi_std = problem(4, 1)
    rls = core.Rls(x0, P0, xi_std)
    y[0, 2] = np.nan
    with pytest.raises(ValueError):
        rls.update(H[0], y[0], L)
    assert np.array_equal(rls.x, x0)
