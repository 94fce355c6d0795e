# SPDX-License-Identifier: Apache-2.0
"""Runs to other tools' files and back: each file opened by a tool that is not ours, each way there and back a law."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import can
import cantools
import devices
import numpy as np
import pytest
from conftest import COGIRO, TOP
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inertiad.base import quantity, table, units
from inertiad.base.error import InputError
from inertiad.base.table import Table
from inertiad.exchange import body_formats, convert, dataset, file_formats, foxglove
from inertiad.exchange.dataset import Dataset
from inertiad.model import tension_color
from inertiad.robot import configuration, description
from inertiad.robot.keys import Nominal, inertia_matrix
from inertiad.run import canlog, lcmlog
from inertiad.run.canlog import CanLog

SHEET_FORMATS = [name for name in file_formats.FORMATS if name != "candump"]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """5 s of standing still, as simulated, and as the daemon recorded it: run.lcmlog, estimate.json."""
    folder = tmp_path_factory.mktemp("run")
    devices.record("xsens_gsv4", folder, rate=50.0, hold=5.0)
    configuration.write(folder / "robot.cfg", description.load(folder / "robot.toml"), "robot.toml")
    command = [TOP / "build/bin/inertiad", "-v", "--config", folder / "robot.cfg", "--lcm", "none"]
    for bus in range(2):
        command += ["--bus", f"file:{folder / 'can.log'}?interface=can{bus}"]
    command += ["--tracker", f"file:{folder / 'tracker.csv'}", "--record", folder / "run.lcmlog"]
    command += ["--estimate", folder / "estimate.json"]
    subprocess.run([str(c) for c in command], check=True, capture_output=True, timeout=60)
    return folder


@pytest.fixture(scope="module")
def recorded(run: Path) -> Dataset:
    remarks: list[str] = []
    data = dataset.read(run / "run.lcmlog", None, "INERTIAD_", remarks)
    assert not remarks and data.frames is not None
    return data


def same_table(a: Table, b: Table) -> None:
    assert a.name == b.name and list(a.columns) == list(b.columns)
    np.testing.assert_array_equal(a.t_ns, b.t_ns)
    for name, values in a.columns.items():
        assert values.dtype == b.columns[name].dtype, name
        np.testing.assert_array_equal(values, b.columns[name], err_msg=name)


def same_frames(a: CanLog, b: CanLog) -> None:
    assert a.names == b.names and len(a) == len(b)
    width = max(a.data.shape[1], b.data.shape[1])
    for name in ("t_ns", "can_id", "flags", "length", "bus"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    padded = [np.pad(x.data, ((0, 0), (0, width - x.data.shape[1]))) for x in (a, b)]
    np.testing.assert_array_equal(*padded)


def same(a: Dataset, b: Dataset) -> None:
    assert list(a.tables) == list(b.tables)
    for name, found in a.tables.items():
        same_table(found, b.tables[name])
    assert (a.frames is None) == (b.frames is None)
    if a.frames is not None and b.frames is not None:
        same_frames(a.frames, b.frames)


# ---- there and back --------------------------------------------------------------------------------------------------


def test_recorded_run_has_every_table_with_a_unit_for_every_quantity(recorded: Dataset):
    assert [found.name for found in recorded.all()] == ["signals", "tracker", "estimate", "frames", "health"]
    for name in ("signals", "tracker", "estimate"):
        without = [n for n in recorded.tables[name].columns if not units.of(n)]
        assert not without


@pytest.mark.parametrize("form", SHEET_FORMATS)
def test_recorded_run_comes_back_from_each_format_unchanged(form: str, recorded: Dataset, tmp_path: Path):
    path = tmp_path / f"x{file_formats.FORMATS[form].ending}"
    file_formats.FORMATS[form].write(path, recorded)
    same(recorded, file_formats.FORMATS[form].read(path))


SECONDS = st.integers(0, 2_000_000_000)
NUMBERS = st.floats(allow_infinity=False, width=64)
TEXT = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=12)


@st.composite
def stamps(draw, n: int, per_ns: int) -> np.ndarray:
    """Increasing host times, spread over up to a day."""
    first = draw(SECONDS) * dataset.NS
    steps = draw(st.lists(st.integers(1, 80_000_000_000_000 // per_ns // 8), min_size=n, max_size=n))
    return np.array(first + np.cumsum(steps) * per_ns, np.int64)


@st.composite
def frames(draw) -> CanLog:
    n = draw(st.integers(1, 6))
    rows = []
    for t in draw(stamps(n, 1000)).tolist():
        kind = draw(st.sampled_from(["classical", "fd", "remote"]))
        extended = draw(st.booleans())
        can_id = draw(st.integers(0, 0x1FFFFFFF)) | canlog.EXTENDED if extended else draw(st.integers(0, 0x7FF))
        length = draw(st.sampled_from([0, 1, 7, 8, 12, 64] if kind == "fd" else range(9)))
        data = b"" if kind == "remote" else draw(st.binary(min_size=length, max_size=length))
        flags = canlog.FD | draw(st.sampled_from([0, canlog.BRS, canlog.BRS | canlog.ESI])) if kind == "fd" else 0
        can_id |= canlog.REMOTE if kind == "remote" else 0
        rows.append((t, can_id, flags, data, f"can{draw(st.integers(0, 2))}", length))
    return canlog.from_rows([*rows, (rows[-1][0], 1, 0, b"", "can0", 0), (rows[-1][0], 1, 0, b"", "can1", 0),
                             (rows[-1][0], 1, 0, b"", "can2", 0)], "test")  # fmt: skip


@st.composite
def datasets(draw) -> Dataset:
    found = []
    for name, columns in (
        ("signals", (*quantity.ACC, *quantity.forces(3))),
        ("tracker", ("x", "y", "z", "valid", "t_device_ns")),
        ("estimate", ("mass", "mass_std", "consistent", "provisional", "n_windows")),
        ("events", ("source", "text")),
    ):
        n = draw(st.integers(1, 5))
        kinds = dict.fromkeys(("valid", "consistent", "provisional"), st.booleans()) | {"source": TEXT, "text": TEXT}
        kinds |= {"t_device_ns": st.integers(-(2**62), 2**62), "n_windows": st.integers(0, 2**62)}
        values = {c: draw(st.lists(kinds.get(c, NUMBERS), min_size=n, max_size=n)) for c in columns}
        found.append(table.at_ns(name, draw(stamps(n, 1)), {c: dataset.typed(name, c, v) for c, v in values.items()}))
    return Dataset({made.name: made for made in found}, draw(frames()), "test")


@pytest.mark.slow
@pytest.mark.parametrize("form", SHEET_FORMATS)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(data=datasets())
def test_any_run_comes_back_from_each_format_unchanged(form: str, tmp_path_factory, data: Dataset):
    path = tmp_path_factory.mktemp(form) / f"x{file_formats.FORMATS[form].ending}"
    file_formats.FORMATS[form].write(path, data)
    again = file_formats.FORMATS[form].read(path)
    if form == "mf4":  # python-can gives its stamps as float seconds; remote frames come after the others
        order = np.argsort((data.frames.can_id & canlog.REMOTE) != 0, kind="stable")
        data = Dataset(data.tables, data.frames[order], data.source)
        by_kind = np.argsort((again.frames.can_id & canlog.REMOTE) != 0, kind="stable")
        again = Dataset(again.tables, again.frames[by_kind], again.source)
        assert np.abs(again.frames.t_ns - data.frames.t_ns).max() < 1000
        again.frames.t_ns[:] = data.frames.t_ns
    same(data, again)


@settings(max_examples=50, deadline=None)
@given(log=frames())
def test_frames_come_back_from_candump_unchanged(tmp_path_factory, log: CanLog):
    path = tmp_path_factory.mktemp("candump") / "x.log"
    file_formats.FORMATS["candump"].write(path, Dataset({}, log, "test"))
    same_frames(log, file_formats.FORMATS["candump"].read(path).frames)


@pytest.mark.parametrize("form", SHEET_FORMATS)
def test_imported_run_gives_the_same_run_again(form: str, run: Path, tmp_path: Path):
    file, again = tmp_path / f"x{file_formats.FORMATS[form].ending}", tmp_path / "again"
    remarks: list[str] = []
    convert.export(run, form, file, None, "INERTIAD_", remarks)
    assert not remarks
    convert.import_file(file, again, run / "robot.toml", remarks)
    assert len(remarks) == 1 and "estimate, health: left out" in remarks[0]
    assert (again / "can.log").read_bytes() == (run / "can.log").read_bytes()
    assert description.load(again / "robot.toml").signals == description.load(run / "robot.toml").signals
    before, after = (dataset.read(path, None, "INERTIAD_", []) for path in (run, again))
    same_table(before.tables["signals"], after.tables["signals"])
    for name in ("x", "y", "z"):
        np.testing.assert_array_equal(before.tables["tracker"].columns[name], after.tables["tracker"].columns[name])
    signals = table.read(again / "signals.csv", [*before.tables["signals"].columns, "t"])
    np.testing.assert_allclose(signals.t, before.tables["signals"].t, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_commands_say_what_they_wrote(run: Path, tmp_path: Path, inertiactl):
    done = inertiactl("export", run, "--to", "mf4", "-o", tmp_path / "x.mf4")
    assert done.returncode == 0 and "signals " in done.stderr
    done = inertiactl("import", tmp_path / "x.mf4", "-o", tmp_path / "again")
    assert done.returncode == 0
    assert [line.split(": ")[0].rsplit("/")[-1] for line in done.stderr.splitlines()] == [
        "x.mf4",
        "signals.csv",
        "tracker.csv",
        "can.log",
    ]


# ---- opened by others ------------------------------------------------------------------------------------------------


def test_csv_opens_in_pandas_with_units_in_the_heads(recorded: Dataset, tmp_path: Path):
    import pandas

    file_formats.write_csv(tmp_path / "x.csv", recorded)
    signals = recorded.tables["signals"]
    frame = pandas.read_csv(tmp_path / "x.csv")
    assert list(frame.columns[:4]) == ["t [s]", "acc_x [m/s2]", "acc_y [m/s2]", "acc_z [m/s2]"]
    assert "f_8 [N]" in frame.columns and "q_w [1]" in frame.columns
    np.testing.assert_array_equal(frame["f_8 [N]"], signals.columns["f_8"])
    estimates = pandas.read_csv(tmp_path / "x.estimate.csv")
    assert "inertia_cog_xy_std [kg m2]" in estimates.columns


def test_parquet_opens_in_pandas_and_names_units_in_its_fields(recorded: Dataset, tmp_path: Path):
    import pandas
    import pyarrow.parquet

    file_formats.write_parquet(tmp_path / "x.parquet", recorded)
    frame = pandas.read_parquet(tmp_path / "x.parquet")
    np.testing.assert_array_equal(frame["acc_z"], recorded.tables["signals"].columns["acc_z"])
    np.testing.assert_array_equal(frame["t_ns"], recorded.tables["signals"].t_ns)
    schema = pyarrow.parquet.read_schema(tmp_path / "x.parquet")
    assert schema.field("gyro_x").metadata == {b"unit": b"rad/s"}


def test_mcap_opens_in_its_own_reader_with_json_schemas(recorded: Dataset, tmp_path: Path):
    from mcap.reader import make_reader

    file_formats.write_mcap(tmp_path / "x.mcap", recorded)
    with (tmp_path / "x.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        topics = {channel.topic: channel.message_encoding for channel in summary.channels.values()}
        assert topics["/signals"] == topics["/frames"] == "json"
        assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema", "protobuf"}
        listed = list(reader.iter_messages(topics=["/signals"]))
    schema = json.loads(listed[0][0].data)
    assert schema["type"] == "object" and schema["properties"]["acc_x"]["description"] == "m/s2"
    signals = recorded.tables["signals"]
    assert [message.log_time for _, _, message in listed] == signals.t_ns.tolist()
    assert [json.loads(m.data)["f_1"] for _, _, m in listed] == signals.columns["f_1"].tolist()


def drawn_messages(path: Path) -> dict[str, list]:
    """Foxglove's messages by topic, decoded by the schemas in the file alone."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found: dict[str, list] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=list(foxglove.TOPICS)):
            assert schema.name == f"foxglove.{SCHEMAS[channel.topic]}" and schema.encoding == "protobuf"
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


