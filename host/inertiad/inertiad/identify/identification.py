# SPDX-License-Identifier: Apache-2.0
"""Runs in, a judged result out: mistakes, fit, payload changes within a run, findings.

A run in which the payload changed is split there, once more and again while stretches still change, and every stretch
gets its own body; the sensors' errors stay common to all.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from inertiad.base.body import NAMES, UNITS
from inertiad.base.error import InputError
from inertiad.base.finding import Finding, ordered, verdict
from inertiad.identify import block_statistics, diagnose, findings, fit, mistake_fit
from inertiad.identify.block_statistics import Change
from inertiad.identify.fit import Estimate, NoBodyError, Segment, Validation
from inertiad.robot import configuration, systematic
from inertiad.robot.description import Robot
from inertiad.run import reader
from inertiad.run.reader import Recording

CHANGES_MAX: Final = 4
FINE: Final = 0.0
"""s: blocks as short as the solver leaves them, to find the instant of a change"""
APART: Final = 4.0
"""sigmas between the masses or CoGs of two stretches that make them two bodies"""
LEAVES_MORE: Final = 3.0
"""times the joint fit's residual: what a mistake may leave. A real one for which the joint fit has no error of its own
left at most 2.0 times as much (modern seed 1000, test/host/mistakes.py and the table of test_diagnose.py). What an
attitude that follows acceleration looks like left 5 times as much and more."""
FOUND_BY_FIT: Final = {
    "force_delay": "force_delay",
    "attitude_delay": "attitude_delay",
    "tracker_delay": "position_delay",
    "tracker_target": "tracker_target",
}
"""mistakes that are sensors' errors, too"""
SAME: Final = 0.3
"""of a mistake's number: the joint fit's own may differ by so much"""
SHORTEST: Final = 5.0
"""s of a stretch that gets a body of its own"""

Progress = Callable[[str], None]


def _silent(step: str) -> None:
    pass


@dataclass(frozen=True)
class Part:
    """A stretch of a run with one body."""

    recording: Recording
    """its rows only"""
    of: Recording
    """the whole run"""
    begin: float
    end: float
    """s since the run's first row"""
    group: int


@dataclass(frozen=True)
class Solved:
    """The joint fit of all parts, and what changed within one of them, if anything does."""

    parts: list[Part]
    result: dict[str, Any]
    change: Change | None = None

    @property
    def group(self) -> list[int]:
        return [part.group for part in self.parts]

    @property
    def recordings(self) -> list[Recording]:
        return [part.recording for part in self.parts]


def _options(parts: list[Part]) -> dict[str, Any]:
    n_groups = 1 + max(part.group for part in parts)
    return {"group": [part.group for part in parts], "payload": [0.0] * n_groups}


def _solve(config: Any, parts: list[Part]) -> Solved:
    return Solved(parts, fit.batch(config, [part.recording for part in parts], **_options(parts)))


def _follow_drift(solved: Solved) -> Solved:
    """Force offsets that drift more than stated, where no other body explains what changes."""
    result = fit.with_drift(solved.recordings, solved.result, **_options(solved.parts))
    return solved if result is solved.result else Solved(solved.parts, result)


def _changes(robot: Robot, solved: Solved) -> list[Change]:
    """Of each part the best place for a change, the likeliest part first."""
    of, widening = block_statistics.blocks(solved.result, FINE), findings.widening_of(solved.result)
    found = []
    for r, part in enumerate(solved.parts):
        kinds = findings.kinds_of_unknowns(robot, solved.result, part.group)
        found.append(block_statistics.change(of, r, kinds, widening))
    return sorted((c for c in found if c is not None), key=lambda c: -c.copies.fall)


def _split(solved: Solved, change: Change) -> list[Part]:
    """The parts with one of them as two, the blocks at the change left out."""
    part = solved.parts[change.run]
    n_groups = 1 + max(solved.group)
    before = replace(part, recording=reader.part(part.recording, 0.0, change.begin), end=part.begin + change.begin)
    after = replace(
        part,
        recording=reader.part(part.recording, change.end, np.inf),
        begin=part.begin + change.end,
        group=n_groups,
    )
    return [*solved.parts[: change.run], before, after, *solved.parts[change.run + 1 :]]


def _are_two_bodies(result: dict[str, Any], a: int, b: int) -> bool:
    """Mass or CoG differ beyond their sigma."""
    one, two = (fit.of_batch("joint", result, g).body for g in (a, b))
    gap = np.abs(np.subtract(one.value, two.value)) / np.hypot(one.std, two.std)
    return bool(gap[:4].max() > APART)


