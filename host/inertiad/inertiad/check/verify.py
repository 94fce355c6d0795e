# SPDX-License-Identifier: Apache-2.0
"""Does the daemon do with a run what it must? One line per check, PASS or FAIL, or OPEN where it could not be made.

The frames it says it took are compared with the log, its counters with each other, its rows with a decoder of our own
(from the DBC, in numpy), its estimates with a recomputation by the same core and with a plain batch weighted least
squares, its result with the truth of a simulated run. robot.toml and its DBC files are compared with the configuration
that the run was made with, where the run says it: in the daemon's own record run.lcmlog, or as robot.cfg.
"""

import json
import struct
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import inertiad_core
from inertiad.base import body as estimate
from inertiad.base import channels, quantity
from inertiad.base import counters as judgement
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.check import daemon_run
from inertiad.check.daemon_run import Published, Setup
from inertiad.robot import configuration, dbc, description
from inertiad.robot.dbc import Binding
from inertiad.robot.description import Robot
from inertiad.run import canlog, encode, lcmlog
from inertiad.run.canlog import CanLog
from inertiad_lcm import robot_config_t

LIVE_TOLERANCE: Final = 1e-9
"""relative, of estimates when live stamps are carried through; 0 from a file"""
BATCH_SIGMAS: Final = 2.0
"""published standard deviations that recursion and batch may differ by"""
TRUTH_SIGMAS: Final = 4.0
ROWS_LOST_MAX: Final = 0.01
"""share of IMU samples that may not become rows: at the ends, where another sensor is missing; on a bus also where the
host stamped late and its clock's fit steps back once it knows better"""
UNSETTLED_MAX: Final = 3.0
"""s of rows that the daemon may give up because clocks were not settled, where none was stepped"""
LATENCY_MAX: Final = 0.1
"""s, p99 from a frame's stamp to the arrival of its RAW message"""
DIFFERENCES_SHOWN: Final = 3
NS_PER_S: Final = 1e9


@dataclass(frozen=True)
class Check:
    """One line of the verdict."""

    name: str
    passed: bool | None
    """None: it could not be made"""
    detail: str

    def __str__(self) -> str:
        verdict = "OPEN" if self.passed is None else "PASS" if self.passed else "FAIL"
        return f"{verdict}  {self.name}: {self.detail}"


@dataclass
class Case:
    """Everything the checks look at."""

    robot: Robot
    config_bytes: bytes
    """compiled from the run's robot.toml"""
    given_config: bytes
    """what the daemon ran with"""
    log: CanLog
    raw: CanLog
    published: Published
    positions: list[tuple[int, list[float]]]
    bindings: list[Binding]
    run: Path

    @property
    def config(self) -> Any:
        return inertiad_core.Config(self.config_bytes)


# ---- frames and counters ---------------------------------------------------------------------------------------------


def _check_config(case: Case) -> Iterator[Check]:
    same = case.config_bytes == case.given_config
    yield Check("configuration", same, "is what robot.toml compiles to" if same else "differs from robot.toml")


def _record_of_configuration(run: Path) -> tuple[str, bytes | None]:
    """Which file says what configuration a run was made with, and that: the daemon's own record, else robot.cfg.

    None: no file does, the text says why.
    """
    log, file = run / "run.lcmlog", run / "robot.cfg"
    if log.exists():
        for event in lcmlog.read(log):
            if event.channel.endswith("_CONFIG"):
                return log.name, event.data
    if file.exists():
        return file.name, file.read_bytes()[:-4]
    return f"no robot.cfg and no CONFIG in {'its' if log.exists() else 'a'} run.lcmlog", None


def _check_description(case: Case) -> Iterator[Check]:
    """robot.toml and its DBC files still say what the run was made with."""
    name, data = _record_of_configuration(case.run)
    unknown = "what the run was made with is not known, so what has changed since cannot be told: "
    if data is None:
        yield Check("robot.toml", None, unknown + name)
        return
    try:
        was = robot_config_t.decode(data)
    except (ValueError, struct.error):
        yield Check("robot.toml", None, f"{unknown}{name} was written by another version")
        return
    differs = configuration.differences(was, robot_config_t.decode(case.config_bytes[:-4]))
    differs = {key: what for key, what in differs.items() if not key.startswith("gyro_bias")}  # it learns that itself
    said = "; ".join(f"{key} is {what}" for key, what in list(differs.items())[:DIFFERENCES_SHOWN])
    more = len(differs) - DIFFERENCES_SHOWN
    detail = f"differs from {name}, which the run was made with: {said}" + (f"; and {more} more" if more > 0 else "")
    yield Check("robot.toml", not differs, detail if differs else f"is what the run was made with, says {name}")


