# SPDX-License-Identifier: Apache-2.0
"""A body in motion, independent of the core: poses from sums of sines, Newton and Euler by numpy and scipy."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY = 9.81
NOMINAL = {  # ICRA 2017 paper, Table III
    "mass": 161.058,
    "cog": np.array([-0.001, -0.077, -0.118]),
    "inertia_cog": np.array([[94.955, -0.393, -0.085], [-0.393, 88.859, 4.136], [-0.085, 4.136, 31.635]]),
}
# Weights of the 8th-order central difference at -4 .. 4 steps.
DIFFERENCE = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


def derivative(f, t, step=4e-3):
    """d f/dt by central differences of 8th order."""
    return sum(k * f(t + i * step) for i, k in zip(range(-4, 5), DIFFERENCE, strict=True) if k) / step


def theta_of(mass, cog, inertia_cog):
    """m, h, J about the reference point as xx yy zz yz xz xy."""
    J = inertia_cog + mass * (cog @ cog * np.eye(3) - np.outer(cog, cog))
    return np.array([mass, *(mass * cog), J[0, 0], J[1, 1], J[2, 2], J[1, 2], J[0, 2], J[0, 1]])


def matrix_of(J):
    """Symmetric matrix of xx yy zz yz xz xy."""
    return np.array([[J[0], J[5], J[4]], [J[5], J[1], J[3]], [J[4], J[3], J[2]]])


def random_body(rng):
    """theta of a body that can exist: ten point masses."""
    mass, at = rng.uniform(1, 30, 10), rng.normal(0, 0.6, (10, 3))
    cog = mass @ at / mass.sum()
    r = at - cog
    inertia = sum(m * (d @ d * np.eye(3) - np.outer(d, d)) for m, d in zip(mass, r, strict=True))
    return mass.sum(), cog, inertia


@dataclass
class Motion:
    """Smooth random motion; every method takes times [n] and returns rows."""

    amplitude: np.ndarray  # [6, k] of x y z [m] and a rotation vector [rad]
    frequency: np.ndarray  # [6, k] rad/s
    phase: np.ndarray
    centre: np.ndarray  # [3] m

    @classmethod
    def random(cls, rng, n_sines=3, fastest=0.6):
        scale = np.array([[0.4], [0.4], [0.3], [0.35], [0.35], [0.35]]) / n_sines
        shape = (6, n_sines)
        return cls(
            scale * rng.uniform(0.5, 1.5, shape),
            2 * np.pi * rng.uniform(0.1, fastest, shape),
            rng.uniform(0, 2 * np.pi, shape),
            np.array([0.0, 0.0, 2.0]),
        )

    def _sines(self, t, which):
        t = np.atleast_1d(t)[:, None, None]
        return (self.amplitude[which] * np.sin(self.frequency[which] * t + self.phase[which])).sum(axis=-1)

    def p(self, t):
        return self.centre + self._sines(t, slice(0, 3))

    def R(self, t):
        return Rotation.from_rotvec(self._sines(t, slice(3, 6))).as_matrix()

    def acceleration(self, t):
        return derivative(lambda u: derivative(self.p, u), t)

    def rate(self, t):
        """Body axes: the vee of R^T dR/dt."""
        S = np.swapaxes(self.R(t), 1, 2) @ derivative(self.R, t)
        return np.stack([S[:, 2, 1] - S[:, 1, 2], S[:, 0, 2] - S[:, 2, 0], S[:, 1, 0] - S[:, 0, 1]], axis=1) / 2

    def angular_acceleration(self, t):
        return derivative(self.rate, t)

    def specific_force(self, t, point=(0.0, 0.0, 0.0)):
        """Of a body point, body axes: R^T (a - g)."""
        at = lambda u: self.p(u) + self.R(u) @ np.array(point)  # noqa: E731
        a = derivative(lambda u: derivative(at, u), t) + np.array([0.0, 0.0, GRAVITY])
        return np.einsum("nji,nj->ni", self.R(t), a)
