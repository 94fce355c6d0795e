# SPDX-License-Identifier: Apache-2.0
"""Simulated runs for the acceptance table: made once per state of the simulator, kept in build/accept/runs."""

import json
import os
import shutil
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

TOP = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(TOP / "host/inertiad"), str(TOP / "build/python")]

import inertiad_core  # noqa: E402
from inertiad.base import quantity  # noqa: E402
from inertiad.model import random_errors, trajectory  # noqa: E402
from inertiad.robot import configuration, description  # noqa: E402
from inertiad.robot.description import Robot  # noqa: E402
from inertiad.robot.keys import Nominal  # noqa: E402
from inertiad.run import reader  # noqa: E402
from inertiad.simulate import sensor_models, simulator  # noqa: E402

COGIRO = TOP / "firmware/robots/cogiro/robot.toml"
OUT = TOP / "build/accept"


def _state_of_the_simulator() -> str:
    package = TOP / "host/inertiad/inertiad"
    modules = sorted([*package.glob("simulate/*.py"), *package.glob("model/*.py"), package / "run/encode.py"])
    robots = sorted(path for path in COGIRO.parent.iterdir() if path.suffix in (".toml", ".dbc"))
    return f"{zlib.crc32(b''.join(path.read_bytes() for path in [Path(__file__), *modules, *robots])):08x}"


RUNS = OUT / "runs" / _state_of_the_simulator()

BEST = sensor_models.PRESETS["modern"].model_copy(
    update={
        "force_offset": 0.3,
        "force_gain": 0.001,
        "attitude_bias_deg": 0.1,
        "attitude_wander_deg": 0.03,
        "geometry": 0.0003,
    }
)
"""tared forces, gains known to 0.1 %, attitude to 0.1 deg, attachments measured to 0.3 mm"""
LEVELS = {**sensor_models.PRESETS, "best": BEST}


def fourier(seed: int, duration: float = 21.0) -> trajectory.Spline:
    """A smooth motion of all six coordinates: five harmonics each, at rest at both ends."""
    dice = np.random.default_rng(seed)
    t = np.arange(0.0, duration + 2.0, 0.02)
    share = np.clip((t - 1.0) / duration, 0.0, 1.0)
    ramp = np.clip(np.minimum(share, 1.0 - share) / 0.12, 0.0, 1.0)
    ramp = ramp**4 * (35 - 84 * ramp + 70 * ramp**2 - 20 * ramp**3)
    x = np.tile([0.0, 0.0, 2.0, 0.0, 0.0, 0.0], (len(t), 1))
    for j, amplitude in enumerate([0.7, 0.7, 0.4, 0.32, 0.32, 0.45]):
        hz = np.array([0.12, 0.21, 0.33, 0.47, 0.6]) * (1.0 + 0.1 * dice.standard_normal(5))
        size = dice.uniform(0.4, 1.0, 5) / np.array([1.0, 1.2, 1.6, 2.2, 3.0])
        wave = (size[:, None] * np.sin(2 * np.pi * hz[:, None] * t + dice.uniform(0.0, 6.28, (5, 1)))).sum(axis=0)
        x[:, j] += amplitude * ramp * wave / np.abs(wave).max()
    q = Rotation.from_euler("ZYX", x[:, :2:-1]).as_quat(scalar_first=True)
    return trajectory.Spline(t, x[:, :3], q)


def body_of(theta: np.ndarray) -> Nominal:
    """The body with m, h, J about P [10]."""
    b = inertiad_core.body(theta, np.eye(10))
    return Nominal(mass=b["mass"], cog=list(b["cog"]), inertia_cog=list(b["inertia_cog"]))


def loaded(robot: Robot, mass: float) -> Nominal:
    """The nominal body with a box of that mass, 0.8 x 0.6 x 0.5 m, 0.2 m below P."""
    assert robot.nominal is not None
    box = Nominal(
        mass=mass, cog=[0.05, -0.03, -0.2], inertia_cog=[mass * v / 12.0 for v in (0.61, 0.89, 1.0)] + [0.0] * 3
    )
    return body_of(configuration.theta_of(robot.nominal) + configuration.theta_of(box))


