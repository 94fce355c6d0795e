# SPDX-License-Identifier: Apache-2.0
"""robot.toml: what is refused, with which words, and what is filled in."""

import tomllib

import pytest
from conftest import COGIRO, minimal_toml
from hypothesis import given, settings
from hypothesis import strategies as st

from inertiad.base.error import InputError
from inertiad.base.text_files import to_toml
from inertiad.robot import description
from inertiad.robot.description import Robot
from inertiad.robot.messages import validate

TEXT = (COGIRO / "robot.toml").read_text()


def refused(path):
    with pytest.raises(InputError) as caught:
        description.load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    return message.removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pulley_radius", "puley_radius", "cables.puley_radius: unknown key; did you mean pulley_radius?"),
        ("[nominal]", "[nominl]", "nominl: unknown key; did you mean nominal?"),
        ("pulley_radius = 0.05", 'pulley_radius = "wide"', 'cables.pulley_radius = "wide": allowed: a number'),
        ("pulley_radius = 0.05", "pulley_radius = true", "cables.pulley_radius = true: allowed: a number"),
        ("pulley_radius = 0.05", "pulley_radius = -1", "cables.pulley_radius = -1: allowed: 0 to 10 m"),
        ("pulley_radius = 0.05", "pulley_radius = nan", "cables.pulley_radius = nan: allowed: a finite number"),
        (
            "swivel_axis = [0, 0, 1] ",
            "swivel_axis = [0, 0, 1.1] ",
            "cables.swivel_axis = [0, 0, 1.1]: allowed: a unit vector, this one has length 1.1",
        ),
        (
            "anchor = [-7.4786, -5.1544, 5.4009]",
            "anchor = [-7.4786, -5.1544]",
            "cable[2].anchor = [-7.4786, -5.1544]: allowed: 3 entries, not 2",
        ),
        ("tension_max = 5000", "tension_max = 50", "cables: allowed: tension_min = 100 below tension_max = 50 N"),
        ("mass = 161.058", "mass = -3", "nominal.mass = -3: allowed: 1e-06 to 1e+07 kg"),
        ('name = "CoGiRo"', "", "name: missing, and it has no default"),
        ("f_8 =", "f_9 =", "signals.f_9: not a cable of this robot: allowed: f_1 to f_8"),
        ("acc_x =", "acx_x =", "signals.acx_x: not a quantity; did you mean acc_x?"),
        ("[imu]", '[position]\nsource = "gps"\n[imu]', 'position.source = "gps": allowed: "tracker", "fixed" or "can"'),
        (
            "[imu]",
            "[calibration]\nforce_offset = [1, 2]\n[imu]",
            "calibration.force_offset with 8 numbers, one per cable, not 2",
        ),
    ],
)
def test_load_bad_value_names_key_value_and_allowed(robot_file, old, new, message):
    assert old in TEXT
    assert refused(robot_file(TEXT.replace(old, new, 1))) == message


def test_load_estimated_inertia_of_the_paper_is_refused_as_no_body(robot_file):
    impossible = TEXT.replace(
        "[94.955, 88.859, 31.635, 4.136, -0.085, -0.393]", "[102.982, 52.744, 46.589, 8.588, -0.132, -3.672]"
    )
    assert "nominal: allowed: inertia_cog of a rigid body" in refused(robot_file(impossible))


@pytest.mark.parametrize("n_cables", [1, 4, 8, 16])
def test_load_1_to_16_cables_is_accepted(robot_file, n_cables):
    assert description.load(robot_file(minimal_toml(n_cables))).n_cables == n_cables


@pytest.mark.parametrize(("n_cables", "message"), [(0, "cable: missing"), (17, "cable: 17 cables: allowed: 1 to 16")])
def test_load_other_numbers_of_cables_are_refused(robot_file, n_cables, message):
    assert refused(robot_file(minimal_toml(n_cables))).startswith(message)


@pytest.mark.parametrize("content", [b"gravity = 9.81 m", b"\xff\xfe", b"[[[", b"a = " + b"[" * 5000])
def test_load_something_else_than_toml_is_one_line(tmp_path, content):
    path = tmp_path / "robot.toml"
    path.write_bytes(content)
    assert refused(path)


def test_load_cable_overrides_the_default_of_all(robot_file):
    path = robot_file(minimal_toml(3) + "pulley_radius = 0.2\n")
    assert [c.pulley_radius for c in description.load(path).cable] == [0.0, 0.0, 0.2]
    assert [c.tension_min for c in description.load(path).cable] == [1.0, 1.0, 1.0]


def test_load_base_gives_the_keys_that_are_left_out():
    base, derived = (description.load(COGIRO / name) for name in ("robot.toml", "robot_fd.toml"))
    assert derived.cable == base.cable
    assert derived.nominal == base.nominal
    assert derived.bus[0].files == [COGIRO / "platform_fd.dbc"]
    assert derived.signals["acc_x"] == "PLATFORM.acc_x"


def test_load_base_of_itself_is_refused(robot_file):
    path = robot_file('base = "robot.toml"\nname = "x"\n')
    with pytest.raises(InputError, match="more than 8 files deep"):
        description.load(path)


def test_load_calibration_file_is_taken_in(robot_file, tmp_path):
    (tmp_path / "calibration.toml").write_text("acc_bias = [0.1, 0.2, 0.3]\nworld_yaw = 0.5\n")
    path = robot_file(minimal_toml(2) + '[calibration]\nfile = "calibration.toml"\nworld_yaw = 0.25\n')
    calibration = description.load(path).calibration
    assert calibration.acc_bias == [0.1, 0.2, 0.3]
    assert calibration.world_yaw == 0.25


names = st.text("abcdefghijklmnopqrstuvwxyz_", min_size=1, max_size=8)
scalars = st.one_of(
    st.booleans(),
    st.integers(-(2**53), 2**53),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
)
tables = st.recursive(
    st.dictionaries(names, st.one_of(scalars, st.lists(scalars, max_size=3)), max_size=4),
    lambda inner: st.dictionaries(
        names, st.one_of(scalars, inner, st.lists(inner, min_size=1, max_size=3)), max_size=4
    ),
    max_leaves=10,
)


@given(tables)
def test_to_toml_reads_back_the_same(data):
    assert tomllib.loads(to_toml(data)) == data


def test_written_robot_is_the_robot(cogiro):
    data = description.read_data(COGIRO / "robot.toml")
    assert validate(Robot, tomllib.loads(to_toml(data)), "again") == cogiro


def paths(data, prefix=()):
    """Every key path of nested dicts and lists."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*prefix, key)
        yield from paths(value, (*prefix, key))


PATHS = list(paths(tomllib.loads(TEXT)))
anything = st.one_of(scalars, st.floats(), st.lists(scalars, max_size=4), tables)


@settings(max_examples=400, deadline=None)
@given(st.sampled_from(PATHS), anything)
def test_anything_anywhere_is_accepted_or_one_line(path, value):
    data = tomllib.loads(TEXT)
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    try:
        validate(Robot, data, "robot.toml")
    except InputError as error:
        assert "\n" not in str(error)
        assert str(error).startswith("robot.toml: ")
