# SPDX-License-Identifier: Apache-2.0
"""A page on a robot description: the robot in space with sensors and workspace, each cable, what looks wrong.

With a run also the path of the platform; the platform is drawn where it was most upright, else in the middle of the
usual workspace, level.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.finding import Finding, lines, ordered, verdict
from inertiad.base.table import Array
from inertiad.model import inverse_dynamics, solid
from inertiad.model.inverse_dynamics import Mechanics
from inertiad.model.trajectory import Motion
from inertiad.report import page, provenance, scene
from inertiad.report.figure import Dots3, Figure, Mesh3, Panel, Path3, Scene, Table, View, line
from inertiad.report.page import Page, Section, Tile
from inertiad.report.report_data import Progress
from inertiad.report.scene import GAP
from inertiad.report.verdict import Verdict
from inertiad.robot import configuration, description, geometry, stand_in
from inertiad.robot.description import Robot
from inertiad.robot.stand_in import Completed
from inertiad.run import platform_pose, reader

STEPS: Final = 11
"""places along each edge of the anchors' hull box at which tensions are looked for"""
AROUND: Final = np.linspace(0.0, 2.0 * np.pi, 33)
HEADLINES: Final = {
    "good": "Nothing implausible in the description",
    "care": "Check the description",
    "stop": "The run does not fit the description",
}
Marks = list[Path3 | Mesh3 | Dots3]


@dataclass(frozen=True)
class Shown:
    """A robot as it is drawn."""

    robot: Robot
    config: bytes
    """contents of robot.cfg"""
    completed: Completed
    p: Array
    """of P in W, m [3]"""
    R: Array
    """P to W [3, 3]"""
    path: Array
    """of P in W, m [N, 3]; none without a run"""
    t: Array
    """s [N]"""
    findings: tuple[Finding, ...]

    @cached_property
    def mechanics(self) -> Mechanics:
        config = inertiad_core.Config(configuration.compile_robot(self.completed.robot, self.robot.name))
        return Mechanics(config, self.completed.robot, self.completed.body)


# ---- data ------------------------------------------------------------------------------------------------------------


def _path(run: Path, robot: Robot) -> tuple[Array, Array, Array]:
    """Time [N], place [N, 3] of P and rotation [N, 3, 3] P to W, of a run's rows."""
    rows = reader.read_as(run, robot).rows
    p, turn = platform_pose.platform_pose(rows.q, rows.position, robot.imu.orientation, robot.tracker.target)
    return rows.t - rows.t[0], p, turn.as_matrix()


def _of_run(source: Path, robot: Robot) -> tuple[Array, Array, Array, list[Finding]]:
    """_path() of a source that is a run; nothing, and a finding, where it cannot be read."""
    none = np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))
    if not source.is_dir():
        return *none, []
    try:
        return *_path(source, robot), []
    except InputError as error:
        return *none, [Finding("unusable_run", "stop", str(error), "mend the run, or view its robot.toml alone")]


def read(source: Path) -> Shown:
    """A robot.toml, or a run folder with one. InputError: see description.load(), geometry.compiled()."""
    file = source / "robot.toml" if source.is_dir() else source
    robot = description.load(file)
    config, suspicious = geometry.compiled(robot, str(file))
    t, path, R, problems = _of_run(source, robot)
    edges = geometry.box(robot)
    place, turn = 0.5 * (edges[:3] + edges[3:]), np.eye(3)
    if len(path):
        upright = int(np.argmax(R[:, 2, 2]))
        place, turn = path[upright], R[upright]
    found = [*problems, *suspicious]
    return Shown(robot, config, stand_in.complete(robot), place, turn, path, t, tuple(ordered(found)))


def _can_hold(mechanics: Mechanics, places: Array) -> Array:
    """At which places [N, 3] tensions within the limits hold the level platform at rest [N]."""
    n, none = len(places), np.zeros((1, 3))
    held = np.zeros(n, dtype=bool)
    for k in range(n):
        rest = Motion(places[k : k + 1], none, none, np.eye(3)[None], none, none)
        try:
            inverse_dynamics.tensions(mechanics, np.zeros(1), rest)
        except InputError:
            continue
        held[k] = True
    return held