def _with_two_bodies(config: Any, solved: Solved, change: Change) -> Solved | None:
    """The fit with another body from the change on; None: a stretch is too short, or there is no such fit."""
    parts = _split(solved, change)
    if min(part.recording.duration for part in parts[change.run : change.run + 2]) < SHORTEST:
        return None
    try:
        split = _solve(config, parts)
    except InputError:
        return None
    return split if split.result["converged"] else None


def _two_bodies(config: Any, solved: Solved, change: Change) -> Solved | None:
    """The split at the change or a block beside it that leaves least; None: no better, or the bodies are equal."""
    before = findings.residual(solved.result)[0]

    def left(split: Solved) -> float:
        return findings.residual(split.result)[0]

    first = _with_two_bodies(config, solved, change)
    if first is None or left(first) > findings.FALLS_TO * before:
        return None
    step = 0.5 * (change.end - change.begin)
    beside = [
        _with_two_bodies(config, solved, replace(change, begin=change.begin + d, end=change.end + d))
        for d in (-step, step)
    ]
    best = min((split for split in (first, *beside) if split is not None), key=left)
    a, b = (part.group for part in best.parts[change.run : change.run + 2])
    return best if _are_two_bodies(best.result, a, b) else None


def _follow_changes(robot: Robot, config: Any, solved: Solved) -> Solved:
    """Split wherever another body explains the data better."""
    for _ in range(CHANGES_MAX):
        if not solved.result["converged"]:
            break
        found = [c for c in _changes(robot, solved) if c.is_significant or findings.has_misfit(robot, solved.result)]
        split = next((s for s in (_two_bodies(config, solved, c) for c in found) if s is not None), None)
        if split is None:
            sure = [c for c in found if c.is_significant]
            return replace(solved, change=sure[0] if sure else None)
        solved = split
    return solved


def _segments(solved: Solved) -> list[Segment]:
    """One per part where a run has several."""
    if len({part.of.path for part in solved.parts}) == len(solved.parts):
        return []
    return [
        Segment(part.of.path, part.begin, part.end, fit.of_batch("joint", solved.result, part.group))
        for part in solved.parts
    ]


def _payload_findings(segments: list[Segment]) -> list[Finding]:
    found = []
    for before, after in pairwise(segments):
        if before.path != after.path:
            continue
        a, b = before.estimate.body, after.estimate.body
        gap = np.abs(np.subtract(a.value, b.value)) / np.hypot(a.std, b.std)
        i = 0 if gap[0] > APART else int(np.argmax(gap[:4]))
        at = 0.5 * (before.end + after.begin)
        says = (
            f"{before.path.name}: the payload changed at {at:.1f} s: {NAMES[i]} {a.value[i]:.4g} ± {a.std[i]:.2g} "
            f"{UNITS[i]} before, {b.value[i]:.4g} ± {b.std[i]:.2g} {UNITS[i]} after; each stretch has its own body"
        )
        evidence = {"run": str(before.path), "time": at, "parameter": NAMES[i], "sigmas": float(gap[i])}
        found.append(Finding("payload_changed", "care", says, "check that this is what happened", evidence))
    return found


def _sensor_finding(solved: Solved) -> list[Finding]:
    change = solved.change
    if change is None:
        return []
    part = solved.parts[change.run]
    at = part.begin + change.at
    evidence: dict[str, Any] = {"run": str(part.of.path), "time": at, "kind": change.kind}
    evidence |= {"chi_squared": change.copies.fall, "runner_up": change.runner_up}
    evidence |= {"runner_up_chi_squared": change.runner_up_fall}
    kind = change.kind.replace("_", " ")
    says = f"{part.of.path.name}: before and after {at:.1f} s the data disagree; another {kind} explains most"
    do = "look at what happened then, or fit the two stretches apart"
    return [Finding("segments_disagree", "care", says, do, evidence)]


def _drift_finding(robot: Robot, solved: Solved) -> list[Finding]:
    drift = solved.result.get("offset_drift")
    if drift is None:
        return []
    stated = configuration.std(robot)["force_offset_drift"]
    says = (
        f"the force sensors' offsets drift by {drift:.2g} N/sqrt(s), more than the {stated:.2g} that [std] "
        "force_offset_drift states; the fit follows them"
    )
    do = "let the force sensors warm up, look at their temperature, or state [std] force_offset_drift in robot.toml"
    return [Finding("force_offset_drift", "care", says, do, {"drift": drift, "stated": stated})]


@dataclass(frozen=True)
class Identification:
    """What a method says about runs, judged."""

    estimate: Estimate | None
    """of the last stretch where a payload changed; None: no body is near what the data say"""
    findings: list[Finding]
    """the worst first"""
    segments: list[Segment]
    """empty: no payload changed"""
    validations: list[Validation]
    result: dict[str, Any] | None = None
    """of the batch solver; None: another method"""


