# SPDX-License-Identifier: Apache-2.0
"""Figures of the site that the report does not have, drawn from the run of the first quick start."""

from pathlib import Path

import numpy as np

import inertiad_core
from inertiad.report import printed
from inertiad.report.figure import Figure, Line, Panel
from inertiad.robot import description
from inertiad.run import reader

SPAN = 4.0
"""s shown, from the middle of the run on"""


def weak_form(run: Path) -> Figure:
    """Angular acceleration by differences of the gyro, and from the windows of the weak form."""
    robot_file = run / "robot.toml"
    robot = description.load(robot_file)
    rows = inertiad_core.rows_of(reader.play(run, robot, str(robot_file), run / "tracker.csv"))
    config = inertiad_core.Config((run / "robot.cfg").read_bytes())
    t_ns = np.rint(1e9 * rows.t).astype(np.int64)
    found = inertiad_core.averages(config, t_ns, rows.acc, rows.gyro, np.zeros((len(rows), 6)))
    begin = float(np.mean(rows.t[[0, -1]]))
    near = (rows.t >= begin) & (rows.t <= begin + SPAN)
    t, difference = rows.t[near] - begin, np.gradient(rows.gyro[near], rows.t[near], axis=0)
    at = np.asarray(found["t"]) * (1e-9 if np.asarray(found["t"]).dtype.kind == "i" else 1.0)
    inside = (at >= begin) & (at <= begin + SPAN)
    panels = []
    for k, axis in enumerate("xyz"):
        marks: list[Line] = [
            Line(t, difference[:, k], "difference of two gyro samples", "muted", width=0.4),
            Line(at[inside] - begin, found["alpha"][inside, k], "window of the weak form", "estimate", width=2.0),
        ]
        panels.append(Panel(list(marks), f"angular acceleration {axis}, rad/s²", "t, s"))
    return Figure("weak_form", "Weak form", "", panels, 3, 220)


def write(run: Path, folder: Path) -> None:
    """Every figure as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = weak_form(run)
    (folder / f"{figure.key}.png").write_bytes(printed.png(figure, dpi=130))
