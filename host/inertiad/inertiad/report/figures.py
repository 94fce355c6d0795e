# SPDX-License-Identifier: Apache-2.0
"""Figures from the report's data. Empty figures are left out."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from inertiad.base.body import NAMES, Body
from inertiad.base.table import Array
from inertiad.identify.fit import Estimate
from inertiad.report import wording
from inertiad.report.figure import Bars, Color, Figure, Heat, Line, Mark, Panel, Points, Role, Rule, line
from inertiad.report.report_data import Facts, Run
from inertiad.report.wording import unit_of
from inertiad.robot import systematic

KINDS: Final = (("mass", range(0, 1)), ("CoG", range(1, 4)), ("inertia", range(4, 10)))
AXES: Final = ("x", "y", "z")
CHANNELS: Final = ("F x", "F y", "F z", "M x", "M y", "M z")
FLOOR: Final = 1e-9
NEAR: Final = 3.0
"""times the greatest tension: a limit further away is named in the caption, not drawn"""


def _several(facts: Facts, run: Run) -> str:
    """The run that a panel shows, where there are several."""
    return run.name if len(facts.runs) > 1 else ""


def convergence(facts: Facts) -> Iterator[Figure]:
    """The filter's estimate over the run."""
    for number, run in enumerate(facts.usable):
        h = run.history
        if h is None or len(h.t) < 2 or facts.joint is None:
            continue
        panels = []
        for i, name in enumerate(NAMES):
            unit, k = unit_of(i)
            final = k * facts.joint.body.value[i]
            t, value, half = h.t, k * h.value[:, i], 2.0 * k * h.std[:, i]
            marks: list[Mark] = [Line(t, value, "filter on the platform, ± 2 σ", "estimate", half=half)]
            marks.append(Rule(final, "joint fit", "good"))
            if facts.truth is not None:
                marks.append(Rule(k * facts.truth.value[i], "truth", "truth"))
            elif facts.nominal is not None:
                marks.append(Rule(k * facts.nominal.value[i], "nominal", "nominal"))
            away = np.abs(value - final) + half
            reach = 1.2 * max(float(np.quantile(away, 0.7)), 4.0 * half[-1], FLOOR)
            panels.append(Panel(marks, f"{name}, {unit}", "t, s", span=(final - reach, final + reach)))
        key = "convergence" if number == 0 else f"convergence_{number + 1}"
        yield Figure(
            key,
            f"Convergence {_several(facts, run)}".strip(),
            "The daemon's own estimate, recomputed by the same core, against the joint fit of everything.",
            panels,
            5,
            190,
        )


def residuals(facts: Facts) -> Iterator[Figure]:
    """Force sensors against each other."""
    check = facts.force_check
    if check is None:
        return
    labels = [str(i + 1) for i in range(len(check.rms))]
    colors: list[Color] = ["estimate"] * len(labels)
    colors[check.worst] = "care" if check.broken is None else "bad"
    everything = Rule(check.everything, "all sensors used", "muted")
    panels = [
        Panel([Bars(labels, check.rms.tolist(), "", colors)], "residual per cable, rms", "cable", "N"),
        Panel(
            [Bars(labels, check.without.tolist(), "", colors), everything],
            "what is left when the cable's force is unknown",
            "cable",
            "N",
        ),
    ]
    if check.error is not None and check.t is not None:
        title = f"error of sensor {check.worst + 1}, from all others"
        panels.append(Panel([line(check.t, check.error, "", "bad")], title, "t, s", "N"))
    word = "does not fit" if check.broken is not None else "is worst"
    yield Figure(
        "residuals",
        "Force sensors",
        f"Cable {check.worst + 1} {word}. Left: the smallest change of tensions that explains what the fit does not. "
        "A broken sensor makes the middle bar of its own cable fall far below the line of all sensors.",
        panels,
        3,
    )
    yield from residuals_over_time(facts)


