# SPDX-License-Identifier: Apache-2.0
"""Simulated physics against laws stated another way, and sensors against their stated levels."""

import json

import numpy as np
import pytest
from conftest import COGIRO

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Table
from inertiad.model import inverse_dynamics, trajectory
from inertiad.model.inverse_dynamics import Mechanics
from inertiad.model.random_errors import Dice, wander
from inertiad.robot import configuration, description
from inertiad.robot.keys import Nominal, inertia_matrix
from inertiad.run import encode, reader
from inertiad.simulate import bus_timing, sensor_models, simulator
from inertiad.simulate.sensor_models import PRESETS, Faults
from inertiad.simulate.simulator import Run

BODY = Nominal(mass=120.0, cog=[0.05, -0.03, -0.2], inertia_cog=[40.0, 50.0, 30.0, 2.0, -1.0, 3.0])


def mechanics(robot, level=PRESETS["ideal"], seed=1):
    drawn = sensor_models.draw(level, robot.n_cables, Dice(seed))
    true_robot = simulator.with_true_geometry(robot, drawn)
    config = inertiad_core.Config(configuration.compile_robot(true_robot, "robot"))
    return Mechanics(config, true_robot, BODY, drawn.swing)


def without_weight(robot):
    cables = [c.model_copy(update={"weight_per_length": 0.0}) for c in robot.cable]
    return robot.model_copy(update={"cable": cables})


def test_tensions_at_rest_carry_exactly_the_weight(cogiro):
    robot = without_weight(cogiro)
    still = trajectory.hold(np.array([0.5, -0.4, 2.0, 0.1, -0.2, 0.3]), 0.1)
    t = np.array([0.0])
    m = mechanics(robot)
    f = simulator.tensions(m, t, still.at(t))
    u, _, _ = inertiad_core.cable_geometry(m.config, still.at(t).p, still.at(t).R)
    total = np.einsum("ni,nij->nj", f, u)[0]
    assert np.allclose(total, [0.0, 0.0, BODY.mass * robot.gravity], atol=1e-8)
    R, p = still.at(t).R[0], still.at(t).p[0]
    arms = np.array([R @ c.attachment for c in robot.cable])
    moment = np.cross(arms, f[0][:, None] * u[0]).sum(axis=0)
    weight = np.cross(R @ np.array(BODY.cog), [0.0, 0.0, -BODY.mass * robot.gravity])
    assert np.allclose(moment + weight, 0.0, atol=1e-8)
    assert np.allclose(p, [0.5, -0.4, 2.0])


def test_cable_weight_lowers_into_the_measured_tensions(cogiro):
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), 0.1)
    t = np.array([0.0])
    heavy, light = mechanics(cogiro), mechanics(without_weight(cogiro))
    u, _, _ = inertiad_core.cable_geometry(heavy.config, still.at(t).p, still.at(t).R)
    lift = [float((simulator.tensions(m, t, still.at(t))[0] * u[0, :, 2]).sum()) for m in (heavy, light)]
    assert 15.0 < lift[0] - lift[1] < 30.0  # N; straight cables over-read by about this much


def test_required_wrench_is_the_momentum_derivative_of_many_particles():
    """A body of point masses: sum of m (a - g) over the particles, accelerations by finite differences."""
    rng = np.random.default_rng(3)
    masses, points = rng.uniform(1.0, 10.0, 12), rng.uniform(-1.0, 1.0, (12, 3))
    m = masses.sum()
    rho = masses @ points / m
    d = points - rho
    J = sum(mi * (di @ di * np.eye(3) - np.outer(di, di)) for mi, di in zip(masses, d, strict=True))
    elements = [J[0, 0], J[1, 1], J[2, 2], J[1, 2], J[0, 2], J[0, 1]]
    assert np.allclose(inertia_matrix(elements), J)
    body = Nominal(mass=m, cog=rho.tolist(), inertia_cog=elements)
    paper, h, g = trajectory.paper(), 1e-4, 9.81
    for time in (1.3, 2.4, 6.1):
        t = time + h * np.array([-1.0, 0.0, 1.0])
        motion = paper.at(t)
        world = motion.p[:, None, :] + np.einsum("nij,kj->nki", motion.R, points)
        acceleration = (world[2] - 2.0 * world[1] + world[0]) / h**2
        forces = masses[:, None] * (acceleration + np.array([0.0, 0.0, g]))
        R, arms = motion.R[1], world[1] - motion.p[1]
        expected = np.concatenate([R.T @ forces.sum(axis=0), R.T @ np.cross(arms, forces).sum(axis=0)])
        assert np.allclose(inverse_dynamics.required_wrench(motion, body, g)[1], expected, rtol=1e-5, atol=1e-3)


