# SPDX-License-Identifier: Apache-2.0
"""Trials over arms, bandwidths and seeds, and what they say: tracking errors by phase, limits, hand-overs."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inertiad.base.error import InputError
from inertiad.control import closed_loop
from inertiad.control.closed_loop import ARMS, Trace, Trial
from inertiad.model.payload import RAMP, Payload
from inertiad.robot.messages import nearest
from inertiad.simulate.simulator import Run

SETTLING: Final = 3.0
"""s after a contact that belong to the transient: the first, in which no estimate helps, and three periods at 1.5 Hz"""
SETTLING_ANNOUNCED: Final = RAMP
"""s after an announced contact that belong to the transient: until the platform carries the whole weight"""
PHASES: Final = ("before", "transient", "late")
KEYS: Final = ("rms_mm", "max_mm", "rms_deg", "late_rms_mm")
"""of control.json"""
LIMIT_NOISE: Final = 1.0
"""N beyond a limit of tension that the drives' ramp between two commands may make"""
HEAD: Final = (
    *("bandwidth", "parameters", "before rms", "max", "transient rms", "max", "later rms", "max"),
    *("attitude, deg", "tensions, N", "hand-over", "over limit", "cut off"),
)
"""of rows()"""


@dataclass(frozen=True)
class Phase:
    """Errors over a part of the motion."""

    rms_mm: float
    max_mm: float
    rms_deg: float
    tension_norm: float
    """N, median"""


@dataclass(frozen=True)
class Outcome:
    """One trial, measured."""

    arm: str
    bandwidth: float
    seed: int
    whole: Phase
    phases: dict[str, Phase]
    """of PHASES, those that there are"""
    hand_over: float
    """greatest step of a tension by a change of parameters, of the tensions' range; NaN: not measured, they adapt"""
    beyond: float
    """N, by which the worst tension breaks its limit; 0: none does"""
    n_commands: int
    n_cut: int
    """commands cut off at the limits of the tensions"""
    cut_at: float
    """s, the first of them; NaN: none was"""
    trace: Trace | None
    """None: not kept"""

    @property
    def document(self) -> dict[str, float]:
        """The values of control.json; NaN: the motion ends before the transient does."""
        late = self.phases["late"].rms_mm if "late" in self.phases else np.nan
        values = (self.whole.rms_mm, self.whole.max_mm, self.whole.rms_deg, late)
        return dict(zip(KEYS, values, strict=True))


def _phase(trace: Trace, part: NDArray[np.bool_]) -> Phase:
    error, turn = 1e3 * trace.error[part], np.rad2deg(trace.turn[part])
    return Phase(
        float(np.sqrt(np.mean(error**2))),
        float(error.max()),
        float(np.sqrt(np.mean(turn**2))),
        float(np.median(trace.tension_norm[part])),
    )


def measured(trial: Trial, trace: Trace, settling: float = SETTLING) -> Outcome:
    """The outcome of a trial. settling: s after the last contact that belong to the transient."""
    contacts = [p.time for p in trial.run.payloads] or [0.0]
    t = trace.t
    settled = max(contacts) + settling
    masks = (t < min(contacts), (t >= min(contacts)) & (t < settled), t >= settled)
    phases = {name: _phase(trace, mask) for name, mask in zip(PHASES, masks, strict=True) if mask.any()}
    cables = trial.run.robot.cable
    span = min(cable.tension_max - cable.tension_min for cable in cables)
    beyond = float(trace.beyond.max())
    cut = np.flatnonzero(trace.is_cut)
    return Outcome(
        trial.arm,
        trial.bandwidth,
        trial.run.seed,
        _phase(trace, np.ones(len(t), dtype=bool)),
        phases,
        np.nan if trial.arm == "adaptive" else float(trace.tension_step.max()) / span,
        beyond if beyond > LIMIT_NOISE else 0.0,
        len(t),
        len(cut),
        float(t[cut[0]]) if len(cut) else np.nan,
        trace,
    )


@dataclass(frozen=True)
class Request:
    """What is compared."""

    run: Run
    arms: tuple[str, ...]
    bandwidths: tuple[float, ...]
    seeds: tuple[int, ...]
    is_pose_measured: bool
    kill_at: float = np.inf
    announced: tuple[Payload, ...] = ()

    @property
    def settling(self) -> float:
        """s after the last contact that belong to the transient."""
        return SETTLING_ANNOUNCED if self.announced else SETTLING


def run_all(request: Request, progress: Callable[[str], None]) -> list[Outcome]:
    """Every trial, in the order of seeds, bandwidths, arms; with the first seed's traces, 7 MB each for 49 s."""
    outcomes = []
    for seed in request.seeds:
        run = replace(request.run, seed=seed)
        for bandwidth in request.bandwidths:
            for arm in request.arms:
                progress(f"seed {seed}, {bandwidth:g} Hz, {arm}")
                kill_at = request.kill_at if arm == "live" else np.inf
                trial = Trial(run, arm, bandwidth, request.is_pose_measured, kill_at, announced=request.announced)
                outcome = measured(trial, closed_loop.control(trial), request.settling)
                outcomes.append(outcome if seed == request.seeds[0] else replace(outcome, trace=None))
    return outcomes


