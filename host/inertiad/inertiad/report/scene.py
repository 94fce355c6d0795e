# SPDX-License-Identifier: Apache-2.0
"""The platform in space: its cables, the centre of gravity, the ellipsoid of inertia; world axes, m.

Shapes are those of model/solid.py. Both views are true to scale.
"""

import numpy as np

from inertiad.base.body import Body
from inertiad.base.table import Array
from inertiad.model import solid
from inertiad.report.figure import Color, Dots3, Mesh3, Path3, Scene, View
from inertiad.report.report_data import Facts
from inertiad.robot.description import Robot
from inertiad.run import reader
from inertiad.run.platform_pose import cable_ends

N_AROUND, N_UP = 28, 14
LABEL_ROOM = 0.12
"""of a set of points, its extent: closer ones share a label"""
REACH = 1.5
"""of the close view, sizes of the platform"""
GAP = np.full((1, 3), np.nan)


def _sphere() -> tuple[Array, Array]:
    """Points [N, 3] and triangles [K, 3] of a unit sphere."""
    up, around = np.linspace(0.0, np.pi, N_UP), np.linspace(0.0, 2.0 * np.pi, N_AROUND, endpoint=False)
    a, b = np.meshgrid(up, around, indexing="ij")
    points = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(N_UP - 1), np.arange(N_AROUND), indexing="ij")
    k = (j + 1) % N_AROUND
    first, second = i * N_AROUND + j, i * N_AROUND + k
    third, fourth = first + N_AROUND, second + N_AROUND
    pieces = np.concatenate([np.stack([first, second, fourth], -1), np.stack([first, fourth, third], -1)])
    return points, pieces.reshape(-1, 3)


def _circles() -> Array:
    """The three principal circles of a unit sphere, NaN between them [N, 3]."""
    a = np.linspace(0.0, 2.0 * np.pi, 2 * N_AROUND)
    c, s, o = np.cos(a), np.sin(a), np.zeros_like(a)
    return np.concatenate(
        [np.column_stack([c, s, o]), GAP, np.column_stack([o, c, s]), GAP, np.column_stack([s, o, c])]
    )


def _ellipsoid(body: Body, p: Array, R: Array, name: str, color: Color, is_solid: bool) -> list[Mesh3 | Path3]:
    """Its three principal circles and, if solid, its surface."""
    found = solid.semi_axes(body)
    if found is None:
        return []
    size, axes = found

    def placed(points: Array) -> Array:
        return np.asarray(p + (np.array(body.value[1:4]) + points * size @ axes.T) @ R.T)

    marks: list[Mesh3 | Path3] = [Path3(placed(_circles()), name, color, 3.0)]
    points, triangles = _sphere()
    return [*marks, Mesh3(placed(points), triangles, "", color, 0.22)] if is_solid else marks


def platform(robot: Robot, p: Array, R: Array) -> list[Path3 | Mesh3 | Dots3]:
    """Attachments with their numbers, and their hull where it is a solid."""
    corner = p + np.array([c.attachment for c in robot.cable]) @ R.T
    labels = merged_labels(corner, LABEL_ROOM * float(np.ptp(corner, axis=0).max()))
    marks: list[Path3 | Mesh3 | Dots3] = [Dots3(corner, labels, "attachments", "ink", 3.0, "near", in_legend=False)]
    shape = solid.hull(np.array([c.attachment for c in robot.cable]))
    if shape is None:
        return marks
    marks.append(Mesh3(corner, np.array(shape.triangles), "platform", "muted", 0.25))
    return [*marks, Path3(edges(corner, shape), "", "muted", 2.0)]


def edges(points: Array, shape: solid.Hull) -> Array:
    """Edges of the hull of points, NaN between them [N, 3]."""
    return np.concatenate([np.concatenate([points[edge], GAP]) for edge in shape.edges])


def merged_labels(points: Array, room: float) -> list[str]:
    """Numbers 1.. of points [N, 3]; points within `room` of an earlier one share its label."""
    numbers: list[list[int]] = [[] for _ in points]
    for i, point in enumerate(points):
        first = next(k for k in range(i + 1) if k == i or (numbers[k] and np.linalg.norm(points[k] - point) < room))
        numbers[first].append(i + 1)
    return [", ".join(map(str, mine)) for mine in numbers]