def test_wrench_of_the_tensions_is_regressor_times_parameters(cogiro):
    paper = trajectory.paper()
    t = np.linspace(0.0, paper.duration, 400)
    m, motion = mechanics(cogiro), paper.at(t)
    f = simulator.tensions(m, t, motion)
    W, sag = inverse_dynamics.wrench_matrix(m, t, motion)
    s = simulator.specific_force(motion, cogiro.gravity, np.zeros(3))
    Y = inertiad_core.regressor(s, motion.omega, motion.alpha)
    left = np.einsum("nij,nj->ni", W, f) + sag + inverse_dynamics.cable_mass_wrench(m, motion)
    assert np.allclose(left, Y @ configuration.theta_of(BODY), atol=1e-8)


def test_tensions_keep_their_limits_where_the_even_pull_does_not(cogiro):
    cables = [c.model_copy(update={"tension_min": 150.0}) for c in cogiro.cable]
    m = mechanics(cogiro.model_copy(update={"cable": cables}))
    paper = trajectory.paper()
    t = np.linspace(0.0, paper.duration, 300)
    W, sag = inverse_dynamics.wrench_matrix(m, t, paper.at(t))
    moved = inverse_dynamics.cable_mass_wrench(m, paper.at(t))
    wrench = inverse_dynamics.required_wrench(paper.at(t), BODY, 9.81) - sag - moved
    free = inverse_dynamics.even_pull(W, wrench, np.full(8, 294.3))
    f = simulator.tensions(m, t, paper.at(t))
    broken = (free < 150.0).any(axis=1)
    assert broken.any()
    assert f.min() >= 150.0 - 1e-6
    assert np.allclose(np.einsum("nij,nj->ni", W, f), wrench, atol=1e-8)
    assert np.allclose(f[~broken], free[~broken])


def test_tensions_out_of_reach_name_time_cable_and_value(cogiro):
    high = trajectory.hold(np.array([0.0, 0.0, 5.3, 0.0, 0.0, 0.0]), 0.1)
    with pytest.raises(InputError, match=r"t = 0.000 s: .*cable \d = -?[\d.e+]+ N: allowed: 100 to 5000 N"):
        simulator.tensions(mechanics(cogiro), np.zeros(1), high.at(np.zeros(1)))


def test_anchors_below_the_platform_are_named_as_such(cogiro):
    cables = [c.model_copy(update={"anchor": [*c.anchor[:2], 0.5 + 0.1 * i]}) for i, c in enumerate(cogiro.cable)]
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), 0.1)
    with pytest.raises(InputError, match="every anchor is below the platform, cables only pull"):
        simulator.tensions(mechanics(cogiro.model_copy(update={"cable": cables})), np.zeros(1), still.at(np.zeros(1)))


def test_too_few_cables_say_what_is_missing(cogiro):
    robot = cogiro.model_copy(update={"cable": cogiro.cable[:4]})
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.3, 0.0, 0.0]), 0.1)
    with pytest.raises(InputError, match="4 cables cannot hold the platform"):
        simulator.tensions(mechanics(robot), np.zeros(1), still.at(np.zeros(1)))


def test_swing_turns_the_cables_by_its_amplitude(cogiro):
    level = Faults(cable_swing=0.003)
    swinging, straight = mechanics(cogiro, level), mechanics(cogiro)
    t = np.linspace(0.0, 2.0, 400)
    motion = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.1, 0.2, 0.3]), 2.0).at(t)
    change = (
        inverse_dynamics.wrench_matrix(swinging, t, motion)[0] - inverse_dynamics.wrench_matrix(straight, t, motion)[0]
    )
    angle = np.linalg.norm(change[:, :3], axis=1)
    assert angle.max() < 0.003 * np.sqrt(2.0) + 1e-9
    assert np.all(angle.max(axis=0) > 0.0025)
    u = inverse_dynamics.wrench_matrix(straight, t, motion)[0][:, :3]
    assert np.abs(np.einsum("nji,nji->ni", u, change[:, :3])).max() < 1e-12


