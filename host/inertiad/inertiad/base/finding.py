# SPDX-License-Identifier: Apache-2.0
"""What is good or not about a result, in words an engineer acts on, and the verdict that follows."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final, Literal

Severity = Literal["good", "care", "stop"]
ORDER: Final[tuple[Severity, ...]] = ("stop", "care", "good")
HEADLINES: Final[dict[Severity, str]] = {
    "good": "A good result",
    "care": "Usable with care",
    "stop": "Do not use this result yet",
}


@dataclass(frozen=True)
class Finding:
    """One statement about a result."""

    name: str
    """for programs: the same cause has the same name everywhere"""
    severity: Severity
    says: str
    do: str = ""
    """what helps; empty: nothing needs to be done"""
    evidence: dict[str, Any] = field(default_factory=dict)
    """numbers behind it, SI units"""

    def document(self) -> dict[str, Any]:
        """As in estimate.json."""
        return {
            "name": self.name,
            "severity": self.severity,
            "says": self.says,
            "evidence": self.evidence,
            "do": self.do,
        }


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """The worst first; equally bad ones stay in order."""
    return sorted(findings, key=lambda finding: ORDER.index(finding.severity))


def verdict(findings: Iterable[Finding]) -> Severity:
    """The worst severity; good where nothing is found."""
    return min((finding.severity for finding in findings), key=ORDER.index, default="good")


def document(findings: Iterable[Finding]) -> dict[str, Any]:
    """verdict and findings, as in estimate.json."""
    found = ordered(findings)
    return {"verdict": verdict(found), "findings": [finding.document() for finding in found]}


def lines(findings: Iterable[Finding]) -> list[str]:
    """For a terminal: the headline and what is not good, a line each."""
    found = ordered(findings)
    said = [HEADLINES[verdict(found)]]
    for finding in found:
        if finding.severity != "good":
            said.append(f"{finding.severity}: {finding.says}" + (f"; do: {finding.do}" if finding.do else ""))
    return said
