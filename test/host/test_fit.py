# SPDX-License-Identifier: Apache-2.0
"""fit: every method against an independent solver on the same windows, and against the simulation's truth."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import drawings
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.body import read
from inertiad.base.error import InputError
from inertiad.base.table import Table
from inertiad.base.text_files import to_toml
from inertiad.identify import findings, fit
from inertiad.robot import description
from inertiad.robot.description import read_data
from inertiad.run import derived_motion, reader, tracker_csv
from inertiad.run.reader import Recording

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/accept"))
import scenes  # noqa: E402

N_XI = 56
"""systematic parameters of eight cables"""


@pytest.fixture(scope="module")
def recording() -> Recording:
    return reader.read(scenes.run(1000, "modern", 100.0, "fourier"))


@pytest.fixture(scope="module")
def config(recording: Recording) -> object:
    return reader.config_of(recording.robot, "test")


def test_wls_equals_statsmodels_on_the_same_windows(recording: Recording, config: object) -> None:
    import statsmodels.api as sm

    options = {"group": [0], "payload": [0.0], "is_free": [False] * N_XI, "theta_prior": 1e6, "is_weight_learnt": False}
    ours = inertiad_core.batch(config, [recording.rows], **options)
    windows = inertiad_core.Windows(config, recording.rows)
    weight = np.tile(1.0 / ours["fit"][0]["noise_std"] ** 2, len(windows.y))
    theirs = sm.WLS(windows.y.ravel(), windows.Y.reshape(-1, 10), weights=weight).fit()
    assert 2 * ours["fit"][0]["n_rest"] <= len(windows.y)  # else windows at rest are treated specially
    np.testing.assert_allclose(ours["body"][0]["theta"], theirs.params, rtol=1e-5, atol=1e-5)


def test_joint_ends_in_the_minimum_that_scipy_finds(recording: Recording, config: object) -> None:
    free = [True] * 11 + [False] * (N_XI - 11)
    options = {"group": [0], "payload": [0.0], "is_free": free, "is_weight_learnt": False}
    std = recording.robot.std.model_copy(
        update={"geometry": 0.0, "attitude_wander": 0.0, "force_offset_drift": 0.0}
    )  # no unknowns beside these
    noise = recording.robot.estimator.model_copy(update={"force_std": 8.0, "moment_std": 5.0})
    attitude = recording.robot.attitude.model_copy(update={"estimate": "ahrs"})  # whose bias is among these unknowns
    still = recording.robot.model_copy(update={"std": std, "estimator": noise, "attitude": attitude})
    config = reader.config_of(still, "test")
    ours = inertiad_core.batch(config, [recording.rows], **options)
    noise, prior_std = ours["fit"][0]["noise_std"], ours["prior_std"]
    told = ours["free"]  # one whose sigma is 0 is not free
    mean = np.r_[_prior_theta(still), np.zeros(len(told))]

    def cost(z: np.ndarray) -> np.ndarray:
        xi = np.zeros(N_XI)
        xi[told] = z[10:]
        rows = inertiad_core.undelayed(recording.rows, xi[10], 0.0)
        windows = inertiad_core.Windows(inertiad_core.calibrated(config, xi), rows)
        n = 222  # windows, whatever the delay drops at the end
        e = (windows.y - windows.Y @ z[:10])[:n] / noise
        return np.r_[e.ravel(), (z - mean) / prior_std]

    found = np.r_[ours["body"][0]["theta"], ours["xi"][told]]
    theirs = least_squares(cost, found + 0.3 * prior_std, x_scale=prior_std, diff_step=1e-6).x
    std = np.sqrt(np.diag(ours["covariance"]))
    assert np.abs((found - theirs) / std).max() < 0.1


def _prior_theta(robot: object) -> np.ndarray:
    from inertiad.robot.configuration import prior

    return prior(robot)[0]


def test_joint_is_closer_to_the_truth_than_wls(recording: Recording, config: object) -> None:
    true = scenes.truth(recording.path)
    joint = scenes.scaled(np.array(fit.joint(config, [recording]).body.value) - true, true)
    plain = scenes.scaled(np.array(fit.wls(config, [recording]).body.value) - true, true)
    assert (joint < [1.0, 4, 4, 4, 2, 2, 2]).all()
    assert joint.sum() < plain.sum()


def test_claimed_sigma_holds_for_joint(recording: Recording, config: object) -> None:
    body = fit.joint(config, [recording]).body
    z = (np.array(body.value) - scenes.truth(recording.path)) / np.array(body.std)
    assert np.abs(z).max() < 3.5


def test_paper_finds_an_ideal_body_from_ideal_sensors(tmp_path: Path) -> None:
    """On cables without mass, of which the method knows nothing: CoGiRo's move its CoG by 3 mm."""
    from inertiad.simulate import sensor_models, simulator

    file, path = tmp_path / "light.toml", scenes.fourier(1000)
    file.write_text(f'base = "{scenes.COGIRO}"\n[cables]\nweight_per_length = 0.0\n')
    robot, level = description.load(file), sensor_models.PRESETS["ideal"]
    assert robot.nominal is not None
    light = simulator.Run(file, robot, robot.nominal, path, "fourier", level, "ideal", 100.0, 1000)
    simulator.simulate(light, tmp_path / "run", lambda _: None)
    run = reader.read(tmp_path / "run")
    true = scenes.truth(run.path)
    estimate = fit.two_step(run.robot, reader.config_of(run.robot, ""), [run])
    assert (scenes.scaled(np.array(estimate.body.value) - true, true) < 2.0).all()


