#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Follow the daemon's estimate and print the feed-forward wrench for a wanted acceleration.

    .venv/bin/python host/examples/follow_estimate.py --acceleration 0.5,0,0 --seconds 10

Exit code 1: no estimate that may be used came. A control loop goes through parameter_gate.hpp instead, which also keeps
the parameters from jumping: host/eigen/examples/follow.cpp.
"""

import argparse
import sys
import time

import numpy as np

import inertiad_core as core
from inertiad.base.channels import DEFAULT_PREFIX, DEFAULT_URL
from inertiad.live import lcm_network
from inertiad_lcm import estimate_t

MASS_STD_MAX = 0.02
"""of the mass: a controller gains nothing from a vaguer one"""
GRAVITY = 9.81
"""m/s2"""


class Follower:
    """Keeps the newest estimate that is good enough, and says why another one is not."""

    def __init__(self, acceleration: list[float]) -> None:
        self.n_used = 0
        level = np.add(acceleration, (0.0, 0.0, GRAVITY))  # specific force of a level platform, P axes
        self._Y = core.regressor(level.reshape(1, 3), np.zeros((1, 3)), np.zeros((1, 3)))[0]  # [6, 10]

    def take(self, channel: str, data: bytes) -> None:
        """One message of ESTIMATE."""
        estimate = estimate_t.decode(data)
        if estimate.verdict == estimate_t.STOP:
            print("not used: verdict stop")
        elif not all(estimate.observable):
            print(f"not used: {estimate.observable.count(False)} of ten parameters not observable yet")
        elif estimate.mass_std > MASS_STD_MAX * estimate.mass:
            print(f"not used: too vague, mass {estimate.mass:.1f} ± {estimate.mass_std:.1f} kg")
        else:
            self.n_used += 1
            wrench = self._Y @ np.array(estimate.theta)
            forces, moments = (", ".join(f"{value:.1f}" for value in part) for part in (wrench[:3], wrench[3:]))
            print(f"mass {estimate.mass:.2f} ± {estimate.mass_std:.2f} kg: force {forces} N, moment {moments} N m")


def main() -> int:
    """Listen for some seconds."""
    parser = argparse.ArgumentParser(description="Follow the daemon's estimate.")
    parser.add_argument("--acceleration", default="0,0,0", help="wanted, of a level platform: x,y,z in m/s2")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--every", type=float, default=1.0, help="s between two lines")
    chosen = parser.parse_args()
    follower = Follower([float(part) for part in chosen.acceleration.split(",")])
    link = lcm_network.connect(DEFAULT_URL)
    newest: dict[str, bytes] = {}
    link.subscribe(f"{DEFAULT_PREFIX}ESTIMATE", newest.__setitem__)
    end = time.monotonic() + chosen.seconds
    due = 0.0
    while time.monotonic() < end:
        lcm_network.handle(link, 100)
        if newest and time.monotonic() >= due:
            follower.take(*newest.popitem())
            due = time.monotonic() + chosen.every
    return 0 if follower.n_used else 1


if __name__ == "__main__":
    sys.exit(main())
