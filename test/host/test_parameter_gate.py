# SPDX-License-Identifier: Apache-2.0
"""The gate between estimates and a control loop: no data race between the thread that offers and the one that reads."""

import os
import subprocess
from pathlib import Path

import pytest
from conftest import TOP

pytestmark = pytest.mark.slow

SOURCES = ("parameter_gate", "body", "consistency", "regressor", "wrench", "config", "cable")


def test_gate_has_no_data_race(tmp_path: Path) -> None:
    program = tmp_path / "gate"
    core = [TOP / f"firmware/core/{name}.c" for name in SOURCES]
    unity = TOP / "build/unity"
    options = ["-std=gnu11", "-O1", "-g", "-fsanitize=thread", "-DUNITY_INCLUDE_DOUBLE", "-DUNITY_OUTPUT_COLOR=0"]
    folders = [f"-I{TOP / 'firmware/core'}", f"-I{TOP / 'test/unit'}", "-isystem", unity]
    files = [TOP / "test/unit/test_parameter_gate.c", unity / "unity.c", *core]
    command = [os.environ.get("CC", "cc"), *options, *folders, *files, "-o", program, "-lm", "-lpthread"]
    subprocess.run(list(map(str, command)), check=True, timeout=300)
    # The sanitizer's shadow memory needs the addresses of a program that is not placed at random.
    done = subprocess.run(["setarch", "-R", str(program)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " 0 Failures" in done.stdout
    assert "data race" not in done.stderr
