# SPDX-License-Identifier: Apache-2.0
"""Payloads that are announced to the daemon: an expectation_t, from words or from a payload of the simulation."""

from typing import Final

import numpy as np

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.model import payload
from inertiad.robot.keys import Nominal
from inertiad_lcm import expectation_t

MASS_STD: Final = 0.02
"""of the mass, where nothing is said: a crane's scale"""
COG_STD: Final = 0.01
"""m, where nothing is said: chosen as what a tape measure gives"""
RADIUS_STD: Final = 0.05
"""m, of gyration, which makes the inertia's sigma where nothing is said: that of a cube of 0.12 m,
so that a load of that size may be announced as a point"""

ROUNDING: Final = 1e-9
"""of the moments about P, below which those about the CoG are those of a point"""


def message(theta: Array, t_ns: int, std: tuple[float, float, float] | None = None) -> expectation_t:
    """The announcement of theta [10] about P, in contact at t_ns. std: of mass [kg], CoG [m], inertia [kg m2]."""
    sign = -1.0 if theta[0] < 0.0 else 1.0
    body = inertiad_core.body(sign * theta, np.eye(10))
    mass = abs(float(theta[0]))
    std = std or (MASS_STD * mass, COG_STD, mass * RADIUS_STD**2)
    e = expectation_t()
    e.t_ns, e.mass, e.mass_std = t_ns, sign * mass, std[0]
    e.cog, e.cog_std = [float(x) for x in body["cog"]], [std[1]] * 3
    about_cog = [float(x) for x in body["inertia_cog"]]
    is_point = max(map(abs, about_cog)) < ROUNDING * float(sign * sum(theta[4:7]))
    e.inertia_cog, e.inertia_cog_std = [0.0] * 6 if is_point else about_cog, [std[2]] * 6
    return e


def _std(words: str) -> tuple[float, float, float]:
    try:
        found = [float(word) for word in words.split(",")]
    except ValueError:
        found = []
    if len(found) != 3 or not all(0.0 <= x < np.inf for x in found):
        raise InputError(f'--std "{words}": allowed: KG,M,KGM2, each 0 or more')
    return found[0], found[1], found[2]


def parse(words: str, now_ns: int, std: str | None = None) -> expectation_t:
    """ "70@2@0,0,0.3": 70 kg touch the platform 2 s from now, a point there in P; "box.toml@2": a body.

    InputError: not of this form, a mass without its position, or later than the daemon takes it.
    """
    is_mass = not words.partition("@")[0].endswith((".toml", ".json"))
    if is_mass and words.count("@") != 2:
        raise InputError(f'command expect: "{words}": allowed: KG@S@x,y,z or FILE@S, s from now; position in P, m')
    unused = Nominal(mass=1.0, cog=[0.0] * 3, inertia_cog=[1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    found = payload.parse(words, unused, "command expect")
    if found.time > expectation_t.AHEAD_MAX:
        limit = f"time = {found.time:g}: allowed: 0 to {expectation_t.AHEAD_MAX}, s from now"
        raise InputError(f'command expect: "{words}": {limit}')
    return message(found.theta, now_ns + round(1e9 * found.time), None if std is None else _std(std))
