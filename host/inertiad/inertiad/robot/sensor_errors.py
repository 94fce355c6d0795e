# SPDX-License-Identifier: Apache-2.0
"""[std] and [calibration.std] of robot.toml: standard deviations of the errors of sensors and cables."""

from inertiad.robot.messages import Strict
from inertiad.robot.value_types import Sigma


class Std(Strict):
    """Sigmas of the errors after calibration. The defaults are a good modern set of sensors, not calibrated.

    None: follows from the robot's tensions, see configuration.std.
    """

    acc_bias: Sigma = 0.02
    gyro_bias: Sigma = 1.75e-4
    attitude: Sigma = 5.2e-3
    world_yaw: Sigma = 8.7e-3
    imu_alignment: Sigma = 3.5e-3
    imu_position: Sigma = 1e-3
    tracker_target: Sigma = 1e-3
    force_offset: Sigma | None = None
    force_gain: Sigma | None = None
    force_offset_drift: Sigma | None = None
    force_delay: Sigma = 1e-3
    position_delay: Sigma = 5e-3
    attitude_delay: Sigma = 5e-3
    friction: Sigma | None = None
    acc_scale: Sigma = 3e-3
    gyro_scale: Sigma = 3e-3
    external_force: Sigma | None = None
    external_stiffness: Sigma | None = None
    geometry: Sigma = 1e-3
    attitude_wander: Sigma = 1.75e-3


class LeftOver(Strict):
    """[calibration.std]: replaces entries of [std] by the sigmas after a calibration."""

    acc_bias: Sigma | None = None
    gyro_bias: Sigma | None = None
    attitude: Sigma | None = None
    world_yaw: Sigma | None = None
    imu_alignment: Sigma | None = None
    force_offset: Sigma | None = None
    force_gain: Sigma | None = None
    force_delay: Sigma | None = None
    position_delay: Sigma | None = None
    attitude_delay: Sigma | None = None