SCHEMAS = {"/tf": "FrameTransform", "/platform/pose": "PoseInFrame"} | dict.fromkeys(
    ("/robot", "/cables", "/body"), "SceneUpdate"
)


def xyz(v) -> list[float]:
    return [v.x, v.y, v.z]


def test_mcap_has_the_robot_in_motion_as_foxgloves_messages(run: Path, recorded: Dataset, tmp_path: Path):
    file_formats.write_mcap(tmp_path / "x.mcap", recorded)
    found = drawn_messages(tmp_path / "x.mcap")
    robot, signals = description.load(run / "robot.toml"), recorded.tables["signals"]
    assert set(found) == set(foxglove.TOPICS) and len(found["/robot"]) == 1
    t_ns, transform = found["/tf"][10]
    row = int(np.searchsorted(signals.t_ns, t_ns))
    assert signals.t_ns[row] == t_ns == transform.timestamp.ToNanoseconds()
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", "platform")
    r = transform.rotation
    turn = Rotation.from_quat([r.x, r.y, r.z, r.w])
    tracked = np.array(xyz(transform.translation)) + turn.apply(robot.tracker.target)
    np.testing.assert_allclose(tracked, signals.stack(*quantity.POSITION)[row], atol=1e-12)
    pose = dict(found["/platform/pose"])[t_ns]
    assert pose.frame_id == "world" and xyz(pose.pose.position) == xyz(transform.translation)
    [lines] = dict(found["/cables"])[t_ns].entities[0].lines
    assert lines.type == lines.LINE_LIST and len(lines.points) == len(lines.colors) == 2 * robot.n_cables
    corner = np.array(xyz(transform.translation)) + turn.apply([c.attachment for c in robot.cable])
    ends = np.array([xyz(point) for point in lines.points]).reshape(-1, 2, 3)
    np.testing.assert_allclose(ends[:, 0], corner, atol=1e-12)
    reach = max(cable.pulley_radius for cable in robot.cable)
    assert (np.linalg.norm(ends[:, 1] - [c.anchor for c in robot.cable], axis=1) <= 2.0 * reach + 1e-9).all()
    assert np.diff([t for t, _ in found["/tf"]]).min() >= 1e9 / foxglove.RATE - 2e7  # rows come every 20 ms


