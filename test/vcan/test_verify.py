# SPDX-License-Identifier: Apache-2.0
"""verify over a real bus: replay plays a golden run to the daemon, everything it publishes is judged.

All runs are judged in one process: in an emulated guest its imports take longer than a run.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[2]
GOLDEN = TOP / "build/vcan/golden"
LATENCY_MAX = "10"  # s; an emulated guest stalls
LOST = 77  # frame

VERIFY_EACH = """
import json, sys
from inertiad.cli import main
for arguments in json.loads(sys.argv[1]):
    status = main.app(["verify", *arguments], standalone_mode=False)
    print("exit", status or 0, flush=True)
"""

# A daemon on vcan1, to which everything of vcan0 is passed on but one frame.
LOSSY = """#!/usr/bin/env bash
coproc BRIDGE {{ exec /usr/bin/python3 -S {bridge} 2>/dev/null; }}
read -r -u "${{BRIDGE[0]}}" # it listens
exec {daemon} "${{@/vcan0/vcan1}}"
"""
BRIDGE = """
import os, socket
source, sink = (socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) for _ in "01")
for link, name in ((source, "vcan0"), (sink, "vcan1")):
    link.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    link.bind((name,))
source.settimeout(1.0)
daemon, n = os.getppid(), 0
print("listening", flush=True)
while os.getppid() == daemon:
    try:
        frame = source.recv(72)
    except TimeoutError:
        continue
    n += 1
    if n != {lost}:
        sink.send(frame)
"""


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory) -> dict[str, tuple[int, dict[str, str]]]:
    """Exit status and every check's line by its name, of the golden run and of two that are not as they should be."""
    folder: Path = tmp_path_factory.mktemp("verify")
    lossy, bridge = folder / "lossy", folder / "bridge.py"
    bridge.write_text(BRIDGE.format(lost=LOST))
    lossy.write_text(LOSSY.format(bridge=bridge, daemon=TOP / "build/bin/inertiad"))
    lossy.chmod(0o755)
    options = {"golden": [], "lost": ["--daemon", lossy], "changed": ["--config", GOLDEN / "changed.cfg"]}
    each = []
    for name, more in options.items():
        run = shutil.copytree(GOLDEN / "run", folder / name)
        each.append(
            [run, "--bus", "socketcan:vcan0", "--json", run / "verify.json", "--latency-max", LATENCY_MAX, *more]
        )
    arguments = json.dumps([[str(a) for a in one] for one in each])
    command = [sys.executable, "-c", VERIFY_EACH, arguments]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # as inertiactl: waiting threads stall a guest
    result = subprocess.run(command, capture_output=True, text=True, timeout=600, env=environment)
    print(result.stdout, result.stderr)
    status = [int(line.split()[1]) for line in result.stdout.splitlines() if line.startswith("exit ")]
    found = {}
    for name, code in zip(options, status, strict=True):
        checks = json.loads((folder / name / "verify.json").read_text())["checks"]
        found[name] = code, {c["name"]: f"{'PASS' if c['passed'] else 'FAIL'} {c['detail']}" for c in checks}
    return found


def test_golden_run_passes_over_vcan(verdicts):
    status, checks = verdicts["golden"]
    assert status == 0, checks
    n = len((GOLDEN / "run/can.log").read_text().splitlines())
    assert checks["frames of bus 0"].startswith(f"PASS all {n} in RAW")
    assert checks["estimates"].startswith("PASS") and "against the same core offline" in checks["estimates"]


def test_frame_lost_on_the_bus_fails_and_is_named(verdicts):
    status, checks = verdicts["lost"]
    assert status == 1
    assert checks["frames of bus 0"].startswith(f"FAIL frame {LOST} was "), checks
    assert checks["frames add up"].startswith("FAIL") and checks["nothing lost or refused"].startswith("FAIL")
    assert checks["daemon"].startswith("PASS")


def test_changed_coefficient_in_the_daemon_fails(verdicts):
    status, checks = verdicts["changed"]
    assert status == 1
    assert checks["configuration"].startswith("FAIL") and checks["estimates"].startswith("FAIL")
    assert checks["frames of bus 0"].startswith("PASS")
