# SPDX-License-Identifier: Apache-2.0
"""Pictures beside a command's numbers, as one page or one PNG: of a fit, of the delays between instruments."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from inertiad.base.error import InputError
from inertiad.base.finding import HEADLINES, Finding, Severity, verdict
from inertiad.base.table import Array
from inertiad.identify import fit, sync
from inertiad.identify.fit import Segment
from inertiad.identify.identification import Identification
from inertiad.identify.sync import Curves, Sync
from inertiad.model.window_residual import Residual
from inertiad.report import cables, figures, page, printed, provenance, report_data, tables
from inertiad.report.figure import Figure, Line, Mark, Panel, Rule, Table, line
from inertiad.report.page import Page, Section, Tile
from inertiad.report.report_data import Facts, Run
from inertiad.report.verdict import Verdict
from inertiad.report.wording import number
from inertiad.robot import configuration
from inertiad.run import reader
from inertiad.run.reader import Recording

ENDINGS: Final = (".html", ".png")
SMOOTH: Final = 0.02
"""s over which the tracker's residuals are averaged to be drawn: its noise would hide what the delay does"""


def check(output: Path) -> None:
    """InputError: neither a page nor a PNG, found out before the long work."""
    if output.suffix.lower() not in ENDINGS and str(output) != "-":
        raise InputError(
            f"--picture {output}: allowed: a file that ends with {' or '.join(ENDINGS)}; -: a page to stdout"
        )


def _stacked(made: Page) -> bytes:
    """All drawings of a page below each other, as one PNG."""
    from PIL import Image

    parts = [Image.open(io.BytesIO(printed.png(drawing))) for drawing in page.drawings_of(made)]
    whole = Image.new("RGB", (max(part.width for part in parts), sum(part.height for part in parts)), "white")
    at = 0
    for part in parts:
        whole.paste(part, (0, at))
        at += part.height
    buffer = io.BytesIO()
    whole.save(buffer, "PNG")
    return buffer.getvalue()


def write(output: Path, made: Page) -> None:
    """A page, or a PNG of its drawings, by the ending."""
    if output.suffix.lower() == ".png":
        output.write_bytes(_stacked(made))
    else:
        output.write_text(page.render(made), encoding="utf-8")


def _provenance(command: str) -> Section:
    rows = [["command", command], *[[name, value] for name, value in provenance.versions()]]
    return Section("provenance", "Provenance", [Table(["", ""], rows, numbers=False)])


# ---- fit -------------------------------------------------------------------------------------------------------------


def _residual(config: Any, done: Identification, recording: Recording) -> Residual:
    """Of one run, each stretch under the body that it has."""
    assert done.estimate is not None
    own: list[Segment] = [part for part in done.segments if part.path == recording.path]
    whole = cables.residual(config, own[0].estimate if own else done.estimate, recording)
    for part in own[1:]:
        later = cables.residual(config, part.estimate, recording)
        inside = (whole.t >= part.begin)[:, None]
        whole = replace(
            whole,
            wrench=np.where(inside, later.wrench, whole.wrench),
            tension=np.where(inside, later.tension, whole.tension),
        )
    return whole


def _facts(done: Identification, recordings: list[Recording], command: str) -> Facts:
    assert done.estimate is not None
    robot = recordings[0].robot
    config = reader.config_of(robot, robot.name)
    runs = [
        Run(
            one.path,
            one.path.name,
            one.robot,
            one,
            history=report_data.history_of(config, one),
            residual=_residual(config, done, one),
        )
        for one in recordings
    ]
    truth = fit.truth_of([one.path for one in recordings])
    methods: dict[str, fit.Estimate | str] = {done.estimate.method: done.estimate}
    return Facts(robot, runs, done.estimate, methods, truth=truth, found=done.findings, command=command)


def of_fit(done: Identification, recordings: list[Recording], command: str) -> Page:
    """Ten numbers with sigma, residual per cable over time, convergence over each run."""
    names = ", ".join(one.path.name for one in recordings)
    severity = verdict(done.findings)
    judged = Verdict(severity, HEADLINES[severity], done.findings)
    title = f"{recordings[0].robot.name}: fit of {names}"
    subtitle = f"{sum(one.duration for one in recordings):.1f} s, {recordings[0].robot.n_cables} cables"
    if done.estimate is None:
        return Page(title, subtitle, judged, [], [_provenance(command)])
    facts = _facts(done, recordings, command)
    numbers = [
        replace(figure, key="numbers", title="Ten numbers", caption="Bars are ± 2 σ.")
        for figure in figures.methods(facts)
    ]
    value, std = done.estimate.body.value, done.estimate.body.std
    mass = Tile("mass", number(value[0], std[0]), "kg", f"± {number(std[0], std[0])} kg, one σ")
    sections = [
        Section("result", "Result", [tables.result(facts), *numbers]),
        Section("residuals", "Residual per cable", [*figures.residuals_over_time(facts)]),
        Section("convergence", "Convergence", [*figures.convergence(facts)]),
        _provenance(command),
    ]
    return Page(title, subtitle, judged, [mass], sections)


