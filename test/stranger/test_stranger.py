# SPDX-License-Identifier: Apache-2.0
"""The independent simulation against laws that it does not use, and a perfect laboratory through the real programs."""

import ast
from dataclasses import replace
from pathlib import Path

import laboratory
import motions
import native
import numpy as np
import pytest
from elastic import LENGTH_DT, plant_of, run_plant, track_from
from judge import Programs, judge, without_unknown_keys
from mechanics import UP, catenary, needed_wrench, run_of, track_of
from robots import DESK, FOUR, FRAME, HALL, HEXA, ROBOTS, G, built_body
from scenes import SCENES
from scipy.spatial.transform import Rotation

HERE = Path(__file__).parent
TOP = HERE.parents[1]


def a_body(robot=FOUR, seed=3):
    return built_body(robot, np.random.default_rng(seed))


def plant_for(robot, w, seconds, **settings):
    """The plant hanging at home on cables of a weight w, winches locked, and its lengths."""
    body, start = a_body(robot), np.array(robot.home)
    cables = run_of(robot, start[None], np.eye(3)[None], robot.anchor, robot.attachment)
    length = np.tile(cables.length * (1.0 - 60.0 / robot.stiffness), (int(seconds / LENGTH_DT) + 10, 1))
    plant = plant_of(robot, [body], (robot.anchor, robot.attachment), start, w)
    plant.n_fine, plant.length_steps = int(seconds / plant.fine_dt), len(length)
    for key, value in settings.items():
        setattr(plant, key, value)
    return plant, length, np.zeros((plant.n_fine, 3)), body


def test_catenary_force_drawn_out_reaches_the_pulley():
    leave, end, w = np.array([[5.0, 1.0, 6.0]]), np.array([[0.0, 0.0, 2.0]]), 4.0
    force, length = catenary(leave, end, np.array([80.0]), w)
    assert np.linalg.norm(force) == pytest.approx(80.0, rel=1e-9)
    s = np.linspace(0.0, length[0], 20001)
    along = force + w * s[:, None] * UP  # tension grows by the weight that hangs below
    u = along / np.linalg.norm(along, axis=1, keepdims=True)
    reached = end[0] + np.trapezoid(u, s, axis=0)
    assert np.allclose(reached, leave[0], atol=1e-6)


@pytest.mark.parametrize("robot", list(ROBOTS.values()), ids=lambda r: r.name)
def test_cable_length_changes_by_what_its_force_works(robot):
    dice, h = np.random.default_rng(1), 1e-6
    p = np.array(robot.home) + 0.3 * dice.uniform(-1, 1, 3) * robot.reach[:3]
    R = motions.rotation(np.array([[0.1, -0.05, 0.1]]))
    here = run_of(robot, p[None], R, robot.anchor, robot.attachment)
    u = (here.leave - here.attachment)[0]
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    for axis in np.eye(3):
        lengths = [run_of(robot, (p + s * h * axis)[None], R, robot.anchor, robot.attachment).length for s in (-1, 1)]
        assert np.allclose((lengths[1] - lengths[0])[0] / (2 * h), -u @ axis, atol=1e-7)


def test_needed_wrench_does_the_work_that_the_body_gains():
    body, motion = a_body(HALL), motions.make("fourier", HALL, 20.0, np.random.default_rng(2))
    t = np.arange(3.0, 17.0, 1e-3)
    track = track_of(motion, t)
    wrench = needed_wrench(track, body)
    omega = np.einsum("nij,nj->ni", track.R, track.omega)
    power = np.sum(wrench[:, :3] * track.v, axis=1) + np.sum(wrench[:, 3:] * omega, axis=1)
    energy = np.zeros(len(t))
    for m, s in zip(body.mass, body.point, strict=True):
        x, v, _ = track.point(s)
        energy += m * (0.5 * np.sum(v * v, axis=1) + G * x[:, 2])
    gained = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1])) * 1e-3])
    assert np.ptp(energy) > 100.0
    assert np.allclose(energy - energy[0], gained, atol=1e-4 * np.ptp(energy))


def test_body_without_cables_falls_and_keeps_its_angular_momentum():
    plant, length, push, body = plant_for(FOUR, 0.0, 1.0, stiffness=0.0, settle=0.0, dt=1e-4)
    plant.kick = type(plant.kick)(0.3, -0.2, 0.1, 1.0, 2.0, -1.5)
    seen = run_plant(plant, length, push)
    t = plant.fine_dt * np.arange(plant.n_fine)
    track = track_from(t, seen)
    cog = np.array(body.moments()["cog"])
    x, v, a = track.point(cog)
    assert np.allclose(a, -G * UP, atol=1e-9)
    assert np.allclose(v - v[0], -G * t[:, None] * UP, atol=1e-9)
    momentum = np.zeros((len(t), 3))
    for m, s in zip(body.mass, body.point, strict=True):
        y, w, _ = track.point(s)
        momentum += m * np.cross(y - x, w - v)
    assert np.linalg.norm(momentum[0]) > 0.1
    assert np.allclose(momentum, momentum[0], atol=2e-3 * np.linalg.norm(momentum[0]))


