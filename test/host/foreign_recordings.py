# SPDX-License-Identifier: Apache-2.0
"""The same motion as other tools record it: IMU at 200 Hz, four forces at 50 Hz, positions at 100 Hz."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

T = {
    "imu": 1.0 + np.arange(400) / 200.0,
    "force": 1.0025 + np.arange(100) / 50.0,
    "pos": 1.001 + np.arange(200) / 100.0,
}
"""s, of each sensor"""
ACC = np.column_stack([0.3 * np.sin(T["imu"]), 0.2 * np.cos(T["imu"]), 9.8 + 0.1 * np.sin(3 * T["imu"])])
GYRO = np.column_stack([0.1 * np.sin(T["imu"]), 0.2 * np.cos(T["imu"]), 0.05 * np.sin(2 * T["imu"])])
ANGLE = 0.2 * np.sin(T["imu"])
QUAT = np.column_stack([np.cos(ANGLE / 2), np.sin(ANGLE / 2), 0 * ANGLE, 0 * ANGLE])
FORCE = 100.0 + 20.0 * np.sin(np.outer(T["force"], [1.0, 2.0, 3.0, 0.5]))
POSITION = np.column_stack([np.sin(T["pos"]), np.cos(T["pos"]), 1.0 + 0.1 * T["pos"]])


def parquet(path: Path) -> Path:
    """One table with null where a sensor has no sample, as merged data frames have; accelerations in g."""
    import pyarrow
    import pyarrow.parquet

    every = np.unique(np.concatenate(list(T.values())))
    columns: dict[str, Any] = {"timestamp": pyarrow.array(np.rint(1e9 * every).astype("datetime64[ns]"))}
    named = {
        "imu": {
            **{f"accel_{a} [g]": ACC[:, k] / 9.80665 for k, a in enumerate("xyz")},
            **{f"gyro_{a} [rad/s]": GYRO[:, k] for k, a in enumerate("xyz")},
            **{f"quat_{a}": QUAT[:, k] for k, a in enumerate("wxyz")},
        },
        "force": {f"load_cell_{k + 1} [kN]": 1e-3 * FORCE[:, k] for k in range(4)},
        "pos": {f"position_{a} [mm]": 1e3 * POSITION[:, k] for k, a in enumerate("xyz")},
    }
    for sensor, own in named.items():
        at = np.searchsorted(every, T[sensor])
        for name, values in own.items():
            whole = np.full(len(every), np.nan)
            whole[at] = values
            columns[name] = pyarrow.array(whole, mask=np.isnan(whole))
    columns["comment"] = pyarrow.array(["run"] * len(every))
    pyarrow.parquet.write_table(pyarrow.table(columns), path, write_page_checksum=True)
    return path


def _structs() -> dict[str, dict[str, np.ndarray]]:
    column = {name: t.reshape(-1, 1) for name, t in T.items()}
    return {
        "imu": {"time": column["imu"], "acc": ACC, "gyro": GYRO, "quat": QUAT},
        "loads": {"t": column["force"], "force": FORCE},
        "tracker_data": {"t": 1e3 * column["pos"], "position": POSITION},
    }


def mat5(path: Path) -> Path:
    """A struct per sensor, as logging in MATLAB gives them; the tracker's time in ms, named so."""
    from scipy.io import savemat

    structs = _structs()
    structs["tracker_data"]["time_ms"] = structs["tracker_data"].pop("t")
    structs["tracker_data"]["t"] = 1e-3 * structs["tracker_data"].pop("time_ms")
    savemat(path, {**structs, "note": "a run", "settings": {"rate": 200.0}}, do_compression=True)
    return path


def mat73(path: Path) -> Path:
    """The same as MATLAB 7.3 writes it: HDF5, transposed, behind a head of 512 bytes."""
    import h5py

    structs = _structs()
    structs["tracker_data"]["t"] = 1e-3 * structs["tracker_data"]["t"]
    with h5py.File(path, "w", userblock_size=512) as file:
        for struct, members in structs.items():
            for name, values in members.items():
                file[f"{struct}/{name}"] = values.T
        file["#refs#/a"] = np.zeros(3)
    data = bytearray(path.read_bytes())
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 ."
    data[: len(head)] = head
    path.write_bytes(data)
    return path


def mf4(path: Path) -> Path:
    """A channel group per sensor with units, as measurement systems write them."""
    from asammdf import MDF, Signal

    groups = (
        ("imu", "imu", [(f"IMU_Acc{a}", "m/s²", ACC[:, k]) for k, a in enumerate("XYZ")]),
        ("rates", "imu", [(f"IMU_Gyro{a}", "°/s", np.rad2deg(GYRO[:, k])) for k, a in enumerate("XYZ")]),
        ("attitude", "imu", [(f"Quat_{a}", "", QUAT[:, k]) for k, a in enumerate("WXYZ")]),
        ("loads", "force", [(f"Force {k + 1}", "kN", 1e-3 * FORCE[:, k]) for k in range(4)]),
        ("tracker6d", "pos", [(f"Position {a}", "mm", 1e3 * POSITION[:, k]) for k, a in enumerate("XYZ")]),
    )
    with MDF(version="4.10") as mdf:
        for name, sensor, channels in groups:
            signals = [Signal(v, T[sensor], unit=unit, name=channel) for channel, unit, v in channels]
            mdf.append(signals, acq_name=name, common_timebase=True)
        mdf.save(path, overwrite=True, compression=1)
    return path


