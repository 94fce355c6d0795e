# SPDX-License-Identifier: Apache-2.0
"""The C++ layer as a controller uses it: its examples run, and give what independent mathematics gives."""

import subprocess
from pathlib import Path

import lcm
import numpy as np

from inertiad_lcm import estimate_t

TOP = Path(__file__).resolve().parents[2]
THETA = np.array([161.0, -0.2, -12.4, -19.0, 98.2, 91.1, 32.6, 2.7, -0.1, -0.4])


def _wrench(theta: np.ndarray, s: np.ndarray, w: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Newton and Euler about P."""
    m, h = theta[0], theta[1:4]
    xx, yy, zz, yz, xz, xy = theta[4:]
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    force = m * s + np.cross(alpha, h) + np.cross(w, np.cross(w, h))
    return np.r_[force, np.cross(h, s) + J @ alpha + np.cross(w, J @ w)]


def test_follow_feeds_forward_what_newton_and_euler_say(tmp_path: Path) -> None:
    log = lcm.EventLog(str(tmp_path / "run.lcmlog"), "w")
    for k in (1.0, 2.0):
        message = estimate_t()
        message.theta, message.covariance = (k * THETA).tolist(), np.eye(10).tolist()
        log.write_event(int(k), "INERTIAD_ESTIMATE", message.encode())
    log.close()
    program = [str(TOP / "build/bin/examples/follow"), f"file://{tmp_path}/run.lcmlog?speed=0", "9.81"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=20)
    assert done.returncode == 0, done.stderr
    lines = np.loadtxt(done.stdout.splitlines())
    expected = _wrench(THETA, np.array([0.5, 0.0, 9.81]), np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.2, 0.0]))
    np.testing.assert_allclose(lines, [expected, 2.0 * expected], atol=1e-5)


def test_follow_names_a_wrong_url() -> None:
    done = subprocess.run(
        [str(TOP / "build/bin/examples/follow"), "nonsense://"], capture_output=True, text=True, timeout=20
    )
    assert done.returncode == 2
    assert "nonsense://" in done.stderr
