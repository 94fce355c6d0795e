# SPDX-License-Identifier: Apache-2.0
"""Recorded runs -> aligned rows, through the same C stages as the daemon.

A run is a folder with robot.toml, can.log and tracker.csv; a signals CSV (with pos_x,pos_y,pos_z, or tracker.csv or
the cables' lengths beside it) and a robot description; or an LCM log of the daemon, whose rows are taken as they were
published. What a CSV lacks, position, rates or specific force, is derived from the other columns; see cable_lengths.py
and derived_motion.py.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

import inertiad_core
from inertiad.base import quantity, table
from inertiad.base.counters import n_rejected
from inertiad.base.error import InputError
from inertiad.base.table import Array, Table
from inertiad.robot import configuration, description
from inertiad.robot.description import Robot
from inertiad.run import cable_lengths, derived_motion, lcmlog, signals_csv, tracker_csv
from inertiad.run.lcmlog import Event
from inertiad_lcm import health_t, signals_t

EARLIEST: Final = -1e8
LATEST: Final = 8_999_999_999.0
"""s, host time as the core takes it"""
SLOW_ROWS: Final = 1.5
"""intervals between rows that are no gap: under two, so that a lost row is one"""
AGE_MOST: Final = 0.25
"""s, as the batch solver's interpolation bridges"""


@dataclass(frozen=True)
class Recording:
    """A run, read."""

    path: Path
    robot: Robot
    rows: Any
    """inertiad_core.Rows"""
    n_frames: int
    n_rejected: int
    """rows lost or refused, all causes"""
    counters: dict[str, int]
    notes: tuple[str, ...] = ()
    """the derived quantities, and damage of the files, as text"""

    @property
    def duration(self) -> float:
        """s from the first to the last row."""
        t = self.rows.t
        return float(t[-1] - t[0]) if len(t) else 0.0


def config_of(robot: Robot, source: str) -> Any:
    """inertiad_core.Config of a robot description."""
    return inertiad_core.Config(configuration.compile_robot(robot, source))


def play(folder: Path, robot: Robot, source: str, tracker: Path | None) -> Any:
    """inertiad_core.Pipeline after a run folder's can.log and a tracker CSV, or none. InputError: one is unusable."""
    n_buses = max(1, len(robot.bus))
    interfaces = [""] if n_buses == 1 else [f"can{i}" for i in range(n_buses)]
    try:
        return inertiad_core.read_run(
            config_of(robot, source),
            [str(folder / "can.log")] * n_buses,
            interfaces,
            "" if tracker is None else str(tracker),
        )
    except ValueError as error:
        raise InputError(str(error)) from None


def robot_of(path: Path, robot_file: Path | None = None) -> Robot:
    """The description that belongs to a run: a folder's own before robot_file, robot_file before one beside a file."""
    own = path / "robot.toml" if path.is_dir() else path.with_name("robot.toml")
    found = own if own.exists() else None
    file = found or robot_file if path.is_dir() else robot_file or found
    if file is None:
        raise InputError(f"{own}: not found; pass --robot ROBOT")
    return description.load(file)


def _read_folder(folder: Path, robot: Robot) -> Recording:
    log, tracker = folder / "can.log", folder / "tracker.csv"
    if not log.exists():
        raise InputError(f"{log}: not found; pass a run folder with can.log, or a signals CSV")
    needs_tracker = robot.position.source == "tracker"
    if needs_tracker and not tracker.exists():
        raise InputError(f'{tracker}: not found, but position.source = "tracker"')
    pipeline = play(folder, robot, str(folder), tracker if needs_tracker else None)
    counters = {k: int(v) for k, v in pipeline.counters.items()}
    rows, n_frames = inertiad_core.rows_of(pipeline), counters["decode.frames"]
    return Recording(folder, robot, rows, n_frames, n_rejected(counters), counters)


def without_positions(folder: Path, robot: Robot) -> Recording:
    """A run folder's rows as if the platform stood still among its anchors: to inspect the other sensors.

    The rows may be none. InputError: no can.log.
    """
    middle = np.mean([cable.anchor for cable in robot.cable], axis=0).tolist()
    still = robot.position.model_copy(update={"source": "fixed", "fixed": middle})
    return _read_folder(folder, robot.model_copy(update={"position": still}))


