# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for the parts that a short robot.toml leaves out, where a motion has to be planned or simulated.

They are the guesses that configuration.py makes for such a robot, so its priors and noise levels stay the same.
"""

from dataclasses import dataclass

from inertiad.robot import configuration
from inertiad.robot.description import Robot
from inertiad.robot.keys import Nominal, Std


@dataclass(frozen=True)
class Completed:
    """A robot to plan with."""

    robot: Robot
    """with a tension_max for every cable; [nominal] as given"""
    body: Nominal
    remarks: tuple[str, ...]
    """assumptions, for people"""


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def body_of(robot: Robot) -> tuple[Nominal, tuple[str, ...]]:
    """[nominal]; without it a body of the mass that the prior assumes, its CoG at P, and the remark that says so."""
    if robot.nominal is not None:
        return robot.nominal, ()
    mass = _rounded(configuration.typical_mass(robot))
    moment = _rounded(configuration.GUESSED_INERTIA * mass * configuration.platform_size(robot) ** 2)
    body = Nominal(mass=mass, cog=[0.0, 0.0, 0.0], inertia_cog=[moment, moment, moment, 0.0, 0.0, 0.0])
    source = "tension_max" if configuration.is_tension_declared(robot) else "the platform's size"
    remark = f"no [nominal]: a stand-in body from {source}: {mass:g} kg, CoG at P, moments of inertia {moment:g} kg m2"
    return body, (remark,)


def complete(robot: Robot, body: Nominal | None = None) -> Completed:
    """The robot with stand-ins for [nominal], unless a body is given, and for tension_max."""
    body, remarks = (body, ()) if body is not None else body_of(robot)
    if configuration.is_tension_declared(robot):
        return Completed(robot, body, remarks)
    held = configuration.WEIGHTS_HELD
    most = _rounded(held * body.mass * max(robot.gravity, 1.0) / robot.n_cables)
    most = max(most, 2.0 * max(cable.tension_min for cable in robot.cable))
    cables = [cable.model_copy(update={"tension_max": most}) for cable in robot.cable]
    robot = robot.model_copy(update={"cable": cables, "std": Std(**configuration.std(robot))})
    remark = f"no tension_max: {most:g} N assumed, all cables together {held:g} times the weight"
    return Completed(robot, body, (*remarks, remark))
