# SPDX-License-Identifier: Apache-2.0
"""Positions from the lengths of the cables and the attitude, where no tracker is: forward kinematics.

Lengths l_i, attachment to anchor with the arc on the pulley, change with the position p of P by dl_i/dp = -u_i, u_i the
unit vector from the attachment along the cable (cable.h). Gauss-Newton from the middle of the usual workspace solves
l(p, R) = l at each instant; from four cables on, what remains of l tells how well lengths, geometry and attitude agree.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Slerp

import inertiad_core
from inertiad.base import quantity, table
from inertiad.base.error import InputError
from inertiad.base.table import Array, Table
from inertiad.robot import configuration, geometry
from inertiad.robot.description import Robot
from inertiad.run import derived_motion

FILE_NAME: Final = "lengths.csv"
STEPS_MAX: Final = 50
"""of Gauss-Newton, from metres away: chosen so that four cables that nearly share a plane converge"""
SOLVED: Final = 1e-7
"""m: a step below it ends the search; chosen so that it is far below what a length is measured to"""
DISAGREE: Final = 0.02
"""m, rms: lengths that fit worse are not these cables', or not lengths from attachment to anchor"""
CABLES_MIN: Final = 3
FREE: Final = 0.05
"""least singular value of the cables' unit directions: chosen so that 1 mm of a length is at most 20 mm of place"""
FAR: Final = 10.0
"""times the median residual of an instant: chosen so that noise is beyond it once in 6e10 instants, with four cables"""
FAR_MIN: Final = 2e-3
"""m: residuals below it are left in, however small the others are; chosen as what an encoder's count and sag may do"""
LOST_MAX: Final = 0.05
"""share of instants for which no pose is found: chosen so that encoders may drop out, and a wrong unit is refused"""
NO_POSE: Final = "no pose has these lengths; are they in m, from attachment to anchor with the arc on the pulley?"


@dataclass(frozen=True)
class FromLengths:
    """Positions of the tracked point, and what the lengths leave unexplained."""

    positions: Table
    """columns x, y, z, W, m"""
    residual: float
    """m, rms over cables and instants; 0 where three cables leave nothing over"""
    n_dropped: int
    """instants left out: no pose has their lengths, or they agree far worse than at others"""
    limit: float
    """m, rms of an instant, above which it is left out"""

    @property
    def note(self) -> str:
        """Where the positions come from, in words."""
        rest = f", which agree to {1e3 * self.residual:.2g} mm rms" if self.residual > 0.0 else ""
        dropped = ""
        if self.n_dropped:
            n = self.n_dropped + len(self.positions)
            dropped = f"; {self.n_dropped} of {n} instants left out: there the lengths disagree by more than "
            dropped += f"{1e3 * self.limit:.2g} mm; check the encoders"
        return f"positions from attitude and cable lengths{rest}{dropped}"


def columns(n_cables: int) -> list[str]:
    """Column names of lengths.csv."""
    return ["t", *quantity.measured_lengths(n_cables)]


def find(signals: Table, file: Path, robot: Robot) -> Table | None:
    """The measured lengths: columns of the signals, or lengths.csv beside them. None: there are none."""
    names = quantity.measured_lengths(robot.n_cables)
    beside = file.with_name(FILE_NAME)
    if names[0] in signals.columns:
        lengths = signals
    elif beside.exists():
        lengths = table.read(beside, columns(robot.n_cables))
    else:
        return None
    for name in names:
        if name not in lengths.columns:
            raise InputError(f"{lengths.name}: line 1: no column {name}: allowed: one length per cable, {names[0]} ..")
        worst = int(np.argmin(lengths.columns[name]))
        if lengths.columns[name][worst] <= 0.0:
            value = f"{name} = {lengths.columns[name][worst]:.6g} m at t = {lengths.t[worst]:.6g} s"
            raise InputError(f"{lengths.name}: {value}: allowed: above 0, attachment to anchor; not a change of length")
    return lengths


def _geometry(config: Any, p: Array, R: Array) -> tuple[Array, Array]:
    """Unit directions [N, m, 3] and lengths [N, m]; NaN where a cable has no direction, as within its pulley."""
    try:
        u, _, length = inertiad_core.cable_geometry(config, p, R)
    except ValueError:
        if len(p) == 1:
            return np.full((1, config.n_cables, 3), np.nan), np.full((1, config.n_cables), np.nan)
        half = len(p) // 2
        halves = (_geometry(config, p[:half], R[:half]), _geometry(config, p[half:], R[half:]))
        return np.concatenate([h[0] for h in halves]), np.concatenate([h[1] for h in halves])
    return u, length


