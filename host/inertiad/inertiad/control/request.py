# SPDX-License-Identifier: Apache-2.0
"""The request of the command line: which trials, with everything that it leaves open chosen by the robot."""

import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from inertiad.base.error import InputError
from inertiad.control import experiment
from inertiad.control.closed_loop import ANNOUNCED_BEFORE
from inertiad.control.experiment import Request
from inertiad.model import payload
from inertiad.model.payload import Payload
from inertiad.simulate import request as simulation
from inertiad.simulate.simulator import Run

AS_IT_IS: Final = "payload"
"""of --announce: what --payload says"""
APART: Final = ANNOUNCED_BEFORE + 1.0
"""s between announced contacts, since the daemon expects one payload at a time: one is taken 0.7 s after its contact
(CoGiRo, 40 kg, seed 0), and only then, with some margin, the next is announced"""


@dataclass(frozen=True)
class Arguments:
    """The command line's words; see `inertiactl control -h`."""

    payload: tuple[str, ...] = ()
    bandwidth: str = "1.5"
    arms: str = "nominal,live,oracle,adaptive"
    is_pose_measured: bool = False
    plant: str = "rigid"
    faults: str = "modern"
    seeds: int = 1
    trajectory: str | None = None
    body: Path | None = None
    mass: float | None = None
    kill: float | None = None
    announce: tuple[str, ...] = ()
    """AS_IT_IS, or payloads as words"""
    duration: float = 10.0
    """s, of hold"""


def _check_kill(kill: float | None, arms: tuple[str, ...], duration: float) -> None:
    """InputError: a time at which no daemon runs."""
    if kill is None:
        return
    if not 0.0 <= kill < duration:
        raise InputError(f"--kill {kill:g}: allowed: 0 to {duration:g}, s: the motion's duration")
    if "live" not in arms:
        raise InputError("--kill: no arm has a daemon; add live to --arms")


def _announced(words: tuple[str, ...], arms: tuple[str, ...], run: Run) -> tuple[Payload, ...]:
    """InputError: the daemon would never hear of one, or hear of the next before it has taken one."""
    if not words:
        return ()
    if "live" not in arms:
        raise InputError("--announce: no arm has a daemon; add live to --arms")
    if words == (AS_IT_IS,) and not run.payloads:
        raise InputError(f"--announce {AS_IT_IS}: there is none; pass --payload as well, or --announce KG@S")
    found = run.payloads if words == (AS_IT_IS,) else _other(words, run)
    for last, following in itertools.pairwise(sorted(one.time for one in found)):
        if following - last < APART:
            raise InputError(
                f"--announce: payloads at {last:g} and {following:g} s: allowed: {APART:g} s apart or more, "
                "the daemon expects one at a time"
            )
    return found


def _other(words: tuple[str, ...], run: Run) -> tuple[Payload, ...]:
    found = tuple(payload.parse(item, run.body, "--announce") for item in words)
    end = run.trajectory.duration
    for item, one in zip(words, found, strict=True):
        if one.time >= end:
            raise InputError(f'--announce "{item}": allowed: 0 to {end:g}, s: the motion\'s duration')
    return found


def request_of(robot_file: Path, arguments: Arguments) -> tuple[Request, list[str]]:
    """The trials and what was assumed for them. InputError: a word, the robot or the body is not usable."""
    if arguments.plant == "exact":
        raise InputError(
            '--plant "exact": a platform that is where the trajectory says needs no controller: '
            "allowed: rigid, elastic, or a .toml file"
        )
    words = simulation.Arguments(
        trajectory=arguments.trajectory,
        faults=arguments.faults,
        body=arguments.body,
        mass=arguments.mass,
        duration=arguments.duration,
        plant=arguments.plant,
        payload=arguments.payload,
    )
    run, remarks = simulation.run_of(robot_file, words)
    arms = experiment.arms(arguments.arms)
    _check_kill(arguments.kill, arms, run.trajectory.duration)
    known = run.robot.model_copy(update={"nominal": run.body})
    return Request(
        replace(run, robot=known),
        arms,
        experiment.bandwidths(arguments.bandwidth),
        tuple(range(arguments.seeds)),
        arguments.is_pose_measured,
        np.inf if arguments.kill is None else arguments.kill,
        _announced(arguments.announce, arms, run),
    ), remarks
