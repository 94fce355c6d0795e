# SPDX-License-Identifier: Apache-2.0
"""The built programs carry the compiler's and linker's protections."""

import re
import subprocess
from pathlib import Path

import pytest
from conftest import TOP

DAEMON = TOP / "build/bin/inertiad"
LIBRARIES = sorted((TOP / "build/python").glob("*.so"))


def readelf(path: Path, *options: str) -> str:
    return subprocess.run(["readelf", "-W", *options, path], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("path", [DAEMON, *LIBRARIES], ids=lambda path: path.name)
def test_relocations_are_read_only_and_the_stack_is_not_executable(path):
    segments = readelf(path, "--program-headers")
    assert re.search(r"GNU_RELRO", segments)
    assert re.search(r"GNU_STACK .* RW ", segments)
    assert re.search(r"BIND_NOW|FLAGS.*NOW", readelf(path, "--dynamic"))


def test_the_daemon_is_position_independent():
    assert re.search(r"Type:\s+DYN", readelf(DAEMON, "--file-header"))
    assert "PIE" in readelf(DAEMON, "--dynamic")


@pytest.mark.parametrize("path", [DAEMON, *LIBRARIES], ids=lambda path: path.name)
def test_buffers_are_checked(path):
    symbols = readelf(path, "--dyn-syms")
    assert "__stack_chk_fail" in symbols
    assert re.search(r"__\w+_chk\b", symbols)


def test_every_object_of_ours_marks_its_branch_targets():
    """The linked program does only if every library does, too."""
    if not re.search(r"Machine:\s+Advanced Micro Devices X86-64", readelf(DAEMON, "--file-header")):
        pytest.skip("control-flow protection is tested on x86-64")
    found = subprocess.run(["gcc", "-fcf-protection=full", "-E", "-x", "c", "/dev/null"], capture_output=True)
    if found.returncode != 0:
        pytest.skip("this compiler has no -fcf-protection")
    objects = [p for folder in ("firmware", "host") for p in (TOP / "build/obj" / folder).rglob("*.o")]
    assert len(objects) > 50
    assert [p.name for p in objects if not re.search(r"IBT, SHSTK", readelf(p, "--notes"))] == []
