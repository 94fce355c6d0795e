# SPDX-License-Identifier: Apache-2.0
"""The request of the command line: its text parsed to numbers and limits, and the plan for it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.excite.constraints import Checker, Limits
from inertiad.excite.planner import Plan, Request, moves, optimal, shortest, static_poses
from inertiad.excite.problem import REST, Criterion
from inertiad.excite.search import Progress
from inertiad.identify.fisher_information import Model
from inertiad.model import trajectory
from inertiad.robot import description, geometry, stand_in
from inertiad.robot.messages import nearest

MOTIONS = ("optimal", "paper")
REST_TO_REST = 2.0
"""s, about, of a move between two rests, to choose a number of rests for a duration"""


def numbers(text: str, n: int, option: str, meaning: str) -> Array:
    """n numbers with commas between. InputError: they are not."""
    try:
        values = np.array([float(cell) for cell in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.shape != (n,) or not np.isfinite(values).all():
        raise InputError(f'{option} "{text}": allowed: {n} numbers, {meaning}')
    return values


def pose_from(text: str, option: str) -> Array:
    """x,y,z in m and roll,pitch,yaw in degrees -> [6], m and rad."""
    pose = numbers(text, 6, option, "x,y,z in m and roll,pitch,yaw in degrees")
    return np.concatenate([pose[:3], np.deg2rad(pose[3:])])


def wanted_sigma(text: str, model: Model) -> Array:
    """ "mass=0.2%,cog=1mm,inertia=1%" -> sigma [10]; percentages of the mass and of the mean moment of inertia."""
    wanted, moment = np.full(10, np.inf), float(np.mean(model.body.inertia_cog[:3]))
    kinds = {
        "mass": (slice(0, 1), {"%": 0.01 * model.body.mass, "kg": 1.0}),
        "cog": (slice(1, 4), {"mm": 1e-3, "m": 1.0}),
        "inertia": (slice(4, 10), {"%": 0.01 * moment, "kgm2": 1.0}),
    }
    for item in text.split(","):
        key, _, value = item.strip().partition("=")
        where, units = kinds.get(key, (slice(0), {}))
        unit = next((u for u in units if value.endswith(u)), None)
        try:
            number = float(value.removesuffix(unit or "?"))
        except ValueError:
            number = -1.0
        if unit is None or not number > 0.0:
            raise InputError(f'--sigma "{item}": allowed: mass=0.2% or kg, cog=1mm or m, inertia=1% or kgm2')
        wanted[where] = number * units[unit]
    return wanted


def limits_from(model: Model, box: str | None, tilt: float, yaw: float, speed: float, acceleration: float) -> Limits:
    """Limits of the command line; degrees, m, s. InputError: the box is empty."""
    edges = (
        geometry.box(model.robot)
        if box is None
        else numbers(box, 6, "--box", "x_min,y_min,z_min,x_max,y_max,z_max in m")
    )
    if not np.all(edges[:3] < edges[3:]):
        raise InputError(f'--box "{box}": allowed: every minimum below its maximum')
    angle = np.deg2rad([tilt, yaw])
    return Limits(
        edges[:3], edges[3:], float(angle[0]), float(angle[1]), speed, acceleration, clearance=0.03, margin=0.1
    )


@dataclass(frozen=True)
class Arguments:
    """The command line's words; see `inertiactl excite -h`."""

    motion: str = "optimal"
    duration: float = 20.0
    sigma: str | None = None
    poses: int = 0
    hold: float = 3.0
    start: str | None = None
    end: str | None = None
    criterion: str = "A"
    box: str | None = None
    tilt: float = 30.0
    yaw: float = 35.0
    speed: float = 4.0
    acceleration: float = 2.0


def _request(robot_file: Path, arguments: Arguments, n_starts: int, seed: int) -> tuple[Request, list[str]]:
    """The request, checked, and what was assumed for it."""
    if arguments.motion not in MOTIONS:
        hint = nearest(arguments.motion, MOTIONS)
        raise InputError(f'--motion "{arguments.motion}": allowed: {", ".join(MOTIONS)}{hint}')
    completed = stand_in.complete(description.load(robot_file))
    if arguments.criterion not in ("A", "D"):
        raise InputError(f'--criterion "{arguments.criterion}": allowed: A, D')
    model = Model(completed.robot, str(robot_file), completed.body)
    limits = limits_from(model, arguments.box, arguments.tilt, arguments.yaw, arguments.speed, arguments.acceleration)
    if arguments.motion == "paper":  # the poses are given: only what the robot cannot do is refused
        far = np.full(3, 1e4)
        limits = replace(limits, low=-far, high=far, tilt=np.deg2rad(80.0), yaw=np.pi, margin=0.0)
    middle = np.concatenate([0.5 * (limits.low + limits.high), np.zeros(3)])
    start = middle if arguments.start is None else pose_from(arguments.start, "--start")
    criterion: Criterion = "A" if arguments.criterion == "A" else "D"
    return Request(Checker(model, limits), start, criterion, n_starts, seed), list(completed.remarks)


def _paper(request: Request, arguments: Arguments) -> Plan:
    """There and back between two poses, those of the paper where none are given."""
    start = request.start if arguments.start is not None else trajectory.PAPER_PAIRS[0, 0]
    end = trajectory.PAPER_PAIRS[0, 1] if arguments.end is None else pose_from(arguments.end, "--end")
    return moves(request, np.array([start, end, start]), REST, "paper")


def _planned(request: Request, arguments: Arguments, remarks: list[str], progress: Progress) -> Plan:
    n_cables = request.checker.model.robot.n_cables
    n_poses = arguments.poses
    if n_cables < 6 and not n_poses and arguments.motion == "optimal" and arguments.sigma is None:
        n_poses = max(3, round(arguments.duration / (arguments.hold + REST_TO_REST)))
        remarks.append(f"{n_cables} cables: no motion can be commanded, {n_poses} rests are planned, as by --poses")
    if n_poses:
        return static_poses(request, n_poses, arguments.hold, progress)
    if arguments.motion == "paper":
        return _paper(request, arguments)
    if arguments.sigma is not None:
        return shortest(request, wanted_sigma(arguments.sigma, request.checker.model), progress)
    return optimal(request, arguments.duration, progress)


def plan(robot_file: Path, arguments: Arguments, n_starts: int, seed: int, progress: Progress) -> tuple[Request, Plan]:
    """The plan of a request. InputError: there is none; the text names the limit in the way."""
    request, remarks = _request(robot_file, arguments, n_starts, seed)
    found = _planned(request, arguments, remarks, progress)
    return request, replace(found, remarks=[*remarks, *found.remarks])
