#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Follow the daemon's estimate and print it.

    .venv/bin/python host/examples/follow_estimate.py --seconds 10

Exit code 1: no estimate came. A control loop goes through the parameter gate instead, which says what may be used and
keeps the parameters from jumping: host/examples/follow.py, host/eigen/examples/follow.cpp.
"""

import argparse
import sys
import time

from inertiad.base.channels import DEFAULT_PREFIX, DEFAULT_URL
from inertiad.live import lcm_network
from inertiad_lcm import estimate_t

VERDICTS = {estimate_t.GOOD: "good", estimate_t.CARE: "care", estimate_t.STOP: "stop"}


def line_of(estimate: estimate_t) -> str:
    """An estimate in words."""
    cog = ", ".join(f"{1e3 * value:.1f}" for value in estimate.cog)
    n_known = sum(map(bool, estimate.observable))
    verdict = VERDICTS.get(estimate.verdict, "none")
    mass = f"mass {estimate.mass:.2f} ± {estimate.mass_std:.2f} kg"
    return f"{mass}, CoG {cog} mm, {n_known} of 10 parameters observable, verdict {verdict}"


def main() -> int:
    """Listen for some seconds."""
    parser = argparse.ArgumentParser(description="Follow the daemon's estimate.")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--every", type=float, default=1.0, help="s between two lines")
    chosen = parser.parse_args()
    link = lcm_network.connect(DEFAULT_URL)
    newest: dict[str, bytes] = {}
    link.subscribe(f"{DEFAULT_PREFIX}ESTIMATE", newest.__setitem__)
    end = time.monotonic() + chosen.seconds
    due, n_printed = 0.0, 0
    while time.monotonic() < end:
        lcm_network.handle(link, 100)
        if newest and time.monotonic() >= due:
            print(line_of(estimate_t.decode(newest.popitem()[1])))
            n_printed += 1
            due = time.monotonic() + chosen.every
    return 0 if n_printed else 1


if __name__ == "__main__":
    sys.exit(main())
