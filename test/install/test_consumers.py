# SPDX-License-Identifier: Apache-2.0
"""Projects in C, C++ and Python against an installation below a prefix: they build and agree."""

import re
import shutil
from pathlib import Path

import pytest
from conftest import TOP, run

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def from_c(prefix, simulated, tmp_path_factory):
    """The estimate of the C program with the shared library."""
    out = tmp_path_factory.mktemp("c")
    root = prefix.parents[1]
    pkg_config = {"PKG_CONFIG_PATH": str(prefix / "lib/pkgconfig"), "PKG_CONFIG_SYSROOT_DIR": str(root)}
    run("make", "-s", "-C", HERE / "c", f"OUT={out}", **pkg_config)
    arguments = [simulated / name for name in ("robot.cfg", "can.log", "tracker.csv")]
    shared = run(out / "estimate", *arguments, LD_LIBRARY_PATH=str(prefix / "lib"))
    (out / "estimate").unlink()
    run("make", "-s", "-C", HERE / "c", f"OUT={out}", "STATIC=1", **pkg_config)
    assert run(out / "estimate", *arguments) == shared
    return shared.split()


def test_c_program_finds_the_mass(from_c):
    assert float.fromhex(from_c[0]) == pytest.approx(161.06, abs=2)


def test_python_program_gives_the_same_bits(from_c, wheel_bin, simulated):
    arguments = [simulated / name for name in ("robot.cfg", "can.log", "tracker.csv")]
    printed = run(wheel_bin / "python", HERE / "python/estimate.py", *arguments).split()
    assert [float.fromhex(a) for a in printed] == [float.fromhex(a) for a in from_c]


def test_cmake_project_builds_and_runs(prefix, simulated, tmp_path):
    options = [f"-DCMAKE_PREFIX_PATH={prefix}", f"-DEXAMPLES={TOP}/host/eigen/examples"]
    run("cmake", "-S", HERE / "cpp", "-B", tmp_path, *options)
    run("cmake", "--build", tmp_path)
    assert "force" in run(tmp_path / "feedforward", simulated / "robot.cfg")
    assert (tmp_path / "follow").exists()


def test_every_installed_header_finds_those_it_includes(prefix, tmp_path):
    headers = sorted((prefix / "include/inertiad").rglob("*.hpp")) + sorted((prefix / "include/inertiad").rglob("*.h"))
    (tmp_path / "all.cpp").write_text("".join(f'#include "{path}"\n' for path in headers))
    assert len(headers) > 60
    run(
        "g++",
        "-std=c++17",
        "-M",
        "-MF",
        "/dev/null",
        f"-I{prefix}/include",
        "-I/usr/include/eigen3",
        tmp_path / "all.cpp",
    )


def test_another_minor_version_is_refused(prefix, tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(old CXX)\nfind_package(inertiad 0.2 QUIET)\n"
        'if(inertiad_FOUND)\n  message(FATAL_ERROR "taken")\nendif()\n'
    )
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefix}")


NOWHERE = "set(CMAKE_FIND_USE_CMAKE_SYSTEM_PATH OFF)\nset(CMAKE_FIND_USE_SYSTEM_ENVIRONMENT_PATH OFF)\n"
"""for cmake: finds neither Eigen nor liblcm, as on a machine without their packages"""


@pytest.mark.parametrize(
    ("component", "settings", "said"),
    [
        ("lcm", NOWHERE, "install liblcm-dev"),
        ("eigen", NOWHERE, "install libeigen3-dev"),
        ("core", "", "allowed: inertiad, static, eigen, lcm"),
    ],
)
def test_a_component_that_is_missing_is_named(prefix, tmp_path, component, settings, said):
    (tmp_path / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.20)\nproject(lacks CXX)\n{settings}"
        f"find_package(inertiad 0.1 COMPONENTS {component})\n"
        'message(STATUS "result ${inertiad_FOUND} ${inertiad_NOT_FOUND_MESSAGE}")\n'
    )
    printed = run("cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    assert re.search(rf"result (FALSE|0) component {component} .*{re.escape(said)}", printed)


def test_without_liblcm_the_core_is_there_and_the_messages_are_not(prefix, tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.20)\nproject(core CXX)\n{NOWHERE}find_package(inertiad 0.1 REQUIRED)\n"
        'if(NOT TARGET inertiad::inertiad OR TARGET inertiad::lcm)\n  message(FATAL_ERROR "targets")\nendif()\n'
    )
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefix}")


def test_the_soname_is_that_of_the_file(prefix):
    for name in ("libinertiad", "libinertiad_lcm"):
        link = prefix / f"lib/{name}.so"
        assert link.is_symlink()
        assert f"[{link.readlink()}]" in run("readelf", "-d", link)


def test_the_shared_core_needs_no_lcm_and_exports_only_its_own(prefix):
    library = prefix / "lib/libinertiad.so"
    assert "liblcm" not in run("readelf", "-d", library)
    names = [line.split()[-1] for line in run("nm", "-D", "--defined-only", library).splitlines()]
    assert names and all(name.startswith("ipe_") for name in names)


def test_uninstall_leaves_nothing(prefix, tmp_path):
    shutil.copytree(prefix, tmp_path / "opt/inertiad", symlinks=True)
    assert (tmp_path / "opt/inertiad/bin/inertiad").exists()
    run("make", "-s", "-C", TOP, "uninstall", f"DESTDIR={tmp_path}", "PREFIX=/opt/inertiad")
    assert [p for p in tmp_path.rglob("*") if not p.is_dir()] == []


def test_manual_pages_have_no_mistakes_and_name_every_command(prefix):
    pages = sorted((prefix / "share/man").rglob("*.gz"))
    assert {"inertiad.8.gz", "inertiactl.1.gz", "inertiactl-fit.1.gz", "inertiad-robot.toml.5.gz"} <= {
        p.name for p in pages
    }
    for path in pages:
        run("sh", "-c", f"zcat {path} | groff -man -Tutf8 -ww >/dev/null 2>{path}.err; test ! -s {path}.err")


def test_the_unit_starts_the_installed_daemon(prefix):
    unit = (prefix / "lib/systemd/system/inertiad.service").read_text()
    assert "ExecStart=/opt/inertiad/bin/inertiad " in unit