def test_paper_says_when_no_body_can_be_like_that() -> None:
    run = reader.read(scenes.run(1001, "paper", 25.0, "paper"))
    estimate = fit.two_step(run.robot, reader.config_of(run.robot, ""), [run])
    assert not estimate.consistent
    assert "inertia not physically consistent" in estimate.notes[0]


def test_published_body_can_exist_although_the_data_disagree(recording: Recording, config: object) -> None:
    start = recording.rows
    f = start.f[:120] * np.linspace(0.7, 1.3, 8)
    samples = [np.ascontiguousarray(x[:120]) for x in (start.acc, start.gyro, start.q, start.position)]
    few = inertiad_core.Rows(np.rint(1e9 * start.t[:120]).astype(np.int64), *samples, f)
    estimate = fit.wls(config, [Recording(recording.path, recording.robot, few, 0, 0, {})])
    assert inertiad_core.is_consistent(estimate.theta)


def test_validation_predicts_a_run_not_used(recording: Recording, config: object) -> None:
    other = reader.read(scenes.run(1500, "modern", 100.0, "fourier", errors_of=1000))
    joint = fit.validate(config, fit.joint(config, [recording]), other)
    plain = fit.validate(config, fit.wls(config, [recording]), other)
    assert (joint.rms < 0.1 * joint.signal).all()
    assert np.linalg.norm(joint.rms) < np.linalg.norm(plain.rms)


