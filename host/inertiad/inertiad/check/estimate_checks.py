# SPDX-License-Identifier: Apache-2.0
"""Checks of the published rows and estimates.

Rows and estimates are compared bit for bit with a recomputation by the same core, from RAW and ORDER in the order in
which the daemon used them; every estimate that was due must be there. The last estimate is compared with the joint
batch solver on the published rows, and with the truth of a simulated run.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

import inertiad_core
from inertiad.base import body as estimate
from inertiad.base.table import Array
from inertiad.check.case import Case, Check
from inertiad_lcm import command_t, order_item_t, robot_config_t

BATCH_SIGMAS: Final = 2.0
"""published standard deviations that recursion and batch may differ by"""
TRUTH_SIGMAS: Final = 4.0
NUMBERS: Final = 20
"""of expectation_t, beside its time"""


@dataclass
class Recomputed:
    """The core's results on the same input in the same order, offline."""

    after_row: list[dict[str, Any] | None]
    """the estimate after each row; None: there is none yet"""
    last: dict[str, Any] | None
    pipeline: Any
    """with its rows kept"""
    is_whole: bool
    """False: a configuration was sent during the run; the recomputation ends there"""


def _in_order(case: Case) -> Iterator[tuple[int, int, Any]]:
    """The estimator's input as the daemon used it: frames begin .. end, then the ORDER item after them, or None."""
    begin, n = {}, 0
    for message in case.published.messages["RAW"]:
        begin[message.sequence] = n
        n += message.n_frames
    at = 0
    for message in case.published.messages["ORDER"]:
        for item in message.item:
            place = min(begin.get(item.raw, n) + item.n_before, n)
            yield at, place, item
            at = place
    yield at, n, None


def _execute(pipeline: Any, item: Any, expected: list[float]) -> None:
    """Use one position or command. expected: numbers of the EXPECT whose items come, emptied with the last."""
    if item.kind == order_item_t.POSITION:
        pipeline.push_position(item.t_ns, np.array(item.value))
    elif item.kind in (command_t.FREEZE, command_t.RESUME):
        pipeline.freeze(item.kind == command_t.FREEZE)
    elif item.kind == command_t.RESET:
        pipeline.reset()
    elif item.kind == command_t.TARE:
        pipeline.set_gyro_bias(np.array(item.value))
    elif item.kind == command_t.EXPECT:
        expected += item.value
        if len(expected) == 3 * order_item_t.EXPECT_ITEMS:
            pipeline.expect(item.t_ns, np.array(expected[:NUMBERS]))
            expected.clear()


def recompute(case: Case) -> Recomputed:
    """Run the core over the frames in RAW and the items in ORDER."""
    pipeline, raw = inertiad_core.Pipeline(case.config), case.raw
    mine = Recomputed([], None, pipeline, True)
    bus = raw.bus.tolist() if len(case.robot.bus) > 1 else [0] * len(raw)
    data, width, length = raw.data.tobytes(), raw.data.shape[1], raw.length.tolist()
    t_ns, can_id, flags = raw.t_ns.tolist(), raw.can_id.tolist(), raw.flags.tolist()

    def step() -> None:
        while (status := pipeline.step()) != 1:
            if status == 0:
                mine.last = pipeline.estimate
            if status >= 0:
                mine.after_row.append(mine.last)

    expected: list[float] = []
    for begin, end, item in _in_order(case):
        for k in range(begin, end):
            pipeline.push_frame(t_ns[k], bus[k], can_id[k], data[width * k : width * k + length[k]], flags[k])
            step()
        if item is not None and item.kind == command_t.CONFIGURE:
            mine.is_whole = False
            break
        if item is not None:
            _execute(pipeline, item, expected)
            mine.last = None if item.kind == command_t.RESET else mine.last
            step()
    pipeline.flush()
    step()
    return mine


