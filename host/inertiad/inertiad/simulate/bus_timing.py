# SPDX-License-Identifier: Apache-2.0
"""CAN frames between sensor and log: when they get through, how late they are stamped, which are lost.

Every sensor is a node that has its frames ready at its sample's time, a little late by release_jitter; the bus takes
the lowest identifier of those that wait. Durations are those of frames without stuff bits; the load that is refused is
that with the most.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import inertiad_core
from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.model.random_errors import Dice
from inertiad.robot import dbc
from inertiad.robot.dbc import Binding
from inertiad.robot.description import Robot
from inertiad.run import encode
from inertiad.run.encode import Frames
from inertiad.run.frame_time import frame_time
from inertiad.simulate.sensor_models import Faults

Mask = NDArray[np.bool_]


def time_of(frames: Frames, bitrate: float, data_bitrate: float, stuffed: bool = False) -> float:
    """s that each of these frames takes, see frame_time()."""
    is_extended = bool(frames.can_id & dbc.EXTENDED_ID)
    return frame_time(frames.data.shape[1], is_extended, frames.is_fd, bitrate, data_bitrate, stuffed)


def priority(can_id: int) -> int:
    """Arbitration key of an identifier, lowest first: the 11 leading bits, then 11-bit before 29-bit identifiers."""
    if can_id & dbc.EXTENDED_ID:
        return (can_id & 0x1FFC0000) << 1 | 1 << 18 | can_id & 0x3FFFF
    return (can_id & 0x7FF) << 19


def _rates(robot: Robot, bus: int) -> tuple[float, float]:
    return (robot.bus[bus].bitrate or 1e6, robot.bus[bus].data_bitrate) if robot.bus else (1e6, 5e6)


def _sensors(bindings: list[Binding]) -> dict[tuple[int, int], set[str]]:
    """Names of quantities and sensors by the message that carries them."""
    found: dict[tuple[int, int], set[str]] = {}
    for binding in bindings:
        names = found.setdefault((binding.bus, binding.can_id), set())
        names |= {binding.quantity, quantity.sensor(binding.quantity)}
    return found


def _through(robot: Robot, level: Faults, t: Array, frames: list[Frames], node: list[str], dice: Dice) -> list[Array]:
    """s, when each frame [N] of one bus has got through."""
    rates = _rates(robot, frames[0].bus)
    load = sum(time_of(f, *rates, stuffed=True) for f in frames) * (len(t) - 1) / (t[-1] - t[0])
    if load > 1.0:
        raise InputError(f"bus {frames[0].bus}: {100 * load:.0f} % load at this --rate: allowed: up to 100 %")
    ready = {n: t + level.release_jitter * dice[f"release_{n}"].random(len(t)) for n in sorted(set(node))}
    release = np.column_stack([ready[n] for n in node])
    first = [priority(f.can_id) for f in frames] * len(t)
    took = [time_of(f, *rates) for f in frames] * len(t)
    end = inertiad_core.arbitrate(release.ravel().tolist(), first, took)
    return list(np.asarray(end).reshape(release.shape).T)


def _lost(level: Faults, t: Array, carries: set[str], dice: np.random.Generator) -> Mask:
    """Mask [N] of the frames that never reach the host."""
    lost = dice.random(len(t)) < level.frame_loss
    if level.silent in carries or level.silent == "bus":
        lost |= level.is_on(t)
    return np.asarray(lost)


def traffic(robot: Robot, bindings: list[Binding], level: Faults, start: float, dice: Dice) -> encode.Stamp:
    """Stamps of frames with everything that can befall them; t = 0 of the run is `start` in host time [s]."""
    names = _sensors(bindings)

    def carries(frames: Frames) -> set[str]:
        return names.get((frames.bus, frames.can_id), set())

    def node(frames: Frames) -> str:
        return next((s for s in ("force", "imu", "pos") if s in carries(frames)), "imu")

    def stamp(t: Array, frames: Sequence[Frames]) -> list[NDArray[np.int64]]:
        bus, frames = frames[0].bus, list(frames)
        through = [t] * len(frames)
        if level.bus_timing:
            through = _through(robot, level, t, frames, [node(f) for f in frames], dice)
        late = dice[f"stamp_jitter_{bus}"].exponential(level.stamp_jitter, (len(t), len(frames)))
        seen = np.column_stack(through) + late + level.stamp_delay
        order = np.argsort(np.column_stack(through).ravel(), kind="stable")
        in_order = np.empty(seen.size)
        in_order[order] = np.maximum.accumulate(seen.ravel()[order])
        in_order += level.stamp_step * (in_order >= start + level.fault_start)
        t_us = np.rint(1e6 * in_order).astype(np.int64)
        if level.stamp_jitter > 0.0:  # frames that a stalled host reads together keep their order: 1 us apart
            ticks = np.arange(len(order))
            t_us[order] = np.maximum.accumulate(t_us[order] - ticks) + ticks
        t_us = t_us.reshape(seen.shape)
        loss = dice[f"frame_loss_{bus}"]
        for j, f in enumerate(frames):
            t_us[_lost(level, t - start, carries(f), loss), j] = encode.LOST
        return list(t_us.T)

    return stamp
