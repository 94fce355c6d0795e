# SPDX-License-Identifier: Apache-2.0
"""calibrate: the simulated sensors' errors are found within what is claimed, what cannot be told is named."""

import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import AFTER_IMU

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.finding import Finding
from inertiad.base.text_files import read_json
from inertiad.identify import calibrate
from inertiad.robot import description, systematic
from inertiad.run import reader
from inertiad.run.reader import Recording

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/accept"))
import scenes  # noqa: E402

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    motions = [(1000, 0.0), (1500, 0.0), (2000, 20.0)]
    return reader.read_all(
        [scenes.run(seed, "modern", 100.0, "fourier", mass, errors_of=1000) for seed, mass in motions]
    )


def _calibrated(recordings: list[Recording], payloads: dict[Path, float]) -> calibrate.Calibration:
    robot = recordings[0].robot
    return calibrate.calibrate(robot, reader.config_of(robot, ""), recordings, payloads)


def _truth(recording: Recording) -> np.ndarray:
    t = read_json(recording.path / "truth.json")
    t["force_delay"] += AFTER_IMU
    return np.concatenate([np.atleast_1d(t.get(g.name, np.zeros(g.n))) for g in systematic.groups(8)])


def test_errors_of_the_sensors_are_found_within_their_sigma(recordings: list[Recording]) -> None:
    found = _calibrated(recordings, {recordings[2].path: 20.0})
    is_there = found.std > 1e-9  # the attitude's own errors are the motion stage's
    z = (found.xi - _truth(recordings[0]))[is_there] / found.std[is_there]
    assert (np.abs(z) < 2.0).mean() > 0.8
    assert np.abs(z).max() < 5.0
    offset = systematic.group("force_offset", 8).part
    assert np.std((found.xi - _truth(recordings[0]))[offset]) < 0.7 * np.std(_truth(recordings[0])[offset])


def test_common_gain_is_refused_without_a_known_weight_and_found_with_one(recordings: list[Recording]) -> None:
    without = _calibrated(recordings[:2], {})
    assert any("common force gain" in d and "--payload" in d for d in without.directions)
    with_weight = _calibrated(recordings, {recordings[2].path: 20.0})
    assert not any("common force gain" in d for d in with_weight.directions)
    gain = systematic.group("force_gain", 8).part
    assert with_weight.covariance[gain, gain].sum() < 0.5 * without.covariance[gain, gain].sum()
    error = (with_weight.xi - _truth(recordings[0]))[gain].mean()
    assert abs(error) < 3.0 * np.sqrt(with_weight.covariance[gain, gain].sum()) / 8.0


def test_payload_bodies_differ_by_the_known_mass(recordings: list[Recording]) -> None:
    light, heavy = _calibrated(recordings, {recordings[2].path: 20.0}).estimates
    assert heavy.body.value[0] - light.body.value[0] == pytest.approx(20.0, abs=0.05)


def test_a_run_at_rest_tells_little_and_says_so(recordings: list[Recording]) -> None:
    rows = recordings[0].rows
    still = inertiad_core.Rows(
        np.rint(1e9 * rows.t[:90]).astype(np.int64),
        *(np.ascontiguousarray(a[:90]) for a in (rows.acc, rows.gyro, rows.q, rows.position, rows.f)),
    )
    found = _calibrated([Recording(recordings[0].path, recordings[0].robot, still, 0, 0, {})], {})
    labels = systematic.names(8)
    refused = {labels[i] for i in np.flatnonzero(found.refused)}
    assert {"position_delay", "force_delay"} <= refused
    assert (found.xi[found.refused] == 0.0).all()
    assert "not observable" in calibrate.text(found)


def test_a_low_pass_that_the_data_do_not_tell_is_not_told(recordings: list[Recording]) -> None:
    found = _calibrated(recordings[:2], {})
    at = systematic.group("force_lowpass", 8).part
    assert found.prior_std[at] > 0.0
    assert found.refused[at].all()
    assert (found.xi[at] == 0.0).all()
    assert found.std[at] == pytest.approx(found.prior_std[at])


