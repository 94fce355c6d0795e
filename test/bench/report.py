# SPDX-License-Identifier: Apache-2.0
"""Seconds and bytes of a report about 60 s at 1 kHz, and seconds of the paper's experiment with 30 seeds."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROBOT = Path("firmware/robots/cogiro/robot.toml")
SECONDS = 60.0
SEEDS = 30


def inertiactl(*arguments: object) -> float:
    """Seconds a command takes, start of the process included."""
    start = time.monotonic()
    subprocess.run([sys.executable, "-m", "inertiad", *map(str, arguments)], check=True, capture_output=True)
    return time.monotonic() - start


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        run, page, poses = Path(folder) / "run", Path(folder) / "report.html", Path(folder) / "poses.csv"
        t = np.arange(0.0, SECONDS + 0.05, 0.1)
        x = np.tile([0.0, 0.0, 2.0, 0.0, 0.0, 0.0], (len(t), 1))
        x += 0.25 * np.sin(2.0 * np.pi * np.outer(t, [0.11, 0.13, 0.17, 0.29, 0.31, 0.23])) * np.minimum(t, 1)[:, None]
        header = "t,x,y,z,roll,pitch,yaw"
        np.savetxt(poses, np.column_stack([t, x]), delimiter=",", header=header, comments="")
        inertiactl("simulate", ROBOT, "--trajectory", poses, "--rate", 1000, "-o", run)
        seconds = inertiactl("report", run, "-o", page)
        print(
            f"report: {SECONDS:g} s at 1 kHz in {seconds:.1f} s (goal 10), page {page.stat().st_size / 1e6:.1f} MB (goal 8)"
        )
        seconds = inertiactl("paper", "--seeds", SEEDS, "-o", page)
        print(f"paper: {SEEDS} experiments of 8 moves in {seconds:.0f} s (goal 300)")


if __name__ == "__main__":
    main()
