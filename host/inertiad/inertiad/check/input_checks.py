# SPDX-License-Identifier: Apache-2.0
"""Checks of the input: configuration, frames, counters, positions."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from inertiad.base import counters
from inertiad.check import daemon_run
from inertiad.check.case import Case, Check
from inertiad.robot import configuration
from inertiad.run import canlog, lcmlog
from inertiad.run.canlog import CanLog
from inertiad_lcm import order_item_t, robot_config_t

DIFFERENCES_SHOWN: Final = 3


def check_config(case: Case) -> Iterator[Check]:
    same = case.config_bytes == case.given_config
    yield Check("configuration", same, "equals the compiled robot.toml" if same else "differs from robot.toml")


def _record_of_configuration(run: Path) -> tuple[str, bytes | None]:
    """The file that holds the configuration of a run, and its contents: the daemon's own record, else robot.cfg.

    None: there is no such file; the text gives the reason.
    """
    log, file = run / "run.lcmlog", run / "robot.cfg"
    if log.exists():
        for event in lcmlog.read(log):
            if event.channel.endswith("_CONFIG"):
                return log.name, event.data
    if file.exists():
        return file.name, file.read_bytes()[:-4]
    return f"no robot.cfg and no CONFIG in {'its' if log.exists() else 'a'} run.lcmlog", None


def check_record(case: Case) -> Iterator[Check]:
    """The daemon's own record, if the run has one, is whole."""
    log = case.run / "run.lcmlog"
    if not log.exists():
        return
    remarks: list[str] = []
    n = sum(1 for _ in lcmlog.read(log, remarks))
    yield Check("record", not remarks, "; ".join(remarks) or f"{n} messages of {log.name} are undamaged")


def _differences(was: robot_config_t, config: bytes) -> dict[str, str]:
    """configuration.differences() without the gyro's bias, which the daemon learns itself."""
    differs = configuration.differences(was, robot_config_t.decode(config[:-4]))
    return {key: what for key, what in differs.items() if not key.startswith("gyro_bias")}


def is_blind(run: Path, given: Path | None, full: bytes, blind: bytes) -> bool:
    """Whether the configuration of a run, or a given one, is closer to the robot's without [nominal] than with it."""
    data = _record_of_configuration(run)[1] if given is None else given.read_bytes()[:-4]
    try:
        was = robot_config_t.decode(data) if data is not None else None
    except (ValueError, struct.error):
        was = None
    return was is not None and len(_differences(was, blind)) < len(_differences(was, full))


def check_description(case: Case) -> Iterator[Check]:
    """robot.toml and its DBC files still give the configuration of the run."""
    name, data = _record_of_configuration(case.run)
    unknown = "the configuration of the run is unknown, so changes since cannot be checked: "
    if data is None:
        yield Check("robot.toml", None, unknown + name)
        return
    try:
        was = robot_config_t.decode(data)
    except (ValueError, struct.error):
        yield Check("robot.toml", None, f"{unknown}{name} was written by another version")
        return
    differs = _differences(was, case.config_bytes)
    shown = "; ".join(f"{key} is {what}" for key, what in list(differs.items())[:DIFFERENCES_SHOWN])
    more = len(differs) - DIFFERENCES_SHOWN
    detail = f"differs from {name}, the configuration of the run: {shown}" + (f"; and {more} more" if more > 0 else "")
    blind = ", compiled --blind" if case.is_blind else ""
    equal = f"equals {name}, the configuration of the run{blind}"
    yield Check("robot.toml", not differs, detail if differs else equal)


def check_daemon(case: Case) -> Iterator[Check]:
    p = case.published
    lines = p.stderr.splitlines()
    detail = f"exit status {p.exit_status}" + (f": {lines[0]}" if p.exit_status and lines else "")
    yield Check("daemon", p.exit_status == 0, detail)
    n = {name: len(p.messages[name]) for name in daemon_run.KINDS if p.messages[name]}
    lost = {name: k for name, k in p.n_gaps.items() if k}
    what = ", ".join(f"{k} {name}" for name, k in n.items())
    yield Check("messages", bool(n) and not lost, what + (f"; missing: {lost}" if lost else "; none missing"))


