# SPDX-License-Identifier: Apache-2.0
"""Seconds and bytes of a report about 60 s at 1 kHz, and seconds of the paper's experiment with 30 seeds."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROBOT = Path("firmware/robots/cogiro/robot.toml")
SECONDS = 60.0
SEEDS = 30


def inertiactl(*arguments: object) -> tuple[float, float]:
    """Seconds a command takes, and of how much computing; start of the process included."""
    start, before = time.monotonic(), os.times()
    subprocess.run([sys.executable, "-m", "inertiad", *map(str, arguments)], check=True, capture_output=True)
    after = os.times()
    busy = after.children_user + after.children_system - before.children_user - before.children_system
    return time.monotonic() - start, busy


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        run, page, poses = Path(folder) / "run", Path(folder) / "report.html", Path(folder) / "poses.csv"
        t = np.arange(0.0, SECONDS + 0.05, 0.1)
        x = np.tile([0.0, 0.0, 2.0, 0.0, 0.0, 0.0], (len(t), 1))
        x += 0.25 * np.sin(2.0 * np.pi * np.outer(t, [0.11, 0.13, 0.17, 0.29, 0.31, 0.23])) * np.minimum(t, 1)[:, None]
        header = "t,x,y,z,roll,pitch,yaw"
        np.savetxt(poses, np.column_stack([t, x]), delimiter=",", header=header, comments="")
        inertiactl("simulate", ROBOT, "--trajectory", poses, "--rate", 1000, "-o", run)
        seconds, busy = inertiactl("report", run, "-o", page)
        size = page.stat().st_size / 1e6
        told = f"in {seconds:.1f} s, {busy:.1f} s of computing (goal 10), page {size:.1f} MB (goal 8)"
        print(f"report: {SECONDS:g} s at 1 kHz {told}", flush=True)
        seconds, busy = inertiactl("paper", "--seeds", SEEDS, "-o", page)
        print(f"paper: {SEEDS} experiments of 8 moves in {seconds:.0f} s, {busy:.0f} s of computing (goal 300)")


if __name__ == "__main__":
    main()