def _check_daemon(case: Case) -> Iterator[Check]:
    p = case.published
    lines = p.stderr.splitlines()
    detail = f"exit status {p.exit_status}" + (f": {lines[0]}" if p.exit_status and lines else "")
    yield Check("daemon", p.exit_status == 0, detail)
    n = {name: len(p.messages[name]) for name in daemon_run.KINDS if p.messages[name]}
    lost = {name: k for name, k in p.n_gaps.items() if k}
    what = ", ".join(f"{k} {name}" for name, k in n.items())
    yield Check("messages", bool(n) and not lost, what + (f"; missing: {lost}" if lost else "; none missing"))


def _first_difference(log: CanLog, raw: CanLog) -> str:
    """Where RAW stops being the log, "" if it does not."""
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


def _check_frames(case: Case) -> Iterator[Check]:
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
    """True if the counter must be zero.

    Samples that a busy host stamped too late are judged by _check_rows(): they are not the daemon's doing.
    """
    stage, _, name = counter.partition(".")
    return judgement.is_bad(counter) and not (is_live and stage == "align" and "backwards" in name)


def _check_counters(case: Case) -> Iterator[Check]:
    counters = case.published.summary
    if not counters:
        yield Check("counters", False, "the daemon printed none")
        return
    n_bus = sum(n for name, n in counters.items() if name.startswith("bus") and name.endswith(".frames"))
    outcomes = ("decoded", "unknown_id", "remote", "error_frame", "bad_length")
    n_outcomes = sum(counters.get(f"decode.{name}", 0) for name in outcomes)
    adds_up = n_bus == n_outcomes == counters.get("decode.frames") == len(case.raw) == len(case.log)
    detail = f"log {len(case.log)}, buses {n_bus}, RAW {len(case.raw)}, decoded or counted by cause {n_outcomes}"
    yield Check("frames add up", adds_up, detail)
    bad = {name: n for name, n in counters.items() if n and _is_bad(name, case.published.is_live)}
    told = ", ".join(f"{name} {n}" for name, n in bad.items())
    yield Check("nothing lost or refused", not bad, told or "every such counter is 0")
    n_decoded = counters.get("decode.decoded", 0)
    detail = f"{n_decoded} frames carry signals of the description"
    yield Check("signals", n_decoded > 0, detail)


def _check_positions(case: Case) -> Iterator[Check]:
    if not case.positions:
        return
    counters = case.published.summary
    n = counters.get("lcm.tracker_positions" if case.published.is_live else "tracker.positions", 0)
    sent = len(case.positions)
    silences = counters.get("position.silences", 0)
    detail = f"{n} of {sent} taken" + (f"; silent {silences} times" if silences else "")
    yield Check("tracker positions", n == sent, detail)


# ---- rows ------------------------------------------------------------------------------------------------------------


def decode(binding: Binding, log: CanLog) -> tuple[NDArray[np.intp], Array]:
    """Indices and values [SI] of a bound signal in the log, from the DBC alone: no code shared with the daemon."""
    chosen = (log.can_id == binding.can_id) & (log.length == binding.message.length)
    if len(log.names) > 1:
        chosen &= log.bus == binding.bus
    at = np.flatnonzero(chosen)
    if binding.mux is not None:
        selector, value = binding.mux
        at = at[_raw(selector, log.data[at]) == value]
    return at, _si(binding, _raw(binding.signal, log.data[at]))


def _raw(signal: Any, data: Any) -> Any:
    raw = np.zeros(len(data), dtype=np.uint64)
    for i, (byte, bit) in enumerate(encode.bit_positions(signal)):
        raw |= ((data[:, byte] >> bit) & 1).astype(np.uint64) << np.uint64(i)
    return raw


