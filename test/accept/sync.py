# SPDX-License-Identifier: Apache-2.0
"""inertiactl sync against known delays: simulated runs of seeds that nothing was tuned on, a new delay for each.

Usage: sync.py [NUMBER OF RUNS]. Exit 1 if a limit is broken.
"""

import sys
from multiprocessing import Pool

import numpy as np
from scenes import COGIRO, LEVELS, OUT

from inertiad import robot as description
from inertiad import simulate, sync, trajectory

FIRST = 2000
CASES = {
    "25 Hz, the paper's sensors": ("paper", 25.0, 0.040, 1e-3),
    "1 kHz, modern sensors": ("modern", 1000.0, 0.010, 0.3e-3),
}
"""level, rate [Hz], largest tracker delay [s], goal for the error's 95 % [s]"""
LIMIT_COVERED = 0.85
"""of the runs within 1.96 sigma, where 0.95 are claimed: 20 runs tell no better"""


def errors(case: str, seed: int) -> np.ndarray:
    """Error and sigma [s] of the tracker's delay, then of the forces'."""
    name, rate, largest, _ = CASES[case]
    level = LEVELS[name].model_copy(update={"tracker_delay": largest * np.random.default_rng(seed).random()})
    robot, folder = description.load(COGIRO), OUT / f"runs/sync_{name}_{seed}"
    run = simulate.Run(COGIRO, robot, robot.nominal, trajectory.paper(), "paper", level, name, rate, seed)
    simulate.simulate(run, folder, lambda _: None)
    truth = simulate.sensors.draw(level, robot.n_cables, simulate.Dice(seed))
    position, (force, std) = sync.delays(description.load(folder / "robot.toml"), folder)
    return np.array([position.value - level.tracker_delay, position.std, force - truth.force_delay, std])


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
