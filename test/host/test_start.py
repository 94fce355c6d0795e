# SPDX-License-Identifier: Apache-2.0
"""A new robot.toml, the reference of its keys and their JSON schema: one description of the keys behind all of them."""

import tomllib

import pytest
from conftest import COGIRO, TOP, minimal_toml
from jsonschema import Draft202012Validator
from pydantic import BaseModel

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.recognition import recognise
from inertiad.robot import configuration, description, keys, reference, template
from inertiad.robot.description import Robot
from inertiad.robot.messages import validate

DEVICES = TOP / "firmware/robots/devices"
ROBOTS = [*COGIRO.glob("*.toml"), *DEVICES.glob("*.toml")]
TABLES = [
    t for t in vars(keys).values() if isinstance(t, type) and issubclass(t, BaseModel) and t.__module__ == keys.__name__
]


@pytest.fixture(scope="module")
def schema():
    return reference.schema()


@pytest.fixture(scope="module")
def validator(schema):
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


@pytest.mark.parametrize("n", range(1, quantity.CABLES_MAX + 1))
def test_new_file_compiles(tmp_path, n):
    path = tmp_path / "robot.toml"
    path.write_text(template.text(template.Start("new", n)))
    robot = description.load(path)
    assert robot.n_cables == n
    assert configuration.compile_robot(robot, "new")