def test_what_force_sensors_typically_leave_does_not_follow_a_few_windows(recording: Recording, config: object) -> None:
    estimate = fit.joint(config, [recording])
    pushed = recording.rows.f.copy()
    pushed[: len(pushed) // 20] *= 1.3
    arrays = (recording.rows.acc, recording.rows.gyro, recording.rows.q, recording.rows.position, pushed)
    t_ns = np.rint(1e9 * recording.rows.t).astype(np.int64)
    rows = inertiad_core.Rows(t_ns, *(np.ascontiguousarray(a) for a in arrays))
    clean = fit.validate(config, estimate, recording)
    seen = fit.validate(config, estimate, replace(recording, rows=rows))
    assert (seen.tension_rms > 5.0 * clean.tension_rms).all()
    np.testing.assert_allclose(seen.tension_typical, clean.tension_typical, rtol=0.2)
    np.testing.assert_allclose(clean.tension_typical, clean.tension_rms, rtol=0.5)  # a good fit leaves no outliers


@pytest.mark.parametrize(("typical", "names"), [(0.01, []), (0.2, ["forces_disagree"])])
def test_force_sensors_are_judged_by_what_they_typically_leave(
    recording: Recording, config: object, monkeypatch: pytest.MonkeyPatch, typical: float, names: list[str]
) -> None:
    tension = float(np.abs(recording.rows.f).mean())
    left = fit.Validation(recording.path, np.ones(6), np.ones(6), np.full(8, tension), np.full(8, typical * tension))
    monkeypatch.setattr(fit, "validate", lambda *_: left)
    result = fit.batch(config, [recording])
    assert [f.name for f in findings._forces(config, result, [recording], [0])] == names


def _csv(path: Path, recording: Recording, columns: list[str], every: int = 1) -> Path:
    rows = recording.rows
    table = {"t": rows.t[:, None], "acc": rows.acc, "gyro": rows.gyro, "q": rows.q, "pos": rows.position, "f": rows.f}
    names = {"acc": "xyz", "gyro": "xyz", "q": "wxyz", "pos": "xyz", "f": [str(i + 1) for i in range(8)]}
    header = ["t", *(f"{c}_{a}" for c in columns for a in names[c])]
    data = np.hstack([table["t"], *(table[c] for c in columns)])[::every]
    np.savetxt(path, data, delimiter=",", header=",".join(header), comments="", fmt="%.12g")
    return path


def test_signals_csv_gives_what_the_run_gives(tmp_path: Path, recording: Recording, config: object) -> None:
    file = _csv(tmp_path / "signals.csv", recording, ["acc", "gyro", "q", "pos", "f"])
    found = fit.joint(config, [reader.read(file, scenes.COGIRO)]).body
    np.testing.assert_allclose(found.value, fit.joint(config, [recording]).body.value, rtol=1e-3, atol=2e-3)


def test_without_gyro_and_accelerometer_the_body_is_found(tmp_path: Path) -> None:
    ideal = reader.read(scenes.run(1000, "ideal", 100.0, "fourier"))
    run = reader.read(_csv(tmp_path / "signals.csv", ideal, ["q", "pos", "f"]), scenes.COGIRO)
    assert run.notes == ("rate derived from attitude", "specific force derived from positions")
    estimate = fit.wls(reader.config_of(run.robot, ""), [run])
    error = scenes.scaled(np.array(estimate.body.value) - scenes.truth(ideal.path), scenes.truth(ideal.path))
    assert (error < [0.2, 2, 2, 2, 2, 2, 2]).all()


def test_without_an_attitude_that_of_the_trackers_poses_serves(tmp_path: Path) -> None:
    ideal = reader.read(scenes.run(1000, "ideal", 100.0, "fourier"))
    file = _csv(tmp_path / "signals.csv", ideal, ["acc", "gyro", "f"])
    rows = ideal.rows
    columns = dict(zip(("x", "y", "z"), rows.position[::2].T, strict=True))
    columns |= dict(zip(("q_w", "q_x", "q_y", "q_z"), rows.q[::2].T, strict=True))
    tracker_csv.write(tmp_path / "tracker.csv", Table(rows.t[::2], columns, "poses at 50 Hz"))
    run = reader.read(file, scenes.COGIRO)
    assert run.notes == ("attitude of the tracker's poses",)
    estimate = fit.wls(reader.config_of(run.robot, ""), [run])
    error = scenes.scaled(np.array(estimate.body.value) - scenes.truth(ideal.path), scenes.truth(ideal.path))
    assert (error < [0.2, 2, 2, 2, 2, 2, 2]).all()


def _at_angles(rows: object, yaw: float, bias: np.ndarray, delay: float) -> np.ndarray:
    """Columns of a run: attitude off by a yaw and a bias [3] (rad), positions late by a delay (s)."""
    q = Rotation.from_euler("z", -yaw) * Rotation.from_quat(rows.q, scalar_first=True) * Rotation.from_rotvec(-bias)
    late = np.array([np.interp(rows.t - delay, rows.t, x) for x in rows.position.T]).T
    return np.hstack([rows.t[:, None], q.as_quat(scalar_first=True), late, rows.f])


def test_derived_motion_takes_part_in_what_its_sources_do_wrong(tmp_path: Path) -> None:
    """The attitude's errors and the tracker's delay are found from the specific force that was derived with them."""
    ideal = reader.read(scenes.run(1000, "ideal", 100.0, "fourier"))
    yaw, bias, delay = 0.05, np.array([0.02, -0.01, 0.015]), 0.02
    header = "t,q_w,q_x,q_y,q_z,pos_x,pos_y,pos_z," + ",".join(f"f_{i + 1}" for i in range(8))
    file = tmp_path / "signals.csv"
    np.savetxt(file, _at_angles(ideal.rows, yaw, bias, delay), delimiter=",", header=header, comments="", fmt="%.12g")
    run = reader.read(file, scenes.COGIRO)
    known = {"force_gain": 1e-6, "force_offset": 1e-3, "imu_alignment": 1e-9, "geometry": 0.0, "attitude_wander": 1e-6}
    wide = {"attitude": 0.05, "world_yaw": 0.1, "position_delay": 0.05, **known}
    robot = run.robot.model_copy(update={"std": run.robot.std.model_copy(update=wide)})
    estimate = fit.joint(reader.config_of(robot, ""), [run])
    assert estimate.xi is not None
    np.testing.assert_allclose(estimate.xi[:3], bias, atol=5e-4)
    np.testing.assert_allclose(estimate.xi[[3, 10]], [yaw, delay], atol=5e-4)
    error = scenes.scaled(np.array(estimate.body.value) - scenes.truth(ideal.path), scenes.truth(ideal.path))
    assert (error < [0.2, 2, 2, 2, 2, 2, 2]).all()


def test_trackers_poses_are_turned_into_the_imus_axes_and_time() -> None:
    robot = description.load(scenes.COGIRO)
    mount, late = Rotation.from_euler("z", 0.7), 0.02
    robot = robot.model_copy(
        update={
            "imu": robot.imu.model_copy(update={"orientation": mount.as_quat(scalar_first=True).tolist()}),
            "align": robot.align.model_copy(update={"delay_position": late}),
        }
    )
    t = np.r_[np.arange(0.0, 1.0, 0.1), np.arange(2.0, 3.0, 0.1)]  # a gap of 1.1 s
    body = Rotation.from_euler("x", (t - late)[:, None])  # the platform at the measured instant
    poses = Table(t, dict(zip(("q_w", "q_x", "q_y", "q_z"), body.as_quat(scalar_first=True).T, strict=True)), "poses")
    at = np.arange(-0.5, 3.5, 0.025)
    q, chosen = derived_motion.attitude_from_poses(robot, poses, at)
    seen = at + late
    assert np.array_equal(chosen, ((seen >= 0.0) & (seen <= 0.9)) | ((seen >= 2.0) & (seen <= t[-1])))
    expected = Rotation.from_euler("x", at[chosen][:, None]) * mount
    assert (expected.inv() * Rotation.from_quat(q, scalar_first=True)).magnitude().max() < 1e-9


def test_poses_of_another_time_leave_nothing(tmp_path: Path) -> None:
    ideal = reader.read(scenes.run(1000, "ideal", 100.0, "fourier"))
    file = _csv(tmp_path / "signals.csv", ideal, ["acc", "gyro", "f"])
    columns = dict.fromkeys(("x", "y", "z", "q_x", "q_y", "q_z"), np.zeros(5)) | {"q_w": np.ones(5)}
    tracker_csv.write(tmp_path / "tracker.csv", Table(1e4 + np.arange(5.0), columns, "later"))
    with pytest.raises(InputError, match=r"no pose within 0\.25 s of any sample"):
        reader.read(file, scenes.COGIRO)


@pytest.mark.parametrize("columns", [["gyro", "q", "pos", "f"], ["acc", "q", "pos", "f"], ["q", "pos", "f"]])
def test_noise_of_derived_motion_does_not_wear_the_body_down(tmp_path: Path, columns: list[str]) -> None:
    modern = reader.read(scenes.run(1000, "modern", 50.0, "paper"))
    run = reader.read(_csv(tmp_path / "signals.csv", modern, columns), modern.path / "robot.toml")
    body = fit.joint(reader.config_of(run.robot, ""), [run]).body
    error = np.abs(np.array(body.value) - scenes.truth(modern.path))
    assert (error < 3.0 * np.array(body.std)).all()


def test_derived_motion_is_what_calibrated_sensors_would_have_measured(recording: Recording, tmp_path: Path) -> None:
    """A calibration of the IMU changes rows of which IMU and rate are derived so that the motion in them stays."""
    told = {"acc_bias": [0.3, -0.2, 0.1], "gyro_bias": [0.02, 0.01, -0.03], "imu_alignment": [0.1, 0.05, -0.1]}
    file = _csv(tmp_path / "signals.csv", recording, ["q", "pos", "f"])
    robot_file, rows, windows = tmp_path / "robot.toml", [], []
    for calibration in ({}, told):
        robot_file.write_text(to_toml({**read_data(scenes.COGIRO), "calibration": calibration}), encoding="utf-8")
        run = reader.read(file, robot_file)
        rows.append(run.rows)
        windows.append(inertiad_core.Windows(reader.config_of(run.robot, ""), run.rows))
    turn = Rotation.from_rotvec(told["imu_alignment"]).as_matrix()
    s = [w.Y[:, :3, 0] for w in windows]
    np.testing.assert_allclose(s[1], s[0] @ turn.T, atol=1e-9)
    np.testing.assert_allclose(rows[1].gyro, rows[0].gyro + told["gyro_bias"], atol=1e-9)


def test_poses_at_rest_give_mass_and_cog_and_no_inertia(tmp_path: Path) -> None:
    ideal = reader.read(scenes.run(1000, "ideal", 100.0, "fourier"))
    file = _static_poses(tmp_path / "poses.csv", ideal)
    run = reader.read(file, scenes.COGIRO)
    estimate = fit.joint(reader.config_of(run.robot, ""), [run])
    true = scenes.truth(ideal.path)
    assert abs(estimate.body.value[0] / true[0] - 1.0) < 0.01
    assert np.abs(np.array(estimate.body.value[1:4]) - true[1:4]).max() < 0.01
    assert estimate.observable[:3] == (True,) * 3
    assert estimate.observable[4:] == (False,) * 6


def _static_poses(path: Path, recording: Recording) -> Path:
    """20 poses of the motion with the tensions that hold them still."""
    from inertiad.model.trajectory import Motion
    from inertiad.robot import configuration, description
    from inertiad.simulate import simulator

    robot = description.load(scenes.COGIRO)
    rows, k = recording.rows, np.linspace(250, 2000, 20).astype(int)
    zero = np.zeros((20, 3))
    R = Rotation.from_quat(rows.q[k], scalar_first=True).as_matrix()
    motion = Motion(np.ascontiguousarray(rows.position[k]), zero, zero, R, zero, zero)
    config = inertiad_core.Config(configuration.compile_robot(robot, ""))
    assert robot.nominal is not None
    f = simulator.tensions(simulator.Mechanics(config, robot, robot.nominal), np.arange(20.0), motion)
    data = np.hstack([np.arange(20.0)[:, None] * 5.0, rows.q[k], rows.position[k], f])
    header = "t,q_w,q_x,q_y,q_z,pos_x,pos_y,pos_z," + ",".join(f"f_{i + 1}" for i in range(8))
    np.savetxt(path, data, delimiter=",", header=header, comments="")
    return path


def test_rate_from_attitude_has_the_gyros_sign_and_size() -> None:
    ideal = reader.read(scenes.run(1000, "ideal", 100.0, "fourier")).rows
    rate = derived_motion.rate_from_attitude(ideal.t, ideal.q, 0.1)
    assert np.abs(rate - ideal.gyro)[50:-50].max() < 2e-3
    assert np.abs(ideal.gyro).max() > 0.3


@pytest.mark.slow
def test_the_command_writes_the_schema_and_names_bad_input(tmp_path: Path, recording: Recording) -> None:
    program = str(TOP / "build/bin/inertiactl")
    out, page = tmp_path / "e.json", tmp_path / "fit.html"
    command = [program, "fit", str(recording.path), "--json", str(out), "--picture", str(page)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    drawn = drawings(page)
    assert set(drawn) == {"numbers", "residuals_over_time", "convergence"}
    assert len(drawn["numbers"]["grid"]["titles"]) == 10 and len(drawn["residuals_over_time"]["data"]) == 8
    assert read(out).value[0] == pytest.approx(scenes.truth(recording.path)[0], rel=0.01)
    assert {"method", "consistent", "observable", "samples", "duration_s", "force_offset"} <= set(
        json.loads(out.read_text())
    )
    bad = subprocess.run([program, "fit", str(tmp_path), "--method", "magic"], capture_output=True, text=True)
    assert bad.returncode == 2
    assert bad.stderr.count("\n") == 1 and "magic" in bad.stderr
    bad = subprocess.run([program, "fit", str(tmp_path), "--picture", "fit.jpg"], capture_output=True, text=True)
    assert bad.returncode == 2
    assert (
        bad.stderr
        == "inertiactl: --picture fit.jpg: allowed: a file that ends with .html or .png; -: a page to stdout\n"
    )


def test_force_noise_does_not_make_the_body_lighter(recording: Recording) -> None:
    """All forces and the body together a little smaller also makes the noise smaller: no reason to believe it."""
    std = recording.robot.std.model_copy(update={"force_gain": 0.05})
    robot, rows = recording.robot.model_copy(update={"std": std}), recording.rows
    noise = 20.0 * np.random.default_rng(1).standard_normal(rows.f.shape)
    t_ns = np.rint(1e9 * rows.t).astype(np.int64)
    noisy = inertiad_core.Rows(t_ns, rows.acc, rows.gyro, rows.q, rows.position, rows.f + noise)
    body = fit.joint(reader.config_of(robot, "test"), [Recording(recording.path, robot, noisy, 0, 0, {})]).body
    assert abs(body.value[0] - scenes.truth(recording.path)[0]) < body.std[0]


def test_nothing_that_lines_up_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"robot\.toml: not found"):
        reader.read(tmp_path)


@pytest.mark.slow
def test_joint_weighs_wander_as_the_whole_covariance_does(recording: Recording, config: object) -> None:
    """Against generalised least squares with the dense covariance of wander and noise over all windows."""
    free = [True] * 3 + [False] * (N_XI - 3)
    options = {"group": [0], "payload": [0.0], "is_free": free, "is_weight_learnt": False}
    std = recording.robot.std.model_copy(update={"geometry": 0.0, "force_offset_drift": 0.0})
    attitude = recording.robot.attitude.model_copy(update={"estimate": "ahrs"})  # whose wander has one time
    config = reader.config_of(recording.robot.model_copy(update={"std": std, "attitude": attitude}), "test")
    ours = inertiad_core.batch(config, [recording.rows], **options)
    noise, prior_std = ours["fit"][0]["noise_std"], ours["prior_std"]

    calibrated = inertiad_core.calibrated(config, np.r_[ours["xi"][:3], np.zeros(N_XI - 3)])
    windows = inertiad_core.Windows(calibrated, recording.rows)
    turn = windows.X(np.array(ours["body"][0]["theta"]))[:, :, :3].reshape(-1, 3)
    by_wander = np.einsum("kji,kai->kja", turn.reshape(-1, 6, 3), windows.R).reshape(-1, 3)  # about W's axes
    age = np.repeat(np.asarray(windows.t), 6)
    C = std.attitude_wander**2 * (by_wander @ by_wander.T) * np.exp(-np.abs(age[:, None] - age) / 20.0)
    whiten = np.linalg.inv(np.linalg.cholesky(C + np.diag(np.tile(noise**2, len(windows.y)))))
    A = np.vstack([whiten @ np.hstack([windows.Y.reshape(-1, 10), -turn]), np.diag(1.0 / prior_std)])
    e = whiten @ windows.y.ravel()
    mean = np.r_[_prior_theta(recording.robot), -np.array(ours["xi"][:3])]
    found = np.linalg.lstsq(A, np.r_[e, mean / prior_std], rcond=None)[0]
    P = np.linalg.inv(A.T @ A)
    sigma = np.sqrt(np.diag(P))
    assert np.abs((np.r_[ours["body"][0]["theta"], np.zeros(3)] - found) / sigma).max() < 0.02
    np.testing.assert_allclose(np.sqrt(np.diag(ours["covariance"])), sigma, rtol=1e-3)
