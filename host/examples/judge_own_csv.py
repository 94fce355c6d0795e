#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Import a CSV log of your own, fit the body, and judge whether the numbers may be used.

    .venv/bin/python host/examples/judge_own_csv.py robot.toml log.csv RUN [MAP.toml]

Without a mapping one is proposed and left in RUN/log.map.toml; correct it, pass it with another RUN. Exit code 0: good,
or usable with care, 1: not to be used, 2: something cannot be read.
"""

import sys
from pathlib import Path

from inertiad.base import finding
from inertiad.base.error import InputError
from inertiad.exchange import channels, foreign_import
from inertiad.identify import fit, identification


def main(robot_file: Path, log: Path, run: Path, mapping: Path | None) -> int:
    """Import, fit, judge."""
    remarks: list[str] = []  # channels and assumptions, a line each
    chosen = channels.read_mapping(mapping) if mapping else None
    for line in foreign_import.import_mapped(log, run, robot_file, chosen, remarks):
        print(line)
    robot, recordings = fit.read([run], robot_file, "joint")
    done = identification.identify("joint", robot, recordings, [], robot_file)
    if done.estimate is not None:
        body = done.estimate.body
        print(f"mass {body.value[0]:.2f} ± {body.std[0]:.2f} kg")
        print(f"CoG  {', '.join(f'{1e3 * x:.1f}' for x in body.value[1:4])} mm")
    for line in finding.lines(done.findings):
        print(line)
    return 1 if finding.verdict(done.findings) == "stop" else 0


if __name__ == "__main__":
    if len(sys.argv) not in (4, 5):
        sys.exit(__doc__)
    words = [Path(word) for word in sys.argv[1:]]
    try:
        sys.exit(main(words[0], words[1], words[2], words[3] if len(words) > 3 else None))
    except InputError as error:
        print(*error.lines, sep="\n", file=sys.stderr)
        sys.exit(2)
