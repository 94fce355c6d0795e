# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics against other engines and against laws: energy, catenary, strings, what a controller must do."""

import json
from dataclasses import replace

import daqp
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from conftest import COGIRO, minimal_toml
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.error import InputError
from inertiad.model import forward_dynamics, payload, trajectory
from inertiad.model.forward_dynamics import Plant
from inertiad.model.inverse_dynamics import Mechanics, Swing, cable_mass_wrench, required_wrench, wrench_matrix
from inertiad.robot import configuration, description
from inertiad.robot.keys import Nominal, inertia_matrix
from inertiad.run import reader
from inertiad.simulate import simulator
from inertiad.simulate.sensor_models import PRESETS

BODY = Nominal(mass=120.0, cog=[0.05, -0.03, -0.2], inertia_cog=[40.0, 50.0, 30.0, 2.0, -1.0, 3.0])
ROBOT = COGIRO / "robot.toml"


def mechanics(robot, body=BODY, payloads=()):
    config = inertiad_core.Config(configuration.compile_robot(robot, "robot"))
    return Mechanics(config, robot, body, payloads=payloads)


def moved(robot, path, plant, rate=1000.0, **options):
    true = mechanics(robot, **options)
    return forward_dynamics.move(true, forward_dynamics.believed_by_controller(robot, "robot", true), path, plant, rate)


def plain(robot):
    """The robot with weightless cables from points."""
    cables = [c.model_copy(update={"weight_per_length": 0.0, "pulley_radius": 0.0}) for c in robot.cable]
    return robot.model_copy(update={"cable": cables})


def swinging(robot, lengths, pose, seconds, stiffness, damping_time=0.0, step=5e-4):
    """The platform let go in a pose [6] on cables of fixed unstrained lengths [m]."""
    config = mechanics(robot).config
    K = round(seconds / step) + 1
    none = np.zeros((K, 3))
    p, R = np.tile(pose[:3], (K, 1)), np.tile(Rotation.from_rotvec(pose[3:]).as_matrix(), (K, 1, 1))
    theta = configuration.theta_of(BODY)
    m = robot.n_cables
    return inertiad_core.forward(
        config, config, theta, theta, np.zeros((0, 12)), p, none, none, R, none, none, np.tile(lengths, (K, 1)),
        np.zeros((2, m)), step=step, steps_per_control=1, EA=stiffness, damping_time=damping_time, winch_rate=100.0,
        control_rate=5.0, swing_damping=0.01, swings=False, holds_length=True,
    )  # fmt: skip


POSE = np.array([0.1, -0.2, 2.0, 0.05, -0.04, 0.1])


def lengths_at(robot, pose, shorter=0.004):
    R = Rotation.from_rotvec(pose[None, 3:]).as_matrix()
    return (1.0 - shorter) * inertiad_core.cable_geometry(mechanics(robot).config, pose[None, :3], R)[2][0]


# ---- against other software ------------------------------------------------------------------------------------------


def pinocchio_model():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "P")
    inertia = pin.Inertia(BODY.mass, np.array(BODY.cog), inertia_matrix(BODY.inertia_cog))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model


@pytest.mark.parametrize("plant", [Plant(swings=False), Plant(stiffness=5e5, swings=False)], ids=["rigid", "elastic"])
def test_accelerations_are_those_of_pinocchio_under_the_same_cable_forces(cogiro, plant):
    found = moved(cogiro, trajectory.paper(), plant)
    model = pinocchio_model()
    data = model.createData()
    k = np.arange(0, len(found.f), 997)
    m = found.motion
    true, at = mechanics(cogiro), trajectory.Motion(m.p[k], m.v[k], m.a[k], m.R[k], m.omega[k], m.alpha[k])
    W, sag = inertiad_core.wrench_matrix(true.config, at.p, at.R, np.zeros(3))
    wrench = np.einsum("nij,nj->ni", W, found.f[k]) + sag + cable_mass_wrench(true, at)
    for n, i in enumerate(k):
        q = np.concatenate([m.p[i], Rotation.from_matrix(m.R[i]).as_quat()])
        v = np.concatenate([m.R[i].T @ m.v[i], m.omega[i]])
        a = pin.aba(model, data, q, v, wrench[n])
        spatial_to_classical = a[:3] + np.cross(m.omega[i], m.R[i].T @ m.v[i])
        assert np.allclose(m.R[i] @ spatial_to_classical, m.a[i], atol=1e-9)
        assert np.allclose(a[3:], m.alpha[i], atol=1e-9)


