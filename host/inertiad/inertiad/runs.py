# SPDX-License-Identifier: Apache-2.0
"""Recorded runs -> aligned rows, through the same C stages as the daemon.

A run is a folder with robot.toml, can.log and tracker.csv, or a signals CSV (with pos_x,pos_y,pos_z, or tracker.csv
beside it) and a robot description. What a CSV lacks, rates or specific force, is derived from the other columns; see
sources.py.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import inertiad_core
from inertiad import compile, encode, quantity, sources, table
from inertiad import robot as description
from inertiad.error import InputError
from inertiad.robot import Robot
from inertiad.table import Array, Table

LOST = ("align.force.missing", "align.force.late", "align.position.missing", "align.position.late", "align.overrun")


@dataclass(frozen=True)
class Recording:
    """A run, read."""

    path: Path
    robot: Robot
    rows: Any
    """inertiad_core.Rows"""
    n_frames: int
    n_rejected: int
    counters: dict[str, int]
    notes: tuple[str, ...] = ()
    """what was derived, in words"""

    @property
    def duration(self) -> float:
        """s from the first to the last row."""
        t = self.rows.t
        return float(t[-1] - t[0]) if len(t) else 0.0


def config_of(robot: Robot, source: str) -> Any:
    """inertiad_core.Config of a robot description."""
    return inertiad_core.Config(compile.compile_robot(robot, source))


def _read_folder(folder: Path, robot_file: Path | None) -> Recording:
    own = folder / "robot.toml"
    file = own if own.exists() else robot_file
    if file is None:
        raise InputError(f"{own}: not there: allowed: with --robot ROBOT")
    robot = description.load(file)
    log, tracker = folder / "can.log", folder / "tracker.csv"
    if not log.exists():
        raise InputError(f"{log}: not there: allowed: a run folder with can.log, or a signals CSV")
    needs_tracker = robot.position.source == "tracker"
    if needs_tracker and not tracker.exists():
        raise InputError(f'{tracker}: not there, but position.source = "tracker"')
    n_buses = max(1, len(robot.bus))
    interfaces = [""] if n_buses == 1 else [f"can{i}" for i in range(n_buses)]
    try:
        pipeline = inertiad_core.read_run(
            config_of(robot, str(file)), [str(log)] * n_buses, interfaces, str(tracker) if needs_tracker else ""
        )
    except ValueError as error:
        raise InputError(str(error)) from None
    counters = {k: int(v) for k, v in pipeline.counters.items()}
    rejected = sum(counters[name] for name in (*LOST, "wrench.bad_geometry"))
    return Recording(folder, robot, inertiad_core.rows_of(pipeline), counters["decode.frames"], rejected, counters)


def _positions(signals: Table, file: Path, robot: Robot) -> Table:
    """Tracked positions over time, from the signals' own columns, tracker.csv beside them, or the fixed position."""
    if all(name in signals.columns for name in quantity.POSITION):
        xyz = dict(zip(("x", "y", "z"), signals.stack(*quantity.POSITION).T, strict=True))
        return Table(signals.t, xyz, signals.source)
    if robot.position.source == "fixed" and robot.position.fixed is not None:
        return Table(
            signals.t, {a: np.full(len(signals.t), v) for a, v in zip("xyz", robot.position.fixed, strict=True)}, ""
        )
    beside = file.with_name("tracker.csv")
    if not beside.exists():
        raise InputError(f"{file}: line 1: no column pos_x, and no tracker.csv beside it")
    return table.read(beside, ["t", "x", "y", "z"])


def _read_signals(file: Path, robot_file: Path | None) -> Recording:
    beside = file.with_name("robot.toml")
    if robot_file is None and not beside.exists():
        raise InputError(f"{file}: allowed: with --robot ROBOT, or robot.toml beside it")
    robot = description.load(robot_file or beside)
    signals = encode._with_attitude(table.read(file, encode.signal_columns(robot)))
    for name in (quantity.QUATERNION[0], *quantity.forces(robot.n_cables)):
        if name not in signals.columns:
            wanted = "roll,pitch,yaw or q_w,q_x,q_y,q_z" if name == quantity.QUATERNION[0] else name
            raise InputError(f"{file}: line 1: no column {wanted}")
    positions = _positions(signals, file, robot)
    robot, signals, positions, notes = sources.completed(robot, signals, positions)
    rows = _aligned(robot, signals, positions, str(file))
    return Recording(file, robot, rows, 0, len(signals.t) - len(rows), {}, notes)


def _nanoseconds(t: Array) -> Any:
    return np.rint(1e9 * t).astype(np.int64)


def _aligned(robot: Robot, signals: Table, positions: Table, source: str) -> Any:
    imu = signals.stack(*quantity.ACC, *quantity.GYRO, *quantity.QUATERNION)
    f = signals.stack(*quantity.forces(robot.n_cables))
    xyz = positions.stack("x", "y", "z")
    config = config_of(robot, source)
    t_imu, t_xyz = _nanoseconds(signals.t), _nanoseconds(positions.t)
    contiguous = [np.ascontiguousarray(a) for a in (imu, f, xyz)]
    return inertiad_core.align_signals(config, t_imu, contiguous[0], contiguous[1], t_xyz, contiguous[2])


def read(path: Path, robot_file: Path | None = None) -> Recording:
    """A run folder or a signals CSV. InputError: a file is missing or unusable, or nothing in it lines up."""
    run = _read_folder(path, robot_file) if path.is_dir() else _read_signals(path, robot_file)
    if len(run.rows) == 0:
        lost = ", ".join(
            f"{k} {v}" for k, v in run.counters.items() if v and k.split(".")[0] in ("decode", "group", "align")
        )
        raise InputError(
            f"{path}: no sample is whole: forces, attitude and position at one time ({lost or 'no overlap'})"
        )
    return run


def read_all(paths: list[Path], robot_file: Path | None = None) -> list[Recording]:
    """Runs of one robot. InputError: see read(), or the number of cables differs."""
    found = [read(path, robot_file) for path in paths]
    for run in found:
        if run.robot.n_cables != found[0].robot.n_cables:
            raise InputError(
                f"{run.path}: {run.robot.n_cables} cables: allowed: {found[0].robot.n_cables}, as in {found[0].path}"
            )
    return found
