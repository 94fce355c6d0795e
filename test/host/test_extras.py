# SPDX-License-Identifier: Apache-2.0
"""Commands without the packages of the extras: most work, the others name what is missing."""

import subprocess
import sys
import tomllib

import pytest
from conftest import TOP

from inertiad.base.extras import EXTRA

BLOCKED = """
import sys
from inertiad.base.extras import EXTRA
sys.modules.update(dict.fromkeys(EXTRA))  # an import of any of them fails
from inertiad.cli.main import main
main()
"""


def said_without_extras(*arguments: str) -> str:
    """stderr of inertiactl in an installation without extras; it must end with 2."""
    command = [sys.executable, "-c", BLOCKED, *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    return done.stderr


def test_every_package_of_an_extra_is_known():
    """By the name of its distribution, with which every module of it begins but mcap-protobuf-support's."""
    project = tomllib.loads((TOP / "host/inertiad/pyproject.toml").read_text(encoding="utf-8"))["project"]
    listed = {
        requirement.split("==")[0].replace("-", "_").removesuffix("_support"): extra
        for extra in ("plot", "optimise", "export")
        for requirement in project["optional-dependencies"][extra]
    }
    assert listed == EXTRA


@pytest.mark.parametrize("command", ["fit", "sync", "verify", "compile", "simulate", "encode", "calibrate"])
def test_commands_that_need_no_extra_get_to_their_input(command, tmp_path):
    inputs = [str(tmp_path / "absent")] * (2 if command in ("encode", "calibrate") else 1)
    output = [] if command in ("fit", "sync", "verify") else ["-o", str(tmp_path / "output")]
    said = said_without_extras(command, *inputs, *output)
    assert str(tmp_path) in said and "package" not in said


@pytest.mark.parametrize("command", [("control", "absent", "-o", "x"), ("fit", "absent", "--picture", "x.html")])
def test_commands_that_draw_name_the_package_and_its_remedy(command):
    said = said_without_extras(*command)
    assert "needs the Python package" in said
    assert "make setup" in said
