# SPDX-License-Identifier: Apache-2.0
"""Checks of the estimates: against the same core offline, a batch fit without recursion, and the truth."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

import inertiad_core
from inertiad.base import body as estimate
from inertiad.base.table import Array
from inertiad.check.case import Case, Check

LIVE_TOLERANCE: Final = 1e-9
"""relative, of estimates when live stamps are carried through; 0 from a file"""
BATCH_SIGMAS: Final = 2.0
"""published standard deviations that recursion and batch may differ by"""
TRUTH_SIGMAS: Final = 4.0


@dataclass
class Recomputed:
    """Offline results of the core for the same input."""

    by_window: dict[int, dict[str, Any]]
    """estimates by their number of windows"""
    last: dict[str, Any] | None
    pipeline: Any
    """with its rows kept"""


def _merged(case: Case) -> Iterator[tuple[int, int]]:
    """Indices of frames (0, i) and positions (1, i) in the order the daemon takes them: by stamp, frames first."""
    frames = np.maximum.accumulate(case.raw.t_ns)
    positions = np.maximum.accumulate(np.array([t for t, _ in case.positions], dtype=np.int64))
    t = np.concatenate([frames, positions])
    for k in np.argsort(t, kind="stable").tolist():
        yield (0, k) if k < len(frames) else (1, k - len(frames))


def _feed(case: Case, pipeline: Any, after: Callable[[], None]) -> None:
    raw = case.raw
    bus = raw.bus.tolist() if len(case.robot.bus) > 1 else [0] * len(raw)
    length = raw.length.tolist()
    data, width = raw.data.tobytes(), raw.data.shape[1]
    t_ns, can_id, flags = raw.t_ns.tolist(), raw.can_id.tolist(), raw.flags.tolist()
    for kind, k in _merged(case):
        if kind == 0:
            pipeline.push_frame(t_ns[k], bus[k], can_id[k], data[width * k : width * k + length[k]], flags[k])
        else:
            pipeline.push_position(case.positions[k][0], np.array(case.positions[k][1]))
        after()
    pipeline.flush()
    after()


def recompute(case: Case) -> Recomputed:
    """Run the core over the daemon's input."""
    stepped, kept = inertiad_core.Pipeline(case.config), inertiad_core.Pipeline(case.config)
    found: dict[int, dict[str, Any]] = {}

    def step() -> None:
        while (status := stepped.step()) != 1:
            if status == 0:
                e = stepped.estimate
                found[e["n_windows"]] = e

    _feed(case, stepped, step)
    _feed(case, kept, kept.drain)
    return Recomputed(found, stepped.estimate if found else None, kept)


FIELDS: Final = (
    "mass",
    "mass_std",
    "cog",
    "cog_std",
    "inertia_cog",
    "inertia_cog_std",
    "theta",
    "covariance",
    "systematic",
    "systematic_std",
    "distance",
    "nis",
)
EXACT_FIELDS: Final = ("t_ns", "n_rows", "consistent", "n_changes")


def _difference(message: Any, mine: dict[str, Any]) -> float:
    """Largest difference of any field, relative to that field's largest value; inf: a count or a flag differs."""
    if any(getattr(message, name) != mine[name] for name in EXACT_FIELDS):
        return float("inf")
    worst = 0.0
    for name in FIELDS:
        a, b = np.asarray(getattr(message, name), dtype=float), np.asarray(mine[name], dtype=float)
        if a.shape != b.shape:
            return float("inf")
        gap = float(np.abs(a - b).max(initial=0.0))
        worst = max(worst, gap / max(float(np.abs(b).max(initial=0.0)), 1e-300) if gap else 0.0)
    return worst


def check_recomputation(case: Case, mine: Recomputed) -> Iterator[Check]:
    messages = case.published.messages["ESTIMATE"]
    if not messages or mine.last is None:
        yield Check("estimates", False, f"{len(messages)} published, {len(mine.by_window)} recomputed: needs some")
        return
    worst = max(_difference(m, mine.by_window.get(m.n_windows, {**mine.last, "t_ns": -1})) for m in messages)
    limit = LIVE_TOLERANCE if case.published.is_live else 0.0
    how = "bit-identical" if worst == 0.0 else f"differ by up to {worst:.2g} of their size, allowed {limit:g}"
    yield Check("estimates", worst <= limit, f"{len(messages)} published, against the same core offline: {how}")
    is_last = messages[-1].n_windows == mine.last["n_windows"]
    detail = f"after {messages[-1].n_windows} windows, offline after {mine.last['n_windows']}"
    yield Check("last estimate", is_last, detail)
    yield _check_estimate_file(case, messages[-1])


def _check_estimate_file(case: Case, message: Any) -> Check:
    if case.published.estimate_file is None:
        return Check("estimate.json", False, "the daemon wrote none")
    same = estimate.read(case.published.estimate_file) == estimate.of_message(message)
    return Check("estimate.json", same, "equals the last message" if same else "differs from the last message")


def batch(case: Case, mine: Recomputed) -> Any:
    """Body by the joint batch solver over all rows, with the configuration's priors: no recursion."""
    rows = inertiad_core.rows_of(mine.pipeline)
    return inertiad_core.batch(case.config, [rows], group=[0], payload=[0.0])["body"][0]


def _ten(body: Any) -> Array:
    return np.array([body["mass"], *body["cog"], *body["inertia_cog"]])


def _sigmas(gap: Array, std: Array) -> tuple[float, str]:
    """The largest gap in standard deviations, and whose it is."""
    ratio = np.abs(gap) / np.maximum(std, 1e-300)
    at = int(np.argmax(ratio))
    return float(ratio[at]), estimate.NAMES[at]


def check_batch(case: Case, mine: Recomputed) -> Iterator[Check]:
    if mine.last is None or not case.published.messages["ESTIMATE"]:
        return
    try:
        other = _ten(batch(case, mine))
    except (ValueError, np.linalg.LinAlgError) as error:
        yield Check("batch fit", False, f"impossible: {error}")
        return
    body = estimate.of_message(case.published.messages["ESTIMATE"][-1])
    worst, name = _sigmas(np.array(body.value) - other, np.array(body.std))
    detail = f"joint batch gives {other[0]:.3f} kg; farthest is {name}, by {worst:.2f} sigma"
    yield Check("batch fit", worst <= BATCH_SIGMAS, f"{detail}, allowed {BATCH_SIGMAS:g}")


def check_truth(case: Case) -> Iterator[Check]:
    path = case.run / "truth.json"
    messages = case.published.messages["ESTIMATE"]
    if not path.exists() or not messages:
        return
    body, truth = estimate.of_message(messages[-1]), estimate.read_truth(path)
    worst, name = _sigmas(np.array(estimate.errors(body, truth)), np.array(body.std))
    detail = f"mass {body.value[0]:.3f} +- {body.std[0]:.3f} kg, true {truth.value[0]:.3f}; farthest is {name}"
    yield Check("truth", worst <= TRUTH_SIGMAS, f"{detail}, by {worst:.2f} sigma, allowed {TRUTH_SIGMAS:g}")


def check_golden(case: Case) -> Iterator[Check]:
    path = case.run / "estimate.json"
    messages = case.published.messages["ESTIMATE"]
    if not path.exists() or not messages or case.published.is_live:
        return
    was, body = estimate.read(path), estimate.of_message(messages[-1])
    worst, name = _sigmas(np.array(body.value) - np.array(was.value), np.array(body.std))
    yield Check("the run's estimate.json", worst <= 1e-6, f"farthest is {name}, by {worst:.2g} sigma, allowed 1e-06")
