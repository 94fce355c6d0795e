# SPDX-License-Identifier: Apache-2.0
"""What the checks of a run look at, and the verdict of one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import inertiad_core
from inertiad.check.daemon_run import Published
from inertiad.robot.dbc import Binding
from inertiad.robot.description import Robot
from inertiad.run.canlog import CanLog


@dataclass(frozen=True)
class Check:
    """One line of the verdict."""

    name: str
    passed: bool | None
    """None: it could not be made"""
    detail: str

    def __str__(self) -> str:
        verdict = "OPEN" if self.passed is None else "PASS" if self.passed else "FAIL"
        return f"{verdict}  {self.name}: {self.detail}"


@dataclass
class Case:
    """Everything the checks look at."""

    robot: Robot
    config_bytes: bytes
    """compiled from the run's robot.toml"""
    given_config: bytes
    """what the daemon ran with"""
    log: CanLog
    raw: CanLog
    published: Published
    positions: list[tuple[int, list[float]]]
    bindings: list[Binding]
    run: Path

    @property
    def config(self) -> Any:
        return inertiad_core.Config(self.config_bytes)
