# SPDX-License-Identifier: Apache-2.0
"""CSV files of other tools: separators, decimal commas, units, rates of their own, and the mapping to quantities."""

import re

import numpy as np
import pytest
from conftest import minimal_toml
from scipy.spatial.transform import Rotation

from inertiad.base import table
from inertiad.base.error import InputError
from inertiad.exchange import channels, convert, foreign_csv, foreign_import
from inertiad.robot import description
from inertiad.run import canlog, signals_csv, tracker_csv

G = 9.80665
T = 1.0 + np.arange(400) / 200.0
ACC = np.column_stack([0.3 * np.sin(T), 0.2 * np.cos(2 * T), G + 0.1 * np.sin(3 * T)])
GYRO = np.column_stack([0.1 * np.sin(T), 0.2 * np.cos(T), 0.05 * np.sin(2 * T)])
RPY = np.column_stack([0.1 * np.sin(T), 0.2 * np.cos(T), 3.2 * np.sin(T)])
FORCE = 100.0 + 20.0 * np.sin(np.outer(T, [1.0, 2.0, 3.0, 0.5]))
HEADS = [
    *(f"IMU Acc{a} [g]" for a in "XYZ"),
    *(f"GYR_{a} (deg/s)" for a in "XYZ"),
    *(f"{n} [°]" for n in ("Roll", "PITCH", "Yaw")),
    *(f"LC{i} [kN]" for i in range(1, 5)),
]


def german(path, encoding="utf-8-sig", separator=";"):
    """IMU at 200 Hz, load cells at 100 Hz in kN, decimal commas, time in ms."""
    values = np.column_stack([ACC / G, np.rad2deg(GYRO), np.rad2deg(RPY), FORCE / 1e3])
    lines = [separator.join(["Zeit [ms]", *HEADS])]
    for i, row in enumerate(values):
        cells = [f"{1e3 * T[i]:.3f}", *(f"{v:.7f}" for v in row)]
        cells = cells if i % 2 == 0 else [*cells[:-4], *[""] * 4]
        lines.append(separator.join(cells).replace(".", ","))
    path.write_text("\r\n".join(lines) + "\r\n", encoding=encoding)
    return path


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(minimal_toml(4))
    return path


@pytest.mark.parametrize(("encoding", "separator"), [("utf-8-sig", ";"), ("utf-16", "\t"), ("cp1252", ";")])
def test_values_are_those_of_the_file_in_si(tmp_path, robot, encoding, separator):
    file, run = german(tmp_path / "log.csv", encoding, separator), tmp_path / "run"
    assert convert.is_foreign(file)
    remarks = []
    written = foreign_import.import_mapped(file, run, robot, None, remarks)
    found = signals_csv.read(run / "signals.csv", description.load(robot))
    inside = slice(0, len(found))
    np.testing.assert_allclose(found.t, T[inside], atol=1e-9)
    np.testing.assert_allclose(found.stack("acc_x", "acc_y", "acc_z"), ACC[inside], atol=1e-5)
    np.testing.assert_allclose(found.stack("gyro_x", "gyro_y", "gyro_z"), GYRO[inside], atol=1e-7)
    np.testing.assert_allclose(found.stack("f_1", "f_2", "f_3", "f_4")[::2], FORCE[inside][::2], atol=1e-3)
    between = 0.5 * (FORCE[0] + FORCE[2])
    np.testing.assert_allclose(found.stack("f_1", "f_2", "f_3", "f_4")[1], between, atol=1e-3)
    true = Rotation.from_euler("ZYX", RPY[inside][:, ::-1])
    turned = Rotation.from_quat(found.stack("q_w", "q_x", "q_y", "q_z"), scalar_first=True)
    assert (turned * true.inv()).magnitude().max() < 1e-6
    assert any("forces at 100 Hz are interpolated to the IMU's 200 Hz" in remark for remark in remarks)
    assert any(line.endswith("rows, 200 Hz") for line in written)


def test_can_log_keeps_each_sensors_rate(tmp_path, robot):
    run = tmp_path / "run"
    foreign_import.import_mapped(german(tmp_path / "log.csv"), run, robot, None, [])
    log = canlog.read_candump(run / "can.log")
    times = {int(i): log.t_ns[log.can_id == i] for i in np.unique(log.can_id)}
    rates = sorted(round(1e9 / float(np.median(np.diff(t)))) for t in times.values())
    assert rates == [100, 200]
    assert (np.diff(log.t_ns) >= 0).all()


