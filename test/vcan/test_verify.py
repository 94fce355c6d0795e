# SPDX-License-Identifier: Apache-2.0
"""verify over a real bus: replay plays a golden run to the daemon, everything it publishes is judged."""

import json
import shutil
import subprocess
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
GOLDEN = TOP / "build/vcan/golden/run"
LATENCY_MAX = 10.0  # s; an emulated guest stalls


def verify(run: Path, *options: str) -> tuple[int, dict[str, str]]:
    """Exit status and every check's line by its name."""
    command = [TOP / "build/bin/inertiactl", "verify", run, "--bus", "socketcan:vcan0", "--json", run / "verify.json"]
    command += ["--latency-max", str(LATENCY_MAX), *options]
    result = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=300)
    print(result.stdout, result.stderr)
    checks = json.loads((run / "verify.json").read_text())["checks"]
    return result.returncode, {c["name"]: f"{'PASS' if c['passed'] else 'FAIL'} {c['detail']}" for c in checks}


def test_golden_run_passes_over_vcan(tmp_path: Path):
    status, checks = verify(Path(shutil.copytree(GOLDEN, tmp_path / "run")))
    assert status == 0, checks
    n = len((GOLDEN / "can.log").read_text().splitlines())
    assert checks["frames of bus 0"].startswith(f"PASS all {n} in RAW")
    assert checks["estimates"].startswith("PASS") and "against the same core offline" in checks["estimates"]
