# SPDX-License-Identifier: Apache-2.0
"""The page about a controller that takes its parameters from somewhere: errors over time, by phase and bandwidth."""

from pathlib import Path

import numpy as np

from inertiad.base import finding
from inertiad.base.finding import Finding
from inertiad.control import experiment
from inertiad.control.closed_loop import SOURCES
from inertiad.control.experiment import PHASES, Outcome, Request
from inertiad.report import page, printed, provenance
from inertiad.report.figure import Color, Figure, Mark, Panel, Points, Table, line
from inertiad.report.page import Fold, Page, Section, Tile
from inertiad.report.verdict import Verdict

COLORS: dict[str, Color] = {"nominal": "nominal", "live": "estimate", "oracle": "truth", "adaptive": 3}
TITLES = {"before": "before the first payload", "transient": "just after the payloads", "late": "later"}
WORSE_SHARE, WORSE_MM = 1.05, 0.2
"""live may be worse than nominal by the larger of 5 % and 0.2 mm"""
STEP_MAX = 0.02
"""of the tensions' range, by which a hand-over may move a tension at once"""
LOST_MM = 200.0
"""position error with which it is lost; chosen as three times what 70 kg on 91 kg do at 1.5 Hz on CoGiRo"""


def _over_time(outcomes: list[Outcome], bandwidth: float) -> Figure:
    """Errors and mass of the first seed."""
    some = [(o.arm, o.trace) for o in outcomes if o.bandwidth == bandwidth and o.trace is not None]
    error: list[Mark] = []
    turn: list[Mark] = []
    mass: list[Mark] = []
    for arm, trace in some:
        color = COLORS[arm]
        error.append(line(trace.t, np.maximum(1e3 * trace.error, 1e-3), arm, color))
        turn.append(line(trace.t, np.maximum(np.rad2deg(trace.turn), 1e-4), arm, color))
        mass.append(line(trace.t, trace.theta[:, 0], arm, color))
    panels = [
        Panel(error, "position error, mm", "s", log=True),
        Panel(turn, "attitude error, deg", "s", log=True),
        Panel(mass, "mass that the controller uses, kg", "s"),
    ]
    caption = f"Seed {outcomes[0].seed}, bandwidth {bandwidth:g} Hz."
    key = f"time-{bandwidth:g}".replace(".", "_")
    return Figure(key, f"A motion at {bandwidth:g} Hz", caption, panels, 1, 240)


def _by_phase(outcomes: list[Outcome]) -> Figure:
    labels = [f"{b:g} Hz" for b in dict.fromkeys(o.bandwidth for o in outcomes)]
    panels = []
    for phase in PHASES:
        marks: list[Mark] = []
        for arm in dict.fromkeys(o.arm for o in outcomes):
            rms = [
                float(
                    np.median(
                        [o.phases[phase].rms_mm for o in experiment.select(outcomes, arm, b) if phase in o.phases]
                        or [np.nan]
                    )
                )
                for b in dict.fromkeys(o.bandwidth for o in outcomes)
            ]
            marks.append(Points(labels, rms, arm, COLORS[arm]))
        panels.append(Panel(marks, f"{TITLES[phase]}, rms, mm", log=True))
    return Figure("phases", "Errors by phase", "Medians over the seeds; logarithmic.", panels, 3, 260)


def _worse(outcomes: list[Outcome]) -> list[str]:
    """Seeds and bandwidths at which live parameters are worse than nominal ones."""
    found = []
    nominal = {(o.bandwidth, o.seed): o for o in outcomes if o.arm == "nominal"}
    for live in (o for o in outcomes if o.arm == "live"):
        other = nominal.get((live.bandwidth, live.seed))
        if other is None:
            continue
        for name in ("rms_mm", "max_mm"):
            ours, theirs = getattr(live.whole, name), getattr(other.whole, name)
            if ours > max(WORSE_SHARE * theirs, theirs + WORSE_MM):
                found.append(f"{live.bandwidth:g} Hz, seed {live.seed}: {name[:3]} {ours:.2f} against {theirs:.2f} mm")
    return found


def _lost(outcomes: list[Outcome]) -> list[Finding]:
    """Trials in which the cables could not give what the controller wanted, or the platform was far away."""
    findings = []
    cut = max(outcomes, key=lambda o: o.n_cut)
    if cut.n_cut > 0:
        says = (
            f"{cut.n_cut} of {cut.n_commands} commands are cut off at the limits of the tensions with {cut.arm} "
            f"parameters at {cut.bandwidth:g} Hz, seed {cut.seed}; the first at t = {cut.cut_at:.2f} s"
        )
        do = "a lighter payload, a slower motion, another position, or tension_max of the real cables"
        evidence = {"arms": sorted({o.arm for o in outcomes if o.n_cut}), "n_cut": cut.n_cut, "first_s": cut.cut_at}
        findings.append(Finding("cut_off", "stop", says, do, evidence))
    far = max(outcomes, key=lambda o: o.whole.max_mm)
    if far.whole.max_mm > LOST_MM:
        says = (
            f"the platform is up to {1e-3 * far.whole.max_mm:.2f} m from its desired position with {far.arm} "
            f"parameters at {far.bandwidth:g} Hz, seed {far.seed}"
        )
        do = "a higher --bandwidth, a lighter payload or a slower motion"
        evidence = {"arms": sorted({o.arm for o in outcomes if o.whole.max_mm > LOST_MM}), "max_mm": far.whole.max_mm}
        findings.append(Finding("lost", "stop", says, do, evidence))
    return findings


