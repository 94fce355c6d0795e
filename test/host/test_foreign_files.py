# SPDX-License-Identifier: Apache-2.0
"""Recordings of other tools, by format: every sensor with its values and its own rate; odd files end with one line."""

import io
import json
import shutil
import struct
import zlib
from pathlib import Path

import can
import foreign_recordings as recorded
import numpy as np
import pytest
from conftest import COGIRO, minimal_toml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from inertiad.base.error import InputError
from inertiad.exchange import channels, convert, file_formats, foreign_import, foreign_messages
from inertiad.run import canlog, tracker_csv

pytestmark = pytest.mark.slow


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(minimal_toml(4))
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One recording of each kind, written once."""
    found = {}
    for kind, (name, write) in recorded.KINDS.items():
        folder = tmp_path_factory.mktemp(kind)
        found[kind] = write(folder / name)
    return found


@pytest.mark.parametrize("kind", recorded.KINDS)
def test_every_sensor_comes_with_its_values_at_its_own_times(kind: str, files: dict[str, Path]):
    assert convert.is_foreign(files[kind])
    found = channels.summary(files[kind])
    mapped = channels.mapped(files[kind], found, channels.proposed_mapping(files[kind], found))
    for sensor, wanted in (
        ("imu", {f"acc_{a}": recorded.ACC[:, k] for k, a in enumerate("xyz")}),
        ("imu", {f"gyro_{a}": recorded.GYRO[:, k] for k, a in enumerate("xyz")}),
        ("imu", {f"q_{a}": recorded.QUAT[:, k] for k, a in enumerate("wxyz")}),
        ("force", {f"f_{k + 1}": recorded.FORCE[:, k] for k in range(4)}),
        ("pos", {f"pos_{a}": recorded.POSITION[:, k] for k, a in enumerate("xyz")}),
    ):
        for name, values in wanted.items():
            assert name in mapped, f"{name} not recognised: {[item.text for item in found]}"
            np.testing.assert_allclose(mapped[name].t, recorded.T[sensor], atol=2e-9, err_msg=name)
            np.testing.assert_allclose(mapped[name].value, values, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("kind", recorded.KINDS)
def test_import_writes_a_run_that_keeps_the_rates(kind: str, files: dict[str, Path], tmp_path: Path, robot: Path):
    remarks: list[str] = []
    written = foreign_import.import_mapped(files[kind], tmp_path / "run", robot, None, remarks)
    assert any(line.endswith("rows, 200 Hz") for line in written)
    log = canlog.read_candump(tmp_path / "run/can.log")
    times = (log.t_ns[log.can_id == i] for i in np.unique(log.can_id))
    assert {round(1e9 / float(np.median(np.diff(t)))) for t in times} == {50, 200}
    tracker = tracker_csv.read(tmp_path / "run/tracker.csv")
    np.testing.assert_allclose(tracker.stack("x", "y", "z"), recorded.POSITION, atol=1e-8)
    mapping = next((tmp_path / "run").glob("*.map.toml"))
    again = foreign_import.import_mapped(files[kind], tmp_path / "again", robot, channels.read_mapping(mapping), [])
    assert [line.partition("/run/")[2] for line in written] == [line.partition("/again/")[2] for line in again]
    assert (tmp_path / "run/can.log").read_bytes() == (tmp_path / "again/can.log").read_bytes()


# ---- CAN logs with DBC -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> dict[str, Path]:
    """A simulated bus as candump and in the formats of other loggers."""
    from inertiad.simulate import request as requests
    from inertiad.simulate import simulator

    folder = tmp_path_factory.mktemp("bus")
    words = requests.Arguments("hold", 100.0, "modern", 1, None, None, "0,0,2,0,0,0", 2.0, None, ())
    run, _ = requests.run_of(COGIRO / "robot.toml", words)
    simulator.simulate(run, folder / "run", lambda step: None)
    log = canlog.read(folder / "run/can.log")
    found = {".log": folder / "run/can.log"}
    for ending in (".asc", ".blf", ".trc"):
        found[ending] = folder / f"can{ending}"
        with can.Logger(found[ending]) as logger:
            for k in range(len(log)):
                identifier, data = int(log.can_id[k]), bytes(log.data[k, : log.length[k]])
                stamp = 1_700_000_000.0 + 1e-9 * int(log.t_ns[k])
                logger.on_message_received(
                    can.Message(timestamp=stamp, arbitration_id=identifier, data=data, is_extended_id=False, channel=0)
                )
    return found


@pytest.mark.parametrize("ending", [".log", ".asc", ".blf", ".trc"])
def test_signals_of_a_can_log_are_channels(ending: str, bus: dict[str, Path]):
    found = channels.summary(bus[ending], None, [COGIRO / "platform.dbc"])
    assert {f"f_{k + 1}" for k in range(8)} <= {item.quantity for item in found}
    log = canlog.read(bus[".log"])
    by_quantity = {item.quantity: item.channel for item in found if item.quantity}
    rate = by_quantity["acc_z"].rate
    assert rate == pytest.approx(100.0, rel=1e-3) and len(by_quantity["acc_z"].t) == np.sum(log.can_id == log.can_id[1])
    assert np.mean(by_quantity["acc_z"].value) == pytest.approx(9.81, abs=0.1)


def test_can_log_without_a_frame_of_the_dbc_names_its_identifiers(bus: dict[str, Path]):
    devices = COGIRO.parent / "devices/me_gsv4.dbc"
    with pytest.raises(InputError, match="identifiers in the log: "):
        channels.summary(bus[".log"], None, [devices])


def _log_of_two(folder: Path, second: str) -> Path:
    """A candump log with frames of one identifier on can0 and, with other values, on another interface."""
    path = folder / "two.log"
    buses = (("can0", "0100"), (second, "0200"))
    path.write_text("".join(f"({1.0 + 0.01 * k:.6f}) {name} 101#{3 * n}\n" for k in range(100) for name, n in buses))
    return path


ONE_MESSAGE = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 257 {name}: 6 X
 SG_ acc_x : 0|16@1- (0.1,0) [0|0] "m/s2" X
 SG_ acc_y : 16|16@1- (0.1,0) [0|0] "m/s2" X
 SG_ acc_z : 32|16@1- (0.1,0) [0|0] "m/s2" X
"""