def test_mcap_has_the_body_of_each_estimate(recorded: Dataset, tmp_path: Path):
    file_formats.write_mcap(tmp_path / "x.mcap", recorded)
    estimate = recorded.tables["estimate"]
    for t_ns, scene in drawn_messages(tmp_path / "x.mcap")["/body"]:
        row, [entity] = int(np.searchsorted(estimate.t_ns, t_ns)), scene.entities
        cog = [estimate.columns[f"cog_{a}"][row] for a in "xyz"]
        assert entity.frame_id == "platform" and xyz(entity.spheres[0].pose.position) == cog
        assert entity.texts[0].text.startswith(f"{estimate.columns['mass'][row]:.2f} ± ")
        names = [f"inertia_cog_{e}" for e in dataset.INERTIA]
        J = inertia_matrix(np.array([estimate.columns[name][row] for name in names]))
        if len(entity.spheres) == 2:  # back from the ellipsoid to the inertia
            size, o = np.array(xyz(entity.spheres[1].size)) / 2.0, entity.spheres[1].pose.orientation
            R = Rotation.from_quat([o.x, o.y, o.z, o.w]).as_matrix()
            moments = estimate.columns["mass"][row] / 5.0 * (np.sum(size**2) - size**2)
            np.testing.assert_allclose(R @ np.diag(moments) @ R.T, J, atol=1e-9 * np.abs(J).max())


