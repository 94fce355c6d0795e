# SPDX-License-Identifier: Apache-2.0
"""Each mistake made on purpose is named, and good data are left alone."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

import inertiad_core
from inertiad.identify import diagnose, mistake_fit, mistake_table
from inertiad.run import reader
from inertiad.run.reader import Recording

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/accept"))
import scenes  # noqa: E402


@pytest.fixture(scope="module", params=[("modern", 100.0), ("paper", 25.0)], ids=["modern", "paper"])
def good(request: pytest.FixtureRequest) -> Recording:
    level, rate = request.param
    return reader.read(scenes.run(1000, level, rate, "fourier"))


def _with(run: Recording, **changed: np.ndarray) -> Recording:
    rows = run.rows
    keys = ("acc", "gyro", "q", "position", "f")
    arrays = [np.ascontiguousarray(changed.get(k, getattr(rows, k))) for k in keys]
    return replace(run, rows=inertiad_core.Rows(np.rint(1e9 * rows.t).astype(np.int64), *arrays))


def _findings(run: Recording) -> str:
    return "\n".join(finding.says for finding in diagnose.diagnose(run.robot, [run]))


def test_good_data_have_no_finding(good: Recording) -> None:
    assert _findings(good) == ""


@pytest.mark.slow
@pytest.mark.parametrize("pair", [(3, 4), (1, 8)])
def test_swapped_cables_are_named(good: Recording, pair: tuple[int, int]) -> None:
    order = np.arange(8)
    order[[pair[0] - 1, pair[1] - 1]] = order[[pair[1] - 1, pair[0] - 1]]
    assert f"cables {pair[0]} and {pair[1]} look swapped" in _findings(_with(good, f=good.rows.f[:, order]))


@pytest.mark.parametrize(("unit", "factor"), [("kN", 1e-3), ("kg", 1.0 / 9.80665)])
def test_a_wrong_force_unit_is_named(good: Recording, unit: str, factor: float) -> None:
    assert f"are the forces in {unit}?" in _findings(_with(good, f=factor * good.rows.f))


def test_a_tracker_in_mm_is_named(good: Recording) -> None:
    assert "is the tracker in mm?" in _findings(_with(good, position=1e3 * good.rows.position))


def test_gravity_with_the_wrong_sign_is_named(good: Recording) -> None:
    assert "gravity has the wrong sign" in _findings(_with(good, acc=-good.rows.acc))


@pytest.mark.slow
def test_an_imu_upside_down_is_named(good: Recording) -> None:
    imu = good.robot.imu.model_copy(update={"orientation": [0.0, 1.0, 0.0, 0.0]})
    assert "upside down" in _findings(replace(good, robot=good.robot.model_copy(update={"imu": imu})))


@pytest.mark.slow
def test_an_accelerometer_in_g_is_named(good: Recording) -> None:
    assert "is it in g?" in _findings(_with(good, acc=good.rows.acc / 9.81))


@pytest.mark.slow
def test_a_gyro_in_degrees_is_named(good: Recording) -> None:
    assert "deg/s?" in _findings(_with(good, gyro=np.rad2deg(good.rows.gyro)))


@pytest.mark.slow
def test_a_slack_cable_is_named(good: Recording) -> None:
    f = good.rows.f.copy()
    f[200:400, 2] = 5.0 + 0.1 * np.arange(200)
    assert "cable 3 is slack" in _findings(_with(good, f=f))


@pytest.mark.slow
def test_a_saturated_sensor_is_named(good: Recording) -> None:
    f = good.rows.f.copy()
    f[:, 4] = np.minimum(f[:, 4], np.quantile(f[:, 4], 0.8))
    assert "force sensor 5 is saturated" in _findings(_with(good, f=f))


@pytest.mark.parametrize("step", [1.0, 20.0])
def test_a_coarse_sensor_is_not_saturated(good: Recording, step: float) -> None:
    """It gives each of its values over and over, those at the turning points of a slow motion most of all."""
    slow = np.repeat(good.rows.f[::8], 8, axis=0)[: len(good.rows)]
    assert diagnose._saturated(good.robot, _with(good, f=step * np.rint(slow / step))) == []


@pytest.mark.parametrize("tension_min", [0.0, 50.0])
@pytest.mark.parametrize("std", [0.02, 0.5])
def test_a_tension_held_at_its_least_is_not_saturated(good: Recording, std: float, tension_min: float) -> None:
    """By a controller: the sensor's noise, N, is small against its range, and against what motion changes elsewhere."""
    f, held = good.rows.f.copy(), np.quantile(good.rows.f[:, 4], 0.3)
    below = f[:, 4] < held
    f[below, 4] = held + np.random.default_rng(1).normal(0.0, std, below.sum())
    assert f[:, 4].max() - held > 300.0
    assert diagnose._saturated(_with_cable(good, 4, tension_min=tension_min).robot, _with(good, f=f)) == []


def _with_cable(run: Recording, i: int, **update: object) -> Recording:
    cables = [c.model_copy(update=update) if k == i else c for k, c in enumerate(run.robot.cable)]
    return replace(run, robot=run.robot.model_copy(update={"cable": cables}))


def _moved(run: Recording, i: int, key: str, axis: int, by: float) -> Recording:
    place = list(getattr(run.robot.cable[i], key))
    place[axis] += by
    return _with_cable(run, i, **{key: place})


