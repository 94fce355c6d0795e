# SPDX-License-Identifier: Apache-2.0
"""Numbers and names as text for people: units, digits by the standard deviation."""

from typing import Final

import numpy as np

from inertiad.base.body import UNITS
from inertiad.robot import systematic

SHOWN_UNITS: Final = {"kg": ("kg", 1.0), "m": ("mm", 1e3), "kg m2": ("kg m²", 1.0)}
METHOD_NAMES: Final = {
    "joint": "joint fit",
    "wls": "weighted least squares",
    "iv": "instrumental variables",
    "paper": "paper's two steps",
}


def unit_of(i: int) -> tuple[str, float]:
    """Unit in which parameter i is shown, and the factor to it from SI."""
    return SHOWN_UNITS[UNITS[i]]


def digits(std: float) -> int:
    """Decimals that show two digits of a standard deviation."""
    if not np.isfinite(std) or std <= 0.0:
        return 2
    return int(np.clip(1 - np.floor(np.log10(std)), 0, 6))


def shown(value: float, std: float) -> str:
    """ "160.42 ± 0.33" """
    n = digits(std)
    return f"{value:.{n}f} ± {std:.{n}f}"


def number(value: float, std: float, signed: bool = False) -> str:
    """The value with the digits its standard deviation allows."""
    return f"{value:{'+' if signed else ''}.{digits(std)}f}"


def difference(i: int, change: float) -> str:
    """A change of parameter i: "+9.68 kg"."""
    unit, factor = unit_of(i)
    return f"{factor * change:+.3g} {unit}"


def spaced(name: str) -> str:
    """force_offset -> force offset"""
    return name.replace("_", " ")


def factors(n_cables: int) -> list[tuple[float, str]]:
    """Factor and unit in which each systematic parameter is shown."""
    return [(g.factor, g.unit.replace("m2", "m²")) for g in systematic.groups(n_cables) for _ in range(g.n)]
