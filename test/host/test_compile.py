# SPDX-License-Identifier: Apache-2.0
"""robot.toml + DBC -> robot.cfg: the numbers agree with the C headers, and the core accepts what is written."""

import re
import zlib

import numpy as np
import pytest
from conftest import COGIRO, TOP, minimal_toml

import inertiad_core
from inertiad import compile as compiler
from inertiad import robot as description
from inertiad.error import InputError
from inertiad.quantity import QUANTITIES
from inertiad.robot import inertia_matrix
from inertiad_lcm import robot_config_t

TEXT = (COGIRO / "robot.toml").read_text()


def compiled(path):
    data = compiler.compile_robot(description.load(path), "robot.toml")
    return robot_config_t.decode(data[:-4]), data


def test_quantities_are_those_of_the_c_header():
    header = (TOP / "firmware/core/types.h").read_text()
    enum = {name: int(number) for name, number in re.findall(r"IPE_Q_(\w+) = (\d+)", header)}
    assert enum.pop("COUNT") == len(QUANTITIES)
    assert len(enum) >= 12
    python_name = {"QUAT_W": "q_w"}
    for name, number in enum.items():
        assert QUANTITIES[python_name.get(name, name.lower())] == number


def test_quantities_are_those_of_the_binding():
    assert inertiad_core.QUANTITIES == QUANTITIES


@pytest.mark.parametrize("name", ["robot.toml", "robot_fd.toml"])
def test_cogiro_compiles_and_the_core_accepts_it(name):
    config, data = compiled(COGIRO / name)
    assert zlib.crc32(data[:-4]).to_bytes(4, "big") == data[-4:]
    assert inertiad_core.Config(data).n_cables == 8
    assert config.cable[1].anchor == (-7.4786, -5.1544, 5.4009)
    assert config.cable[7].pulley_radius == 0.05
    assert config.cable[8].tension_max == 0.0


@pytest.mark.parametrize("at", [0, 9, 100, 3000, -5, -1])
def test_a_flipped_bit_is_refused_by_the_core(at):
    _, data = compiled(COGIRO / "robot.toml")
    damaged = bytearray(data)
    damaged[at] ^= 0x10
    with pytest.raises(ValueError, match=r".+"):
        inertiad_core.Config(bytes(damaged))


@pytest.mark.parametrize("n_cables", [1, 3, 8, 9, 16])
def test_a_robot_without_dbc_gets_one(robot_file, n_cables):
    config, _ = compiled(robot_file(minimal_toml(n_cables)))
    bound = {s.quantity for s in config.signal[: config.n_signals]}
    assert {QUANTITIES[f"f_{i + 1}"] for i in range(n_cables)} <= bound
    assert QUANTITIES["q_w"] in bound


def test_prior_is_the_nominal_body_about_p(cogiro):
    body = cogiro.nominal
    theta = compiler.theta_of(body)
    shifted = inertiad_core.shift(theta, -np.array(body.cog))
    assert np.allclose(shifted[1:4], 0.0, atol=1e-12)
    about_cog = inertia_matrix(shifted[4:])
    assert np.allclose(about_cog, inertia_matrix(body.inertia_cog), atol=1e-12)
    assert inertiad_core.is_consistent(theta)


def test_prior_without_nominal_is_wide(robot_file):
    config, _ = compiled(robot_file(minimal_toml(8)))
    assert inertiad_core.is_consistent(np.array(config.prior_theta))
    assert config.prior_covariance[0][0] == pytest.approx((2.0 * config.prior_theta[0]) ** 2)
    assert config.prior_covariance[1][1] > 0.0


def test_prior_is_wider_without_nominal(cogiro):
    informed, blind = (compiler.prior(r)[1] for r in (cogiro, cogiro.model_copy(update={"nominal": None})))
    assert np.all(np.diag(blind) > 4.0 * np.diag(informed))


def test_prior_std_given_in_robot_toml_is_used(robot_file):
    path = robot_file(minimal_toml(8) + "[estimator]\nprior_mass_std = 7.0\nprior_product_std = 3.0\n")
    covariance = np.array(compiled(path)[0].prior_covariance)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(7.0)
    assert np.sqrt(covariance[9, 9]) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('f_3 = "FORCE_A.f_3"', "", 'signals.f_3: missing: allowed: f_3 = "MESSAGE.signal"'),
        ("FORCE_A.f_3", "FORCE_A.f3", 'signals.f_3 = "FORCE_A.f3": no such signal in platform.dbc'),
        ("FORCE_A.f_3", "FORC_A.f_3", 'signals.f_3 = "FORC_A.f_3": no such message'),
        ("FORCE_A.f_3", "bus1:FORCE_A.f_3", "bus: allowed: bus0 to bus0"),
        ("platform.dbc", "nowhere.dbc", "nowhere.dbc: No such file or directory"),
        ('f_1 = "FORCE_A.f_1"', 'f_1 = "IMU_RATE.gyro_x"', 'unit "rad/s": allowed: N, mN, daN, kN, kgf, kg, lbf'),
    ],
)
def test_bad_binding_is_one_line(robot_file, old, new, message):
    assert old in TEXT
    with pytest.raises(InputError) as caught:
        compiled(robot_file(TEXT.replace(old, new)))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_garbage_dbc_is_one_line(robot_file, tmp_path):
    path = robot_file(TEXT)
    (tmp_path / "platform.dbc").write_bytes(b"BO_ nothing of the kind\n\x00\xff")
    with pytest.raises(InputError, match=r"platform.dbc: not a usable DBC: [^\n]+$"):
        compiled(path)
