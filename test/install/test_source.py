# SPDX-License-Identifier: Apache-2.0
"""The source archive, unpacked where no git repository is."""

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from conftest import TOP, newest

BUILT = (
    *("build/release/dependencies", "build/release/dependencies.txt", "build/release/python", "build/python"),
    "build/lib",
)
"""of make release in this tree: building it again would take minutes and show nothing of the archive"""


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("source")
    with tarfile.open(newest("*.tar.gz")) as archive:
        archive.extractall(folder, filter="data")
    return next(folder.iterdir())


def run(unpacked: Path, *command: object) -> subprocess.CompletedProcess[str]:
    """A command in the archive, which no repository around it and no variable of the caller helps."""
    environment = {key: value for key, value in os.environ.items() if key != "SOURCE_DATE_EPOCH"}
    return subprocess.run([*map(str, command)], cwd=unpacked, env=environment, capture_output=True, text=True)


def test_time_stamps_are_those_of_the_commit(unpacked):
    committed = (unpacked / ".date").read_text().strip()
    assert committed in run(TOP, "git", "log", "--format=%ct").stdout.split()
    script = "import sys; sys.path[:0] = ['tools']; import dist; print(dist.set_epoch())"
    done = run(unpacked, sys.executable, "-c", script)
    assert (done.returncode, done.stdout.strip()) == (0, committed), done.stderr


def test_the_tree_that_install_copies_is_built(unpacked):
    for name in BUILT:
        (unpacked / name).parent.mkdir(parents=True, exist_ok=True)
        (unpacked / name).symlink_to(TOP / name)
    done = run(unpacked, sys.executable, "tools/dist.py", "tree", "tree")
    assert done.returncode == 0, done.stderr
    assert (unpacked / "tree/inertiad/__init__.py").exists() and (unpacked / "tree/inertiad_lcm/__init__.py").exists()


def test_install_before_release_says_what_to_do(unpacked, tmp_path):
    (unpacked / ".venv").symlink_to(TOP / ".venv")
    done = run(unpacked, "make", "install", f"DESTDIR={tmp_path}", "PREFIX=/usr")
    assert done.returncode == 2 and "run make release first" in done.stderr
    assert list(tmp_path.iterdir()) == []