def _late(run: Recording, key: str, delay: float) -> Recording:
    rows = run.rows
    late = np.column_stack([np.interp(rows.t - delay, rows.t, x) for x in getattr(rows, key).T])
    return _with(run, **{key: late if key != "q" else late / np.linalg.norm(late, axis=1)[:, None]})


def _aimed(run: Recording, by: list[float]) -> Recording:
    tracker = run.robot.tracker.model_copy(update={"target": (np.array(run.robot.tracker.target) + by).tolist()})
    return replace(run, robot=run.robot.model_copy(update={"tracker": tracker}))


def _yawed(run: Recording, angle: float) -> Recording:
    c, s = np.cos(angle), np.sin(angle)
    return _with(run, position=run.rows.position @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


TABLE = {
    "swapped_cables": (
        lambda run: _with(run, f=run.rows.f[:, [0, 5, 2, 3, 4, 1, 6, 7]]),
        "cables 2 and 6 look swapped",
    ),
    "acc_axes": (lambda run: _with(run, acc=run.rows.acc * [1.0, -1.0, 1.0]), "axes look like x, -y, z"),
    "gyro_axes": (lambda run: _with(run, gyro=run.rows.gyro[:, [1, 0, 2]]), "axes look like y, x, z"),
    "quaternion": (lambda run: _with(run, q=run.rows.q[:, [1, 2, 3, 0]]), "its order looks like x y z w"),
    "tracker_axes": (lambda run: _with(run, position=run.rows.position[:, [1, 0, 2]]), "axes look like y, x, z"),
    "tracker_yaw": (lambda run: _yawed(run, 0.2), "the tracker's world looks turned by"),
    "tracker_target": (lambda run: _aimed(run, [0.0, 0.4, 0.0]), "the tracker looks at another point"),
    "anchor": (lambda run: _moved(run, 2, "anchor", 0, 1.0), "cable[3].anchor looks wrong along x"),
    "attachment": (lambda run: _moved(run, 5, "attachment", 1, -0.3), "cable[6].attachment looks wrong along y"),
    "force_gain": (lambda run: _with(run, f=run.rows.f * [1, 1, 1, 1.3, 1, 1, 1, 1]), "force sensor 4 looks scaled"),
    "force_delay": (lambda run: _late(run, "f", 0.1), "the forces look 0."),
    "attitude_delay": (lambda run: _late(run, "q", 0.1), "the attitude looks 0."),
    "tracker_delay": (lambda run: _late(run, "position", 0.1), "the positions look 0."),
}
"""of the table: what is done to a run, what is said"""
NUMBERS = {"tracker_yaw": 0.2, "anchor": -1.0, "attachment": 0.3, "force_gain": 1.0 / 1.3 - 1.0}
NUMBERS |= {"force_delay": 0.1, "attitude_delay": 0.1, "tracker_delay": 0.1}
"""that are found, m, rad, s"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", TABLE)
def test_every_mistake_of_the_table_is_named_first(kind: str) -> None:
    make, words = TABLE[kind]
    made = make(reader.read(scenes.run(1000, "modern", 100.0, "fourier")))
    found = diagnose.diagnose(made.robot, [made])
    assert found and found[0].name == kind and words in found[0].says, found
    if kind in NUMBERS:
        assert found[0].evidence["numbers"] == pytest.approx([NUMBERS[kind]], rel=0.1)


@pytest.mark.slow
def test_forces_behind_a_low_pass_are_no_mistake_of_wiring() -> None:
    """The joint fit takes a delay and a low-pass out of the forces: usable with care."""
    run = reader.read(scenes.run(1000, "modern", 100.0, "fourier"))
    sos = scipy.signal.bessel(4, 2.0, fs=100.0, norm="mag", output="sos")
    smooth = scipy.signal.sosfilt(sos, run.rows.f - run.rows.f[0], axis=0) + run.rows.f[0]
    found = diagnose.diagnose(run.robot, [_with(run, f=smooth)])
    assert [(f.name, f.severity) for f in found] == [("force_lowpass", "care")]


def test_rest_and_one_pose_are_named(good: Recording) -> None:
    still = {k: np.repeat(getattr(good.rows, k)[:1], len(good.rows), axis=0) for k in ("q", "position", "gyro")}
    assert "one pose only" in _findings(_with(good, **still | {"gyro": 0.0 * good.rows.gyro}))


@pytest.mark.parametrize(
    ("best", "rival", "severity"), [("stop", "care", "stop"), ("care", "stop", "care"), ("stop", "stop", "stop")]
)
def test_a_mild_rival_does_not_make_a_mistake_mild(
    good: Recording, best: str, rival: str, severity: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fitted(kind: str, cost: float, sigma: float, mild: str) -> mistake_fit.Fitted:
        mistake = mistake_table.Mistake(kind, kind, lambda case, x: case)
        law = SimpleNamespace(solved=(None, sigma, 0.0), floor=0.1)
        return mistake_fit.Fitted(replace(mistake, severity=mild), cost, np.zeros(0), [law, law, law])  # type: ignore

    nothing = replace(fitted("none", 1e4, 100.0, "stop"), mistake=mistake_fit.NOTHING)
    found = [fitted("gross", 0.0, 1.0, best), fitted("other", 1.0, 1.0, rival), nothing]
    monkeypatch.setattr(mistake_fit, "explain", lambda judge: found)
    (finding,) = mistake_fit.find(good.robot, [good])
    assert (finding.severity, finding.name) == (severity, "gross")
    assert "; or other" in finding.says
    assert finding.do == (mistake_fit.MILD if severity == "care" else mistake_fit.CORRECT)