def test_layouts_name_what_the_mcap_has(recorded: Dataset, tmp_path: Path):
    from mcap.reader import make_reader

    written = file_formats.write_mcap(tmp_path / "x.mcap", recorded)
    assert [path.name for path in written] == ["x.mcap", "x.foxglove.json", "x.plotjuggler.xml"]
    with written[0].open("rb") as file:
        topics = {channel.topic for channel in make_reader(file).get_summary().channels.values()}
    layout = json.loads(written[1].read_text())
    plotted = [path["value"] for p in layout["configById"].values() for path in p.get("paths", [])]
    curves = [curve.get("name") for curve in ElementTree.parse(written[2]).iter("curve")]
    assert len(plotted) == len(curves) == len(set(plotted)) >= 16
    for value, name in ((p, p.partition(".")[2]) for p in plotted):
        assert name in recorded.tables[value.partition(".")[0].strip("/")].columns
    assert {value.replace(".", "/") for value in plotted} == set(curves)
    assert set(layout["configById"]["3D!robot"]["topics"]) <= topics

    def panels(node) -> list[str]:
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])


def test_run_without_description_is_exported_without_the_robot_in_space(recorded: Dataset, tmp_path: Path):
    file_formats.write_mcap(tmp_path / "x.mcap", Dataset(recorded.tables, recorded.frames, "x"))
    assert drawn_messages(tmp_path / "x.mcap") == {}
    assert "3D!robot" not in (tmp_path / "x.foxglove.json").read_text()


