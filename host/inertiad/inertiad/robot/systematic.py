# SPDX-License-Identifier: Apache-2.0
"""The systematic parameters xi of the sensors: kinds, names and places, as the C core has them (systematic.h)."""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

import inertiad_core
from inertiad.base.quantity import AXES

_SHOWN: Final = {
    "rad": ("deg", 180.0 / np.pi),
    "rad/s": ("deg/s", 180.0 / np.pi),
    "s": ("ms", 1e3),
    "m": ("mm", 1e3),
    "1": ("%", 100.0),
}
"""unit in which people are shown a quantity of an SI unit, and the factor to it"""


@dataclass(frozen=True)
class Group:
    """Systematic parameters of one kind."""

    name: str
    """as in estimate.json"""
    si: str
    """their unit in xi"""
    first: int
    """index in xi"""
    n: int
    is_per_cable: bool

    @property
    def part(self) -> slice:
        """of xi"""
        return slice(self.first, self.first + self.n)

    @property
    def unit(self) -> str:
        """for people"""
        return _SHOWN.get(self.si, (self.si, 1.0))[0]

    @property
    def factor(self) -> float:
        """to unit, from SI"""
        return _SHOWN.get(self.si, (self.si, 1.0))[1]

    @property
    def labels(self) -> list[str]:
        """A name for each: with its axis or its cable's number."""
        if self.is_per_cable:
            return [f"{self.name}_{i + 1}" for i in range(self.n)]
        return [self.name] if self.n == 1 else [f"{self.name}_{axis}" for axis in AXES]

    @property
    def std_key(self) -> str:
        """of [std] and [calibration.std], their common sigma"""
        return "attitude" if self.name == "attitude_bias" else self.name


@cache
def groups(n_cables: int) -> tuple[Group, ...]:
    """All kinds in the order of xi."""
    return tuple(Group(*row) for row in inertiad_core.systematic_table(n_cables))


def group(name: str, n_cables: int) -> Group:
    """The kind of that name."""
    return next(g for g in groups(n_cables) if g.name == name)


def names(n_cables: int) -> list[str]:
    """A name for every parameter, in the order of xi."""
    return [label for g in groups(n_cables) for label in g.labels]


def planned_groups(n_cables: int) -> list[Group]:
    """The kinds whose equations instants of a motion have; they come first. Friction needs the cables' travel."""
    return [g for g in groups(n_cables) if g.name != "friction"]


def n_planned(n_cables: int) -> int:
    """Number of parameters of planned_groups()."""
    return sum(g.n for g in planned_groups(n_cables))