def test_new_file_has_the_defaults_of_the_model(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(template.text(template.Start("new", 4)))
    active = [key.removeprefix("# ") for key in path.read_text().splitlines()]
    path.write_text(
        "\n".join(line for line in active if " = " in line and line.startswith(("pulley_radius", "force_at")))
    )
    given = tomllib.loads(path.read_text())
    assert given == {"pulley_radius": 0.0, "force_at": "platform"}


def test_signals_are_proposed_from_the_dbc(tmp_path):
    files = [DEVICES / "xsens_mti600.dbc", DEVICES / "me_gsv4.dbc"]
    start = template.start_from_dbc("new", files, 4, None, tmp_path)
    proposed = {name: value for name, value in start.signals.items() if not name.startswith("f_")}
    bound = tomllib.loads((DEVICES / "xsens_gsv4.toml").read_text())["signals"]
    assert {name: bound[name] for name in proposed if name in bound and "counter" not in name} == {
        name: value for name, value in proposed.items() if name in bound and "counter" not in name
    }
    assert set(quantity.ACC + quantity.GYRO + quantity.QUATERNION) <= set(proposed)


def test_file_of_a_complete_dbc_compiles(tmp_path, cogiro):
    start = template.start_from_dbc("new", [COGIRO / "platform.dbc"], None, 200.0, tmp_path)
    path = tmp_path / "robot.toml"
    path.write_text(template.text(start))
    made = description.load(path)
    assert made.n_cables == 8
    assert made.imu.rate == 200.0
    needed = (*quantity.ACC, *quantity.GYRO, *quantity.forces(8))
    assert {n: made.signals[n] for n in needed} == {n: cogiro.signals[n] for n in needed}
    assert configuration.compile_robot(made, "new")


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_schema_accepts_every_robot(validator, path):
    assert not list(validator.iter_errors(tomllib.loads(path.read_text())))


@pytest.mark.parametrize(
    "extra",
    [
        "[imu]\nposition = [0.0, 0.0]\n",
        "[imu]\nrte = 100.0\n",
        "[imu]\nrate = -1.0\n",
        "[imu]\nrate = 'fast'\n",
        "[position]\nsource = 'gps'\n",
        "[estimator]\nmemory = 5.0\n",
        "[nominal]\nmass = 3.0\n",
        "[signals]\nacx_x = 'A.b'\n",
        "[align]\nfilter_imu = { kind = 'bessel', order = 11, cutoff = 10.0 }\n",
    ],
)
def test_schema_refuses_what_the_description_refuses(validator, robot_file, extra):
    path = robot_file(minimal_toml(4, extra))
    assert list(validator.iter_errors(tomllib.loads(path.read_text())))
    with pytest.raises(InputError):
        description.load(path)


def test_schema_wants_name_and_cables_only_without_a_base(validator):
    assert list(validator.iter_errors({}))
    assert not list(validator.iter_errors({"base": "robot.toml", "nominal": {"mass": 3.0}}))


def numeric_keys(whole):
    """Path, least and greatest of every number with a range in the tables of robot.toml."""
    for name, key in whole["properties"].items():
        table = reference.table_of(key, whole["$defs"])
        if table is None or name == "cable":
            continue
        for inner, entry in table[0]["properties"].items():
            if entry.get("type") == "number" and "minimum" in entry:
                yield name, inner, entry["minimum"], entry["maximum"]


def test_ranges_of_the_schema_are_those_that_are_checked(schema):
    found = list(numeric_keys(schema))
    assert len(found) > 40
    base = tomllib.loads(minimal_toml(4))
    for table, key, low, high in found:
        beside = {"dbc": "a.dbc"} if table == "bus" else {"cog": [0.0] * 3, "inertia_cog": [1.0] * 3 + [0.0] * 3}
        for value in (low - 1.0 - abs(low), high + 1.0 + abs(high)):
            given = {**(beside if table in ("bus", "nominal") else {}), key: value}
            with pytest.raises(InputError, match=rf"{table}.*{key} = "):
                validate(Robot, base | {table: [given] if table == "bus" else given}, "x")


@pytest.mark.parametrize("model", [*TABLES, Robot], ids=lambda model: model.__name__)
def test_every_key_has_a_meaning(model):
    assert model.__doc__
    for name, key in model.model_fields.items():
        is_table = any(t.__name__ in str(key.annotation) for t in TABLES) and name not in ("signals",)
        assert key.description or (is_table and name not in ("filter_imu",)), f"{model.__name__}.{name}"


def test_reference_has_every_key_with_range_unit_and_default():
    text = reference.text()
    for model in TABLES:
        for name in model.model_fields:
            assert f"{name} = " in text, name
    assert "  max_wait = number 0 to 10 s; default 0.25\n" in text
    assert "  anchor = [3 numbers] -10000 to 10000 m; required\n" in text
    assert "  mass = number 1e-06 to 1e+07 kg; required\n" in text


@pytest.mark.parametrize(
    ("name", "unit", "found"),
    [
        ("accX", "g", "acc_x"),
        ("ACC_Y", "", "acc_y"),
        ("Linear Acceleration Z", "m/s²", "acc_z"),
        ("gyro.z", "deg/s", "gyro_z"),
        ("omega_x", "rad/s", "gyro_x"),
        ("quat_w", "", "q_w"),
        ("q0", "", "q_w"),
        ("q3", "", "q_z"),
        ("Heading", "deg", "yaw"),
        ("Force 3", "kN", "f_3"),
        ("load_cell_4", "N", "f_4"),
        ("LC12", "kN", "f_12"),
        ("Position X", "mm", "pos_x"),
        ("TimeStamp", "us", "t"),
        ("sample_counter", "", "counter"),
        ("temperature", "degC", None),
        ("acc_x", "V", None),
        ("f_17", "N", None),
        ("", "", None),
    ],
)
def test_channels_are_recognised_by_name_and_unit(name, unit, found):
    assert recognise(name, unit) == found


def test_init_does_not_overwrite(inertiactl, tmp_path):
    path = tmp_path / "robot.toml"
    assert inertiactl("init", "--cables", "4", "-o", path).returncode == 0
    before = path.read_text()
    again = inertiactl("init", "--cables", "5", "-o", path)
    assert (again.returncode, path.read_text()) == (2, before)
    assert "is there already" in again.stderr
    assert inertiactl("init", "--cables", "5", "--force", "-o", path).returncode == 0
    assert inertiactl("compile", path, "-o", tmp_path / "robot.cfg").returncode == 0


def test_schema_and_reference_go_to_stdout(inertiactl):
    import json

    assert json.loads(inertiactl("schema").stdout) == reference.schema()
    assert inertiactl("help", "robot.toml").stdout.strip() == reference.text().strip()
