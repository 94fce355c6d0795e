# SPDX-License-Identifier: Apache-2.0
"""The SI unit of every column that files of a run may have, by its name, and heads with units: "acc_x [m/s2]"."""

import re
from typing import Final

from inertiad.base.error import InputError

_OF_NAME: Final = (
    (r"t|imu_time|force_time|pos_time|(position|force)_delay", "s"),
    (r"t(_device)?_ns", "ns"),
    (r"acc_(bias_)?[xyz]", "m/s2"),
    (r"gyro_[xyz]", "rad/s"),
    (r"roll|pitch|yaw|world_yaw|(attitude|imu_alignment)_[xyz]", "rad"),
    (r"[xyz]|(pos|cog)_[xyz]", "m"),
    (r"f_\d+|force_offset_\d+", "N"),
    (r"mass", "kg"),
    (r"inertia_cog_[xyz]{2}", "kg m2"),
    (r"q_[wxyz]|force_gain_\d+|consistent|valid|distance|nis|n_\w+", "1"),
    (r"length", "byte"),
)


def of(name: str) -> str:
    """SI unit of a column, "" where it has none. A standard deviation, name_std, has the unit of its quantity."""
    quantity = name.removesuffix("_std")
    return next((unit for pattern, unit in _OF_NAME if re.fullmatch(pattern, quantity)), "")


def head(name: str) -> str:
    """Name and unit for people and programs: "acc_x [m/s2]"."""
    unit = of(name)
    return f"{name} [{unit}]" if unit else name


def split(text: str) -> tuple[str, str]:
    """Name and unit of a column head; "" for a head without a unit."""
    match = re.fullmatch(r'\s*"?\s*([^\[\]"]*?)\s*(?:\[([^\[\]]*)\])?\s*"?\s*', text)
    return (match[1], (match[2] or "").strip()) if match else (text.strip(), "")


def factor(name: str, unit: str, source: str) -> float:
    """SI value of one of unit, for a column of that name. InputError: the unit measures something else."""
    own = of(name)
    if unit in ("", own):
        return 1.0
    from inertiad.robot import dbc

    for dimension, known in dbc.UNITS.items():
        if known.get(own) == 1.0:
            try:
                return dbc.unit_factor(unit, dimension)
            except KeyError as error:
                raise InputError(f'{source}: {name}: unit "{unit}": allowed: {error.args[0]}') from None
    raise InputError(f'{source}: {name}: unit "{unit}": allowed: {own or "none"}')