def run(seed: int, level: str, rate: float, motion: str, mass: float = 0.0, errors_of: int | None = None) -> Path:
    """Folder of a simulated run. motion: paper or fourier, by seed. errors_of: another seed whose sensors measure."""
    folder = RUNS / f"{level}_{rate:g}_{motion}_{mass:g}_{seed}_{errors_of or seed}"
    if (folder / "truth.json").exists():
        return folder
    robot = description.load(COGIRO)
    assert robot.nominal is not None
    what = simulator.Run(
        robot_file=COGIRO,
        robot=robot,
        body=loaded(robot, mass) if mass else robot.nominal,
        trajectory=trajectory.paper() if motion == "paper" else fourier(seed),
        trajectory_name=motion,
        level=LEVELS[level],
        faults_name=level,
        rate=rate,
        seed=errors_of or seed,
    )
    unfinished = folder.with_name(f"{folder.name}.{os.getpid()}")
    simulator.simulate(what, unfinished, lambda _: None)
    try:
        unfinished.rename(folder)
    except OSError:  # another process was quicker
        shutil.rmtree(unfinished)
    return folder


def quiet_rows(level: str, rate: float, seed: int, motions: list[trajectory.Spline]) -> np.ndarray:
    """Rows [N, 13 + m] as aligned: acc, gyro, q, position, f, of motions one after the other.

    With the systematic errors drawn by seed and a true geometry of its own, without noise, wander, swing and delays.
    """
    robot, dice = description.load(COGIRO), random_errors.Dice(seed)
    still = {k: 0.0 for k in sensor_models.Faults.model_fields if "noise" in k}
    quiet = LEVELS[level].model_copy(
        update=still | {"attitude_wander_deg": 0.0, "cable_swing": 0.0, "tracker_delay": 0.0, "force_delay_max": 0.0}
    )
    drawn = sensor_models.draw(quiet, robot.n_cables, dice)
    true = simulator.with_true_geometry(robot, drawn)
    assert robot.nominal is not None
    mechanics = simulator.Mechanics(reader.config_of(true, ""), true, robot.nominal)
    parts = []
    for motion in motions:
        t = np.arange(int(motion.duration * rate)) / rate
        signals = simulator.measure_signals(robot, mechanics, motion, t, quiet, drawn, rate, dice)
        imu = signals.stack(*quantity.ACC, *quantity.GYRO, *quantity.QUATERNION)
        f = signals.stack(*quantity.forces(robot.n_cables))
        parts.append(np.hstack([imu, simulator.tracker_target(robot, motion.at(t)), f]))
    return np.concatenate(parts)


def noise_of(level: str, rate: float) -> list[float]:
    """One sigma per sample at rate [Hz] of acc, gyro, force, position, and attitude wander [rad], its time [s]."""
    k, white = LEVELS[level], np.sqrt(0.5 * rate)
    force = float(np.hypot(k.force_noise, k.force_noise_density * white))
    acc, gyro = k.acc_noise_density * white, np.deg2rad(k.gyro_noise_density_deg) * white
    return [acc, gyro, force, k.tracker_noise, np.deg2rad(k.attitude_wander_deg), k.attitude_wander_time]


def platform(folder: Path, robot: Robot | None = None) -> Any:
    """The daemon's pipeline after the run: its .estimate, .counters."""
    robot = robot or description.load(folder / "robot.toml")
    config = reader.config_of(robot, str(folder))
    return inertiad_core.read_run(config, [str(folder / "can.log")], [""], str(folder / "tracker.csv"))


def truth(folder: Path) -> np.ndarray:
    """m, rho, J_C [10]."""
    t = json.loads((folder / "truth.json").read_text())
    return np.array([t["mass"], *t["cog"], *t["inertia_cog"]])


def scaled(error: np.ndarray, true: np.ndarray) -> np.ndarray:
    """|error| of m in %, rho in mm, Jx Jy Jz in %: [..., 7]."""
    unit = np.r_[100.0 / true[0], 1e3, 1e3, 1e3, 100.0 / true[4:7]]
    return np.abs(error[..., :7]) * unit
