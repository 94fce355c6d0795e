# SPDX-License-Identifier: Apache-2.0
"""The SI unit of every column that files of a run may have, by its name, and heads with units: "acc_x [m/s2]"."""

import math
import re
from typing import Final

from inertiad.base.error import InputError
from inertiad.base.quantity import Dimension

G = 9.80665
"""m/s2, standard gravity: of the unit g and of a kilogram-force"""
_DEG = math.pi / 180.0
SI_VALUE: Final[dict[Dimension, dict[str, float]]] = {
    "acceleration": {
        "m/s2": 1.0,
        "m/s/s": 1.0,
        "mm/s2": 1e-3,
        "cm/s2": 1e-2,
        "g": G,
        "mg": 1e-3 * G,
        "ug": 1e-6 * G,
    },
    "rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEG, "dps": _DEG, "mdps": 1e-3 * _DEG, "deg/h": _DEG / 3600.0},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": _DEG, "mdeg": 1e-3 * _DEG},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "force": {"N": 1.0, "mN": 1e-3, "daN": 10.0, "kN": 1e3, "kgf": G, "kg": G, "lbf": 4.4482216152605},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "none": {"": 1.0, "1": 1.0, "-": 1.0},
}
"""SI value of one unit. A DBC signal without a unit counts as SI."""

_SPELLINGS = {"²": "2", "^": "", "**": "", "°": "deg", "º": "deg", "µ": "u", "μ": "u", "sec": "s", "rad/sec": "rad/s"}


_OF_NAME: Final = (
    (r"t|imu_time|force_time|pos_time|(position|force|attitude)_delay", "s"),
    (r"t(_device)?_ns", "ns"),
    (r"acc_(bias_)?[xyz]", "m/s2"),
    (r"gyro_(bias_)?[xyz]", "rad/s"),
    (r"roll|pitch|yaw|world_yaw|(attitude|attitude_bias|imu_alignment)_[xyz]", "rad"),
    (r"[xyz]|(pos|cog|imu_position|tracker_target)_[xyz]", "m"),
    (r"f_\d+|force_offset_\d+|external_force_[xyz]", "N"),
    (r"external_stiffness_[xyz]", "N/m"),
    (r"force_lowpass", "s2"),
    (r"mass", "kg"),
    (r"inertia_cog_[xyz]{2}", "kg m2"),
    (
        r"q_[wxyz]|(force_gain|friction)_\d+|(acc|gyro)_scale|cable_inertia|consistent|provisional|valid|distance|nis|n_\w+",
        "1",
    ),
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


def plain(unit: str) -> str:
    """A unit in the spelling of SI_VALUE: "m/s²" -> "m/s2"."""
    text = unit.strip().strip("[]()").replace(" ", "")
    for spelling, simple in _SPELLINGS.items():
        text = text.replace(spelling, simple)
    return text


def unit_factor(unit: str | None, dimension: Dimension) -> float:
    """SI value of one of the unit. KeyError if it does not measure the dimension; its text lists the units that do."""
    text = plain(unit or "")
    known = SI_VALUE[dimension]
    if text == "":
        return 1.0
    if text not in known:
        raise KeyError(", ".join(name for name in known if name))
    return known[text]


def factor(name: str, unit: str, source: str) -> float:
    """SI value of one of unit, for a column of that name. InputError: the unit measures something else."""
    own = of(name)
    if unit in ("", own):
        return 1.0
    for dimension, known in SI_VALUE.items():
        if known.get(own) == 1.0:
            try:
                return unit_factor(unit, dimension)
            except KeyError as error:
                raise InputError(f'{source}: {name}: unit "{unit}": allowed: {error.args[0]}') from None
    raise InputError(f'{source}: {name}: unit "{unit}": allowed: {own or "none"}')
