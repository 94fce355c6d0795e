# SPDX-License-Identifier: Apache-2.0
"""Time alignment of a run's sources: delays with standard deviations, trigger edges, the host's clock, cost of errors.

The tracker's delay against the IMU comes from the motion of both alone (time_delay.py); the forces' delay from the
wrench balance with the tracker's delay corrected (batch.hpp). sync.json holds both and, under "calibration", the keys
that robot.toml reads with [calibration] sync = "sync.json".
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.identify import findings, fit, time_delay
from inertiad.identify.time_delay import Delay
from inertiad.robot import configuration, dbc, description, systematic
from inertiad.robot.description import Robot
from inertiad.robot.keys import Position
from inertiad.run import canlog, encode, host_info, reader, tracker_csv
from inertiad.run.canlog import CanLog

MARGIN: Final = 0.3
"""s, the largest delay that is looked for, either way"""
FORCE_DELAY_STD: Final = 0.02
"""s, prior: nothing is known of it"""
LEVER_STD_MIN: Final = 1e-4
VAGUE: Final = 2e-3
"""s, sigma above which the delay is reported as poorly observable"""
N_POSITION: Final = 41
N_FORCE: Final = 7
SHOWN_SIGMAS: Final = 5.0
SHOWN_BEYOND: Final = 1.3
"""of the distance from the delay found to the one configured"""
SHOWN_LEAST: Final = 2e-3
"""s"""
SYNC_ID: Final = 0x80
"""CANopen's SYNC"""


@dataclass(frozen=True)
class Edges:
    """Rising edges of a digital signal, or sync frames, in host time."""

    name: str
    t: list[float] = field(default_factory=list)
    """s"""

    def __str__(self) -> str:
        if not self.t:
            return f"{self.name}: no rising edge"
        text = f"{self.name}: {len(self.t)} rising edges, the first at {self.t[0]:.6f} s"
        if len(self.t) > 2:
            step = np.diff(self.t)
            late = np.percentile(np.abs(step - np.median(step)), 99)
            text += f", every {np.median(step):.6g} s, p99 of the spacing's error {1e6 * late:.0f} us"
        return text


@dataclass(frozen=True)
class Cost:
    """By how much the identified body moves for a misalignment."""

    what: str
    mass: float
    """kg"""
    cog: float
    """m, length of the change"""
    inertia: float
    """kg m2, largest element of the change"""

    def __str__(self) -> str:
        return f"{self.what}: mass {self.mass:+.3f} kg, CoG {1e3 * self.cog:.2f} mm, J {self.inertia:.2f} kg m2"


@dataclass(frozen=True)
class Sync:
    """Result of sync()."""

    run: Path
    robot: Robot
    position: Delay
    """total, from the measured instant to the tracker's stamp"""
    force: tuple[float, float]
    """s total, one sigma"""
    edges: list[Edges]
    is_clock_good: bool
    clock: str
    costs: list[Cost]
    solution: time_delay.Solution
    """of the tracker's delay"""


@dataclass(frozen=True)
class Curves:
    """What the delays explain: residuals against each delay, and over time."""

    position_delay: Array
    """s [K]"""
    position_rms: Array
    """m, each axis, of the tracker's positions [K]"""
    force_delay: Array
    """s [L]"""
    force_rms: Array
    """N, of the wrench's force [L]"""
    t: Array
    """s since the first IMU sample [N]"""
    before: Array
    """m [N, 3]: residual of the positions with the delay that robot.toml has"""
    after: Array
    """m [N, 3]: with the delay found"""


# ---- delays ----------------------------------------------------------------------------------------------------------


def _imu(robot: Robot, run: Path) -> tuple[time_delay.Imu, float]:
    """IMU samples as the daemon aligns them, no position needed, from 0 s on; and the host time of the first."""
    fixed = robot.model_copy(update={"position": Position(source="fixed", fixed=[0.0, 0.0, 0.0])})
    rows = reader.read_as(run, fixed).rows
    if rows.derives_force or rows.derives_rate:
        raise InputError(f"{run}: no accelerometer or no gyro in it; the tracker's delay is measured against both")
    if len(rows) < 2:
        raise InputError(f"{run}: only one IMU sample with forces beside it; use a run that moves")
    t0 = float(rows.t[0])
    acc = rows.acc - np.array(robot.calibration.acc_bias)
    gyro = rows.gyro - np.array(robot.calibration.gyro_bias)
    return time_delay.Imu(rows.t - t0, acc, gyro, rows.q), t0