@pytest.mark.parametrize(
    ("f", "expected"),
    [
        (99.0, tension_color.SLACK),
        (100.0, (37, 99, 200)),
        (1000.0, (214, 78, 18)),
        (1001.0, tension_color.OVERLOAD),
        (100.0 * 10**0.4, (20, 160, 170)),
    ],
)
def test_colour_of_a_tension_is_logarithmic_between_its_limits(f, expected):
    assert tension_color.color(f, 100.0, 1000.0) == expected


def test_mat_opens_in_scipy_with_a_struct_of_units(recorded: Dataset, tmp_path: Path):
    from scipy.io import loadmat

    file_formats.write_mat(tmp_path / "x.mat", recorded)
    contents = loadmat(tmp_path / "x.mat", simplify_cells=True)
    np.testing.assert_array_equal(contents["signals"]["f_3"], recorded.tables["signals"].columns["f_3"])
    assert contents["units"]["estimate"]["inertia_cog_xx"] == "kg m2"
    assert contents["frames"]["data"][0] == "00000000"


def test_mf4_opens_in_asammdf_and_its_frames_decode_by_dbc(recorded: Dataset, tmp_path: Path):
    from asammdf import MDF

    file_formats.write_mf4(tmp_path / "x.mf4", recorded)
    with MDF(tmp_path / "x.mf4") as mdf:
        mass = mdf.get("mass")
        assert mass.unit == "kg"
        np.testing.assert_array_equal(mass.samples, recorded.tables["estimate"].columns["mass"])
        dbc = devices.DEVICES / "xsens_mti600.dbc"
        decoded = mdf.extract_bus_logging({"CAN": [(dbc, 0)]}).get("acc_z")
    by_cantools = cantools.database.load_file(dbc).get_message_by_name("MTI_ACCELERATION")
    chosen = recorded.frames[recorded.frames.can_id == by_cantools.frame_id]
    expected = [by_cantools.decode(row[:6].tobytes())["acc_z"] for row in chosen.data]
    np.testing.assert_allclose(decoded.samples, expected, rtol=1e-12)


def test_candump_opens_in_can_utils_and_python_can(recorded: Dataset, tmp_path: Path):
    path = tmp_path / "x.log"
    file_formats.write_candump(path, recorded)
    with can.LogReader(path) as reader:
        assert len(list(reader)) == len(recorded.frames)
    done = subprocess.run(["log2asc", "-I", path, "can0", "can1"], capture_output=True, text=True, check=True)
    assert sum("d " in line for line in done.stdout.splitlines()) == len(recorded.frames)