def mujoco_model(robot, lengths, stiffness, step):
    xx, yy, zz, yz, xz, xy = BODY.inertia_cog
    sites = "".join(f'<site name="b{i}" pos="{" ".join(map(str, c.attachment))}"/>' for i, c in enumerate(robot.cable))
    anchors = "".join(f'<site name="a{i}" pos="{" ".join(map(str, c.anchor))}"/>' for i, c in enumerate(robot.cable))
    tendons = "".join(
        f'<spatial stiffness="{float(stiffness / lengths[i])}" springlength="0 {float(lengths[i])}">'
        f'<site site="a{i}"/><site site="b{i}"/></spatial>'
        for i in range(robot.n_cables)
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step}" integrator="RK4" gravity="0 0 {-robot.gravity}"/><worldbody>{anchors}'
        f'<body><freejoint/><inertial pos="{" ".join(map(str, BODY.cog))}" mass="{BODY.mass}" '
        f'fullinertia="{xx} {yy} {zz} {xy} {xz} {yz}"/>{sites}</body></worldbody><tendon>{tendons}</tendon></mujoco>'
    )


@pytest.mark.parametrize("n_cables", [8, 4])
def test_free_swing_on_elastic_cables_is_that_of_mujoco(cogiro, n_cables):
    robot = plain(cogiro.model_copy(update={"cable": cogiro.cable[-n_cables:]}))
    lengths, step, seconds = lengths_at(robot, POSE), 2.5e-4, 2.0
    model = mujoco_model(robot, lengths, 3e5, step)
    data = mujoco.MjData(model)
    data.qpos[:3] = POSE[:3]
    data.qpos[3:] = Rotation.from_rotvec(POSE[3:]).as_quat(scalar_first=True)
    for _ in range(round(seconds / step)):
        mujoco.mj_step(model, data)
    found = swinging(robot, lengths, POSE, seconds, 3e5, step=step)
    assert found["stopped"] == ""
    assert np.linalg.norm(found["p"][-1] - POSE[:3]) > 5e-3
    assert np.abs(found["p"][-1] - data.qpos[:3]).max() < 1e-6
    theirs = Rotation.from_quat(data.qpos[3:7], scalar_first=True)
    assert (Rotation.from_matrix(found["R"][-1]).inv() * theirs).magnitude() < 1e-5


def test_distribution_is_the_optimum_of_a_quadratic_programme():
    dice = np.random.default_rng(5)
    n_tight = n_none = 0
    for m in (6, 7, 8, 12):
        W = dice.standard_normal((60, 6, m))
        inside = dice.uniform(80.0, 1200.0, (60, m))
        low, high, pull = np.full(m, 100.0), np.full(m, 1000.0), np.full(m, 300.0)
        wrench = np.einsum("nij,nj->ni", W, inside)
        f, none = inertiad_core.distribute(W, wrench, pull, low, high)
        for k in range(len(W)):
            A = np.ascontiguousarray(np.vstack([np.eye(m), W[k]]))
            upper, lower = np.concatenate([high, wrench[k]]), np.concatenate([low, wrench[k]])
            sense = np.r_[np.zeros(m, dtype=np.int32), np.full(6, 5, dtype=np.int32)]
            best, _, flag, _ = daqp.solve(np.eye(m), -pull, A, upper, lower, sense)
            assert (flag > 0) == (k not in none), (m, k, flag)
            if k not in none:
                assert np.allclose(f[k], best, atol=1e-5)
                n_tight += bool(np.isclose(f[k], 100.0).any() or np.isclose(f[k], 1000.0).any())
            n_none += k in none
    assert n_tight > 30
    assert n_none > 5


# ---- laws ------------------------------------------------------------------------------------------------------------


def energy(robot, found, lengths, stiffness):
    p, R, w = found["p"], found["R"], found["omega"]
    rho, J = np.array(BODY.cog), inertia_matrix(BODY.inertia_cog)
    v_C = found["v"] + np.einsum("nij,nj->ni", R, np.cross(w, rho))
    height = p[:, 2] + R[:, 2] @ rho
    length = inertiad_core.cable_geometry(mechanics(robot).config, p, R)[2]
    stretch = np.maximum(length / lengths - 1.0, 0.0)
    kinetic = 0.5 * BODY.mass * (v_C**2).sum(axis=1) + 0.5 * np.einsum("ni,ij,nj->n", w, J, w)
    return kinetic + BODY.mass * robot.gravity * height + 0.5 * stiffness * (lengths * stretch**2).sum(axis=1), kinetic


