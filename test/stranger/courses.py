# SPDX-License-Identifier: Apache-2.0
"""Courses of events: the platform follows a motion exactly, and the cables pull as they must."""

from dataclasses import replace

import numpy as np
from mechanics import Track, needed_wrench, run_of, tensions, track_of
from motions import Motion
from robots import Body, Robot
from scipy.interpolate import make_interp_spline
from sensors import Course, Draws, Faults

FINE = 400.0
"""Hz of a course; a quarter of it where the sensors are slow, too"""
COARSE = 100.0
"""Hz at which tensions are solved; they are splines in between; half of it for a slow course"""
SLOW = 100.0
"""Hz: sensors below are slow"""


class CannotMove(Exception):
    """The motion asks a cable to push, or for more than it holds."""


def pushes_of(robot: Robot, faults: Faults, draws: Draws, t: np.ndarray) -> np.ndarray:
    """Force [N, 3], W, of somebody who leans on the platform now and then."""
    force = np.zeros((len(t), 3))
    if faults.pushes:
        for start in np.sort(draws.dice.uniform(0.2, 0.85, 6)) * t[-1]:
            length = draws.dice.uniform(0.8, 2.0)
            s = np.clip((t - start) / length, 0.0, 1.0)
            force += faults.pushes * np.sin(np.pi * s)[:, None] ** 2 * draws.direction() * [1.0, 1.0, 0.4]
    return force


HOSE_AT = np.array([0.3, -0.2, 0.4])
"""m, in units of the platform's size: where the hose is fixed"""


def outside_wrench(robot: Robot, faults: Faults, draws: Draws, track: Track) -> np.ndarray:
    """Wrench about P, W [N, 6], that others than cables and gravity put on the platform."""
    arm = track.R @ (HOSE_AT * robot.size)
    hose = np.zeros_like(track.p)
    if faults.hose:
        pull = faults.hose * draws.direction() * [0.6, 0.6, 1.0]
        hose = pull - 0.2 * faults.hose * (track.p + arm - robot.home)
        draws.drawn["hose"] = pull.tolist()
    push = pushes_of(robot, faults, draws, track.t)
    lean = track.R @ (np.array([0.5, 0.3, 0.2]) * robot.size)
    return np.hstack([hose + push, np.cross(arm, hose) + np.cross(lean, push)])


def follow(
    robot: Robot, bodies: list[Body], change: float, motion: Motion, geometry: tuple[np.ndarray, np.ndarray],
    faults: Faults, draws: Draws,
) -> Course:  # fmt: skip
    """The motion, exactly. bodies: before and, where there are two, from the time `change` [s] on.

    CannotMove: a tension outside the robot's limits.
    """
    coarse_dt, fine_dt = (1.0 / COARSE, 1.0 / FINE) if robot.rate >= SLOW else (2.0 / COARSE, 4.0 / FINE)
    coarse = track_of(motion, np.arange(0.0, motion.duration, coarse_dt))
    cables = run_of(robot, coarse.p, coarse.R, *geometry)
    w = robot.weight_per_length if faults.cable_weight is None else faults.cable_weight
    outside = outside_wrench(robot, faults, draws, coarse)
    fine = track_of(motion, np.arange(0.0, motion.duration - coarse_dt, fine_dt))
    per_body = []
    for body in bodies:
        wrench = needed_wrench(coarse, body) - outside
        f, remains = tensions(robot, cables, coarse.p, wrench, w)
        if f.min() < robot.tension[0] or f.max() > robot.tension[1] or remains.max() > 1e-3 * np.abs(wrench).max():
            raise CannotMove(f"{robot.name}: tensions {f.min():.1f} to {f.max():.1f} N")
        per_body.append(make_interp_spline(coarse.t, f, k=5)(fine.t))
    tension = per_body[0] if len(bodies) == 1 else np.where(fine.t[:, None] < change, *per_body)
    rise = make_interp_spline(coarse.t, cables.leave[..., 2] - cables.attachment[..., 2], k=5)(fine.t)
    wrap, length = (make_interp_spline(coarse.t, x, k=5)(fine.t) for x in (cables.wrap, cables.length))
    return Course(fine, tension, tension + w * rise, wrap, length)


def shrunk(make, tries: int = 12) -> Course:  # type: ignore[no-untyped-def]
    """make(scale) with the largest of 1, 0.85, 0.85^2 ... that the cables can do."""
    for k in range(tries):
        try:
            course = make(0.85**k)
        except CannotMove as error:
            last = error
            continue
        return replace(course, events={**course.events, "scale": 0.85**k})
    raise last
