# SPDX-License-Identifier: Apache-2.0
"""Measure calibrate and fit on 8 runs of 5 s at 200 Hz, functions and whole commands. Prints a table."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as tools/inertiactl has it
TOP = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(TOP / "test/accept")]

import numpy as np  # noqa: E402
import scenes  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from inertiad.identify import calibrate, fit  # noqa: E402
from inertiad.robot import description  # noqa: E402
from inertiad.run import reader  # noqa: E402

OUT = TOP / "build/bench/offline"
INERTIACTL = TOP / "build/bin/inertiactl"
N_RUNS, DURATION, RATE, PAYLOAD = 8, 5.0, 200, 20.0


def fastest(n, action):
    """Wall clock and CPU seconds, children included, of the fastest of n."""
    found = []
    for _ in range(n):
        before = os.times()
        action()
        after = os.times()
        cpu = sum(after[:4]) - sum(before[:4])
        found.append((after.elapsed - before.elapsed, cpu))
    return min(found)


def inertiactl(*arguments):
    """A command of the project, its output kept to itself."""
    subprocess.run([str(a) for a in (INERTIACTL, *arguments)], check=True, capture_output=True)


def simulate():
    """Folders of runs of the platform alone, and of one with a weight on, all with the same sensors."""
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    t = np.arange(0.0, DURATION + 0.01, 0.02)
    mass = description.load(scenes.COGIRO).nominal.mass
    folders = [OUT / f"run_{i}" for i in range(N_RUNS + 1)]
    for i, folder in enumerate(folders):
        motion = scenes.fourier(i).at(t)
        q = Rotation.from_matrix(motion.R).as_quat(scalar_first=True)
        file = OUT / f"motion_{i}.csv"
        columns = np.column_stack([t, motion.p, q])
        np.savetxt(file, columns, delimiter=",", header="t,x,y,z,q_w,q_x,q_y,q_z", comments="")
        sensors = ["--faults", "modern", "--rate", RATE, "--seed", 1]
        body = ["--mass", mass + PAYLOAD] if i == N_RUNS else []
        inertiactl("simulate", scenes.COGIRO, "--trajectory", file, *sensors, *body, "-o", folder)
    return folders[:N_RUNS], folders[N_RUNS]


def main():
    folders, loaded = simulate()
    mixed = [*folders[1:], loaded]
    recordings = {folder: reader.read(folder) for folder in (*folders, loaded)}
    empty, known = [recordings[f] for f in folders], [recordings[f] for f in mixed]
    robot = empty[0].robot
    config = reader.config_of(robot, "")
    weight = ["--payload", f"{loaded}={PAYLOAD}"]
    table = [
        ("calibrate, runs read already", lambda: calibrate.calibrate(robot, config, known, {loaded: PAYLOAD})),
        ("fit, runs read already", lambda: fit.joint(config, empty)),
        (
            "inertiactl calibrate",
            lambda: inertiactl("calibrate", scenes.COGIRO, *mixed, *weight, "-o", OUT / "found.toml"),
        ),
        ("inertiactl fit", lambda: inertiactl("fit", *folders, "--json", OUT / "estimate.json")),
    ]
    n_rows = sum(len(run.rows) for run in empty)
    print(f"{N_RUNS} runs of {DURATION:g} s at {RATE} Hz, {n_rows} rows:")
    for name, action in table:
        wall, cpu = fastest(3, action)
        print(f"  {name:42} {wall:6.2f} s, of CPU time {cpu:.2f} s")


if __name__ == "__main__":
    main()
