# SPDX-License-Identifier: Apache-2.0
"""One line of the acceptance table, and what several of them share."""

import subprocess
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scenes import OUT, TOP

FIRST = 1000
"""first seed; nothing was tuned on those from here on"""


@dataclass(frozen=True)
class Verdict:
    """A limit and what was measured against it."""

    name: str
    what: str
    trials: int
    unit: str
    """of the trials: runs, windows, ..."""
    limit: str
    measured: str
    good: bool | None
    """None: does not apply"""

    def __str__(self) -> str:
        word = "n/a" if self.good is None else "PASS" if self.good else "FAIL"
        n = f"{self.trials:g}" if self.trials < 1e5 else f"{self.trials:.0e}".replace("e+0", "e")
        return f"{word:4} {self.name:3} {self.what:44} {n:>5} {self.unit:10} {self.limit:44} {self.measured}".rstrip()

    def as_dict(self) -> dict[str, Any]:
        """For the JSON file."""
        return asdict(self)


HEAD = f"{'':4} {'':3} {'':44} {'n':>5} {'of':10} {'limit':44} measured"


def numbers(values: np.ndarray) -> str:
    """m %, rho mm, J %; what has no limit is left out."""
    m, rho, J = values[0], values[1:4], values[4:]
    parts = [f"m {m:.2f}"] if np.isfinite(m) else []
    for name, part in (("rho", rho), ("J", J)):
        if np.isfinite(part).all():
            parts.append(f"{name} {'/'.join(f'{v:.2g}' if v < 1 else f'{v:.1f}' for v in part)}")
    return "  ".join(parts)


def within(name: str, what: str, n: int, measured: np.ndarray, limit: list[float]) -> Verdict:
    """Medians [7] against limits [7] as scenes.scaled has them; inf: no limit."""
    good = bool((measured <= np.array(limit)).all())
    return Verdict(name, what, n, "runs", numbers(np.array(limit)), numbers(measured), good)


def program(name: str, *arguments: object) -> dict[str, float]:
    """What a program of test/accept prints, "name value" lines."""
    command = [str(a) for a in (TOP / "build/test/accept" / name, *arguments)]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return {key: float(value) for key, value in (line.split() for line in out.splitlines())}


def scratch(name: str) -> Any:
    """A file in build/accept/."""
    OUT.mkdir(parents=True, exist_ok=True)
    return OUT / name
