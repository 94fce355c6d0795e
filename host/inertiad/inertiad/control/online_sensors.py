# SPDX-License-Identifier: Apache-2.0
"""The simulated sensors of a motion that is still going on: frames and positions as they arrive.

Noise, systematic errors and the times at which frames get through are those of `simulate` with the same seed, drawn
beforehand: they do not depend on the motion. Only what is measured does.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.table import Array, Table
from inertiad.model.forward_dynamics import Moved
from inertiad.model.random_errors import Dice
from inertiad.model.trajectory import Motion
from inertiad.robot import dbc
from inertiad.run import encode
from inertiad.simulate import bus_timing, sensor_models, simulator
from inertiad.simulate.sensor_models import Freezer
from inertiad.simulate.simulator import START, Run

SPLINE_ROWS = 8
"""rows before a tension that is asked for: beyond them a cubic spline's end does not matter, (2 - sqrt 3)^8 = 3e-5"""


class _Recent:
    """The newest rows of a motion; a Trajectory over times near its end."""

    def __init__(self, first: int, rows: Array, step: float, duration: float) -> None:
        """rows [N, 19 + m] of ControlLoop.states(), the first with that number."""
        q = Rotation.from_quat(rows[:, 6:10], scalar_first=True).as_matrix()
        motion = Motion(rows[:, :3], rows[:, 3:6], rows[:, 13:16], q, rows[:, 10:13], rows[:, 16:19])
        self._moved = Moved(step, duration, motion, rows[:, 19:], 0, np.inf, 0.0)
        self._start = first * step
        self.duration = duration

    def at(self, t: Array) -> Motion:
        return self._moved.at(np.maximum(t - self._start, 0.0))

    def tensions(self, t: Array) -> Array:
        grid = self._moved.step * np.arange(len(self._moved.f))
        return np.asarray(CubicSpline(grid, self._moved.f)(np.clip(t - self._start, 0.0, grid[-1])))


