# SPDX-License-Identifier: Apache-2.0
"""The request of the command line: a simulation with everything that it leaves open chosen by the robot."""

from dataclasses import dataclass
from pathlib import Path

import inertiad_core
from inertiad.model import forward_dynamics, workspace
from inertiad.model import payload as payloads
from inertiad.model import trajectory as trajectories
from inertiad.model.inverse_dynamics import Mechanics
from inertiad.model.trajectory import Trajectory
from inertiad.robot import configuration, description, stand_in
from inertiad.robot.stand_in import Completed
from inertiad.simulate import sensor_models, simulator
from inertiad.simulate.simulator import Run


@dataclass(frozen=True)
class Arguments:
    """The command line's words; see `inertiactl simulate -h`."""

    trajectory: str | None = None
    rate: float | None = None
    faults: str = "modern"
    seed: int = 0
    body: Path | None = None
    mass: float | None = None
    pose: str = "0,0,2,0,0,0"
    duration: float = 10.0
    plant: str | None = None
    payload: tuple[str, ...] = ()


def _motion(arguments: Arguments, completed: Completed, source: str) -> tuple[Trajectory, str, list[str]]:
    """The motion asked for, else the usual one of the robot; its name, and remarks."""
    if arguments.trajectory is not None:
        path = trajectories.named(arguments.trajectory, arguments.pose, arguments.duration)
        return path, arguments.trajectory, []
    config = inertiad_core.Config(configuration.compile_robot(completed.robot, source))
    path, name, remark = workspace.usual_motion(Mechanics(config, completed.robot, completed.body))
    return path, name, [f"no --trajectory: {remark}"] if remark else []


def _plant(arguments: Arguments, completed: Completed) -> tuple[str, list[str]]:
    """Name of the plant, and remarks: elastic cables where fewer than six hold the platform."""
    if arguments.plant is not None:
        return arguments.plant, []
    n = completed.robot.n_cables
    if n >= 6:
        return "exact", []
    return "elastic", [f"{n} cables leave {6 - n} of 6 degrees of freedom free: --plant elastic, the platform swings"]


def run_of(robot_file: Path, arguments: Arguments) -> tuple[Run, list[str]]:
    """The simulation and what was assumed for it. InputError: a word, the robot or the body is not usable."""
    robot = description.load(robot_file)
    level = sensor_models.faults(arguments.faults)
    given = arguments.body is not None or arguments.mass is not None
    body = simulator.body_of(robot, arguments.body, arguments.mass)
    completed = stand_in.complete(robot, body if given else None)
    assumed = stand_in.body_of(robot)[1] if arguments.body is None and given else ()
    path, name, remarks = _motion(arguments, completed, str(robot_file))
    plant, more = _plant(arguments, completed)
    run = Run(
        robot_file=robot_file,
        robot=completed.robot,
        body=completed.body,
        trajectory=path,
        trajectory_name=name,
        level=level,
        faults_name=arguments.faults,
        rate=level.rate if arguments.rate is None else arguments.rate,
        seed=arguments.seed,
        plant=forward_dynamics.plant(plant, completed.robot),
        payloads=payloads.parse_all(list(arguments.payload), completed.body, path.duration),
    )
    return run, [*assumed, *completed.remarks, *more, *remarks]
