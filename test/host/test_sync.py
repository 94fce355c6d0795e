# SPDX-License-Identifier: Apache-2.0
"""sync: known delays come back within their bars, triggers and the clock's state are told, sync.json is taken in."""

import json
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from browser import drawings
from conftest import AFTER_IMU, COGIRO, TOP
from scipy.spatial.transform import Rotation

from inertiad.identify import sync, time_delay
from inertiad.model import trajectory
from inertiad.robot import description
from inertiad.run import host_info
from inertiad_lcm import robot_config_t

GRAVITY, NOISE = 9.81, 1e-3
LEVER = np.array([0.3, -0.2, 0.4])
PRIOR = time_delay.Prior(GRAVITY, LEVER, 0.02, 2e-4, 1e-3)


def imu_of(t: np.ndarray, dice: np.random.Generator) -> time_delay.Imu:
    """An IMU at P during the paper's motion: biases and white noise."""
    m = trajectory.paper().at(t)
    acc = np.einsum("nji,nj->ni", m.R, m.a + np.array([0.0, 0.0, GRAVITY]))
    acc += 0.02 * dice.standard_normal(3) + 0.01 * dice.standard_normal(acc.shape)
    gyro = m.omega + 2e-4 * dice.standard_normal(3) + 1e-3 * dice.standard_normal(acc.shape)
    return time_delay.Imu(t, acc, gyro, Rotation.from_matrix(m.R).as_quat(scalar_first=True))


def positions(t: np.ndarray, late: float, dice: np.random.Generator) -> np.ndarray:
    """What a tracker stamps with t."""
    m = trajectory.paper().at(t - late)
    return m.p + m.R @ LEVER + NOISE * dice.standard_normal((len(t), 3))


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.0173, -0.12, 0.0004])
def test_delay_is_found_within_its_bar(late):
    dice = np.random.default_rng(7)
    imu, t = imu_of(np.arange(0.0, 12.0, 0.01), dice), np.arange(0.0, 12.0, 1.0 / 238.0)
    solution = time_delay.solve(imu, t, positions(t, late, dice), PRIOR, 0.3)
    assert solution is not None
    found = solution.delay
    others = found.value + found.std * np.array([-8.0, -4.0, -1.0, 0.0, 1.0, 4.0, 8.0])
    squares = solution.rms(others) ** 2 * solution.stretches[0].x.size / found.tracker_noise**2
    assert np.argmin(squares) == 3, "the residual is least at the delay found"
    assert squares[[1, 5]] - squares[3] == pytest.approx(16.0, rel=0.5), (
        "four sigmas off: 16 more, in units of the noise"
    )
    moved = [np.sqrt(np.mean(solution.stretches[0].residual(d) ** 2)) for d in (found.value, found.value + 0.005)]
    assert moved[0] == pytest.approx(NOISE, rel=0.05) and moved[1] > 1.2 * moved[0]
    assert found.std < 5e-4
    assert found.value == pytest.approx(late, abs=3.0 * found.std)
    assert found.tracker_noise == pytest.approx(NOISE, rel=0.05)


@pytest.mark.slow
def test_gaps_of_tracker_and_imu_cost_certainty_not_truth():
    dice = np.random.default_rng(8)
    t_imu, t = np.arange(0.0, 16.0, 0.01), np.arange(0.0, 16.0, 1.0 / 238.0)
    late = 0.009
    seen = (t < 3.0) | (t > 6.0)
    beam_lost = time_delay.estimate(imu_of(t_imu, dice), t[seen], positions(t[seen], late, dice), PRIOR, 0.3)
    there = (t_imu < 7.0) | (t_imu > 8.0)
    imu_lost = time_delay.estimate(imu_of(t_imu[there], dice), t, positions(t, late, dice), PRIOR, 0.3)
    for found, n in ((beam_lost, 1), (imu_lost, 2)):
        assert found is not None and found.n_stretches == n
        assert found.value == pytest.approx(late, abs=3.0 * found.std)


@pytest.mark.slow
def test_platform_at_rest_tells_no_delay():
    dice = np.random.default_rng(9)
    t_imu, t = np.arange(0.0, 8.0, 0.01), np.arange(0.0, 8.0, 0.01)
    still = time_delay.Imu(
        t_imu, np.tile([0.0, 0.0, GRAVITY], (800, 1)), np.zeros((800, 3)), np.tile([1.0, 0, 0, 0], (800, 1))
    )
    found = time_delay.estimate(still, t, NOISE * dice.standard_normal((800, 3)), PRIOR, 0.3)
    assert found is not None and found.std > 0.05
    assert time_delay.estimate(still, t[:300], np.zeros((300, 3)), PRIOR, 0.3) is not None
    short = time_delay.Imu(t_imu[:300], still.acc[:300], still.gyro[:300], still.q[:300])
    assert time_delay.estimate(short, t, np.zeros((800, 3)), PRIOR, 0.3) is None