# ---- sync ------------------------------------------------------------------------------------------------------------


def _averaged(t: Array, e: Array) -> tuple[Array, Array]:
    """Residuals [N] over pieces of SMOOTH."""
    piece = np.floor((t - t[0]) / SMOOTH).astype(np.int64)
    first = np.flatnonzero(np.diff(piece, prepend=-1))
    count = np.diff(first, append=len(t))
    return np.add.reduceat(t, first) / count, np.add.reduceat(e, first) / count


def _against(key: str, title: str, delay: Array, rms: Array, unit: str, marks: list[tuple[str, float, str]]) -> Panel:
    """Residual over the delay [ms], with upright lines at some delays."""
    low, high = float(rms.min()), float(rms.max())
    room = 0.08 * max(high - low, 1e-3 * high)
    upright: list[Mark] = [
        Line(np.array([1e3 * at] * 2), np.array([low - room, high + room]), name, color, dashed=color == "nominal")  # type: ignore[arg-type]
        for name, at, color in marks
    ]
    curve: Mark = Line(1e3 * delay, rms, key, "estimate", width=2.0)
    return Panel([curve, *upright], title, "delay, ms", unit, span=(low - room, high + room))


def _delays(found: Sync, drawn: Curves) -> Figure:
    configured = configuration.delays(found.robot)
    p, (force, force_std) = found.position, found.force
    panels = []
    for title, delay, rms, unit, value, std, was in (
        ("tracker", drawn.position_delay, 1e3 * drawn.position_rms, "mm", p.value, p.std, configured["position"]),
        ("forces", drawn.force_delay, drawn.force_rms, "N", force, force_std, configured["force"]),
    ):
        shown = [("found", value, "good"), ("± 2 σ", value - 2 * std, "care"), ("± 2 σ", value + 2 * std, "care")]
        panels.append(_against("residual, rms", title, delay, rms, unit, [*shown, ("robot.toml", was, "nominal")]))
    caption = (
        "Tracker: residual of its positions, motion and sensor errors fitted anew to each delay. Forces: residual "
        "force of the fit. A curve with a clear lowest point is a delay that this motion shows."
    )
    return Figure("delays", "Residual against delay", caption, panels, 2, 260)


def _alignment(found: Sync, drawn: Curves) -> Figure:
    panels = []
    for k, axis in enumerate("xyz"):
        marks: list[Mark] = []
        for name, e, color in (
            ("as robot.toml has it", drawn.before, "bad"),
            ("with the delay found", drawn.after, "estimate"),
        ):
            marks.append(line(*_averaged(drawn.t, 1e3 * e[:, k]), name, color, width=1.0))  # type: ignore[arg-type]
        panels.append(Panel([*marks, Rule(0.0, "", "muted")], axis, "t, s", "mm"))
    caption = (
        f"Tracked position against the motion that the IMU measures, averaged over {1e3 * SMOOTH:.0f} ms. A wrong "
        "delay leaves a residual that follows the speed; what follows nothing is noise."
    )
    return Figure("alignment", "Alignment over time", caption, panels, 3, 220)


def of_sync(found: Sync, drawn: Curves, command: str) -> Page:
    """Alignment over time, residual against each delay."""
    severity: Severity = "care" if found.position.std > sync.VAGUE else "good"
    said = list(sync.text(found))
    p, (force, force_std) = found.position, found.force
    tiles = [
        Tile(
            f"delay of the {name}", number(1e3 * value, 1e3 * std), "ms", f"± {number(1e3 * std, 1e3 * std)} ms, one σ"
        )
        for name, value, std in (("tracker", p.value, p.std), ("forces", force, force_std))
    ]
    sections = [
        Section("delays", "Residual against delay", [_delays(found, drawn)]),
        Section("alignment", "Alignment", [_alignment(found, drawn)]),
        Section("remarks", "Remarks", [*said[2:]]),
        _provenance(command),
    ]
    findings = [
        Finding(f"{name}_delay", severity, text) for name, text in zip(("tracker", "force"), said, strict=False)
    ]
    judged = Verdict(severity, "Delays between the instruments", findings)
    return Page(
        f"{found.robot.name}: alignment of {found.run.name}", f"{p.n_samples} positions", judged, tiles, sections
    )
