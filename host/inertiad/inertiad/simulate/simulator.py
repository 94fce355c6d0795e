# SPDX-License-Identifier: Apache-2.0
"""Simulated runs: a trajectory, a rigid body, cables with pulleys and weight, sensors with faults -> a run folder.

    trajectory -> motion and tensions -> what sensors measure -> CAN frames -> when they get through -> files
The platform is where the trajectory says, with the tensions that takes (inverse_dynamics.py), or moves by its own
dynamics under a controller (forward_dynamics.py).
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.table import Array, Table
from inertiad.base.text_files import read_json, read_toml
from inertiad.model import forward_dynamics, payload
from inertiad.model.forward_dynamics import Moved, Plant
from inertiad.model.inverse_dynamics import Mechanics, specific_force, tensions
from inertiad.model.payload import Payload
from inertiad.model.random_errors import Dice
from inertiad.model.trajectory import Motion, Trajectory
from inertiad.robot import configuration, dbc, stand_in
from inertiad.robot.dbc import Binding
from inertiad.robot.description import Robot, read_data
from inertiad.robot.keys import Nominal
from inertiad.robot.messages import validate
from inertiad.run import encode, tracker_csv
from inertiad.run import folder as run_folder
from inertiad.run.encode import Frames
from inertiad.simulate import bus_timing, sensor_models
from inertiad.simulate.sensor_models import Drawn, Faults, Freezer, Noise

START = 1.0
"""s, host time at which a run begins: early measurements must not reach back before 0."""

SAMPLES_MAX = 20_000_000

Progress = Callable[[str], None]
Pack = Callable[[list[Binding], Table, Array], list[Frames]]
"""A function that packs signals into frames, as encode.pack() does."""


def tracker_target(robot: Robot, motion: Motion) -> Array:
    """Position of the tracker's target during a motion, m [N, 3], world axes."""
    return motion.p + motion.R @ np.array(robot.tracker.target)


def _tensions(mechanics: Mechanics, trajectory: Trajectory, t: Array) -> Array:
    """True tensions [N, m] at times t [N]: those of the motion, or those that make it so."""
    if isinstance(trajectory, Moved):
        return trajectory.tensions(t)
    return tensions(mechanics, t, trajectory.at(t))


def measure_signals(
    robot: Robot,
    mechanics: Mechanics,
    trajectory: Trajectory,
    t: Array,
    level: Faults,
    drawn: Drawn,
    rate: float,
    dice: Dice,
) -> Table:
    """Simulated IMU and force samples at times t [N] of the trajectory, as a signals table in host time."""
    noise = sensor_models.draw_noise(level, len(t), robot.n_cables, rate, dice)
    f = _tensions(mechanics, trajectory, np.maximum(t - drawn.force_delay, 0.0))
    return sample(robot, trajectory, f, t, Freezer(level), level, drawn, noise)


def sample(
    robot: Robot,
    trajectory: Trajectory,
    f: Array,
    t: Array,
    freezer: Freezer,
    level: Faults,
    drawn: Drawn,
    noise: Noise,
) -> Table:
    """measure_signals() of samples whose noise and tensions f [N, m], as old as the sensors give them, are known."""
    motion = trajectory.at(t)
    R_PI = Rotation.from_quat(robot.imu.orientation, scalar_first=True).as_matrix()
    s = specific_force(motion, robot.gravity, np.array(robot.imu.position))
    acc, gyro, q = sensor_models.measure_imu(s, motion.omega, motion.R, R_PI, drawn, noise)
    f = sensor_models.measure_forces(f, drawn, noise)
    columns = dict(zip(quantity.ACC + quantity.GYRO + quantity.QUATERNION, np.hstack([acc, gyro, q]).T, strict=True))
    columns |= dict(zip(quantity.forces(robot.n_cables), f.T, strict=True))
    rpy = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")[:, ::-1]
    columns |= dict(zip(quantity.RPY, rpy.T, strict=True))
    if robot.position.source == "can":
        xyz = tracker_target(robot, trajectory.at(t - level.tracker_delay)) + noise.position
        columns |= dict(zip(quantity.POSITION, xyz.T, strict=True))
    return Table(START + t, freezer.freeze(t, columns), "simulation")


