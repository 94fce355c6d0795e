# SPDX-License-Identifier: Apache-2.0
"""A run as Foxglove's own messages, so that Foxglove and Lichtblick show the robot without a plug-in.

/tf             FrameTransform   world -> platform, as measured
/platform/pose  PoseInFrame      the same in world
/robot          SceneUpdate      pulleys in world, hull of the attachments in platform: once
/cables         SceneUpdate      lines from attachment to pulley, coloured by tension against the cable's limits
/body           SceneUpdate      ellipsoid of inertia, CoG and mass, in platform: with each estimate
Motion at most RATE times a second. Protobuf, schemas of the package foxglove-schemas-protobuf.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from inertiad.base import quantity
from inertiad.base.body import Body
from inertiad.base.table import Array, Table
from inertiad.exchange.dataset import INERTIA, Dataset
from inertiad.model import solid
from inertiad.model.tension_color import color
from inertiad.robot.description import Robot
from inertiad.run import reader
from inertiad.run.platform_pose import cable_ends, platform_pose

RATE: Final = 30.0
"""Hz"""
ESTIMATE_RATE: Final = 5.0
WORLD: Final = "world"
PLATFORM: Final = "platform"
DOT: Final = 0.015
"""size of points, of the platform's reach times ten"""
TOPICS: Final = ("/tf", "/platform/pose", "/robot", "/cables", "/body")


@dataclass(frozen=True)
class Message:
    """One message of a topic."""

    topic: str
    t_ns: int
    data: Any
    """of a class of foxglove_schemas_protobuf"""


def _thinned(table: Table, rate: float) -> NDArray[np.int64]:
    """Indices of rows at most `rate` times a second."""
    slot = ((table.t_ns - table.t_ns[0]) * rate / 1e9).astype(np.int64)
    return np.unique(slot, return_index=True)[1].astype(np.int64)


def _classes() -> Any:
    """Foxglove's message classes. ImportError: the package is not installed."""
    from foxglove_schemas_protobuf import FrameTransform_pb2, PoseInFrame_pb2, SceneUpdate_pb2

    return FrameTransform_pb2.FrameTransform, PoseInFrame_pb2.PoseInFrame, SceneUpdate_pb2.SceneUpdate


def _stamp(message: Any, t_ns: int) -> None:
    message.timestamp.FromNanoseconds(t_ns)


def _set(vector: Any, values: Any) -> None:
    for name, value in zip("xyzw", values, strict=False):
        setattr(vector, name, float(value))


def _paint(target: Any, rgb: tuple[int, int, int], alpha: float = 1.0) -> None:
    target.r, target.g, target.b = (v / 255.0 for v in rgb)
    target.a = alpha


def _entity(scene: Any, name: str, frame: str, t_ns: int) -> Any:
    made = scene.entities.add()
    _stamp(made, t_ns)
    made.frame_id, made.id, made.frame_locked = frame, name, True
    return made


def _dot(entity: Any, place: Any, size: float, rgb: tuple[int, int, int]) -> None:
    made = entity.spheres.add()
    _set(made.pose.position, place)
    made.pose.orientation.w = 1.0
    _set(made.size, [size] * 3)
    _paint(made.color, rgb)


def _robot(Scene: Any, robot: Robot, t_ns: int) -> Any:
    scene = Scene()
    attachment = np.array([c.attachment for c in robot.cable])
    size = 10.0 * DOT * float(np.linalg.norm(attachment, axis=1).max())
    pulleys = _entity(scene, "pulleys", WORLD, t_ns)
    for k, cable in enumerate(robot.cable):
        _dot(pulleys, cable.anchor, size, (120, 130, 145))
        text = pulleys.texts.add()
        _set(text.pose.position, np.add(cable.anchor, (0.0, 0.0, size)))
        text.pose.orientation.w = 1.0
        text.text, text.font_size, text.billboard, text.scale_invariant = str(k + 1), 14.0, True, True
        _paint(text.color, (120, 130, 145))
    shape = solid.hull(attachment)
    body = _entity(scene, "platform", PLATFORM, t_ns)
    if shape is not None:
        faces = body.triangles.add()
        faces.pose.orientation.w = 1.0
        for point in attachment:
            _set(faces.points.add(), point)
        faces.indices.extend(i for triangle in shape.triangles for i in triangle)
        _paint(faces.color, (120, 130, 145), 0.35)
        _lines(body, attachment[np.array(shape.edges).ravel()], [(120, 130, 145)])
    return scene


def _lines(entity: Any, ends: Array, colors: list[tuple[int, int, int]]) -> None:
    """Lines between pairs of points [2 n, 3]; one colour for all, or one per point."""
    made = entity.lines.add()
    made.type = made.LINE_LIST
    made.pose.orientation.w = 1.0
    made.thickness, made.scale_invariant = 2.0, True
    for point in ends:
        _set(made.points.add(), point)
    if len(colors) == 1:
        _paint(made.color, colors[0])
    else:
        for rgb in colors:
            _paint(made.colors.add(), rgb)


