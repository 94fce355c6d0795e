# SPDX-License-Identifier: Apache-2.0
"""Fisher information of a motion: predicted standard deviations of the body, before the experiment.

    Lambda = sum_k H_k^T C^-1 H_k + P_0^-1        H_k = [Y, -X] of window k, from the C core
    S = E Lambda^-1 E^T                           E: states -> mass, CoG, inertia about it, first order
C and P_0 are those of the compiled configuration, S is published with the geometry's share in the CoG, as
firmware/core/pipeline.c does. The filter replaces C by the noise level it learns, so the sigma that a run reports
follows from a rehearsal: the core's filter on the planned equations, with the systematic errors of [std], attitude that
wanders and misplaced cables.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import inertiad_core
from inertiad.base.table import Array
from inertiad.model.inverse_dynamics import specific_force
from inertiad.model.random_errors import wander
from inertiad.model.trajectory import Motion, Trajectory
from inertiad.robot import configuration, systematic
from inertiad.robot.description import Robot
from inertiad.robot.keys import Nominal
from inertiad.robot.systematic import Group

WANDER_TIME = 20.0
"""s, correlation time of the attitude's wander, which robot.toml does not say"""

REHEARSAL_RATE = 100.0
"""Hz at which a planned motion is sampled"""

N_REHEARSALS = 12

N_THETA = 10
"""states of the body: m, h, J; those of the systematic parameters follow"""


