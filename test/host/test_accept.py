# SPDX-License-Identifier: Apache-2.0
"""The quick lines of the acceptance list, with fewer trials; `make accept` measures them all."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[2]
DESIGN = TOP / "firmware/DESIGN.md"
sys.path.insert(0, str(TOP / "test/accept"))
import accuracy  # noqa: E402
import change  # noqa: E402
import core  # noqa: E402
from verdict import FIRST, Verdict  # noqa: E402

QUICK = {
    "T1": lambda: core.t1(200),
    "T2": accuracy.t2,
    "T3": lambda: core.t3(5_000),
    "T4": lambda: core.t4(100),
    "T12 noise": lambda: core.t12_noise(0.2, 1),
    "T14": lambda: core.t14(5_000),
}


@pytest.mark.parametrize("name", [pytest.param("T2", marks=pytest.mark.slow), *list(QUICK)[1:]])
def test_quick_line_holds(name: str) -> None:
    result = QUICK[name]()
    verdicts = result if isinstance(result, list) else [result]
    assert [str(v) for v in verdicts if v.good is False] == []
    assert any(v.good for v in verdicts)


def test_only_the_filter_is_larger_than_its_limit() -> None:
    """By its states, as many as firmware/DESIGN.md, "Filter", says: theta, D and the triangle U, each number once."""
    words = re.search(r"n = 35 \+ 2 m states: (\d+) for 8 cables, ([\d.]+) KB", DESIGN.read_text(encoding="utf-8"))
    assert words is not None
    n, kilobytes = int(words[1]), words[2]
    n_bytes = 8 * (n + n + n * (n - 1) // 2)
    failed = {v.what: v.measured for v in core.t15() if v.good is False}
    assert failed == {"filter's state in use, 8 cables": f"{n_bytes} B"}
    assert kilobytes == f"{1e-3 * n_bytes:.1f}"


def test_a_load_of_300_kg_is_noticed_within_half_a_second() -> None:
    seen = change.pick_up(300.0, FIRST)
    assert seen.n_early == 0
    assert seen.delay <= 0.5


def test_a_line_says_what_does_not_apply() -> None:
    lines = [
        str(Verdict("T3", "float", 0, "windows", "<= 1e-4", "no float build", good)) for good in (None, True, False)
    ]
    assert [line.split()[0] for line in lines] == ["n/a", "PASS", "FAIL"]


def test_broken_inputs_were_tried_of_every_kind() -> None:
    found = core._endure("bad", 500, core.BAD_RATE, blind=True)
    assert found["bad_inputs"] >= 3 * 21 + 2 * 23  # NaN and +- Inf in every value, both ends of every signal


def test_an_unknown_name_is_an_error() -> None:
    command = [sys.executable, str(TOP / "test/accept/accept.py"), "T99"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("accept: T99: allowed: T1, T2")