def _motion(data: Dataset, robot: Robot) -> Iterator[Message]:
    signals = data.tables["signals"]
    at = _thinned(signals, RATE)
    q, position = signals.stack(*quantity.QUATERNION)[at], signals.stack(*quantity.POSITION)[at]
    f = signals.stack(*quantity.forces(robot.n_cables))[at]
    good = (np.abs(q).max(axis=1) > 0.0) & np.isfinite(np.column_stack([q, position, f])).all(axis=1)
    at, q, position, f = at[good], q[good], position[good], f[good]
    if not len(at):
        return
    Transform, Pose, Scene = _classes()
    p, turn = platform_pose(q, position, robot.imu.orientation, robot.tracker.target)
    attachments, anchors = (np.array([getattr(c, key) for c in robot.cable]) for key in ("attachment", "anchor"))
    corner, leave = cable_ends(reader.config_of(robot, robot.name), attachments, anchors, p, turn.as_matrix())
    quaternion = turn.as_quat()
    yield Message("/robot", int(signals.t_ns[at[0]]), _robot(Scene, robot, int(signals.t_ns[at[0]])))
    for k, row in enumerate(at.tolist()):
        t_ns = int(signals.t_ns[row])
        transform, pose, scene = Transform(), Pose(), Scene()
        _stamp(transform, t_ns)
        transform.parent_frame_id, transform.child_frame_id = WORLD, PLATFORM
        _set(transform.translation, p[k])
        _set(transform.rotation, quaternion[k])
        _stamp(pose, t_ns)
        pose.frame_id = WORLD
        _set(pose.pose.position, p[k])
        _set(pose.pose.orientation, quaternion[k])
        colors = [color(v, c.tension_min, c.tension_max) for v, c in zip(f[k].tolist(), robot.cable, strict=True)]
        ends = np.stack([corner[k], leave[k]], axis=1).reshape(-1, 3)
        _lines(_entity(scene, "cables", WORLD, t_ns), ends, [rgb for rgb in colors for _ in range(2)])
        for topic, message in (("/tf", transform), ("/platform/pose", pose), ("/cables", scene)):
            yield Message(topic, t_ns, message)


def _bodies(data: Dataset, robot: Robot) -> Iterator[Message]:
    """The estimate as ellipsoid, dot and text."""
    _, _, Scene = _classes()
    table = data.tables["estimate"]
    names = ("mass", *(f"cog_{a}" for a in "xyz"), *(f"inertia_cog_{e}" for e in INERTIA))
    value, std = table.stack(*names), table.stack(*(f"{name}_std" for name in names))
    size = 10.0 * DOT * max(float(np.linalg.norm(c.attachment)) for c in robot.cable)
    for row in _thinned(table, ESTIMATE_RATE).tolist():
        if not np.isfinite(value[row]).all():
            continue
        t_ns, scene = int(table.t_ns[row]), Scene()
        entity = _entity(scene, "body", PLATFORM, t_ns)
        cog = value[row, 1:4]
        _dot(entity, cog, size, (31, 95, 168))
        text = entity.texts.add()
        _set(text.pose.position, np.add(cog, (0.0, 0.0, 2.0 * size)))
        text.pose.orientation.w = 1.0
        text.text = f"{value[row, 0]:.2f} ± {std[row, 0]:.2f} kg"
        text.font_size, text.billboard, text.scale_invariant = 14.0, True, True
        _paint(text.color, (31, 95, 168))
        _ellipsoid(entity, Body(tuple(value[row].tolist()), tuple(std[row].tolist())))
        yield Message("/body", t_ns, scene)


def _ellipsoid(entity: Any, body: Body) -> None:
    found = solid.semi_axes(body)
    if found is None:
        return
    axes = found[1] * np.sign(np.linalg.det(found[1]))  # a rotation, no reflection
    made = entity.spheres.add()
    _set(made.pose.position, body.value[1:4])
    _set(made.pose.orientation, Rotation.from_matrix(axes).as_quat())
    _set(made.size, 2.0 * found[0])
    _paint(made.color, (31, 95, 168), 0.3)


def messages(data: Dataset, robot: Robot) -> Iterator[Message]:
    """Foxglove's messages of a run of this robot, topic by topic. ImportError: their package is not installed."""
    if "signals" in data.tables and len(quantity.forces(robot.n_cables)) == _n_forces(data.tables["signals"]):
        yield from _motion(data, robot)
    if "estimate" in data.tables:
        yield from _bodies(data, robot)


def _n_forces(signals: Table) -> int:
    wanted = (*quantity.QUATERNION, *quantity.POSITION)
    has_pose = all(name in signals.columns for name in wanted)
    return sum(name.startswith("f_") for name in signals.columns) if has_pose else -1
