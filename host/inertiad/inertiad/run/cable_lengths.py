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

NO_POSE: Final = "no pose has these lengths; are they in m, from attachment to anchor with the arc on the pulley?"


@dataclass(frozen=True)
class FromLengths:
    """Positions of the tracked point, and what the lengths leave unexplained."""

    positions: Table
    """columns x, y, z, W, m"""
    residual: float
    """m, rms over cables and instants; 0 where three cables leave nothing over"""
    n_dropped: int
    """instants left out: their lengths agree far worse than at others"""

    @property
    def note(self) -> str:
        """Where the positions come from, in words."""
        rest = f", which agree to {1e3 * self.residual:.2g} mm rms" if self.residual > 0.0 else ""
        dropped = f"; {self.n_dropped} instants left out, at which they disagree" if self.n_dropped else ""
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


def _solve(config: Any, R: Array, lengths: Array, start: Array) -> tuple[Array, Array, Array, Array]:
    """p [N, 3] of P, the residual [N, m] of the lengths, the length [N] of the last step, unit directions [N, m, 3]."""
    p = np.repeat(start[None], len(R), axis=0)
    for _ in range(STEPS_MAX):
        u, _, length = inertiad_core.cable_geometry(config, p, R)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(u), length - lengths)
        p = p + step
        size = np.linalg.norm(step, axis=1)
        if size.max() < SOLVED:
            break
    return p, length - lengths, size, u


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

    Instants whose lengths disagree far more than those of others are left out. InputError: cables that leave a
    direction free, lengths that no pose has, or that differ by more than DISAGREE.
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
    try:
        p, left, step, u = _solve(config, R, measured, 0.5 * (box[:3] + box[3:]))
    except (ValueError, np.linalg.LinAlgError):
        raise InputError(f"{lengths.name}: {NO_POSE}") from None
    worst = int(np.argmax(step))
    if not step[worst] < SOLVED:
        raise InputError(f"{lengths.name}: t = {t[worst]:.6g} s: {NO_POSE}")
    each = np.sqrt(np.mean(left**2, axis=1))
    kept = each <= max(FAR * float(np.median(each)), FAR_MIN)
    residual = float(np.sqrt(np.mean(left[kept] ** 2)))
    if residual > DISAGREE:
        raise InputError(
            f"{lengths.name}: the {robot.n_cables} lengths disagree by {1e3 * residual:.3g} mm rms: allowed: "
            f"{1e3 * DISAGREE:g}; check anchors, attachments, pulley radius and the lengths' zero"
        )
    _check_directions(lengths.name, t[kept], u[kept])
    target = (p + turn.apply(robot.tracker.target))[kept]
    found = Table(t[kept], dict(zip("xyz", target.T, strict=True)), lengths.name)
    return FromLengths(found, residual if robot.n_cables > CABLES_MIN else 0.0, int(np.sum(~kept)))
