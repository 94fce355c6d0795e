# SPDX-License-Identifier: Apache-2.0
"""Control: time of a motion in closed loop, with and without the daemon; of a reading of the gate from Python; from an
ESTIMATE's publication to a control thread that has its parameters; of readings at 1 kHz beside threads that compute.

With the right to SCHED_FIFO the second line of the hand-over leaves out those during which the machine itself stalled.
"""

import os
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


def hand_over(n_busy: int) -> list[str]:
    """Lines of hand_over.cpp in words."""
    command = ["build/test/bench/hand_over", URL, str(SECONDS), str(n_busy)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    rows = [line.split() for line in done.stdout.splitlines()]
    return [f"{n} times, p50 {p50}, p99 {p99}, p99.9 {p999}, longest {most}" for n, p50, p99, p999, most in rows]


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
    all_of_them, *without_stalls = hand_over(0)
    print(f"hand-over: {all_of_them} us until usable")
    for line in without_stalls:
        print(f"  while no CPU of the machine stalled: {line} us")
    n_busy = os.cpu_count() or 1
    took, late = hand_over(n_busy)
    print(f"control thread of 1 kHz beside {n_busy} threads that compute: reading takes {took} us")
    print(f"  and begins late, by {late} us: that is the scheduler's part")


if __name__ == "__main__":
    main()
