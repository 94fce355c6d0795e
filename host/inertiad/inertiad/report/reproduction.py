# SPDX-License-Identifier: Apache-2.0
"""The page about the paper's experiment: Table III, its method reproduced, and the joint fit on the same data."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from inertiad.base.body import NAMES
from inertiad.base.finding import Finding
from inertiad.base.table import Array
from inertiad.check.paper_experiment import Reproduction
from inertiad.identify import two_step
from inertiad.model.trajectory import MOVE_TIME
from inertiad.report import page, printed, provenance
from inertiad.report.figure import Figure, Mark, Panel, Points, Role, Rule, Table
from inertiad.report.page import Page, Section, Tile
from inertiad.report.verdict import Verdict
from inertiad.report.wording import unit_of
from inertiad.robot.keys import inertia_matrix

Z95: Final = 1.96
TABLE_III: Final = np.subtract(two_step.ESTIMATED, two_step.NOMINAL)
FAR_OFF: Final = 0.08
"""m: CoG errors beyond this are of the paper's size"""
ALIKE: Final = 3.0
"""times: the least ratio of two errors to be called different"""
KINDS: Final = (("mass", slice(0, 1)), ("CoG", slice(1, 4)), ("moments of inertia", slice(4, 7)))


def _digits(i: int) -> int:
    return 1 if unit_of(i)[0] == "mm" else 2


def _median_size(error: Array) -> Array:
    return np.asarray(np.median(np.abs(error), axis=0))


def slack(inertia: Any) -> float:
    """kg m2: the other two principal moments minus the largest; negative: no body has them."""
    J = np.linalg.eigvalsh(inertia_matrix(np.asarray(inertia)))
    return float(J[0] + J[1] - J[2])


def beside(found: Reproduction) -> Table:
    """Table III, and both methods' errors; estimate - nominal, medians of the size over the seeds."""
    two, ours, std = _median_size(found.two_step_error), _median_size(found.joint_error), found.joint_std
    covered = (np.abs(found.joint_error) < Z95 * std).mean(axis=0)
    rows = []
    for i, name in enumerate(NAMES):
        unit, k = unit_of(i)
        n = _digits(i)
        numbers = [k * two_step.NOMINAL[i], k * two_step.ESTIMATED[i]]
        errors = [k * two[i], k * ours[i], k * float(np.median(std[:, i]))]
        cells = [f"{v:.{n}f}" for v in numbers] + [f"{k * TABLE_III[i]:+.{n}f}"] + [f"{v:.{n}f}" for v in errors]
        rows.append([name, unit, *cells, f"{two[i] / max(ours[i], 1e-12):.0f} x", f"{100 * covered[i]:.0f} %"])
    head = ["", "unit", "nominal", "Table III", "its error", "two steps, |error|", "joint fit, |error|", "its σ"]
    foot = (
        f"Table III: the robot itself, one experiment. Errors: estimate minus truth, median of the size over "
        f"{len(found.experiments)} simulated experiments. Inside: share with the truth within 1.96 σ of the fit."
    )
    return Table([*head, "gain", "inside"], rows, foot=foot)


def _errors(found: Reproduction) -> Figure:
    """Every experiment's error."""
    panels = []
    for i, name in enumerate(NAMES):
        unit, k = unit_of(i)
        two, ours = k * found.two_step_error[:, i], k * found.joint_error[:, i]
        marks: list[Mark] = [
            Points(["two steps"] * len(two), two.tolist(), "paper's two steps", "truth", hollow=True),
            Points(["joint fit"] * len(ours), ours.tolist(), "joint fit, same data", "estimate", hollow=True),
            Rule(k * float(TABLE_III[i]), "Table III, the robot", "nominal"),
            Rule(0.0, "", "muted"),
        ]
        middle = np.percentile(np.concatenate([two, ours, [k * TABLE_III[i], 0.0]]), [4, 96])
        room = 0.15 * float(middle[1] - middle[0])
        panels.append(Panel(marks, f"{name}, {unit}", span=(float(middle[0]) - room, float(middle[1]) + room)))
    caption = "Estimate minus truth, a circle per experiment; the outermost 4 % may lie outside of a panel."
    return Figure("errors", "Errors of every experiment", caption, panels, 5, 240)


def _sizes(found: Reproduction) -> Figure:
    """Table III's errors beside both methods'."""
    two, ours = _median_size(found.two_step_error), _median_size(found.joint_error)
    panels = []
    for title, part in KINDS:
        unit, k = unit_of(part.start)
        labels = list(NAMES[part])
        rows: tuple[tuple[str, Role, Array], ...] = (
            ("Table III, the robot", "nominal", np.abs(TABLE_III)),
            ("paper's two steps", "truth", two),
            ("joint fit, same data", "estimate", ours),
        )
        marks: list[Mark] = [Points(labels, (k * size[part]).tolist(), name, color) for name, color, size in rows]
        panels.append(Panel(marks, f"|error| of {title}, {unit}", log=True))
    return Figure("sizes", "Size of the errors", "Medians over the experiments; logarithmic.", panels, 3, 260)


def _slack(found: Reproduction) -> Figure:
    """Distance of the two-step results from physical consistency."""
    each = sorted(slack(e.two_step.value[4:]) for e in found.experiments)
    ours = sorted(slack(e.joint.value[4:]) for e in found.experiments)
    labels = [str(i + 1) for i in range(len(each))]
    marks: list[Mark] = [
        Points(labels, each, "paper's two steps", "truth"),
        Points(labels, ours, "joint fit, same data", "estimate"),
        Rule(slack(two_step.ESTIMATED[4:]), "Table III, the robot", "nominal"),
        Rule(0.0, "", "bad"),
    ]
    caption = (
        "The two smaller principal moments minus the largest; a body needs more than 0. Each method's experiments in "
        "rising order."
    )
    return Figure("slack", "Can a body have this inertia?", caption, [Panel(marks, x="experiment", y="kg m²")])


