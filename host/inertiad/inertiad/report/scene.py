# SPDX-License-Identifier: Apache-2.0
"""The platform in space: its cables, the centre of gravity, the ellipsoid of inertia; world axes, m.

The ellipsoid is the uniform one with the identified mass and inertia: semi-axes a_i^2 = 5/(2 m) (J_j + J_k - J_i) along
the principal axes. It shows the distribution of the mass, to scale with the platform.
"""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

import inertiad_core
from inertiad.base.body import Body
from inertiad.base.table import Array
from inertiad.report.figure import Color, Dots3, Mesh3, Path3, Scene, View
from inertiad.report.report_data import Facts
from inertiad.robot.description import Robot
from inertiad.robot.keys import inertia_matrix
from inertiad.run import reader

N_AROUND, N_UP = 28, 14
FLAT = 0.999
"""cosine between facets from which they are one"""
REACH = 1.5
"""of the close view, sizes of the platform"""
GAP = np.full((1, 3), np.nan)


def semi_axes(body: Body) -> tuple[Array, Array] | None:
    """Semi-axes [3] m and principal axes [3, 3] (columns, P axes); None: no body has this inertia."""
    J, axes = np.linalg.eigh(inertia_matrix(np.array(body.value[4:])))
    square = 2.5 / body.value[0] * (J.sum() - 2.0 * J)
    return (np.sqrt(square), axes) if body.value[0] > 0.0 and (square > 0.0).all() else None


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
    found = semi_axes(body)
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
    labels = [str(i + 1) for i in range(len(corner))]
    marks: list[Path3 | Mesh3 | Dots3] = [Dots3(corner, labels, "attachments", "ink", 3.0)]
    try:
        hull = ConvexHull(corner)
    except (QhullError, ValueError):
        return marks  # flat or fewer than four points: no solid to draw
    marks.append(Mesh3(corner, hull.simplices, "platform", "muted", 0.25))
    return [*marks, Path3(edges(corner, hull), "", "muted", 2.0)]


def edges(corner: Array, hull: ConvexHull) -> Array:
    """Edges between facets that are not one plane, NaN between them [N, 3]."""
    pieces = []
    for a, neighbours in enumerate(hull.neighbors):
        for b in neighbours[neighbours > a]:
            if hull.equations[a, :3] @ hull.equations[b, :3] < FLAT:
                ends = np.intersect1d(hull.simplices[a], hull.simplices[b])
                pieces += [corner[ends], GAP]
    return np.concatenate(pieces)


def _cables(facts: Facts, p: Array, R: Array) -> list[Path3 | Dots3]:
    robot = facts.robot
    u, free, _ = inertiad_core.cable_geometry(reader.config_of(robot, robot.name), p[None], R[None])
    corner = p + np.array([c.attachment for c in robot.cable]) @ R.T
    leave = corner + u[0] * free[0][:, None]
    check = facts.force_check
    marks: list[Path3 | Dots3] = []
    for i in range(robot.n_cables):
        is_worst = check is not None and check.worst == i
        color: Color = "muted"
        if is_worst and check is not None:
            color = "care" if check.broken is None else "bad"
        rms = f", residual {check.rms[i]:.2g} N" if check is not None else ""
        marks.append(Path3(np.array([corner[i], leave[i]]), f"cable {i + 1}{rms}", color, 6.0 if is_worst else 3.0))
    marks.append(Dots3(leave, [f"winch {i + 1}" for i in range(robot.n_cables)], "winches", "ink", 3.0))
    return marks


def triad(p: Array, R: Array, length: float, name: str, color: Color = "ink") -> Path3:
    """The three axes of a frame at p [3] whose columns are R [3, 3], m."""
    ends = p + length * R.T
    return Path3(np.concatenate([np.concatenate([p[None], e[None], GAP]) for e in ends]), name, color, 4.0)


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
        triad(p, R, 0.5 * size, "axes of P"),
    ]
    marks += _ellipsoid(body, p, R, "ellipsoid of inertia", "estimate", is_solid=True)
    marks.append(Dots3(cog[None], ["C"], f"CoG, ± {sigma} mm", "estimate", 7.0))
    other = facts.truth or facts.nominal
    if other is not None:
        name = "truth" if facts.truth is not None else "nominal"
        marks += _ellipsoid(other, p, R, f"{name}: ellipsoid", "truth", is_solid=False)
        marks.append(Dots3((p + R @ np.array(other.value[1:4]))[None], [""], f"{name}: CoG", "truth", 5.0))
    for number, motion in enumerate(facts.motions):
        which = f", run {number + 1}" if len(facts.motions) > 1 else ""
        marks.append(Path3(motion.position, f"path of P{which}", number, 2.0, is_far=True))
    found = semi_axes(body)
    sizes = "" if found is None else f" Its semi-axes: {', '.join(f'{a:.2f}' for a in sorted(found[0])[::-1])} m."
    return Scene(
        "platform",
        "Platform, centre of gravity, inertia",
        f"The uniform ellipsoid with the identified mass and inertia, on the platform.{sizes} "
        f"CoG ± {sigma} mm (one sigma). Drag to turn, scroll to zoom.",
        marks,
        views(robot, p, size),
    )
