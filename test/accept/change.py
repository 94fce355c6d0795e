# SPDX-License-Identifier: Apache-2.0
"""T12: a load picked up in half a second, as the pipeline sees it frame by frame."""

from dataclasses import dataclass

import numpy as np
import pictures
import scenes
from scenes import COGIRO
from verdict import FIRST, Verdict

import inertiad_core
from inertiad.base.table import Table
from inertiad.model import trajectory
from inertiad.model.random_errors import Dice
from inertiad.robot import dbc, description
from inertiad.robot.description import Robot
from inertiad.run import encode, reader
from inertiad.simulate import sensor_models, simulator

RATE, DURATION, START, RAMP = 100.0, 40.0, 30.0, 0.5  # Hz, s
LIMITS = ((300.0, 0.5), (10.0, 0.6))  # kg, s


@dataclass(frozen=True)
class PickUp:
    """What the pipeline said; times in s from the start of the ramp."""

    mass: float
    delay: float
    """to the alarm, latency of the rows included; inf: none"""
    n_early: int
    """alarms before it"""
    history: np.ndarray
    """time, mass, its std, alarms so far [N, 4]"""


def _measured(robot: Robot, mass: float, seed: int) -> tuple[Table, Table]:
    """Signals and tracker while the load comes on."""
    level, motion = sensor_models.PRESETS["modern"], trajectory.paper()
    t = np.arange(int(DURATION * RATE)) / RATE
    tables = []
    for added in (0.0, mass):
        dice = Dice(seed)
        drawn = sensor_models.draw(level, robot.n_cables, dice)
        true = simulator.with_true_geometry(robot, drawn)
        body = scenes.loaded(robot, added) if added else robot.nominal
        assert body is not None
        mechanics = simulator.Mechanics(reader.config_of(true, ""), true, body)
        tables.append(simulator.measure_signals(robot, mechanics, motion, t, level, drawn, RATE, dice))
    share = np.clip((t - START) / RAMP, 0.0, 1.0)
    empty, full = tables
    columns = {
        k: (1.0 - share) * v + share * full.columns[k] if k.startswith("f_") else v for k, v in empty.columns.items()
    }
    return Table(empty.t, columns, "pick-up"), simulator.measure_tracker(robot, motion, level, Dice(seed))


def pick_up(mass: float, seed: int) -> PickUp:
    """A platform that picks up a box of mass [kg] after 30 s, one pipeline step after the other."""
    bus = [b.model_copy(update={"bitrate": 0.0}) for b in description.load(COGIRO).bus]
    robot = description.load(COGIRO).model_copy(update={"bus": bus})
    signals, tracker = _measured(robot, mass, seed)
    folder = scenes.RUNS / f"pickup_{mass:g}_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "can.log"
    encode.write_can_log(
        log, signals.t, encode.pack(dbc.bind(robot, str(COGIRO)), signals, signals.t - simulator.START)
    )
    pipeline = inertiad_core.Pipeline(reader.config_of(robot, ""))
    k, xyz, history = 0, tracker.stack("x", "y", "z"), []
    for line in log.open():
        stamp, _, frame = line.split()[:3]
        t = float(stamp[1:-1])
        while k < len(tracker.t) and tracker.t[k] <= t:
            pipeline.push_position(round(tracker.t[k] * 1e9), xyz[k])
            k += 1
        can_id, data = frame.split("#", 1)
        pipeline.push_frame(round(t * 1e6) * 1000, 0, int(can_id, 16), bytes.fromhex(data), 0)
        while (status := pipeline.step()) != 1:
            if status == 0:
                e = pipeline.estimate
                history.append((t - simulator.START - START, e["mass"], e["mass_std"], e["n_changes"]))
    h = np.array(history)
    before = h[h[:, 0] < 0.0]
    alarms = h[(h[:, 0] >= 0.0) & (h[:, 3] > before[-1, 3]), 0]
    return PickUp(mass, float(alarms[0]) if len(alarms) else np.inf, int(before[-1, 3]), h)


def t12(n: int = 8) -> list[Verdict]:
    """How soon a load is noticed."""
    found = []
    for mass, limit in LIMITS:
        seen = [pick_up(mass, FIRST + i) for i in range(n)]
        if mass == LIMITS[0][0]:
            pictures.pick_up(seen[0].history, seen[0].delay, mass)
        delays, early = [p.delay for p in seen], sum(p.n_early for p in seen)
        text = f"{np.median(delays):.2f} s, worst {max(delays):.2f} s; {early} before"
        good = float(np.median(delays)) <= limit and early == 0
        what, said = f"alarm after {mass:g} kg in {RAMP} s, with latency", f"median <= {limit} s, none before"
        found.append(Verdict("T12", what, n, "runs", said, text, good))
    return found