def test_energy_stays_without_damping_and_falls_with_it(cogiro):
    robot = plain(cogiro)
    lengths = lengths_at(robot, POSE)
    total, kinetic = energy(robot, swinging(robot, lengths, POSE, 3.0, 3e5), lengths, 3e5)
    assert kinetic.max() > 1.0
    assert np.ptp(total) < 1e-5 * kinetic.max()
    damped, _ = energy(robot, swinging(robot, lengths, POSE, 3.0, 3e5, damping_time=5e-3), lengths, 3e5)
    assert np.all(np.diff(damped) < 1e-9 * abs(damped[0]))
    assert damped[0] - damped[-1] > 1.0


def catenary_end(l_0, span, rise, w, EA):
    """Pull (horizontal, vertical) of an elastic catenary of unstrained length l_0 on its lower end."""

    def gap(x):
        H, V = x  # at the lower end
        top = V + w * l_0
        horizontal = H * l_0 / EA + H / w * (np.arcsinh(top / H) - np.arcsinh(V / H))
        vertical = (top**2 - V**2) / (2.0 * EA * w) + (np.hypot(H, top) - np.hypot(H, V)) / w
        return [horizontal - span, vertical - rise]

    chord = np.hypot(span, rise)
    return fsolve(gap, [200.0 * span / chord, 200.0 * rise / chord], xtol=1e-12)


@pytest.mark.parametrize("f", [120.0, 300.0, 2000.0])
def test_sagging_cable_pulls_like_the_exact_catenary(cogiro, f):
    cable = cogiro.cable[0].model_copy(update={"pulley_radius": 0.0})
    robot = cogiro.model_copy(update={"cable": [cable] * 8})
    pose = np.array([[0.3, 0.2, 2.0]])
    motion = trajectory.Motion(pose, pose * 0, pose * 0, np.eye(3)[None], pose * 0, pose * 0)
    config, EA = mechanics(robot).config, 1e6
    l_0 = forward_dynamics.unstrained(config, robot, motion, np.full((1, 8), f), EA)[0, 0]
    d = np.array(cable.anchor) - pose[0] - np.array(cable.attachment)
    span, rise, w = np.hypot(d[0], d[1]), d[2], cable.weight_per_length
    H, V = catenary_end(l_0, span, rise, w, EA)
    chord = np.hypot(span, rise)
    along = (H * span + V * rise) / chord
    assert f == pytest.approx(along, rel=0.01)
    if f < 1000.0:
        straight = EA * (chord / l_0 - 1.0)
        assert abs(straight - along) > 3.0 * abs(f - along)


def test_struck_cable_swings_at_the_frequency_of_a_string(cogiro):
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), 8.0)
    phase = np.zeros((8, 2))
    phase[0, 0] = 0.5 * np.pi
    true = replace(mechanics(cogiro), swing=Swing(0.01, np.ones((8, 2)), phase))
    quiet = Plant(control_hz=0.05, swing_damping=0.0)
    believed = forward_dynamics.believed_by_controller(cogiro, "robot", true)
    found = forward_dynamics.move(true, believed, still, quiet, 500.0)
    line = inertiad_core.cable_geometry(true.config, found.motion.p[:1], found.motion.R[:1])[1][0, 0]
    expected = np.sqrt(found.f[0, 0] * 9.81 / cogiro.cable[0].weight_per_length) / (2.0 * line)
    side = found.motion.a[:, 0] - found.motion.a[:, 0].mean()
    spectrum = np.abs(np.fft.rfft(side * np.hanning(len(side)), 16 * len(side)))
    hz = np.fft.rfftfreq(16 * len(side), 1.0 / 500.0 if found.step == 0.002 else found.step)
    assert hz[np.argmax(spectrum * (hz > 1.0))] == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("plant", [Plant(), Plant(stiffness=1e6)], ids=["rigid", "elastic"])
def test_sampled_accelerations_are_those_of_the_motion(cogiro, plant):
    found = moved(cogiro, trajectory.paper(), plant)
    m, h = found.motion, found.step
    gained = (m.v[1:] - m.v[:-1]) / h - 0.5 * (m.a[1:] + m.a[:-1])
    assert np.sqrt((gained**2).mean()) < 2e-5 * np.sqrt((m.a**2).mean())


