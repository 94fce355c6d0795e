# SPDX-License-Identifier: Apache-2.0
"""Payloads that a platform takes up or sets down while it moves.

A payload's ten parameters join the body's in a ramp; a negative mass is set down.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.base.text_files import read_json, read_toml
from inertiad.robot import configuration
from inertiad.robot.keys import Nominal
from inertiad.robot.messages import validate

RAMP = 0.5
"""s from the first contact to the whole weight"""


@dataclass(frozen=True)
class Payload:
    """A change of the body."""

    time: float
    """s from the start of the motion to the first contact"""
    theta: Array
    """m, h, J about P [10] that are added"""
    ramp: float = RAMP
    """s, the parameters rise evenly over this"""

    def share(self, t: Array) -> Array:
        """Share of it that is carried at times t [N], 0 to 1."""
        return np.clip((t - self.time) / self.ramp, 0.0, 1.0)


def _seconds(text: str, item: str, option: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds < np.inf:
        raise InputError(f'{option} "{item}": time = {text}: allowed: 0 and more, s')
    return seconds


def _point(mass: float, position: Sequence[float]) -> Array:
    """theta [10] of a point mass [kg] at a position [3] in P, m."""
    x = np.asarray(position)
    J = np.dot(x, x) * np.eye(3) - np.outer(x, x)
    return mass * np.array([1.0, *x, J[0, 0], J[1, 1], J[2, 2], J[1, 2], J[0, 2], J[0, 1]])


def parse(item: str, body: Nominal, option: str = "--payload") -> Payload:
    """ "20.0@4.0": 20 kg taken up at 4 s, a point at the body's CoG; "20@4@x,y,z": there in P; "box.toml@4": a body.

    InputError: not of this form.
    """
    what, *rest = item.split("@")
    if not 1 <= len(rest) <= 2:
        raise InputError(f'{option} "{item}": allowed: KG@S, KG@S@x,y,z or FILE@S')
    time = _seconds(rest[0], item, option)
    try:
        mass = float(what)
    except ValueError:
        path = Path(what)
        if path.suffix not in (".toml", ".json"):
            raise InputError(f'{option} "{item}": allowed: a mass in kg, or a .toml or .json file') from None
        if len(rest) == 2:
            said = f"position = {rest[1]}"
            raise InputError(f'{option} "{item}": {said}: allowed: FILE@S, the cog in FILE is the position') from None
        data = read_json(path) if path.suffix == ".json" else read_toml(path)
        return Payload(time, configuration.theta_of(validate(Nominal, data, what)))
    if not np.isfinite(mass) or mass == 0.0:
        raise InputError(f'{option} "{item}": mass = {what}: allowed: above 0 to take up, below 0 to set down, kg')
    try:
        position = body.cog if len(rest) == 1 else [float(cell) for cell in rest[1].split(",")]
    except ValueError:
        position = []
    if len(position) != 3 or not np.isfinite(position).all():
        raise InputError(f'{option} "{item}": position = {rest[-1]}: allowed: x,y,z in P, m')
    return Payload(time, _point(mass, position))


def parse_all(items: Sequence[str], body: Nominal, duration: float) -> tuple[Payload, ...]:
    """Payloads in the order of their times. InputError: after the motion's duration [s], or a body that cannot be."""
    parsed = sorted(((parse(item, body), item) for item in items), key=lambda pair: pair[0].time)
    for payload, item in parsed:
        if payload.time + payload.ramp > duration:
            raise InputError(f'--payload "{item}": allowed: {payload.ramp:g} s before the end at {duration:g} s')
    payloads = tuple(payload for payload, _ in parsed)
    for n in range(1, len(payloads) + 1):
        theta = configuration.theta_of(body) + sum(payload.theta for payload in payloads[:n])
        if not inertiad_core.is_consistent(theta):
            raise InputError(
                f"--payload: no body is left at {payloads[n - 1].time:g} s, mass = {theta[0]:.4g} kg: "
                "allowed: what can be set down"
            )
    return payloads


def body_of(theta: Array) -> Nominal:
    """The body with m, h, J about P [10]."""
    found: dict[str, Any] = inertiad_core.body(theta, np.eye(10))
    return Nominal(
        mass=found["mass"], cog=[float(x) for x in found["cog"]], inertia_cog=[float(x) for x in found["inertia_cog"]]
    )
