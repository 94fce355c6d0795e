# SPDX-License-Identifier: Apache-2.0
"""A daemon's messages -> items of a Feed, at the rates that a person sees: robot, motion, estimate, residuals, health.

Times of items are s since the first stamp. Everything kept is bounded; bytes that are no message are counted.
"""

import threading
from collections import deque
from typing import Any, Final

import numpy as np

from inertiad.base.body import NAMES, UNITS, of_message
from inertiad.base.finding import verdict
from inertiad.live import findings
from inertiad.live.drawn_robot import DrawnRobot, ellipsoid, numbers
from inertiad.live.feed import Feed
from inertiad.live.findings import State
from inertiad.live.incoming import Decoder, clock, finite, plain
from inertiad.live.load import BusLoad, health_item
from inertiad.model.tension_color import RAMP
from inertiad.robot.description import Robot
from inertiad_lcm import estimate_t, event_t, health_t, robot_config_t, signals_t, tracker_t

SPAN: Final = 60.0
"""s of data that a listener gets who comes late"""
POSE_PERIOD: Final = 0.045
"""s between poses; ticks come at 20 Hz"""
ROW_PERIOD: Final = 0.1
ESTIMATE_PERIOD: Final = 0.2
RESIDUAL_PERIOD: Final = 0.5
STATE_PERIOD: Final = 1.0
KEPT: Final = {
    "start": 1,
    "robot": 1,
    "pose": 1,
    "row": int(SPAN / ROW_PERIOD),
    "estimate": int(SPAN / ESTIMATE_PERIOD),
    "residual": int(SPAN / RESIDUAL_PERIOD),
    "health": 1,
    "event": 50,
    "state": 1,
}
CHANNELS: Final = ("SIGNALS", "ESTIMATE", "HEALTH", "EVENT", "CONFIG", "TRACKER", "RAW")
BACKWARDS: Final = 1.0
"""s by which stamps fall back when another run has begun"""
ROWS_KEPT: Final = 4000
"""full-rate rows kept for the residual"""
CABLES_MAX: Final = robot_config_t.CABLES_MAX


class _Due:
    """True once per period."""

    def __init__(self, period: float) -> None:
        self._period, self._next = period, -np.inf

    def __call__(self, now: float) -> bool:
        if now < self._next:
            return False
        self._next = max(self._next + self._period, now)
        return True


