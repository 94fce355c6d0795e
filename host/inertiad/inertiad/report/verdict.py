# SPDX-License-Identifier: Apache-2.0
"""Facts into words: what is good, what is not, what to do next. Worst first; a report opens with this."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from inertiad.base import counters
from inertiad.base.body import NAMES
from inertiad.identify import calibrate
from inertiad.report import wording
from inertiad.report.report_data import GAP, Facts, apart
from inertiad.report.wording import shown

Level = Literal["good", "care", "bad"]

WANTED: Final = (0.005, 3e-3, 0.02)
"""one sigma of the mass [of the mass], CoG [m], inertia [of the largest moment] that counts as good"""
USELESS: Final = 10.0
"""times WANTED: not a result"""
FAR: Final = 4.0
"""prior sigmas beyond which a sensor's error is more than its data sheet allows"""
SIGMAS: Final = 3.0
LOST_MAX: Final = 0.01
SHORT: Final = 15.0
"""s"""
MOST: Final = 0.5
"""share of a variance that one cause must have to be named as what limits"""

ADVICE: Final = {
    "force_gain": "add a known weight in a second run: inertiactl calibrate ROBOT RUN RUN2 --payload RUN2=KG",
    "force_offset": "tare the force sensors with no tension in any cable: inertiactl calibrate --tare FILE.csv",
    "geometry": "measure anchors and attachments better, and say so in [std] geometry",
    "attitude_bias": "align the IMU's attitude with the platform: inertiactl calibrate with runs in several poses",
    "imu_alignment": "measure how the IMU sits on the platform, or calibrate it: inertiactl calibrate",
    "acc_bias": "calibrate the accelerometer in six positions: inertiactl calibrate",
    "world_yaw": "align the tracker's frame with the IMU's",
    "position_delay": "synchronise the tracker with the bus",
    "force_delay": "give the force frames their device time",
    "gyro_bias": "let the platform rest for some seconds in every run",
}


@dataclass(frozen=True)
class Finding:
    level: Level
    text: str
    action: str = ""


@dataclass(frozen=True)
class Verdict:
    level: Level
    headline: str
    findings: list[Finding]


# ---- what can be wrong -----------------------------------------------------------------------------------------------


def _unusable(facts: Facts) -> Iterator[Finding]:
    for run in facts.runs:
        if run.problem:
            yield Finding("bad", f"{run.name}: {run.problem}", run.remedy)


def _mistakes(facts: Facts) -> Iterator[Finding]:
    for text in facts.found:
        yield Finding("bad", text, "correct robot.toml or the wiring, then record or fit again")


def _is_broken(facts: Facts) -> bool:
    return facts.force_check is not None and facts.force_check.broken is not None


def _sensor(facts: Facts) -> Iterator[Finding]:
    check = facts.force_check
    if check is None or check.broken is None:
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
    yield Finding("bad", text, action)


def _changes(facts: Facts) -> Iterator[Finding]:
    for run in facts.usable:
        if run.history is not None and run.history.n_changes:
            text = f"{run.name}: the payload, or a sensor, changed {run.history.n_changes} times during the run"
            if run.history.changed_at:
                text += f", first at {run.history.changed_at[0]:.1f} s"
            if _is_broken(facts):
                yield Finding("care", text, "most likely that sensor: look at what happened to it then")
            else:
                yield Finding("bad", text, "split the run there, or keep the payload as it is while recording")


def _bodies(facts: Facts) -> Iterator[Finding]:
    first = facts.usable[0] if facts.usable else None
    for name in facts.other_bodies:
        run = next(r for r in facts.usable if r.name == name)
        if run.estimate is None or first is None or first.estimate is None:
            continue
        gap = apart(run.estimate.body, first.estimate.body)
        i = int(np.argmax(gap))
        yield Finding(
            "bad",
            f"{name} and {first.name} saw different bodies: {NAMES[i]} differs by "
            f"{wording.difference(i, run.estimate.body.value[i] - first.estimate.body.value[i])}, {gap[i]:.0f} sigma",
            "report runs of one body together, others apart; with a known added weight use inertiactl calibrate",
        )


def _consistency(facts: Facts) -> Iterator[Finding]:
    if facts.joint is not None and not facts.joint.consistent:
        yield Finding(
            "bad" if facts.joint.distance > 9.0 else "care",
            f"no body can have what the data say; the nearest is shown, {np.sqrt(facts.joint.distance):.1f} sigma away",
            "more excitation, or look for a mistake in geometry and sensor axes",
        )


def _calibration(facts: Facts) -> Iterator[Finding]:
    joint = facts.joint
    if joint is None or joint.xi is None or not len(facts.prior_xi):
        return
    far = np.abs(joint.xi) / np.maximum(facts.prior_xi, 1e-12)
    labels = calibrate.names(facts.robot.n_cables)
    factor = wording.factors(facts.robot.n_cables)
    for i in np.argsort(-far)[:3]:
        if far[i] > FAR:
            k, unit = factor[i]
            yield Finding(
                "bad" if far[i] > 3.0 * FAR else "care",
                f"{labels[i]} = {k * joint.xi[i]:.3g} {unit}: {far[i]:.0f} times the standard deviation expected of it",
                "look at this sensor, or correct its [std] in robot.toml; inertiactl calibrate keeps what was found",
            )


def _observability(facts: Facts) -> Iterator[Finding]:
    joint = facts.joint
    if joint is None:
        return
    unseen = [name for name, seen in zip(NAMES, joint.observable, strict=True) if not seen]
    if unseen:
        yield Finding(
            "care",
            f"the motion does not tell {', '.join(unseen)}: the sigma is still more than half of the prior's",
            "turn the platform faster about all axes: inertiactl excite ROBOT -o excite.csv plans such a motion",
        )


