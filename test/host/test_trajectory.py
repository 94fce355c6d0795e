# SPDX-License-Identifier: Apache-2.0
"""Trajectories: derivatives against finite differences, limits of the tracker, poses met."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inertiad.base.error import InputError
from inertiad.model import trajectory


def spline(path, attitude="rpy"):
    """A smooth motion in all six coordinates, as sparse poses in a CSV."""
    t = np.arange(0.0, 6.0, 0.5)
    p = np.column_stack([np.sin(t), np.cos(1.3 * t), 2.0 + 0.3 * np.sin(2.0 * t)])
    rpy = np.column_stack([0.4 * np.sin(1.5 * t), 0.3 * np.cos(t), 0.8 * t])
    if attitude == "rpy":
        np.savetxt(path, np.column_stack([t, p, rpy]), delimiter=",", header="t,x,y,z,roll,pitch,yaw", comments="")
    else:
        q = Rotation.from_euler("ZYX", rpy[:, ::-1]).as_quat(scalar_first=True)
        q[::7] *= -1.0  # the same attitude
        np.savetxt(path, np.column_stack([t, p, q]), delimiter=",", header="t,x,y,z,q_w,q_x,q_y,q_z", comments="")
    return trajectory.read(path), t, p, rpy


@pytest.fixture(params=["paper", "rpy", "quaternion"])
def moving(request, tmp_path):
    return trajectory.paper() if request.param == "paper" else spline(tmp_path / "pose.csv", request.param)[0]


def test_at_derivatives_match_finite_differences(moving):
    h = 1e-5
    t = np.linspace(0.3, moving.duration - 0.3, 200)
    before, now, after = moving.at(t - h), moving.at(t), moving.at(t + h)
    assert np.abs(now.omega).max() > 0.3
    assert np.allclose((after.p - before.p) / (2 * h), now.v, atol=1e-6)
    assert np.allclose((after.v - before.v) / (2 * h), now.a, atol=1e-5)
    assert np.allclose((after.omega - before.omega) / (2 * h), now.alpha, atol=1e-5)
    turn = np.einsum("nji,njk->nik", now.R, (after.R - before.R) / (2 * h))
    assert np.allclose(np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1), now.omega, atol=1e-6)


def test_paper_starts_and_ends_in_the_published_poses_at_rest():
    paper = trajectory.paper()
    motion = paper.at(np.array([0.2, 0.5 + trajectory.MOVE_TIME + 0.25]))
    assert np.allclose(motion.p, [[0.01, -0.01, 1.55], [1.01, 1.49, 2.55]])
    rpy = Rotation.from_matrix(motion.R).as_euler("ZYX", degrees=True)[:, ::-1]
    assert np.allclose(rpy, [[-18.80, 24.87, -30.74], [21.20, -10.13, 29.26]])
    assert np.abs(motion.v).max() < 1e-12
    assert np.abs(motion.alpha).max() < 1e-10


def test_paper_stays_within_the_tracker():
    paper = trajectory.paper()
    motion = paper.at(np.arange(0.0, paper.duration, 0.002))
    assert np.linalg.norm(motion.v, axis=1).max() < 4.0
    assert np.linalg.norm(motion.a, axis=1).max() < 2.0


@pytest.mark.parametrize("attitude", ["rpy", "quaternion"])
def test_read_runs_through_the_poses(tmp_path, attitude):
    path, t, p, rpy = spline(tmp_path / "pose.csv", attitude)
    motion = path.at(t)
    assert np.allclose(motion.p, p, atol=1e-12)
    assert np.allclose(motion.R, Rotation.from_euler("ZYX", rpy[:, ::-1]).as_matrix(), atol=1e-12)


def test_hold_does_not_move():
    motion = trajectory.named("hold", "1,2,3,0.1,0.2,0.3", 2.0).at(np.linspace(0, 2, 5))
    assert np.all(motion.p == [1.0, 2.0, 3.0])
    assert not np.any([motion.v, motion.a, motion.omega, motion.alpha])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y,z,roll,pitch\n", "no data"),
        ("t,x,y,z,roll,pitch\n0,0,0,0,0,0\n", "line 1: no column yaw"),
        ("t,x,y,z,roll,pitch,yaw\n0,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", "2 poses: allowed: 6 or more"),
        ("t,x,y,z,q_w,q_x,q_y,q_z\n" + "".join(f"{i},0,0,0,2,0,0,0\n" for i in range(6)), "pose 1: |q| = 2"),
    ],
)
def test_read_bad_file_is_one_line(tmp_path, text, message):
    path = tmp_path / "pose.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        trajectory.read(path)
    assert message in str(caught.value)


@pytest.mark.parametrize(("name", "pose"), [("fast", "0"), ("hold", "1,2"), ("hold", "1,2,3,4,5,nan"), ("hold", "a")])
def test_named_refuses_the_rest(name, pose):
    with pytest.raises(InputError, match="allowed"):
        trajectory.named(name, pose, 1.0)