# ---- runs ------------------------------------------------------------------------------------------------------------

TRIGGER = (
    '\nBO_ 1536 TRIGGER: 1 Vector__XXX\n SG_ spare : 0|1@1+ (1,0) [0|1] "" X\n SG_ start : 3|1@1+ (1,0) [0|1] "" X\n'
)


def inertiactl_(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "inertiad", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=TOP)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """The paper's motion at 50 Hz with a trigger signal and SYNC frames, recorded on a host of known clock."""
    folder: Path = tmp_path_factory.mktemp("sync") / "run"
    result = inertiactl_("simulate", COGIRO / "robot.toml", "--rate", "50", "--seed", "5", "-o", folder)
    assert result.returncode == 0, result.stderr
    dbc = folder / "platform.dbc"
    dbc.write_text(dbc.read_text() + TRIGGER)
    marks = [f"({3 + 0.5 * k:017.6f}) can0 600#{8 * (k % 2):02X}\n" for k in range(8)]
    marks += [f"({2 + 0.01 * k:017.6f}) can0 080#\n" for k in range(5)]
    lines = (folder / "can.log").read_text().splitlines(keepends=True) + marks
    (folder / "can.log").write_text("".join(sorted(lines, key=lambda line: line.split()[0])))
    host_info.write(folder)
    return folder


@pytest.mark.slow
def test_sync_finds_delays_edges_clock_and_cost(run, tmp_path):
    picture = tmp_path / "sync.html"
    result = inertiactl_("sync", run, "--json", tmp_path / "sync.json", "--picture", picture)
    assert result.returncode == 0, result.stderr
    print(result.stdout)
    assert result.stderr.splitlines()[-1] == f"{picture}: written"
    drawn = drawings(picture)
    assert set(drawn) == {"delays", "alignment"} and all(figure["data"] for figure in drawn.values())
    found, truth = (json.loads(p.read_text()) for p in (tmp_path / "sync.json", run / "truth.json"))
    truth["force_delay"] += AFTER_IMU
    for name in ("position_delay", "force_delay"):
        assert found[name]["value"] == pytest.approx(truth[name], abs=3.0 * found[name]["std"])
    assert found["position_delay"]["std"] < 3e-4
    edges = {e["name"]: e["t"] for e in found["edges"]}
    assert edges["TRIGGER.start"] == pytest.approx([3.5, 4.5, 5.5, 6.5])
    assert edges["TRIGGER.spare"] == []
    assert edges["can0: SYNC frames 080"] == pytest.approx([2.0, 2.01, 2.02, 2.03, 2.04])
    assert "trigger: TRIGGER.start: 4 rising edges, the first at 3.500000 s, every 1 s" in result.stdout
    configured, tracker, force = found["cost"]
    assert "tracker -4.9" in configured["what"] or "tracker -5.0" in configured["what"]
    assert configured["cog"] > 5.0 * tracker["cog"] > 0.0 and force["cog"] > 0.0


@pytest.mark.slow
def test_sync_json_is_taken_in_by_robot_toml(run, tmp_path):
    robot = tmp_path / "robot.toml"
    said = {"position_delay": 0.012, "force_delay": -0.001, "std": {"position_delay": 2e-4, "force_delay": 3e-4}}
    (tmp_path / "sync.json").write_text(json.dumps({"calibration": said}))
    text = (run / "robot.toml").read_text()
    (tmp_path / "platform.dbc").write_bytes((run / "platform.dbc").read_bytes())
    robot.write_text(text + '\n[align]\ndelay_position = 0.001\n[calibration]\nsync = "sync.json"\nworld_yaw = 0.1\n')
    assert inertiactl_("compile", robot, "-o", tmp_path / "robot.cfg").returncode == 0
    config = robot_config_t.decode((tmp_path / "robot.cfg").read_bytes()[:-4])
    assert config.delay == pytest.approx([0.0, -0.001, 0.013])
    assert (config.std_position_delay, config.std_force_delay, config.world_yaw) == (2e-4, 3e-4, 0.1)
    (tmp_path / "sync.json").write_text("{}")
    result = inertiactl_("compile", robot, "-o", tmp_path / "robot.cfg")
    assert result.returncode == 2
    assert "sync.json: no calibration in it: allowed: a file that inertiactl sync wrote" in result.stderr


@pytest.mark.slow
def test_second_sync_with_the_first_in_place_finds_the_same_total(run, tmp_path):
    robot = description.load(run / "robot.toml")
    position = time_delay.Delay(0.004, 1e-4, NOISE, 1000, 1)
    moved = sync._with_delays(robot, position, (0.002, 1e-3))
    assert sync.calibration(moved, position, (0.002, 1e-3)) == sync.calibration(robot, position, (0.002, 1e-3))
    assert moved.calibration.position_delay == 0.004 and moved.calibration.std.force_delay == 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["can.log", "tracker.csv"])
