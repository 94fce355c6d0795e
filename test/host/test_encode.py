# SPDX-License-Identifier: Apache-2.0
"""Packing against cantools and the C decoder on random databases; units; CSV files with something wrong in them."""

import math
from dataclasses import dataclass

import can
import cantools
import numpy as np
import pytest
from conftest import minimal_toml
from hypothesis import given, settings
from hypothesis import strategies as st

import inertiad_core
from inertiad.base import quantity, units
from inertiad.base.error import InputError
from inertiad.base.table import Table
from inertiad.robot import configuration, dbc, description
from inertiad.robot.description import Robot
from inertiad.robot.messages import validate
from inertiad.run import encode

N = 5
UNITS = {"acceleration": ["m/s2", "g", "mg", ""], "rate": ["rad/s", "deg/s", "dps"], "force": ["N", "kN"], "none": [""]}
SI = {"m/s2": 1.0, "g": 9.80665, "mg": 9.80665e-3, "rad/s": 1.0, "deg/s": math.pi / 180, "dps": math.pi / 180, "N": 1.0}
SI |= {"kN": 1e3, "": 1.0}


@dataclass
class Layout:
    """A random DBC with one message per group of quantities, and raw values for every signal."""

    text: str
    signals: dict[str, str]
    raw: dict[str, list[float]]


@st.composite
def message_signals(draw, names, n_bytes, selector):
    """DBC lines that place the names' signals in one message without overlap: one signal per run of whole bytes."""
    share = (n_bytes - 1) // len(names)
    lines, raw = [], {}
    for i, name in enumerate(names):
        room = 8 * share
        first = 8 * (1 + i * share)  # byte 0 is left to the multiplexer
        kind = draw(st.sampled_from(["int", "int", "float", "double"]))
        kind = "int" if room < (64 if kind == "double" else 32) else kind
        length = {"float": 32, "double": 64}.get(kind) or draw(st.integers(2, min(64, room)))
        spare = draw(st.integers(0, room - length))
        big = draw(st.booleans())
        # Intel counts up from the least significant bit, Motorola starts at the most significant one.
        start = 8 * ((first + spare) // 8) + 7 - (first + spare) % 8 if big else first + spare
        signed = kind != "int" or draw(st.booleans())
        unit = draw(st.sampled_from(UNITS[quantity.dimension(name)]))
        scale = draw(st.sampled_from([1.0, 0.5, 0.01, 3.0, -0.25])) if kind == "int" else 1.0
        offset = draw(st.sampled_from([0.0, 0.0, -10.0, 1.5])) if kind == "int" else 0.0
        lines.append(
            f" SG_ {name}{selector} : {start}|{length}@{0 if big else 1}{'-' if signed else '+'} "
            f'({scale},{offset}) [0|0] "{unit}" X'
        )
        low, high = (-(2 ** (length - 1)), 2 ** (length - 1) - 1) if signed else (0, 2**length - 1)
        bound = min(high, 2**52)
        values = st.integers(max(low, -bound), bound) if kind == "int" else st.floats(-1e6, 1e6, width=32)
        raw[name] = (kind, scale, offset, SI[unit], [float(v) for v in draw(st.lists(values, min_size=N, max_size=N))])
    return lines, raw


@st.composite
def layouts(draw):
    groups = [quantity.ACC, quantity.GYRO, quantity.QUATERNION, ("f_1", "f_2")]
    text, signals, raw, types = 'VERSION ""\nNS_ :\nBS_:\nBU_: X\n', {}, {}, []
    used = set()
    for i, names in enumerate(groups):
        extended = draw(st.booleans())
        number = draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF).filter(lambda n: n not in used))
        used.add(number)
        can_id = number | (0x80000000 if extended else 0)
        n_bytes = draw(st.sampled_from([8, 12, 24, 48, 64]))
        muxed = draw(st.booleans())
        selector = f" m{draw(st.integers(0, 255))}" if muxed else ""
        lines, values = draw(message_signals(names, n_bytes, selector))
        head = ' SG_ selector M : 0|8@1+ (1,0) [0|0] "" X\n' if muxed else ""
        text += f"\nBO_ {can_id} M{i}: {n_bytes} X\n{head}" + "\n".join(lines) + "\n"
        signals |= {name: f"M{i}.{name}" for name in names}
        raw |= values
        types += [
            f"SIG_VALTYPE_ {can_id} {n} : {1 if v[0] == 'float' else 2};" for n, v in values.items() if v[0] != "int"
        ]
    return Layout(text + "\n" + "\n".join(types) + "\n", signals, raw)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(layouts())
