# SPDX-License-Identifier: Apache-2.0
"""Simulated runs: a trajectory, a rigid body, cables with pulleys and weight, sensors with faults -> a run folder.

    F   = m (f_P + alpha x rho + omega x (omega x rho))          f_P = R^T (a_P + g z)
    tau = m rho x f_P + J_P alpha + omega x J_P omega            platform axes, about P
    W f + sag = [F; tau],  tension_min <= f <= tension_max       W, sag from the C core
Tensions come in closed form, closest to an even pull; samples that break a limit get the nearest ones that do not, by a
quadratic programme in the null space of W.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import daqp
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad import compile, dbc, encode, quantity, sensors, tracker_csv
from inertiad.dbc import Binding
from inertiad.encode import Frames
from inertiad.error import InputError
from inertiad.estimate import read_json
from inertiad.robot import Nominal, Robot, inertia_matrix, read_data, read_toml, validate
from inertiad.sensors import Dice, Drawn, Faults
from inertiad.table import Array, Table
from inertiad.trajectory import Motion, Trajectory

START = 1.0
"""s, host time at which a run begins: early measurements must not reach back before 0."""

SAMPLES_MAX = 20_000_000

Progress = Callable[[str], None]
Pack = Callable[[list[Binding], Table, Array], list[Frames]]
"""Who makes frames of signals, as encode.pack() does."""


@dataclass(frozen=True)
class Mechanics:
    """The true robot: the compiled description with its true geometry, and the body that hangs on it."""

    config: Any
    """inertiad_core.Config"""
    robot: Robot
    """with the true anchors and attachments"""
    body: Nominal
    drawn: Drawn
    swing: float
    """rad, amplitude of the cables' lateral oscillation"""


def specific_force(motion: Motion, gravity: float, point: Array) -> Array:
    """What an ideal accelerometer at a platform point [3] measures, P axes, m/s2 [N, 3]."""
    f_P = np.einsum("nji,nj->ni", motion.R, motion.a + np.array([0.0, 0.0, gravity]))
    w = motion.omega
    return f_P + np.cross(motion.alpha, point) + np.cross(w, np.cross(w, point))


def required_wrench(motion: Motion, body: Nominal, gravity: float) -> Array:
    """Force and moment about P the cables must give, P axes, N and N m [N, 6]: Newton and Euler."""
    rho = np.array(body.cog)
    J_C = inertia_matrix(body.inertia_cog)
    force = body.mass * specific_force(motion, gravity, rho)
    spin = motion.alpha @ J_C + np.cross(motion.omega, motion.omega @ J_C)
    return np.hstack([force, spin + np.cross(rho, force)])


def _swing(mechanics: Mechanics, t: Array, motion: Motion) -> Array:
    """Change of the wrench matrix [N, 6, m] by the cables' lateral oscillation."""
    u = inertiad_core.cable_geometry(mechanics.config, motion.p, motion.R)[0]
    first = np.cross(u, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=2, keepdims=True)
    phase = 2.0 * np.pi * mechanics.drawn.swing_hz * t[:, None, None] + mechanics.drawn.swing_phase
    angle = mechanics.swing * np.sin(phase)
    tilt_W = angle[:, :, :1] * first + angle[:, :, 1:] * np.cross(u, first)
    tilt = np.einsum("nji,nkj->nki", motion.R, tilt_W)
    attachment = np.array([c.attachment for c in mechanics.robot.cable])
    return np.concatenate([tilt, np.cross(attachment, tilt)], axis=2).transpose(0, 2, 1)


def wrench_matrix(mechanics: Mechanics, t: Array, motion: Motion) -> tuple[Array, Array]:
    """W [N, 6, m] and sag [N, 6] about P at times t [N]. InputError where a cable has no direction."""
    try:
        W, sag = inertiad_core.wrench_matrix(mechanics.config, motion.p, motion.R, np.zeros(3))
    except ValueError as error:
        raise InputError(f"trajectory: {error}") from None
    if mechanics.swing > 0.0:
        W = W + _swing(mechanics, t, motion)
    return W, sag


def _even_pull(W: Array, wrench: Array, pull: Array) -> Array:
    """Tensions [N, m] with W f = wrench closest to pull [m]; least squares where the robot cannot give the wrench."""
    if W.shape[2] < 6:
        return np.einsum("nij,nj->ni", np.linalg.pinv(W), wrench)
    gap = wrench - W @ pull
    gram = W @ W.transpose(0, 2, 1)
    try:
        weight = np.linalg.solve(gram, gap[:, :, None])
    except np.linalg.LinAlgError:
        weight = np.linalg.pinv(gram) @ gap[:, :, None]
    return pull + (W.transpose(0, 2, 1) @ weight)[:, :, 0]


