# SPDX-License-Identifier: Apache-2.0
"""Exports of motion capture systems, and their positions beside the recording of the other sensors."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import minimal_toml

from inertiad.base import table
from inertiad.base.error import InputError
from inertiad.exchange import channels, clock_offset, convert, motion_capture
from inertiad.exchange.foreign_csv import Channel

G = 9.80665
RATE = 120.0
LOST = slice(300, 320)
"""frames in which nothing was seen"""


@dataclass
class Motion:
    """A platform that never repeats itself, level: positions [N, 3] m at t, specific force at t_imu."""

    t: np.ndarray
    position: np.ndarray
    t_imu: np.ndarray
    acc: np.ndarray


def motion(seconds: float = 30.0, first_imu: float = -3.0, last_imu: float = 3.0) -> Motion:
    rng = np.random.default_rng(4)
    f, phase = rng.uniform(0.2, 1.2, (3, 4)), rng.uniform(0.0, 6.0, (3, 4))
    t, t_imu = np.arange(0.0, seconds, 1.0 / RATE), np.arange(first_imu, seconds + last_imu, 1.0 / 200.0)
    at = lambda t, p: 0.1 * np.sin(2 * np.pi * f * t[:, None, None] + phase) * (2 * np.pi * f) ** p  # noqa: E731
    position = at(t, 0).sum(axis=2) + [0.0, 0.0, 1.5] + 3e-4 * rng.standard_normal((len(t), 3))
    return Motion(t, position, t_imu, -at(t_imu, 2).sum(axis=2) + [0.0, 0.0, G])


def _lines(rows: list[list[str]], separator: str) -> str:
    return "\r\n".join(separator.join(row) for row in rows) + "\r\n"


def _cells(values: np.ndarray, lost: str) -> list[list[str]]:
    cells = [[f"{v:.6f}" for v in row] for row in values]
    for row in cells[LOST]:
        row[:] = [lost] * len(row)
    return cells


def motive(path: Path, of: Motion, is_labelled: bool = True) -> Path:
    """Motive 3: y up, mm, a rigid body and a marker of it; without labels, as Motive 2 has it."""
    p = 1e3 * of.position[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (len(p), 1))
    label = ("Type", "Name", "ID") if is_labelled else ("", "", "")
    head = (
        "Format Version,1.23,Take Name,a,Export Frame Rate,120.000000,Rotation Type,Quaternion,Length Units,Millimeters"
    )
    rows = [
        head.split(","),
        [],
        ["", label[0], *["Rigid Body"] * 8, *["Rigid Body Marker"] * 3],
        ["", label[1], *["Load 1"] * 8, *["Load 1:Marker1"] * 3],
        ["", label[2], *["E1"] * 8, *["E2"] * 3],
        ["", "", *["Rotation"] * 4, *["Position"] * 3, "Mean Marker Error", *["Position"] * 3],
        ["Frame", "Time (Seconds)", *"XYZW", *"XYZ", "", *"XYZ"],
    ]
    body = _cells(np.column_stack([turn, p, 0 * of.t, p + 40.0]), "")
    rows += [[str(k), f"{of.t[k]:.6f}", *body[k]] for k in range(len(p))]
    path.write_text(_lines(rows, ","), encoding="utf-8-sig", newline="")
    return path


def vicon(path: Path, of: Motion, separator: str = ",") -> Path:
    """Analog devices first, then trajectories of two markers."""
    p = 1e3 * of.position
    rows = [["Devices"], ["1000"], ["", "", "Plate"], ["Frame", "Sub Frame", "Fx"], ["", "", "N"], ["1", "0", "3"], []]
    rows += [["Trajectories"], ["120"], ["", "", "Load:M1", "", "", "Load:M2", "", ""]]
    rows += [["Frame", "Sub Frame", *"XYZ", *"XYZ"], ["", "", *["mm"] * 6]]
    body = _cells(np.hstack([p, p + 40.0]), "")
    rows += [[str(k + 1), "0", *body[k]] for k in range(len(p))]
    path.write_text(_lines(rows, separator).replace("." if separator == ";" else "\0", ","), newline="")
    return path


def vicon_objects(path: Path, of: Motion) -> Path:
    """Vicon Tracker: rotation vector and place of an object."""
    rows = [["Objects"], ["120"], ["", "", "Load:Load"], ["Frame", "Sub Frame", "RX", "RY", "RZ", "TX", "TY", "TZ"]]
    rows += [["", "", *["rad"] * 3, *["mm"] * 3]]
    body = _cells(np.hstack([0 * of.position, 1e3 * of.position]), "")
    rows += [[str(k + 1), "0", *body[k]] for k in range(len(of.t))]
    path.write_text(_lines(rows, ","), newline="")
    return path


def qualisys(path: Path, of: Motion, kind: str = "3D", with_time: bool = True) -> Path:
    """TSV of markers, or of a 6D body."""
    p = 1e3 * of.position
    n = len(p)
    rows = [["NO_OF_FRAMES", str(n)], ["FREQUENCY", "120"], ["DATA_INCLUDED", kind]]
    if kind == "3D":
        rows += [["MARKER_NAMES", "load", "other"]]
        heads, body = [f"{m} {a}" for m in ("load", "other") for a in "XYZ"], np.hstack([p, p + 40.0])
    else:
        rows += [["BODY_NAMES", "load"]]
        heads = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))]
        body = np.hstack([p, 0 * p, np.ones((n, 1)), np.tile(np.eye(3).ravel(), (n, 1))])
    cells = _cells(body, "0.000000")
    if with_time:
        rows += [["Frame", "Time", *heads], *([str(k + 1), f"{of.t[k]:.6f}", *cells[k]] for k in range(n))]
    else:
        rows += cells
    path.write_text(_lines(rows, "\t"), newline="")
    return path


EXPORTS = {
    "motive": ("a.csv", motive, "y"),
    "motive2": ("a.csv", lambda path, of: motive(path, of, False), "y"),
    "vicon": ("a.csv", vicon, "z"),
    "vicon-german": ("a.csv", lambda path, of: vicon(path, of, ";"), "z"),
    "vicon-objects": ("a.csv", vicon_objects, "z"),
    "qualisys": ("a.tsv", qualisys, "z"),
    "qualisys-bare": ("a.tsv", lambda path, of: qualisys(path, of, "3D", False), "z"),
    "qualisys-6d": ("a.tsv", lambda path, of: qualisys(path, of, "6D"), "z"),
}


@pytest.mark.parametrize("kind", EXPORTS)
def test_positions_of_the_first_body_are_proposed_without_the_frames_in_which_it_was_lost(kind, tmp_path: Path):
    name, write, up = EXPORTS[kind]
    of = motion(5.0)
    path = write(tmp_path / name, of)
    assert convert.is_foreign(path)
    found = channels.summary(path)
    mapped = channels.mapped(path, found, channels.proposed_mapping(path, found))
    assert sorted(mapped) == ["pos_x", "pos_y", "pos_z"]
    there = np.delete(np.arange(len(of.t)), LOST)
    true = of.position[:, [0, 2, 1]] * [1.0, 1.0, -1.0] if up == "y" else of.position  # axes as the file has them
    for axis, channel in enumerate(mapped.values()):
        np.testing.assert_allclose(channel.t, of.t[there], atol=1e-6)
        np.testing.assert_allclose(channel.value, true[there, axis], atol=1e-8)


def other_sensors(path: Path, of: Motion, start: float) -> Path:
    """Accelerations and forces of the same motion by another clock, the tracker's 0 at start."""
    heads = ["t", *(f"acc_{a} [m/s2]" for a in "xyz"), *(f"gyro_{a} [rad/s]" for a in "xyz")]
    heads += [f"quat_{a}" for a in "wxyz"] + [f"force_{k} [N]" for k in range(1, 5)]
    n = len(of.t_imu)
    rows = np.column_stack(
        [of.t_imu + start, of.acc, np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 4), 50.0)]
    )
    path.write_text(
        ",".join(heads) + "\n" + "\n".join(",".join([f"{row[0]:.6f}", *(f"{v:.9g}" for v in row[1:])]) for row in rows)
    )
    return path


