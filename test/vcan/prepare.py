# SPDX-License-Identifier: Apache-2.0
"""Make the runs that the tests here replay: in a guest kernel without hardware support this would take minutes.

build/vcan/robot: a whole modern run of CoGiRo;  robot_fd: 2 s of hold;
build/vcan/robot_timed: a whole run whose samples all carry their device time, so that a machine which stalls and stamps
frames late does not spoil the estimate.
"""

import shutil
import subprocess
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
COGIRO = TOP / "firmware/robots/cogiro"
RUNS = TOP / "build/vcan"
PATIENT = "\n[align]\nmax_wait = 2.0  # s: an emulated machine may take a while to send a position\n"


def make_run(name: str, description: str, *options: str) -> None:
    folder = RUNS / name
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(COGIRO, folder)
    robot = folder / description
    robot.write_text(robot.read_text() + PATIENT)
    tool = TOP / "build/bin/inertiactl"
    subprocess.run([tool, "compile", robot, "-o", folder / "robot.cfg"], check=True, capture_output=True)
    subprocess.run([tool, "simulate", robot, *options, "-o", folder / "run"], check=True, capture_output=True)


if __name__ == "__main__":
    make_run("robot", "robot.toml", "--rate", "50", "--faults", "modern", "--seed", "1")
    make_run("robot_timed", "robot_fd.toml", "--rate", "50", "--faults", "modern", "--seed", "1")
    make_run("robot_fd", "robot_fd.toml", "--trajectory", "hold", "--duration", "2")
