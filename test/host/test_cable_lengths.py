# SPDX-License-Identifier: Apache-2.0
"""Positions from cable lengths and attitude: against straight lines in numpy, on a simulated run, and refused input."""

from pathlib import Path

import numpy as np
import pytest
from conftest import TOP
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base import quantity, table
from inertiad.base.error import InputError
from inertiad.base.table import Table
from inertiad.base.text_files import to_toml
from inertiad.robot import configuration, description
from inertiad.robot.description import Robot
from inertiad.run import cable_lengths, encode, reader, signals_csv, tracker_csv

TARGET = [0.05, -0.02, 0.1]


def cubic_robot(folder: Path, n_cables: int, pulley_radius: float = 0.0) -> Robot:
    """Cables from the top of a room of 4 x 3 x 2.5 m, attached alternately at the bottom and top of a box."""
    angle = 2.0 * np.pi * np.arange(n_cables) / n_cables
    anchors = np.column_stack([2.0 * np.cos(angle), 1.5 * np.sin(angle), np.full(n_cables, 2.5)])
    box = np.column_stack([0.2 * np.cos(angle + 0.3), 0.15 * np.sin(angle - 0.2), 0.1 * (-1.0) ** np.arange(n_cables)])
    cables = [{"anchor": a.tolist(), "attachment": b.tolist()} for a, b in zip(anchors, box, strict=True)]
    path = folder / "robot.toml"
    keys = {"name": "room", "cable": cables, "tracker": {"target": TARGET}, "cables": {"pulley_radius": pulley_radius}}
    path.write_text(to_toml(keys), encoding="utf-8")
    return description.load(path)