def _first_difference(log: CanLog, raw: CanLog) -> str:
    """The first difference of RAW from the log, "" if there is none."""
    n = min(len(log), len(raw))
    width = max(log.data.shape[1], raw.data.shape[1])
    data = [np.pad(x.data[:n], ((0, 0), (0, width - x.data.shape[1]))) for x in (log, raw)]
    differs = (data[0] != data[1]).any(axis=1)
    for name in ("can_id", "flags", "length"):
        differs |= getattr(log, name)[:n] != getattr(raw, name)[:n]
    if differs.any():
        at = int(np.argmax(differs))
        was, got = (canlog.lines(x[at : at + 1])[0].decode().split()[-1] for x in (log, raw))
        return f"frame {at + 1} was {was}, RAW has {got}"
    return "" if len(log) == len(raw) else f"frame {n + 1}: {len(log)} frames in the log, {len(raw)} in RAW"


def check_frames(case: Case) -> Iterator[Check]:
    for bus in range(max(len(case.log.names), 1)):
        one_bus = len(case.robot.bus) <= 1
        log = case.log if one_bus else case.log[case.log.bus == bus]
        raw = case.raw if one_bus else case.raw[case.raw.bus == bus]
        difference = _first_difference(log, raw)
        yield Check(
            f"frames of bus {bus}", not difference, difference or f"all {len(log)} in RAW, same content and order"
        )
        if not difference and not case.published.is_live:
            same = bool((log.t_ns == raw.t_ns).all())
            yield Check(f"stamps of bus {bus}", same, "equal to the log's" if same else "differ from the log's")
        elif not difference:
            yield _check_live_stamps(bus, log, raw)
        if one_bus:
            return


def _check_live_stamps(bus: int, log: CanLog, raw: CanLog) -> Check:
    drift = (raw.t_ns - raw.t_ns[0]) - (log.t_ns - log.t_ns[0])
    p50, p99 = np.percentile(np.abs(drift - np.median(drift)), [50, 99]) / 1e3
    ordered = bool((np.diff(raw.t_ns) >= 0).all())
    detail = f"spacing off by {p50:.0f} us (p50), {p99:.0f} us (p99)"
    return Check(f"stamps of bus {bus}", ordered, detail + ("" if ordered else "; they go back"))


def _is_bad(counter: str, is_live: bool) -> bool:
    """True if the counter must be zero. Samples that a busy host stamped too late are judged by row_checks."""
    stage, _, name = counter.partition(".")
    return counters.is_bad(counter) and not (is_live and stage == "align" and "backwards" in name)


def check_counters(case: Case) -> Iterator[Check]:
    found = case.published.summary
    if not found:
        yield Check("counters", False, "the daemon printed none")
        return
    n_bus = sum(n for name, n in found.items() if name.startswith("bus") and name.endswith(".frames"))
    outcomes = ("decoded", "unknown_id", "remote", "error_frame", "bad_length")
    n_outcomes = sum(found.get(f"decode.{name}", 0) for name in outcomes)
    adds_up = n_bus == n_outcomes == found.get("decode.frames") == len(case.raw) == len(case.log)
    detail = f"log {len(case.log)}, buses {n_bus}, RAW {len(case.raw)}, decoded or counted by cause {n_outcomes}"
    yield Check("frames add up", adds_up, detail)
    bad = {name: n for name, n in found.items() if n and _is_bad(name, case.published.is_live)}
    listed = ", ".join(f"{name} {n}" for name, n in bad.items())
    yield Check("nothing lost or refused", not bad, listed or "every such counter is 0")
    n_decoded = found.get("decode.decoded", 0)
    detail = f"{n_decoded} frames carry signals of the description"
    yield Check("signals", n_decoded > 0, detail)


def check_positions(case: Case) -> Iterator[Check]:
    if not case.positions:
        return
    items = [i for m in case.published.messages["ORDER"] for i in m.item if i.kind == order_item_t.POSITION]
    sent = {(t, *xyz) for t, xyz in case.positions}
    foreign = sum((daemon_run.seconds(i.t_ns), *i.value) not in sent for i in items)
    n, silences = len(items), case.published.summary.get("position.silences", 0)
    detail = f"{n} of {len(case.positions)} used" + (f", {foreign} of them were not sent" if foreign else "")
    detail += f"; silent {silences} times" if silences else ""
    yield Check("tracker positions", n == len(case.positions) and not foreign, detail)
