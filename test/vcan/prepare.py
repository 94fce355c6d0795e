# SPDX-License-Identifier: Apache-2.0
"""Make the runs that the tests here replay: in a guest kernel without hardware support this would take minutes.

build/vcan/robot: a whole modern run of CoGiRo;  robot_fd: 2 s of hold;
build/vcan/robot_timed: 16 s of motion whose samples all carry their device time, so that a machine which stalls and
stamps frames late does not spoil the estimate;
build/vcan/golden: 8 s of motion, longer than clocks take to settle on a host that stalls, with the daemon's own
estimate.json in the run: what verify runs again, at 50 Hz, so that the daemon's ring of samples outlasts the stalls of
an emulated machine; beside it changed.cfg, which is not what the run's robot.toml compiles to;
build/vcan/devices: 30 s of real sensors on two buses, in one place, so that no tracker has to be played as well;
build/vcan/faults: one run per fault of scenarios.py, laid out as frames with the time they are due.
"""

import math
import shutil
import subprocess
import sys
from pathlib import Path

import scenarios

TOP = Path(__file__).resolve().parents[2]
COGIRO = TOP / "firmware/robots/cogiro"
RUNS = TOP / "build/vcan"
TOOL = TOP / "build/bin/inertiactl"
PATIENT = "\n[align]\nmax_wait = 10.0  # s: an emulated machine may take a while to send a position\n"


def write_swing(path: Path, duration: int) -> Path:
    """Some seconds of motion in all six coordinates that starts and ends at rest."""
    amplitude = (0.25, 0.2, 0.12, 0.12, 0.12, 0.15)  # m, rad
    rows = ["t,x,y,z,roll,pitch,yaw"]
    for t in (0.02 * k for k in range(50 * duration + 1)):
        ramp = math.sin(math.pi * t / duration) ** 4
        pose = [a * ramp * math.sin(2.0 * math.pi * (0.35 + 0.05 * i) * t + i) for i, a in enumerate(amplitude)]
        pose[2] += 2.0
        rows.append(",".join(f"{value:.9f}" for value in (t, *pose)))
    path.write_text("\n".join(rows) + "\n")
    return path


def write_estimate(run: Path) -> None:
    """The daemon's result on a run, from its files, into the run."""
    subprocess.run([TOOL, "compile", run / "robot.toml", "-o", run / "robot.cfg"], check=True, capture_output=True)
    files = ["--bus", f"file:{run}/can.log", "--tracker", f"file:{run}/tracker.csv", "--lcm", "none"]
    command = [
        TOP / "build/bin/inertiad",
        "-v",
        "--config",
        run / "robot.cfg",
        *files,
        "--estimate",
        run / "estimate.json",
    ]
    subprocess.run(command, check=True, capture_output=True)


def write_changed(golden: Path) -> None:
    """changed.cfg: compiled from the golden run's description with one force 2 % larger."""
    folder = golden / "changed"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(golden / "run", folder)
    dbc = folder / "platform_fd.dbc"
    was, now = " SG_ f_3 : 336|24@1+ (0.001,", " SG_ f_3 : 336|24@1+ (0.00102,"
    text = dbc.read_text()
    assert was in text
    dbc.write_text(text.replace(was, now))
    command = [TOOL, "compile", folder / "robot.toml", "-o", golden / "changed.cfg"]
    subprocess.run(command, check=True, capture_output=True)


def make_run(name: str, description: str, *options: object) -> None:
    folder = RUNS / name
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(COGIRO, folder)
    robot = folder / description
    robot.write_text(robot.read_text() + PATIENT)
    subprocess.run([TOOL, "compile", robot, "-o", folder / "robot.cfg"], check=True, capture_output=True)
    command = [TOOL, "simulate", robot, *options, "-o", folder / "run"]
    subprocess.run([str(part) for part in command], check=True, capture_output=True)


def make_devices_run() -> None:
    folder = RUNS / "devices"
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([sys.executable, TOP / "test/host/devices.py", "xsens_gsv4", folder, "50", "30"], check=True)
    command = [TOOL, "compile", "--blind", folder / "robot.toml", "-o", folder / "robot.cfg"]
    subprocess.run(command, check=True, capture_output=True)


if __name__ == "__main__":
    make_devices_run()
    make_run("robot", "robot.toml", "--rate", "50", "--faults", "modern", "--seed", "1")
    for name, duration in (("robot_timed", 16), ("golden", 8)):
        swing = write_swing(RUNS / f"{name}.csv", duration)
        make_run(name, "robot_fd.toml", "--trajectory", swing, "--rate", "50", "--faults", "modern", "--seed", "1")
    write_estimate(RUNS / "golden/run")
    write_changed(RUNS / "golden")
    make_run("robot_fd", "robot_fd.toml", "--trajectory", "hold", "--duration", "2")
    scenarios.write(RUNS / "faults")