def _largest_box(held: Array) -> tuple[Array, Array] | None:
    """First and last index [3] of the largest block of a grid [nx, ny, nz] that is all True; None: no cell."""
    total = np.pad(held.astype(int), ((1, 0), (1, 0), (1, 0))).cumsum(0).cumsum(1).cumsum(2)
    n = held.shape[0]
    low, high = np.triu_indices(n)
    size = high - low + 1
    best, most = None, 0
    for k, (z0, z1) in enumerate(zip(low, high, strict=True)):
        flat = total[:, :, z1 + 1] - total[:, :, z0]
        count = (
            flat[np.ix_(high + 1, high + 1)]
            - flat[np.ix_(low, high + 1)]
            - flat[np.ix_(high + 1, low)]
            + flat[np.ix_(low, low)]
        )
        volume = np.where(count == np.multiply.outer(size, size) * size[k], count, 0)
        if volume.max() > most:
            i, j = np.unravel_index(int(np.argmax(volume)), volume.shape)
            most = int(volume.max())
            best = np.array([low[i], low[j], z0]), np.array([high[i], high[j], z1])
    return best


def feasible_box(shown: Shown) -> Array | None:
    """Least and greatest x y z [6] of P, m, of the largest box of places at which the level platform can be held.

    None: fewer than six cables, which hold no pose, or no such place.
    """
    robot = shown.robot
    if robot.n_cables < 6:
        return None
    ends = np.array([cable.anchor for cable in robot.cable])
    low, high = ends.min(axis=0), ends.max(axis=0)
    usual = geometry.box(robot)
    low, high = np.minimum(low, usual[:3]), np.maximum(high, usual[3:])
    low[2] = max(low[2], min(0.0, float(ends[:, 2].min())))
    axes = [np.linspace(low[i], high[i], STEPS) for i in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    block = _largest_box(_can_hold(shown.mechanics, grid).reshape(STEPS, STEPS, STEPS))
    if block is None:
        return None
    return np.array([axes[i][index[i]] for index in block for i in range(3)])


# ---- scene -----------------------------------------------------------------------------------------------------------


def _corners(low: Array, high: Array) -> Array:
    """The edges of a box as a path [N, 3]."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    points = low + corner * (high - low)
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(corner[a] - corner[b]).sum() == 1]
    return np.concatenate([np.concatenate([points[[a, b]], GAP]) for a, b in pairs])


def _hull(points: Array) -> Array:
    """Edges of the hull of places, or their outline where they lie in one plane [N, 3]; nothing for a line."""
    shape = solid.hull(points)
    if shape is not None:
        return scene.edges(points, shape)
    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    try:
        order = ConvexHull(centred @ axes[:2].T).vertices
    except (QhullError, ValueError):
        return np.zeros((0, 3))
    return np.asarray(points[[*order, order[0]]])


def _pulley(anchor: Array, swivel: Array, radius: float, towards: Array) -> Array:
    """The circle of a pulley that turned towards a place [3]."""
    away = towards - anchor
    across = away - swivel * (away @ swivel)
    across /= max(float(np.linalg.norm(across)), 1e-9)
    centre = anchor + radius * across
    turn = np.multiply.outer(np.cos(AROUND), across) + np.multiply.outer(np.sin(AROUND), swivel)
    return np.asarray(centre + radius * turn)


def _cables(shown: Shown, corner: Array, leave: Array) -> Marks:
    """Cables and pulleys, numbered at the anchors; without entries in the legend."""
    robot = shown.robot
    marks: Marks = []
    for i, cable in enumerate(robot.cable):
        marks.append(Path3(np.array([corner[i], leave[i]]), "", i, 4.0))
        if cable.pulley_radius > 0.0:
            swivel, anchor = np.array(cable.swivel_axis), np.array(cable.anchor)
            marks.append(Path3(_pulley(anchor, swivel, cable.pulley_radius, corner[i]), "", i, 3.0))
    anchors = np.array([cable.anchor for cable in robot.cable])
    marks.append(Dots3(anchors, [str(i + 1) for i in range(robot.n_cables)], "anchors", "ink", 4.0))
    return marks


def _sensors(shown: Shown, size: float) -> Marks:
    robot, p, R = shown.robot, shown.p, shown.R
    R_PI = Rotation.from_quat(robot.imu.orientation, scalar_first=True).as_matrix()
    marks: Marks = [
        scene.triad(p, R, 0.5 * size, "axes of P"),
        scene.triad(p + R @ np.array(robot.imu.position), R @ R_PI, 0.35 * size, "axes of the IMU", "estimate"),
        Dots3((p + R @ np.array(robot.tracker.target))[None], ["T"], "tracked point", "care", 5.0),
    ]
    if robot.nominal is not None:
        marks.append(Dots3((p + R @ np.array(robot.nominal.cog))[None], ["C"], "nominal CoG", "truth", 5.0))
    return marks


def _platform(robot: Robot, p: Array, R: Array, corner: Array) -> Marks:
    """The hull of the attachments, or their outline where they lie in one plane."""
    marks = scene.platform(robot, p, R)
    outline = _hull(corner)
    is_solid = any(isinstance(mark, Mesh3) for mark in marks)
    return marks if is_solid or not len(outline) else [*marks, Path3(outline, "platform", "muted", 4.0)]


def _drawn(shown: Shown, edges: Array | None) -> Scene:
    robot, p, R = shown.robot, shown.p, shown.R
    attachments, anchors = (np.array([getattr(c, key) for c in robot.cable]) for key in ("attachment", "anchor"))
    core = inertiad_core.Config(shown.config)
    [corner], [leave] = platform_pose.cable_ends(core, attachments, anchors, p[None], R[None])
    size = max(float(np.linalg.norm(attachments, axis=1).max()), 0.05)
    marks: Marks = [
        *_platform(robot, p, R, corner),
        *_cables(shown, corner, leave),
        *_sensors(shown, size),
        scene.triad(np.zeros(3), np.eye(3), 0.15 * float(np.ptp(anchors, axis=0).max()), "axes of W", "muted"),
    ]
    frame = _hull(anchors)
    if len(frame):
        marks.append(Path3(frame, "hull of the anchors", "muted", 2.0, where="far"))
    if edges is not None:
        marks.append(Path3(_corners(edges[:3], edges[3:]), "box where tensions hold it", "good", 3.0, where="far"))
    if len(shown.path):
        marks.append(Path3(shown.path[:: max(1, len(shown.path) // 2000)], "path of P", "estimate", 3.0, where="far"))
    near, whole = scene.views(robot, p, size)
    low, high = np.minimum(whole.low, 0.0), np.maximum(whole.high, 0.0)
    whole = View(whole.name, tuple(low.tolist()), tuple(high.tolist()), is_far=True)
    return Scene(
        "robot",
        "The robot",
        "World axes, m. P: platform frame, T: tracked point, C: nominal CoG; numbers: cables, at both ends. "
        f"{_place_text(shown)} Drag to turn, scroll to zoom.",
        marks,
        [whole, near],
    )


def _place_text(shown: Shown) -> str:
    x, y, z = shown.p
    where = "where the run has it most upright" if len(shown.path) else "level, in the middle of the usual workspace"
    return f"The platform is drawn {where}: P at {x:.2f}, {y:.2f}, {z:.2f} m."


# ---- page ------------------------------------------------------------------------------------------------------------


def _lines(shown: Shown) -> list[tuple[float, float]] | None:
    """Length [m] and elevation [deg] of each cable; None where one has no direction."""
    core = inertiad_core.Config(shown.config)
    try:
        u, _, length = inertiad_core.cable_geometry(core, shown.p[None], shown.R[None])
    except ValueError:
        return None
    elevation = np.rad2deg(np.arcsin(np.clip(u[0][:, 2], -1.0, 1.0)))
    return list(zip(length[0].tolist(), elevation.tolist(), strict=True))


def _cable_table(shown: Shown) -> Table:
    robot = shown.robot
    lines = _lines(shown)
    tension = None if lines is None else _rest_tensions(shown)
    rows = []
    for i, cable in enumerate(robot.cable):
        place, fixed = (", ".join(f"{v:.4g}" for v in triple) for triple in (cable.anchor, cable.attachment))
        held = [] if tension is None else [f"{tension[i]:.4g}"]
        line = [] if lines is None else [f"{lines[i][0]:.3f}", f"{lines[i][1]:.1f}"]
        rows.append([str(i + 1), place, fixed, *line, *held])
    mass = shown.completed.body.mass
    foot = f"Tension: at rest in this place, platform of {mass:g} kg, the most even pull."
    if tension is None:
        foot = "No tensions within their limits hold the platform at rest in this place and attitude."
        if robot.n_cables < 6:
            foot = "Fewer than six cables: the platform hangs as its weight wants, in no pose of choice."
    head = ["cable", "anchor in W, m", "attachment in P, m", "length, m", "elevation, °"]
    if lines is None:
        return Table(
            head[:3], rows, foot="A cable has no direction in this place: its attachment is inside its pulley."
        )
    return Table(head if tension is None else [*head, "tension, N"], rows, foot=foot)


def _rest_tensions(shown: Shown) -> Array | None:
    none = np.zeros((1, 3))
    rest = Motion(shown.p[None], none, none, shown.R[None], none, none)
    try:
        return np.asarray(inverse_dynamics.tensions(shown.mechanics, np.zeros(1), rest)[0])
    except InputError:
        return None


def _tiles(shown: Shown, edges: Array | None) -> list[Tile]:
    robot = shown.robot
    span = np.ptp([cable.anchor for cable in robot.cable], axis=0)
    body = shown.completed.body
    tiles = [
        Tile("cables", str(robot.n_cables), "", f"anchors span {' x '.join(f'{v:.3g}' for v in span)} m"),
        Tile("platform", f"{body.mass:.4g}", "kg", "[nominal]" if robot.nominal else "assumed: no [nominal]"),
    ]
    if edges is not None:
        size = " x ".join(f"{v:.3g}" for v in edges[3:] - edges[:3])
        corners = ", ".join(f"{v:.2f}" for v in edges[:3]), ", ".join(f"{v:.2f}" for v in edges[3:])
        tiles.append(Tile("box where tensions hold it, level", size, "m", f"P from {corners[0]} to {corners[1]} m"))
    return tiles


def _motion(shown: Shown) -> list[Section]:
    if not len(shown.path):
        return []
    marks = [line(shown.t, shown.path[:, i], name, i) for i, name in enumerate("xyz")]
    panel = Panel([*marks], x="t, s", y="P in W, m")
    low, high = shown.path.min(axis=0), shown.path.max(axis=0)
    ranges = ", ".join(f"{n} {a:.2f} to {b:.2f}" for n, a, b in zip("xyz", low, high, strict=True))
    figure = Figure("motion", "Motion", f"Place of P over {shown.t[-1]:.1f} s: {ranges} m.", [panel])
    return [Section("motion", "Motion", [figure])]


def page_of(shown: Shown, command: str) -> Page:
    """The whole page."""
    severity = verdict(shown.findings)
    edges = feasible_box(shown)
    origin = [["command", command], *[[name, value] for name, value in provenance.versions()]]
    return Page(
        f"{shown.robot.name}: robot description",
        f"{shown.robot.n_cables} cables",
        Verdict(severity, HEADLINES[severity], list(shown.findings)),
        _tiles(shown, edges),
        [
            Section("robot", "The robot", [_drawn(shown, edges), *shown.completed.remarks]),
            Section("cables", "Cables", [_cable_table(shown)]),
            *_motion(shown),
            Section("provenance", "Provenance", [Table(["", ""], origin, numbers=False)]),
        ],
    )


def write(source: Path, output: Path, command: str, progress: Progress) -> list[str]:
    """Write the page; returns what looks wrong, a line each. InputError: see read()."""
    progress("read")
    shown = read(source)
    progress("draw")
    output.write_text(page.render(page_of(shown, command)), encoding="utf-8")
    return lines(shown.findings)[1:]
