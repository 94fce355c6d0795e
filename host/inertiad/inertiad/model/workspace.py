# SPDX-License-Identifier: Apache-2.0
"""A robot's usual workspace, and a motion within it for robots that have none of their own."""

from dataclasses import replace
from typing import Final

import numpy as np

from inertiad.base.error import InputError
from inertiad.model import forward_dynamics, inverse_dynamics, trajectory
from inertiad.model.forward_dynamics import Plant
from inertiad.model.inverse_dynamics import Mechanics
from inertiad.model.trajectory import Moves, Trajectory
from inertiad.robot.description import Robot
from inertiad.robot.geometry import box

SHARES: Final = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1)
"""of the usual box and of the angles, tried one after the other"""
CHECK_RATE = 20.0
"""Hz at which a motion is checked for possible tensions"""
MARGIN = 0.02
"""of the tensions' range that a motion chosen here stays inside of, so that small errors of geometry do no harm"""


def _scaled(robot: Robot, share: float) -> Moves:
    """The paper's moves, their places in a share of the box, their angles times it; level with fewer than 6 cables."""
    pairs = trajectory.PAPER_PAIRS
    low, high = pairs[..., :3].min(axis=(0, 1)), pairs[..., :3].max(axis=(0, 1))
    edges = box(robot)
    size = edges[3:] - edges[:3]
    middle = 0.5 * (edges[:3] + edges[3:])
    place = middle + share * size * ((pairs[..., :3] - low) / (high - low) - 0.5)
    angles = pairs[..., 3:] * (share if robot.n_cables >= 6 else 0.0)
    slower = max(1.0, float(np.sqrt(share * np.max(size / (high - low)))))
    poses = np.concatenate([place, angles], axis=2)
    return trajectory.there_and_back(poses, trajectory.MOVE_TIME * slower)


def _is_possible(mechanics: Mechanics, path: Trajectory) -> bool:
    """Whether six or more cables can hold the platform on the whole path with a margin."""
    cables = []
    for cable in mechanics.robot.cable:
        margin = MARGIN * min(cable.tension_max - cable.tension_min, cable.tension_max)
        cables.append(
            cable.model_copy(
                update={"tension_min": cable.tension_min + margin, "tension_max": cable.tension_max - margin}
            )
        )
    narrower = replace(mechanics, robot=mechanics.robot.model_copy(update={"cable": cables}))
    t = np.arange(int(path.duration * CHECK_RATE) + 1) / CHECK_RATE
    try:
        inverse_dynamics.tensions(narrower, t, path.at(t))
    except InputError:
        return False
    return True


def _hangs(mechanics: Mechanics, path: Moves, plant: Plant) -> bool:
    """Whether a platform on fewer than six cables hangs, all of them taut, at every pose of the moves."""
    t = np.array([0.0, *path.spans[:, 1]])
    motion = path.at(t)
    try:
        lengths = forward_dynamics.lengths_at_rest(mechanics, motion, plant)
        for k in range(len(t)):
            forward_dynamics.hang(mechanics, lengths[k], path.at(t[k : k + 1]), plant.stiffness)
    except (InputError, ValueError):
        return False
    return True


def usual_motion(mechanics: Mechanics) -> tuple[Trajectory, str, str]:
    """The paper's moves where the robot can make them, else the largest it can of their shape in its own box.

    Returns the motion, its name and a remark, "" for the paper's own. InputError: not even the smallest is possible.
    """
    robot = mechanics.robot
    holds_pose = robot.n_cables >= 6
    if holds_pose and _is_possible(mechanics, trajectory.paper()):
        return trajectory.paper(), "paper", ""
    plant = forward_dynamics.plant("elastic", robot)
    assert plant is not None
    for share in SHARES:
        path = _scaled(robot, share)
        if _is_possible(mechanics, path) if holds_pose else _hangs(mechanics, path, plant):
            angles = f", angles times {share:g}" if holds_pose else ", level"
            return path, "moves", f"moves like the paper's within {share:.0%} of the robot's middle{angles}"
    edges = ", ".join(f"{v:.3g}" for v in box(robot))
    raise InputError(
        f"trajectory: in the robot's middle (x y z from {edges} m) no tensions within the limits hold a platform of "
        f"{mechanics.body.mass:g} kg: check anchors, attachments and tensions (inertiactl view), or give --trajectory"
    )
