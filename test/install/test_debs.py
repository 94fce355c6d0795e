# SPDX-License-Identifier: Apache-2.0
"""The .debs in an empty root: installed, run, upgraded beside a checkpoint, removed. dpkg and lintian judge them."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import CLEAN, DIST, newest, run

ARCHITECTURE = run("dpkg", "--print-architecture").strip()
NAMES = ("libinertiad0", "libinertiad-dev", "inertiad", "inertiad-tools")


def dpkg(root: Path, *arguments: object) -> str:
    """dpkg on a root that is empty but for its own records: what the packages depend on is taken as there."""
    options = ["--force-depends", "--force-not-root", "--force-script-chrootless", "--force-bad-path"]
    command = ["dpkg", f"--root={root}", f"--log={root}/dpkg.log", *options, *map(str, arguments)]
    done = subprocess.run(command, env=CLEAN, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("debian")
    for name in ("updates", "info"):
        (folder / "var/lib/dpkg" / name).mkdir(parents=True)
    for name in ("status", "available"):
        (folder / "var/lib/dpkg" / name).touch()
    dpkg(folder, "--install", *(newest(f"{name}_*_{ARCHITECTURE}.deb") for name in NAMES))
    return folder


def test_installed_programs_identify_a_run(root, simulated, tmp_path):
    run(root / "usr/bin/inertiactl", "compile", simulated / "robot.toml", "-o", tmp_path / "robot.cfg")
    run(root / "usr/bin/inertiactl", "export", simulated, "--to", "fmu", "-o", tmp_path / "robot.fmu")
    checkpoint, estimate = tmp_path / "checkpoint", tmp_path / "estimate.json"
    command = [root / "usr/bin/inertiad", "--config", tmp_path / "robot.cfg", "--lcm", "none"]
    command += ["--bus", f"file:{simulated}/can.log", "--tracker", f"file:{simulated}/tracker.csv"]
    run(*command, "--checkpoint", checkpoint, "--estimate", estimate)
    truth = json.loads((simulated / "truth.json").read_text())
    assert json.loads(estimate.read_text())["mass"]["value"] == pytest.approx(truth["mass"], abs=2)

    dpkg(root, "--install", newest(f"inertiad_*_{ARCHITECTURE}.deb"))  # an upgrade, with the checkpoint in place
    run(*command, "--checkpoint", checkpoint, "--estimate", estimate)


def test_service_files_lie_where_systemd_looks(root):
    for name in ("systemd/system/inertiad.service", "udev/rules.d/70-inertiad-can.rules", "tmpfiles.d/inertiad.conf"):
        assert (root / "usr/lib" / name).exists()
    assert "ExecStart=/usr/bin/inertiad " in (root / "usr/lib/systemd/system/inertiad.service").read_text()


def test_removed_packages_leave_nothing(root, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(root, other, symlinks=True)
    dpkg(other, "--remove", *reversed(NAMES))
    assert [p for p in (other / "usr").rglob("*") if not p.is_dir()] == []


def test_lintian_finds_nothing():
    if shutil.which("lintian") is None:
        pytest.skip("lintian is not installed; tools/setup dist")
    done = subprocess.run(["lintian", "--allow-root", *DIST.glob("*.deb")], capture_output=True, text=True, env=CLEAN)
    assert done.stdout == ""
    assert done.returncode == 0, done.stderr


def test_checksums_are_those_of_the_files():
    run("sha256sum", "--quiet", "-c", "SHA256SUMS", cwd=DIST)


def test_bill_of_materials_names_every_bundled_package(root):
    document = json.loads(newest("*.cdx.json").read_text())
    named = {part["name"].lower().replace("_", "-") for part in document["components"]}
    bundled = {p.name.split("-")[0].lower().replace("_", "-") for p in (root / "usr/lib/inertiad").glob("*.dist-info")}
    assert bundled - {"inertiad"} <= named
    assert {"eigen", "nanobind", "robin-map", "liblcm", "glib"} <= named
    assert [part["name"] for part in document["components"] if not part["version"][:1].isdigit()] == []
    assert (DIST / "NOTICE").stat().st_size > 2000
