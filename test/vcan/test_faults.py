# SPDX-License-Identifier: Apache-2.0
"""Every fault of scenarios.py: the daemon lives, its counters add up, its estimate is within 3 sigma of the truth.

faults.py runs them all at once and leaves the table in build/vcan/faults.txt; here is one test per row.
"""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

TOP = Path(__file__).resolve().parents[2]
FAULTS = [s["name"] for s in json.loads((TOP / "build/vcan/faults/scenarios.json").read_text())]


@pytest.fixture(scope="module")
def rows() -> dict[str, Any]:
    subprocess.run(["python3", "-S", TOP / "test/vcan/faults.py"], check=False, timeout=1500)
    return {row["fault"]: row for row in json.loads((TOP / "build/vcan/faults.json").read_text())}


@pytest.mark.parametrize("fault", FAULTS)
def test_daemon_survives(fault: str, rows: dict[str, Any]):
    assert rows[fault]["wrong"] == [], rows[fault]
