# SPDX-License-Identifier: Apache-2.0
"""Constraints of a planned motion: tensions, workspace, tilt, speed, acceleration, distances.

Every limit is a function g of pose coordinates q = x y z roll pitch yaw and their two derivatives, in its own unit of
excess: g <= 0 is allowed, g = 0.1 means a tenth over. Tensions are those that inverse_dynamics.py gives the motion.
"""

import itertools
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.identify.fisher_information import Model
from inertiad.model import inverse_dynamics
from inertiad.model.inverse_dynamics import Mechanics
from inertiad.model.trajectory import POSE_NAMES, Motion, motion_of

GRAZING = 0.02
"""rad that a cable may lean into the hull of the attachments, which is only roughly the platform"""


@dataclass(frozen=True)
class Limits:
    """SI; the tracker's are of the tracked point."""

    low: Array
    """x y z [3] of P in W, m"""
    high: Array
    tilt: float
    """rad, of the platform's z axis against the world's"""
    yaw: float
    """rad, either way"""
    speed: float
    """m/s of P and of the tracked point"""
    acceleration: float
    """m/s2 of P and of the tracked point"""
    clearance: float
    """m between any two cables"""
    margin: float
    """share of its range that every tension stays inside of"""


def _segment_distance(p: Array, d: Array, q: Array, e: Array) -> Array:
    """Distance [...] of the segments p + s d and q + t e, s and t in 0 .. 1; all [..., 3]."""
    r = p - q
    a, b, c = (np.sum(x * y, axis=-1) for x, y in ((d, d), (d, e), (e, e)))
    f, g = np.sum(d * r, axis=-1), np.sum(e * r, axis=-1)
    s = np.clip((b * g - c * f) / np.maximum(a * c - b * b, 1e-12), 0.0, 1.0)
    t = np.clip((b * s + g) / c, 0.0, 1.0)
    s = np.clip((b * t - f) / a, 0.0, 1.0)
    return np.asarray(np.linalg.norm(r + s[..., None] * d - t[..., None] * e, axis=-1))


