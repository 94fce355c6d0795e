# SPDX-License-Identifier: Apache-2.0
"""Simulation: how much faster than real time a run with every sensor at 1 kHz is written, with and without forward
dynamics. Seconds of one core, from description to files."""

import time
from pathlib import Path

from inertiad.model import forward_dynamics, trajectory
from inertiad.robot import description
from inertiad.simulate import sensor_models, simulator

ROBOT = Path("firmware/robots/cogiro/robot.toml")
OUT = Path("build/bench/simulate")
REPEATS = 3


def seconds(plant: str) -> float:
    """CPU seconds of the fastest of some runs."""
    robot = description.load(ROBOT)
    modern = sensor_models.PRESETS["modern"]
    path, moves = trajectory.paper(), forward_dynamics.plant(plant, robot)
    run = simulator.Run(ROBOT, robot, robot.nominal, path, "paper", modern, "modern", 1000.0, 1, moves)
    found = []
    for _ in range(REPEATS):
        start = time.process_time()
        simulator.simulate(run, OUT, lambda step: None)
        found.append(time.process_time() - start)
    return min(found)


def main() -> None:
    duration = trajectory.paper().duration
    for plant in forward_dynamics.PRESETS:
        took = seconds(plant)
        print(
            f"simulate: {duration:.1f} s at 1 kHz, {plant:8} {took:5.2f} s, {duration / took:4.0f}x real time (goal 50)"
        )


if __name__ == "__main__":
    main()
