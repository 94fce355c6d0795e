# SPDX-License-Identifier: Apache-2.0
"""Tracker CSV: t,x,y,z; s and m, world frame, of the tracked point. From an instrument that measures poses also
q_w,q_x,q_y,q_z, unit quaternion platform to world."""

from pathlib import Path

import numpy as np

from inertiad.base import quantity, table
from inertiad.base.error import InputError
from inertiad.base.table import Table

HEADER = "t,x,y,z"
POSE_HEADER = ",".join([HEADER, *quantity.QUATERNION])
FAR = 100.0
"""m: a tracked position beyond this is most likely in mm."""


def has_attitude(tracker: Table) -> bool:
    """True: its rows are poses."""
    return quantity.QUATERNION[0] in tracker.columns


def write(path: Path, tracker: Table) -> None:
    """Write the tracker's positions or poses: s to the microsecond, m to the nanometre."""
    is_pose = has_attitude(tracker)
    rows = np.column_stack([tracker.t, tracker.stack("x", "y", "z", *(quantity.QUATERNION if is_pose else ()))])
    form = ["%.6f"] + ["%.9f"] * (rows.shape[1] - 1)
    np.savetxt(path, rows, fmt=form, delimiter=",", header=POSE_HEADER if is_pose else HEADER, comments="")


def read(path: Path) -> Table:
    """A tracker CSV. InputError: see table.read(); also for positions that look like mm and quaternions not unit."""
    tracker = table.read(path, POSE_HEADER.split(","))
    for name in ("x", "y", "z"):
        if name not in tracker.columns:
            raise InputError(f"{path}: line 1: no column {name}: allowed: {HEADER}")
        worst = int(np.argmax(np.abs(tracker.columns[name])))
        if abs(tracker.columns[name][worst]) > FAR:
            value = f"{name} = {tracker.columns[name][worst]:.6g} m at t = {tracker.t[worst]:.6g} s"
            raise InputError(f"{path}: {value}: allowed: within {FAR:g} m; is the file in mm?")
    if tracker.t[0] < 0.0:
        raise InputError(f"{path}: t = {tracker.t[0]:g} s: allowed: 0 and later")
    _check_attitude(path, tracker)
    return tracker


def _check_attitude(path: Path, tracker: Table) -> None:
    there = [name for name in quantity.QUATERNION if name in tracker.columns]
    if not there:
        return
    if len(there) < len(quantity.QUATERNION):
        raise InputError(f"{path}: line 1: only {', '.join(there)}: allowed: {POSE_HEADER}, or without the last four")
    length = np.linalg.norm(tracker.stack(*quantity.QUATERNION), axis=1)
    worst = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[worst] - 1.0) > 0.1:
        value = f"quaternion of length {length[worst]:.3g} at t = {tracker.t[worst]:.6g} s"
        raise InputError(f"{path}: {value}: allowed: 1 +- 0.1")