class Picture:
    """take() messages from one thread, tick() from another."""

    def __init__(self, feed: Feed, robot: Robot | None, source: str) -> None:
        """robot: the description, where there is a file; else CONFIG shows it. source: of it, for people."""
        self._feed, self._lock, self._decoder = feed, threading.Lock(), Decoder()
        self._described = robot
        self._robot = DrawnRobot.of_description(robot, source) if robot is not None else None
        self._config_bytes = b""
        self._due = {k: _Due(p) for k, p in (("pose", POSE_PERIOD), ("row", ROW_PERIOD), ("state", STATE_PERIOD))}
        self._due |= {"estimate": _Due(ESTIMATE_PERIOD), "residual": _Due(RESIDUAL_PERIOD)}
        self._heard: float | None = None
        self.note = ""
        """state of the source, such as the end of a recording"""
        self._start()

    def _start(self) -> None:
        """A picture of nothing but the robot."""
        self._zero_ns: int | None = None
        self._newest_ns = 0
        self._rows: deque[Any] = deque(maxlen=ROWS_KEPT)
        self._low: list[float] = []
        self._high: list[float] = []
        self._new_row: Any = None
        self._new_estimate: bytes | None = None
        self._estimate: estimate_t | None = None
        self._health: deque[health_t] = deque(maxlen=10)
        self._gap, self._tracker_ns = 0.0, 0
        self._load = BusLoad()
        self._feed.clear(*KEPT)
        self._feed.put("start", names=NAMES, units=UNITS, span=SPAN, ramp=RAMP)
        if self._robot is not None:
            self._feed.put("robot", **self._robot.item())

    # ---- messages ----------------------------------------------------------------------------------------------------

    def take(self, channel: str, data: bytes, now: float) -> None:
        """One message; channel without prefix, now in s of any steady clock. Never raises for what is in data."""
        with self._lock:
            self._heard = now
            match channel:
                case "SIGNALS":
                    self._take_signals(data)
                case "ESTIMATE":
                    self._new_estimate = data
                case "TRACKER":
                    self._take_tracker(data)
                case "RAW":
                    self._load.newest = data
                case "HEALTH":
                    self._take_health(data)
                case "EVENT":
                    self._take_event(data)
                case "CONFIG":
                    self._take_config(data)

    def _seconds(self, t_ns: int) -> float:
        """s since the first stamp."""
        if self._zero_ns is None:
            self._zero_ns = t_ns
        return round(1e-9 * (t_ns - self._zero_ns), 4)

    def _is_another_run(self, t_ns: int) -> bool:
        return self._zero_ns is not None and t_ns < self._newest_ns - 1e9 * BACKWARDS

    def _take_signals(self, data: bytes) -> None:
        message = self._decoder.decode(signals_t, data)
        if message is None or not message.row:
            return
        if self._is_another_run(message.row[0].t_ns):
            self._start()
        for row in message.row:
            if row.n_cables > CABLES_MAX or not finite((*row.acc, *row.gyro, *row.q, *row.position, *row.f)):
                self._decoder.n_undecodable += 1
                return
            if len(row.f) != len(self._low):
                self._low, self._high = list(row.f), list(row.f)
            self._low, self._high = list(map(min, self._low, row.f)), list(map(max, self._high, row.f))
            self._rows.append(row)
        self._new_row, self._newest_ns = message.row[-1], message.row[-1].t_ns

    def _take_tracker(self, data: bytes) -> None:
        message = self._decoder.decode(tracker_t, data)
        if message is None or not message.valid:
            return
        if 0 < self._tracker_ns < message.t_ns:
            self._gap = max(self._gap, 1e-9 * (message.t_ns - self._tracker_ns))
        self._tracker_ns = message.t_ns

    def _take_health(self, data: bytes) -> None:
        message = self._decoder.decode(health_t, data)
        if message is None or not finite(message.age):
            return
        before = self._health[-1] if self._health else None
        self._health.append(message)
        rates = () if self._robot is None else self._robot.rates
        loads = self._load.take(message, before, rates, self._decoder)
        self._feed.put("health", t=self._seconds(message.t_ns), **health_item(message, before, loads))

    def _take_event(self, data: bytes) -> None:
        message = self._decoder.decode(event_t, data)
        if message is not None:
            kind = {event_t.DONE: "done", event_t.REFUSED: "refused"}.get(message.kind, "news")
            self._feed.put(
                "event",
                t=self._seconds(message.t_ns),
                clock=clock(message.t_ns),
                source=plain(message.source, 40),
                text=plain(message.text),
                what=kind,
            )

    def _take_config(self, data: bytes) -> None:
        if data == self._config_bytes:
            return
        message = self._decoder.decode(robot_config_t, data)
        robot = DrawnRobot.of_message(message, data, self._described) if message is not None else None
        if robot is not None:
            self._config_bytes, self._robot = data, robot
            self._feed.put("robot", **robot.item())
        elif message is not None:
            self._decoder.n_undecodable += 1

    # ---- items -------------------------------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """Put what is due, and wake the listeners. now as in take()."""
        with self._lock:
            if self._due["pose"](now):
                self._put_pose()
            if self._due["row"](now):
                self._put_row()
            if self._due["estimate"](now):
                self._put_estimate()
            if self._due["residual"](now):
                self._put_residual()
            if self._due["state"](now):
                self._put_state(now)
        self._feed.announce()

    def _put_pose(self) -> None:
        row, self._new_row = self._new_row, None
        if row is None:
            return
        t = self._seconds(row.t_ns)
        self._feed.put("pose", t=t, f=numbers(row.f), **(self._robot.pose(row) if self._robot is not None else {}))

    def _put_row(self) -> None:
        if not self._rows or not self._low:
            return
        row = self._rows[-1]
        t = self._seconds(row.t_ns)
        extremes = {"low": numbers(self._low), "high": numbers(self._high)}
        since = 1e-9 * (row.t_ns - self._tracker_ns)  # a tracker that is lost has a gap that grows
        gap = round(max(self._gap, since), 4) if self._tracker_ns > 0 else None
        self._feed.put("row", t=t, **extremes, acc=numbers(row.acc), gyro=numbers(row.gyro), gap=gap)
        self._low, self._high, self._gap = [], [], 0.0

    def _put_estimate(self) -> None:
        data, self._new_estimate = self._new_estimate, None
        message = None if data is None else self._decoder.decode(estimate_t, data)
        if message is None:
            return
        body = of_message(message)
        if not finite((*body.value, *body.std, *message.theta, *message.systematic, message.nis)):
            self._decoder.n_undecodable += 1
            return
        self._estimate = message
        self._feed.put(
            "estimate",
            t=self._seconds(self._newest_ns or message.t_ns),
            value=numbers(body.value),
            std=numbers(body.std),
            nis=round(message.nis, 2),
            counts=[message.n_windows, message.n_rows, message.n_dropped, message.n_changes],
            observable=[bool(x) for x in message.observable],
            solid=ellipsoid(body),
        )

    def _put_residual(self) -> None:
        if self._robot is None or self._estimate is None:
            return
        found = self._robot.residual(self._rows, self._estimate)
        if found is not None:
            self._feed.put("residual", t=self._seconds(self._rows[-1].t_ns), f=numbers(found))

    def _put_state(self, now: float) -> None:
        silence = 0.0 if self.note or self._heard is None else now - self._heard
        newest = self._health[-1] if self._health else None
        earlier = self._health[0] if len(self._health) > 1 else None
        found = findings.of(State(self._estimate, newest, earlier, silence))
        self._feed.put(
            "state",
            verdict=verdict(found),
            findings=[[x.severity, x.says, x.do] for x in found],
            silence=round(silence, 1),
            heard=self._heard is not None,
            note=self.note,
            undecodable=self._decoder.n_undecodable,
        )
