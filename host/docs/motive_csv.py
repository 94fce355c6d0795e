# SPDX-License-Identifier: Apache-2.0
"""Turn tracker.csv into an export as Motive writes it, for the pages: mm, y up, a clock that begins at 0.
motive_csv.py TRACKER OUTPUT
"""

import csv
import sys
from pathlib import Path

HEAD = (
    "Format Version,1.23,Take Name,drive 1,Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
    "",
    ",Type,Rigid Body,Rigid Body,Rigid Body",
    ",Name,Platform,Platform,Platform",
    ",ID,E1,E1,E1",
    ",,Position,Position,Position",
    "Frame,Time (Seconds),X,Y,Z",
)


def main(tracker: Path, output: Path) -> None:
    """Positions x y z, m, z up -> x, z, -y in mm."""
    with tracker.open(encoding="utf-8") as file:
        rows = [[float(cell) for cell in row[:4]] for row in list(csv.reader(file))[1:]]
    lines = [
        f"{number},{t - rows[0][0]:.6f},{1e3 * x:.4f},{1e3 * z:.4f},{-1e3 * y:.4f}"
        for number, (t, x, y, z) in enumerate(rows)
    ]
    output.write_text("\n".join([*HEAD, *lines, ""]), encoding="utf-8")


main(*map(Path, sys.argv[1:]))