@pytest.mark.parametrize("kind", ["motive", "vicon", "qualisys"])
def test_positions_come_onto_the_other_clock_with_z_up(kind, tmp_path: Path, inertiactl):
    name, write, up = EXPORTS[kind]
    of, start = motion(first_imu=2.0), 1.7e9 + 12.345
    path, log = write(tmp_path / name, of), other_sensors(tmp_path / "log.csv", of, start)
    (tmp_path / "robot.toml").write_text(minimal_toml(4))
    done = inertiactl("import", log, "--tracker", path, "--robot", tmp_path / "robot.toml", "-o", tmp_path / "run")
    found = table.read(tmp_path / "run/tracker.csv", ["t", "x", "y", "z"])
    assert abs(found.t[-1] - of.t[-1] - start) < 0.005
    kept = np.delete(np.arange(len(of.t)), LOST)[-len(found.t) :]
    np.testing.assert_allclose(found.stack("x", "y", "z"), of.position[kept], atol=1e-6)
    assert ("y points up there" in done.stderr) == (up == "y")
    assert (
        f"begins its clock at t = {start:.0f}"[:-1] in done.stderr and "lie outside of log.csv in time" in done.stderr
    )
    written = (tmp_path / "run/log.map.toml").read_text()
    assert ("scale = -1.0" in written) == (up == "y") and f"--tracker {name}" in written