def measure_tracker(robot: Robot, trajectory: Trajectory, level: Faults, dice: Dice) -> Table:
    """Simulated tracker positions, in host time."""
    t = np.arange(int(trajectory.duration * level.tracker_rate) + 1) / level.tracker_rate
    xyz = sensor_models.measure_positions(tracker_target(robot, trajectory.at(t - level.tracker_delay)), level, dice)
    seen = ~sensor_models.out_of_sight(level, t, dice)
    return Table(START + t[seen], dict(zip(("x", "y", "z"), xyz[seen].T, strict=True)), "simulation")


def with_true_geometry(robot: Robot, drawn: Drawn) -> Robot:
    """The robot as it is: its cables' ends off from the description by the errors drawn."""
    cables = [
        cable.model_copy(
            update={
                "anchor": (np.array(cable.anchor) + drawn.anchor_error[i]).tolist(),
                "attachment": (np.array(cable.attachment) + drawn.attachment_error[i]).tolist(),
            }
        )
        for i, cable in enumerate(robot.cable)
    ]
    return robot.model_copy(update={"cable": cables})


def data_sheet(level: Faults) -> dict[str, float]:
    """[std] of a robot with such sensors, for a run whose robot.toml has none."""
    deg = np.pi / 180.0
    return {
        "acc_bias": level.acc_bias,
        "gyro_bias": level.gyro_bias_deg * deg,
        "attitude": level.attitude_bias_deg * deg,
        "world_yaw": level.world_yaw_deg * deg,
        "imu_alignment": level.imu_alignment_deg * deg,
        "imu_position": level.geometry,
        "force_offset": level.force_offset,
        "force_gain": level.force_gain,
        "force_delay": level.force_delay_max,
        "position_delay": level.tracker_delay,
        "geometry": level.geometry,
        "attitude_wander": level.attitude_wander_deg * deg,
    }


def _payloads_of(mechanics: Mechanics) -> dict[str, Any]:
    """The body at the end, as which truth.json is compared with an estimate, and how it came about."""
    if not mechanics.payloads:
        return mechanics.body.model_dump()
    changes = [p.theta for p in mechanics.payloads]
    return {
        **payload.body_of(configuration.theta_of(mechanics.body) + sum(changes)).model_dump(),
        "body_at_start": mechanics.body.model_dump(),
        "payload": [{"t": p.time, "ramp": p.ramp, "theta": p.theta.tolist()} for p in mechanics.payloads],
    }


def truth_of(mechanics: Mechanics, drawn: Drawn, settings: dict[str, Any], level: Faults) -> dict[str, Any]:
    """Contents of truth.json: everything that was put in and can be compared with an estimate.

    mass, cog, inertia_cog are those at the end; with a payload, body_at_start and the changes (m, h, J about P) follow.
    """
    return {
        "convention": "SI; P to C; inertia about C as matrix entries xx yy zz yz xz xy, platform axes",
        **_payloads_of(mechanics),
        "force_offset": drawn.force_offset.tolist(),
        "force_gain": drawn.force_gain.tolist(),
        "acc_bias": drawn.acc_bias.tolist(),
        "gyro_bias": drawn.gyro_bias.tolist(),
        "imu_alignment": drawn.imu_alignment.tolist(),
        "attitude_bias": drawn.attitude_bias.tolist(),
        "world_yaw": drawn.world_yaw,
        "force_delay": drawn.force_delay,
        "position_delay": level.tracker_delay,
        "anchor": [c.anchor for c in mechanics.robot.cable],
        "attachment": [c.attachment for c in mechanics.robot.cable],
        **settings,
    }


@dataclass(frozen=True)
class Run:
    """Settings of a simulation."""

    robot_file: Path
    robot: Robot
    body: Nominal
    trajectory: Trajectory
    trajectory_name: str
    level: Faults
    faults_name: str
    rate: float
    """Hz of IMU and forces"""
    seed: int
    plant: Plant | None = None
    """how the platform moves; None: exactly as the trajectory says"""
    payloads: tuple[Payload, ...] = ()


@dataclass(frozen=True)
class Simulated:
    """Result of a simulation."""

    n_frames: int
    """in can.log"""
    remarks: list[str]
    """notes on the motion"""


def body_of(robot: Robot, file: Path | None, mass: float | None) -> Nominal:
    """The true body: from a TOML or JSON file with mass, cog, inertia_cog, else [nominal] or a stand-in.

    mass [kg] replaces its mass. InputError: a body that cannot exist.
    """
    if file is not None:
        body = validate(Nominal, read_json(file) if file.suffix == ".json" else read_toml(file), str(file))
    elif robot.nominal is not None:
        body = robot.nominal
    else:
        body, _ = stand_in.body_of(robot)
    return body if mass is None else validate(Nominal, body.model_dump() | {"mass": mass}, "--mass")


