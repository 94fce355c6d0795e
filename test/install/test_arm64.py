# SPDX-License-Identifier: Apache-2.0
"""The .debs for arm64, unpacked beside the Debian packages they need and run by qemu-user: the same bits as here."""

import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import DIST, TOP, newest, run

from inertiad.run import lcmlog

IS_CROSS_BUILT = platform.machine() == "x86_64" and platform.freedesktop_os_release()["ID"] == "debian"
pytestmark = pytest.mark.skipif(not IS_CROSS_BUILT, reason="make dist builds for arm64 on Debian for x86-64 only")

HERE = Path(__file__).parent
SYSROOT = TOP / "build/arm64/sysroot/root"
QEMU = ("qemu-aarch64", "-L", SYSROOT)
NAMES = ("libinertiad0", "libinertiad-dev", "inertiad")
LIBRARIES = "usr/lib/aarch64-linux-gnu"


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("arm64")
    for name in NAMES:
        run("dpkg-deb", "-x", newest(f"{name}_*_arm64.deb"), folder)
    return folder


def test_packages_are_those_of_the_architecture(root):
    assert {p.name.split("_")[0] for p in DIST.glob("*_arm64.deb")} == set(NAMES)
    for name in NAMES:
        assert run("dpkg-deb", "-f", newest(f"{name}_*_arm64.deb"), "Architecture").strip() == "arm64"
    programs = [p for p in root.rglob("*") if p.is_file() and not p.is_symlink() and p.read_bytes()[:4] == b"\x7fELF"]
    assert {p.name.partition(".so")[0] for p in programs} == {"inertiad", "libinertiad", "libinertiad_lcm"}
    for path in programs:
        assert re.search(r"Machine: +AArch64$", run("readelf", "-h", path), re.M)


def test_packages_depend_on_what_they_load():
    """On the same as the native ones, which dpkg-shlibdeps reads from the packages installed here."""

    def depends(name: str, architecture: str) -> set[str]:
        return set(run("dpkg-deb", "-f", newest(f"{name}_*_{architecture}.deb"), "Depends").strip().split(", "))

    assert {"libc6", "liblcm1"} <= {part.split()[0] for part in depends("inertiad", "arm64")}
    for name in NAMES:
        named = {a: {part.split()[0] for part in depends(name, a)} for a in ("arm64", "amd64")}
        assert named["arm64"] == named["amd64"]
    assert "inertiad-tools" not in run("dpkg-deb", "-f", newest("inertiad_*_arm64.deb"))


def estimates(record: Path) -> list[bytes]:
    return [event.data for event in lcmlog.read(record) if event.channel == "INERTIAD_ESTIMATE"]


def test_daemon_gives_the_same_estimates(root, prefix, simulated, tmp_path):
    daemon = {"arm64": (*QEMU, root / "usr/bin/inertiad"), "amd64": (prefix / "bin/inertiad",)}
    for name, command in daemon.items():
        inputs = ("--bus", f"file:{simulated}/can.log", "--tracker", f"file:{simulated}/tracker.csv", "--lcm", "none")
        outputs = ("--estimate", tmp_path / f"{name}.json", "--record", tmp_path / f"{name}.lcmlog")
        run(*command, "--config", simulated / "robot.cfg", *inputs, *outputs)
    assert (tmp_path / "arm64.json").read_bytes() == (tmp_path / "amd64.json").read_bytes()
    assert len(estimates(tmp_path / "arm64.lcmlog")) > 100
    assert estimates(tmp_path / "arm64.lcmlog") == estimates(tmp_path / "amd64.lcmlog")


@pytest.mark.parametrize("static", ["", "1"])
def test_c_program_cross_built_on_the_package_gives_the_same_bits(root, prefix, simulated, tmp_path, static):
    arguments = [simulated / name for name in ("robot.cfg", "can.log", "tracker.csv")]
    settings = {
        "arm64": (root, root / LIBRARIES, "aarch64-linux-gnu-gcc"),
        "amd64": (prefix.parents[1], prefix / "lib", "cc"),
    }
    printed = {}
    for name, (system, libraries, compiler) in settings.items():
        pkg_config = {"PKG_CONFIG_LIBDIR": f"{libraries}/pkgconfig", "PKG_CONFIG_SYSROOT_DIR": str(system)}
        out = tmp_path / name
        out.mkdir()
        options = (f"OUT={out}", f"CC={compiler}", f"STATIC={static}")
        run("make", "-s", "-C", HERE / "c", *options, **pkg_config)
        emulator = QEMU if name == "arm64" else ()
        printed[name] = run(*emulator, out / "estimate", *arguments, LD_LIBRARY_PATH=str(libraries))
    assert len(printed["arm64"].split()) == 10
    assert printed["arm64"] == printed["amd64"]


def test_packed_twice_they_are_the_same_bytes(tmp_path):
    """From the same programs; `make clean` between two `make dist` shows the same for the compiler."""
    script = """
import sys
from pathlib import Path
sys.path[:0] = ["tools"]
import debs, dist
debs.build(Path(sys.argv[1]), dist.VERSION, dist.set_epoch(), dist.run, ["arm64"])
"""
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], cwd=TOP, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in NAMES:
        first = newest(f"{name}_*_arm64.deb")
        assert (tmp_path / first.name).read_bytes() == first.read_bytes()
