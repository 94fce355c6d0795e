# SPDX-License-Identifier: Apache-2.0
"""Quantities that a CAN signal can carry: names, numbers, dimensions and the sensor each belongs to.

The numbers are those of ``ipe_quantity_t`` in firmware/core/types.h and part of the compiled configuration.
"""

from typing import Final, Literal

Dimension = Literal["acceleration", "rate", "angle", "length", "force", "time", "none"]
Sensor = Literal["imu", "force", "pos"]

CABLES_MAX: Final = 16
AXES: Final = ("x", "y", "z")

ACC: Final = tuple(f"acc_{a}" for a in AXES)
GYRO: Final = tuple(f"gyro_{a}" for a in AXES)
QUATERNION: Final = ("q_w", "q_x", "q_y", "q_z")
RPY: Final = ("roll", "pitch", "yaw")
POSITION: Final = tuple(f"pos_{a}" for a in AXES)
COUNTER: Final = ("imu_counter", "force_counter", "pos_counter")
TIME: Final = ("imu_time", "force_time", "pos_time")


def lengths(n_cables: int) -> tuple[str, ...]:
    """Names of the cables' unstrained lengths: l_1 .. l_m; not measured, commanded."""
    return tuple(f"l_{i + 1}" for i in range(n_cables))


def measured_lengths(n_cables: int) -> tuple[str, ...]:
    """Names of the cables' measured lengths, attachment to anchor with the arc on the pulley: length_1 .. length_m."""
    return tuple(f"length_{i + 1}" for i in range(n_cables))


def forces(n_cables: int) -> tuple[str, ...]:
    """Names of the cable forces: f_1 .. f_m."""
    return tuple(f"f_{i + 1}" for i in range(n_cables))


_IN_ORDER: Final = ACC + GYRO + QUATERNION + RPY + POSITION + forces(CABLES_MAX) + COUNTER + TIME
QUANTITIES: Final[dict[str, int]] = {name: number for number, name in enumerate(_IN_ORDER)}


def dimension(name: str) -> Dimension:
    """Dimension of the quantity; its SI unit follows: m/s2, rad/s, rad, m, N, s, 1."""
    if name in ACC:
        return "acceleration"
    if name in GYRO:
        return "rate"
    if name in RPY:
        return "angle"
    if name in POSITION:
        return "length"
    if name in TIME:
        return "time"
    if name in QUATERNION or name in COUNTER:
        return "none"
    return "force"


def sensor(name: str) -> Sensor:
    """The sensor whose samples the quantity is part of."""
    if name in POSITION or name.startswith("pos_"):
        return "pos"
    if name.startswith(("f_", "force_")):
        return "force"
    return "imu"
