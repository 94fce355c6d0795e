# SPDX-License-Identifier: Apache-2.0
"""Tracker CSV: t,x,y,z; s and m, world frame, of the tracked point."""

from pathlib import Path

import numpy as np

from inertiad import table
from inertiad.error import InputError
from inertiad.table import Table

HEADER = "t,x,y,z"
FAR = 100.0
"""m: a tracked position beyond this is most likely in mm."""


def write(path: Path, tracker: Table) -> None:
    """Write the tracker's positions: s to the microsecond, m to the nanometre."""
    rows = np.column_stack([tracker.t, tracker.stack("x", "y", "z")])
    np.savetxt(path, rows, fmt=["%.6f", "%.9f", "%.9f", "%.9f"], delimiter=",", header=HEADER, comments="")


def read(path: Path) -> Table:
    """A tracker CSV. InputError: see table.read(); also for positions that look like mm."""
    tracker = table.read(path, ["t", "x", "y", "z"])
    for name in ("x", "y", "z"):
        if name not in tracker.columns:
            raise InputError(f"{path}: line 1: no column {name}: allowed: {HEADER}")
        worst = int(np.argmax(np.abs(tracker.columns[name])))
        if abs(tracker.columns[name][worst]) > FAR:
            value = f"{name} = {tracker.columns[name][worst]:.6g} m at t = {tracker.t[worst]:.6g} s"
            raise InputError(f"{path}: {value}: allowed: within {FAR:g} m; is the file in mm?")
    if tracker.t[0] < 0.0:
        raise InputError(f"{path}: t = {tracker.t[0]:g} s: allowed: 0 and later")
    return tracker
