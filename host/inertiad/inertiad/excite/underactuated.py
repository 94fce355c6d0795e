# SPDX-License-Identifier: Apache-2.0
"""Plans for fewer than six cables: the platform can be brought to rest where it hangs, and swings on the way.

No motion can be commanded along the free directions, so the plan consists of cable lengths: those of level poses, from
rest to rest. Where the platform hangs on them, how it swings between, and the resulting information follow from
forward_dynamics.py.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.excite.constraints import Checker
from inertiad.identify import fisher_information
from inertiad.model import forward_dynamics
from inertiad.model.forward_dynamics import Moved, Plant
from inertiad.model.trajectory import Motion, Moves

CANDIDATES = 60
"""random places among which rests are chosen"""
WAY_POINTS = 4
"""places on a straight way at which it must be able to rest, too"""
SLOWER = 1.5
TRIES = 6
"""so often a motion is slowed down by that much where it swings out of the limits"""


@dataclass(frozen=True)
class Rest:
    """Where the platform hangs on the lengths of a level pose."""

    pose: Array
    """level pose [6] whose lengths are commanded"""
    motion: Motion
    """one row"""
    f: Array
    """tensions [m], N"""


def elastic(checker: Checker) -> Plant:
    plant = forward_dynamics.plant("elastic", checker.model.robot)
    assert plant is not None
    return plant


def _rest(checker: Checker, place: Array) -> Rest | None:
    """The rest at a place [3], None where there is none within the limits."""
    p, none = place[None], np.zeros((1, 3))
    level = Motion(p, none, none, np.eye(3)[None], none, none)
    plant = elastic(checker)
    try:
        lengths = forward_dynamics.lengths_at_rest(checker.mechanics, level, plant)[0]
        motion, f = forward_dynamics.hang(checker.mechanics, lengths, level, plant.stiffness)
    except InputError:
        return None
    low, high = checker.range
    tilt = np.arccos(np.clip(motion.R[0, 2, 2], -1.0, 1.0))
    is_within = np.all((f >= low) & (f <= high)) and tilt <= checker.limits.tilt
    return Rest(np.concatenate([place, np.zeros(3)]), motion, f) if is_within else None


def _is_passable(checker: Checker, a: Array, b: Array) -> bool:
    """Can the platform rest everywhere on the way between two places [3]?"""
    share = np.linspace(0.0, 1.0, WAY_POINTS + 2)[1:-1]
    return all(_rest(checker, a + s * (b - a)) is not None for s in share)


def _candidates(checker: Checker, middle: Array, dice: np.random.Generator) -> list[Rest]:
    """Rests that can be reached from the middle [3] of the box."""
    limits, robot = checker.limits, checker.model.robot
    places = dice.uniform(limits.low, limits.high, (CANDIDATES, 3))
    found = [rest for rest in (_rest(checker, place) for place in places) if rest is not None]
    found = [rest for rest in found if _is_passable(checker, middle, rest.pose[:3])]
    if not found or _rest(checker, middle) is None:
        raise InputError(
            f"{checker.model.source}: {robot.n_cables} cables: nowhere in the box does the platform hang at rest with "
            "every tension within its limits; change --box or --tilt"
        )
    return found


def _best(checker: Checker, rests: list[Rest], n: int, hold: float, scale: Array) -> list[Rest]:
    """n of the rests, each the one that leaves the least sum of variances by scale [10]; inf: no matter."""
    model, counts = checker.model, np.isfinite(scale)
    weight = hold / (0.25 * model.robot.estimator.window_length)
    E = model.E[counts] / scale[counts, None]
    each = [
        model.information(model.instants(rest.motion, rest.f[None]), weight) - model.prior_information for rest in rests
    ]
    total, chosen = model.prior_information, list[Rest]()
    for _ in range(n):
        costs = [np.trace(E @ np.linalg.inv(total + more) @ E.T) for more in each]
        k = int(np.argmin(costs))
        total = total + each[k]
        chosen.append(rests[k])
    return chosen


def _in_order(checker: Checker, poses: list[Array], middle: Array) -> Array:
    """The different poses [K, 6], always on to the nearest, by way of the middle where there is no straight way."""
    left, order = list({tuple(pose): pose for pose in poses}.values()), [np.concatenate([middle, np.zeros(3)])]
    while left:
        here = order[-1]
        following = left.pop(min(range(len(left)), key=lambda k: float(np.linalg.norm(left[k] - here))))
        if not _is_passable(checker, here[:3], following[:3]):
            order.append(order[0])
        order.append(following)
    return np.array(order)


def _swung(checker: Checker, path: Moves) -> Moved:
    mechanics = checker.mechanics
    return forward_dynamics.move(mechanics, mechanics, path, elastic(checker), fisher_information.REHEARSAL_RATE)


def rests(
    checker: Checker,
    n_poses: int,
    hold: float,
    scale: Array,
    move_time: Callable[[Array, Array], float],
    dice: np.random.Generator,
) -> tuple[Moves, Moved]:
    """Lengths of level poses to command, and the resulting motion: the n rests of hold [s] with most information,
    starting in the middle of the box.

    InputError: nowhere to rest, or it swings out of the limits however slowly it is moved.
    """
    middle = 0.5 * (checker.limits.low + checker.limits.high)
    chosen = _best(checker, _candidates(checker, middle, dice), n_poses, hold, scale)
    poses = _in_order(checker, [rest.pose for rest in chosen], middle)
    times = [move_time(a, b) for a, b in itertools.pairwise(poses)]
    robot = checker.model.robot
    low = np.array([cable.tension_min for cable in robot.cable])
    high = np.array([cable.tension_max for cable in robot.cable])
    for _ in range(TRIES):
        path = Moves(poses, times, hold)
        moved = _swung(checker, path)
        if np.all((moved.f >= low) & (moved.f <= high)):
            return path, moved
        times = [SLOWER * seconds for seconds in times]
    raise InputError(f"{n_poses} poses: {'; '.join(forward_dynamics.summary(moved, robot)[1:])}")


def sampled(moved: Moved) -> tuple[Motion, Array]:
    """Motion and tensions [N, m] at the rate of rehearsals."""
    t = fisher_information.sample_times(moved)
    return moved.at(t), moved.tensions(t)