def _unlike(two: Array) -> str:
    """Errors of Table III that the two steps do not repeat, with both sizes."""
    listed = []
    for i in range(7):
        unit, k = unit_of(i)
        here, there = k * two[i], k * abs(float(TABLE_III[i]))
        if max(here, there) > ALIKE * min(here, there):
            listed.append(f"{NAMES[i]} {there:.{_digits(i)}f} there, {here:.{_digits(i)}f} {unit} here")
    return ", ".join(listed)


def judge(found: Reproduction) -> Verdict:
    """Findings from the experiments."""
    n = len(found.experiments)
    two, ours = _median_size(found.two_step_error), _median_size(found.joint_error)
    far = (np.abs(TABLE_III[1:4]) * 1e3).round().astype(int).tolist()
    table = f"Table III's is {far[0]}/{far[1]}/{far[2]} mm off"
    cog = [" / ".join(f"{1e3 * v:.0f}" for v in error[1:4]) for error in (two, ours)]
    is_alike = bool(two[1:4].max() > FAR_OFF)
    unlike = _unlike(two)
    gain = float(np.median(two / np.maximum(ours, 1e-12)))
    inside = float((np.abs(found.joint_error) < Z95 * found.joint_std).mean())
    findings = [
        Finding(
            "two_step_error",
            "good" if is_alike else "care",
            f"the paper's two steps put the CoG {cog[0]} mm off (x / y / z, median of {n}); {table}",
        ),
        Finding(
            "two_step_impossible",
            "good",
            f"{found.n_impossible} of {n} two-step results are no body: their pseudo-inertia is not positive; "
            f"Table III's is none either, by {-slack(two_step.ESTIMATED[4:]):.1f} kg m²",
        ),
        Finding(
            "joint_gain",
            "good" if gain > 1.0 else "stop",
            f"the joint fit on the same data: CoG {cog[1]} mm, mass {ours[0]:.1f} kg, moments "
            f"{' / '.join(f'{v:.1f}' for v in ours[4:7])} kg m²; {gain:.0f} times closer (median of ten parameters)",
        ),
        Finding(
            "coverage",
            "good" if 0.9 <= inside <= 0.995 else "care",
            f"the truth lies within 1.96 σ of the joint fit in {100 * inside:.0f} % of all cases",
        ),
        Finding(
            "assumptions",
            "care",
            "three of the four trajectories and all error levels of the sensors are assumptions: the paper gives one "
            "trajectory and no data sheet",
            "with other error levels: inertiactl simulate --faults FILE.toml, then inertiactl report",
        ),
    ]
    if unlike:
        findings.append(Finding("unlike_table", "care", f"errors of another size than in Table III: {unlike}"))
    headline = "The paper's error of the CoG is reproduced" if is_alike else "The paper's error is not reproduced"
    return Verdict("good" if is_alike else "care", headline, findings)


def page_of(found: Reproduction, command: str) -> Page:
    """Table III beside both methods."""
    n = len(found.experiments)
    two, ours = _median_size(found.two_step_error), _median_size(found.joint_error)
    worst = [1e3 * float(error[1:4].max()) for error in (two, ours)]
    tiles = [
        Tile("CoG, paper's two steps", f"{worst[0]:.0f}", "mm", f"worst axis, median of {n}"),
        Tile("CoG, joint fit on the same data", f"{worst[1]:.1f}", "mm", f"worst axis, median of {n}"),
        Tile("two-step results that no body can have", f"{found.n_impossible} of {n}", "", "Table III: 1 of 1"),
    ]
    seeds = [e.seed for e in found.experiments]
    origin = [["command", command], ["seeds", f"{min(seeds)} to {max(seeds)}"]]
    origin += [[name, value] for name, value in provenance.versions()]
    method = (
        f"Four rest-to-rest trajectories, each forward and backward, {MOVE_TIME:g} s a move. Two steps: 1/m and CoG "
        "from the forces, then the inertia from the moments, each move by itself, medians over the eight. Joint fit: "
        "all eight together, forces and moments in one weak-form regression, sensor errors as further unknowns."
    )
    return Page(
        f"{found.robot_name}: the experiment of Tempel et al., ICRA 2017",
        f"{n} simulated experiments, 4 trajectories forward and backward, {found.rate:g} Hz, the paper's sensors",
        judge(found),
        tiles,
        [
            Section("table", "Table III beside both methods", [beside(found), _sizes(found)]),
            Section("errors", "Errors of every experiment", [_errors(found)]),
            Section("slack", "Can a body have this inertia?", [_slack(found)]),
            Section("method", "What was done", [method]),
            Section("provenance", "Provenance", [Table(["", ""], origin, numbers=False)]),
        ],
    )


def write(found: Reproduction, output: Path, folder: Path | None, command: str) -> None:
    """The page, and each drawing as PNG and PDF into a folder if one is given."""
    made = page_of(found, command)
    output.write_text(page.render(made), encoding="utf-8")
    if folder is not None:
        printed.write_all(page.drawings_of(made), folder)


def text(found: Reproduction) -> str:
    """The table for a terminal."""
    table = beside(found)
    widths = [max(len(row[i]) for row in [table.head, *table.rows]) for i in range(len(table.head))]
    lines = []
    for row in [table.head, *table.rows]:
        cells = [
            cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join([*lines, "", *(f.says for f in judge(found).findings)])