def _tracker_delay(robot: Robot, run: Path) -> time_delay.Solution:
    imu, t0 = _imu(robot, run)
    tracker = tracker_csv.read(run / "tracker.csv")
    to_imu = Rotation.from_quat(robot.imu.orientation, scalar_first=True).inv()
    lever = to_imu.apply(np.array(robot.tracker.target) - np.array(robot.imu.position))
    std = robot.calibration.std.model_dump(exclude_none=True)
    spread = configuration.std(robot) | std
    prior = time_delay.Prior(
        robot.gravity, lever, spread["acc_bias"], spread["gyro_bias"], max(spread["imu_position"], LEVER_STD_MIN)
    )
    found = time_delay.solve(imu, tracker.t - t0, tracker.stack("x", "y", "z"), prior, MARGIN)
    if found is None:
        raise InputError(f"{run}: IMU and tracker never overlap for {time_delay.SHORTEST:g} s; use a run that moves")
    return found


def delays(robot: Robot, run: Path) -> tuple[Delay, tuple[float, float]]:
    """The tracker's delay, and the forces' with its sigma [s]. InputError: the run does not observe them."""
    position = _tracker_delay(robot, run).delay
    return position, _force_delay(robot, run, position)


def calibration(robot: Robot, position: Delay, force: tuple[float, float]) -> dict[str, Any]:
    """The keys of [calibration] that the delays belong to."""
    configured, calibrated = configuration.delays(robot), robot.calibration
    return {
        "position_delay": position.value - configured["position"] + calibrated.position_delay,
        "force_delay": force[0] - configured["force"] + calibrated.force_delay,
        "std": {"position_delay": position.std, "force_delay": force[1]},
    }


def _with_delays(robot: Robot, position: Delay, force: tuple[float, float]) -> Robot:
    keys = calibration(robot, position, force)
    std = robot.calibration.std.model_copy(update=keys.pop("std"))
    return robot.model_copy(update={"calibration": robot.calibration.model_copy(update={**keys, "std": std})})


def _force_delay(robot: Robot, run: Path, position: Delay) -> tuple[float, float]:
    """Total delay of the forces and its sigma, s, by the joint fit."""
    configured = configuration.delays(robot)["force"]
    known = _with_delays(robot, position, (configured, FORCE_DELAY_STD))
    result = fit.joint(reader.config_of(known, str(run)), [reader.read_as(run, known)])
    assert result.xi is not None and result.xi_std is not None
    at = systematic.group("force_delay", robot.n_cables).first
    return configured + float(result.xi[at]), float(result.xi_std[at])


# ---- cost ------------------------------------------------------------------------------------------------------------


def _fit(config: Any, run: reader.Recording, shift: tuple[float, float]) -> dict[str, Any]:
    """The batch solver's result with delays taken as they are, shift [s] wrong: positions, forces."""
    kinds = systematic.groups(run.robot.n_cables)
    free = np.concatenate([np.full(g.n, g.name not in ("position_delay", "force_delay")) for g in kinds])
    moved = reader.Recording(run.path, run.robot, inertiad_core.undelayed(run.rows, *shift), 0, 0, {})
    return fit.batch(config, [moved], is_free=free.tolist())


def _body(config: Any, run: reader.Recording, shift: tuple[float, float]) -> Array:
    """Ten numbers of the body."""
    return np.array(fit.of_batch("joint", _fit(config, run, shift)).body.value)


def _costs(robot: Robot, run: Path, position: Delay, force: tuple[float, float]) -> Iterator[Cost]:
    aligned = _with_delays(robot, position, force)
    config, recording = reader.config_of(aligned, str(run)), reader.read_as(run, aligned)
    best = _body(config, recording, (0.0, 0.0))
    configured = configuration.delays(robot)
    was, was_force = configured["position"] - position.value, configured["force"] - force[0]
    for what, shift in (
        (f"as configured, tracker {1e3 * was:+.2f} ms and forces {1e3 * was_force:+.2f} ms off", (was, was_force)),
        (f"one sigma of the tracker's delay, {1e3 * position.std:.2f} ms", (position.std, 0.0)),
        (f"one sigma of the forces' delay, {1e3 * force[1]:.2f} ms", (0.0, force[1])),
    ):
        change = _body(config, recording, shift) - best
        yield Cost(what, float(change[0]), float(np.linalg.norm(change[1:4])), float(np.abs(change[4:]).max()))


def _around(found: float, std: float, configured: float, n: int) -> Array:
    """n delays, s, that show the one found, its sigmas and the one configured."""
    reach = max(SHOWN_SIGMAS * std, SHOWN_BEYOND * abs(configured - found), SHOWN_LEAST)
    return np.linspace(found - reach, found + reach, n)