BODIES = st.builds(
    lambda mass, cog, axes, spread: Nominal(mass=mass, cog=cog, inertia_cog=possible(mass, axes, spread)),
    st.floats(0.1, 500.0),
    st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3),
    st.lists(st.floats(-np.pi, np.pi), min_size=3, max_size=3),
    st.lists(st.floats(0.05, 1.0), min_size=3, max_size=3),
)


def possible(mass: float, axes: list[float], spread: list[float]) -> list[float]:
    """Inertia about the CoG of a box with these half edges, turned by a rotation vector."""
    from scipy.spatial.transform import Rotation

    a, b, c = np.square(spread)
    R = Rotation.from_rotvec(axes).as_matrix()
    J = R @ (mass / 3.0 * np.diag([b + c, a + c, a + b])) @ R.T
    return [J[0, 0], J[1, 1], J[2, 2], J[1, 2], J[0, 2], J[0, 1]]


@settings(max_examples=40, deadline=None)
@given(body=BODIES)
def test_urdf_loads_in_pinocchio_as_the_same_body(tmp_path_factory, body: Nominal):
    import pinocchio as pin

    path = tmp_path_factory.mktemp("urdf") / "body.urdf"
    body_formats.write(path, body, "urdf")
    inertia = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer()).inertias[1]
    scale = float(np.abs(body.inertia_cog).max())
    assert inertia.mass == pytest.approx(body.mass, rel=1e-9)
    np.testing.assert_allclose(inertia.lever, body.cog, rtol=0, atol=1e-9)
    np.testing.assert_allclose(inertia.inertia, inertia_matrix(body.inertia_cog), rtol=0, atol=1e-9 * scale)


@settings(max_examples=40, deadline=None)
@given(body=BODIES)
def test_mjcf_loads_in_mujoco_as_the_same_body(tmp_path_factory, body: Nominal):
    import mujoco
    from scipy.spatial.transform import Rotation

    path = tmp_path_factory.mktemp("mjcf") / "body.xml"
    body_formats.write(path, body, "mjcf")
    model = mujoco.MjModel.from_xml_path(str(path))
    index = model.body("platform").id
    R = Rotation.from_quat(model.body_iquat[index], scalar_first=True).as_matrix()
    J = R @ np.diag(model.body_inertia[index]) @ R.T
    scale = float(np.abs(body.inertia_cog).max())
    assert model.body_mass[index] == pytest.approx(body.mass, rel=1e-9)
    np.testing.assert_allclose(model.body_ipos[index], body.cog, rtol=0, atol=1e-9)
    np.testing.assert_allclose(J, inertia_matrix(body.inertia_cog), rtol=0, atol=1e-9 * scale)


@pytest.mark.slow
def test_identified_body_goes_to_every_format_and_json_back_into_simulate(run: Path, tmp_path: Path, inertiactl):
    found = json.loads((run / "estimate.json").read_text())
    for form in body_formats.FORMATS:
        assert convert.export(run, form, tmp_path / f"body.{form}", None, "", [])
    body = json.loads((tmp_path / "body.json").read_text())
    assert body == {key: found[key]["value"] for key in ("mass", "cog", "inertia_cog")}
    hold = ("--trajectory", "hold", "--duration", "0.2", "--body", tmp_path / "body.json")
    assert inertiactl("simulate", COGIRO / "robot.toml", *hold, "-o", tmp_path / "run").returncode == 0


# ---- bad input -------------------------------------------------------------------------------------------------------


def refused(*arguments: object, run: Callable) -> str:
    done = run(*arguments)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
    return done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "target"),
    [
        ("candump", "can.log"),
        ("csv", "tracker.csv"),
        ("mf4", "robot.toml"),
        ("mat", "tracker.csv"),
        ("json", "run.lcmlog"),
    ],
)
def test_file_of_the_run_is_not_written_over(form: str, target: str, run: Path, tmp_path: Path, inertiactl):
    before = (run / target).read_bytes()
    assert "is what is exported" in refused("export", run, "--to", form, "-o", run / target, run=inertiactl)
    assert (run / target).read_bytes() == before


