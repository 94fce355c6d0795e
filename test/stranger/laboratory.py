# SPDX-License-Identifier: Apache-2.0
"""A scene played once: the folder that a laboratory hands over (robot.toml, signals.csv, tracker.csv), and truth."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import motions
import numpy as np
from courses import follow, shrunk
from elastic import release
from robots import ROBOTS, Body, G, Robot, built_body, design_body
from sensors import Draws, Faults, Readings, read, true_geometry

NO_FAULTS = Faults()


@dataclass(frozen=True)
class Scene:
    """One kind of trouble on some robots."""

    name: str
    robots: tuple[str, ...]
    motion: str
    faults: Faults = NO_FAULTS
    duration: float = 30.0
    declare: dict[str, dict[str, Any]] = field(default_factory=dict)
    """tables and keys of robot.toml on top of the robot's own; what [std] declares is also drawn"""
    known: str = "residual"
    """what shows the fault: "declared" (drawn with the declared sigma), "residual", "silent" (no residual by nature)"""
    rate: float = 0.0
    """Hz of the sensors, 0: the robot's own"""


@dataclass(frozen=True)
class Run:
    """What one play of a scene left."""

    scene: Scene
    robot: Robot
    seed: int
    folder: Path
    truth: dict[str, Any]


def _number(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(_number(v) for v in value) + "]"
    return repr(float(value))


def robot_toml(robot: Robot, declare: dict[str, dict[str, Any]]) -> str:
    """The description that the laboratory writes, one key a line."""
    tables: dict[str, dict[str, Any]] = {
        "cables": {
            "pulley_radius": robot.pulley_radius,
            "weight_per_length": robot.weight_per_length,
            "tension_min": robot.tension[0],
            "tension_max": robot.tension[1],
        },
        "imu": {"position": robot.imu_position, "orientation": robot.imu_orientation},
        "tracker": {"target": robot.target},
    }
    if robot.force_at != "platform":
        tables["cables"]["force_at"] = robot.force_at
    if robot.has_nominal:
        tables["nominal"] = dict(design_body(robot).moments())
    tables["std"] = dict(robot.std)
    for table, keys in declare.items():
        tables.setdefault(table, {}).update(keys)
    lines = [f'name = "{robot.name}"', f"gravity = {G}"]
    for table, keys in tables.items():
        lines += ["", f"[{table}]"] + [f"{key} = {_number(value)}" for key, value in keys.items()]
    for anchor, attachment, axis in zip(robot.anchor, robot.attachment, robot.axis, strict=True):
        lines += ["", "[[cable]]", f"anchor = {_number(anchor)}", f"attachment = {_number(attachment)}"]
        lines += [f"swivel_axis = {_number(axis)}"]
    return "\n".join(lines) + "\n"


def _csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    rows = np.column_stack(list(columns.values()))
    text = "\n".join([",".join(columns), *(",".join(map("{:.9g}".format, row)) for row in rows.tolist()), ""])
    path.write_text(text, encoding="ascii")


def _bodies(robot: Robot, faults: Faults, draws: Draws) -> list[Body]:
    """The body as built, and after the change."""
    body = built_body(robot, draws.dice)
    if not faults.payload:
        return [body]
    at = np.array(robot.cog) - np.array([0.0, 0.0, 0.4 * robot.size[2]])
    return [body, body.with_load(faults.payload * robot.mass, at, 0.3 * min(robot.size))]


def play(scene: Scene, robot_name: str, seed: int) -> tuple[Robot, Readings, dict[str, Any]]:
    """What the sensors read, and the truth. Same seed, same numbers."""
    robot = ROBOTS[robot_name]
    robot = replace(robot, std=robot.std | {k: v for k, v in scene.declare.get("std", {}).items() if k in robot.std})
    if scene.rate:
        robot = replace(robot, rate=scene.rate, tracker_rate=min(robot.tracker_rate, scene.rate))
    draws = Draws(robot, scene.faults, seed)
    bodies = _bodies(robot, scene.faults, draws)
    geometry = true_geometry(robot, scene.faults, draws)
    change = round(0.5 * scene.duration + draws.dice.uniform(-2.0, 2.0), 3)
    motion_seed, outside_seed = draws.dice.integers(2**31, size=2)

    def make(scale: float) -> Any:
        motion = motions.make(scene.motion, robot, scene.duration, np.random.default_rng(motion_seed), scale)
        draws.dice, kept = np.random.default_rng(outside_seed), draws.dice
        try:
            if robot.is_elastic or scene.faults.cable_inertia or scene.faults.slack:
                return release(robot, bodies, change, motion, geometry, scene.faults, draws)
            return follow(robot, bodies, change, motion, geometry, scene.faults, draws)
        finally:
            draws.dice = kept

    course = shrunk(make)
    readings = read(robot, scene.faults, draws, course)
    truth: dict[str, Any] = dict(bodies[-1].moments())
    if len(bodies) > 1:
        truth |= {"before": bodies[0].moments(), "change_s": change}
    truth |= {"scene": scene.name, "robot": robot.name, "seed": seed, "known": scene.known, "drawn": readings.drawn}
    truth["motion_scale"] = course.events["scale"]
    return robot, readings, truth


def write(scene: Scene, robot_name: str, seed: int, folder: Path) -> Run:
    """Play a scene and write the folder."""
    robot, readings, truth = play(scene, robot_name, seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.toml").write_text(robot_toml(robot, scene.declare), encoding="utf-8")
    _csv(folder / "signals.csv", readings.signals)
    _csv(folder / "tracker.csv", readings.tracker)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return Run(scene, robot, seed, folder, truth)
