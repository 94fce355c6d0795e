# SPDX-License-Identifier: Apache-2.0
"""The robot as a live page draws it: geometry once, pose and cables at each instant, residual per cable."""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

import inertiad_core
from inertiad.base.body import Body
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.live.incoming import finite, plain
from inertiad.model import solid, window_residual
from inertiad.robot import configuration, systematic
from inertiad.robot.description import Robot
from inertiad.run.platform_pose import cable_ends, platform_pose
from inertiad_lcm import estimate_t, robot_config_t, signals_row_t

RESIDUAL_WINDOWS: Final = 2.0
"""window lengths of rows from which a residual is taken"""


def numbers(values: Iterable[float]) -> list[float]:
    """Six digits: more than a screen shows, a third of the bytes."""
    return [float(f"{v:.6g}") for v in values]


def ellipsoid(body: Body) -> dict[str, list[float]] | None:
    """Semi-axes [3] m of the ellipsoid of inertia, their sigma [3], principal axes [9] by rows; None: no ellipsoid.

    Sigma is that of the lengths at a common scale, from those of mass and moments.
    """
    value, std = np.array(body.value), np.array(body.std)
    with np.errstate(all="ignore"):  # of numbers that no body has
        found = solid.semi_axes(body)
        if found is None:
            return None
        size, axes = found
        share = 0.5 * np.hypot(std[0] / value[0], np.linalg.norm(std[4:7]) / np.linalg.norm(value[4:7]))
        sigma = np.minimum(share, 1.0) * size
    if not finite((*size, *sigma, *axes.ravel())):
        return None
    return {"size": numbers(size), "axes": numbers(axes.ravel()), "sigma": numbers(sigma)}


@dataclass(frozen=True)
class DrawnRobot:
    """A compiled configuration, and the body it expects."""

    config: robot_config_t
    core: Any
    """inertiad_core.Config"""
    expected: str
    """"nominal", or "prior" where no nominal body is known"""
    body: Body

    @classmethod
    def of_description(cls, robot: Robot, source: str) -> "DrawnRobot":
        """InputError: it does not compile."""
        data = configuration.compile_robot(robot, source)
        return cls(robot_config_t.decode(data[:-4]), inertiad_core.Config(data), *_expected(robot, None))

    @classmethod
    def of_message(cls, config: robot_config_t, data: bytes, robot: Robot | None) -> "DrawnRobot | None":
        """Of a CONFIG message and its bytes; None: the core refuses it. robot: the description, if there is a file."""
        try:
            core = inertiad_core.Config(data + zlib.crc32(data).to_bytes(4, "big"))
        except ValueError:
            return None
        return cls(config, core, *_expected(robot, config))

    @property
    def cables(self) -> list[Any]:
        """cable_config_t of each."""
        return list(self.config.cable[: self.config.n_cables])

    @property
    def rates(self) -> list[tuple[float, float]]:
        """bit/s of each bus, nominal and data phase; 0: unknown."""
        return list(zip(self.config.bus_bitrate, self.config.bus_data_bitrate, strict=True))

    def item(self) -> dict[str, Any]:
        """The geometry."""
        attachment = np.array([c.attachment for c in self.cables])
        shape = solid.hull(attachment)
        return {
            "name": plain(bytes(self.config.name).rstrip(b"\0").decode(errors="replace"), 64),
            "anchors": [list(c.anchor) for c in self.cables],
            "attachments": attachment.tolist(),
            "limits": [[c.tension_min, c.tension_max] for c in self.cables],
            "triangles": shape.triangles if shape is not None else [],
            "edges": shape.edges if shape is not None else [],
            "target": list(self.config.tracker_target),
            "expected": self.expected,
            "nominal": numbers(self.body.value),
            "solid": ellipsoid(self.body),
        }

    def pose(self, row: signals_row_t) -> dict[str, Any]:
        """Position of P, rotation P to W by rows, where each cable leaves its pulley; {}: the row has no attitude."""
        if not any(row.q):
            return {}
        at = np.array([row.q]), np.array([row.position])
        [p], turn = platform_pose(*at, self.config.imu_orientation, self.config.tracker_target)
        [R] = turn.as_matrix()
        attachments, anchors = (np.array([getattr(c, key) for c in self.cables]) for key in ("attachment", "anchor"))
        _, [leave] = cable_ends(self.core, attachments, anchors, p[None], R[None])
        return {"p": numbers(p), "R": numbers(R.ravel()), "leave": [numbers(x) for x in leave]}

    def residual(self, rows: Sequence[signals_row_t], estimate: estimate_t) -> Array | None:
        """N [m]: change of tensions that explains the newest windows' residual wrench, rms; None: too few rows."""
        n, names = self.config.n_cables, systematic.names(self.config.n_cables)
        newest = [row for row in _newest(rows, RESIDUAL_WINDOWS * self.config.window_length) if row.n_cables == n]
        if len(newest) < 8:
            return None
        columns = [[getattr(row, name) for row in newest] for name in ("acc", "gyro", "q", "position", "f")]
        t_ns = np.array([row.t_ns for row in newest], dtype=np.int64)
        known = dict(zip(estimate.systematic_name, estimate.systematic, strict=True))
        xi = np.array([known.get(name, 0.0) for name in names])
        theta = inertiad_core.shift(np.array(estimate.theta), -np.array(self.config.imu_position))
        try:
            acc, gyro, q, position, f = map(np.array, columns)
            table = inertiad_core.Rows(t_ns, acc, gyro, q, position, f)
            found = window_residual.residual(self.core, table, theta, xi, n)
        except (ValueError, np.linalg.LinAlgError):
            return None
        if not len(found.t) or not finite(found.tension.ravel()):
            return None
        return np.asarray(np.sqrt((found.tension**2).mean(axis=0)))


def _newest(rows: Sequence[signals_row_t], span: float) -> list[signals_row_t]:
    found: list[signals_row_t] = []
    for row in reversed(rows):
        if rows[-1].t_ns - row.t_ns > 1e9 * span:
            break
        found.append(row)
    return found[::-1]


def _expected(robot: Robot | None, config: robot_config_t | None) -> tuple[str, Body]:
    """Name and body of what is expected: the description's nominal body, else the prior."""
    none = (0.0,) * 10
    if robot is not None and robot.nominal is not None:
        nominal = robot.nominal
        return "nominal", Body((nominal.mass, *nominal.cog, *nominal.inertia_cog), none)
    if config is not None:
        theta, P = np.array(config.prior_theta), np.array(config.prior_covariance)
    elif robot is not None:
        theta, P = configuration.prior(robot)
    else:
        raise InputError("neither a description nor a configuration")
    found = inertiad_core.body(theta, P)
    return "prior", Body((found["mass"], *found["cog"], *found["inertia_cog"]), none)