def test_file_beside_the_output_is_not_written_over(tmp_path: Path):
    signals = tmp_path / "a.signals.csv"
    signals.write_text("t,acc_x\n")
    with pytest.raises(InputError, match=r"a\.signals\.csv: is what is exported"):
        convert.export(signals, "csv", tmp_path / "a.csv", None, "", [])


@pytest.mark.parametrize("form", body_formats.FORMATS)
def test_robot_description_that_is_not_used_is_refused(form: str, tmp_path: Path):
    with pytest.raises(InputError, match=f"--robot .* not wanted with --to {form}"):
        convert.export(tmp_path, form, tmp_path / "x", COGIRO / "robot.toml", "", [])


@pytest.mark.slow
def test_unknown_format_lists_the_known_ones(run: Path, tmp_path: Path, inertiactl):
    text = refused("export", run, "--to", "parket", "-o", tmp_path / "x", run=inertiactl)
    for name in (*file_formats.FORMATS, *body_formats.FORMATS):
        assert name in text
    assert "did you mean parquet?" in text
    text = refused("import", run / "robot.cfg", "-o", tmp_path / "x", run=inertiactl)
    assert ".mcap" in text and ".blf" in text


@pytest.mark.slow
def test_torn_log_is_exported_up_to_the_damage_with_a_count(run: Path, recorded: Dataset, tmp_path: Path, inertiactl):
    whole = (run / "run.lcmlog").read_bytes()
    torn = tmp_path / "torn.lcmlog"
    torn.write_bytes(whole[: len(whole) * 2 // 3])
    done = inertiactl("export", torn, "--to", "csv", "-o", tmp_path / "x.csv")
    assert done.returncode == 0
    assert "cut off in the middle of a record" in done.stderr and "messages before it were read" in done.stderr
    part, signals = file_formats.read_csv(tmp_path / "x.csv").tables["signals"], recorded.tables["signals"]
    assert 0 < len(part) < len(signals)
    np.testing.assert_array_equal(part.columns["acc_x"], signals.columns["acc_x"][: len(part)])


@pytest.mark.slow
def test_log_of_another_version_is_named_and_refused(run: Path, tmp_path: Path, inertiactl):
    newer = lcmlog.Writer(tmp_path / "newer.lcmlog")
    for event in lcmlog.read(run / "run.lcmlog"):
        is_changed = event.channel == "INERTIAD_ESTIMATE"
        newer.write(event.t_us, event.channel, bytes(8) + event.data[8:] if is_changed else event.data)
    newer.close()
    text = refused("export", newer.path, "--to", "mat", "-o", tmp_path / "x.mat", run=inertiactl)
    assert "INERTIAD_ESTIMATE" in text and "estimate_t of this version" in text


def test_channels_of_another_prefix_are_told(run: Path, recorded: Dataset, tmp_path: Path):
    other = lcmlog.Writer(tmp_path / "other.lcmlog")
    for event in lcmlog.read(run / "run.lcmlog"):
        other.write(event.t_us, event.channel.replace("INERTIAD_", "DEMO_"), event.data)
    other.close()
    same(recorded, dataset.read(other.path, None, "DEMO_", []))
    with pytest.raises(InputError, match=r"nothing to export: .*other channels than INERTIAD_"):
        dataset.read(other.path, None, "INERTIAD_", [])


@pytest.mark.slow
def test_empty_run_and_absent_body_are_refused(tmp_path: Path, inertiactl):
    (tmp_path / "empty").mkdir()
    text = refused("export", tmp_path / "empty", "--to", "csv", "-o", tmp_path / "x.csv", run=inertiactl)
    assert "nothing to export" in text and "can.log" in text
    text = refused("export", tmp_path / "empty", "--to", "urdf", "-o", tmp_path / "x.urdf", run=inertiactl)
    assert "estimate.json" in text
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.slow
def test_run_without_tracker_says_so_and_gives_its_frames(run: Path, tmp_path: Path, inertiactl):
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("robot.toml", "can.log", "xsens_mti600.dbc", "me_gsv4.dbc"):
        (folder / name).write_bytes((run / name).read_bytes())
    done = inertiactl("export", folder, "--to", "csv", "-o", tmp_path / "x.csv")
    assert done.returncode == 0 and "no signals: " in done.stderr and "tracker.csv: not found" in done.stderr
    assert list(file_formats.read_csv(tmp_path / "x.csv").tables) == []
    assert file_formats.read_csv(tmp_path / "x.csv").frames is not None
    (tmp_path / "signals.csv").write_text("t,acc_x\n1,2\n")
    (tmp_path / "tracker").mkdir()
    (tmp_path / "tracker/tracker.csv").write_text("t,x,y,z\n1,2,3,4\n")
    text = refused("export", tmp_path / "tracker", "--to", "candump", "-o", tmp_path / "y.log", run=inertiactl)
    assert "no CAN frame" in text


@pytest.mark.parametrize(
    ("form", "package"), [("parquet", "pyarrow"), ("mcap", "mcap"), ("mcap", "foxglove_schemas_protobuf")]
)
def test_missing_package_is_named(form: str, package: str, recorded: Dataset, tmp_path: Path, monkeypatch):
    for name in [n for n in sys.modules if n == package or n.startswith(f"{package}.")] + [package]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=f"{form}: needs the Python package {package}"):
        file_formats.FORMATS[form].write(tmp_path / "x", recorded)


@pytest.mark.parametrize("form", ["parquet", "mcap", "mat", "mf4"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5])
def test_damaged_file_is_refused_in_one_line(form: str, share: float, recorded: Dataset, tmp_path: Path):
    path = tmp_path / f"x{file_formats.FORMATS[form].ending}"
    file_formats.FORMATS[form].write(path, recorded)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError) as error:
        convert.import_file(path, tmp_path / "run", None, [])
    assert str(error.value).startswith(f"{path}: ")
    assert len(str(error.value).splitlines()) == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "line 1: no column t"),
        ("", "line 1: no column t"),
        ("t,acc_x\n1,2,3\n", "line 2: 3 values: allowed: 2"),
        ("t,acc_x\n1,abc\n", 'line 2: acc_x = "abc": allowed: a number'),
        ("t,acc_x,acc_x\n1,2,3\n", "line 1: column acc_x is there twice"),
        ("t,acc_x [kg]\n1,2\n", 'acc_x: unit "kg": allowed: m/s2'),
    ],
)
def test_foreign_csv_with_a_mistake_is_named(text: str, message: str, tmp_path: Path):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(InputError) as error:
        convert.import_file(tmp_path / "x.csv", tmp_path / "run", None, [])
    assert message in str(error.value)


def test_units_in_csv_heads_are_converted(tmp_path: Path):
    path = tmp_path / "x.csv"
    path.write_text("t [ms],acc_x [g],gyro_x [deg/s],f_1 [kN],x [mm]\n1000,1,180,2,5\n2000,0,0,0,0\n")
    allowed = ["t", "acc_x", "gyro_x", "f_1", "x"]
    checked, any_columns = table.read(path, allowed), dataset.read_csv(path)
    assert checked.t.tolist() == [1.0, 2.0] and any_columns.t_ns.tolist() == [10**9, 2 * 10**9]
    for name, value in (("acc_x", 9.80665), ("gyro_x", np.pi), ("f_1", 2000.0), ("x", 0.005)):
        assert checked.columns[name][0] == pytest.approx(value, rel=1e-12)
        assert any_columns.columns[name][0] == pytest.approx(value, rel=1e-12)
    path.write_text("t,x [N]\n1,2\n")
    with pytest.raises(InputError, match=r'line 1: x: unit "N": allowed: m, cm'):
        table.read(path, allowed)
