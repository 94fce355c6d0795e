# SPDX-License-Identifier: Apache-2.0
"""The sensors of firmware/robots/devices, emulated from their documents and encoded by cantools alone.

Takes what our simulator measures in SI and says what each device would send: its units, axes, counters, status. Nothing
here goes through our bindings, scales or packing, so that a run recorded this way tests them.

    python test/host/devices.py                     renew the short recordings in test/host/devices/
    python test/host/devices.py xsens_gsv4 RUN 50 30  simulate 30 s of turning in one place, 50 Hz, with these devices
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cantools
import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from inertiad.base import quantity
from inertiad.base.table import Array, Table
from inertiad.model import trajectory
from inertiad.model.trajectory import Trajectory
from inertiad.robot import description
from inertiad.robot.dbc import Binding
from inertiad.run.encode import Frames
from inertiad.simulate import sensor_models, simulator

TOP = Path(__file__).resolve().parents[2]
DEVICES = TOP / "firmware/robots/devices"
RECORDINGS = Path(__file__).with_name("devices")
SEED = 20180202

Values = dict[str, dict[str, Array]]
"""physical values [N] of each message's signals, in the units of the device's document"""

US = 1e6
NEWTON_PER_COUNT = 0.16
"""of the strain gauge amplifiers' channels, as xsens_gsv4.toml has it"""


def _ticks(t: Array) -> Array:
    """us in 32 bits."""
    return np.mod(np.rint(US * t), 2.0**32)


def _axes(prefix: str, signals: Table) -> dict[str, Array]:
    return {f"{prefix}_{a}": signals.columns[f"{prefix}_{a}"] for a in "xyz"}


def mti600(signals: Table, t: Array) -> Values:
    """Xsens MTi 600: rad/s, m/s2, quaternion to east north up, Euler angles in degrees."""
    n = np.arange(len(t))
    rpy = {name: np.rad2deg(signals.columns[name]) for name in quantity.RPY}
    return {
        "MTI_SAMPLE_TIME": {"time": _ticks(t)},
        "MTI_GROUP_COUNTER": {"counter": np.mod(65000.0 + n, 65536.0)},
        "MTI_STATUS": {"status": np.full(len(t), 3.0)},  # self-test passed, filter valid
        "MTI_QUATERNION": {name: signals.columns[name] for name in quantity.QUATERNION},
        "MTI_EULER": rpy,
        "MTI_RATE": _axes("gyro", signals),
        "MTI_ACCELERATION": _axes("acc", signals),
    }


def ellipse(signals: Table, t: Array) -> Values:
    """SBG Ellipse: attitude to north east down, where our world is north west up."""
    up_to_down = Rotation.from_euler("x", 180.0, degrees=True)
    attitude = up_to_down.inv() * Rotation.from_quat(signals.stack(*quantity.QUATERNION), scalar_first=True)
    q = attitude.as_quat(scalar_first=True, canonical=True).T
    yaw, pitch, roll = attitude.as_euler("ZYX").T
    warm = 31.0 + 4.0 * (1.0 - np.exp(-t / 60.0))
    return {
        "SBG_IMU_INFO": {"time": _ticks(t), "status": np.full(len(t), 0x007F), "temperature": warm},
        "SBG_IMU_ACCEL": _axes("acc", signals),
        "SBG_IMU_GYRO": _axes("gyro", signals),
        "SBG_EKF_INFO": {"time": _ticks(t)},
        "SBG_EKF_QUAT": {f"q_{i}": q[i] for i in range(4)},
        "SBG_EKF_EULER": {"roll": roll, "pitch": pitch, "yaw": yaw},
    }


def gsv4(signals: Table, t: Array) -> Values:
    """Two ME GSV-4: counts from the middle of the range."""
    counts = {i: signals.columns[f"f_{i + 1}"] / NEWTON_PER_COUNT for i in range(8)}
    return {
        f"GSV4_{name}_VALUES": {f"channel_{c + 1}": counts[4 * k + c] for c in range(4)} for k, name in enumerate("AB")
    }


def zc_sg(signals: Table, t: Array) -> Values:
    """Eight Seneca ZC-SG: N as float, and the converter's bits."""
    forces = {n: signals.columns[f"f_{n}"] for n in range(1, 9)}
    return {f"NODE_{n}_TPDO2": {"measure": f, "adc": np.rint(f / 0.4)} for n, f in forces.items()}