@dataclass(frozen=True)
class Checker:
    """Limits of one robot, evaluated over instants."""

    model: Model
    limits: Limits

    def __getstate__(self) -> dict[str, Any]:
        """Pickled: the fields, without cached values."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def mechanics(self) -> Mechanics:
        return Mechanics(self.model.config, self.model.robot, self.model.body)

    @cached_property
    def range(self) -> tuple[Array, Array]:
        """Least and greatest tension [m] planned, N."""
        low = np.array([c.tension_min for c in self.model.robot.cable])
        high = np.array([c.tension_max for c in self.model.robot.cable])
        inside = self.limits.margin * np.minimum(high - low, np.maximum(low, 0.02 * high))
        return low + inside, high - inside

    @cached_property
    def _pairs(self) -> tuple[Array, Array]:
        """Pairs of cables that start apart on the platform."""
        place = [np.array(c.attachment) for c in self.model.robot.cable]
        apart = [
            (i, j)
            for i, j in itertools.combinations(range(len(place)), 2)
            if np.linalg.norm(place[i] - place[j]) > 2.0 * self.limits.clearance
        ]
        first, second = np.array(apart, dtype=int).reshape(-1, 2).T
        return first, second

    @cached_property
    def _facets(self) -> list[Array]:
        """Outward normals [K, 3] of the hull of the attachments at each of them; empty where there is no hull."""
        place = np.array([c.attachment for c in self.model.robot.cable])
        try:
            hull = ConvexHull(place)
        except (QhullError, ValueError):
            return []
        at = [np.flatnonzero((hull.simplices == i).any(axis=1)) for i in range(len(place))]
        return [hull.equations[k, :3] for k in at]

    @cached_property
    def names(self) -> list[str]:
        """One per column of excess()."""
        m = self.model.robot.n_cables
        cables = [f"tension_{end} of cable {i + 1}" for end in ("min", "max") for i in range(m)]
        box = [f"{end} {name} of the box" for end in ("least", "greatest") for name in POSE_NAMES[:3]]
        moving = [
            f"{what} of {who}" for what in ("speed", "acceleration") for who in ("the platform", "the tracked point")
        ]
        pairs = [f"clearance of cables {i + 1} and {j + 1}" for i, j in zip(*self._pairs, strict=True)]
        facets = [f"clearance of cable {i + 1} and the platform" for i, n in enumerate(self._facets) if len(n)]
        return [*cables, *box, "tilt", "yaw", *moving, *pairs, *facets]

    def tensions(self, motion: Motion) -> Array:
        """Tensions [N, m] closest to an even pull, N, whether within their limits or not."""
        robot, body = self.model.robot, self.model.body
        W, sag = inverse_dynamics.wrench_matrix(self.mechanics, np.zeros(len(motion.p)), motion)
        wrench = inverse_dynamics.required_wrench(motion, body, robot.gravity) - sag
        share = 2.0 * body.mass * robot.gravity / robot.n_cables
        low = np.array([c.tension_min for c in robot.cable])
        high = np.array([c.tension_max for c in robot.cable])
        return inverse_dynamics.even_pull(W, wrench, np.clip(np.full(robot.n_cables, share), low, high))

    def moving(self, motion: Motion) -> list[Array]:
        """Excess [N] of speed of P, speed of the target, acceleration of P and of the target, in that order."""
        target = np.array(self.model.robot.tracker.target)
        w = motion.omega
        spin = np.cross(w, np.broadcast_to(target, w.shape))
        v = motion.v + np.einsum("nij,nj->ni", motion.R, spin)
        turn = np.cross(motion.alpha, np.broadcast_to(target, w.shape)) + np.cross(w, spin)
        a = motion.a + np.einsum("nij,nj->ni", motion.R, turn)
        top = (self.limits.speed, self.limits.speed, self.limits.acceleration, self.limits.acceleration)
        return [
            0.5 * (np.sum(x * x, axis=1) / t**2 - 1.0) for x, t in zip((motion.v, v, motion.a, a), top, strict=True)
        ]

    def _distances(self, motion: Motion) -> Array:
        """Excess [N, pairs + cables] of clearances."""
        robot = self.model.robot
        u, free, _ = inertiad_core.cable_geometry(self.model.config, motion.p, motion.R)
        start = motion.p[:, None] + np.einsum("nij,cj->nci", motion.R, np.array([c.attachment for c in robot.cable]))
        along = u * free[:, :, None]
        i, j = self._pairs
        gap = _segment_distance(start[:, i], along[:, i], start[:, j], along[:, j])
        found = [1.0 - gap / self.limits.clearance]
        body = np.einsum("nji,ncj->nci", motion.R, u)
        for k, normals in enumerate(self._facets):
            if len(normals):
                found.append(-np.max(body[:, k] @ normals.T, axis=1, keepdims=True) - GRAZING)
        return np.hstack(found)

    def excess(self, q: Array, dq: Array, ddq: Array, n_poses: int | None = None) -> tuple[Array, Motion, Array]:
        """(g [N, len(names)], motion, tensions [N, m]) of coordinates [N, 6] and derivatives. ValueError: no geometry.

        n_poses: the rows up to there are seven copies of the instants, the first as it is; all rows after them have the
        first copy's poses, and so its distances.
        """
        motion = motion_of(q, dq, ddq)
        f = self.tensions(motion)
        low, high = self.range
        limits = self.limits
        size = np.maximum(limits.high - limits.low, 1e-3)
        tilt = (np.cos(limits.tilt) - motion.R[:, 2, 2]) / max(1.0 - np.cos(limits.tilt), 1e-4)
        yaw = np.abs(q[:, 5]) / max(limits.yaw, 1e-3) - 1.0
        scale = max(2.0 * self.model.body.mass * self.model.robot.gravity / self.model.robot.n_cables, 1.0)
        columns = [
            (low - f) / scale,
            (f - high) / scale,
            (limits.low - q[:, :3]) / size,
            (q[:, :3] - limits.high) / size,
        ]
        moving = [g[:, None] for g in (tilt, yaw, *self.moving(motion))]
        distances = self._distances(_first(motion, len(q) if n_poses is None else n_poses))
        if n_poses is not None:
            repeated = distances[: n_poses // 7]
            distances = np.concatenate([distances, np.tile(repeated, ((len(q) - n_poses) // len(repeated), 1))])
        return np.hstack([*columns, *moving, distances]), motion, f

    def worst(self, t: Array, q: Array, dq: Array, ddq: Array) -> tuple[float, str]:
        """The greatest excess, with its constraint and place."""
        g, motion, f = self.excess(q, dq, ddq)
        k, c = np.unravel_index(int(np.argmax(g)), g.shape)
        name, m = self.names[int(c)], self.model.robot.n_cables
        value = f" = {f[k, c % m]:.0f} N" if c < 2 * m else ""
        x, y, z = motion.p[k]
        where = f"t = {t[k]:.2f} s, x y z = {x:.2f} {y:.2f} {z:.2f} m"
        return float(g[k, c]), f"{name}{value} at {where}"


def _first(motion: Motion, n: int) -> Motion:
    return Motion(*(getattr(motion, name)[:n] for name in ("p", "v", "a", "R", "omega", "alpha")))


def check_pose(checker: Checker, pose: Array, name: str) -> None:
    """InputError unless the platform can rest in the pose [6] within every limit."""
    robot, still = checker.model.robot, np.zeros((1, 6))
    if robot.n_cables < 6:
        raise InputError(
            f"{checker.model.source}: {robot.n_cables} cables leave {6 - robot.n_cables} of 6 degrees of freedom free, "
            "no motion can be commanded along them; use excite --poses N, rests to swing between"
        )
    try:
        excess, where = checker.worst(np.zeros(1), pose[None], still, still)
    except (ValueError, InputError) as error:
        raise InputError(f"{name}: {str(error).removeprefix('trajectory: ')}") from None
    if excess > 1e-6:
        hint = inverse_dynamics.below_hint(robot, float(pose[2]))
        raise InputError(f"{name}: no rest within the limits: {where.replace('t = 0.00 s, ', '')}{hint}")
