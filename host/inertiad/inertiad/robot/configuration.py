# SPDX-License-Identifier: Apache-2.0
"""robot.toml and its DBC files -> robot.cfg: an LCM-encoded robot_config_t and its CRC-32, all the daemon reads."""

import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.robot import dbc
from inertiad.robot.dbc import Binding
from inertiad.robot.description import Robot
from inertiad.robot.keys import TENSION_MAX_DEFAULT, Cable, Nominal, inertia_matrix
from inertiad_lcm import cable_config_t, robot_config_t, signal_config_t

ATTITUDE_SOURCE = {"quaternion": 1, "rpy": 2}
ATTITUDE_ESTIMATE = {"ahrs": 0, "fused": 1}
POSITION_SOURCE = {"tracker": 0, "fixed": 1, "can": 2}
FORCE_AT = {"platform": 0, "winch": 1}
DRIFT_TIME = 10800.0
"""s in which a force offset drifts by its own sigma, where nothing else is declared"""
GUESSED_DENSITY = 1000.0
"""kg/m3 of the cube that a platform of unknown weight would fill"""
WEIGHTS_HELD = 24.0
"""weights of the platform that all cables of a usual robot together could hold"""
GUESSED_INERTIA = 0.3
"""moment of inertia of an unknown platform, in units of its mass and its size squared"""
GUESSED_MASS_MIN = 50.0
"""kg: attachments close together may carry anything"""


def _padded(values: list[float] | None, n: int) -> list[float]:
    return [*(values or []), *[0.0] * (n - len(values or []))]


def _cable(cable: Cable | None) -> cable_config_t:
    result = cable_config_t()
    if cable is not None:
        for key in cable_config_t.__slots__:
            setattr(result, key, getattr(cable, key))
        result.force_at = FORCE_AT[cable.force_at]
    return result


def signed32(value: int) -> int:
    """The int32 with the same bits as an unsigned 32-bit number."""
    return value - (1 << 32) if value >= 1 << 31 else value


def _signal(binding: Binding | None) -> signal_config_t:
    result = signal_config_t()
    if binding is None:
        return result
    signal = binding.signal
    big_endian = signal.byte_order == "big_endian"
    result.quantity = quantity.QUANTITIES[binding.quantity]
    result.bus = binding.bus
    result.can_id = signed32(binding.can_id)
    result.frame_length = binding.message.length
    result.start, result.length = signal.start, signal.length
    result.big_endian, result.is_signed = big_endian, signal.is_signed
    result.kind = {False: result.INTEGER, True: result.FLOAT32 if signal.length == 32 else result.FLOAT64}[
        signal.is_float
    ]
    result.scale, result.offset = binding.scale, binding.offset
    result.minimum, result.maximum = binding.minimum, binding.maximum
    result.mux_start = -1
    if binding.mux is not None:
        mux, result.mux_value = binding.mux
        result.mux_start, result.mux_length = mux.start, mux.length
        result.mux_big_endian = mux.byte_order == "big_endian"
    return result


def theta_of(body: Nominal) -> np.ndarray:
    """m [kg], h = m rho [kg m] and J about P (xx yy zz yz xz xy) [kg m2] of a body, P axes."""
    rho = np.array(body.cog)
    J = inertia_matrix(body.inertia_cog) + body.mass * (rho @ rho * np.eye(3) - np.outer(rho, rho))
    return np.array([body.mass, *(body.mass * rho), J[0, 0], J[1, 1], J[2, 2], J[1, 2], J[0, 2], J[0, 1]])


def is_tension_declared(robot: Robot) -> bool:
    """Whether a cable has a tension_max of its own."""
    return any(cable.tension_max != TENSION_MAX_DEFAULT for cable in robot.cable)


def typical_mass(robot: Robot) -> float:
    """kg: the nominal mass, or a twenty-fourth of what all cables together could hold, or a guess from the size.

    Too heavy a guess costs accuracy only where it is hundreds of times too heavy: the noise level is learnt down from
    it to a hundredth.
    """
    if robot.nominal is not None:
        return robot.nominal.mass
    if not is_tension_declared(robot):
        return max(GUESSED_DENSITY * (2.0 * platform_size(robot)) ** 3, GUESSED_MASS_MIN)
    return sum(cable.tension_max for cable in robot.cable) / (WEIGHTS_HELD * max(robot.gravity, 1.0))