def _within_limits(W: Array, f: Array, low: Array, high: Array) -> Array | None:
    """The tensions closest to f [m] with the same wrench by W [6, m] and low <= f <= high, or None: there are none."""
    null = np.linalg.svd(W)[2][np.linalg.matrix_rank(W) :]
    if len(null) == 0:
        return None
    n = len(null)
    z, _, flag, _ = daqp.solve(
        np.eye(n),
        np.zeros(n),
        np.ascontiguousarray(null.T),
        high - f,
        low - f,
        np.zeros(len(f), dtype=np.int32),
    )
    return f + z @ null if flag == 1 else None


def tensions(mechanics: Mechanics, t: Array, motion: Motion) -> Array:
    """True cable tensions [N, m], N. InputError with time, cable and value where none are possible."""
    robot = mechanics.robot
    low = np.array([c.tension_min for c in robot.cable])
    high = np.array([c.tension_max for c in robot.cable])
    W, sag = wrench_matrix(mechanics, t, motion)
    wrench = required_wrench(motion, mechanics.body, robot.gravity) - sag
    share = 2.0 * mechanics.body.mass * robot.gravity / robot.n_cables
    f = _even_pull(W, wrench, np.clip(np.full(robot.n_cables, share), low, high))
    missing = np.abs((W @ f[:, :, None])[:, :, 0] - wrench).max(axis=1)
    if missing.max() > 1e-6 * np.abs(wrench).max():
        at = int(np.argmax(missing))
        raise InputError(
            f"trajectory: t = {t[at]:.3f} s: {robot.n_cables} cables cannot hold the platform in this pose and motion: "
            f"{missing[at]:.3g} N or N m is missing"
        )
    for k in np.flatnonzero(((f < low) | (f > high)).any(axis=1)):
        found = _within_limits(W[k], f[k], low, high)
        if found is None:
            raise InputError(_slack_message(robot, float(t[k]), f[k], low, high))
        f[k] = found
    return f


def _slack_message(robot: Robot, t: float, f: Array, low: Array, high: Array) -> str:
    worst = int(np.argmax(np.maximum(low - f, f - high)))
    cable = robot.cable[worst]
    return (
        f"trajectory: t = {t:.3f} s: no tensions within the limits hold the platform: "
        f"cable {worst + 1} = {f[worst]:.4g} N: allowed: {cable.tension_min:g} to {cable.tension_max:g} N"
    )


def _target(robot: Robot, motion: Motion) -> Array:
    return motion.p + motion.R @ np.array(robot.tracker.target)


def measure_signals(
    robot: Robot, mechanics: Mechanics, trajectory: Trajectory, t: Array, level: Faults, rate: float, dice: Dice
) -> Table:
    """What IMU and force sensors report at times t [N] of the trajectory, as a signals table in host time."""
    drawn = mechanics.drawn
    motion = trajectory.at(t)
    R_PI = Rotation.from_quat(robot.imu.orientation, scalar_first=True).as_matrix()
    s = specific_force(motion, robot.gravity, np.array(robot.imu.position))
    acc, gyro, q = sensors.measure_imu(s, motion.omega, motion.R, R_PI, level, drawn, rate, dice)
    earlier = np.maximum(t - drawn.force_delay, 0.0)
    f = sensors.measure_forces(tensions(mechanics, earlier, trajectory.at(earlier)), level, drawn, rate, dice)
    columns = dict(zip(quantity.ACC + quantity.GYRO + quantity.QUATERNION, np.hstack([acc, gyro, q]).T, strict=True))
    columns |= dict(zip(quantity.forces(robot.n_cables), f.T, strict=True))
    rpy = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")[:, ::-1]
    columns |= dict(zip(quantity.RPY, rpy.T, strict=True))
    if robot.position.source == "can":
        xyz = sensors.measure_positions(_target(robot, trajectory.at(t - level.tracker_delay)), level, dice)
        columns |= dict(zip(quantity.POSITION, xyz.T, strict=True))
    return Table(START + t, columns, "simulation")


def measure_tracker(robot: Robot, trajectory: Trajectory, level: Faults, dice: Dice) -> Table:
    """What the tracker reports, in host time."""
    t = np.arange(int(trajectory.duration * level.tracker_rate) + 1) / level.tracker_rate
    xyz = sensors.measure_positions(_target(robot, trajectory.at(t - level.tracker_delay)), level, dice)
    return Table(START + t, dict(zip(("x", "y", "z"), xyz.T, strict=True)), "simulation")