# ---- sensors ---------------------------------------------------------------------------------------------------------


def measured(robot, level, seed=1, duration=20.0, rate=200.0):
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.1, 0.2, 0.3]), duration)
    t = np.arange(int(duration * rate)) / rate
    m = mechanics(robot, level, seed)
    drawn = sensor_models.draw(level, robot.n_cables, Dice(seed))
    return simulator.measure_signals(robot, m, still, t, level, drawn, rate, Dice(seed)), drawn


@pytest.mark.parametrize(
    ("fault", "columns", "sigma"),
    [
        ({"acc_noise_density": 0.001}, ("acc_x", "acc_y", "acc_z"), 0.001 * np.sqrt(100.0)),
        ({"gyro_noise_density_deg": 0.1}, ("gyro_x", "gyro_z"), np.deg2rad(0.1) * np.sqrt(100.0)),
        ({"force_noise_density": 0.2}, ("f_1", "f_8"), 0.2 * np.sqrt(100.0)),
        ({"force_noise": 3.0}, ("f_1", "f_8"), 3.0),
    ],
)
def test_noise_has_its_level_and_touches_nothing_else(cogiro, fault, columns, sigma):
    clean, _ = measured(cogiro, Faults())
    noisy, _ = measured(cogiro, Faults(**fault))
    for name in clean.columns:
        difference = noisy.columns[name] - clean.columns[name]
        if name in columns:
            assert np.std(difference) == pytest.approx(sigma, rel=0.06)
        elif name[0] != columns[0][0]:
            assert not difference.any()


def test_systematic_faults_are_the_drawn_ones(cogiro):
    clean, _ = measured(cogiro, Faults(), duration=0.1)
    level = Faults(acc_bias=0.1, gyro_bias_deg=0.3, force_offset=15.0, force_gain=0.01)
    off, drawn = measured(cogiro, level, duration=0.1)
    for i, name in enumerate(("acc_x", "acc_y", "acc_z")):
        assert np.allclose(off.columns[name] - clean.columns[name], drawn.acc_bias[i])
    f, f_true = off.stack("f_1", "f_2"), clean.stack("f_1", "f_2")
    assert np.allclose(f, (1.0 + drawn.force_gain[:2]) * f_true + drawn.force_offset[:2])
    assert np.all(drawn.force_offset != 0.0)


def test_attitude_faults_are_undone_by_their_definition(cogiro):
    from scipy.spatial.transform import Rotation

    clean, _ = measured(cogiro, Faults(), duration=0.1)
    off, drawn = measured(cogiro, Faults(attitude_bias_deg=1.0, world_yaw_deg=3.0), duration=0.1)
    q = ("q_w", "q_x", "q_y", "q_z")
    reported = Rotation.from_quat(off.stack(*q), scalar_first=True)
    true = Rotation.from_quat(clean.stack(*q), scalar_first=True)
    back = Rotation.from_euler("z", drawn.world_yaw) * reported * Rotation.from_rotvec(drawn.attitude_bias)
    assert (reported.inv() * true).magnitude().min() > 1e-3
    assert (back.inv() * true).magnitude().max() < 1e-12


def test_imu_pose_and_alignment_turn_what_it_measures(cogiro):
    imu = cogiro.imu.model_copy(update={"orientation": [0.5, 0.5, 0.5, 0.5], "position": [0.1, 0.2, 0.3]})
    plain, _ = measured(cogiro, Faults(), duration=0.1)
    turned, _ = measured(cogiro.model_copy(update={"imu": imu}), Faults(), duration=0.1)
    # this quaternion takes x to y, y to z, z to x
    assert np.allclose(turned.stack("acc_x", "acc_y", "acc_z"), plain.stack("acc_y", "acc_z", "acc_x"))


def test_wander_is_stationary_with_its_level():
    slow = wander(0.5, 2.0, 100.0, 400_000, np.random.default_rng(1))
    assert np.std(slow[:1000]) > 0.0
    assert np.std(slow) == pytest.approx(0.5, rel=0.1)
    lag = np.mean(slow[200:] * slow[:-200]) / np.mean(slow**2)
    assert lag == pytest.approx(np.exp(-1.0), abs=0.08)


