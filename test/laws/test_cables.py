# SPDX-License-Identifier: Apache-2.0
"""Cable directions and lengths of a whole robot against an independent construction of the tangent to a pulley."""

from itertools import pairwise

import numpy as np
import pytest
from robots import checked, cogiro
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import inertiad_core as core


def poses(rng, n):
    p = rng.uniform([-4, -3, 0.5], [4, 3, 3.5], (n, 3))
    return p, Rotation.from_rotvec(rng.normal(0, 0.4, (n, 3))).as_matrix()


def tangent(anchor, axis, radius, B):
    """Leave point and wrap angle by root finding: the spoke at the leave point is square to the cable."""
    d = B - anchor
    e = d - (d @ axis) * axis
    e /= np.linalg.norm(e)
    centre = anchor + radius * e
    rim = lambda b: centre + radius * (-np.cos(b) * e + np.sin(b) * axis)  # noqa: E731
    ahead = lambda b: np.sin(b) * e + np.cos(b) * axis  # direction of travel  # noqa: E731
    square = lambda b: (rim(b) - centre) @ (B - rim(b))  # noqa: E731
    grid = np.linspace(0, 2 * np.pi, 721)
    for low, high in pairwise(grid):
        if square(low) * square(high) <= 0:
            b = brentq(square, low, high, xtol=1e-14)
            if ahead(b) @ (B - rim(b)) > 0:
                return rim(b), b
    raise AssertionError("no tangent")


def test_cable_geometry_equals_tangent_by_root_finding():
    rng = np.random.default_rng(1)
    robot = cogiro()
    for cable in robot.cable[:8]:
        axis = rng.normal(0, 0.3, 3) + cable.swivel_axis
        cable.swivel_axis = (axis / np.linalg.norm(axis)).tolist()
        cable.pulley_radius = rng.uniform(0.02, 0.3)
    p, R = poses(rng, 20)
    u, free, length = core.cable_geometry(checked(robot), p, R)
    for k in range(len(p)):
        for i, cable in enumerate(robot.cable[:8]):
            B = p[k] + R[k] @ cable.attachment
            leave, wrap = tangent(np.array(cable.anchor), np.array(cable.swivel_axis), cable.pulley_radius, B)
            np.testing.assert_allclose(free[k, i], np.linalg.norm(leave - B), atol=1e-9)
            np.testing.assert_allclose(u[k, i], (leave - B) / free[k, i], atol=1e-9)
            np.testing.assert_allclose(length[k, i], free[k, i] + cable.pulley_radius * wrap, atol=1e-9)


def test_pulley_of_radius_zero_is_a_point():
    robot = cogiro()
    for cable in robot.cable:
        cable.pulley_radius = 0.0
    p, R = poses(np.random.default_rng(2), 50)
    u, free, length = core.cable_geometry(checked(robot), p, R)
    for i, cable in enumerate(robot.cable[:8]):
        d = np.array(cable.anchor) - p - R @ np.array(cable.attachment)
        np.testing.assert_allclose(free[:, i], np.linalg.norm(d, axis=1), rtol=1e-14)
        np.testing.assert_allclose(u[:, i], d / np.linalg.norm(d, axis=1)[:, None], atol=1e-14)
    assert np.array_equal(free, length)


def test_wrench_matrix_is_minus_the_derivative_of_lengths():
    rng = np.random.default_rng(3)
    config = checked(cogiro())
    p, R = poses(rng, 20)
    W, _ = core.wrench_matrix(config, p, R, np.zeros(3))
    h = 1e-6
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = h
        moved = [
            core.cable_geometry(config, p + sign * R @ step[:3], R @ Rotation.from_rotvec(sign * step[3:]).as_matrix())[
                2
            ]
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(W[:, axis, :], -(moved[0] - moved[1]) / (2 * h), atol=1e-7)


def test_point_on_its_own_anchor_is_refused_by_number():
    robot = cogiro()
    config = checked(robot)
    p = np.array([robot.cable[4].anchor]) - np.array([robot.cable[4].attachment])
    with pytest.raises(ValueError, match="cable 5, sample 0"):
        core.cable_geometry(config, p, np.eye(3)[None])