def sample_times(run: Run) -> Array:
    """s [N] from the start of the motion. InputError: too few or too many."""
    n = int(run.trajectory.duration * run.rate + 1e-9) + 1
    if not 2 <= n <= SAMPLES_MAX:
        raise InputError(f"{n} samples at {run.rate:g} Hz: allowed: 2 to {SAMPLES_MAX}")
    return np.arange(n) / run.rate


def mechanics_of(run: Run, drawn: Drawn) -> Mechanics:
    """The true robot with the errors drawn."""
    true_robot = with_true_geometry(run.robot, drawn)
    config = inertiad_core.Config(configuration.compile_robot(true_robot, str(run.robot_file)))
    return Mechanics(config, true_robot, run.body, drawn.swing, run.payloads)


def check_sensors(run: Run) -> None:
    """InputError: a fault of a sensor that the robot does not have."""
    for key in ("stuck", "silent"):
        name = getattr(run.level, key)
        if name.startswith("f_") and name not in quantity.forces(run.robot.n_cables):
            raise InputError(f'{run.faults_name}: {key} = "{name}": allowed: f_1 to f_{run.robot.n_cables}')


def device_time(level: Faults, drawn: Drawn, t: Array) -> Array:
    """The sensors' clock [N] at times t [N] of the motion, s."""
    return (1.0 + drawn.clock_drift) * t + level.clock_step * (t >= level.fault_start)


def _description(run: Run) -> dict[str, Any]:
    """robot.toml of the run folder: with the sensors' data sheet where it has no [std] of its own."""
    return {"std": data_sheet(run.level)} | read_data(run.robot_file)


def _settings(run: Run, path: Trajectory) -> dict[str, Any]:
    moved = {}
    if isinstance(path, Moved):
        moved = {
            "strays": path.strays,
            "tension": {"min": float(path.f.min()), "max": float(path.f.max())},
            "n_infeasible": path.n_infeasible,
        }
    return {
        "trajectory": run.trajectory_name,
        "rate": run.rate,
        "duration_s": run.trajectory.duration,
        "seed": run.seed,
        "faults_name": run.faults_name,
        "faults": run.level.model_dump(),
        "plant": run.plant.model_dump() if run.plant else "exact",
        **moved,
    }


def _path(run: Run, mechanics: Mechanics) -> tuple[Trajectory, list[str]]:
    """The motion of the platform, and notes on it."""
    if run.plant is None:
        return run.trajectory, []
    believed = forward_dynamics.believed_by_controller(run.robot, str(run.robot_file), mechanics)
    moved = forward_dynamics.move(mechanics, believed, run.trajectory, run.plant, run.rate)
    return moved, forward_dynamics.summary(moved, run.robot)


def simulate(run: Run, folder: Path, progress: Progress, pack: Pack = encode.pack) -> Simulated:
    """Simulate a run into a folder: robot.toml, DBC, can.log, tracker.csv, truth.json.

    Same run, same files, byte for byte. InputError: no possible tensions, a value that does not fit its CAN signal, an
    overloaded bus.
    """
    robot, level, dice, source = run.robot, run.level, Dice(run.seed), str(run.robot_file)
    progress("bind signals")
    check_sensors(run)
    bindings = dbc.bind(robot, source)
    drawn = sensor_models.draw(level, robot.n_cables, dice)
    mechanics, t = mechanics_of(run, drawn), sample_times(run)
    progress("move the platform")
    path, remarks = _path(run, mechanics)
    signals = measure_signals(robot, mechanics, path, t, level, drawn, run.rate, dice)
    progress("pack frames")
    frames = pack(bindings, signals, device_time(level, drawn, t))
    run_folder.open_run(folder)
    progress("write files")
    run_folder.write_robot(folder, robot, _description(run), bitrate=None if level.bus_timing else 0.0)
    if robot.position.source == "tracker":
        tracker_csv.write(folder / "tracker.csv", measure_tracker(robot, path, level, dice))
    truth = truth_of(mechanics, drawn, _settings(run, path), level)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    stamp = bus_timing.traffic(robot, bindings, level, START, dice)
    return Simulated(encode.write_can_log(folder / "can.log", signals.t, frames, stamp), remarks)
