# SPDX-License-Identifier: Apache-2.0
"""Installations in empty places, and a recorded run for programs that use them. make test-install builds build/dist."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[2]
DIST = TOP / "build/dist"
_home = tempfile.TemporaryDirectory(prefix="inertiad-home-")
CLEAN = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "LC_ALL": "C.UTF-8", "HOME": _home.name}
"""an environment in which nothing of this source tree or of the user's Python is found"""


def run(*command: object, cwd: Path | None = None, **variables: str) -> str:
    """stdout of a command that must succeed."""
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd or "/", env={**CLEAN, **variables}, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}{done.stderr}"
    return done.stdout


def refused(*command: object, cwd: Path | None = None) -> str:
    """stderr of a command that must end with 2."""
    done = subprocess.run([str(word) for word in command], cwd=cwd or "/", env=CLEAN, capture_output=True, text=True)
    assert done.returncode == 2, done.stdout + done.stderr
    return done.stderr


def newest(pattern: str) -> Path:
    found = sorted(DIST.glob(pattern))
    assert len(found) == 1, f"build/dist/{pattern}: {len(found)} files; run make dist"
    return found[0]


@pytest.fixture(scope="session")
def wheel_bin(tmp_path_factory) -> Path:
    """bin/ of an empty environment into which the wheel was installed, and nothing else."""
    folder = tmp_path_factory.mktemp("wheel") / "venv"
    run(sys._base_executable, "-m", "venv", folder)  # type: ignore[attr-defined]
    settings = {key: value for key, value in os.environ.items() if key.startswith("PIP_") or key.endswith("_proxy")}
    run(folder / "bin/pip", "install", "-q", newest("*.whl"), **{**settings, "HOME": os.environ.get("HOME", "/")})
    return folder / "bin"


def built() -> dict[str, int]:
    """Files that make release wrote, with the times when."""
    return {str(path): path.lstat().st_mtime_ns for path in (TOP / "build/release").rglob("*")}


@pytest.fixture(scope="session")
def prefix(tmp_path_factory) -> Path:
    """PREFIX of `make install DESTDIR=...`, which asks no network and writes nothing into the source tree."""
    root = tmp_path_factory.mktemp("root")
    make = ["make", "-s", "-C", str(TOP), "install", f"DESTDIR={root}", "PREFIX=/opt/inertiad"]
    before = built()
    done = subprocess.run(["unshare", "--map-root-user", "--net", *make], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert built() == before
    return root / "opt/inertiad"


@pytest.fixture(scope="session")
def simulated(tmp_path_factory, prefix) -> Path:
    """A run of the installed example robot, with robot.cfg, made by the installed tool."""
    folder = tmp_path_factory.mktemp("run") / "run"
    tool = prefix / "bin/inertiactl"
    robot = prefix / "share/inertiad/robots/cogiro/robot.toml"
    run(tool, "simulate", robot, "--faults", "modern", "--seed", "1", "-o", folder)
    run(tool, "compile", folder / "robot.toml", "-o", folder / "robot.cfg")
    return folder