def test_proposed_mapping_is_one_that_gives_the_same(tmp_path, robot):
    file = german(tmp_path / "log.csv")
    foreign_import.import_mapped(file, tmp_path / "a", robot, None, [])
    mapping = channels.read_mapping(tmp_path / "a/log.map.toml")
    foreign_import.import_mapped(file, tmp_path / "b", robot, mapping, [])
    for name in ("signals.csv", "can.log"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_mapping_changes_channel_unit_sign_and_offset(tmp_path):
    file, run = german(tmp_path / "log.csv"), tmp_path / "run"
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        '[time]\nchannel = "Zeit"\n[channels.f_1]\nchannel = "LC3"\nscale = -1.0\noffset = 5.0\n'
        '[channels.f_2]\nchannel = "LC1"\nunit = "N"\n'
    )
    foreign_import.import_mapped(file, run, None, channels.read_mapping(mapping), [])
    found = table.read_columns(run / "signals.csv")
    np.testing.assert_allclose(found.columns["f_1"], 5.0 - FORCE[::2, 2], atol=1e-3)
    np.testing.assert_allclose(found.columns["f_2"], FORCE[::2, 0] / 1e3, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[channels.f_1]\nchannel = "LC9"\n', 'f_1: no channel "LC9"; did you mean LC'),
        ('[channels.f_1]\nchannel = "LC1"\nunit = "deg"\n', 'f_1: unit "deg" of "LC1": allowed: N'),
        ('[channels.g_1]\nchannel = "LC1"\n', "channels.g_1: not a quantity"),
        ('[time]\nchannel = "clock"\n', 'no column "clock"; columns: Zeit, IMU AccX'),
        ('[channels.f_1]\nchanel = "LC1"\n', "unknown key; did you mean channel?"),
    ],
)
def test_wrong_mapping_is_refused_with_the_remedy(tmp_path, text, message):
    file, path = german(tmp_path / "log.csv"), tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        foreign_import.import_mapped(file, tmp_path / "run", None, channels.read_mapping(path), [])
    assert message in "\n".join(caught.value.lines)


def test_motion_capture_in_mm_without_units(tmp_path):
    file, run = tmp_path / "mocap.csv", tmp_path / "run"
    rows = "".join(f"{i},{i / 120:.4f},{10.0 * i:.3f},{500 - i:.3f},1000\n" for i in range(200))
    file.write_text("Frame,Time,X,Y,Z\n" + rows)
    remarks = []
    foreign_import.import_mapped(file, run, None, None, remarks)
    found = tracker_csv.read(run / "tracker.csv")
    np.testing.assert_allclose(found.columns["x"], 0.01 * np.arange(200), atol=1e-9)
    assert "no unit in the file: mm assumed for pos_x, pos_y, pos_z (values above 100)" in remarks
    assert any(re.match(r"Frame: 200 samples, 120 Hz, .*: not recognised", remark) for remark in remarks)