def document(outcomes: list[Outcome]) -> dict[str, dict[str, dict[str, float]]]:
    """control.json: medians over the seeds, by arm and bandwidth."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for arm in dict.fromkeys(o.arm for o in outcomes):
        for bandwidth in dict.fromkeys(o.bandwidth for o in outcomes):
            values = [o.document for o in select(outcomes, arm, bandwidth)]
            medians = {key: float(np.median([v[key] for v in values])) for key in KEYS}
            found.setdefault(arm, {})[f"{bandwidth:g}"] = medians
    return found


def select(outcomes: list[Outcome], arm: str, bandwidth: float) -> list[Outcome]:
    """Those of one arm and bandwidth, a seed each."""
    return [o for o in outcomes if o.arm == arm and o.bandwidth == bandwidth]


def _median(outcomes: list[Outcome], phase: str, name: str) -> float:
    values = [getattr(o.phases[phase], name) for o in outcomes if phase in o.phases]
    return float(np.median(values)) if values else np.nan


def rows(outcomes: list[Outcome]) -> list[list[str]]:
    """Cells of the table under HEAD, a row per bandwidth and arm. Empty: there is no such phase, or not measured."""
    found = []
    for bandwidth in dict.fromkeys(o.bandwidth for o in outcomes):
        for arm in dict.fromkeys(o.arm for o in outcomes):
            some = select(outcomes, arm, bandwidth)
            cells = [f"{bandwidth:g} Hz", arm]
            for phase in PHASES:
                rms, most = (_median(some, phase, name) for name in ("rms_mm", "max_mm"))
                cells += [_number(rms), _number(most)]
            cells += [_number(_median(some, "late", "rms_deg")), _number(_median(some, "late", "tension_norm"), 0)]
            hand_over = max(o.hand_over for o in some)
            cells += ["" if np.isnan(hand_over) else f"{100 * hand_over:.2f} %"]
            cells += [f"{max(o.beyond for o in some):.0f} N", f"{max(o.n_cut for o in some)}"]
            found.append(cells)
    return found


def _number(value: float, digits: int = 2) -> str:
    return "" if np.isnan(value) else f"{value:.{digits}f}"


def lines(outcomes: list[Outcome]) -> list[str]:
    """The table as text, columns aligned."""
    table = [HEAD, *rows(outcomes)]
    width = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    aligned = [
        "  ".join(cell.ljust(w) if i < 2 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, width, strict=True)))
        for row in table
    ]
    return [line.rstrip() for line in aligned]


def write_json(path: Path, outcomes: list[Outcome]) -> None:
    """control.json: {arm: {bandwidth in Hz: medians over the seeds}}; null: the motion has no such phase."""
    written = {
        arm: {
            hz: {key: None if np.isnan(value) else value for key, value in values.items()}
            for hz, values in found.items()
        }
        for arm, found in document(outcomes).items()
    }
    path.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


def words(text: str, allowed: tuple[str, ...], option: str) -> tuple[str, ...]:
    """A list with commas. InputError: a word that is not allowed."""
    found = tuple(word.strip() for word in text.split(","))
    for word in found:
        if word not in allowed:
            raise InputError(f'{option} "{word}": allowed: {", ".join(allowed)}{nearest(word, allowed)}')
    return tuple(dict.fromkeys(found))


def bandwidths(text: str) -> tuple[float, ...]:
    """A list of Hz with commas. InputError: no number, or outside of 0.05 to 20 Hz."""
    found: list[float] = []
    for word in text.split(","):
        try:
            value = float(word)
        except ValueError:
            value = -1.0
        if not 0.05 <= value <= 20.0:
            raise InputError(f'--bandwidth "{word}": allowed: 0.05 to 20, Hz')
        found.append(value)
    return tuple(dict.fromkeys(found))


def arms(text: str) -> tuple[str, ...]:
    """A list of arms with commas. InputError: one that is not known."""
    return words(text, ARMS, "--arms")


def _first_live(outcomes: list[Outcome]) -> Trace | None:
    return next((o.trace for o in outcomes if o.arm == "live" and o.trace is not None), None)


def notes(outcomes: list[Outcome]) -> list[str]:
    """What happened in the first live trial, a line each, with its time."""
    trace = _first_live(outcomes)
    return [] if trace is None else [f"t = {t:.2f} s: {text}" for t, text in trace.told]


def summary(outcomes: list[Outcome]) -> Any:
    """The first live trial's offers to the gate, by what became of them."""
    trace = _first_live(outcomes)
    return {} if trace is None else dict(trace.offers)
