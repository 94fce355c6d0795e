# SPDX-License-Identifier: Apache-2.0
"""The experiment of Tempel et al., ICRA 2017, repeated: its motions, sensors and method, and the joint fit beside it.

One seed is one experiment: sensors with errors drawn anew, four trajectories forward and backward at 25 Hz, through the
CAN log and the daemon's own stages. The paper's method takes each of the eight moves by itself and reports medians; the
joint fit takes the same eight moves together. Three of the four trajectories and all error levels are assumptions: the
paper gives one trajectory and no data sheet.
"""

import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

import inertiad_core
from inertiad.base.body import Body
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.identify import fit
from inertiad.model import trajectory
from inertiad.robot import description
from inertiad.run import reader
from inertiad.run.reader import Recording
from inertiad.simulate import sensor_models, simulator

Progress = Callable[[str], None]
FAULTS: Final = "paper"


@dataclass(frozen=True)
class Experiment:
    """Result of one seed."""

    seed: int
    two_step: Body
    """the paper's method; std: scatter of the eight moves"""
    is_possible: bool
    """a body can have the two-step result"""
    moves: Array
    """[8, 10] two-step results of the moves"""
    joint: Body
    is_joint_possible: bool
    """the optimum of the data alone, before the projection to a consistent body"""


@dataclass(frozen=True)
class Reproduction:
    """All experiments, by seed."""

    robot_name: str
    truth: Body
    rate: float
    """Hz"""
    experiments: list[Experiment]

    @property
    def two_step_error(self) -> Array:
        """[N, 10] estimate - truth"""
        return np.array([e.two_step.value for e in self.experiments]) - self.truth.value

    @property
    def joint_error(self) -> Array:
        """[N, 10] estimate - truth"""
        return np.array([e.joint.value for e in self.experiments]) - self.truth.value

    @property
    def joint_std(self) -> Array:
        """[N, 10]"""
        return np.array([e.joint.std for e in self.experiments])

    @property
    def n_impossible(self) -> int:
        """Two-step results that no body can have."""
        return sum(not e.is_possible for e in self.experiments)


def cut(run: Recording, first: float, last: float) -> Recording:
    """The rows of a recording from first to last [s of its own clock]."""
    rows = run.rows
    t_ns = np.rint(1e9 * rows.t).astype(np.int64)
    inside = (rows.t >= first) & (rows.t <= last)
    values = (rows.acc, rows.gyro, rows.q, rows.position, rows.f)
    acc, gyro, q, position, f = (np.ascontiguousarray(a[inside]) for a in values)
    return replace(run, rows=inertiad_core.Rows(t_ns[inside], acc, gyro, q, position, f))


def experiment(robot_file: Path, seed: int) -> Experiment:
    """Simulate, read, identify by both methods."""
    robot = description.load(robot_file)
    level = sensor_models.faults(FAULTS)
    body = simulator.body_of(robot, None, None)
    what = simulator.Run(robot_file, robot, body, trajectory.paper(), "paper", level, FAULTS, level.rate, seed)
    with tempfile.TemporaryDirectory() as folder:
        simulator.simulate(what, Path(folder), lambda _: None)
        whole = reader.read(Path(folder))
        config = reader.config_of(whole.robot, str(robot_file))
    moves = [cut(whole, *(simulator.START + span)) for span in trajectory.paper_spans()]
    each = [fit.two_step(whole.robot, config, [move]).body.value for move in moves]
    median = fit.two_step(whole.robot, config, moves)
    joint = fit.joint(config, moves)
    return Experiment(seed, median.body, median.consistent, np.array(each), joint.body, joint.consistent)


def reproduce(robot_file: Path, first_seed: int, n: int, n_processes: int | None, progress: Progress) -> Reproduction:
    """n experiments in as many processes as there are cores. InputError: the robot has no nominal body, or 0 seeds."""
    if n < 1:
        raise InputError(f"--seeds {n}: allowed: 1 or more")
    robot = description.load(robot_file)
    nominal = simulator.body_of(robot, None, None)
    found = []
    with ProcessPoolExecutor(n_processes) as pool:
        waiting = [pool.submit(experiment, robot_file, first_seed + i) for i in range(n)]
        for task in as_completed(waiting):
            found.append(task.result())
            progress(f"experiment {len(found)} of {n}")
    truth = Body((nominal.mass, *nominal.cog, *nominal.inertia_cog), (0.0,) * 10)
    rate = sensor_models.faults(FAULTS).rate
    return Reproduction(robot.name, truth, rate, sorted(found, key=lambda e: e.seed))