def test_random_database_decodes_to_what_was_encoded(tmp_path_factory, layout):
    path = tmp_path_factory.mktemp("dbc") / "random.dbc"
    path.write_text(layout.text)
    cables = [{"anchor": [x, 0.0, 3.0], "attachment": [0.0, 0.0, 0.0]} for x in (-1.0, 1.0)]
    data = {"name": "x", "cable": cables, "bus": [{"dbc": str(path)}], "signals": layout.signals}
    robot = validate(Robot, data, "random")
    physical = {n: np.array(v) * scale + offset for n, (_, scale, offset, _, v) in layout.raw.items()}
    si = {n: value * layout.raw[n][3] for n, value in physical.items()}
    t = np.arange(N, dtype=float)
    bindings = dbc.bind(robot, "random")
    frames = encode.pack(bindings, Table(t, si, "random"), t)

    database = cantools.database.load_file(path)
    config = inertiad_core.Config(configuration.compile_robot(robot, "random"))
    seen = set()
    for f in frames:
        message = database.get_message_by_frame_id(f.can_id & 0x1FFFFFFF, f.can_id >> 31 == 1)
        for k in range(N):
            payload = f.data[k].tobytes()
            by_core = inertiad_core.decode_frame(config, 0, f.can_id, payload)
            for name, value in message.decode(payload, decode_choices=False).items():
                if name == "selector":
                    continue
                kind, scale, _, factor, raw = layout.raw[name]
                tolerance = 1e-9 * (abs(physical[name][k]) + abs(scale)) if kind == "int" else 2e-7 * abs(raw[k])
                assert value == pytest.approx(physical[name][k], abs=tolerance, rel=0), name
                assert by_core[quantity.QUANTITIES[name]] == pytest.approx(
                    value * factor, rel=1e-12, abs=1e-12 * factor
                )
                seen.add((name, k))
    assert seen == {(name, k) for name in layout.raw for k in range(N)}


def four(robot_file, extra=""):
    path = robot_file(minimal_toml(8, extra))
    return path, description.load(path)


HEADER = "t,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z,q_w,q_x,q_y,q_z," + ",".join(f"f_{i + 1}" for i in range(8))


def row(t, force=100.0):
    return f"{t},0.1,-0.2,9.81,0.01,0.02,0.03,1,0,0,0," + ",".join([str(force)] * 8)


GOOD = "\n".join([HEADER, row(0.0), row(0.001), row(0.002)]) + "\n"
TRACKED = "t,x,y,z\n0.0,0.1,0.2,1.5\n0.002,0.1,0.2,1.5\n"


def run_encode(tmp_path, robot_file, signals=GOOD, tracker=TRACKED, extra=""):
    path, robot = four(robot_file, extra)
    (tmp_path / "signals.csv").write_text(signals)
    (tmp_path / "tracker.csv").write_text(tracker)
    return encode.encode(path, robot, tmp_path / "signals.csv", tmp_path / "tracker.csv", tmp_path / "run")[0]


def test_encode_run_folder_reads_back(tmp_path, robot_file):
    assert run_encode(tmp_path, robot_file) == 6
    run = tmp_path / "run"
    database = cantools.database.load_file(run / "generated.dbc")
    frames = list(can.LogReader(run / "can.log"))
    assert [f.timestamp for f in frames] == pytest.approx([0.0, 0.0, 0.001, 0.001, 0.002, 0.002])
    assert all(f.is_fd for f in frames)
    imu = [database.decode_message(f.arbitration_id, f.data) for f in frames if f.arbitration_id == 0x100]
    assert [f["counter"] for f in imu] == [0, 1, 2]
    assert [f["time"] for f in imu] == [0, 1000, 2000]
    assert imu[1]["acc_z"] == pytest.approx(9.81, rel=1e-7)
    again = description.load(run / "robot.toml")
    assert again.bus[0].files == [run / "generated.dbc"]
    assert inertiad_core.Config(configuration.compile_robot(again, "again")).n_cables == 8
    assert (run / "tracker.csv").read_text().splitlines()[1] == "0.000000,0.100000000,0.200000000,1.500000000"