class OnlineSensors:
    """Lines for the daemon, in the order and at the times they arrive."""

    def __init__(self, run: Run) -> None:
        """InputError: signals that cannot be bound, an overloaded bus."""
        self.run = run
        self.dice = Dice(run.seed)
        level, robot = run.level, run.robot
        self.drawn = sensor_models.draw(level, robot.n_cables, self.dice)
        self.t = simulator.sample_times(run)
        self.noise = sensor_models.draw_noise(level, len(self.t), robot.n_cables, run.rate, self.dice)
        self._bindings = dbc.bind(robot, str(run.robot_file))
        self._freezer = Freezer(level)
        self.tracker_t = self._tracker_times()
        self.tracker_noise = level.tracker_noise * self.dice["tracker_noise"].standard_normal((len(self._all_t), 3))
        self.tracker_noise = self.tracker_noise[self._seen]
        self._stamps = self._arrivals()
        self._done = self._tracked = self._sent = 0
        self._waiting: list[tuple[int, int, str]] = []
        """ns of arrival, number, line"""

    def _tracker_times(self) -> Array:
        level, run = self.run.level, self.run
        self._all_t = np.arange(int(run.trajectory.duration * level.tracker_rate) + 1) / level.tracker_rate
        self._seen = ~sensor_models.out_of_sight(level, self._all_t, self.dice)
        return self._all_t[self._seen]

    def _arrivals(self) -> list[NDArray[np.int64]]:
        """us at which each frame of every sample is stamped, in the order of encode.pack(); LOST: it is."""
        robot, run = self.run.robot, self.run
        first = self.t[:1]
        columns = {b.quantity: np.full(1, 0.5 * (b.minimum + b.maximum)) for b in self._bindings}
        columns |= dict(zip(("q_w", "q_x", "q_y", "q_z"), np.array([[1.0], [0.0], [0.0], [0.0]]), strict=True))
        frames = encode.pack(self._bindings, Table(START + first, columns, "simulation"), first)
        stamp = bus_timing.traffic(robot, self._bindings, run.level, START, self.dice)
        found: list[NDArray[np.int64]] = []
        for bus in sorted({f.bus for f in frames}):
            found += stamp(START + self.t, [f for f in frames if f.bus == bus])
        return found

    @property
    def imu_arrival(self) -> Array:
        """s of the motion at which each sample's last frame is there [N]; late ones count as if they were on time."""
        last = 1e-6 * np.max(np.stack(self._stamps), axis=0) - START
        return np.maximum(last, self.t)

    def measure(self, loop: Any, n_rows: int, step: float) -> None:
        """Take the samples of a ControlLoop that has integrated n_rows rows, step s apart."""
        end = (n_rows - 1) * step + 1e-9
        last = int(np.searchsorted(self.t, end, side="right"))
        tracked = int(np.searchsorted(self.tracker_t, end, side="right"))
        if last == self._done and tracked == self._tracked:
            return
        level = self.run.level
        times = [self.t[self._done : last] - self.drawn.force_delay, self.tracker_t[self._tracked : tracked]]
        oldest = min((float(part[0]) for part in times if len(part)), default=end) - level.tracker_delay
        first = max(int(oldest / step) - SPLINE_ROWS, 0)
        recent = _Recent(first, loop.states(first, n_rows), step, self.run.trajectory.duration)
        if last > self._done:
            self._measure_samples(recent, slice(self._done, last))
        if tracked > self._tracked and self.run.robot.position.source == "tracker":
            self._measure_positions(recent, slice(self._tracked, tracked))
        self._done, self._tracked = last, tracked

    def _measure_samples(self, recent: _Recent, part: slice) -> None:
        robot, level, t = self.run.robot, self.run.level, self.t[part]
        f = recent.tensions(np.maximum(t - self.drawn.force_delay, 0.0))
        noise = self.noise.part(part)
        signals = simulator.sample(robot, recent, f, t, self._freezer, level, self.drawn, noise)
        frames = encode.pack(self._bindings, signals, simulator.device_time(level, self.drawn, t), part.start)
        for packed, stamps in zip(frames, self._stamps, strict=True):
            t_us = stamps[part]
            seen = t_us != encode.LOST
            if not seen.all():
                packed, t_us = replace(packed, data=packed.data[seen]), t_us[seen]
            lines = encode.lines_of(packed, t_us)
            self._waiting += [(1000 * us, self._number(), line) for us, line in zip(t_us.tolist(), lines, strict=True)]

    def _measure_positions(self, recent: _Recent, part: slice) -> None:
        t = self.tracker_t[part]
        motion = recent.at(t - self.run.level.tracker_delay)
        xyz = simulator.tracker_target(self.run.robot, motion) + self.tracker_noise[part]
        for when, (x, y, z) in zip(np.rint(1e9 * (START + t)).astype(int).tolist(), xyz.tolist(), strict=True):
            self._waiting.append((when, self._number(), f"position {when} {x!r} {y!r} {z!r}\n"))

    def _number(self) -> int:
        self._sent += 1
        return self._sent

    def lines(self, until_ns: int) -> list[str]:
        """Everything that has arrived until a host time, and was not asked for before."""
        self._waiting.sort()
        n = next((i for i, (when, _, _) in enumerate(self._waiting) if when > until_ns), len(self._waiting))
        arrived, self._waiting = self._waiting[:n], self._waiting[n:]
        return [line for _, _, line in arrived]

    def pose_sensors(self, observer_rate: float) -> Any:
        """inertiad_core.PoseSensors: the same tracker and IMU, as a controller gets them."""
        robot, level, drawn, noise = self.run.robot, self.run.level, self.drawn, self.noise
        R_PI = Rotation.from_quat(robot.imu.orientation, scalar_first=True).as_matrix()
        to_true = sensor_models.imu_axes(R_PI, drawn).T  # P to the IMU's axes, which it takes for those of robot.toml
        return inertiad_core.PoseSensors(
            imu_t=self.t.tolist(),
            imu_arrival=self.imu_arrival.tolist(),
            attitude_error=np.ascontiguousarray(drawn.attitude_bias + noise.wander),
            gyro_error=np.ascontiguousarray((drawn.gyro_bias + noise.gyro) @ R_PI.T),
            acc_error=np.ascontiguousarray((drawn.acc_bias + noise.acc) @ R_PI.T),
            alignment=R_PI @ to_true,
            yaw=drawn.world_yaw,
            tracker_t=self.tracker_t.tolist(),
            tracker_error=np.ascontiguousarray(self.tracker_noise),
            tracker_delay=level.tracker_delay,
            target=np.array(robot.tracker.target),
            observer_rate=observer_rate,
        )