def judge(outcomes: list[Outcome]) -> Verdict:
    """Findings: is the platform held, is the controller better with live parameters, and never worse?"""
    findings = _lost(outcomes)
    medians = experiment.document(outcomes)
    if not any("late" in o.phases for o in outcomes):
        says = (
            "the motion ends before the transient after the last payload does: no error is that of settled parameters"
        )
        findings.append(Finding("late", "care", says, "a longer motion, or an earlier payload"))
    if "live" in medians and "nominal" in medians:
        worse = _worse(outcomes)
        for bandwidth, ours in medians["live"].items():
            theirs = medians["nominal"][bandwidth]
            if np.isnan(ours["late_rms_mm"]):
                continue
            ratio = theirs["late_rms_mm"] / max(ours["late_rms_mm"], 1e-9)
            times = f"{ratio:.1f} times less" if ratio >= 1.0 else f"{1.0 / ratio:.1f} times more"
            says = (
                f"{bandwidth} Hz: rms after the transient {ours['late_rms_mm']:.2f} mm with live parameters, "
                f"{theirs['late_rms_mm']:.2f} mm with nominal ones: {times}"
            )
            findings.append(Finding("gain", "good" if ratio >= 1.0 else "care", says))
        findings.append(
            Finding("worse", "stop", f"live parameters are worse than nominal ones: {'; '.join(worse[:5])}")
            if worse
            else Finding("worse", "good", "live parameters are in no trial worse than nominal ones by 5 % and 0.2 mm")
        )
        step = max(o.hand_over for o in outcomes if o.arm == "live")
        findings.append(
            Finding(
                "hand_over",
                "good" if step <= STEP_MAX else "care",
                f"the greatest step of a tension by a hand-over is {100 * step:.2f} % of its range",
            )
        )
    beyond = sorted({o.arm for o in outcomes if o.beyond > 0.0})
    if beyond:
        findings.append(Finding("limits", "care", f"a limit of the tensions is broken with: {', '.join(beyond)}"))
    severity = finding.verdict(findings)
    headline = "Live parameters serve the controller" if severity == "good" else "Look at the findings"
    return Verdict(severity, headline, findings)


def _tiles(outcomes: list[Outcome]) -> list[Tile]:
    medians = experiment.document(outcomes)
    bandwidth = next(iter(next(iter(medians.values()))))
    key, name = ("late_rms_mm", "late rms") if "late" in outcomes[0].phases else ("rms_mm", "rms")
    return [
        Tile(f"{arm} parameters", f"{values[bandwidth][key]:.2f}", "mm", f"{name}, {bandwidth} Hz")
        for arm, values in medians.items()
    ]


def page_of(request: Request, outcomes: list[Outcome], command: str) -> Page:
    """The page."""
    run = request.run
    taken = [f"{p.theta[0]:+g} kg at {p.time:g} s" for p in run.payloads]
    said = experiment.notes(outcomes)
    offers = [[name, str(n)] for name, n in experiment.summary(outcomes).items()]
    blocks: list[page.Block] = [_over_time(outcomes, b) for b in request.bandwidths]
    method = (
        "Computed torque with an integral; tensions distributed within their limits. nominal: the body at the start. "
        "live: ESTIMATE through the parameter gate, from the daemon in lock-step. oracle: the true body at every "
        "instant. adaptive: Slotine and Li's law, adapting along bodies that can exist, without identification."
    )
    pose = "as tracker and IMU give it, with their delays" if request.is_pose_measured else "the true one"
    origin = [["command", command], ["pose of the controller", pose], ["sources of parameters", ", ".join(SOURCES)]]
    origin += [[name, value] for name, value in provenance.versions()]
    sections = [
        Section(
            "errors",
            "Errors",
            [
                Table(
                    list(experiment.HEAD),
                    experiment.rows(outcomes),
                    foot="mm; medians over the seeds, hand-over, over limit and commands cut off: the worst.",
                ),
                _by_phase(outcomes),
                *blocks,
            ],
        ),
        Section(
            "told",
            "What was told",
            [*(said or ["Nothing."]), Fold("Offers to the gate", Table(["", "estimates"], offers))],
        ),
        Section("method", "Method", [method, Table(["", ""], origin, numbers=False)]),
    ]
    subtitle = f"{run.robot.name}, {run.body.mass:g} kg, {', '.join(taken) or 'no payload'}, {run.faults_name} sensors"
    return Page(
        "Control with live parameters",
        f"{subtitle}, {len(request.seeds)} seed{'' if len(request.seeds) == 1 else 's'}",
        judge(outcomes),
        _tiles(outcomes),
        sections,
    )


def write(path: Path, figures: Path | None, request: Request, outcomes: list[Outcome], command: str) -> None:
    """control.html, and each drawing as PNG and PDF into a folder if one is given."""
    made = page_of(request, outcomes, command)
    path.write_text(page.render(made), encoding="utf-8")
    if figures is not None:
        printed.write_all(page.drawings_of(made), figures)