@pytest.mark.parametrize(("residual", "names"), [(15.0, []), (0.1, ["tracker_delay"])])
def test_mistakes_are_judged_beside_the_joint_fit(
    recordings: list[Recording], monkeypatch: pytest.MonkeyPatch, residual: float, names: list[str]
) -> None:
    """What leaves residual [N], much more than the joint fit of about 1 N, is no mistake."""
    evidence = {"residual_without_N": residual, "residual_least_N": 0.1, "numbers": [0.2]}
    late = Finding("tracker_delay", "stop", "the positions look late", "", evidence)
    monkeypatch.setattr(calibrate.identification.mistake_fit, "find", lambda *_: [late])
    found = _calibrated(recordings[:1], {})
    assert [f.name for f in found.findings if f.name == "tracker_delay"] == names


def test_the_file_takes_what_was_found_into_the_configuration(tmp_path: Path, recordings: list[Recording]) -> None:
    found = _calibrated(recordings, {recordings[2].path: 20.0})
    calibrate.write(tmp_path / "calibration.toml", found)
    ahrs = '[attitude]\nestimate = "ahrs"\n'  # the motion stage would weigh by the new sigmas
    text = f'base = "{scenes.COGIRO}"\n{ahrs}[calibration]\nfile = "calibration.toml"\n'
    (tmp_path / "robot.toml").write_text(text)
    robot = description.load(tmp_path / "robot.toml")
    told = reader.config_of(robot, "")
    xi = found.xi.copy()
    xi[systematic.group("tracker_target", 8).part] = 0.0  # no key of [calibration] has it
    by_ahrs = recordings[0].robot.model_copy(update={"attitude": robot.attitude})
    other = inertiad_core.calibrated(reader.config_of(by_ahrs, ""), xi)
    rows = inertiad_core.undelayed(recordings[0].rows, found.xi[10], found.xi[11])
    a, b = inertiad_core.Windows(told, rows), inertiad_core.Windows(other, rows)
    np.testing.assert_allclose(a.y, b.y, atol=1e-6)
    np.testing.assert_allclose(a.Y, b.Y, atol=1e-9)
    assert (inertiad_core.systematic_std(told) <= inertiad_core.systematic_std(other) * (1.0 + 1e-9)).all()


def test_the_platform_is_better_with_the_file(recordings: list[Recording]) -> None:
    """In the sum over six runs of one installation; a single one is at the noise."""
    found = _calibrated(recordings, {recordings[2].path: 20.0})
    told = description.Calibration.model_validate(calibrate.document(found))
    total = np.zeros(2)
    for seed in range(2500, 2506):
        folder = scenes.run(seed, "modern", 100.0, "fourier", 300.0, errors_of=1000)
        own = description.load(folder / "robot.toml").model_copy(update={"nominal": None})
        true, error = scenes.truth(folder), []
        for robot in (own, own.model_copy(update={"calibration": told})):
            e = scenes.platform(folder, robot).estimate
            error.append(scenes.scaled(np.array([e["mass"], *e["cog"], *e["inertia_cog"]]) - true, true))
        assert error[1][0] < 0.5
        assert (error[1][4:] < 1.5).all()
        total += [error[0].sum(), error[1].sum()]
    assert total[1] < 0.9 * total[0]


@pytest.mark.parametrize("option", ["run", "run=", "run=-1", "run=nan", "other=20"])
def test_payload_options_are_checked(option: str) -> None:
    with pytest.raises(InputError, match="--payload"):
        calibrate.parse_payloads([option], [Path("run")])


def test_tare_refuses_a_file_with_tension(tmp_path: Path, cogiro: description.Robot) -> None:
    header = "t," + ",".join(f"f_{i + 1}" for i in range(8))
    dice = np.random.default_rng(0)
    for level, good in ((3.0, True), (500.0, False)):
        data = np.c_[np.arange(100) / 10.0, level + 0.5 * dice.standard_normal((100, 8))]
        np.savetxt(tmp_path / "tare.csv", data, delimiter=",", header=header, comments="")
        if good:
            tared = calibrate.with_tare(cogiro, tmp_path / "tare.csv")
            assert tared.calibration.force_offset == pytest.approx([3.0] * 8, abs=0.3)
        else:
            with pytest.raises(InputError, match="no tension"):
                calibrate.with_tare(cogiro, tmp_path / "tare.csv")