def _dbc(folder: Path, file: str, message: str) -> Path:
    path = folder / file
    path.write_text(ONE_MESSAGE.format(name=message))
    return path


def test_interfaces_of_a_can_log_are_not_mixed(tmp_path: Path):
    dbc = _dbc(tmp_path, "imu.dbc", "IMU")
    found = {f.channel.name: f.channel for f in channels.summary(_log_of_two(tmp_path, "can1"), None, [dbc])}
    assert set(found) == {f"{bus}:IMU.acc_{a}" for bus in ("can0", "can1") for a in "xyz"}
    for name, channel in found.items():
        np.testing.assert_allclose(channel.value, 0.1 if name.startswith("can0") else 0.2)
    one = {f.channel.name for f in channels.summary(_log_of_two(tmp_path, "can0"), None, [dbc])}
    assert one == {f"IMU.acc_{a}" for a in "xyz"}


@pytest.mark.parametrize(("other", "said"), [("IMU", "message IMU"), ("Turn", "identifier 101")])
def test_dbc_files_that_share_a_message_are_refused(other: str, said: str, tmp_path: Path):
    files = [_dbc(tmp_path, "a.dbc", "IMU"), _dbc(tmp_path, "b.dbc", other)]
    with pytest.raises(InputError, match=f"a.dbc and b.dbc both describe {said}"):
        channels.summary(_log_of_two(tmp_path, "can1"), None, files)


