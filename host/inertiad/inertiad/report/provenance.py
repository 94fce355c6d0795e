# SPDX-License-Identifier: Apache-2.0
"""Provenance of a report: files with their checksums, versions, the command."""

import datetime
import hashlib
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Final

from inertiad.base.installation import SOURCE_TREE
from inertiad.report.figure import Table
from inertiad.report.report_data import Facts

FILES: Final = ("robot.toml", "can.log", "tracker.csv", "run.lcmlog", "truth.json", "estimate.json", "verify.json")
PACKAGES: Final = ("numpy", "scipy", "plotly", "matplotlib", "lcm")


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path, *(f for f in (path.with_name("robot.toml"), path.with_name("tracker.csv")) if f.exists())]
    return [path / name for name in FILES if (path / name).exists()] + sorted(path.glob("*.dbc"))


def files(facts: Facts) -> Table:
    """Every file that was read or could have been."""
    rows = [
        [str(file), f"{file.stat().st_size:,}".replace(",", " "), _checksum(file)]
        for run in facts.runs
        for file in _files(run.path)
    ]
    return Table(["file", "bytes", "sha256"], rows)


def revision() -> str:
    """Of the source tree, or "" outside of one."""
    if SOURCE_TREE is None:
        return ""
    command = ["git", "-C", str(SOURCE_TREE), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def versions() -> list[tuple[str, str]]:
    """Versions of the programs that computed and drew this."""
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    found = [("made", now), ("source revision", revision() or "unknown"), ("Python", platform.python_version())]
    return found + [(name, metadata.version(name)) for name in PACKAGES]


def origin(facts: Facts) -> Table:
    """Command, versions, and how a simulated run was made."""
    rows = [["command", facts.command], *([name, value] for name, value in versions())]
    if facts.simulated:
        rows.append(["simulated", ", ".join(f"{k} {v}" for k, v in facts.simulated.items())])
    return Table(["", ""], rows, numbers=False)