def residuals_over_time(facts: Facts) -> Iterator[Figure]:
    """What is left of each cable's force."""
    shown = [run for run in facts.usable if run.residual is not None and len(run.residual.t) > 1]
    if not shown:
        return
    panels = []
    for run in shown:
        r = run.residual
        assert r is not None
        marks: list[Mark] = [
            line(r.t, r.tension[:, i], f"cable {i + 1}", i, width=1.0) for i in range(r.tension.shape[1])
        ]
        panels.append(Panel(marks, _several(facts, run), "t, s", "N"))
    caption = (
        "Of every window of the weak form; patterns that repeat with the motion mean geometry, steps mean a sensor."
    )
    yield Figure("residuals_over_time", "Residual per cable over time", caption, panels, 2 if len(panels) > 1 else 1)


def tensions(facts: Facts) -> Iterator[Figure]:
    """Against each cable's limits."""
    shown = [run for run in facts.runs if run.has_rows]
    if not shown:
        return
    low = min(c.tension_min for c in facts.robot.cable)
    high = max(c.tension_max for c in facts.robot.cable)
    peak = max(float(run.f.max()) for run in shown)
    rules: list[Mark] = [Rule(low, "tension_min", "care")]
    if high < NEAR * peak:
        rules.append(Rule(high, "tension_max", "bad"))
    panels = []
    for run in shown:
        marks: list[Mark] = [line(run.t, run.f[:, i], f"cable {i + 1}", i, width=1.0) for i in range(run.f.shape[1])]
        panels.append(Panel([*marks, *rules], _several(facts, run), "t, s", "N"))
    f = np.concatenate([run.f for run in shown])
    labels = [str(i + 1) for i in range(f.shape[1])]
    least, p5, p50, p95, most = np.percentile(f, [0, 5, 50, 95, 100], axis=0)
    panels.append(
        Panel(
            [
                Bars(labels, (most - least).tolist(), "least to greatest", "muted", least.tolist(), thin=True),
                Bars(labels, (p95 - p5).tolist(), "90 % of the time", "estimate", p5.tolist()),
                Points(labels, p50.tolist(), "median", "ink"),
                *rules,
            ],
            "range of each cable",
            "cable",
            "N",
        )
    )
    inside = f"tension_min {low:g} N, tension_max {high:g} N"
    caption = f"As measured; {inside}{'' if high < NEAR * peak else ' (above what is shown)'}."
    yield Figure("tensions", "Tensions against limits", caption, panels, 2, 280)


def motion(facts: Facts) -> Iterator[Figure]:
    """Excitation over the run."""
    panels = []
    for run, m in zip(facts.usable, facts.motions, strict=True):
        if len(m.t) < 2:
            continue
        name = _several(facts, run)
        prefix = f"{name}: " if name else ""
        rows = (
            ("position of P, m", m.position - m.position.mean(axis=0)),
            ("roll pitch yaw, deg", np.rad2deg(m.rpy)),
            ("rate, deg/s", np.rad2deg(m.omega)),
            ("angular acceleration, deg/s²", np.rad2deg(m.alpha)),
        )
        for title, values in rows:
            marks: list[Mark] = [line(m.t, values[:, i], AXES[i], i, width=1.2) for i in range(3)]
            panels.append(Panel(marks, prefix + title, "t, s"))
    if panels:
        caption = "Mass needs nothing but weight, the CoG tilt, the inertia angular acceleration about every axis."
        yield Figure("motion", "Motion", caption, panels, 4, 190)


def coverage(facts: Facts) -> Iterator[Figure]:
    """Sigma of each parameter before, after, and with known sensor errors."""
    u = facts.uncertainty
    if u is None:
        return
    panels = []
    for title, part in KINDS:
        unit, k = unit_of(part[0])
        labels = [NAMES[i] for i in part]
        rows: tuple[tuple[str, Role, Array], ...] = (
            ("before", "muted", u.prior),
            ("after", "estimate", u.found),
            ("if all else were known", "good", u.alone),
        )
        marks: list[Mark] = [Points(labels, [k * float(s[i]) for i in part], name, color) for name, color, s in rows]
        panels.append(Panel(marks, f"σ of {title}, {unit}", log=True))
    caption = (
        "Coverage of the excitation. Before: what [nominal] and the priors allow. The distance from after to the "
        "lowest is lost to sensor errors and to parameters that look alike."
    )
    yield Figure("coverage", "Excitation per parameter", caption, panels, 3, 240)