def _messages() -> list[tuple[float, str, dict[str, Any]]]:
    """Time, topic, content, in the order in which a recorder gets them."""
    found: list[tuple[float, str, dict[str, Any]]] = []
    for k, t in enumerate(T["imu"]):
        content = {
            "header": {"stamp": {"sec": int(t), "nanosec": round(1e9 * (t - int(t)))}, "frame_id": "imu"},
            "linear_acceleration": dict(zip("xyz", ACC[k].tolist(), strict=True)),
            "angular_velocity": dict(zip("xyz", GYRO[k].tolist(), strict=True)),
            "orientation": dict(zip("wxyz", QUAT[k].tolist(), strict=True)),
        }
        found.append((t, "/imu/data", content))
    found += [(t, "/forces", {"data": FORCE[k].tolist()}) for k, t in enumerate(T["force"])]
    for k, t in enumerate(T["pos"]):
        found.append((t, "/tracker/pose", {"position": dict(zip("xyz", POSITION[k].tolist(), strict=True))}))
    return sorted(found, key=lambda one: one[0])


def mcap_json(path: Path) -> Path:
    """JSON messages; the IMU's carry their own stamp and are logged 3 ms late."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for t, topic, content in _messages():
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            logged = round(1e9 * t) + (3_000_000 if "header" in content else 0)
            writer.add_message(channels[topic], logged, json.dumps(content).encode(), logged)
        writer.finish()
    return path


def mcap_protobuf(path: Path) -> Path:
    """Protobuf messages: IMU and forces of types of their own, positions as Foxglove's PoseInFrame."""
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap_protobuf.writer import Writer

    file = descriptor_pb2.FileDescriptorProto(name="lab.proto", package="lab", syntax="proto3")
    kind = descriptor_pb2.FieldDescriptorProto
    vector = file.message_type.add(name="Vector")
    for number, axis in enumerate("xyzw", 1):
        vector.field.add(name=axis, number=number, type=kind.TYPE_DOUBLE, label=kind.LABEL_OPTIONAL)
    imu = file.message_type.add(name="Imu")
    for number, name in enumerate(("linear_acceleration", "angular_velocity", "orientation"), 1):
        imu.field.add(
            name=name, number=number, type=kind.TYPE_MESSAGE, type_name=".lab.Vector", label=kind.LABEL_OPTIONAL
        )
    forces = file.message_type.add(name="Forces")
    forces.field.add(name="data", number=1, type=kind.TYPE_DOUBLE, label=kind.LABEL_REPEATED)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    Imu, Forces = (message_factory.GetMessageClass(pool.FindMessageTypeByName(f"lab.{n}")) for n in ("Imu", "Forces"))
    with path.open("wb") as stream, Writer(stream) as writer:
        for t, topic, content in _messages():
            content.pop("header", None)
            stamp = round(1e9 * t)
            if topic == "/imu/data":
                message: Any = Imu(**content)
            elif topic == "/forces":
                message = Forces(**content)
            else:
                message = PoseInFrame(frame_id="world", pose={"position": content["position"]})
                message.timestamp.FromNanoseconds(stamp)
                stamp += 5_000_000
            writer.write_message(topic, message, log_time=stamp, publish_time=stamp)
    return path


def rosbag2(path: Path) -> Path:
    """Imu, PoseStamped and Float64MultiArray, as ros2 bag records them."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    of = store.types
    stamp = lambda t: of["builtin_interfaces/msg/Time"](int(t), round(1e9 * (t - int(t))))  # noqa: E731
    head = lambda t: of["std_msgs/msg/Header"](stamp(t), "x")  # noqa: E731
    vector, quaternion = of["geometry_msgs/msg/Vector3"], of["geometry_msgs/msg/Quaternion"]
    layout = of["std_msgs/msg/MultiArrayLayout"]([], 0)
    none = np.zeros(9)
    kinds = {
        "/imu/data": "sensor_msgs/msg/Imu",
        "/forces": "std_msgs/msg/Float64MultiArray",
        "/tracker/pose": "geometry_msgs/msg/PoseStamped",
    }
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for t, topic, content in _messages():
            kind = of[kinds[topic]]
            if topic == "/imu/data":
                q = content["orientation"]
                message = kind(
                    head(t),
                    quaternion(q["x"], q["y"], q["z"], q["w"]),
                    none,
                    vector(**content["angular_velocity"]),
                    none,
                    vector(**content["linear_acceleration"]),
                    none,
                )
            elif topic == "/forces":
                message = kind(layout, np.array(content["data"]))
            else:
                place = of["geometry_msgs/msg/Point"](**content["position"])
                message = kind(head(t), of["geometry_msgs/msg/Pose"](place, quaternion(0.0, 0.0, 0.0, 1.0)))
            writer.write(connections[topic], round(1e9 * t), store.serialize_cdr(message, kinds[topic]))
    return path


KINDS: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "parquet": ("log.parquet", parquet),
    "mat5": ("log.mat", mat5),
    "mat73": ("log.mat", mat73),
    "mf4": ("log.mf4", mf4),
    "mcap-json": ("log.mcap", mcap_json),
    "mcap-protobuf": ("log.mcap", mcap_protobuf),
    "rosbag2": ("bag", rosbag2),
}
"""file name and writer of each kind"""