def _losses(facts: Facts) -> Iterator[Finding]:
    for run in facts.usable:
        recording = run.recording
        if recording is None:
            continue
        lost = recording.n_rejected / max(recording.n_rejected + len(recording.rows), 1)
        causes = ("missing", "late", "overrun", "bad_geometry", "restarts")  # told by _gaps() or as lost samples
        worst = {k: n for k, n in recording.counters.items() if n and k.rpartition(".")[2] in causes}
        if lost > LOST_MAX:
            cause = max(worst, key=lambda k: worst[k]) if worst else "no overlap of the sensors"
            yield Finding(
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
            told = ", ".join(f"{k} {n}" for k, n in bad.items())
            yield Finding("care", f"{run.name}: refused on the way: {told}", "inertiactl verify RUN names the frames")
        if recording.duration < SHORT:
            yield Finding(
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
                    "bad",
                    f"{run.name}: cable {i + 1} is above {cable.tension_max:g} N {100 * above:.1f} % of the time",
                    "slow down, or lighten the platform",
                )
            elif below > LOST_MAX:
                yield Finding(
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
        yield Finding("good", f"{', '.join(good)} (one sigma)", "" if wide else f"better still: {limits(facts)}")
    if wide:
        ratio = max(x / limit for x, limit in zip(found, WANTED, strict=True))
        level: Level = "bad" if ratio > USELESS else "care"
        yield Finding(level, f"only {', '.join(wide)} (one sigma; {goal})", limits(facts))


def limits(facts: Facts) -> str:
    """What the widest of mass, CoG and inertia is limited by, and what helps."""
    u = facts.uncertainty
    if u is None:
        return ""
    ratio = np.array(relative_sigma(facts)) / np.array(WANTED)
    part = (slice(0, 1), slice(1, 4), slice(4, 10))[int(np.argmax(ratio))]
    i = part.start + int(np.argmax(u.found[part]))
    kind = max(u.share, key=lambda name: u.share[name][i])
    if u.share[kind][i] > MOST:
        return f"{NAMES[i]}: {100 * u.share[kind][i]:.0f} % of the variance is {wording.spaced(kind)}; {ADVICE[kind]}"
    return f"{NAMES[i]} is limited by noise and motion: record for longer, or plan a motion with inertiactl excite"


def _prediction(facts: Facts) -> Iterator[Finding]:
    for run in facts.usable:
        v = run.prediction
        if v is None:
            continue
        share = float(np.max(v.rms / np.maximum(v.signal, 1e-9)))
        level: Level = "good" if share < 0.2 else "care"
        yield Finding(level, f"{run.name}, predicted from the other runs: tensions to {v.tension_rms.max():.2g} N")


def _agreement(facts: Facts) -> Iterator[Finding]:
    if facts.joint is None:
        return
    check = facts.force_check
    if check is not None and check.broken is None:
        i = check.worst
        yield Finding(
            "good",
            f"the force sensors agree to {np.sqrt(np.mean(check.rms**2)):.2g} N; "
            f"cable {i + 1} is worst with {check.rms[i]:.2g} N",
        )
    if facts.truth is not None:
        z = np.abs(np.subtract(facts.joint.body.value, facts.truth.value)) / np.array(facts.joint.body.std)
        n = int((z < 2.0).sum())
        level: Level = "good" if n >= 8 and z.max() < 4.0 else "care"
        yield Finding(level, f"simulated run: {n} of 10 parameters within 2 sigma of the truth, {z.max():.1f} at most")
    elif facts.nominal is not None:
        z = (np.array(facts.joint.body.value) - facts.nominal.value) / np.array(facts.joint.body.std)
        i = int(np.argmax(np.abs(z)))
        if abs(z[i]) > SIGMAS:
            change = wording.difference(i, facts.joint.body.value[i] - facts.nominal.value[i])
            yield Finding(
                "care",
                f"{NAMES[i]} is {change} from nominal, {abs(z[i]):.0f} sigma",
                "if nothing was added to the platform, put the identified body into [nominal]",
            )
        else:
            yield Finding("good", f"agrees with the nominal body within {abs(z[i]):.1f} sigma")


RULES: Final = (
    *(_unusable, _mistakes, _sensor, _changes, _bodies, _consistency, _calibration, _observability),
    *(_accuracy, _losses, _gaps, _tensions, _prediction, _agreement),
)
ORDER: Final[dict[Level, int]] = {"bad": 0, "care": 1, "good": 2}


def _headline(facts: Facts, level: Level) -> str:
    if facts.joint is None:
        return "Nothing can be identified from this" if len(facts.runs) == 1 else "Nothing can be identified from these"
    return {
        "bad": "Do not use this result yet",
        "care": "Usable with care",
        "good": "A good result",
    }[level]


def judge(facts: Facts) -> Verdict:
    """All findings, the worst first, and the level of the worst."""
    findings = [finding for rule in RULES for finding in rule(facts)]
    findings.sort(key=lambda f: ORDER[f.level])
    level = findings[0].level if findings else "good"
    return Verdict(level, _headline(facts, level), findings)


def spoken(verdict: Verdict) -> list[str]:
    """For a terminal: headline and what is not good."""
    lines = [verdict.headline]
    for finding in verdict.findings:
        if finding.level != "good":
            action = f"; do: {finding.action}" if finding.action else ""
            lines.append(f"{finding.level}: {re.sub(r' +', ' ', finding.text)}{action}")
    return lines
