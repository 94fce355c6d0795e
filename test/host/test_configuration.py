# SPDX-License-Identifier: Apache-2.0
"""robot.toml + DBC -> robot.cfg: the numbers agree with the C headers, and the core accepts what is written."""

import re
import zlib
from functools import partial

import cantools
import numpy as np
import pytest
from conftest import COGIRO, TOP, minimal_toml
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.quantity import QUANTITIES
from inertiad.base.table import Table
from inertiad.robot import configuration, dbc, description
from inertiad.robot.keys import TENSION_MAX_DEFAULT, inertia_matrix
from inertiad.robot.messages import validate
from inertiad.run import encode
from inertiad_lcm import robot_config_t

TEXT = (COGIRO / "robot.toml").read_text()
BODY = "[nominal]\nmass = 20\ncog = [0, 0, 0]\ninertia_cog = [1, 1, 1, 0, 0, 0]\n"


def compiled(path):
    data = configuration.compile_robot(description.load(path), "robot.toml")
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
    theta = configuration.theta_of(body)
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


@pytest.mark.parametrize(("size", "mass"), [(0.08, 3.2), (0.8, 161.0), (2.5, 5000.0), (0.05, 100.0)])
def test_weight_that_nothing_tells_is_guessed_from_the_size(cogiro, size, mass):
    scale = size / configuration.platform_size(cogiro)
    cables = [
        c.model_copy(update={"attachment": [scale * x for x in c.attachment], "tension_max": TENSION_MAX_DEFAULT})
        for c in cogiro.cable
    ]
    guess = configuration.typical_mass(cogiro.model_copy(update={"nominal": None, "cable": cables}))
    assert 0.3 * mass < guess < 100.0 * mass


def test_prior_is_wider_without_nominal(cogiro):
    informed, blind = (configuration.prior(r)[1] for r in (cogiro, cogiro.model_copy(update={"nominal": None})))
    assert np.all(np.diag(blind) > 4.0 * np.diag(informed))


def test_prior_std_given_in_robot_toml_is_used(robot_file):
    path = robot_file(minimal_toml(8) + "[estimator]\nprior_mass_std = 7.0\nprior_product_std = 3.0\n")
    covariance = np.array(compiled(path)[0].prior_covariance)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(7.0)
    assert np.sqrt(covariance[9, 9]) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('f_3 = "FORCE_A.f_3"', "", 'signals.f_3: missing; add f_3 = "MESSAGE.signal"'),
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


SCALED = '{ signal = "FORCE_A.f_1", %s }'


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("scal = 2.0", "signals.f_1.scal: unknown key; did you mean scale?"),
        ("scale = 0", "signals.f_1.scale = 0: allowed: 1e-12 to 1e12 in magnitude"),
        ('scale = "a"', 'signals.f_1.scale = "a": allowed: a number'),
    ],
)
def test_scaled_signal_with_a_mistake_is_named(tmp_path, keys, message):
    path = tmp_path / "robot.toml"
    path.write_text(f'base = "{COGIRO}/robot.toml"\n[signals]\nf_1 = {SCALED % keys}\n')
    with pytest.raises(InputError, match=re.escape(message)):
        description.load(path)


@given(
    scale=st.floats(1e-6, 1e6) | st.floats(-1e6, -1e-6),
    offset=st.floats(-1e3, 1e3),
    raw=st.integers(1, 65534),
)
def test_scaled_signal_is_the_dbc_value_times_scale_plus_offset(scale, offset, raw):
    data = description.read_data(COGIRO / "robot.toml")
    data["signals"]["f_1"] = {"signal": "FORCE_A.f_1", "scale": scale, "offset": offset}
    robot = validate(description.Robot, data, "robot.toml")
    config = inertiad_core.Config(configuration.compile_robot(robot, "robot.toml"))
    payload = raw.to_bytes(2, "little") + bytes(6)
    message = cantools.database.load_file(COGIRO / "platform.dbc").get_message_by_name("FORCE_A")
    expected = message.decode(payload)["f_1"] * scale + offset
    found = inertiad_core.decode_frame(config, 0, message.frame_id, payload)[QUANTITIES["f_1"]]
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * (abs(200 * scale) + abs(offset)))