@dataclass(frozen=True)
class Model:
    """A robot, its assumed body, and the predicted result of its filter for a motion."""

    robot: Robot
    source: str
    """robot.toml, for messages"""
    body: Nominal
    """about which the equations are linearised and for which tensions are planned"""

    def __getstate__(self) -> dict[str, Any]:
        """Pickled: the fields, without cached values."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def config(self) -> Any:
        """inertiad_core.Config"""
        return inertiad_core.Config(configuration.compile_robot(self.robot, self.source))

    @cached_property
    def theta(self) -> Array:
        """m, h, J about the IMU [10]"""
        return np.asarray(inertiad_core.shift(configuration.theta_of(self.body), np.array(self.robot.imu.position)))

    @cached_property
    def E(self) -> Array:
        """d(mass, cog, inertia_cog) / d(states) [10, n], states about the IMU."""
        n_x = N_THETA + systematic.n_planned(self.robot.n_cables)
        back = -np.array(self.robot.imu.position)
        shift = np.column_stack([inertiad_core.shift(column, back) for column in np.eye(10)])
        E = np.zeros((10, n_x))
        E[:, :10] = inertiad_core.body_jacobian(configuration.theta_of(self.body)) @ shift
        return E

    @cached_property
    def prior_information(self) -> Array:
        """P_0^-1 [n, n] about the IMU."""
        covariance = configuration.prior(self.robot)[1]
        forth = np.array(self.robot.imu.position)
        shift = np.column_stack([inertiad_core.shift(column, forth) for column in np.eye(10)])
        n_x = self.E.shape[1]
        Lambda = np.zeros((n_x, n_x))
        Lambda[:10, :10] = np.linalg.inv(shift @ covariance @ shift.T)
        std = np.maximum(inertiad_core.systematic_std(self.config)[: n_x - 10], 1e-12)
        Lambda[range(10, n_x), range(10, n_x)] = std**-2.0
        return Lambda

    @cached_property
    def residual_std(self) -> Array:
        """[6] N and N m, square roots of C's diagonal."""
        return np.repeat(configuration.residual_std(self.robot), 3)

    @staticmethod
    def columns(group: Group) -> slice:
        """Of H and of the states, those of systematic parameters of one kind."""
        return slice(N_THETA + group.first, N_THETA + group.first + group.n)

    def prior_sigma(self) -> Array:
        """One sigma [10] of mass, CoG, inertia before any data."""
        return self.sigma(self.prior_information)

    def covariance(self, P: Array) -> Array:
        """Published covariance [10, 10] of mass, CoG and inertia from the filter's P [10, 10] about the IMU."""
        return np.asarray(inertiad_core.published_covariance(self.config, self.theta, P))

    def sigma(self, information: Array) -> Array:
        """Published sigma [10] of mass, CoG and inertia for a filter with this information matrix [n, n]."""
        P = np.asarray(np.linalg.inv(information)[:10, :10], dtype=np.float64)
        return np.sqrt(np.diag(self.covariance(P)))

    def information(self, H: Array, weight: float = 1.0) -> Array:
        """Lambda [n, n] of windows H [M, 6, n], each counted weight times."""
        rows = (H / self.residual_std[:, None]).reshape(-1, H.shape[2])
        return weight * rows.T @ rows + self.prior_information

    def _specific_force(self, motion: Motion) -> Array:
        """At the IMU, P axes, m/s2 [N, 3]."""
        return specific_force(motion, self.robot.gravity, np.array(self.robot.imu.position))

    def instants(self, motion: Motion, f: Array) -> Array:
        """H [N, 6, n] as if each instant were a window; tensions f [N, m]."""
        s = self._specific_force(motion)
        return np.asarray(
            inertiad_core.planned_instants(
                self.config, s, motion.omega, motion.alpha, motion.p, motion.v, motion.R, f, self.theta
            )
        )

    def windows(self, motion: Motion, f: Array, rate: float) -> Array:
        """H [M, 6, n] of the windows that the daemon will form of the motion at rate [Hz], tensions f [N, m]."""
        s = self._specific_force(motion)
        H, _, _ = inertiad_core.planned_windows(self.config, rate, s, motion.omega, motion.p, motion.R, f, self.theta)
        return np.asarray(H)

    def _misplaced(self, motion: Motion, f: Array, dice: np.random.Generator) -> Array:
        """Wrench [N, 6] that anchors and attachments std_geometry off their places add, about P, P axes; f [N, m]."""
        u_W, free, _ = inertiad_core.cable_geometry(self.config, motion.p, motion.R)
        shape = (self.robot.n_cables, 3)
        anchor, attachment = self.robot.std.geometry * dice.standard_normal((2, *shape))
        u = np.einsum("nji,ncj->nci", motion.R, u_W)
        away = np.einsum("nji,cj->nci", motion.R, anchor) - attachment
        turn = (away - u * np.sum(u * away, axis=2, keepdims=True)) / free[:, :, None]
        F, dF = f[:, :, None] * u, f[:, :, None] * turn
        place = np.array([cable.attachment for cable in self.robot.cable])
        moment = np.cross(attachment, F) + np.cross(place, dF)
        return np.hstack([dF.sum(axis=1), moment.sum(axis=1)])

    def rehearse(self, motion: Motion, f: Array, rate: float, seed: int = 0) -> Array:
        """Covariance [10, 10] of mass, CoG, inertia that a run of this motion [N], sampled at rate [Hz], will report.

        Median over N_REHEARSALS of the core's filter on the planned equations with errors drawn from [std].
        """
        H, length = self.windows(motion, f, rate), self.robot.estimator.window_length
        hop, n_xi, s = 0.25 * length, H.shape[2] - 10, self._specific_force(motion)
        middle = np.rint((0.5 * length + hop * np.arange(len(H))) * rate).astype(int)
        middle = np.minimum(middle, len(f) - 1)
        centre = Motion(*(getattr(motion, name)[middle] for name in ("p", "v", "a", "R", "omega", "alpha")))
        dice = np.random.default_rng([seed, 20])
        attitude = self.columns(systematic.group("attitude_bias", self.robot.n_cables))
        found = []
        for _ in range(N_REHEARSALS):
            turn = wander(self.robot.std.attitude_wander, WANDER_TIME, 1.0 / hop, len(H), dice)
            xi = inertiad_core.systematic_std(self.config)[:n_xi] * dice.standard_normal(n_xi)
            y = H @ np.concatenate([self.theta, xi]) + np.einsum("kij,kj->ki", H[:, :, attitude], turn)
            y += self._misplaced(centre, f[middle], dice)
            found.append(inertiad_core.rehearse(self.config, rate, s, motion.omega, motion.p, motion.R, f, y))
        return np.asarray(np.median(found, axis=0))


def sample_times(trajectory: Trajectory, rate: float = REHEARSAL_RATE) -> NDArray[np.float64]:
    """s, [N]: the whole trajectory at rate [Hz]."""
    return np.arange(int(trajectory.duration * rate + 1e-9) + 1) / rate
