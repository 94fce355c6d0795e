# SPDX-License-Identifier: Apache-2.0
"""inertiactl sync against known delays: simulated runs of seeds that nothing was tuned on, a new delay for each.

Usage: sync.py [NUMBER OF RUNS]. Exit 1 if a limit is broken.
"""

import sys
from multiprocessing import Pool

import numpy as np
from scenes import COGIRO, LEVELS, OUT

from inertiad.base import quantity
from inertiad.identify import sync
from inertiad.model import trajectory
from inertiad.model.random_errors import Dice
from inertiad.robot import dbc, description
from inertiad.robot.description import Robot
from inertiad.run import encode
from inertiad.simulate import bus_timing, sensor_models, simulator

FIRST = 5000
CASES = {
    "25 Hz, the paper's sensors": ("robot.toml", "paper", 25.0, 0.040, 1e-3),
    "1 kHz, modern sensors": ("robot.toml", "modern", 1000.0, 0.010, 0.3e-3),
    "1 kHz, modern sensors, CAN FD": ("robot_fd.toml", "modern", 1000.0, 0.010, 0.3e-3),
}
"""robot, level, rate [Hz], largest tracker delay [s], goal for the error's 95 % [s]"""
LIMIT_COVERED = 0.85
"""of the runs within 1.96 sigma, where 0.95 are claimed: 20 runs tell no better"""


def waits(robot: Robot) -> float:
    """s that the first frame of the forces waits for those of the IMU, which the bus lets pass first."""
    messages = {b.can_id: b.message for b in dbc.bind(robot, "") if quantity.sensor(b.quantity) == "imu"}
    force = {b.can_id for b in dbc.bind(robot, "") if b.quantity in quantity.forces(robot.n_cables)}
    first = min(map(bus_timing.priority, force))
    ahead = [(i, m) for i, m in messages.items() if bus_timing.priority(i) < first]
    frames = [encode.Frames(0, i, m.is_fd or m.length > 8, np.zeros((1, m.length), np.uint8)) for i, m in ahead]
    return sum(bus_timing.time_of(f, robot.bus[0].bitrate, robot.bus[0].data_bitrate) for f in frames)


def errors(case: str, seed: int) -> np.ndarray:
    """Error and sigma [s] of the tracker's delay, then of the forces'."""
    file, name, rate, largest, _ = CASES[case]
    level = LEVELS[name].model_copy(update={"tracker_delay": largest * np.random.default_rng(seed).random()})
    source = COGIRO.parent / file
    robot, folder = description.load(source), OUT / f"runs/sync_{source.stem}_{name}_{seed}"
    run = simulator.Run(source, robot, robot.nominal, trajectory.paper(), "paper", level, name, rate, seed)
    simulator.simulate(run, folder, lambda _: None)
    true_force = sensor_models.draw(level, robot.n_cables, Dice(seed)).force_delay + waits(robot)
    position, (force, std) = sync.delays(description.load(folder / "robot.toml"), folder)
    return np.array([position.value - level.tracker_delay, position.std, force - true_force, std])


def line(what: str, error: np.ndarray, std: np.ndarray, goal: float | None) -> bool:
    """Print one line of the table; True if all of it is good."""
    median, most = np.percentile(np.abs(error), [50, 95])
    inside, twice = ((np.abs(error) <= k * std).sum() for k in (1.0, 1.96))
    good = twice >= LIMIT_COVERED * len(error) and (goal is None or most <= goal)
    limit = "" if goal is None else f"95 % <= {1e3 * goal:g} ms, "
    bars = f"sigma {1e3 * np.median(std):.3f} ms, inside 1 sigma {inside}, inside 1.96 sigma {twice} of {len(error)}"
    print(
        f"{'PASS' if good else 'FAIL'}  sync {what:44} n {len(error):3}  limit {limit}bar >= {LIMIT_COVERED:.0%}  "
        f"measured |error| median {1e3 * median:.3f} ms, 95 % {1e3 * most:.3f} ms, {bars}",
        flush=True,
    )
    return good


def main(n: int) -> int:
    good = True
    with Pool(2) as pool:
        for case, (*_, goal) in CASES.items():
            found = np.array(pool.starmap(errors, [(case, seed) for seed in range(FIRST, FIRST + n)]))
            good &= line(f"tracker delay, {case}", found[:, 0], found[:, 1], goal)
            good &= line(f"force delay, {case}", found[:, 2], found[:, 3], None)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 20))
