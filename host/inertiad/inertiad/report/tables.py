# SPDX-License-Identifier: Apache-2.0
"""Tables of text from the report's data."""

from typing import Final

import numpy as np

from inertiad.base.body import NAMES
from inertiad.report import figures, wording
from inertiad.report.figure import Table
from inertiad.report.report_data import Facts
from inertiad.report.wording import number, unit_of
from inertiad.robot import systematic

HARDLY: Final = 0.9
"""sigma after, of before, from which a parameter counts as not observed"""


def result(facts: Facts) -> Table:
    """Table III of the paper, with sigmas, and the truth of a simulated run."""
    joint, nominal, truth = facts.joint, facts.nominal, facts.truth
    assert joint is not None
    head = ["", "unit", "estimate", "± σ"]
    head += ["nominal", "difference"] if nominal else []
    head += ["truth", "error", "error / σ"] if truth else []
    rows = []
    for i, name in enumerate(NAMES):
        unit, k = unit_of(i)
        value, std = k * joint.body.value[i], k * joint.body.std[i]
        row = [name, unit, number(value, std), number(std, std)]
        if nominal is not None:
            there = k * nominal.value[i]
            row += [number(there, std), number(value - there, std, True)]
        if truth is not None:
            there = k * truth.value[i]
            row += [number(there, std), number(value - there, std, True), f"{(value - there) / std:+.1f}"]
        rows.append(row)
    faint = [i for i, seen in enumerate(joint.observable) if not seen]
    foot = "σ: one standard deviation, slow errors of the sensors included. CoG from P, inertia about the CoG, matrix "
    foot += "entries, platform axes."
    return Table(head, rows, foot=foot + (" Grey: not observable from this motion." if faint else ""), faint=faint)


def methods(facts: Facts) -> Table:
    """Every answer beside each other."""
    found = figures.answers(facts)
    rows = []
    for i, name in enumerate(NAMES):
        unit, k = unit_of(i)
        cells = [
            wording.shown(k * b.value[i], k * b.std[i]) if b.std[i] > 0 else f"{k * b.value[i]:.2f}"
            for _, b, _ in found
        ]
        rows.append([name, unit, *cells])
    return Table(["", "unit", *(name for name, _, _ in found)], rows)


def calibration(facts: Facts) -> Table:
    """Every sensor error: found, left, expected."""
    joint = facts.joint
    assert joint is not None and joint.xi is not None and joint.xi_std is not None
    rows, faint = [], []
    parameters = zip(systematic.names(facts.robot.n_cables), wording.factors(facts.robot.n_cables), strict=True)
    for i, (name, (k, unit)) in enumerate(parameters):
        std, before = k * joint.xi_std[i], k * facts.prior_xi[i]
        if std > HARDLY * before:
            faint.append(i)
        rows.append([wording.spaced(name), unit, number(k * joint.xi[i], std, True), number(std, std), f"{before:.3g}"])
    foot = (
        "Corrections to robot.toml's [calibration]. Grey: not observable in these runs. "
        "inertiactl calibrate writes them to a file."
    )
    return Table(["", "unit", "found", "± σ", "σ before"], rows, foot=foot, faint=faint)


def tensions(facts: Facts) -> Table:
    """Per cable: range, share of the time outside, residual."""
    f = np.concatenate([run.f for run in facts.runs if run.has_rows])
    rows = []
    for i, cable in enumerate(facts.robot.cable):
        column = f[:, i]
        outside = [100.0 * np.mean(column < cable.tension_min), 100.0 * np.mean(column > cable.tension_max)]
        check = facts.force_check
        rows.append(
            [
                f"cable {i + 1}",
                *(f"{v:.0f}" for v in (column.min(), np.median(column), column.max())),
                f"{cable.tension_min:g} – {cable.tension_max:g}",
                *(f"{v:.2f}" for v in outside),
                *([f"{check.rms[i]:.2f}", f"{check.without[i]:.2f}"] if check else []),
            ]
        )
    head = ["", "least, N", "median, N", "greatest, N", "limits, N", "below, %", "above, %"]
    alert = [facts.force_check.worst] if facts.force_check is not None and facts.force_check.broken is not None else []
    return Table([*head, *(["residual, N", "without it, N"] if facts.force_check else [])], rows, alert=alert)


def motion(facts: Facts) -> Table:
    """Greatest values of the motion."""
    rows = []
    for run, m in zip(facts.usable, facts.motions, strict=True):
        if not len(m.t):
            continue
        tilt = np.rad2deg(np.arccos(np.clip(m.R[:, 2, 2], -1.0, 1.0)))
        speed = np.linalg.norm(np.diff(m.position, axis=0), axis=1) / np.maximum(np.diff(m.t), 1e-9)
        rate, alpha = (np.rad2deg(np.linalg.norm(v, axis=1)) for v in (m.omega, m.alpha))
        cells = [f"{np.max(v, initial=0.0):.3g}" for v in (tilt, speed, rate, alpha)]
        rows.append([run.name, f"{m.t[-1] - m.t[0]:.1f}", *cells])
    return Table(["run", "duration, s", "tilt, deg", "speed, m/s", "rate, deg/s", "angular acceleration, deg/s²"], rows)


def loss(facts: Facts) -> Table:
    """Frames and rows per run."""
    rows = []
    for run in facts.runs:
        if not run.has_rows or run.recording is None:
            rows.append([run.name, *["–"] * 6])
            continue
        step = np.diff(run.t)
        lost = run.recording.n_rejected
        total = max(lost + len(run.recording.rows), 1)
        frames = str(run.recording.n_frames) if run.recording.n_frames else "–"
        numbers = [f"{lost}", f"{100 * lost / total:.2f}", f"{1.0 / np.median(step):.5g}", f"{1e3 * step.max():.3g}"]
        rows.append([run.name, frames, str(len(run.recording.rows)), *numbers])
    return Table(["run", "CAN frames", "rows", "lost", "lost, %", "rate, Hz", "longest interval, ms"], rows)


def counters(facts: Facts) -> Table | None:
    """Counters of every stage; those that are not 0."""
    counted = [run for run in facts.runs if run.recording is not None and run.recording.counters]
    names: list[str] = []
    for run in counted:
        assert run.recording is not None
        names += [name for name, n in run.recording.counters.items() if n and name not in names]
    rows = [[name, *(str(run.recording.counters.get(name, 0)) for run in counted if run.recording)] for name in names]
    return Table(["counter", *(run.name for run in counted)], rows) if rows else None