def _mcap(folder: Path, rows: list[dict[str, object]]) -> Path:
    """JSON messages of one topic, logged every 0.1 s from 5 s on."""
    from mcap.writer import Writer

    path = folder / "one.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        topic = writer.register_channel("/a", "json", writer.register_schema("any", "jsonschema", b"{}"))
        for k, row in enumerate(rows):
            logged = 5_000_000_000 + 100_000_000 * k
            writer.add_message(topic, logged, json.dumps(row).encode(), logged)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("stamps", "first"),
    [([0.0, 0.01, 0.02], 0.0), ([0.0, 0.0, 0.0], 5.0), ([1.0, None, 1.02], 5.0), ([7.0, 7.01, 7.02], 7.0)],
)
def test_a_topic_has_one_clock(stamps: list[float | None], first: float, tmp_path: Path):
    rows: list[dict[str, object]] = [{"x": 1.0 + k} | ({} if s is None else {"t": s}) for k, s in enumerate(stamps)]
    (found,) = foreign_messages.read_mcap(_mcap(tmp_path, rows))
    step = 0.01 if first != 5.0 else 0.1
    np.testing.assert_allclose(found.t, first + step * np.arange(3))
    np.testing.assert_allclose(found.value, [1.0, 2.0, 3.0])


def test_only_whole_names_are_left_out(tmp_path: Path):
    row = {
        "sequence_gain": 1.0,
        "seq": 2.0,
        "subheader": 3.0,
        "orientation_covariance": [1.0] * 9,
        "covariance_gain": 4.0,
    }
    found = foreign_messages.read_mcap(_mcap(tmp_path, [row, row]))
    assert {channel.name for channel in found} == {"/a.sequence_gain", "/a.subheader", "/a.covariance_gain"}


def test_length_of_a_wrench_topics_force_is_a_cable_force(tmp_path: Path):
    """Force sensors in line with the cables, a WrenchStamped each."""
    forces = {"/cable_1/wrench": (3.0, 4.0, 12.0), "/force_sensor_2": (0.0, 0.0, -50.0), "/other": (1.0, 0.0, 0.0)}
    path = tmp_path / "wrench.bag2"
    store = get_typestore(Stores.ROS2_HUMBLE)
    of, kind = store.types, "geometry_msgs/msg/WrenchStamped"
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic in forces}
        for t in range(1, 4):
            head = of["std_msgs/msg/Header"](of["builtin_interfaces/msg/Time"](t, 0), "x")
            for topic, force in forces.items():
                vector = of["geometry_msgs/msg/Vector3"]
                wrench = of["geometry_msgs/msg/Wrench"](vector(*force), vector(9.0, 9.0, 9.0))
                writer.write(connections[topic], t * 10**9, store.serialize_cdr(of[kind](head, wrench), kind))
    found = channels.summary(path)
    mapped = channels.mapped(path, found, channels.proposed_mapping(path, found))
    assert {name: channel.value.tolist() for name, channel in mapped.items()} == {"f_1": [13.0] * 3, "f_2": [50.0] * 3}
    text = '[channels.f_1]\nchannel = "/cable_1/wrench.wrench.force.z"\nscale = 2.0\n'
    (tmp_path / "map.toml").write_text(text)
    chosen = channels.mapped(path, found, channels.read_mapping(tmp_path / "map.toml"))
    assert chosen["f_1"].value.tolist() == [24.0] * 3


# ---- objects of MATLAB -----------------------------------------------------------------------------------------------


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def _mat5_object(path: Path, name: bytes, kind: bytes, is_compressed: bool) -> Path:
    """A variable of mxOPAQUE_CLASS, as MATLAB saves a table; no MATLAB was at hand."""
    from scipy.io import savemat

    inner = io.BytesIO()
    savemat(inner, {"x": np.zeros((6, 1), np.uint32)})
    head, flags = inner.getvalue()[:128], _element(6, struct.pack("<II", 17, 0))
    content = flags + _element(1, name) + _element(1, b"MCOS") + _element(1, kind) + inner.getvalue()[128:]
    whole = struct.pack("<II", 14, len(content)) + content
    if is_compressed:
        packed = zlib.compress(whole)
        whole = struct.pack("<II", 15, len(packed)) + packed
    path.write_bytes(head + whole)
    return path