def _published(log: Path, remarks: list[str]) -> tuple[list[signals_t], list[health_t]]:
    """SIGNALS and HEALTH of the daemon in an LCM log, whatever its channel prefix. InputError: of several daemons."""
    found: dict[str, list[Event]] = {}
    for event in lcmlog.read(log, remarks):
        if event.channel.endswith(("SIGNALS", "HEALTH")):
            found.setdefault(event.channel, []).append(event)
    prefixes = [channel.removesuffix("SIGNALS") for channel in found if channel.endswith("SIGNALS")]
    if len(prefixes) > 1:
        raise InputError(
            f"{log}: of several daemons, prefixes {', '.join(sorted(prefixes))}: allowed: of one, taken out by "
            f"inertiactl export {log} --prefix {min(prefixes)} --to csv -o signals.csv"
        )
    signals, health = ([event for p in prefixes for event in found.get(f"{p}{n}", [])] for n in ("SIGNALS", "HEALTH"))
    return [lcmlog.decode(signals_t, e, log) for e in signals], [lcmlog.decode(health_t, e, log) for e in health]


def _read_lcm(log: Path, robot: Robot) -> Recording:
    """A daemon's LCM log: its aligned rows, its counters."""
    remarks: list[str] = []
    signals, health = _published(log, remarks)
    published = [row for message in signals for row in message.row]
    if any(row.n_cables != robot.n_cables for row in published):
        raise InputError(
            f"{log}: {published[0].n_cables} cables: allowed: {robot.n_cables}, as in the robot description"
        )
    width = {"acc": 3, "gyro": 3, "q": 4, "position": 3, "f": robot.n_cables}
    acc, gyro, q, position, f = (
        np.array([getattr(row, name) for row in published]).reshape(-1, n) for name, n in width.items()
    )
    counters = {c.name: c.value for c in health[-1].counter} if health else {}
    t_ns = np.array([row.t_ns for row in published], dtype=np.int64)
    rows, n_frames = inertiad_core.Rows(t_ns, acc, gyro, q, position, f), counters.get("decode.frames", 0)
    damage = tuple(remark.removeprefix(f"{log}: ") for remark in remarks)
    return Recording(log, robot, rows, n_frames, n_rejected(counters), counters, damage)


def _positions(signals: Table, file: Path, robot: Robot) -> tuple[Table, tuple[str, ...]]:
    """Tracked positions over time, and a note on them where they are derived.

    From the signals' own columns, the fixed position, tracker.csv beside the signals, or the cables' lengths.
    """
    if all(name in signals.columns for name in quantity.POSITION):
        xyz = dict(zip(("x", "y", "z"), signals.stack(*quantity.POSITION).T, strict=True))
        return Table(signals.t, xyz, signals.name), ()
    if robot.position.source == "fixed" and robot.position.fixed is not None:
        return Table(
            signals.t, {a: np.full(len(signals.t), v) for a, v in zip("xyz", robot.position.fixed, strict=True)}, ""
        ), ()
    beside = file.with_name("tracker.csv")
    if beside.exists():
        return tracker_csv.read(beside), ()
    lengths = cable_lengths.find(signals, file, robot)
    if lengths is None:
        raise InputError(
            f"{file}: line 1: no column pos_x, no tracker.csv beside it, and no length_1 .. length_{robot.n_cables}"
        )
    found = cable_lengths.positions(robot, str(file), signals, lengths)
    return found.positions, (found.note,)


def _with_trackers_attitude(signals: Table, file: Path, robot: Robot) -> tuple[Table, tuple[str, ...]]:
    """Signals without an attitude of their own with that of the poses in tracker.csv beside them, and a note on it.

    Samples outside the tracker's time, or in a gap of more than max_age_position, are left out.
    """
    beside = file.with_name("tracker.csv")
    if quantity.QUATERNION[0] in signals.columns or not beside.exists():
        return signals, ()
    tracker = tracker_csv.read(beside)
    if not tracker_csv.has_attitude(tracker):
        return signals, ()
    q, chosen = derived_motion.attitude_from_poses(robot, tracker, signals.t)
    if not chosen.any():
        raise InputError(f"{beside}: no pose within {robot.align.max_age_position:g} s of any sample of {file}")
    kept = {name: values[chosen] for name, values in signals.columns.items()}
    kept |= dict(zip(quantity.QUATERNION, q.T, strict=True))
    return Table(signals.t[chosen], kept, signals.name), ("attitude of the tracker's poses",)


def _bridging_jitter(robot: Robot, t: Array) -> Robot:
    """The robot with ages of at least SLOW_ROWS median intervals of its rows, t [s].

    At ages of one interval every row that jitter makes late would be a gap, and its windows would be lost.
    """
    if len(t) < 2:
        return robot
    least = min(SLOW_ROWS * float(np.median(np.diff(t))), AGE_MOST)
    ages = {name: max(getattr(robot.align, name), least) for name in ("max_age_imu", "max_age_force")}
    return robot.model_copy(update={"align": robot.align.model_copy(update=ages)})


