# SPDX-License-Identifier: Apache-2.0
"""A controller in Python that follows the daemon: ESTIMATE goes through the parameter gate, whose parameters give the
wrench to feed forward. Prints a line per estimate until interrupted or the log ends. As host/eigen/examples/follow.cpp.

Usage: .venv/bin/python host/examples/follow.py LCM_URL robot.toml
Exit code 2: no network, no such log, or an unusable robot.toml.
"""

import sys
import time
from pathlib import Path

import numpy as np

import inertiad_core as core
from inertiad.base.error import InputError
from inertiad.live import lcm_network
from inertiad.robot import configuration, description
from inertiad_lcm import estimate_t

LEVEL = np.eye(3)
"""attitude, P to W"""
ACCELERATION = np.array([0.5, 0.0, 0.0])
"""m/s2, W, of the platform's reference point"""
RATE = np.array([0.0, 0.0, 0.1])
"""rad/s, P"""
ANGULAR_ACCELERATION = np.array([0.0, 0.2, 0.0])
"""rad/s2, P"""


def follow(url: str, robot_file: Path) -> None:
    """Follow until the log ends. InputError: robot.toml or the network cannot be used."""
    robot = description.load(robot_file)
    gate = core.ParameterGate(configuration.prior(robot)[0])  # as robot.cfg has it, with or without [nominal]
    is_log = url.startswith("file:")

    def take(channel: str, data: bytes) -> None:
        e = estimate_t.decode(data)
        now_ns = e.t_ns if is_log else time.time_ns()
        covariance, observable = np.array(e.covariance), list(map(bool, e.observable))
        outcome = gate.offer(
            e.sequence,
            e.t_ns,
            e.n_changes,
            np.array(e.theta),
            covariance,
            observable,
            e.verdict,
            bool(e.provisional),
            now_ns,
        )
        if outcome != 0:
            print(f"follow: estimate {e.sequence}: {core.gate_reason(outcome)}", file=sys.stderr)
        theta = gate.read(now_ns)["theta"]
        wrench = core.feed_forward(theta, LEVEL, ACCELERATION, RATE, ANGULAR_ACCELERATION, robot.gravity)
        print(*np.round(wrench, 6))

    network = lcm_network.connect(url)
    network.subscribe("INERTIAD_ESTIMATE", take)
    while True:
        try:
            network.handle()
        except OSError as error:
            if is_log:  # it has ended
                return
            raise InputError(f"{url}: {error.strerror or error}") from None


def main() -> int:
    """Exit code."""
    if len(sys.argv) != 3:
        print(f"usage: {sys.argv[0]} LCM_URL robot.toml", file=sys.stderr)
        return 2
    try:
        follow(sys.argv[1], Path(sys.argv[2]))
    except InputError as error:
        print(*(f"follow: {line}" for line in error.lines), sep="\n", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