def test_delays_show_what_was_measured_earlier(cogiro):
    paper = trajectory.paper()
    late = simulator.measure_tracker(cogiro, paper, Faults(tracker_delay=0.1), Dice(1))
    prompt = simulator.measure_tracker(cogiro, paper, Faults(), Dice(1))
    assert np.allclose(np.interp(prompt.t[500] + 0.1, late.t, late.columns["x"]), prompt.columns["x"][500], atol=1e-5)
    assert abs(late.columns["x"][500] - prompt.columns["x"][500]) > 1e-3


def test_streams_do_not_depend_on_each_other():
    first = Dice(5)["acc_noise"].standard_normal(3)
    dice = Dice(5)
    dice["gyro_noise"].standard_normal(100)
    assert np.array_equal(dice["acc_noise"].standard_normal(3), first)
    assert not np.array_equal(Dice(6)["acc_noise"].standard_normal(3), first)
    assert not np.array_equal(Dice(5)["gyro_noise"].standard_normal(3), first)


# ---- runs ------------------------------------------------------------------------------------------------------------


def run_of(robot, level, seed=1, rate=100.0, duration=1.0):
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), duration)
    return Run(COGIRO / "robot.toml", robot, BODY, still, "hold", level, "test", rate, seed)


def write(run, folder):
    simulator.simulate(run, folder, lambda step: None)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_same_seed_same_files_other_seed_other_files(cogiro, tmp_path):
    level = PRESETS["modern"]
    first, again = (write(run_of(cogiro, level), tmp_path / name) for name in "ab")
    other = write(run_of(cogiro, level, seed=2), tmp_path / "c")
    assert first == again
    assert first["can.log"] != other["can.log"]
    assert first["tracker.csv"] != other["tracker.csv"]


def test_truth_states_what_was_put_in(cogiro, tmp_path):
    truth = json.loads(write(run_of(cogiro, PRESETS["modern"]), tmp_path)["truth.json"])
    assert truth["mass"] == BODY.mass
    assert truth["cog"] == BODY.cog
    assert truth["inertia_cog"] == BODY.inertia_cog
    assert len(truth["force_offset"]) == 8
    assert truth["seed"] == 1
    assert truth["faults"]["force_offset"] == 5.0


def stamps(text):
    lines = [line.split() for line in text.decode().splitlines()]
    return [(float(s.strip("()")), frame.split("#")[0]) for s, _, frame in lines]


def test_ideal_frames_carry_their_samples_time(cogiro, tmp_path):
    read = stamps(write(run_of(cogiro, Faults(), duration=0.1), tmp_path)["can.log"])
    assert [s for s, _ in read[:6]] == [simulator.START] * 6
    assert read[6][0] == pytest.approx(simulator.START + 0.01)


def test_frames_on_the_bus_follow_each_other(cogiro, tmp_path):
    level = Faults(bus_timing=True)
    read = stamps(write(run_of(cogiro, level, rate=1000.0, duration=0.1), tmp_path)["can.log"])
    first = [s - simulator.START for s, _ in read[:6]]
    # six frames at 1 Mbit/s: 47 + 48 bits, then five of 47 + 64
    assert first == pytest.approx(np.cumsum([95e-6] + [111e-6] * 5), abs=1e-6)
    assert [i for _, i in read[:6]] == ["010", "011", "012", "013", "020", "021"]


def test_fd_frame_takes_the_bits_of_both_phases():
    short, long = (encode.Frames(0, 0x100, True, np.zeros((1, n), np.uint8)) for n in (8, 64))
    assert bus_timing.time_of(short, 1e6, 5e6) == pytest.approx(
        29e-6 + (64 + 33) / 5e6
    )  # 17 of CRC, 6 fixed stuff bits
    assert bus_timing.time_of(long, 1e6, 5e6) == pytest.approx(29e-6 + (512 + 38) / 5e6)  # 21 and 7
    assert bus_timing.time_of(long, 1e6, 5e6, stuffed=True) == pytest.approx(33e-6 + (512 + 38 + 130) / 5e6)