def _due(case: Case, mine: Recomputed) -> list[dict[str, Any]]:
    """The estimates to be published: at the configured rate in the time of the published rows, and the last."""
    rows = [row.t_ns for message in case.published.messages["SIGNALS"] for row in message.row]
    period = round(1e9 / robot_config_t.decode(case.config_bytes[:-4]).estimate_rate)
    due, found = None, []
    for t, current in zip(rows, mine.after_row, strict=False):
        if current is None or (due is not None and -period <= t - due < 0):
            continue
        found.append(current)
        due = (due if due is not None and 0 <= t - due < period else t) + period
    return [*found, mine.last] if mine.last is not None else found


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
EXACT_FIELDS: Final = ("t_ns", "n_windows", "n_rows", "consistent", "n_changes")


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


def _check_recomputed_rows(case: Case, mine: Recomputed) -> Check:
    rows = inertiad_core.rows_of(mine.pipeline)
    published = [row for message in case.published.messages["SIGNALS"] for row in message.row]
    if len(published) != len(rows):
        return Check("rows recomputed", False, f"{len(published)} published, {len(rows)} recomputed")
    for name in ("acc", "gyro", "q", "position", "f"):
        theirs = np.array([getattr(row, name) for row in published])
        differs = (theirs != getattr(rows, name)).any(axis=1) if len(published) else np.zeros(0, bool)
        if differs.any():
            return Check("rows recomputed", False, f"{name} of row {int(np.argmax(differs)) + 1} differs")
    return Check("rows recomputed", True, f"all {len(published)} bit-identical")


def check_recomputation(case: Case, mine: Recomputed) -> Iterator[Check]:
    messages = case.published.messages["ESTIMATE"]
    if not mine.is_whole:
        yield Check("estimates", None, "a configuration was sent during the run, where the recomputation ends")
        return
    yield _check_recomputed_rows(case, mine)
    due = _due(case, mine)
    if not messages or not due:
        yield Check("estimates", False, f"{len(messages)} published, {len(due)} recomputed: needs some")
        return
    worst = max(_difference(m, due[m.sequence]) if m.sequence < len(due) else float("inf") for m in messages)
    how = "bit-identical" if worst == 0.0 else f"differ by up to {worst:.2g} of their size"
    detail = f"{len(messages)} published, {len(due)} due, against the same core offline: {how}"
    yield Check("estimates", worst == 0.0 and len(messages) == len(due), detail)
    yield _check_estimate_file(case, messages[-1])


def _check_estimate_file(case: Case, message: Any) -> Check:
    if case.published.estimate_file is None:
        return Check("estimate.json", False, "the daemon wrote none")
    same = estimate.read(case.published.estimate_file) == estimate.of_message(message)
    return Check("estimate.json", same, "equals the last message" if same else "differs from the last message")


def _published_rows(case: Case) -> Any:
    """inertiad_core.Rows of all SIGNALS messages."""
    rows = [row for message in case.published.messages["SIGNALS"] for row in message.row]
    width = {"acc": 3, "gyro": 3, "q": 4, "position": 3, "f": case.robot.n_cables}
    t_ns = np.array([row.t_ns for row in rows], dtype=np.int64)
    acc, gyro, q, position, f = (
        np.array([getattr(row, name) for row in rows]).reshape(-1, n) for name, n in width.items()
    )
    return inertiad_core.Rows(t_ns, acc, gyro, q, position, f)


def batch(case: Case) -> Any:
    """Body by the joint batch solver over the rows that the daemon published, with the configuration's priors."""
    return inertiad_core.batch(case.config, [_published_rows(case)], group=[0], payload=[0.0])["body"][0]


def _ten(body: Any) -> Array:
    return np.array([body["mass"], *body["cog"], *body["inertia_cog"]])


def _sigmas(gap: Array, std: Array) -> tuple[float, str]:
    """The largest gap in standard deviations, and whose it is."""
    ratio = np.abs(gap) / np.maximum(std, 1e-300)
    at = int(np.argmax(ratio))
    return float(ratio[at]), estimate.NAMES[at]


def check_batch(case: Case) -> Iterator[Check]:
    if not case.published.messages["ESTIMATE"]:
        return
    try:
        other = _ten(batch(case))
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