def _solve(config: Any, R: Array, lengths: Array, start: Array) -> tuple[Array, Array, Array]:
    """p [N, 3] of P, the residual [N, m] of the lengths, unit directions [N, m, 3]; NaN where no pose is found."""
    n, m = lengths.shape
    p, left, u = np.repeat(start[None], n, axis=0), np.full((n, m), np.nan), np.full((n, m, 3), np.nan)
    sought = np.arange(n)
    for _ in range(STEPS_MAX):
        directions, length = _geometry(config, p[sought], R[sought])
        is_found = np.isfinite(directions).all(axis=(1, 2)) & np.isfinite(length).all(axis=1)
        sought, directions, rest = sought[is_found], directions[is_found], (length - lengths[sought])[is_found]
        step = np.einsum("nij,nj->ni", np.linalg.pinv(directions), rest)
        p[sought] += step
        is_solved = np.linalg.norm(step, axis=1) < SOLVED
        left[sought[is_solved]], u[sought[is_solved]] = rest[is_solved], directions[is_solved]
        sought = sought[~is_solved]
        if len(sought) == 0:
            break
    return p, left, u


def _check_directions(name: str, t: Array, u: Array) -> None:
    """InputError: the cables leave a direction free, in which the position would be made up."""
    least = np.linalg.svd(u, compute_uv=False)[:, -1]
    worst = int(np.argmin(least))
    if not least[worst] > FREE:
        raise InputError(
            f"{name}: t = {t[worst]:.6g} s: the {u.shape[1]} cables leave a direction free, they nearly share a plane: "
            "lengths do not give the position there; pass a tracker's positions"
        )


def positions(robot: Robot, source: str, signals: Table, lengths: Table) -> FromLengths:
    """Positions of the tracked point at the lengths' times, within the time of the signals' attitude.

    Instants whose lengths no pose has, or disagree far more than those of others, are left out. InputError: cables that
    leave a direction free, more than LOST_MAX of instants without a pose, or lengths that differ by more than DISAGREE.
    """
    if robot.n_cables < CABLES_MIN:
        raise InputError(
            f"{lengths.name}: {robot.n_cables} cables: allowed: {CABLES_MIN} or more, fewer lengths give no position; "
            "pass a tracker's positions"
        )
    inside = (lengths.t >= signals.t[0]) & (lengths.t <= signals.t[-1])
    t = lengths.t[inside]
    if len(t) < 2:
        raise InputError(f"{lengths.name}: fewer than two lengths in the time of {signals.name}")
    turn = Slerp(signals.t, derived_motion.platform_attitude(robot, signals))(t)
    R = np.ascontiguousarray(turn.as_matrix())
    measured = lengths.stack(*quantity.measured_lengths(robot.n_cables))[inside]
    config = inertiad_core.Config(configuration.compile_robot(robot, source))
    box = geometry.box(robot)
    p, left, u = _solve(config, R, measured, 0.5 * (box[:3] + box[3:]))
    each = np.sqrt(np.mean(left**2, axis=1))
    is_lost = np.isnan(each)
    if np.mean(is_lost) > LOST_MAX:
        which = f"{np.sum(is_lost)} of {len(t)} instants, the first at t = {t[np.argmax(is_lost)]:.6g} s"
        raise InputError(f"{lengths.name}: {which}: {NO_POSE}")
    limit = max(FAR * float(np.median(each[~is_lost])), FAR_MIN)
    kept = each <= limit
    residual = float(np.sqrt(np.mean(left[kept] ** 2)))
    if residual > DISAGREE:
        raise InputError(
            f"{lengths.name}: the {robot.n_cables} lengths disagree by {1e3 * residual:.3g} mm rms: allowed: "
            f"{1e3 * DISAGREE:g}; check anchors, attachments, pulley radius and the lengths' zero"
        )
    _check_directions(lengths.name, t[kept], u[kept])
    target = (p + turn.apply(robot.tracker.target))[kept]
    found = Table(t[kept], dict(zip("xyz", target.T, strict=True)), lengths.name)
    return FromLengths(found, residual if robot.n_cables > CABLES_MIN else 0.0, int(np.sum(~kept)), limit)