def _si(binding: Binding, raw: Any) -> Array:
    signal = binding.signal
    if signal.is_float:
        number = raw.astype(np.uint32).view(np.float32) if signal.length == 32 else raw.view(np.float64)
    elif signal.is_signed:
        sign = np.uint64(64 - signal.length)
        number = (raw << sign).view(np.int64) >> sign.astype(np.int64)
    else:
        number = raw
    return np.asarray(number.astype(np.float64) * binding.scale + binding.offset)


def _rows(case: Case) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """Stamps [ns] and values of all rows of all SIGNALS messages."""
    rows = [r for m in case.published.messages["SIGNALS"] for r in m.row]
    values = {name: np.array([getattr(r, name) for r in rows]) for name in ("acc", "gyro")}
    return np.array([r.t_ns for r in rows], dtype=np.int64), values


def _check_rows(case: Case) -> Iterator[Check]:
    t_ns, values = _rows(case)
    counters = case.published.summary
    n_imu = counters.get("align.imu.samples", 0) + counters.get("align.imu.backwards", 0)
    n_unsettled = counters.get("clock.unsettled", 0)
    lost = n_imu - len(t_ns) - n_unsettled
    good = n_imu > 0 and 0 <= lost <= max(ROWS_LOST_MAX * n_imu, 50)
    good &= len(t_ns) > 1 and n_unsettled * float(np.median(np.diff(t_ns))) < UNSETTLED_MAX * NS_PER_S
    causes = ("missing", "late", "backwards", "carried", "unsettled")
    told = ", ".join(f"{name} {n}" for name, n in counters.items() if n and name.rpartition(".")[2] in causes)
    yield Check("rows", good, f"{len(t_ns)} of {n_imu} IMU samples{f'; {told}' if told else ''}")
    ordered = len(t_ns) > 0 and bool((np.diff(t_ns) > 0).all())
    yield Check("row stamps", ordered, "increase" if ordered else "do not increase")
    if len(t_ns):
        yield _check_decoder(case, values)


def _check_decoder(case: Case, values: dict[str, Array]) -> Check:
    """Every acceleration and rate in the rows is one that stands in the log, by our own decoder."""
    for name, found in values.items():
        for axis in range(3):
            binding = next(b for b in case.bindings if b.quantity == f"{name}_{'xyz'[axis]}")
            there = np.isin(found[:, axis], decode(binding, case.log)[1])
            if not there.all():
                at = int(np.argmin(there))
                detail = (
                    f"{binding.quantity} = {found[at, axis]:.9g} of row {at + 1} is not in the log by {binding.place}"
                )
                return Check("decoder", False, detail)
    return Check("decoder", True, "every acceleration and rate equals one decoded from the log by the DBC")


def _check_sample_counters(case: Case) -> Iterator[Check]:
    """Counters the sensors put into their messages step by one."""
    for binding in case.bindings:
        if binding.quantity not in quantity.COUNTER or dbc.carries_time(binding, case.bindings):
            continue
        _, value = decode(binding, case.raw)
        step = np.mod(np.diff(value), 2.0**binding.signal.length)
        bad = int((step != 1).sum())
        detail = f"steps by one, {len(value)} times" if not bad else f"{bad} steps of other than one"
        yield Check(f"counter {binding.message.name}.{binding.signal.name}", not bad and len(value) > 1, detail)


# ---- estimates -------------------------------------------------------------------------------------------------------


@dataclass
class Recomputed:
    """What the core makes of the same input, offline."""

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
    """Run the core over what the daemon took."""
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


def _check_recomputation(case: Case, mine: Recomputed) -> Iterator[Check]:
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


def _check_batch(case: Case, mine: Recomputed) -> Iterator[Check]:
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


def _check_truth(case: Case) -> Iterator[Check]:
    path = case.run / "truth.json"
    messages = case.published.messages["ESTIMATE"]
    if not path.exists() or not messages:
        return
    body, truth = estimate.of_message(messages[-1]), estimate.read_truth(path)
    worst, name = _sigmas(np.array(estimate.errors(body, truth)), np.array(body.std))
    detail = f"mass {body.value[0]:.3f} +- {body.std[0]:.3f} kg, true {truth.value[0]:.3f}; farthest is {name}"
    yield Check("truth", worst <= TRUTH_SIGMAS, f"{detail}, by {worst:.2f} sigma, allowed {TRUTH_SIGMAS:g}")