@pytest.mark.parametrize(("w", "share"), [(0.0, 0.01), (2.0, 0.06)])
def test_plant_without_damping_keeps_its_energy(w, share):
    """A share of the kinetic energy: heavy cables (a fifth of the body here) are shaken by the start and wound up."""
    plant, length, push, body = plant_for(FOUR, w, 2.0, drag=0.0)
    plant.damping_time = 0.0
    plant.dt = plant.fine_dt / 250
    plant.kick = type(plant.kick)(0.3, -0.2, 0.05, 0.2, 0.3, -0.2)
    seen = run_plant(plant, length, push)
    kinetic = 0.5 * body.mass.sum() * np.sum(seen["v"] ** 2, axis=1)
    assert np.ptp(kinetic) > 0.2
    assert np.ptp(seen["energy"]) < share * kinetic.max()


@pytest.mark.parametrize("w", [0.0, 2.0])
def test_plant_at_rest_hangs_on_catenaries(w):
    plant, length, push, body = plant_for(FOUR, w, 1.0, settle=20.0)
    seen = run_plant(plant, length, push)
    assert np.abs(seen["a"][-1]).max() < 0.02
    R = seen["R"][-1:].reshape(1, 3, 3)
    cables = run_of(FOUR, seen["p"][-1:], R, FOUR.anchor, FOUR.attachment)
    force, _ = catenary(cables.leave, cables.attachment, seen["tension"][-1:, : FOUR.n_cables], w)
    weight = body.mass.sum() * G
    assert np.allclose(force[0].sum(0), weight * UP, atol=4e-3 * weight)
    cog = seen["p"][-1] + R[0] @ np.array(body.moments()["cog"])
    moment = np.cross(cables.attachment[0] - cog, force[0]).sum(0)
    assert np.abs(moment).max() < 4e-3 * weight * FOUR.size[0]


@pytest.mark.parametrize("kind", ["mahony", "madgwick", "kalman"])
def test_attitude_filter_at_rest_finds_the_vertical_and_the_heading(kind):
    n, dt = 24000, 0.005
    true = Rotation.from_euler("ZYX", [0.7, -0.2, 0.3])
    acc = np.tile(true.inv().apply(G * UP), (n, 1))
    gyro = np.zeros((n, 3))
    q0 = (true * Rotation.from_rotvec([0.08, -0.05, 0.1])).as_quat(scalar_first=True)
    gain = {"mahony": 1.0, "madgwick": 0.05, "kalman": 0.02}[kind]
    q = native.attitude_filter(kind, dt, gain, G, acc, gyro, np.full(n, 0.7), q0)
    left = (true.inv() * Rotation.from_quat(q[-1], scalar_first=True)).magnitude()
    assert left < 2e-3


