# SPDX-License-Identifier: Apache-2.0
"""The C++ layer as a controller uses it: its examples run, and give what independent mathematics gives."""

import subprocess
import sys
import tomllib
from pathlib import Path

import lcm
import numpy as np
import pytest
from conftest import COGIRO, TOP

from inertiad_lcm import estimate_t

THETA = np.array([161.0, -0.2, -12.4, -19.0, 98.2, 91.1, 32.6, 2.7, -0.1, -0.4])


def _wrench(theta: np.ndarray, s: np.ndarray, w: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Newton and Euler about P."""
    m, h = theta[0], theta[1:4]
    xx, yy, zz, yz, xz, xy = theta[4:]
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    force = m * s + np.cross(alpha, h) + np.cross(w, np.cross(w, h))
    return np.r_[force, np.cross(h, s) + J @ alpha + np.cross(w, J @ w)]


def _nominal() -> np.ndarray:
    """Ten parameters about P of CoGiRo's nominal body: its inertia moved by Steiner's theorem."""
    body = tomllib.loads((COGIRO / "robot.toml").read_text())["nominal"]
    m, c = body["mass"], np.array(body["cog"])
    moved = m * (c @ c * np.eye(3) - np.outer(c, c))
    J = np.array(body["inertia_cog"]) + moved[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    return np.r_[m, m * c, J]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("follow") / "robot.cfg"
    command = [sys.executable, "-m", "inertiad", "compile", COGIRO / "robot.toml", "-o", path]
    subprocess.run(command, check=True, capture_output=True)
    return path


def _follow(url: str, config: Path) -> subprocess.CompletedProcess[str]:
    program = [str(TOP / "build/bin/examples/follow"), url, str(config)]
    return subprocess.run(program, capture_output=True, text=True, timeout=60)


def _estimate(k: int, theta: np.ndarray) -> estimate_t:
    """The k-th of one each second, known to 0.1 % or so."""
    message = estimate_t()
    message.sequence, message.t_ns, message.verdict = k, (k + 1) * 10**9, estimate_t.GOOD
    message.theta, message.covariance = theta.tolist(), np.diag(np.full(10, 1e-3)).tolist()
    message.observable = [True] * 10
    return message


def test_follow_feeds_forward_the_nominal_body_and_then_the_estimated_one(tmp_path: Path, config: Path) -> None:
    log = lcm.EventLog(str(tmp_path / "run.lcmlog"), "w")
    for k in range(8):
        log.write_event(k, "INERTIAD_ESTIMATE", _estimate(k, THETA).encode())
    worse = _estimate(8, 1.2 * THETA)
    worse.verdict = estimate_t.STOP
    log.write_event(8, "INERTIAD_ESTIMATE", worse.encode())
    log.close()
    done = _follow(f"file://{tmp_path}/run.lcmlog?speed=0", config)
    assert done.returncode == 0, done.stderr
    lines = np.loadtxt(done.stdout.splitlines())
    motion = np.array([0.5, 0.0, 9.81]), np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.2, 0.0])
    nominal = _nominal()
    np.testing.assert_allclose(lines[0], _wrench(nominal, *motion), atol=1e-5)
    np.testing.assert_allclose(lines[-2:], 2 * [_wrench(THETA, *motion)], atol=1e-5)
    assert "not used: acceptable; more of them in a row are needed" in done.stderr
    assert "not used: its verdict is worse than allowed" in done.stderr


def test_follow_names_a_wrong_url(config: Path) -> None:
    done = _follow("nonsense://", config)
    assert done.returncode == 2
    assert "nonsense://" in done.stderr
