# SPDX-License-Identifier: Apache-2.0
"""Verdict: findings from the report's data with their remedies, the worst first. A report opens with it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from inertiad.base import counters
from inertiad.base.body import NAMES
from inertiad.base.finding import HEADLINES, Finding, Severity, lines, ordered, verdict
from inertiad.identify.findings import SEPARATES
from inertiad.report import wording
from inertiad.report.report_data import GAP, Facts
from inertiad.report.wording import shown

WANTED: Final = (0.005, 3e-3, 0.02)
"""one sigma of the mass [of the mass], CoG [m], inertia [of the largest moment] that counts as good"""
SIGMAS: Final = 3.0
LOST_MAX: Final = 0.01
SHORT: Final = 15.0
"""s"""
MOST: Final = 0.5
"""share of a variance that one cause must have to be named as what limits"""


@dataclass(frozen=True)
class Verdict:
    severity: Severity
    headline: str
    findings: list[Finding]


# ---- what can be wrong -----------------------------------------------------------------------------------------------


def _unusable(facts: Facts) -> Iterator[Finding]:
    for run in facts.runs:
        if run.problem:
            yield Finding("unusable_run", "stop", f"{run.name}: {run.problem}", run.remedy)


def _is_broken(facts: Facts) -> bool:
    """Do the others contradict a force sensor? One that the fit does without is among its own findings."""
    is_left_out = any(finding.name == "broken_force_sensor" for finding in facts.found)
    return facts.force_check is not None and facts.force_check.broken is not None and not is_left_out


def _sensor(facts: Facts) -> Iterator[Finding]:
    check = facts.force_check
    if check is None or check.broken is None or not _is_broken(facts):
        return
    i = check.broken
    text = (
        f"the force sensor of cable {i + 1} does not fit the others: the residual falls from {check.everything:.3g} N "
        f"to {check.without[i]:.3g} N when its force is taken as unknown"
    )
    if check.error is not None:
        low, high = check.error.min(), check.error.max()
        text += f"; against the others it reads {low:+.0f} to {high:+.0f} N too much"
    action = f"check sensor {i + 1}: mounting, cable, zero, amplifier; then repeat the run"
    if check.body is not None:
        mass = shown(check.body.value[0], check.body.std[0])
        action += f". Until then use the result without it: mass {mass} kg, see Methods"
    yield Finding("broken_force_sensor", "stop", text, action)


def _changes(facts: Facts) -> Iterator[Finding]:
    """As the platform's filter saw them; where fit found one too, it has said so."""
    if any(finding.name == "payload_changed" for finding in facts.found):
        return
    for run in facts.usable:
        if run.history is not None and run.history.n_changes:
            text = f"{run.name}: the payload, or a sensor, changed {run.history.n_changes} times during the run"
            if run.history.changed_at:
                text += f", first at {run.history.changed_at[0]:.1f} s"
            if _is_broken(facts):
                yield Finding(
                    "payload_changed", "care", text, "most likely that sensor: find out what happened to it then"
                )
            else:
                yield Finding(
                    "payload_changed", "stop", text, "split the run there, or keep the payload as it is while recording"
                )


def _losses(facts: Facts) -> Iterator[Finding]:
    for run in facts.usable:
        recording = run.recording
        if recording is None:
            continue
        lost = recording.n_rejected / max(recording.n_rejected + len(recording.rows), 1)
        causes = ("missing", "late", "overrun", "bad_geometry", "restarts")  # reported by _gaps() or as lost samples
        worst = {k: n for k, n in recording.counters.items() if n and k.rpartition(".")[2] in causes}
        if lost > LOST_MAX:
            cause = max(worst, key=lambda k: worst[k]) if worst else "no overlap of the sensors"
            yield Finding(
                "lost_samples",
                "care",
                f"{run.name}: {100 * lost:.1f} % of the samples are lost, most by {cause}",
                "look at Timing: a sensor that pauses, or stamps that do not belong together",
            )
        bad = {
            k: n
            for k, n in recording.counters.items()
            if n and counters.is_bad(k) and k.rpartition(".")[2] not in causes
        }
        if bad:
            listed = ", ".join(f"{k} {n}" for k, n in bad.items())
            yield Finding(
                "refused_data",
                "care",
                f"{run.name}: refused by the pipeline: {listed}",
                "inertiactl verify RUN names the frames",
            )
        if recording.duration < SHORT:
            yield Finding(
                "short_record",
                "care",
                f"{run.name}: {recording.duration:.1f} s are short: slow errors of the sensors do not average out",
                "record half a minute or more",
            )


def _gaps(facts: Facts) -> Iterator[Finding]:
    for run in facts.usable:
        step = np.diff(run.t)
        if len(step) and step.max() > max(GAP * float(np.median(step)), 0.1):
            at = int(np.argmax(step))
            yield Finding(
                "gap",
                "care",
                f"{run.name}: nothing for {step[at]:.2f} s at {run.t[at]:.1f} s; windows start again after a gap",
                "look at Timing for the cause: bus, sensor or tracker beam",
            )


def _tensions(facts: Facts) -> Iterator[Finding]:
    for run in facts.runs:
        if not run.has_rows:
            continue
        for i, cable in enumerate(facts.robot.cable):
            above = float(np.mean(run.f[:, i] > cable.tension_max))
            below = float(np.mean(run.f[:, i] < cable.tension_min))
            if above > 0.001:
                yield Finding(
                    "tension_above_limit",
                    "stop",
                    f"{run.name}: cable {i + 1} is above {cable.tension_max:g} N {100 * above:.1f} % of the time",
                    "slow down, or lighten the platform",
                )
            elif below > LOST_MAX:
                yield Finding(
                    "tension_below_limit",
                    "care",
                    f"{run.name}: cable {i + 1} is below {cable.tension_min:g} N {100 * below:.0f} % of the time, "
                    f"{run.f[:, i].min():.0f} N at least: it may sag",
                    "keep the motion where all cables pull: inertiactl excite keeps every tension inside its limits",
                )


