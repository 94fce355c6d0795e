# SPDX-License-Identifier: Apache-2.0
"""Turn an export into a CSV as other tools write them, for the pages: semicolons, decimal commas, kN, foreign names,
every sensor at a rate of its own with blank cells between.   foreign_csv.py SIGNALS TRACKER OUTPUT
"""

import csv
import sys
from pathlib import Path

NAMES = {"acc": "Accel {} [m/s^2]", "gyro": "Gyro {} [rad/s]", "q": "Quat {} [-]", "f": "Force {} [kN]"}
FORCE_EVERY = 4
"""IMU samples per force sample"""


def _heading(name: str) -> str:
    kind, _, rest = name.partition("_")
    return NAMES[kind].format(rest.upper())


def main(signals: Path, tracker: Path, output: Path) -> None:
    """Rows of both files in order of time, blank where a sensor has no sample."""
    with signals.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    names = [cell.split(" ")[0] for cell in rows[0]]
    kept = [k for k, name in enumerate(names) if name.partition("_")[0] in NAMES]
    merged = []
    for number, row in enumerate(rows[1:]):
        cells = []
        for k in kept:
            is_force = names[k].startswith("f_")
            value = f"{1e-3 * float(row[k]):.6f}" if is_force else row[k]
            cells.append("" if is_force and number % FORCE_EVERY else value)
        merged.append((float(row[0]), cells, ["", "", ""]))
    with tracker.open(encoding="utf-8") as file:
        positions = list(csv.reader(file))
    at = [[cell.split(" ")[0] for cell in positions[0]].index(axis) for axis in "xyz"]
    merged += [(float(row[0]), [""] * len(kept), [row[k] for k in at]) for row in positions[1:]]
    with output.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, delimiter=";")
        writer.writerow(
            ["Time [s]", *(_heading(names[k]) for k in kept), *(f"Position {a.upper()} [m]" for a in "xyz")]
        )
        for t, cells, position in sorted(merged, key=lambda entry: entry[0]):
            writer.writerow([f"{t:.6f}".replace(".", ","), *(c.replace(".", ",") for c in (*cells, *position))])


main(*map(Path, sys.argv[1:]))