def frame_time(frames: Frames, bitrate: float, data_bitrate: float, stuffed: bool = False) -> float:
    """s that one frame takes on the bus, with none or the most stuff bits; FD frames switch to data_bitrate."""
    n = frames.data.shape[1]
    extended = 20 if frames.can_id & dbc.EXTENDED_ID else 0
    if frames.is_fd:
        data = 8 * n + (21 if n > 16 else 17) + 10
        return (29 + extended) / bitrate + data * (1.2 if stuffed else 1.0) / data_bitrate
    bits = 34 + extended + 8 * n
    return (bits + 13 + ((bits - 1) // 4 if stuffed else 0)) / bitrate


def _bus_stamps(robot: Robot, level: Faults, dice: Dice) -> encode.Stamp:
    """Stamps of frames that queue for the bus from their sample's time on, in order, plus lateness of the host."""

    def stamp(t: Array, frames: list[Frames]) -> list[NDArray[np.int64]]:
        bus = frames[0].bus
        rates = (robot.bus[bus].bitrate or 1e6, robot.bus[bus].data_bitrate) if robot.bus else (1e6, 5e6)
        load = sum(frame_time(f, *rates, stuffed=True) for f in frames) * (len(t) - 1) / (t[-1] - t[0])
        if load > 1.0:
            raise InputError(f"bus {bus}: {100 * load:.0f} % load at this --rate: allowed: up to 100 %")
        took = np.tile([frame_time(f, *rates) for f in frames], len(t))
        total = np.cumsum(took)
        end = total + np.maximum.accumulate(np.repeat(t, len(frames)) - (total - took))
        late = end + dice[f"stamp_jitter_{bus}"].exponential(level.stamp_jitter, len(end))
        t_us = np.rint(1e6 * np.maximum.accumulate(late)).astype(np.int64)
        return list(t_us.reshape(len(t), len(frames)).T)

    return stamp


def _truly(robot: Robot, drawn: Drawn) -> Robot:
    """The robot with its true geometry."""
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


def truth_of(mechanics: Mechanics, settings: dict[str, Any], level: Faults) -> dict[str, Any]:
    """Contents of truth.json: everything that was put in and can be compared with an estimate."""
    drawn = mechanics.drawn
    return {
        "convention": "SI; P to C; inertia about C as matrix entries xx yy zz yz xz xy, platform axes",
        **mechanics.body.model_dump(),
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
    """What to simulate."""

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


def body_of(robot: Robot, robot_file: Path, file: Path | None, mass: float | None) -> Nominal:
    """The true body: from a TOML or JSON file with mass, cog, inertia_cog, else [nominal]; mass [kg] replaces its mass.

    InputError: no body given, or one that cannot exist.
    """
    if file is not None:
        body = validate(Nominal, read_json(file) if file.suffix == ".json" else read_toml(file), str(file))
    elif robot.nominal is not None:
        body = robot.nominal
    else:
        raise InputError(f"{robot_file}: no [nominal] body: allowed: with --body FILE")
    return body if mass is None else validate(Nominal, body.model_dump() | {"mass": mass}, "--mass")


def _sample_times(run: Run) -> Array:
    n = int(run.trajectory.duration * run.rate + 1e-9) + 1
    if not 2 <= n <= SAMPLES_MAX:
        raise InputError(f"{n} samples at {run.rate:g} Hz: allowed: 2 to {SAMPLES_MAX}")
    return np.arange(n) / run.rate


def simulate(run: Run, folder: Path, progress: Progress, pack: Pack = encode.pack) -> int:
    """Simulate a run into a folder: robot.toml, DBC, can.log, tracker.csv, truth.json. Returns the number of frames.

    Same run, same files, byte for byte. InputError: no possible tensions, a value that does not fit its CAN signal, an
    overloaded bus.
    """
    robot, level, dice, source = run.robot, run.level, Dice(run.seed), str(run.robot_file)
    progress("bind signals")
    bindings = dbc.bind(robot, source)
    drawn = sensors.draw(level, robot.n_cables, dice)
    true_robot = _truly(robot, drawn)
    config = inertiad_core.Config(compile.compile_robot(true_robot, source))
    mechanics = Mechanics(config, true_robot, run.body, drawn, level.cable_swing)
    t = _sample_times(run)
    progress("move the platform")
    signals = measure_signals(robot, mechanics, run.trajectory, t, level, run.rate, dice)
    progress("pack frames")
    frames = pack(bindings, signals, (1.0 + drawn.clock_drift) * t)
    encode.open_run(folder)
    progress("write files")
    description = {"std": data_sheet(level)} | read_data(run.robot_file)
    encode.write_robot(folder, robot, description, bitrate=None if level.bus_timing else 0.0)
    if robot.position.source == "tracker":
        tracker_csv.write(folder / "tracker.csv", measure_tracker(robot, run.trajectory, level, dice))
    settings = {
        "trajectory": run.trajectory_name,
        "rate": run.rate,
        "duration_s": run.trajectory.duration,
        "seed": run.seed,
        "faults_name": run.faults_name,
        "faults": level.model_dump(),
    }
    (folder / "truth.json").write_text(json.dumps(truth_of(mechanics, settings, level), indent=1) + "\n")
    stamp = _bus_stamps(robot, level, dice) if level.bus_timing else encode.stamp_exactly
    return encode.write_can_log(folder / "can.log", signals.t, frames, stamp)