def test_motion_between_steps_belongs_to_its_derivatives(cogiro):
    found = moved(cogiro, trajectory.paper(), Plant())
    t, h = np.array([1.2503, 2.34567, 5.00021]), 1e-5
    before, here, after = (found.at(t + s * h) for s in (-1, 0, 1))
    assert np.allclose((after.p - before.p) / (2 * h), here.v, atol=1e-5)
    turn = Rotation.from_matrix(before.R).inv() * Rotation.from_matrix(after.R)
    assert np.allclose(turn.as_rotvec() / (2 * h), here.omega, atol=1e-5)
    on_grid = found.step * np.array([0.0, 700.0, 12345.0])
    assert np.allclose(found.at(on_grid).a, found.motion.a[[0, 700, 12345]], atol=1e-12)
    assert np.allclose(found.tensions(on_grid), found.f[[0, 700, 12345]], atol=1e-9)


# ---- what a controller must do ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("plant", [Plant(), Plant(stiffness=1e6)], ids=["rigid", "elastic"])
def test_paper_motion_is_followed_within_the_limits(cogiro, plant):
    found = moved(cogiro, trajectory.paper(), plant, body=cogiro.nominal)
    assert found.strays < 1e-3
    assert found.n_infeasible == 0
    assert found.f.min() >= 100.0
    assert found.f.max() <= 5000.0
    assert forward_dynamics.summary(found, cogiro)[0].startswith("P at most")


def test_wrong_mass_in_the_controller_is_balanced_by_its_integral(cogiro):
    still = trajectory.hold(POSE, 10.0)
    found = moved(cogiro, still, Plant())  # BODY is 41 kg lighter than [nominal]
    assert found.strays < 1e-6


def test_payload_sinks_the_platform_which_comes_back(cogiro):
    still = trajectory.hold(POSE, 20.0)
    added = payload.parse("20@4", BODY)
    found = moved(cogiro, still, Plant(), payloads=(added,))
    z = found.motion.p[:, 2] - POSE[2]
    t = found.step * np.arange(len(z))
    assert np.abs(z[t < 4.0]).max() < 1e-9
    assert -0.05 < z.min() < -0.001
    assert abs(z[-1]) < 0.1 * abs(z.min())
    W, sag = wrench_matrix(mechanics(cogiro), np.zeros(1), found.at(np.array([20.0])))
    carried = (W[0] @ found.f[-1] + sag[0])[:3]
    assert np.linalg.norm(carried) == pytest.approx((BODY.mass + 20.0) * 9.81, rel=1e-3)


def test_exact_motion_feels_the_payload_too(cogiro):
    still = trajectory.hold(POSE, 8.0)
    m = mechanics(cogiro, payloads=(payload.parse("20@4@0.1,0,-0.3", BODY),))
    t = np.array([0.0, 4.25, 7.0])
    W, sag = wrench_matrix(m, t, still.at(t))
    lifted = np.linalg.norm((np.einsum("nij,nj->ni", W, simulator.tensions(m, t, still.at(t))) + sag)[:, :3], axis=1)
    assert lifted == pytest.approx(9.81 * np.array([120.0, 130.0, 140.0]), rel=1e-9)


def test_four_cables_swing_about_where_they_hang(robot_file):
    robot = description.load(robot_file(minimal_toml(4)))
    m = mechanics(robot)
    still = trajectory.hold(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 3.0)
    found = moved(robot, still, Plant(stiffness=2e5))
    W, sag = inertiad_core.wrench_matrix(m.config, found.motion.p, found.motion.R, np.zeros(3))
    wrench = np.einsum("nij,nj->ni", W, found.f) + sag
    assert np.allclose(wrench, required_wrench(found.at(np.zeros(1)), BODY, 9.81), atol=1e-3)
    assert np.abs(found.motion.omega).max() < 1e-6
    assert np.abs(found.motion.R[0, 2, :2]).max() > 0.01  # the CoG is off the middle: it hangs tilted
    with pytest.raises(InputError, match="4 cables leave the platform free to swing"):
        moved(robot, still, Plant())


def test_limits_out_of_reach_are_reported_with_time_and_cable(cogiro):
    cables = [c.model_copy(update={"tension_max": 1100.0}) for c in cogiro.cable]
    robot = cogiro.model_copy(update={"cable": cables})
    found = moved(robot, trajectory.paper(), Plant(), body=cogiro.nominal)
    assert found.n_infeasible > 0
    lines = forward_dynamics.summary(found, robot)
    assert "commands had no tensions within the limits" in lines[-1]