def _is_told_by_fit(robot: Robot, mistake: Finding, result: dict[str, Any]) -> bool:
    """Does the joint fit find the same error by itself?"""
    kind = FOUND_BY_FIT.get(mistake.name)
    if kind is None:
        return False
    told = np.array(result["xi"])[systematic.group(kind, robot.n_cables).part]
    number = np.array(mistake.evidence["numbers"])
    return bool(np.abs(told - number).max() < SAME * np.abs(number).max())


def _explains(robot: Robot, mistake: Finding, result: dict[str, Any]) -> bool:
    """Does it leave about as little as the joint fit, or find what that finds? The joint fit knows more errors, such as
    an attitude that follows acceleration: what leaves much more than it does is no explanation."""
    left, least = (float(mistake.evidence[key]) for key in ("residual_without_N", "residual_least_N"))
    left_by_fit = max(findings.residual(result)[0], least)
    return left < LEAVES_MORE * left_by_fit or _is_told_by_fit(robot, mistake, result)


def _beside(robot: Robot, mistake: Finding, result: dict[str, Any]) -> list[Finding]:
    """A mistake beside the joint fit: none if that explains more; care if that finds the same and takes it out."""
    if not _explains(robot, mistake, result):
        return []
    if not _is_told_by_fit(robot, mistake, result):
        return [mistake]
    return [replace(mistake, severity="care", says=f"{mistake.says}; the fit finds the same and takes it out")]


def mistakes(robot: Robot, runs: list[Recording], result: dict[str, Any], signals: list[Finding]) -> list[Finding]:
    """Those that signals show; where these show none, those that explain the runs, judged beside their joint fit."""
    if diagnose.are_mistakes(signals):
        return signals
    found = [] if signals else mistake_fit.find(robot, runs)
    if result["converged"]:
        found = [judged for mistake in found for judged in _beside(robot, mistake, result)]
    if not found and findings.has_symptom(robot, result):
        found = diagnose.unclear(robot, runs)
    return found + signals


def joint(
    robot: Robot, config: Any, recordings: list[Recording], signals: list[Finding], progress: Progress = _silent
) -> Identification:
    """The joint fit with mistakes, payload changes and findings. signals: diagnose.of_signals()."""
    parts = [Part(run, run, 0.0, run.duration, 0) for run in recordings]
    try:
        solved = _solve(config, parts)
    except NoBodyError as error:
        return Identification(None, ordered([*diagnose.diagnose(robot, recordings), _no_body(error)]), [], [])
    progress("look for mistakes")
    wrong = mistakes(robot, solved.recordings, solved.result, signals)
    if all(finding.severity != "stop" for finding in wrong):
        progress("look for changes")
        solved = _follow_drift(_follow_changes(robot, config, solved))
    segments = _segments(solved)
    found = findings.of_result(robot, config, solved.result, solved.recordings, solved.group)
    found = [*wrong, *_payload_findings(segments), *_sensor_finding(solved), *_drift_finding(robot, solved), *found]
    estimate = fit.of_batch("joint", solved.result, solved.group[-1])
    return Identification(estimate, ordered(found), segments, [], solved.result)


def _no_body(error: NoBodyError) -> Finding:
    return Finding(
        "impossible_body",
        "stop",
        f"no body can have what the data say: {error}",
        "look for a mistake in geometry, sensor axes and units, or record a motion that tilts and turns the platform",
    )


def identify(
    method: str,
    robot: Robot,
    recordings: list[Recording],
    held_out: list[Path],
    robot_file: Path | None,
    progress: Progress = _silent,
) -> Identification:
    """Judge runs by one of fit.METHODS and predict the held out ones.

    Where there is nothing to solve, the result is the mistake that stops it; InputError: none was found.
    """
    config = reader.config_of(robot, str(recordings[0].path))
    progress("fit")
    try:
        if method == "joint":
            done = joint(robot, config, recordings, diagnose.of_signals(robot, recordings), progress)
        else:
            estimate = fit.fit(method, robot, config, recordings)
            found = [*diagnose.diagnose(robot, recordings), *findings.of_estimate(estimate)]
            done = Identification(estimate, ordered(found), [], [])
    except NoBodyError as error:
        return Identification(None, ordered([*diagnose.diagnose(robot, recordings), _no_body(error)]), [], [])
    except InputError as error:
        wrong = diagnose.diagnose(robot, recordings)
        if verdict(wrong) == "stop":
            return Identification(None, ordered(wrong), [], [])
        raise InputError("; ".join([str(error), *(mistake.says for mistake in wrong)])) from None
    if done.estimate is None:
        return done
    held = [fit.validate(config, done.estimate, run) for run in reader.read_all(held_out, robot_file)]
    return replace(done, validations=held)