@pytest.mark.parametrize("name", ["robot.toml", "robot_fd.toml"])
def test_rows_carry_their_samples_time_not_that_of_the_frames_end(tmp_path, name):
    robot = description.load(COGIRO / name)
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), 2.0)
    level = Faults(bus_timing=True)  # given: a frame is stamped when it has got through
    write(Run(COGIRO / name, robot, BODY, still, "hold", level, "test", 500.0, 1), tmp_path)
    t = reader.read(tmp_path).rows.t - simulator.START  # when
    assert len(t) > 900
    assert np.abs(t - np.rint(500.0 * t) / 500.0).max() < 1.5e-6  # then: but for the stamps' microseconds


def test_overloaded_bus_is_refused(cogiro, tmp_path):
    with pytest.raises(InputError, match=r"bus 0: \d+ % load at this --rate: allowed: up to 100 %"):
        write(run_of(cogiro, Faults(bus_timing=True), rate=2000.0), tmp_path)


def test_cogiro_at_1_khz_fits_one_classical_bus_in_the_worst_case(cogiro, tmp_path):
    write(run_of(cogiro, Faults(bus_timing=True), rate=1000.0, duration=0.1), tmp_path)


def test_lowest_identifier_of_those_that_wait_wins():
    release = [0.0, 1e-4, 2e-4, 2e-4, 5e-3]
    end = inertiad_core.arbitrate(release, [30, 20, 10, 5, 1], [1e-3] * 5)
    assert end == pytest.approx([1e-3, 4e-3, 3e-3, 2e-3, 6e-3])


def test_arbitration_is_that_of_a_bus_stepped_through_time():
    dice = np.random.default_rng(3)
    n, slot = 300, 1e-5
    release, ident = slot * dice.integers(0, 3000, n), dice.permutation(n)
    took = slot * dice.integers(5, 14, n)
    end = np.array(inertiad_core.arbitrate(release, ident, took))
    waiting, left, now, free_at = set(), set(range(n)), 0, 0
    expected = np.zeros(n)
    while left or waiting:
        waiting |= {k for k in left if round(release[k] / slot) <= now}
        left -= waiting
        if now >= free_at and waiting:
            winner = min(waiting, key=lambda k: ident[k])
            waiting.remove(winner)
            free_at = now + round(took[winner] / slot)
            expected[winner] = slot * free_at
        now += 1
    assert np.allclose(end, expected)


def test_eleven_bit_identifiers_win_over_longer_ones_that_start_alike():
    extended = 1 << 31
    order = [0x100, 0x100 << 18 | 5 | extended, 0x101, 0x101 << 18 | extended, 0x7FF]
    assert sorted(order, key=bus_timing.priority) == order


