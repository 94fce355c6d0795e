# SPDX-License-Identifier: Apache-2.0
"""Signals CSV: t, specific force, angular rate, attitude, position, cable forces; SI."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from inertiad.base import quantity, table
from inertiad.base.error import InputError
from inertiad.base.table import Table
from inertiad.robot import dbc
from inertiad.robot.description import Robot


def columns(robot: Robot) -> list[str]:
    """Column names a signals CSV may have for this robot."""
    sensors = quantity.ACC + quantity.GYRO + quantity.QUATERNION + quantity.RPY + quantity.POSITION
    return ["t", *sensors, *quantity.forces(robot.n_cables), *quantity.measured_lengths(robot.n_cables)]


def with_attitude(signals: Table) -> Table:
    """The table with both a quaternion and roll, pitch, yaw, from whichever it has."""
    found = dict(signals.columns)
    if all(name in found for name in quantity.QUATERNION):
        q = signals.stack(*quantity.QUATERNION)
        norm = np.linalg.norm(q, axis=1)
        far = np.flatnonzero(np.abs(norm - 1.0) > 0.01)
        if len(far):
            at = int(far[0])
            raise InputError(f"{signals.name}: t = {signals.t[at]:.6f} s: |q| = {norm[at]:.4g}: allowed: 1, within 1 %")
        rpy = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")[:, ::-1]
        found = dict(zip(quantity.RPY, rpy.T, strict=True)) | found
    elif all(name in found for name in quantity.RPY):
        rotation = Rotation.from_euler("ZYX", signals.stack(*quantity.RPY)[:, ::-1])
        found |= dict(zip(quantity.QUATERNION, rotation.as_quat(scalar_first=True).T, strict=True))
    return Table(signals.t, found, signals.name)


def read(path: Path, robot: Robot) -> Table:
    """A signals CSV, complete for the robot. InputError: see table.read(), or a column is missing."""
    signals = with_attitude(table.read(path, columns(robot)))
    if signals.t[0] < 0.0:
        raise InputError(f"{path}: t = {signals.t[0]:g} s: allowed: 0 and later")
    for name in (*dbc.required(robot), *robot.signals):
        if name not in signals.columns and name not in quantity.COUNTER + quantity.TIME:
            what = f"{path}: line 1: no column {name}, which the robot's CAN signals need"
            if name in quantity.ACC + quantity.GYRO:
                what += f"; the daemon takes no run without accelerometer and gyro, inertiactl fit {path} does"
            raise InputError(what)
    return signals
