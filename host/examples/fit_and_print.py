#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Fit a body to runs and print it in a format of your own, here the YAML that a controller might read.

    .venv/bin/python host/examples/fit_and_print.py run1 run2 > body.yaml

Exit code 1: the result is not to be used, 2: a run cannot be read.
"""

import sys
from pathlib import Path

from inertiad.base import finding
from inertiad.base.error import InputError
from inertiad.identify import fit, identification


def main(runs: list[Path]) -> int:
    """Fit all runs together."""
    robot, recordings = fit.read(runs, None, "joint")
    done = identification.identify("joint", robot, recordings, [], None)
    verdict = finding.verdict(done.findings)
    for one in done.findings:
        if one.severity != "good":
            print(f"{one.severity}: {one.says}; {one.do}", file=sys.stderr)
    if done.estimate is None or verdict == "stop":
        return 1
    value, std = done.estimate.body.value, done.estimate.body.std
    print(f"# {robot.name}, from {', '.join(map(str, runs))}; standard deviations in the comments")
    print(f"verdict: {verdict}")
    print(f"mass: {value[0]:.3f}  # kg, {std[0]:.3f}")
    print(f"cog: [{', '.join(f'{x:.5f}' for x in value[1:4])}]  # m, {max(std[1:4]):.5f}")
    xx, yy, zz, yz, xz, xy = value[4:]
    print(f"inertia:  # about the CoG, platform axes, kg m2, {max(std[4:]):.3f}")
    for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)):
        print(f"  - [{', '.join(f'{x:.4f}' for x in row)}]")
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    try:
        sys.exit(main([Path(word) for word in sys.argv[1:]]))
    except InputError as error:
        print(*error.lines, sep="\n", file=sys.stderr)
        sys.exit(2)