def _read_signals(file: Path, robot: Robot) -> Recording:
    signals = signals_csv.with_attitude(table.read(file, signals_csv.columns(robot)))
    robot = _bridging_jitter(robot, signals.t)
    signals, borrowed = _with_trackers_attitude(signals, file, robot)
    for name in (quantity.QUATERNION[0], *quantity.forces(robot.n_cables)):
        if name not in signals.columns:
            wanted = "roll,pitch,yaw or q_w,q_x,q_y,q_z" if name == quantity.QUATERNION[0] else name
            raise InputError(f"{file}: line 1: no column {wanted}")
    positions, located = _positions(signals, file, robot)
    whole = derived_motion.completed(robot, signals, positions)
    rows = aligned(whole, str(file))
    return Recording(file, whole.robot, rows, 0, len(whole.signals.t) - len(rows), {}, borrowed + located + whole.notes)


def _nanoseconds(t: Array, source: str) -> Any:
    """Times [s] in ns. InputError: out of the range whose differences fit."""
    far = t[(t < EARLIEST) | (t > LATEST)]
    if len(far):
        raise InputError(f"{source}: t = {far[0]:g} s: allowed: {EARLIEST:g} to {LATEST:g}")
    return np.rint(1e9 * t).astype(np.int64)


def aligned(whole: derived_motion.Completed, source: str) -> Any:
    """inertiad_core.Rows of signals and positions, lined up as the daemon does; source names the robot in errors."""
    imu = whole.signals.stack(*quantity.ACC, *quantity.GYRO, *quantity.QUATERNION)
    f = whole.signals.stack(*quantity.forces(whole.robot.n_cables))
    xyz = whole.positions.stack("x", "y", "z")
    config = config_of(whole.robot, source)
    t_imu, t_xyz = _nanoseconds(whole.signals.t, source), _nanoseconds(whole.positions.t, source)
    contiguous = [np.ascontiguousarray(a) for a in (imu, f, xyz)]
    derived = {"derives_force": whole.derives_force, "derives_rate": whole.derives_rate}
    return inertiad_core.align_signals(config, t_imu, contiguous[0], contiguous[1], t_xyz, contiguous[2], **derived)


def read(path: Path, robot_file: Path | None = None) -> Recording:
    """read_as() the robot that belongs to the run."""
    return read_as(path, robot_of(path, robot_file))


def read_as(path: Path, robot: Robot) -> Recording:
    """A run folder, a signals CSV or an LCM log. InputError: a file is missing or unusable, or nothing in it lines up.

    A folder without can.log is read from the run.lcmlog in it, or else from its signals.csv.
    """
    others = () if not path.is_dir() or (path / "can.log").exists() else (path / "run.lcmlog", path / "signals.csv")
    file = next((other for other in others if other.exists()), path)
    if file.is_dir():
        run = _read_folder(file, robot)
    else:
        run = _read_lcm(file, robot) if file.suffix == ".lcmlog" and file.exists() else _read_signals(file, robot)
    if len(run.rows) == 0:
        lost = ", ".join(
            f"{k} {v}" for k, v in run.counters.items() if v and k.split(".")[0] in ("decode", "group", "align")
        )
        hint = "; positions are out of the cables' reach: is the tracker in mm?" if _is_out_of_reach(run) else ""
        raise InputError(
            f"{path}: no sample is whole: forces, attitude and position at one time ({lost or 'no overlap'}){hint}"
        )
    return run


def _is_out_of_reach(run: Recording) -> bool:
    """Most positions were refused because the cables do not reach there."""
    refused = run.counters.get("align.position.unreachable", 0)
    return refused > run.counters.get("align.position.samples", 0)


def part(recording: Recording, begin: float, end: float) -> Recording:
    """The rows of a run from begin to end, s since its first row."""
    rows = recording.rows
    t = rows.t - rows.t[0]
    inside = (t >= begin) & (t <= end)
    values = (rows.acc, rows.gyro, rows.q, rows.position, rows.f)
    acc, gyro, q, position, f = (np.ascontiguousarray(x[inside]) for x in values)
    t_ns = _nanoseconds(rows.t[inside], str(recording.path))
    kept = inertiad_core.Rows(t_ns, acc, gyro, q, position, f, rows.derives_force, rows.derives_rate)
    return replace(recording, rows=kept)


def read_all(paths: list[Path], robot_file: Path | None = None) -> list[Recording]:
    """Runs of one robot. InputError: see read(), or the number of cables differs."""
    found = [read(path, robot_file) for path in paths]
    for run in found:
        if run.robot.n_cables != found[0].robot.n_cables:
            raise InputError(
                f"{run.path}: {run.robot.n_cables} cables: allowed: {found[0].robot.n_cables}, as in {found[0].path}"
            )
    return found