def _check_golden(case: Case) -> Iterator[Check]:
    path = case.run / "estimate.json"
    messages = case.published.messages["ESTIMATE"]
    if not path.exists() or not messages or case.published.is_live:
        return
    was, body = estimate.read(path), estimate.of_message(messages[-1])
    worst, name = _sigmas(np.array(body.value) - np.array(was.value), np.array(body.std))
    yield Check("the run's estimate.json", worst <= 1e-6, f"farthest is {name}, by {worst:.2g} sigma, allowed 1e-06")


# ---- time ------------------------------------------------------------------------------------------------------------


def _check_latency(case: Case, limit: float) -> Iterator[Check]:
    p = case.published
    if not p.is_live:
        yield Check(
            "speed", True, f"{len(case.raw) / max(p.seconds, 1e-9):.0f} frames/s with start and messages written"
        )
        return
    if not p.messages["RAW"]:
        return
    late = np.array(p.arrival_ns["RAW"]) - np.array([m.t_ns for m in p.messages["RAW"]])
    p50, p99, worst = np.percentile(late, [50, 99, 100]) / NS_PER_S
    detail = f"frame's stamp to message: {1e3 * p50:.2f} ms (p50), {1e3 * p99:.2f} ms (p99), {1e3 * worst:.2f} ms (max)"
    yield Check("latency", bool(p99 <= limit), f"{detail}, p99 allowed {1e3 * limit:g}")


# ---- all -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Options:
    """What `inertiactl verify` was asked to do."""

    run: Path
    buses: tuple[str, ...] = ()
    """none: from the run's files"""
    config: Path | None = None
    daemon: Path | None = None
    url: str = channels.DEFAULT_URL
    latency_max: float = LATENCY_MAX


def _setup(options: Options, robot: Robot, data: bytes, folder: Path) -> Setup:
    config = options.config
    if config is None:
        config = folder / "robot.cfg"
        config.write_bytes(data)
    with_tracker = robot.position.source == "tracker"
    if with_tracker and not (options.run / "tracker.csv").exists():
        raise InputError(f'{options.run / "tracker.csv"}: not there, but position.source = "tracker"')
    daemon = options.daemon or daemon_run.daemon_path()
    return Setup(options.run, folder, config, daemon, max(1, len(robot.bus)), with_tracker, options.url)


def judge(case: Case, latency_max: float) -> list[Check]:
    """All checks, in the order of the data's way."""
    mine = recompute(case)
    checks = [*_check_description(case), *_check_config(case), *_check_daemon(case)]
    checks += [*_check_frames(case), *_check_counters(case)]
    checks += [*_check_sample_counters(case), *_check_positions(case), *_check_rows(case)]
    checks += [*_check_recomputation(case, mine), *_check_batch(case, mine)]
    return [*checks, *_check_truth(case), *_check_golden(case), *_check_latency(case, latency_max)]


def verify(options: Options, progress: Callable[[str], None]) -> list[Check]:
    """Run the daemon on a run and check what it does. InputError: the run, bus or daemon cannot be used."""
    source = options.run / "robot.toml"
    robot = description.load(source)
    data = configuration.compile_robot(robot, str(source))
    log = canlog.read(options.run / "can.log")
    with tempfile.TemporaryDirectory(prefix="inertiad-") as name:
        setup = _setup(options, robot, data, Path(name))
        progress("run the daemon")
        is_live = bool(options.buses)
        said = daemon_run.live(setup, list(options.buses), len(log)) if is_live else daemon_run.from_file(setup)
        progress("check")
        given = setup.config.read_bytes()
        positions = daemon_run.positions_of(setup, said)
        bindings = dbc.bind(robot, str(source))
        raw = said.frames(setup.n_buses)
        case = Case(robot, data, given, log, raw, said, positions, bindings, options.run)
        return judge(case, options.latency_max)


def write(path: Path, options: Options, checks: list[Check]) -> None:
    """verify.json."""
    document = {
        "run": str(options.run),
        "bus": list(options.buses) or ["file"],
        "passed": all(c.passed is not False for c in checks),
        "checks": [asdict(c) for c in checks],
    }
    path.write_text(json.dumps(document, indent=1) + "\n")
