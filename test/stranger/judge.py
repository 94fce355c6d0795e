# SPDX-License-Identifier: Apache-2.0
"""Runs the real programs on a laboratory's folder and compares what they publish with the truth."""

import json
import math
import os
import re
import select
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from laboratory import Run

NAMES = ("mass", "cog x", "cog y", "cog z", "J xx", "J yy", "J zz", "J yz", "J xz", "J xy")
TIME_LIMIT = 900.0
"""s for one command"""
CHANGE_EVENT = b"payload changed"


class Programs:
    """The programs of one build: inertiactl as a long-lived process, the daemon started for every run."""

    def __init__(self, top: Path):
        self.top = top
        self.server: subprocess.Popen[str] | None = None

    def inertiactl(self, *arguments: str | Path) -> tuple[int, str]:
        """Exit code and stderr; code -1: no answer in time, or the process died."""
        if self.server is None:
            path = f"{self.top / 'host/inertiad'}{os.pathsep}{self.top / 'build/python'}"
            env = os.environ | {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
            self.server = subprocess.Popen(
                [self.top / ".venv/bin/python", Path(__file__).with_name("commands.py")],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env, text=True,
            )  # fmt: skip
        assert self.server.stdin and self.server.stdout
        try:
            self.server.stdin.write(json.dumps([str(a) for a in arguments]) + "\n")
            self.server.stdin.flush()
            ready, _, _ = select.select([self.server.stdout], [], [], TIME_LIMIT)
            line = self.server.stdout.readline() if ready else ""
        except BrokenPipeError:
            line = ""
        if not line:
            self.server.kill()
            self.server.wait()
            self.server = None
            return -1, f"inertiactl {arguments[0]}: no answer within {TIME_LIMIT:g} s, or it died"
        answer = json.loads(line)
        return int(answer["code"]), str(answer["err"])

    def daemon(self, *arguments: str | Path) -> tuple[int, str]:
        """Exit code and stderr of the daemon."""
        try:
            done = subprocess.run(
                [self.top / "build/bin/inertiad", *map(str, arguments)],
                capture_output=True, text=True, timeout=TIME_LIMIT,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return -1, f"inertiad: no end within {TIME_LIMIT:g} s"
        return done.returncode, done.stderr


def _ten(data: dict[str, Any], part: str) -> list[float]:
    get = (lambda v: v[part]) if part else (lambda v: v)
    return [float(v) for v in (get(data["mass"]), *get(data["cog"]), *get(data["inertia_cog"]))]


def score(estimate: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    """Errors and z of the ten numbers; those that are not observable are None."""
    value, std, true = np.array(_ten(estimate, "value")), np.array(_ten(estimate, "std")), np.array(_ten(truth, ""))
    seen = np.array(_ten(estimate["observable"], ""), dtype=bool)
    error = value - true
    z = np.where(std > 0.0, error / np.where(std > 0.0, std, 1.0), 1e9 * np.sign(error))

    def worst(x: np.ndarray, part: slice) -> float | None:
        picked = np.abs(x[part])[seen[part]]
        return float(picked.max()) if len(picked) else None

    trace = float(true[4:7].sum()) / 3.0
    mass, j = worst(error, slice(0, 1)), worst(error, slice(4, 10))
    cog = float(np.linalg.norm(error[1:4][seen[1:4]])) if seen[1:4].any() else None
    return {
        "value": value.tolist(), "std": std.tolist(), "true": true.tolist(), "observable": seen.tolist(),
        "z": [float(v) if s else None for v, s in zip(z, seen, strict=True)],
        "mass_percent": None if mass is None else 100.0 * mass / true[0],
        "cog_mm": None if cog is None else 1e3 * cog,
        "inertia_percent": None if j is None else 100.0 * j / trace,
        "worst_z": worst(z, slice(0, 10)),
        "n_observable": int(seen.sum()),
        "n_covered": int((np.abs(z) <= 1.96)[seen].sum()),
    }  # fmt: skip


def _judged(path: Path, code: int, said: str, truth: dict[str, Any]) -> dict[str, Any]:
    """What came out of one program."""
    result: dict[str, Any] = {"code": code, "failed": None}
    try:
        estimate = json.loads(path.read_text(encoding="utf-8"))
        finite = all(math.isfinite(v) for v in _ten(estimate, "value") + _ten(estimate, "std"))
        if finite and estimate["mass"]["value"] > 0.0:
            result |= score(estimate, truth)
        else:
            result["failed"] = "nothing published"
    except (OSError, ValueError, KeyError, TypeError) as error:
        last = [line for line in said.strip().splitlines() if line]
        result["failed"] = last[-1] if last else f"{type(error).__name__}: {error}"
        return result
    result |= {key: estimate.get(key) for key in ("verdict", "converged", "consistent", "changes", "method")}
    result["findings"] = [f.get("name") if isinstance(f, dict) else f for f in estimate.get("findings") or []]
    result["used"] = estimate.get("samples", {}).get("used")
    if "Traceback" in said:
        result["traceback"] = said[-600:]
    others = set(estimate) - {"method", "mass", "cog", "inertia_cog", "consistent", "observable", "counters", "samples"}
    result["found"] = {
        k: estimate[k] for k in sorted(others) if isinstance(estimate[k], dict) and "value" in estimate[k]
    }
    segments = estimate.get("segments")
    if segments and "before" in truth:
        ends = (truth["before"], {k: truth[k] for k in ("mass", "cog", "inertia_cog")})
        result["segments"] = [
            score(s | {"observable": estimate["observable"]}, t) for s, t in zip(segments, ends, strict=False)
        ]
    return result


def change_times(log: Path) -> list[float]:
    """Times [s] of the payload changes in a daemon's record, by the instant of the data."""
    data = log.read_bytes() if log.exists() else b""
    times, at = [], 0
    while at + 28 <= len(data):
        name_length, size = (
            int.from_bytes(data[at + 20 : at + 24], "big"),
            int.from_bytes(data[at + 24 : at + 28], "big"),
        )
        body = data[at + 28 + name_length : at + 28 + name_length + size]
        if data[at + 28 : at + 28 + name_length].endswith(b"EVENT") and CHANGE_EVENT in body:
            times.append(1e-9 * int.from_bytes(body[16:24], "big"))
        at += 28 + name_length + size
    return times


def without_unknown_keys(programs: Programs, folder: Path) -> tuple[list[str], str]:
    """Takes out of robot.toml what this build does not know yet; the keys, and what still stops it."""
    path, gone = folder / "robot.toml", []
    for _ in range(12):
        code, said = programs.inertiactl("compile", path, "-o", folder / "robot.cfg")
        unknown = re.search(r"toml: (\S+): unknown key", said)
        if code == 0 or unknown is None:
            return gone, "" if code == 0 else said.strip()
        table, _, key = re.sub(r"^cable\[\d+\]", "cables", unknown[1]).rpartition(".")
        lines, current, kept = path.read_text().splitlines(), "", []
        for line in lines:
            current = line.strip("[]") if line.startswith("[") else current
            is_it = (current == table and line.startswith(f"{key} =")) or (not table and current == key)
            if not is_it:
                kept.append(line)
        if len(kept) == len(lines):
            return gone, said.strip()
        path.write_text("\n".join(kept) + "\n")
        gone.append(unknown[1])
    return gone, "too many unknown keys"


def judge(programs: Programs, run: Run) -> dict[str, Any]:
    """Both columns of one run. The folder's path is what the programs see; truth stays outside of it."""
    folder, recorded = run.folder, run.folder / "run"
    result: dict[str, Any] = {"scene": run.scene.name, "known": run.scene.known, "robot": run.robot.name}
    result |= {"seed": run.seed, "motion": run.scene.motion, "truth": run.truth}
    start = time.monotonic()
    gone, stopped = without_unknown_keys(programs, folder)
    result["unknown_keys"] = gone
    files = (folder / "robot.toml", folder / "signals.csv", "--tracker", folder / "tracker.csv", "-o", recorded)
    code, said = (2, stopped) if stopped else programs.inertiactl("encode", *files)
    code, said = (
        (code, said) if code else programs.inertiactl("compile", recorded / "robot.toml", "-o", folder / "robot.cfg")
    )
    if code:
        failed = {"code": code, "failed": said.strip().splitlines()[-1] if said.strip() else "encode"}
        return result | {"platform": failed, "fit": dict(failed), "seconds": time.monotonic() - start}
    log = folder / "run.lcmlog"
    code, said = programs.daemon(
        "--config", folder / "robot.cfg", "--bus", f"file:{recorded / 'can.log'}?speed=0",
        "--tracker", f"file:{recorded / 'tracker.csv'}", "--estimate", folder / "platform.json",
        "--record", log, "--lcm", "none",
    )  # fmt: skip
    result["platform"] = _judged(folder / "platform.json", code, said, run.truth)
    result["platform"]["change_times"] = change_times(log)
    log.unlink(missing_ok=True)
    now = time.monotonic()
    code, said = programs.inertiactl("fit", recorded, "--json", folder / "fit.json")
    result["fit"] = _judged(folder / "fit.json", code, said, run.truth)
    result["fit"]["seconds"] = time.monotonic() - now
    result["fit"]["said"] = [line for line in said.splitlines() if line.startswith("diagnosis")]
    result["seconds"] = time.monotonic() - start
    return result