def test_jitter_of_a_node_reorders_nodes_and_never_its_own_frames(cogiro, tmp_path):
    level = Faults(bus_timing=True, release_jitter=2e-3)
    read = stamps(write(run_of(cogiro, level, rate=200.0, duration=1.0), tmp_path)["can.log"])
    ids = [i for _, i in read]
    assert ids != ["010", "011", "012", "013", "020", "021"] * (len(ids) // 6)
    assert [i for i in ids if i < "020"] == ["010", "011", "012", "013"] * (len(ids) // 6)
    assert np.all(np.diff([s for s, _ in read]) >= 0.0)


def test_frames_that_a_stalled_host_reads_together_keep_the_order_of_the_bus(cogiro, tmp_path):
    level = Faults(bus_timing=True, stamp_jitter=2e-3)
    read = stamps(write(run_of(cogiro, level, rate=1000.0, duration=1.0), tmp_path)["can.log"])
    ids = [i for _, i in read]
    assert ids == ["010", "011", "012", "013", "020", "021"] * (len(ids) // 6)
    assert np.all(np.diff([s for s, _ in read]) > 0.0)


def test_lost_frames_are_the_others_of_a_whole_log(cogiro, tmp_path):
    whole = write(run_of(cogiro, Faults(), duration=20.0), tmp_path / "a")["can.log"].decode().splitlines()
    some = write(run_of(cogiro, Faults(frame_loss=0.1), duration=20.0), tmp_path / "b")["can.log"].decode().splitlines()
    assert set(some) < set(whole)
    assert 1.0 - len(some) / len(whole) == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(
    ("silent", "missing"),
    [("force", {"020", "021"}), ("f_3", {"020"}), ("imu", {"010", "011", "012", "013"})],
)
def test_silent_sensor_sends_nothing_for_a_while(cogiro, tmp_path, silent, missing):
    level = Faults(silent=silent, fault_start=1.0, fault_duration=0.5)
    read = stamps(write(run_of(cogiro, level, duration=2.0), tmp_path)["can.log"])
    during = {i for s, i in read if simulator.START + 1.0 <= s < simulator.START + 1.5}
    assert {i for _, i in read} - during == missing
    assert {i for s, i in read if s >= simulator.START + 1.5} >= missing


def test_stuck_sensor_repeats_its_last_value(cogiro):
    level = Faults(stuck="f_3", fault_start=1.0, fault_duration=0.5, force_noise=1.0)
    noisy, _ = measured(cogiro, level, duration=2.0)
    t = noisy.t - simulator.START
    during = (t >= 1.0) & (t < 1.5)
    f = noisy.columns["f_3"]
    assert np.all(f[during] == f[np.argmax(during) - 1])
    assert np.std(f[~during]) > 0.5
    assert np.std(noisy.columns["f_4"][during]) > 0.5


def test_tracker_out_of_sight(cogiro):
    still = trajectory.hold(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), 200.0)
    gone = simulator.measure_tracker(cogiro, still, Faults(silent="tracker"), Dice(1))
    assert np.diff(gone.t).max() == pytest.approx(2.0, abs=0.01)
    drops = simulator.measure_tracker(cogiro, still, Faults(dropout_hz=0.2, dropout=0.5), Dice(1))
    gaps = np.diff(drops.t) - 1.0 / 238.0
    assert 20 < np.sum(gaps > 1e-3) < 60
    assert np.mean(gaps[gaps > 1e-3]) == pytest.approx(0.5, rel=0.5)


def test_clocks_that_jump(cogiro, tmp_path):
    level = Faults(stamp_step=0.25, clock_step=0.1, fault_start=1.0)
    plain = stamps(write(run_of(cogiro, Faults(), duration=2.0), tmp_path / "a")["can.log"])
    jumped = stamps(write(run_of(cogiro, level, duration=2.0), tmp_path / "b")["can.log"])
    difference = np.array([b[0] - a[0] for a, b in zip(plain, jumped, strict=True)])
    assert sorted(set(np.round(difference, 6))) == [0.0, 0.25]
    drawn = sensor_models.draw(level, 8, Dice(1))
    assert np.allclose(simulator.device_time(level, drawn, np.array([0.5, 1.5])), [0.5, 1.6])


def test_fault_of_a_sensor_that_is_not_there(cogiro, tmp_path):
    with pytest.raises(InputError, match='test: stuck = "f_9": allowed: f_1 to f_8'):
        write(run_of(cogiro, Faults(stuck="f_9")), tmp_path)


@pytest.mark.parametrize("name", list(PRESETS))
def test_presets_run(cogiro, tmp_path, name):
    assert set(write(run_of(cogiro, PRESETS[name], rate=25.0), tmp_path)) == {
        "can.log",
        "platform.dbc",
        "robot.toml",
        "tracker.csv",
        "truth.json",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("acc_biass = 0.1", "acc_biass: unknown key; did you mean acc_bias?"),
        ("rate = 0", "rate = 0: allowed: 1 to 100000 Hz"),
        ("bus_timing = 1", "bus_timing = 1: allowed: true or false"),
        ("frame_loss = 2", "frame_loss = 2: allowed: 0 to 1"),
        ("release_jitter = 1e-3", "release_jitter with bus_timing = true"),
        ("cable_swing_low_hz = 9", "cable_swing_low_hz up to cable_swing_high_hz"),
        ('stuck = "imus"', 'stuck = "imus": allowed: imu, force, pos, tracker, bus, or a quantity such as f_3; did'),
    ],
)
def test_fault_file_errors(tmp_path, text, message):
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        sensor_models.faults(str(path))
    assert str(caught.value).startswith(f"{path}: {message}")


def test_unknown_preset_suggests_one():
    with pytest.raises(
        InputError, match=r'--faults "modem": allowed: ideal, .*, or a .toml file; did you mean modern\?'
    ):
        sensor_models.faults("modem")


def test_body_from_json_and_mass_option(cogiro, tmp_path):
    path = tmp_path / "body.json"
    path.write_text(BODY.model_dump_json())
    assert simulator.body_of(cogiro, path, None) == BODY
    assert simulator.body_of(cogiro, path, 99.0).mass == 99.0
    assert simulator.body_of(cogiro, None, None) == cogiro.nominal
    path.write_text('{"mass": 1')
    with pytest.raises(InputError, match="not JSON"):
        simulator.body_of(cogiro, path, None)


def through_the_core(folder):
    """The estimate of the C pipeline, which is not told the nominal body, from a run folder, and its counters."""
    robot = description.load(folder / "robot.toml").model_copy(update={"nominal": None})
    pipeline = inertiad_core.Pipeline(inertiad_core.Config(configuration.compile_robot(robot, "run")))
    events = []
    for line in (folder / "can.log").read_text().splitlines():
        stamp, _, frame = line.split()
        can_id, _, data = frame.partition("#")
        t_ns = int(stamp.strip("()").replace(".", "")) * 1000
        events.append(
            (t_ns, int(can_id, 16), bytes.fromhex(data[2:] if data.startswith("#") else data), data[0] == "#")
        )
    if (folder / "tracker.csv").exists():
        for row in np.loadtxt(folder / "tracker.csv", delimiter=",", skiprows=1):
            events.append((round(row[0] * 1e6) * 1000, -1, row[1:].copy(), False))
    for t_ns, can_id, data, is_fd in sorted(events, key=lambda e: (e[0], e[1] < 0)):
        if can_id < 0:
            pipeline.push_position(t_ns, data)
        else:
            pipeline.push_frame(t_ns, 0, can_id, data, int(is_fd))
        while pipeline.step() != 1:
            pass
    pipeline.flush()
    while pipeline.step() != 1:
        pass
    return pipeline.estimate, pipeline.counters


FD = (COGIRO / "robot_fd.toml").read_text().replace('"robot.toml"', f'"{COGIRO}/robot.toml"')
FD = FD.replace("platform_fd.dbc", f"{COGIRO}/platform_fd.dbc")
WITHOUT_DBC = (COGIRO / "robot.toml").read_text().split("[[bus]]")[0]
for old, new in {
    "[imu]\nposition = [0, 0, 0]": "[imu]\nposition = [0.2, -0.1, 0.3]",
    "orientation = [1, 0, 0, 0]": "orientation = [0.5, 0.5, -0.5, 0.5]",
    "target = [0, 0, 0]": "target = [0.1, 0.3, -0.2]",
}.items():
    assert old in WITHOUT_DBC
    WITHOUT_DBC = WITHOUT_DBC.replace(old, new)
WITHOUT_DBC += '[position]\nsource = "can"\n[attitude]\nsource = "rpy"\n'


@pytest.mark.parametrize("text", [FD, WITHOUT_DBC], ids=["one FD frame", "generated DBC, all over CAN, IMU off centre"])
def test_ideal_sensors_give_back_a_body_the_prior_does_not_know(tmp_path, text):
    file = tmp_path / "robot.toml"
    file.write_text(text)
    robot = description.load(file)
    run = Run(file, robot, BODY, trajectory.paper(), "paper", PRESETS["ideal"], "ideal", 1000.0, 1)
    simulator.simulate(run, tmp_path / "run", lambda step: None)
    estimate, counters = through_the_core(tmp_path / "run")
    assert counters["decode.decoded"] == counters["decode.frames"] > 45_000
    assert estimate["mass"] == pytest.approx(BODY.mass, rel=1e-5)
    assert np.allclose(estimate["cog"], BODY.cog, atol=5e-5)
    assert np.allclose(estimate["inertia_cog"], BODY.inertia_cog, atol=0.05)
    assert estimate["consistent"]


def test_signals_table_of_a_run_is_what_a_user_would_bring(cogiro):
    table, _ = measured(cogiro, Faults(), duration=0.1)
    assert isinstance(table, Table)
    assert {"acc_x", "q_w", "roll", "f_8"} <= set(table.columns)