def test_row_of_units_below_the_names(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("exported by a logger\nTime;f_0;f_1\ns;kN;kN\n" + "".join(f"{i};1,5;2,5\n" for i in range(5)))
    found = {item.quantity: item.channel for item in channels.summary(file)}
    assert {name: (c.name, c.unit, c.value[0]) for name, c in found.items()} == {
        "f_1": ("f_0", "kN", 1.5),
        "f_2": ("f_1", "kN", 2.5),
    }


def test_quaternion_counted_from_zero_beside_forces_counted_from_zero(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,q0,q1,q2,q3,f_0,f_1\n" + "".join(f"{i / 100},1,0,0,0,10,20\n" for i in range(50)))
    found = {item.quantity: item.channel.name for item in channels.summary(file) if item.quantity}
    assert found == {"q_w": "q0", "q_x": "q1", "q_y": "q2", "q_z": "q3", "f_1": "f_0", "f_2": "f_1"}


def test_gap_of_a_sensor_is_left_out_and_named(tmp_path, robot):
    file, remarks = german(tmp_path / "log.csv"), []
    lines = file.read_text(encoding="utf-8-sig").splitlines()
    silent = slice(1 + 200, 1 + 300)  # of 200 Hz: half a second of the load cells
    lines[silent] = [";".join([*line.split(";")[:-4], *[""] * 4]) for line in lines[silent]]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8-sig")
    foreign_import.import_mapped(file, tmp_path / "run", robot, None, remarks)
    t = signals_csv.read(tmp_path / "run/signals.csv", description.load(robot)).t
    assert not ((t > T[200]) & (t < T[298])).any()
    assert (t < T[200]).sum() > 190 and (t > T[300]).sum() > 90
    assert any("rows are left out" in line and "f_1" in line for line in remarks), remarks


def test_mapping_that_was_edited_is_not_overwritten(tmp_path, robot):
    file = german(tmp_path / "log.csv")
    foreign_import.import_mapped(file, tmp_path / "run", robot, None, [])
    edited = tmp_path / "run/log.map.toml"
    edited.write_text("# mine\n" + edited.read_text())
    with pytest.raises(InputError, match="is there already; pass --map"):
        foreign_import.import_mapped(file, tmp_path / "run", robot, None, [])
    assert edited.read_text().startswith("# mine")


def test_accelerometer_in_g_without_units(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,ax,ay,az\n" + "".join(f"{i / 100},0.01,-0.02,1.0\n" for i in range(50)))
    text = channels.mapping_text(file, channels.summary(file))
    assert text.count('unit = "g"  # the file gives no unit; assumed: usual length 1') == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no rows below a header"),
        ("a,b\n", "no rows below a header"),
        ("Time,f_1\n1,2\n1,3\n", "line 3: Time does not increase"),
        ("Time,f_1\n1,2\n2,x\n3,4\n", 'line 3: f_1 = "x": allowed: a number, or blank'),
        ("Time,f_1\n1,2\n2,3,4\n", "line 3: 3 values: allowed: 2"),
        ("Time,f_1,f_1\n1,2,3\n2,3,4\n", "column f_1 is there 2 times"),
        ("a,b\n1,2\n2,3\n", "no column of time"),
        ("Time [kg],f_1\n1,2\n2,3\n", "no column of time"),
    ],
)
def test_unusable_file_is_refused_with_line_and_column(tmp_path, text, message):
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=re.escape(message)):
        foreign_csv.read(file)


@pytest.mark.parametrize("seed", range(20))
def test_no_bytes_make_a_traceback(tmp_path, seed):
    dice = np.random.default_rng(seed)
    whole = bytearray(german(tmp_path / "log.csv").read_bytes()[:4000])
    for at in dice.integers(0, len(whole), 30):
        whole[at] = dice.integers(0, 256)
    (tmp_path / "bad.csv").write_bytes(bytes(whole))
    try:
        foreign_import.import_mapped(tmp_path / "bad.csv", tmp_path / "run", None, None, [])
    except InputError as error:
        assert str(error)


def test_own_files_are_not_foreign(tmp_path):
    file = tmp_path / "signals.csv"
    file.write_text("t,acc_x [g],f_1\n0,1,2\n1,1,2\n")
    assert not convert.is_foreign(file)
    file.write_text("t,acc_x [g],f_1\n0,1,2\n1,1,\n")
    assert convert.is_foreign(file)


def test_init_takes_cables_and_rate_from_a_recording(inertiactl, tmp_path, robot):
    done = inertiactl("init", "--from", german(tmp_path / "log.csv"), "-o", tmp_path / "new.toml")
    assert done.returncode == 0, done.stderr
    made = description.load(tmp_path / "new.toml")
    assert (made.n_cables, made.imu.rate) == (4, 200.0)


def test_cells_that_are_not_finite_are_no_samples(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,f_1 [N],f_2 [N]\n0,inf,nan\n1,2,nan\n2,nan,-inf\nnan,3,1\n4,5,nan\n")
    (only,) = foreign_csv.read(path)
    assert (only.name, only.t.tolist(), only.value.tolist()) == ("f_1", [1.0, 4.0], [2.0, 5.0])


def test_damaged_mdf_ends_with_one_line(inertiactl, tmp_path):
    (tmp_path / "log.mf4").write_bytes(b"MDF     4.10    " + bytes(200))
    done = inertiactl("import", tmp_path / "log.mf4", "-o", tmp_path / "run")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