def _cables(facts: Facts, p: Array, R: Array) -> list[Path3 | Dots3]:
    robot = facts.robot
    attachments, anchors = (np.array([getattr(c, key) for c in robot.cable]) for key in ("attachment", "anchor"))
    core = reader.config_of(robot, robot.name)
    [corner], [leave] = cable_ends(core, attachments, anchors, p[None], R[None])
    check = facts.force_check
    marks: list[Path3 | Dots3] = []
    for i in range(robot.n_cables):
        is_worst = check is not None and check.worst == i
        color: Color = "muted"
        if is_worst and check is not None:
            color = "care" if check.broken is None else "bad"
        rms = f", residual {check.rms[i]:.2g} N" if check is not None else ""
        ends = np.array([corner[i], leave[i]])
        marks.append(Path3(ends, f"cable {i + 1}{rms}", color, 6.0 if is_worst else 3.0, in_legend=is_worst))
    labels = merged_labels(leave, LABEL_ROOM * float(np.ptp(leave, axis=0).max()))
    marks.append(Dots3(leave, labels, "pulleys", "ink", 3.0, "far", in_legend=False))
    return marks


def triad(p: Array, R: Array, length: float, name: str, color: Color = "ink", in_legend: bool = True) -> Path3:
    """The three axes of a frame at p [3] whose columns are R [3, 3], m."""
    lines = np.concatenate([np.concatenate([p[None], e[None], GAP]) for e in p + length * R.T])
    return Path3(lines, name, color, 4.0, in_legend=in_legend)


def _pose(facts: Facts) -> tuple[Array, Array]:
    """Of the platform in the picture: where it was most upright."""
    motion = facts.motions[0]
    at = int(np.argmax(motion.R[:, 2, 2]))
    return motion.position[at], motion.R[at]


def _three(v: Array) -> tuple[float, float, float]:
    x, y, z = v.tolist()
    return x, y, z


def views(robot: Robot, p: Array, size: float) -> list[View]:
    """The platform of a size [m] at p [3], and the whole robot."""
    anchors = np.array([c.anchor for c in robot.cable])
    low, high = np.minimum(anchors.min(axis=0), p - size), np.maximum(anchors.max(axis=0), p + size)
    near = View("platform", _three(p - REACH * size), _three(p + REACH * size))
    return [near, View("whole robot", _three(low - 0.3), _three(high + 0.3), is_far=True)]


def scene(facts: Facts) -> Scene | None:
    """None where nothing was identified or the platform never had a pose."""
    if facts.joint is None or not facts.motions or not len(facts.motions[0].t):
        return None
    p, R = _pose(facts)
    body, robot = facts.joint.body, facts.robot
    size = float(np.linalg.norm([c.attachment for c in robot.cable], axis=1).max())
    cog = p + R @ np.array(body.value[1:4])
    sigma = " / ".join(f"{1e3 * s:.2g}" for s in body.std[1:4])
    marks: list[Path3 | Mesh3 | Dots3] = [
        *platform(robot, p, R),
        *_cables(facts, p, R),
        triad(p, R, 0.5 * size, "axes of P", in_legend=False),
    ]
    marks += _ellipsoid(body, p, R, "ellipsoid of inertia", "estimate", is_solid=True)
    marks.append(Dots3(cog[None], ["C"], f"CoG, ± {sigma} mm", "estimate", 7.0))
    other = facts.truth or facts.nominal
    if other is not None:
        name = "truth" if facts.truth is not None else "nominal"
        marks += _ellipsoid(other, p, R, f"{name}", "truth", is_solid=False)
        place = (p + R @ np.array(other.value[1:4]))[None]
        marks.append(Dots3(place, [""], f"{name}: CoG", "truth", 5.0, in_legend=False))
    for number, motion in enumerate(facts.motions):
        which = f", run {number + 1}" if len(facts.motions) > 1 else ""
        marks.append(Path3(motion.position, f"path of P{which}", number, 2.0, "far"))
    found = solid.semi_axes(body)
    sizes = "" if found is None else f" Its semi-axes: {', '.join(f'{a:.2f}' for a in sorted(found[0])[::-1])} m."
    return Scene(
        "platform",
        "Platform, centre of gravity, inertia",
        f"The uniform ellipsoid with the identified mass and inertia, on the platform.{sizes} "
        f"CoG ± {sigma} mm (one sigma). Drag to turn, scroll to zoom.",
        marks,
        views(robot, p, size),
    )