Emulator = Callable[[Table, Array], Values]
BUSES: dict[str, tuple[tuple[str, Emulator], ...]] = {
    "xsens_gsv4": (("xsens_mti600", mti600), ("me_gsv4", gsv4)),
    "sbg_canopen": (("sbg_ellipse", ellipse), ("seneca_zc_sg", zc_sg)),
}
"""robot description -> DBC file and device of each bus"""


def _encoded(bus: int, message: Message, values: dict[str, Array]) -> Frames:
    columns = {name: v.tolist() for name, v in values.items()}
    rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
    data = b"".join(message.encode(row, strict=True) for row in rows)
    payloads: NDArray[np.uint8] = np.frombuffer(data, dtype=np.uint8).reshape(-1, message.length)
    return Frames(bus, message.frame_id, False, payloads)


def _frames(name: str, signals: Table, t_device: Array) -> Iterator[Frames]:
    for bus, (dbc, emulate) in enumerate(BUSES[name]):
        database = cantools.database.load_file(DEVICES / f"{dbc}.dbc")
        values = emulate(signals, t_device)
        for message in sorted(database.messages, key=lambda m: m.frame_id):
            yield _encoded(bus, message, values[message.name])


def record(name: str, folder: Path, rate: float = 100.0, seed: int = SEED, hold: float = 0.0) -> None:
    """A run folder of CoGiRo with modern sensors of these makes, nobody having calibrated them.

    The paper's motion, or hold seconds of standing still.
    """
    file = DEVICES / f"{name}.toml"
    motion = "hold" if hold else "paper"
    path = trajectory.named(motion, "0,0,2,0,0,0", hold)
    _simulate(name, file, path, motion, folder, rate, seed)


def record_turning(name: str, folder: Path, rate: float, duration: float) -> None:
    """The same, turning about P, which stays at one place: no tracker is needed to know it."""
    folder.mkdir(parents=True)
    file, motion = folder / "fixed.toml", folder / "turning.csv"
    place = [0.0, 0.0, 2.0]
    file.write_text(f'base = "{DEVICES / name}.toml"\n[position]\nsource = "fixed"\nfixed = {place}\n')
    t = np.arange(0.0, duration + 0.01, 0.02)
    ramp = np.minimum(1.0, 0.5 * np.minimum(t, duration - t)) ** 2
    turns = [
        a * ramp * np.sin(2.0 * np.pi * f * t + f) for a, f in zip((0.12, 0.12, 0.2), (0.31, 0.37, 0.43), strict=True)
    ]
    rows = np.column_stack([t, *(np.full_like(t, x) for x in place), *turns])
    np.savetxt(motion, rows, "%.9f", ",", header="t,x,y,z,roll,pitch,yaw", comments="")
    _simulate(name, file, trajectory.read(motion), str(motion), folder, rate, SEED)


def _simulate(name: str, file: Path, path: Trajectory, motion: str, folder: Path, rate: float, seed: int) -> None:
    robot, level = description.load(file), sensor_models.faults("modern")
    body = simulator.body_of(robot, None, None)
    run = simulator.Run(file, robot, body, path, motion, level, "modern", rate, seed)

    def pack(_bindings: list[Binding], signals: Table, t_device: Array) -> list[Frames]:
        return list(_frames(name, signals, t_device))

    simulator.simulate(run, folder, lambda step: None, pack)


def recordings(folder: Path) -> Iterator[tuple[str, str]]:
    """File name and contents of the short recording of each device: 0.2 s at 50 Hz, made in folder."""
    for name, buses in BUSES.items():
        record(name, folder / name, 50.0, hold=0.2)
        lines = (folder / name / "can.log").read_text().splitlines(keepends=True)
        for bus, (dbc, _) in enumerate(buses):
            yield f"{dbc}.log", "".join(line for line in lines if f" can{bus} " in line)


if __name__ == "__main__":
    if len(sys.argv) == 5:
        record_turning(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
    else:
        import tempfile

        RECORDINGS.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory() as scratch:
            for file_name, text in recordings(Path(scratch)):
                (RECORDINGS / file_name).write_text(text)
