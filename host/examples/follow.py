# SPDX-License-Identifier: Apache-2.0
"""A controller in Python that follows the daemon: ESTIMATE goes through the parameter gate, whose parameters give the
wrench to feed forward. Prints a line per estimate until interrupted or the log ends.

Usage: .venv/bin/python host/examples/follow.py LCM_URL robot.toml
"""

import sys
import time
from pathlib import Path

import lcm
import numpy as np

import inertiad_core as core
from inertiad.robot import configuration, description
from inertiad_lcm import estimate_t

ACCELERATION = np.array([[0.5, 0.0, 9.81]])
"""m/s2, of the platform's reference point, gravity included: level platform"""
RATE = np.array([[0.0, 0.0, 0.1]])
"""rad/s"""
ANGULAR_ACCELERATION = np.array([[0.0, 0.2, 0.0]])
"""rad/s2"""


def main(url: str, robot_file: str) -> None:
    """Follow until the messages end."""
    nominal = description.load(Path(robot_file)).nominal
    gate = core.ParameterGate(configuration.theta_of(nominal))
    Y = core.regressor(ACCELERATION, RATE, ANGULAR_ACCELERATION)[0]
    is_log = url.startswith("file:")

    def take(channel: str, data: bytes) -> None:
        e = estimate_t.decode(data)
        now_ns = e.t_ns if is_log else time.time_ns()
        covariance, observable = np.array(e.covariance), list(map(bool, e.observable))
        outcome = gate.offer(
            e.sequence, e.t_ns, e.n_changes, np.array(e.theta), covariance, observable, e.verdict, now_ns
        )
        if outcome != 0:
            print(f"follow: estimate {e.sequence}: {core.gate_reason(outcome)}", file=sys.stderr)
        print(*np.round(Y @ gate.read(now_ns)["theta"], 6))

    network = lcm.LCM(url)
    network.subscribe("INERTIAD_ESTIMATE", take)
    while True:
        try:
            network.handle()
        except OSError:  # the log has ended
            return


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(f"usage: {sys.argv[0]} LCM_URL robot.toml")
    main(sys.argv[1], sys.argv[2])