@pytest.mark.parametrize("is_compressed", [False, True])
def test_matlab_table_is_refused_with_what_to_save_instead(is_compressed: bool, tmp_path: Path):
    path = _mat5_object(tmp_path / "log.mat", b"run1", b"timetable", is_compressed)
    assert convert.is_foreign(path)
    with pytest.raises(InputError, match=r"run1 is a timetable.*parquetwrite"):
        channels.summary(path)


def test_matlab_timeseries_of_version_73_is_refused_and_a_string_is_left_out(tmp_path: Path):
    import h5py

    def write(kind: str) -> Path:
        path = tmp_path / f"{kind}.mat"
        with h5py.File(path, "w") as file:
            file["run/t"], file["run/force_1"] = np.arange(5.0)[None], np.ones((1, 5))
            one = file.create_dataset("run/one", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32))
            one.attrs["MATLAB_class"], one.attrs["MATLAB_object_decode"] = np.bytes_(kind), np.int32(3)
        return path

    with pytest.raises(InputError, match=r"run.one is a timeseries.*timeseries2timetable"):
        channels.summary(write("timeseries"))
    assert [item.channel.name for item in channels.summary(write("string"))] == ["run.force_1"]


# ---- odd files -------------------------------------------------------------------------------------------------------


def _flip(data: bytes, at: float) -> bytes:
    changed = bytearray(data)
    changed[int(at * len(changed))] ^= 0x10
    return bytes(changed)