def platform_size(robot: Robot) -> float:
    """m: root mean square distance of the attachments from P, at least 1 cm."""
    return max(float(np.sqrt(np.mean([np.dot(c.attachment, c.attachment) for c in robot.cable]))), 0.01)


def prior(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Prior mean [10] and covariance [10, 10] of theta about P.

    Standard deviations, in units of the typical mass M and the platform size l: with a nominal body m 0.3 M, h 0.1 M l,
    moments 0.4 M l2, products 0.15 M l2; without one a guess +- 2 M, 2 M l, 2 M l2, 0.7 M l2.
    """
    mass, size = typical_mass(robot), platform_size(robot)
    guess = np.array([mass, 0.0, 0.0, 0.0, *([GUESSED_INERTIA * mass * size**2] * 3), 0.0, 0.0, 0.0])
    theta = guess if robot.nominal is None else theta_of(robot.nominal)
    share = (2.0, 2.0, 2.0, 0.7) if robot.nominal is None else (0.3, 0.1, 0.4, 0.15)
    estimator = robot.estimator
    given = (estimator.prior_mass_std, estimator.prior_h_std, estimator.prior_inertia_std, estimator.prior_product_std)
    unit = (mass, mass * size, mass * size**2, mass * size**2)
    std = [s * u if g is None else g for g, s, u in zip(given, share, unit, strict=True)]
    return theta, np.diag(np.square(np.repeat(std, [1, 3, 3, 3])))


def residual_std(robot: Robot) -> tuple[float, float]:
    """N and N m: long-run standard deviation of the windows' residual wrench, where the filter's noise level starts.

    Attitude wander turns the weight: M g times it, and it lasts for about nine windows, so three times that. 0.0001 of
    the weight is left for all else.
    """
    force = robot.estimator.force_std
    if force is None:
        weight = typical_mass(robot) * max(robot.gravity, 1.0)
        force = weight * float(np.hypot(3.0 * robot.std.attitude_wander, 1e-4))
    moment = robot.estimator.moment_std
    return force, 0.6 * platform_size(robot) * force if moment is None else moment


def std(robot: Robot) -> dict[str, float]:
    """[std], completed: what is left out follows from the robot's tensions and from where its force sensors sit."""
    if is_tension_declared(robot):
        offset, gain = 1e-3 * min(cable.tension_max for cable in robot.cable), 5e-3
    else:
        offset, gain = 0.1 * typical_mass(robot) * max(robot.gravity, 1.0) / robot.n_cables, 0.03
    offset = offset if robot.std.force_offset is None else robot.std.force_offset
    is_at_winch = any(cable.force_at == "winch" for cable in robot.cable)
    follows = {
        "force_offset": offset,
        "force_gain": gain,
        "force_offset_drift": offset / math.sqrt(DRIFT_TIME),
        "friction": 0.02 if is_at_winch else 5e-3,
    }
    return follows | robot.std.model_dump(exclude_none=True)


def delays(robot: Robot) -> dict[str, float]:
    """s: of imu, force, position and attitude, with what the sensors' low-passes and the calibration add."""
    align, calibration = robot.align, robot.calibration
    total = {}
    for sensor in ("imu", "force", "position", "attitude"):
        low_pass = getattr(align, f"filter_{sensor}")
        filtered = 0.0 if low_pass is None else low_pass.delay
        total[sensor] = getattr(align, f"delay_{sensor}") + filtered + getattr(calibration, f"{sensor}_delay", 0.0)
    return total


def _fill_sensors(config: robot_config_t, robot: Robot) -> None:
    config.imu_position, config.imu_orientation = robot.imu.position, robot.imu.orientation
    config.sample_rate = robot.imu.rate
    config.tracker_target = robot.tracker.target
    config.attitude_source = ATTITUDE_SOURCE[robot.attitude.source]
    follows = "ahrs" if robot.position.source == "fixed" else "fused"
    config.attitude_estimate = ATTITUDE_ESTIMATE[robot.attitude.estimate or follows]
    config.position_source = POSITION_SOURCE[robot.position.source]
    config.fixed_position = robot.position.fixed or [0.0, 0.0, 0.0]
    config.max_wait = robot.align.max_wait
    config.max_age = [robot.align.max_age_imu, robot.align.max_age_force, robot.align.max_age_position]
    config.max_carry = robot.align.max_carry
    delay = delays(robot)
    config.delay, config.delay_attitude = [delay[s] for s in ("imu", "force", "position")], delay["attitude"]


def _fill_calibration(config: robot_config_t, robot: Robot) -> None:
    calibration = robot.calibration
    config.acc_bias, config.gyro_bias = calibration.acc_bias, calibration.gyro_bias
    config.attitude_bias, config.world_yaw = calibration.attitude_bias, calibration.world_yaw
    config.force_offset = _padded(calibration.force_offset, robot_config_t.CABLES_MAX)
    config.force_gain = _padded(calibration.force_gain, robot_config_t.CABLES_MAX)
    if any(calibration.imu_alignment):
        _turn_imu(config, calibration.imu_alignment)
    left_over = calibration.std.model_dump(exclude_none=True)
    for key, value in (std(robot) | left_over).items():
        setattr(config, f"std_{key}", value)


def _turn_imu(config: robot_config_t, alignment: list[float]) -> None:
    """Turn the IMU's mounting by a rotation vector, P axes, rad, and with it the attitude it gives."""
    turn = Rotation.from_rotvec(alignment)
    orientation = turn * Rotation.from_quat(config.imu_orientation, scalar_first=True)
    config.imu_orientation = orientation.as_quat(scalar_first=True).tolist()


def _fill_estimator(config: robot_config_t, robot: Robot) -> None:
    estimator = robot.estimator
    force, moment = residual_std(robot)
    theta, covariance = prior(robot)
    config.window_length, config.estimate_rate = estimator.window_length, estimator.estimate_rate
    config.residual_covariance = np.diag(np.square([force] * 3 + [moment] * 3)).tolist()
    config.memory = estimator.memory
    config.prior_theta, config.prior_covariance = theta.tolist(), covariance.tolist()


def config_of(robot: Robot, bindings: list[Binding]) -> robot_config_t:
    """The daemon's configuration of a robot whose signals are bound."""
    config = robot_config_t()
    config.name = robot.name.encode().ljust(64, b"\0")
    config.gravity = robot.gravity
    config.n_cables = robot.n_cables
    config.cable = [_cable(c) for c in robot.cable] + [_cable(None)] * (robot_config_t.CABLES_MAX - robot.n_cables)
    config.n_signals = len(bindings)
    config.signal = [_signal(b) for b in bindings] + [_signal(None)] * (robot_config_t.SIGNALS_MAX - len(bindings))
    config.bus_bitrate = _padded([bus.bitrate for bus in robot.bus], 8)
    config.bus_data_bitrate = _padded([bus.data_bitrate for bus in robot.bus], 8)
    _fill_sensors(config, robot)
    _fill_calibration(config, robot)
    _fill_estimator(config, robot)
    return config


def to_bytes(config: robot_config_t) -> bytes:
    """LCM encoding followed by its CRC-32 (IEEE 802.3), big-endian."""
    payload: bytes = config.encode()
    return payload + zlib.crc32(payload).to_bytes(4, "big")


def compile_robot(robot: Robot, source: str) -> bytes:
    """Contents of robot.cfg. A robot without [[bus]] gets the layout of dbc.generate().

    InputError: see dbc.bind(); or the core, which checks it all again, refuses it.
    """
    data = to_bytes(config_of(robot, dbc.bind(robot, source)))
    try:
        inertiad_core.Config(data)
    except ValueError as error:
        raise InputError(f"{source}: {error}") from None
    return data


def _values(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every number of a message, by its path: cable[1].weight_per_length, f_3.scale."""
    if isinstance(value, signal_config_t):
        name = list(quantity.QUANTITIES)[value.quantity]
    if isinstance(value, (list, tuple)):
        for i, item in enumerate(value, 1):
            yield from _values(item, f"{name}[{i}]")
    elif hasattr(value, "__slots__"):
        for key in value.__slots__:
            yield from _values(getattr(value, key), f"{name}.{key}" if name else key)
    else:
        yield name, value


def differences(was: robot_config_t, now: robot_config_t) -> dict[str, str]:
    """Differences of two configurations by their path: "0.64, was 0.628". Indices count from 1.

    A number that differs by rounding, as processors with and without fused operations compile it, is the same.
    """
    pairs = zip(_values(now, ""), _values(was, ""), strict=True)
    return {name: f"{new!r}, was {old!r}" for (name, new), (_, old) in pairs if not _is_same(new, old)}


def _is_same(a: Any, b: Any) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-15)
    return bool(a == b)


def write(path: Path, robot: Robot, source: str) -> int:
    """Write robot.cfg; returns its number of bytes."""
    data = compile_robot(robot, source)
    path.write_bytes(data)
    return len(data)