def curves(found: Sync, progress: Callable[[str], None]) -> Curves:
    """Residuals against the delays. Cost: N_FORCE fits."""
    configured, (force, force_std) = configuration.delays(found.robot), found.force
    progress("residual against the tracker's delay")
    delay = _around(found.position.value, found.position.std, configured["position"], N_POSITION)
    aligned = _with_delays(found.robot, found.position, found.force)
    config, recording = reader.config_of(aligned, str(found.run)), reader.read_as(found.run, aligned)
    force_delay, rms = _around(force, force_std, configured["force"], N_FORCE), []
    for number, other in enumerate(force_delay):
        progress(f"residual against the forces' delay, {number + 1} of {N_FORCE}")
        rms.append(findings.residual(_fit(config, recording, (0.0, float(other - force))))[0])
    parts = found.solution.stretches
    return Curves(
        delay,
        found.solution.rms(delay),
        force_delay,
        np.array(rms),
        np.concatenate([part.t for part in parts]),
        np.concatenate([part.residual(configured["position"]) for part in parts]),
        np.concatenate([part.residual(float(part.theta[0])) for part in parts]),
    )


# ---- triggers --------------------------------------------------------------------------------------------------------


def _rising(t_ns: Array, level: Array) -> list[float]:
    return (1e-9 * t_ns[1:][(level[1:] != 0) & (level[:-1] == 0)]).tolist()


def edges(robot: Robot, log: CanLog) -> list[Edges]:
    """Rising edges of every one-bit signal of the DBC files that is in the log, and CANopen SYNC frames."""
    found = []
    is_sync = (log.can_id == SYNC_ID) & (log.length <= 1)
    for number, name in enumerate(log.names):
        there = is_sync & (log.bus == number)
        if there.any():
            found.append(Edges(f"{name}: SYNC frames {SYNC_ID:03X}", (1e-9 * log.t_ns[there]).tolist()))
    for number, bus in enumerate(robot.bus):
        for message, _ in dbc.load(bus.files).messages:
            can_id = message.frame_id | (dbc.EXTENDED_ID if message.is_extended_frame else 0)
            there = (log.can_id == can_id) & (log.length == message.length)
            if len(robot.bus) > 1:
                there &= log.bus == number
            for signal in message.signals:
                if signal.length == 1 and not signal.is_multiplexer and there.any():
                    byte, bit = encode.bit_positions(signal)[0]
                    level = (log.data[there, byte] >> bit) & 1
                    found.append(Edges(f"{message.name}.{signal.name}", _rising(log.t_ns[there], level)))
    return found


# ---- all -------------------------------------------------------------------------------------------------------------


def sync(run: Path, progress: Callable[[str], None]) -> Sync:
    """Look at a run folder with robot.toml, can.log or signals.csv, and tracker.csv. InputError: something is missing
    or unusable."""
    robot = description.load(run / "robot.toml")
    needed = ("can.log" if not (run / "signals.csv").exists() else "signals.csv", "tracker.csv")
    for name in needed:
        if not (run / name).exists():
            raise InputError(
                f"{run / name}: not found; pass a run folder with robot.toml, can.log or signals.csv, and tracker.csv"
            )
    progress("estimate the delays")
    solution = _tracker_delay(robot, run)
    position = solution.delay
    force = _force_delay(robot, run, position)
    progress("compute the cost of wrong delays")
    costs = list(_costs(robot, run, position, force))
    triggers = edges(robot, canlog.read(run / "can.log")) if (run / "can.log").exists() else []
    return Sync(run, robot, position, force, triggers, *host_info.clock_in_words(run), costs, solution)


def text(found: Sync) -> Iterator[str]:
    """For people, a line each."""
    p, (value, std) = found.position, found.force
    yield f"tracker delay  {1e3 * p.value:8.3f} ± {1e3 * p.std:.3f} ms  against the IMU, one sigma"
    yield f"force delay    {1e3 * value:8.3f} ± {1e3 * std:.3f} ms"
    yield f"from {p.n_samples} positions in {p.n_stretches} stretches; tracker noise {1e3 * p.tracker_noise:.2f} mm"
    if p.std > VAGUE:
        yield "the delay is poorly observable from this motion; use a run with accelerations of at least 1 m/s2"
    yield from (f"trigger: {e}" for e in found.edges)
    if not found.edges:
        yield "trigger: neither a SYNC frame nor a one-bit signal in the log"
    yield f"clock: {found.clock}"
    if not found.is_clock_good:
        yield "clock: where CAN and tracker were stamped by different hosts, the delay holds for this run only"
    yield from (f"cost: {c}" for c in found.costs)


def write(path: Path, found: Sync) -> None:
    """sync.json."""
    position = asdict(found.position)
    document = {
        "run": str(found.run),
        "position_delay": {"value": position.pop("value"), "std": position.pop("std")} | position,
        "force_delay": {"value": found.force[0], "std": found.force[1]},
        "edges": [asdict(e) for e in found.edges],
        "clock": {"synchronised": found.is_clock_good, "text": found.clock},
        "cost": [asdict(c) for c in found.costs],
        "calibration": calibration(found.robot, found.position, found.force),
    }
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
