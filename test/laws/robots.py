# SPDX-License-Identifier: Apache-2.0
"""CoGiRo as a compiled configuration with every signal a float64 of its own frame, so that nothing is quantised."""

import struct
from pathlib import Path

import inertiad_core
from inertiad.robot import configuration, dbc, description
from inertiad_lcm import signal_config_t

COGIRO = Path(__file__).resolve().parents[2] / "firmware/robots/cogiro/robot.toml"
Q = inertiad_core.QUANTITIES
IMU, FORCE = 0x100, 0x200  # one FD frame each


def wide_signal(name, can_id, place):
    s = signal_config_t()
    s.quantity, s.can_id, s.frame_length = Q[name], can_id, 64
    s.start, s.length, s.kind, s.scale = 64 * place, 64, s.FLOAT64, 1.0
    s.mux_start = -1
    return s


def cogiro():
    """robot_config_t of CoGiRo; change fields, then Config(to_bytes())."""
    robot = description.load(COGIRO)
    config = configuration.config_of(robot, dbc.bind(robot, "robot.toml"))
    names = [f"{q}_{a}" for q in ("acc", "gyro") for a in "xyz"]
    signals = [wide_signal(name, IMU, i) for i, name in enumerate(names)]
    signals += [wide_signal(f"q_{a}", IMU + 1, i) for i, a in enumerate("wxyz")]
    signals += [wide_signal(f"f_{i + 1}", FORCE, i) for i in range(8)]
    config.n_signals = len(signals)
    config.signal = signals + [signal_config_t()] * (config.SIGNALS_MAX - len(signals))
    config.bus_bitrate = [0.0] * 8
    return config


def checked(config):
    return inertiad_core.Config(configuration.to_bytes(config))


def frames(acc, gyro, q, f):
    """The three frames of one sample as (can_id, data)."""
    yield IMU, struct.pack("<8d", *acc, *gyro, 0.0, 0.0)
    yield IMU + 1, struct.pack("<8d", *q, 0.0, 0.0, 0.0, 0.0)
    yield FORCE, struct.pack("<8d", *f)