def test_device_time_bound_as_counter_is_encoded_once(tmp_path):
    data = description.read_data(COGIRO / "robot.toml")
    data["signals"]["imu_counter"] = ["IMU_TIME.time"]
    robot = validate(description.Robot, data, "robot.toml")
    t = np.array([1.0, 1.001])
    columns = {name: np.zeros(2) for name in dbc.required(robot)}
    frames = encode.pack(dbc.bind(robot, "robot.toml"), Table(t, columns, "test"), t)
    ticks = [int.from_bytes(row[:4].tobytes(), "big") for f in frames if f.can_id == 0x10 for row in f.data]
    assert ticks == [1_000_000, 1_001_000]


def test_force_offset_follows_the_tensions_unless_it_is_declared(robot_file):
    declared, _ = compiled(robot_file(minimal_toml(4).replace("tension_max = 1000", "tension_max = 50")))
    assert declared.std_force_offset == pytest.approx(0.05) and declared.std_force_gain == 5e-3
    silent = minimal_toml(4).replace("tension_max = 1000", "") + BODY
    nothing, _ = compiled(robot_file(silent))
    assert nothing.std_force_offset == pytest.approx(0.1 * 20.0 * 9.81 / 4) and nothing.std_force_gain == 0.03
    given, _ = compiled(robot_file(silent + "[std]\nforce_offset = 2.0\nforce_gain = 1e-3\n"))
    assert given.std_force_offset == 2.0 and given.std_force_gain == 1e-3
    assert given.std_force_offset_drift == pytest.approx(2.0 / np.sqrt(10800.0))


def test_force_sensors_at_the_winch_are_allowed_more_friction(robot_file):
    platform, _ = compiled(robot_file(minimal_toml(2)))
    winch, _ = compiled(robot_file(minimal_toml(2).replace("[cables]\n", '[cables]\nforce_at = "winch"\n')))
    assert (platform.cable[0].force_at, winch.cable[0].force_at, winch.cable[1].force_at) == (0, 1, 1)
    assert platform.std_friction < winch.std_friction


def test_attitude_is_fused_where_the_position_is_measured(robot_file):
    fixed = '[position]\nsource = "fixed"\nfixed = [0, 0, 1]\n'
    for extra, estimate in (("", 1), (fixed, 0), ('[attitude]\nestimate = "ahrs"\n', 0)):
        config, _ = compiled(robot_file(minimal_toml(2) + extra))
        assert config.attitude_estimate == estimate
    with pytest.raises(InputError, match="needs a measured one"):
        description.load(robot_file(minimal_toml(2) + fixed + '[attitude]\nestimate = "fused"\n'))


@pytest.mark.parametrize("kind", ["bessel", "butterworth"])
@pytest.mark.parametrize("order", [1, 2, 4])
def test_delay_of_a_low_pass_is_its_phase_per_frequency(robot_file, kind, order):
    low_pass = f'filter_force = {{ kind = "{kind}", order = {order}, cutoff = 10.0 }}\ndelay_force = 0.002\n'
    config, _ = compiled(robot_file(minimal_toml(2) + "[align]\n" + low_pass))
    design = {"bessel": partial(signal.bessel, norm="mag"), "butterworth": signal.butter}[kind]
    b, a = design(order, 2.0 * np.pi * 10.0, analog=True)
    w = 2.0 * np.pi * 0.1
    phase = np.angle(signal.freqs(b, a, [w])[1][0])
    assert config.delay[1] == pytest.approx(0.002 - phase / w, rel=1e-3)


def test_delay_of_the_attitude_is_that_of_align_and_calibration(robot_file):
    text = "[align]\ndelay_attitude = 0.02\n[calibration]\nattitude_delay = 0.003\n"
    config, _ = compiled(robot_file(minimal_toml(2) + text))
    assert config.delay_attitude == pytest.approx(0.023)
