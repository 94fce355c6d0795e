# SPDX-License-Identifier: Apache-2.0
"""The fuzzers' corpora are those that their generator writes, beside what libFuzzer found."""

import runpy

from conftest import TOP

FUZZ = TOP / "test/fuzz"


def test_corpora_are_those_of_the_generator(tmp_path):
    runpy.run_path(str(FUZZ / "seeds.py"))["write"](tmp_path)
    wanted = {p.relative_to(tmp_path): p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    there = {p.relative_to(FUZZ / "corpus"): p.read_bytes() for p in (FUZZ / "corpus").rglob("*") if p.is_file()}
    assert wanted == {path: data for path, data in there.items() if not path.name.startswith("found_")}
