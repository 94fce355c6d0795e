# SPDX-License-Identifier: Apache-2.0
"""Pose of the platform from the IMU's attitude and the tracked point, as measured."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

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