@pytest.mark.parametrize("kind", ["mahony", "kalman"])
def test_attitude_filter_learns_the_gyro_bias(kind):
    n, dt = 60000, 0.005
    acc, gyro = np.tile(G * UP, (n, 1)), np.tile([0.004, -0.003, 0.0], (n, 1))
    gain = {"mahony": 1.0, "kalman": 0.01}[kind]
    q = native.attitude_filter(kind, dt, gain, G, acc, gyro, np.zeros(n), np.array([1.0, 0.0, 0.0, 0.0]))
    tilt = Rotation.from_quat(q[[n // 20, -1]], scalar_first=True).magnitude()
    assert tilt[1] < 0.5 * tilt[0]


def test_friction_needs_travel_to_turn_and_is_bounded():
    travel = np.r_[np.linspace(0.0, 0.1, 1000), np.linspace(0.1, 0.0, 1000)]
    z = native.friction_state(travel, 0.01, 2e-3)
    assert z[900] == pytest.approx(1.0, abs=0.2) and z[-1] == pytest.approx(-1.0, abs=0.2)
    assert z[1005] > 0.0 and np.abs(z).max() <= 1.2
    assert np.all(native.friction_state(np.zeros(100), 0.01, 2e-3) == 0.0)


def test_hysteresis_loop_takes_work_and_is_bounded():
    x = 3.0 * np.sin(np.linspace(0.0, 12.0 * np.pi, 6000))
    z = native.bouc_wen(x, 1.0)
    assert np.abs(z).max() <= 1.0 + 1e-6
    assert np.trapezoid(z[3000:], x[3000:]) > 1.0


def test_same_seed_same_readings_and_spikes_change_nothing_else():
    quiet = next(s for s in SCENES if s.name == "declared")
    spikes = next(s for s in SCENES if s.name == "force-spikes-10")
    (_, a, _), (_, b, _), (_, c, _) = (laboratory.play(s, "frame", 5) for s in (quiet, quiet, spikes))
    assert all(np.array_equal(a.signals[k], b.signals[k]) for k in a.signals)
    forces = [k for k in a.signals if k.startswith("f_")]
    assert sum(np.count_nonzero(a.signals[k] != c.signals[k]) for k in forces) == 10
    assert np.array_equal(a.tracker["x"], c.tracker["x"])


def test_simulator_imports_nothing_of_the_product():
    for path in HERE.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        names |= {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert path.name == "commands.py" or not any(name.startswith("inertiad") for name in names), path


def test_keys_that_the_programs_do_not_know_are_taken_out_and_named(tmp_path):
    (tmp_path / "robot.toml").write_text(laboratory.robot_toml(DESK, {"cables": {"nonsense": 1.0}}))
    gone, stopped = without_unknown_keys(Programs(TOP), tmp_path)
    assert stopped == "" and any("nonsense" in key for key in gone)


def test_perfect_laboratory_is_identified_to_two_thousandths(tmp_path):
    # The frame pulls with 450 N on 25 kg: 0.1 mrad of the estimated attitude is a thousandth of the mass.
    scene = replace(next(s for s in SCENES if s.name == "perfect"), duration=20.0)
    result = judge(Programs(TOP), laboratory.write(scene, FRAME.name, 11, tmp_path))
    for column in ("platform", "fit"):
        found = result[column]
        assert found["failed"] is None and found["n_observable"] == 10
        assert found["mass_percent"] < 0.2 and found["cog_mm"] < 0.1 and found["inertia_percent"] < 0.5, found


@pytest.mark.slow
def test_noise_of_a_long_coarse_record_leaves_no_bias(tmp_path):
    """600 s at 25 Hz: sigma is small, and noise stands in the columns of low-pass, gains and attachments."""
    scene = next(s for s in SCENES if s.name == "gain-600s")
    found = judge(Programs(TOP), laboratory.write(scene, HEXA.name, 24, tmp_path))["fit"]
    assert found["failed"] is None and found["verdict"] == "good" and found["n_observable"] == 10
    assert found["worst_z"] < 3.0, found


@pytest.mark.slow
def test_noise_that_the_attitude_follows_leaves_no_bias(tmp_path, monkeypatch):
    """Noisy IMU, slow motion: half of what noise seems to know of the CoG, the attitude has followed."""
    monkeypatch.setitem(ROBOTS, "noisy", replace(FOUR, name="noisy", rate=100.0, acc_noise=0.03, gyro_noise=2.3e-3))
    scene = replace(next(s for s in SCENES if s.name == "declared"), motion="pick", duration=90.0)
    programs = Programs(TOP)
    found = [judge(programs, laboratory.write(scene, "noisy", s, tmp_path / str(s)))["fit"] for s in range(1, 5)]
    z = np.array([one["z"] for one in found])
    assert np.abs(z.mean(axis=0)).max() < 1.5 and np.abs(z).max() < 3.5, z


@pytest.mark.slow
def test_the_attitudes_wander_is_no_misfit(tmp_path):
    """Residuals that have the wander in them teach weights under which it is not followed."""
    scene = next(s for s in SCENES if s.name == "declared-pick")
    found = judge(Programs(TOP), laboratory.write(scene, "four", 73, tmp_path))["fit"]
    assert found["verdict"] == "good" and found["worst_z"] < 3.5, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "faults"),
    [(DESK, {"lowpass": "bessel", "lowpass_hz": 8.0}), (HEXA, {"imu_off": 0.07})],
    ids=["forces 40 ms late", "IMU 7 cm off"],
)
def test_error_of_many_stated_sigmas_is_found(tmp_path, robot, faults):
    scene = next(s for s in SCENES if s.name == "declared")
    scene = replace(scene, faults=replace(scene.faults, **faults), motion="fourier", duration=20.0)
    found = judge(Programs(TOP), laboratory.write(scene, robot.name, 31, tmp_path))["fit"]
    assert found["worst_z"] < 3.5 and found["cog_mm"] < 3.0, found
    assert found["verdict"] == "care" and "correction_beyond_prior" in found["findings"], found