def test_start_that_no_tensions_hold_is_refused(cogiro):
    high = trajectory.hold(np.array([0.0, 0.0, 5.3, 0.0, 0.0, 0.0]), 1.0)
    with pytest.raises(InputError, match="no tensions within the limits hold the platform at the start"):
        moved(cogiro, high, Plant())


# ---- whole runs ------------------------------------------------------------------------------------------------------


def run_of(robot, level, plant, **options):
    given = {"rate": 1000.0, "seed": 1, "body": BODY, "trajectory": trajectory.paper()} | options
    return simulator.Run(
        ROBOT, robot, given["body"], given["trajectory"], "paper", level, "test", given["rate"], given["seed"], plant,
        given.get("payloads", ()),
    )  # fmt: skip


def test_ideal_sensors_on_an_elastic_robot_give_back_the_body(tmp_path):
    file = COGIRO / "robot_fd.toml"
    robot = description.load(file)
    run = replace(run_of(robot, PRESETS["ideal"], Plant(stiffness=1e6, swings=False)), robot_file=file)
    simulator.simulate(run, tmp_path, lambda step: None)
    blind = description.load(tmp_path / "robot.toml").model_copy(update={"nominal": None})
    config = reader.config_of(blind, "run")
    found = inertiad_core.read_run(config, [str(tmp_path / "can.log")], [""], str(tmp_path / "tracker.csv")).estimate
    assert found["n_changes"] == 0
    assert found["mass"] == pytest.approx(BODY.mass, rel=2e-5)
    assert np.allclose(found["cog"], BODY.cog, atol=1e-4)
    assert np.allclose(found["inertia_cog"], BODY.inertia_cog, atol=0.1)


def test_truth_tells_plant_and_payload(cogiro, tmp_path):
    payloads = payload.parse_all(["20@0.2@0,0,-0.5", "-5@0.9"], BODY, 2.0)
    still = trajectory.hold(POSE, 1.0)
    run = run_of(cogiro, PRESETS["modern"], Plant(stiffness=1e6), trajectory=still, payloads=payloads)
    first = simulator.simulate(run, tmp_path / "a", lambda step: None)
    again = simulator.simulate(run, tmp_path / "b", lambda step: None)
    assert first == again
    assert (tmp_path / "a/can.log").read_bytes() == (tmp_path / "b/can.log").read_bytes()
    truth = json.loads((tmp_path / "a/truth.json").read_text())
    assert truth["mass"] == pytest.approx(135.0)
    assert truth["body_at_start"]["mass"] == 120.0
    assert [p["t"] for p in truth["payload"]] == [0.2, 0.9]
    assert truth["plant"]["stiffness"] == 1e6
    assert truth["tension"]["min"] >= 100.0


@pytest.mark.parametrize(
    ("item", "message"),
    [
        ("20", "allowed: KG@S, KG@S@x,y,z or FILE@S"),
        ("heavy@4", "allowed: a mass in kg, or a .toml or .json file"),
        ("20@soon", "time = soon: allowed: 0 and more, s"),
        ("0@4", "mass = 0: allowed: above 0 to take up"),
        ("20@4@1,2", "position = 1,2: allowed: x,y,z in P, m"),
        ("box.toml@4@0,0,1", "position = 0,0,1: allowed: FILE@S, the cog in FILE is the position"),
        ("20@9.8", "allowed: 0.5 s before the end at 10 s"),
        ("-500@4", "no body is left at 4 s, mass = -380 kg"),
    ],
)
def test_payload_errors(item, message):
    with pytest.raises(InputError) as caught:
        payload.parse_all([item], BODY, 10.0)
    assert message in str(caught.value)


def test_plant_errors(cogiro, tmp_path):
    with pytest.raises(InputError, match=r'--plant "elastik": allowed: exact, .*; did you mean elastic\?'):
        forward_dynamics.plant("elastik", cogiro)
    file = tmp_path / "plant.toml"
    file.write_text("stifness = 1e6")
    with pytest.raises(InputError, match=r"stifness: unknown key; did you mean stiffness\?"):
        forward_dynamics.plant(str(file), cogiro)
    assert forward_dynamics.plant("exact", cogiro) is None
