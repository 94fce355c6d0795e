# SPDX-License-Identifier: Apache-2.0
"""The type stubs that mypy reads are those of the bindings as built; `make stubs` writes them."""

import sys

import pytest
from conftest import TOP

sys.path[:0] = [str(TOP / "tools")]
import stubs  # noqa: E402


@pytest.mark.parametrize("module", stubs.MODULES)
def test_stub_is_that_of_the_binding(module: str):
    assert (stubs.TYPINGS / f"{module}.pyi").read_text(encoding="utf-8") == stubs.stub(module)