def test_encode_euler_angles_stand_for_the_quaternion(tmp_path, robot_file):
    signals = GOOD.replace("q_w,q_x,q_y,q_z", "roll,pitch,yaw").replace(",1,0,0,0,", ",0.1,0.2,0.3,")
    run_encode(tmp_path, robot_file, signals)
    database = cantools.database.load_file(tmp_path / "run/generated.dbc")
    frame = next(f for f in can.LogReader(tmp_path / "run/can.log") if f.arbitration_id == 0x100)
    decoded = database.decode_message(0x100, frame.data)
    half = np.array([0.05, 0.1, 0.15])
    (sr, sp, sy), (cr, cp, cy) = np.sin(half), np.cos(half)
    assert decoded["q_w"] == pytest.approx(cr * cp * cy + sr * sp * sy, abs=1e-6)
    assert decoded["q_x"] == pytest.approx(sr * cp * cy - cr * sp * sy, abs=1e-6)


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ("", "line 1: no column t"),
        (HEADER + "\n", "no data below the header"),
        (GOOD.replace(row(0.001), row("0.00l")), 'line 3: t = "0.00l": allowed: a number'),
        (GOOD.replace(row(0.001), row(0.001)[:-6]), "line 3: 18 values: allowed: 19, one per column of the header"),
        (GOOD.replace(row(0.001), row(0.0)), "line 3: t = 0 s: allowed: above 0, the line before"),
        (GOOD.replace(row(0.001), row(0.001, "nan")), "line 3: f_1 = nan: allowed: a finite number"),
        (GOOD.replace("f_3", "f_03"), 'line 1: column "f_03" is unknown'),
        (GOOD.replace("f_3", "f_2"), "line 1: column f_2 is there twice"),
        (GOOD.replace(",1,0,0,0,", ",0.7,0,0,0,"), "t = 0.000000 s: |q| = 0.7: allowed: 1, within 1 %"),
        (GOOD.replace("9.81", "98100"), "acc_z = 98100: allowed: -1000 to 1000, by generated.dbc: IMU.acc_z"),
        (
            "\n".join(",".join(line.split(",")[:-1]) for line in GOOD.splitlines()),
            "line 1: no column f_8, which the robot's CAN signals need",
        ),
        (GOOD.replace("0.0,0.1", "-1.0,0.1"), "t = -1 s: allowed: 0 and later"),
    ],
)
def test_encode_bad_signals_name_file_line_and_column(tmp_path, robot_file, signals, message):
    with pytest.raises(InputError) as caught:
        run_encode(tmp_path, robot_file, signals)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "signals.csv"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("tracker", "message"),
    [
        (TRACKED.replace("1.5", "1500"), "z = 1500 m at t = 0 s: allowed: within 100 m; is the file in mm?"),
        (TRACKED.replace(",z", ""), "line 2: 4 values: allowed: 3"),
        ("t,x,y\n0,1,2\n", "line 1: no column z"),
    ],
)
def test_encode_bad_tracker_is_one_line(tmp_path, robot_file, tracker, message):
    with pytest.raises(InputError) as caught:
        run_encode(tmp_path, robot_file, tracker=tracker)
    assert message in str(caught.value)


def test_encode_without_position_is_refused(tmp_path, robot_file):
    path, robot = four(robot_file)
    (tmp_path / "signals.csv").write_text(GOOD)
    with pytest.raises(InputError, match=r'position.source = "tracker"; pass --tracker'):
        encode.encode(path, robot, tmp_path / "signals.csv", None, tmp_path / "run")


def test_encode_fixed_position_needs_no_tracker(tmp_path, robot_file):
    path, robot = four(robot_file, '[position]\nsource = "fixed"\nfixed = [0, 0, 1]\n')
    (tmp_path / "signals.csv").write_text(GOOD)
    encode.encode(path, robot, tmp_path / "signals.csv", None, tmp_path / "run")
    assert not (tmp_path / "run/tracker.csv").exists()


def test_counter_and_time_wrap_at_their_lengths(cogiro):
    n = 70_000
    t = 4294.0 + np.arange(n) / 1000.0
    names = dbc.required(cogiro)
    columns = {name: np.full(n, 1.0 if name == "q_w" else 0.0) for name in names}
    frames = encode.pack(dbc.bind(cogiro, "robot.toml"), Table(t, columns, "test"), t)
    clock = next(f for f in frames if f.can_id == 0x10)
    counter = clock.data[:, 4].astype(int) * 256 + clock.data[:, 5]
    ticks = clock.data[:, :4].astype(np.uint64) @ np.array([1 << 24, 1 << 16, 1 << 8, 1], dtype=np.uint64)
    assert np.array_equal(counter, np.arange(n) % 65536)
    assert np.array_equal(ticks, np.rint(t * 1e6).astype(np.uint64) % 2**32)


@pytest.mark.parametrize(
    ("unit", "dimension", "factor"),
    [
        ("g", "acceleration", 9.80665),
        ("m/s²", "acceleration", 1.0),
        ("m/s^2", "acceleration", 1.0),
        ("°/s", "rate", math.pi / 180),
        ("deg", "angle", math.pi / 180),
        ("mm", "length", 1e-3),
        ("kN", "force", 1e3),
        ("µs", "time", 1e-6),
        (None, "force", 1.0),
    ],
)
def test_units_become_si(unit, dimension, factor):
    assert units.unit_factor(unit, dimension) == pytest.approx(factor)


@pytest.mark.parametrize(("unit", "dimension"), [("kN", "acceleration"), ("m", "force"), ("furlong", "length")])
def test_unit_of_another_dimension_is_refused(unit, dimension):
    with pytest.raises(KeyError):
        units.unit_factor(unit, dimension)
