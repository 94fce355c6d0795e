# SPDX-License-Identifier: Apache-2.0
"""Eight motions, rest to rest, as splines of x y z [m] and roll pitch yaw [rad] over time."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from robots import Robot
from scipy.interpolate import BSpline, make_interp_spline

REST = 2.5
"""s at rest before and after"""
STEP = 0.02


@dataclass(frozen=True)
class Motion:
    """A pose over time."""

    duration: float
    spline: BSpline
    is_released: bool = False
    """it starts with a push, and the winches stay locked"""

    def pose(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """p [N, 3] and R [N, 3, 3] = Rz(yaw) Ry(pitch) Rx(roll), body to world."""
        x = self.spline(np.clip(t, 0.0, self.duration))
        return x[:, :3], rotation(x[:, 3:])

    def position_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity and acceleration of P [N, 3], W."""
        return self.spline(t, 1)[:, :3], self.spline(t, 2)[:, :3]


def rotation(rpy: np.ndarray) -> np.ndarray:
    """R [N, 3, 3] of roll, pitch, yaw [N, 3]."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(rpy).T, np.sin(rpy).T
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _smooth(s: np.ndarray) -> np.ndarray:
    """0 to 1 with three derivatives that vanish at both ends."""
    s = np.clip(s, 0.0, 1.0)
    return s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)


def _fourier(robot: Robot, t: np.ndarray, dice: np.random.Generator, share: np.ndarray) -> np.ndarray:
    """Five harmonics in every coordinate, faded in and out."""
    fade = _smooth(t / (0.8 / robot.pace)) * _smooth((t[-1] - t) / (0.8 / robot.pace))
    x = np.zeros((len(t), 6))
    for j in range(6):
        hz = robot.pace * np.array([0.7, 1.3, 2.1, 2.9, 3.6]) * (1.0 + 0.08 * dice.standard_normal(5))
        size = dice.uniform(0.4, 1.0, 5) / np.array([1.0, 1.1, 1.5, 2.1, 2.8])
        wave = (size[:, None] * np.sin(2.0 * np.pi * hz[:, None] * t + dice.uniform(0, 6.28, (5, 1)))).sum(0)
        x[:, j] = robot.reach[j] * share[j] * fade * wave / np.abs(wave).max()
    return x


def _visits(
    robot: Robot, t: np.ndarray, dice: np.random.Generator, share: np.ndarray, move: float, hold: float
) -> np.ndarray:
    """Random poses, smooth moves between them and rests in them; back home at the end."""
    x = np.zeros((len(t), 6))
    at, now = np.zeros(6), 0.0
    n = max(int((t[-1] + hold) // (move + hold)), 2)
    for k in range(n):
        goal = np.zeros(6) if k == n - 1 else dice.uniform(-1.0, 1.0, 6) * robot.reach * share
        x += (goal - at) * _smooth((t - now) / move)[:, None]
        at, now = goal, now + move + hold
    return x


def fourier(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    return _fourier(robot, t, dice, np.ones(6))


def pick(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    """Pick and place: quick moves, short rests, the platform nearly level."""
    move = 0.45 / robot.pace
    return _visits(robot, t, dice, np.array([1.0, 1.0, 1.0, 0.35, 0.35, 0.8]), move, 0.2 / robot.pace)


def translate(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    return _fourier(robot, t, dice, np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))


def yaw(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    return _fourier(robot, t, dice, np.array([0.1, 0.1, 0.1, 0.0, 0.0, 1.0]))


def vertical(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    return _fourier(robot, t, dice, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


def stops(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    """Moves that end in an emergency stop: braked to rest within a tenth of the move's time, on to the next pose."""
    x = np.zeros((len(t), 6))
    at, now, move, brake, hold = np.zeros(6), 0.0, 0.55 / robot.pace, 0.08 / robot.pace, 0.3 / robot.pace
    share = np.array([1.0, 1.0, 0.8, 0.7, 0.7, 0.8])
    while now + 2.0 * move + brake + hold < t[-1]:
        goal = dice.uniform(-1.0, 1.0, 6) * robot.reach * share
        cut = dice.uniform(0.4, 0.6) * move
        grid = np.arange(0.0, cut + brake, 0.002)
        s = _smooth(grid / move)
        speed = np.gradient(s, grid)
        speed *= np.where(grid < cut, 1.0, 0.5 + 0.5 * np.cos(np.pi * np.clip((grid - cut) / brake, 0.0, 1.0)))
        way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * 0.002])
        x += (goal - at) * np.interp(t - now, grid, way)[:, None]
        at = at + (goal - at) * way[-1]
        now += cut + brake + hold
    return x - at * _smooth((t - now) / (t[-1] - now))[:, None]


def gallery(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    """Rest poses, slow moves between them."""
    return _visits(robot, t, dice, np.ones(6), 0.6 / robot.pace, 1.0 / robot.pace)


def swing(robot: Robot, t: np.ndarray, dice: np.random.Generator) -> np.ndarray:
    """Free swinging: winches locked; with six cables and more, a sway of all coordinates that dies down."""
    x = np.zeros((len(t), 6))
    if robot.is_elastic:
        return x
    fade = _smooth(t * robot.pace) * np.exp(-t / (0.5 * t[-1])) * _smooth((t[-1] - t) * robot.pace)
    for j in range(6):
        hz = 2.2 * robot.pace * (1.0 + 0.15 * dice.standard_normal())
        x[:, j] = 0.6 * robot.reach[j] * fade * np.sin(2 * np.pi * hz * t + dice.uniform(0, 6.28))
    return x


MOTIONS: dict[str, Callable[[Robot, np.ndarray, np.random.Generator], np.ndarray]] = {
    f.__name__: f for f in (fourier, pick, translate, yaw, vertical, stops, gallery, swing)
}


def make(name: str, robot: Robot, duration: float, dice: np.random.Generator, scale: float = 1.0) -> Motion:
    """The motion of that name; scale shrinks its amplitudes."""
    t = np.arange(0.0, duration + STEP, STEP)
    n_rest = int(REST / STEP)
    moving = t[n_rest:-n_rest] - t[n_rest]
    x = np.zeros((len(t), 6))
    x[n_rest:-n_rest] = scale * MOTIONS[name](robot, moving, dice)
    x[:, :3] += robot.home
    return Motion(float(t[-1]), make_interp_spline(t, x, k=5), name == "swing" and robot.is_elastic)