def motion(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Times, positions of P and attitudes, within the room."""
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(n)
    p = [0.0, 0.0, 0.9] + [0.6, 0.5, 0.3] * np.sin(np.outer(t, rng.uniform(0.3, 1.5, 3)) + rng.uniform(0, 6, 3))
    turn = Rotation.from_rotvec(0.3 * np.sin(np.outer(t, rng.uniform(0.3, 1.5, 3)) + rng.uniform(0, 6, 3)))
    return t, p, turn


def straight_lengths(robot: Robot, p: np.ndarray, turn: Rotation) -> np.ndarray:
    anchors, attachments = (np.array([getattr(c, key) for c in robot.cable]) for key in ("anchor", "attachment"))
    return np.linalg.norm(anchors - p[:, None] - np.einsum("nij,kj->nki", turn.as_matrix(), attachments), axis=2)


def signals_of(t: np.ndarray, turn: Rotation, **more: np.ndarray) -> Table:
    q = dict(zip(quantity.QUATERNION, turn.as_quat(scalar_first=True).T, strict=True))
    return Table(t, q | more, "signals.csv")


def lengths_of(t: np.ndarray, lengths: np.ndarray) -> Table:
    return Table(t, dict(zip(quantity.measured_lengths(lengths.shape[1]), lengths.T, strict=True)), "lengths.csv")


@pytest.mark.parametrize("n_cables", [3, 4, 6, 8])
@pytest.mark.parametrize("seed", [1, 2])
def test_positions_are_those_of_straight_cables(tmp_path: Path, n_cables: int, seed: int) -> None:
    robot = cubic_robot(tmp_path, n_cables)
    t, p, turn = motion(200, seed)
    late = slice(0, None, 3)  # lengths are sampled at a third of the rate
    found = cable_lengths.positions(
        robot, "test", signals_of(t, turn), lengths_of(t[late], straight_lengths(robot, p, turn)[late])
    )
    np.testing.assert_allclose(found.positions.t, t[late])
    np.testing.assert_allclose(found.positions.stack("x", "y", "z"), (p + turn.apply(TARGET))[late], atol=1e-6)
    assert found.residual < 1e-7


def test_what_remains_of_the_lengths_is_said(tmp_path: Path) -> None:
    robot = cubic_robot(tmp_path, 4)
    t, p, turn = motion(2000, 3)
    noise = np.random.default_rng(3).normal(0.0, 2e-3, (len(t), 4))
    found = cable_lengths.positions(
        robot, "test", signals_of(t, turn), lengths_of(t, straight_lengths(robot, p, turn) + noise)
    )
    assert found.residual == pytest.approx(2e-3 * np.sqrt(1 / 4), rel=0.1)  # one equation of four is over


@pytest.mark.parametrize(("instant", "length"), [(7, 0.3), (7, -0.3), (0, 0.05)])
def test_an_instant_that_disagrees_is_left_out_and_counted(tmp_path: Path, instant: int, length: float) -> None:
    robot = cubic_robot(tmp_path, 6)
    t, p, turn = motion(2000, 3)
    lengths = straight_lengths(robot, p, turn) + np.random.default_rng(4).normal(0.0, 1e-3, (len(t), 6))
    lengths[instant, 2] += length
    found = cable_lengths.positions(robot, "test", signals_of(t, turn), lengths_of(t, lengths))
    assert found.n_dropped == 1 and "; 1 of 2000 instants left out: there the lengths disagree by" in found.note
    assert "more than 6.3 mm; check the encoders" in found.note
    assert t[instant] not in found.positions.t and len(found.positions.t) == len(t) - 1
    whole = np.delete(p + turn.apply(TARGET), instant, axis=0)
    assert np.abs(found.positions.stack("x", "y", "z") - whole).max() < 0.02


@pytest.mark.parametrize("reading", [0.001, 0.1, 10.0, 50.0, 65.535])
@pytest.mark.parametrize(("n_cables", "radius"), [(3, 0.0), (4, 0.0), (6, 0.05), (8, 0.05)])
def test_an_encoder_that_drops_out_costs_its_instants_only(
    tmp_path: Path, n_cables: int, radius: float, reading: float
) -> None:
    robot = cubic_robot(tmp_path, n_cables, radius)
    t, p, turn = motion(300, 3)
    lengths = straight_lengths(robot, p, turn)
    if radius > 0.0:  # lengths with the arc on the pulley
        config = inertiad_core.Config(configuration.compile_robot(robot, "test"))
        lengths = inertiad_core.cable_geometry(config, p, turn.as_matrix())[2]
    lengths[[70, 71, 200], 2] = reading
    found = cable_lengths.positions(robot, "test", signals_of(t, turn), lengths_of(t, lengths))
    assert found.n_dropped == 3 and not np.isin(t[[70, 71, 200]], found.positions.t).any()
    whole = np.delete(p + turn.apply(TARGET), [70, 71, 200], axis=0)
    np.testing.assert_allclose(found.positions.stack("x", "y", "z"), whole, atol=1e-6)


def test_lengths_without_a_pose_at_many_instants_are_refused(tmp_path: Path) -> None:
    robot = cubic_robot(tmp_path, 4)
    t, p, turn = motion(100, 3)
    lengths = straight_lengths(robot, p, turn)
    lengths[10:16, 2] = 50.0
    with pytest.raises(InputError, match=r"6 of 100 instants, the first at t = 0\.2 s: no pose has these lengths"):
        cable_lengths.positions(robot, "test", signals_of(t, turn), lengths_of(t, lengths))


@pytest.mark.parametrize("n_cables", [1, 2])
def test_fewer_than_three_cables_give_no_position(tmp_path: Path, n_cables: int) -> None:
    robot = cubic_robot(tmp_path, n_cables)
    t, p, turn = motion(50, 5)
    with pytest.raises(InputError, match=f"{n_cables} cables: allowed: 3 or more"):
        cable_lengths.positions(robot, "t", signals_of(t, turn), lengths_of(t, straight_lengths(robot, p, turn)))


def test_cables_of_one_plane_give_no_position(tmp_path: Path) -> None:
    anchors = [[-2.0, 0.0, 2.5], [2.0, 0.0, 2.5], [2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]
    attachments = [[-0.2, 0.0, 0.1], [0.2, 0.0, 0.1], [0.2, 0.0, -0.1], [-0.2, 0.0, -0.1]]
    cables = [{"anchor": a, "attachment": b} for a, b in zip(anchors, attachments, strict=True)]
    path = tmp_path / "robot.toml"
    path.write_text(to_toml({"name": "plane", "cable": cables, "tracker": {"target": TARGET}}), encoding="utf-8")
    robot = description.load(path)
    t, p, _ = motion(50, 6)
    p[:, 1] = 0.0
    level = Rotation.identity(len(t))
    with pytest.raises(InputError, match=r"t = [\d.]+ s: the 4 cables leave a direction free"):
        cable_lengths.positions(robot, "t", signals_of(t, level), lengths_of(t, straight_lengths(robot, p, level)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x: 1e3 * x, "no pose has these lengths|disagree"),
        (lambda x: x + np.array([0.3, 0.0, 0.0, 0.0]), "disagree by"),
        (lambda x: x - x[:1], "above 0, attachment to anchor; not a change of length"),
    ],
)
def test_lengths_that_cannot_be_are_refused(tmp_path: Path, change, words: str) -> None:
    robot = cubic_robot(tmp_path, 4)
    t, p, turn = motion(50, 4)
    lengths = change(straight_lengths(robot, p, turn))
    columns = dict(zip(quantity.measured_lengths(4), lengths.T, strict=True))
    signals = signals_of(t, turn, **columns)
    with pytest.raises(InputError, match=words):
        found = cable_lengths.find(signals, tmp_path / "signals.csv", robot)
        assert found is not None
        cable_lengths.positions(robot, "test", signals, found)


def test_a_length_that_is_missing_is_named(tmp_path: Path) -> None:
    robot = cubic_robot(tmp_path, 4)
    (tmp_path / "lengths.csv").write_text("t,length_1,length_2,length_3\n0,1,1,1\n1,1,1,1\n")
    t, _, turn = motion(50, 4)
    with pytest.raises(InputError, match=r"lengths\.csv: line 1: no column length_4"):
        cable_lengths.find(signals_of(t, turn), tmp_path / "signals.csv", robot)


def write_csv(path: Path, t: np.ndarray, columns: dict[str, np.ndarray]) -> None:
    rows = np.column_stack([t, *columns.values()])
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=",".join(["t", *columns]), comments="")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run of a robot without tracker, IMU and CAN: attitude and forces at 50 Hz, lengths at 25 Hz."""
    robot = cubic_robot(tmp_path, 4)
    t, p, turn = motion(600, 5)
    signals = signals_of(t, turn, **{name: np.full(len(t), 30.0) for name in quantity.forces(4)})
    write_csv(tmp_path / "signals.csv", t, signals.columns)
    write_csv(tmp_path / "lengths.csv", t[::2], lengths_of(t[::2], straight_lengths(robot, p, turn)[::2]).columns)
    return tmp_path


def test_a_folder_without_tracker_and_can_is_read(folder: Path) -> None:
    run = reader.read(folder)
    t, p, turn = motion(600, 5)
    assert run.notes[0].startswith("positions from attitude and cable lengths, which agree to ")
    assert run.notes[1:] == ("rate derived from attitude", "specific force derived from positions")
    here = (run.rows.t > 1.0) & (run.rows.t < 10.0)
    expected = np.column_stack([np.interp(run.rows.t[here], t, x) for x in (p + turn.apply(TARGET)).T])
    np.testing.assert_allclose(run.rows.position[here], expected, atol=2e-3)


def test_a_trackers_positions_come_before_lengths(folder: Path) -> None:
    (folder / "tracker.csv").write_text("t,x,y,z\n" + "".join(f"{0.1 * k},0.0,0.0,0.9\n" for k in range(121)))
    assert "lengths" not in " ".join(reader.read(folder).notes)


def test_without_any_position_all_ways_to_give_one_are_named(folder: Path) -> None:
    (folder / "lengths.csv").unlink()
    with pytest.raises(InputError, match=r"no column pos_x, no tracker\.csv beside it, and no length_1 \.\. length_4"):
        reader.read(folder)


def test_lengths_are_columns_of_signals_csv(tmp_path: Path) -> None:
    robot = description.load(TOP / "firmware/robots/cogiro/robot.toml")
    write_csv(tmp_path / "signals.csv", np.arange(3.0), {name: np.ones(3) for name in quantity.measured_lengths(8)})
    read = table.read(tmp_path / "signals.csv", signals_csv.columns(robot))
    assert set(read.columns) == set(quantity.measured_lengths(8))


def test_encode_writes_the_positions_as_a_tracker(folder: Path) -> None:
    signals = signals_csv.with_attitude(table.read(folder / "signals.csv", signals_csv.columns(cubic_robot(folder, 4))))
    at_rest = {"acc_z": np.full(600, 9.8)} | {name: np.zeros(600) for name in ("acc_x", "acc_y", *quantity.GYRO)}
    write_csv(folder / "signals.csv", signals.t, at_rest | {k: v for k, v in signals.columns.items() if k[:1] in "qf"})
    encode.encode(
        folder / "robot.toml", description.load(folder / "robot.toml"), folder / "signals.csv", None, folder / "run"
    )
    _, p, turn = motion(600, 5)
    tracker = tracker_csv.read(folder / "run/tracker.csv")
    np.testing.assert_allclose(tracker.stack("x", "y", "z"), (p + turn.apply(TARGET))[::2], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("encode", "{0}/robot.toml", "{0}/signals.csv", "-o", "{0}/run"),
            "takes no run without accelerometer and gyro, inertiactl",
        ),
        (("verify", "{0}"), "no can.log to run the daemon on; inertiactl encode makes a run folder from signals.csv"),
        (("sync", "{0}"), "no accelerometer or no gyro in it"),
    ],
)
def test_what_needs_more_says_so(folder: Path, inertiactl, arguments, words: str) -> None:
    (folder / "tracker.csv").write_text("t,x,y,z\n" + "".join(f"{0.1 * k},0.0,0.0,0.9\n" for k in range(121)))
    done = inertiactl(*(word.format(folder) for word in arguments))
    assert done.returncode == 2 and words in done.stderr
    assert done.stderr.count("\n") == 1