def observability(facts: Facts) -> Iterator[Figure]:
    """Error sources of each parameter, and correlations."""
    u = facts.uncertainty
    if u is None:
        return
    kinds = sorted(u.share, key=lambda name: -float(u.share[name].max()))
    kinds = [name for name in kinds if u.share[name].max() > 0.02] or kinds[:1]
    share = np.array([u.share[name] for name in kinds])
    yield Figure(
        "limits",
        "What limits the answer",
        "Part of each parameter's variance that would go if this were known exactly. Sensor errors act together, so "
        "columns need not add up to 100 %; what is left when all is low is noise and motion.",
        [Panel([Heat([wording.spaced(n) for n in kinds], list(NAMES), share, signed=False, as_percent=True)])],
        1,
        60 + 30 * len(kinds),
    )
    yield Figure(
        "correlation",
        "Correlation of the parameters",
        "Near ± 1, only a combination of the two parameters is observable.",
        [Panel([Heat(list(NAMES), list(NAMES), u.correlation, signed=True)])],
        1,
        380,
    )


def methods(facts: Facts) -> Iterator[Figure]:
    """Every method's answer, beside nominal and truth."""
    if facts.joint is None:
        return
    panels, outside = [], set()
    for i, name in enumerate(NAMES):
        span = _span(facts, i)
        k = unit_of(i)[1]
        outside |= {method for method, body, _ in answers(facts) if not span[0] <= k * body.value[i] <= span[1]}
        panels.append(Panel(_method_marks(facts, i), f"{name}, {unit_of(i)[0]}", span=span))
    caption = "Bars are ± 2 σ as each method claims it; the two-step method claims none for a single run."
    if outside:
        caption += f" Off the scale where it is missing: {', '.join(sorted(outside))}; see Numbers."
    yield Figure("methods", "Methods", caption, panels, 5, 210)


def _span(facts: Facts, i: int) -> tuple[float, float]:
    """Of a panel: all answers but those so far off that the others would fall into one."""
    k = unit_of(i)[1]
    near = [(k * b.value[i], 2.0 * k * b.std[i]) for name, b, _ in answers(facts) if name != "paper"]
    near += [(k * b.value[i], 0.0) for b in (facts.nominal, facts.truth) if b is not None]
    low, high = min(v - half for v, half in near), max(v + half for v, half in near)
    room = max(high - low, FLOOR)
    paper = facts.methods.get("paper")
    if isinstance(paper, Estimate) and low - room < k * paper.body.value[i] < high + room:
        low, high = min(low, k * paper.body.value[i]), max(high, k * paper.body.value[i])
    return low - 0.08 * room, high + 0.08 * room


def answers(facts: Facts) -> list[tuple[str, Body, Color]]:
    """Name, body, colour of everything that can be compared."""
    found: list[tuple[str, Body, Color]] = []
    for number, (name, result) in enumerate(facts.methods.items()):
        if isinstance(result, Estimate):
            found.append((name, result.body, "estimate" if name == "joint" else number))
    check = facts.force_check
    if check is not None and check.broken is not None and check.body is not None:
        found.append((f"without {check.broken + 1}", check.body, "good"))
    daemons = [run.daemon for run in facts.usable if run.daemon is not None]
    if len(facts.usable) == 1 and daemons:
        found.append(("daemon", daemons[0], 6))
    return found


def _method_marks(facts: Facts, i: int) -> list[Mark]:
    _, k = unit_of(i)
    marks: list[Mark] = []
    for name, body, color in answers(facts):
        marks.append(Points([name], [k * body.value[i]], name, color, [2.0 * k * body.std[i]]))
    if facts.nominal is not None:
        marks.append(Rule(k * facts.nominal.value[i], "nominal", "nominal"))
    if facts.truth is not None:
        marks.append(Rule(k * facts.truth.value[i], "truth", "truth"))
    return marks


