# SPDX-License-Identifier: Apache-2.0
"""The data that checks of a run compare, and the result of one check."""

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
    """Result of one check."""

    name: str
    passed: bool | None
    """None: it could not be made"""
    detail: str

    def __str__(self) -> str:
        verdict = "OPEN" if self.passed is None else "PASS" if self.passed else "FAIL"
        return f"{verdict}  {self.name}: {self.detail}"


@dataclass
class Case:
    """The data that checks compare."""

    robot: Robot
    config_bytes: bytes
    """compiled from the run's robot.toml"""
    given_config: bytes
    """the daemon's"""
    log: CanLog
    raw: CanLog
    published: Published
    positions: list[tuple[float, list[float]]]
    bindings: list[Binding]
    run: Path
    is_blind: bool = False
    """compiled without [nominal]"""

    @property
    def config(self) -> Any:
        return inertiad_core.Config(self.config_bytes)
