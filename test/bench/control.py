# SPDX-License-Identifier: Apache-2.0
"""Control: time of a motion in closed loop, with and without the daemon, and of a reading of the gate from Python; from
publishing an ESTIMATE to a control thread that has its parameters.
"""

import subprocess
import time
from dataclasses import replace
from pathlib import Path

from inertiad.control import closed_loop, request
from inertiad.control.closed_loop import Trial
from inertiad.robot import configuration
from inertiad_core import ParameterGate

ROBOT = Path("firmware/robots/cogiro/robot.toml")
READS = 100_000
URL, SECONDS = "udpm://239.255.76.67:7667?ttl=0", 60


def main() -> None:
    wanted, _ = request.request_of(ROBOT, request.Arguments(payload=("70@12",), mass=91.0))
    duration = wanted.run.trajectory.duration
    took = {}
    for arm in closed_loop.ARMS:
        start = time.perf_counter()
        closed_loop.control(Trial(replace(wanted.run, seed=1), arm, 1.5))
        took[arm] = time.perf_counter() - start
    for arm, seconds in took.items():
        print(
            f"control: {duration:.1f} s at 1 kHz, {arm:8} {seconds:6.2f} s, {duration / seconds:4.0f}x real time, "
            f"{seconds / took['nominal']:4.1f}x the time of nominal parameters"
        )
    gate = ParameterGate(configuration.theta_of(wanted.run.body))
    start = time.perf_counter()
    for k in range(READS):
        gate.read(k)
    print(f"gate: read from Python {1e6 * (time.perf_counter() - start) / READS:.2f} us")
    command = ["build/test/bench/hand_over", URL, str(SECONDS)]
    n, *us = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    p50, p99, p999, longest = us
    print(f"hand-over: {n} estimates, p50 {p50}, p99 {p99}, p99.9 {p999}, longest {longest} us until usable")


if __name__ == "__main__":
    main()