def test_start_that_is_given_is_taken_and_the_mapping_gives_the_same(tmp_path: Path, inertiactl):
    of = motion(8.0)
    path, log = vicon(tmp_path / "a.csv", of), other_sensors(tmp_path / "log.csv", of, 10.0)
    inertiactl("import", log, "--tracker", path, "--tracker-start", "10.25", "-o", tmp_path / "run")
    first = table.read(tmp_path / "run/tracker.csv", ["t", "x", "y", "z"])
    assert first.t[0] == 10.25
    again = ["--map", tmp_path / "run/log.map.toml", "-o", tmp_path / "again"]
    inertiactl("import", log, "--tracker", path, "--tracker-start", "10.25", *again)
    assert (tmp_path / "again/tracker.csv").read_bytes() == (tmp_path / "run/tracker.csv").read_bytes()


def test_motion_that_was_not_common_or_repeats_is_refused_with_the_remedy(tmp_path: Path, inertiactl):
    of, other = motion(12.0), motion(12.0)
    other.position[:] = 1.0 + 0.05 * np.sin(np.outer(other.t, [1.0, 2.0, 3.0]))
    log = other_sensors(tmp_path / "log.csv", of, 5.0)
    done = inertiactl("import", log, "--tracker", vicon(tmp_path / "a.csv", other), "-o", tmp_path / "run")
    assert done.returncode == 2
    assert "is not found" in done.stderr and "--tracker-start S" in done.stderr
    period = motion(24.0)
    period.acc[:] = G + np.sin(2 * np.pi * period.t_imu)[:, None] * [0.0, 0.0, 1.0]
    period.position[:] = -np.sin(2 * np.pi * period.t)[:, None] * [0.0, 0.0, 1.0 / (2 * np.pi) ** 2]
    log = other_sensors(tmp_path / "log.csv", period, 5.0)
    done = inertiactl("import", log, "--tracker", vicon(tmp_path / "b.csv", period), "-o", tmp_path / "run")
    assert done.returncode == 2
    assert "as it repeats" in done.stderr and "--tracker-start S" in done.stderr


def test_start_without_a_tracker_and_one_far_off_are_refused(tmp_path: Path, inertiactl):
    of = motion(6.0)
    log, path = other_sensors(tmp_path / "log.csv", of, 5.0), vicon(tmp_path / "a.csv", of)
    assert "without --tracker" in inertiactl("import", log, "--tracker-start", "1", "-o", tmp_path / "r").stderr
    far = ["--tracker", path, "--tracker-start", "900", "-o", tmp_path / "r"]
    assert "check --tracker-start" in inertiactl("import", log, *far).stderr


def test_offset_is_found_where_either_has_gaps_and_they_overlap_in_part():
    of = motion(40.0, first_imu=15.0, last_imu=20.0)
    kept = (of.t < 24.0) | (of.t > 26.0)
    found = clock_offset.find(of.t_imu + 7.0, of.acc, of.t[kept], of.position[kept])
    assert abs(found.start - 7.0) < 0.005 and found.up == "z" and not found.is_ambiguous


def test_robots_signals_say_what_a_can_logs_channels_are():
    t = np.arange(3.0)
    found = [channels.Found(Channel(name, "", t, t), None) for name in ("A.odd", "A.acc_x")]
    bound = channels.by_signals(found, {"A.odd": "acc_x"})
    assert [item.quantity for item in bound] == ["acc_x", None]
    assert channels.by_signals(found, {"B.odd": "acc_x"}) is found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Format Version,1.23\n1,2,3\n", "begins with Frame,Time"),
        ("Format Version,1.23\nFrame,Time (Seconds),X,Y,Z\n0,0,1,2,3\n", "types, names and kinds"),
        ("Trajectories\nx\n,,M\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,1,2,3\n", "Vicon's section"),
        ("Trajectories\n0\n,,M\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,1,2,3\n", "rate 0"),
        ("Trajectories\n100\n,,M\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,1,2,oops\n2,0,1,2,3\n", 'line 6: "oops"'),
        ("Trajectories\n100\n,,M\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n2,0,1,2,3\n1,0,1,2,3\n", "does not increase"),
        ("NO_OF_FRAMES\t2\nFREQUENCY\t0\n1\t2\t3\n", "without FREQUENCY"),
        ("NO_OF_FRAMES\t2\nFREQUENCY\t100\n1\t2\t3\n", "without MARKER_NAMES"),
        ("NO_OF_FRAMES\t2\nFREQUENCY\t100\nMARKER_NAMES\ta\n0\t0\t0\n0\t0\t0\n", "without a position"),
    ],
)
def test_damaged_export_is_refused_with_its_place(text, said, tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        motion_capture.read(path)


def test_cut_anywhere_gives_channels_or_one_message(tmp_path: Path):
    whole = [write(tmp_path / name, motion(1.0)).read_bytes() for name, write, _ in EXPORTS.values()]
    path = tmp_path / "cut.csv"
    for data in whole:
        for n in range(10, 900, 37):
            path.write_bytes(data[:n])
            try:
                channels.summary(path)
            except InputError as error:
                assert "cut.csv" in str(error)