def repeatability(facts: Facts) -> Iterator[Figure]:
    """Each run by itself."""
    estimates = [(run.name, run.estimate.body) for run in facts.usable if run.estimate is not None]
    if len(estimates) < 2 or facts.joint is None:
        return
    panels = []
    for i, name in enumerate(NAMES):
        unit, k = unit_of(i)
        labels, bodies = [n for n, _ in estimates], [b for _, b in estimates]
        values, half = [k * b.value[i] for b in bodies], [2.0 * k * b.std[i] for b in bodies]
        marks: list[Mark] = [
            Points(labels, values, "one run, ± 2 σ", "estimate", half),
            Rule(k * facts.joint.body.value[i], "all runs", "good"),
        ]
        if facts.truth is not None:
            marks.append(Rule(k * facts.truth.value[i], "truth", "truth"))
        panels.append(Panel(marks, f"{name}, {unit}"))
    yield Figure("repeatability", "Runs", "Each run identified by itself, beside all together.", panels, 5, 210)


def calibration(facts: Facts) -> Iterator[Figure]:
    """The sensors' errors before and after, and their cost."""
    joint = facts.joint
    if joint is None or joint.xi is None or joint.xi_std is None or not len(facts.prior_xi):
        return
    prior = np.maximum(facts.prior_xi, 1e-12)
    known = facts.prior_xi > 1e-9
    labels = [
        wording.spaced(n) for n, is_known in zip(systematic.names(facts.robot.n_cables), known, strict=True) if is_known
    ]
    z, half = (joint.xi / prior)[known], (joint.xi_std / prior)[known]
    marks: list[Mark] = [
        Bars(labels, [2.0] * len(labels), "before: ± 1 σ of [std]", "muted", [-1.0] * len(labels), thin=True),
        Points(labels, z.tolist(), "after: found ± 1 σ", "estimate", half.tolist()),
        Rule(0.0, "as configured", "muted"),
    ]
    panels = [Panel(marks, "sensor errors, in their prior σ", y="σ")]
    plain = facts.methods.get("wls")
    yield Figure(
        "calibration",
        "Sensor errors found",
        "Corrections to the calibration in robot.toml, in units of what [std] expects. A long bar left means the runs "
        "do not observe it.",
        panels,
        1,
        320,
    )
    if isinstance(plain, Estimate):
        names = list(CHANNELS)
        yield Figure(
            "before_after",
            "Residual before and after calibration",
            "Of the wrench about the IMU, all runs: sensors taken as configured, and with the errors found.",
            [
                Panel(_pair(names[:3], plain.rms[:3], joint.rms[:3]), "force, rms", y="N"),
                Panel(_pair(names[3:], plain.rms[3:], joint.rms[3:]), "moment, rms", y="N m"),
            ],
            2,
            220,
        )


def _pair(labels: list[str], before: Array, after: Array) -> list[Mark]:
    return [
        Bars(labels, before.tolist(), "before", "muted"),
        Bars(labels, after.tolist(), "after", "estimate"),
    ]


def timing(facts: Facts) -> Iterator[Figure]:
    """Intervals between samples."""
    panels = []
    for run in facts.runs:
        if not run.has_rows:
            continue
        step = 1e3 * np.diff(run.t)
        top = max(float(step.max()), 2.0 * float(np.median(step)))
        panels.append(
            Panel(
                [line(run.t[1:], step, "", "estimate", width=1.0)],
                _several(facts, run),
                "t, s",
                "ms",
                span=(0.0, 1.05 * top),
            )
        )
    if panels:
        caption = "Between whole rows: IMU, forces and position at one instant. A peak is a gap that restarts windows."
        yield Figure("timing", "Intervals between samples", caption, panels, 2 if len(panels) > 1 else 1, 200)


SECTIONS: Final = {
    "forces": (residuals,),
    "tensions": (tensions,),
    "convergence": (convergence,),
    "excitation": (coverage, motion),
    "observability": (observability,),
    "methods": (methods,),
    "repeatability": (repeatability,),
    "calibration": (calibration,),
    "timing": (timing,),
}


def all_of(facts: Facts) -> dict[str, list[Figure]]:
    """Figures by section of the page."""
    return {name: [f for make in makers for f in make(facts)] for name, makers in SECTIONS.items()}
