# SPDX-License-Identifier: Apache-2.0
"""Pose of the platform from the IMU's attitude and the tracked point, as measured, and where its cables are then."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.table import Array


def platform_pose(
    q: Array, position: Array, imu_orientation: Sequence[float], target: Sequence[float]
) -> tuple[Array, Rotation]:
    """Position of P [N, 3] m in W and the N rotations P to W.

    q [N, 4] w x y z, I to W, none zero; position [N, 3] of the tracked point, W, m; imu_orientation [4] w x y z,
    I to P; target [3] of the tracked point in P, m.
    """
    turn = Rotation.from_quat(q, scalar_first=True) * Rotation.from_quat(imu_orientation, scalar_first=True).inv()
    return np.asarray(position - turn.apply(target)), turn


def cable_ends(core: Any, attachment: Array, anchor: Array, p: Array, R: Array) -> tuple[Array, Array]:
    """Both ends of the cables [N, m, 3] in W, m: at the platform, and where they leave their pulleys.

    core: inertiad_core.Config; attachment [m, 3] in P and anchor [m, 3] in W, m; p [N, 3] m; R [N, 3, 3] P to W.
    Where a cable has no direction all end at their anchors.
    """
    corner = p[:, None] + np.einsum("kij,nj->kni", R, attachment)
    try:
        u, free, _ = inertiad_core.cable_geometry(core, np.ascontiguousarray(p), np.ascontiguousarray(R))
    except ValueError:
        return corner, np.broadcast_to(anchor, corner.shape)
    return corner, np.asarray(corner + u * free[:, :, None])