# ---- what is good, and what limits -----------------------------------------------------------------------------------


def relative_sigma(facts: Facts) -> tuple[float, float, float]:
    """One sigma of the mass [of the mass], worst of the CoG [m], worst of the inertia [of the largest moment]."""
    joint = facts.joint
    if joint is None:
        return np.inf, np.inf, np.inf
    value, std = joint.body.value, joint.body.std
    return std[0] / max(abs(value[0]), 1e-9), max(std[1:4]), max(std[4:]) / max(max(value[4:7]), 1e-9)


def _accuracy(facts: Facts) -> Iterator[Finding]:
    if facts.joint is None or _is_broken(facts):  # then no sigma holds
        return
    found = relative_sigma(facts)
    text = (f"mass to {100 * found[0]:.2g} %", f"CoG to {1e3 * found[1]:.2g} mm", f"inertia to {100 * found[2]:.2g} %")
    good = [t for t, x, limit in zip(text, found, WANTED, strict=True) if x <= limit]
    wide = [t for t, x, limit in zip(text, found, WANTED, strict=True) if x > limit]
    goal = f"goal {100 * WANTED[0]:g} %, {1e3 * WANTED[1]:g} mm, {100 * WANTED[2]:g} %"
    if good:
        yield Finding(
            "accuracy", "good", f"{', '.join(good)} (one sigma)", "" if wide else f"better still: {limits(facts)}"
        )
    if wide:
        yield Finding("accuracy", "good", f"only {', '.join(wide)} (one sigma; {goal})", limits(facts))


def limits(facts: Facts) -> str:
    """The error source that limits the least certain of mass, CoG and inertia, and its remedy."""
    u = facts.uncertainty
    if u is None:
        return ""
    ratio = np.array(relative_sigma(facts)) / np.array(WANTED)
    part = (slice(0, 1), slice(1, 4), slice(4, 10))[int(np.argmax(ratio))]
    i = part.start + int(np.argmax(u.found[part]))
    kind = max(u.share, key=lambda name: u.share[name][i])
    if u.share[kind][i] > MOST:
        return (
            f"{NAMES[i]}: {100 * u.share[kind][i]:.0f} % of the variance is {wording.spaced(kind)}; {SEPARATES[kind]}"
        )
    return f"{NAMES[i]} is limited by noise and motion: record for longer, or plan a motion with inertiactl excite"


def _prediction(facts: Facts) -> Iterator[Finding]:
    for run in facts.usable:
        v = run.prediction
        if v is None:
            continue
        share = float(np.max(v.rms / np.maximum(v.signal, 1e-9)))
        severity: Severity = "good" if share < 0.2 else "care"
        yield Finding(
            "prediction",
            severity,
            f"{run.name}, predicted from the other runs: tensions to {v.tension_rms.max():.2g} N",
        )


def _agreement(facts: Facts) -> Iterator[Finding]:
    if facts.joint is None:
        return
    check = facts.force_check
    is_disagreement_known = any(finding.name == "forces_disagree" for finding in facts.found)
    if check is not None and check.broken is None and not is_disagreement_known:
        i = check.worst
        yield Finding(
            "forces_agree",
            "good",
            f"the force sensors agree to {np.sqrt(np.mean(check.rms**2)):.2g} N; "
            f"cable {i + 1} is worst with {check.rms[i]:.2g} N",
        )
    if facts.truth is not None:
        z = np.abs(np.subtract(facts.joint.body.value, facts.truth.value)) / np.array(facts.joint.body.std)
        n = int((z < 2.0).sum())
        severity: Severity = "good" if n >= 8 and z.max() < 4.0 else "care"
        yield Finding(
            "truth", severity, f"simulated run: {n} of 10 parameters within 2 sigma of the truth, {z.max():.1f} at most"
        )
    elif facts.nominal is not None:
        z = (np.array(facts.joint.body.value) - facts.nominal.value) / np.array(facts.joint.body.std)
        i = int(np.argmax(np.abs(z)))
        if abs(z[i]) > SIGMAS:
            change = wording.difference(i, facts.joint.body.value[i] - facts.nominal.value[i])
            yield Finding(
                "differs_from_nominal",
                "care",
                f"{NAMES[i]} is {change} from nominal, {abs(z[i]):.0f} sigma",
                "if nothing was added to the platform, put the identified body into [nominal]",
            )
        else:
            yield Finding("agrees_with_nominal", "good", f"agrees with the nominal body within {abs(z[i]):.1f} sigma")


RULES: Final = (_unusable, _sensor, _changes, _accuracy, _losses, _gaps, _tensions, _prediction, _agreement)
"""of the report alone; what fit finds comes with the facts"""


def judge(facts: Facts) -> Verdict:
    """All findings, the worst first, and the severity of the worst."""
    findings = ordered([*facts.found, *(found for rule in RULES for found in rule(facts))])
    severity = verdict(findings)
    headline = HEADLINES[severity]
    if facts.joint is None:
        headline = "Nothing can be identified from " + ("this" if len(facts.runs) == 1 else "these")
    return Verdict(severity, headline, findings)


def summary(judged: Verdict) -> list[str]:
    """For a terminal: headline and what is not good."""
    return [judged.headline, *lines(judged.findings)[1:]]