def test_run_without_a_source_is_one_line(run, tmp_path, name):
    for other in {"robot.toml", "platform.dbc", "can.log", "tracker.csv"} - {name}:
        (tmp_path / other).write_bytes((run / other).read_bytes())
    result = inertiactl_("sync", tmp_path)
    assert result.returncode == 2
    assert f"{name}: not found; pass a run folder" in result.stderr and len(result.stderr.splitlines()) == 1


# ---- clocks ----------------------------------------------------------------------------------------------------------

CHRONY = "A29FC87B,192.0.2.7,3,1764000000.1,0.000012,-0.000003,0.000021,-12.3,0.001,0.05,0.0008,0.0004,64.2,Normal"
PMC = """sending: GET TIME_STATUS_NP
\t001122.fffe.334455-0 seq 0 RESPONSE MANAGEMENT TIME_STATUS_NP
\t\tmaster_offset              -73
\t\tingress_time               1764000000000000000
\t\tgmPresent                  true
\t\tgmIdentity                 001122.fffe.334455
"""


@pytest.fixture
def programs(tmp_path, monkeypatch) -> Path:
    """chronyc and pmc that answer as real ones do."""
    for name, text in (("chronyc", CHRONY), ("pmc", PMC)):
        (tmp_path / name).write_text(f"#!/bin/sh\ncat <<'END'\n{text}\nEND\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    return tmp_path


def test_header_keeps_what_chrony_ptp_and_kernel_say(programs, tmp_path):
    host_info.write(tmp_path)
    clock = json.loads((tmp_path / "header.json").read_text())["clock"]
    assert clock["chrony"]["offset_rms_s"] == pytest.approx(21e-6)
    assert clock["chrony"]["error_max_s"] == pytest.approx(12e-6 + 0.4e-3 + 0.4e-3)
    assert clock["ptp"] == {"offset_s": -73e-9, "master_present": True, "master": "001122.fffe.334455"}
    assert clock["kernel"]["error_max_s"] >= 0.0
    _, text = host_info.clock_in_words(tmp_path)
    assert "chrony from 192.0.2.7, 21 us rms" in text and "PTP, -0.1 us off its master" in text


def test_programs_that_fail_are_left_out(programs, tmp_path):
    (programs / "chronyc").write_text("#!/bin/sh\necho 506 Cannot talk to daemon\nexit 1\n")
    (programs / "pmc").write_text("#!/bin/sh\nexit 0\n")
    assert set(host_info.clock()) == {"kernel"}


@pytest.mark.parametrize(("synchronised", "words"), [(True, "error at most 1.50 ms"), (False, "not synchronised")])
def test_clock_in_words(tmp_path, synchronised, words):
    kernel = {"synchronised": synchronised, "error_max_s": 1.5e-3, "error_estimated_s": 0.0}
    (tmp_path / "header.json").write_text(json.dumps({"host": "lab", "clock": {"kernel": kernel}}))
    good, text = host_info.clock_in_words(tmp_path)
    assert good == synchronised and words in text and text.startswith("lab: ")


def test_posterior_keeps_its_digits_where_normal_equations_lose_them():
    """A tilt seen 1e9 times as well as by its prior, beside what is hardly seen: solved in rational numbers."""
    R = np.array([[3e9, 1e9, 7.0], [0.0, 2.0, 1e-3], [0.0, 0.0, 1e-4]])
    z, std = np.array([1e8, 0.3, -2e-5]), np.array([1.0, 0.5, 2.0])
    theta, P = time_delay._posterior(R, z, std)
    exact = [[Fraction(v) for v in row] for row in R]
    size = range(3)
    normal = [[sum(exact[k][i] * exact[k][j] for k in size) for j in size] for i in size]
    for i in size:
        normal[i][i] += 1 / Fraction(std[i]) ** 2
    right = [sum(exact[k][i] * Fraction(z[k]) for k in size) for i in size]
    unit = [[Fraction(int(i == j)) for j in size] for i in size]
    found = [_solved(normal, column) for column in (right, *unit)]
    np.testing.assert_allclose(theta, [float(v) for v in found[0]], rtol=1e-7)
    np.testing.assert_allclose(np.diag(P), [float(found[1 + i][i]) for i in size], rtol=1e-7)


def _solved(A: list[list[Fraction]], b: list[Fraction]) -> list[Fraction]:
    """Gauss-Jordan without rounding."""
    rows = [[*row, value] for row, value in zip(A, b, strict=True)]
    for i in range(len(rows)):
        rows[i] = [v / rows[i][i] for v in rows[i]]
        for k in range(len(rows)):
            if k != i:
                rows[k] = [v - rows[k][i] * w for v, w in zip(rows[k], rows[i], strict=True)]
    return [row[-1] for row in rows]