def _odd(files: dict[str, Path], folder: Path) -> dict[str, Path]:
    """Damaged and strange files by what is odd about them."""
    import pyarrow
    import pyarrow.parquet
    from asammdf import MDF
    from mcap.writer import Writer
    from scipy.io import savemat

    found: dict[str, Path] = {}

    def put(name: str, data: bytes) -> None:
        found[name] = folder / name
        found[name].parent.mkdir(exist_ok=True)
        found[name].write_bytes(data)

    for kind in ("parquet", "mat5", "mat73", "mf4", "mcap-json", "mcap-protobuf"):
        ending, whole = files[kind].suffix, files[kind].read_bytes()
        put(f"{kind}-half{ending}", whole[: len(whole) // 2])
        put(f"{kind}-empty{ending}", b"")
        put(f"{kind}-text{ending}", b"t,acc_x\n0,1\n")
    for kind in ("parquet", "mat5", "mf4", "mcap-json", "mcap-protobuf"):  # with checksums of formats or compressions
        for at in (0.2, 0.4, 0.6):
            put(f"{kind}-flip-{at}{files[kind].suffix}", _flip(files[kind].read_bytes(), at))
    put("zero-rows.parquet", b"")
    schema = pyarrow.schema([("t", pyarrow.float64()), ("accel_x", pyarrow.float64())])
    pyarrow.parquet.write_table(schema.empty_table(), found["zero-rows.parquet"])
    put("no-time.parquet", b"")
    pyarrow.parquet.write_table(pyarrow.table({"accel_x": [1.0, 2.0]}), found["no-time.parquet"])
    put("words.parquet", b"")
    pyarrow.parquet.write_table(pyarrow.table({"t": ["a", "b"], "accel_x": ["c", "d"]}), found["words.parquet"])
    put("twice.parquet", b"")
    pyarrow.parquet.write_table(pyarrow.table({"time": [0.0, 0.0], "accel_x": [1.0, 2.0]}), found["twice.parquet"])
    put("bomb.mat", b"")
    savemat(found["bomb.mat"], {"t": np.zeros((20_000_000, 1))}, do_compression=True)
    put("words.mat", b"")
    savemat(found["words.mat"], {"t": "abc", "acc": "def"})
    put("no-time.mat", b"")
    savemat(found["no-time.mat"], {"acc": np.ones((5, 3))})
    put("no-channel.mf4", b"")
    with MDF(version="4.10") as mdf:
        mdf.save(found["no-channel.mf4"], overwrite=True)
    put("other-encoding.mcap", b"")
    with found["other-encoding.mcap"].open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/imu", "cdr", writer.register_schema("Imu", "ros2msg", b"float64 x"))
        writer.add_message(channel, 1, b"\0" * 12, 1)
        writer.finish()
    put("json-words.mcap", b"")
    with found["json-words.mcap"].open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/imu", "json", writer.register_schema("any", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"not json", 1)
        writer.finish()
    for name in ("bag-cut", "bag-no-data"):
        found[name] = folder / name
        shutil.copytree(files["rosbag2"], found[name])
        data = next(found[name].glob("*.db3"))
        whole = data.read_bytes()
        if name == "bag-no-data":
            data.unlink()
        else:
            data.write_bytes(whole[: len(whole) // 2])
    found["bag-bad-metadata"] = folder / "bag-bad-metadata"
    shutil.copytree(files["rosbag2"], found["bag-bad-metadata"])
    (found["bag-bad-metadata"] / "metadata.yaml").write_text("a: [")
    put("unknown.xyz", b"abc")
    return found


def test_odd_files_end_with_one_line(files: dict[str, Path], tmp_path: Path):
    """In one process, through the command's own functions: each gives InputError of one line that names the file."""
    (tmp_path / "odd").mkdir()
    odd = _odd(files, tmp_path / "odd")
    assert len(odd) >= 40
    said, wrong = [], []
    for name, path in odd.items():
        run = tmp_path / "runs" / name
        try:
            if convert.is_foreign(path):
                foreign_import.import_mapped(path, run, None, None, [])
            else:
                convert.import_file(path, run, None, [])
            wrong.append(f"{name}: came in")
        except InputError as error:
            said += [f"{name}: {line}" for line in error.lines]
            if len(error.lines) != 1 or "\n" in str(error) or name not in str(error):
                wrong.append(f"{name}: {error.lines}")
        except Exception as error:
            wrong.append(f"{name}: {type(error).__name__}: {error}")
    print("\n".join(said))
    assert not wrong, "\n".join(wrong)
    assert any(line.startswith("bomb.mat: ") and "bytes would expand to 1.6e+08" in line for line in said)


def test_every_flipped_bit_of_parquet_values_is_found(tmp_path: Path):
    import pyarrow
    import pyarrow.parquet

    file, value = tmp_path / "x.parquet", np.random.default_rng(1).normal(size=1000)
    table = pyarrow.table({"t": 0.01 * np.arange(1000), "accel_x": value})
    pyarrow.parquet.write_table(table, file, compression="none", use_dictionary=False, write_page_checksum=True)
    whole = file.read_bytes()
    first = whole.index(value[:4].tobytes())
    for at in range(first, first + 8 * len(value), 251):
        damaged = bytearray(whole)
        damaged[at] ^= 0x10
        file.write_bytes(damaged)
        with pytest.raises(InputError, match="not a usable Parquet file"):
            file_formats.parquet_table(file)


@pytest.mark.parametrize("name", ["half", "flip"])
def test_the_command_ends_with_2_and_one_line(name: str, files: dict[str, Path], tmp_path: Path, inertiactl):
    whole = files["mcap-protobuf"].read_bytes()
    file = tmp_path / "log.mcap"
    file.write_bytes(whole[: len(whole) // 2] if name == "half" else _flip(whole, 0.5))
    done = inertiactl("import", file, "-o", tmp_path / "run")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith(f"inertiactl: {file}: not a usable MCAP file: ")
