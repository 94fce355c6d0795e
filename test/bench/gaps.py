# SPDX-License-Identifier: Apache-2.0
"""The tracker lost again and again: how far carried positions go astray, and what the estimate gains from them.

Runs with gaps of a length every few seconds, through the core, with and without max_carry. Astray: largest axis of
carried against tracked position, the tracker's own noise included.
"""

from pathlib import Path
from typing import Any

import numpy as np

import inertiad_core
from inertiad.base import body as estimate
from inertiad.base import table
from inertiad.base.table import Array
from inertiad.model import trajectory
from inertiad.robot import description
from inertiad.robot.description import Robot
from inertiad.run import reader, tracker_csv
from inertiad.simulate import sensor_models, simulator

ROBOT = Path("firmware/robots/cogiro/robot.toml")
OUT = Path("build/bench/gaps")
CASES = (("modern", 100.0), ("paper", 25.0))
"""sensors, Hz"""
SEEDS = range(3100, 3116)
FIRST, PAUSE = 6.0, 2.0
"""s, of the motion until the first gap, and between gaps"""
GAPS = ((0.5, 0.0), (0.5, 0.5), (2.0, 0.0), (2.0, 0.5), (2.0, 1.0), (2.0, 2.0))
"""s of the gaps, s of max_carry"""


def simulated(sensor_set: str, rate: float, seed: int) -> Path:
    """A run folder."""
    robot, folder = description.load(ROBOT), OUT / f"{sensor_set}_{seed}"
    level = sensor_models.PRESETS[sensor_set]
    run = simulator.Run(ROBOT, robot, robot.nominal, trajectory.paper(), "paper", level, sensor_set, rate, seed)
    simulator.simulate(run, folder, lambda _: None)
    return folder


def cut(run: Path, gap: float) -> Path:
    """tracker.csv without what lies in the gaps."""
    tracker = tracker_csv.read(run / "tracker.csv")
    since = tracker.t - tracker.t[0] - FIRST
    seen = (since < 0.0) | (np.mod(since, gap + PAUSE) >= gap)
    path = run / "cut.csv"
    xyz = {axis: tracker.columns[axis][seen] for axis in "xyz"}
    tracker_csv.write(path, table.Table(tracker.t[seen], xyz, str(path)))
    return path


def played(run: Path, robot: Robot, tracker: Path, max_carry: float) -> Any:
    align = robot.align.model_copy(update={"max_carry": max_carry})
    return reader.play(run, robot.model_copy(update={"align": align}), str(run), tracker)


def astray(run: Path, whole: Any, carried: Any) -> Array:
    """m, of every row of the run that was not tracked but carried."""
    rows, other = inertiad_core.rows_of(whole), inertiad_core.rows_of(carried)
    _, i, k = np.intersect1d(rows.t, other.t, return_indices=True)
    off = np.abs(other.position[k] - rows.position[i]).max(axis=1)
    return off[off > 0.0]


def errors(run: Path, pipeline: Any) -> tuple[Array, Array]:
    """Error and sigma [10] of the body."""
    e, truth = pipeline.estimate, estimate.read_truth(run / "truth.json")
    body = np.array([e["mass"], *e["cog"], *e["inertia_cog"]])
    return body - truth.value, np.array([e["mass_std"], *e["cog_std"], *e["inertia_cog_std"]])


def main() -> None:
    for sensor_set, rate in CASES:
        folders = [simulated(sensor_set, rate, seed) for seed in SEEDS]
        print(f"{sensor_set}, {rate:g} Hz, {len(folders)} runs from seed {SEEDS.start}, a gap every gap + {PAUSE:g} s")
        print("  gap  max_carry  windows  carried  astray p50, p99  |CoG error| median  J error median  in 1.96 sigma")
        for gap, max_carry in GAPS:
            found, off, n = [], [], []
            for run in folders:
                robot = description.load(run / "robot.toml")
                pipeline = played(run, robot, cut(run, gap), max_carry)
                found.append(errors(run, pipeline))
                off.append(astray(run, played(run, robot, run / "tracker.csv", 0.0), pipeline))
                n.append((pipeline.estimate["n_windows"], pipeline.counters["motion.carried"]))
            error, std = (np.array(x) for x in zip(*found, strict=True))
            p50, p99 = 1e3 * np.percentile(np.concatenate(off), [50, 99]) if max_carry > 0.0 else (0.0, 0.0)
            windows, carried = np.mean(n, axis=0)
            cog = 1e3 * np.median(np.linalg.norm(error[:, 1:4], axis=1))
            inertia = np.median(np.linalg.norm(error[:, 4:7], axis=1))
            inside = np.mean(np.abs(error) < 1.96 * std)
            print(
                f"{gap:3.1f} s  {max_carry:7.1f} s  {windows:7.0f}  {carried:7.0f}  {p50:5.1f}, {p99:5.1f} mm  "
                f"{cog:15.2f} mm  {inertia:8.2f} kg m2  {100 * inside:11.1f} %",
                flush=True,
            )


if __name__ == "__main__":
    main()
