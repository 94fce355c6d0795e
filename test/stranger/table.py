# SPDX-License-Identifier: Apache-2.0
"""The table: one row per scene, the platform's columns and the fit's. `table.py results.json...` prints it again."""

import json
import sys
from collections import Counter
from pathlib import Path
from statistics import median
from typing import Any

COLUMNS = f"{'m %':>6} {'CoG mm':>7} {'J %':>6} {'|z|':>6} {'cover':>5} {'chg':>3} {'g/c/s/-':>9}"
HEAD = f"{'scene':28} {'runs':>4} | {'platform: ' + COLUMNS:>57} | {'fit: ' + COLUMNS:>52}"
SURE = 3.5


def _number(values: list[float | None], form: str) -> str:
    seen = [v for v in values if v is not None]
    if not seen:
        return f"{'-':>{form.split('.')[0]}}"
    value = median(seen)
    return f"{value:{form}f}" if value < 1e4 else f"{'huge':>{form.split('.')[0]}}"


def cells(parts: list[dict[str, Any]]) -> str:
    """One program's columns: median errors, worst |z| and coverage of the observable ones, changes, verdicts."""
    good = [p for p in parts if p.get("failed") is None and "worst_z" in p]
    n = sum(p["n_observable"] for p in good)
    cover = f"{100.0 * sum(p['n_covered'] for p in good) / n:4.0f}%" if n else "    -"
    worst = [p["worst_z"] for p in good if p["worst_z"] is not None]
    verdicts = Counter(p.get("verdict") or "-" for p in good)
    counts = "/".join(str(verdicts[v]) for v in ("good", "care", "stop", "-"))
    changes = sum(p.get("changes") or 0 for p in good)
    z = f"{max(worst):6.1f}" if worst and max(worst) < 1e4 else f"{'huge' if worst else '-':>6}"
    columns = [
        _number([p["mass_percent"] for p in good], "6.2"),
        _number([p["cog_mm"] for p in good], "7.1"),
        _number([p["inertia_percent"] for p in good], "6.2"),
    ]
    lost = f" {len(parts) - len(good)} failed" if len(good) < len(parts) else ""
    return f"{' '.join(columns)} {z} {cover} {changes:3d} {counts:>9}{lost}"


def row(name: str, runs: list[dict[str, Any]]) -> str:
    """A scene's line."""
    platform, fit = (cells([r[column] for r in runs]) for column in ("platform", "fit"))
    return f"{name:28} {len(runs):4d} | {platform:>57} | {fit:>52}"


def sure_and_wrong(runs: list[dict[str, Any]], column: str) -> str:
    """Runs with an observable parameter beyond 3.5 sigma, and those of them where the verdict was good or none."""
    known = [r[column] for r in runs if r[column].get("failed") is None and r[column].get("worst_z") is not None]
    wrong = [p for p in known if p["worst_z"] > SURE]
    silent = [p for p in wrong if (p.get("verdict") or "good") == "good"]
    share = 100.0 / max(len(known), 1)
    return f"{column}: {len(wrong) * share:.0f} % over {SURE} sigma, {len(silent) * share:.1f} % of all with no warning"


def table(results: list[dict[str, Any]]) -> list[str]:
    """Rows by scene; `declared` by robot; then the runs that are wrong and sure, and what failed."""
    lines = [HEAD, "-" * len(HEAD)]
    for scene in dict.fromkeys(r["scene"] for r in results):
        runs = [r for r in results if r["scene"] == scene]
        robots = sorted({r["robot"] for r in runs})
        lines.append(row(scene, runs))
        if len(robots) > 1:
            lines += [row(f"  {robot}", [r for r in runs if r["robot"] == robot]) for robot in robots]
    lines.append("-" * len(HEAD))
    for known, said in (
        ("residual", "faults that show"),
        ("silent", "faults without residual"),
        ("declared", "healthy"),
    ):
        runs = [r for r in results if r["known"] == known]
        if runs:
            lines.append(
                f"{said}: {len(runs)} runs; " + "; ".join(sure_and_wrong(runs, c) for c in ("platform", "fit"))
            )
    lines += _failures(results)
    keys = Counter(key for r in results for key in r.get("unknown_keys", []))
    if keys:
        told = ", ".join(f"{key} ({n} runs)" for key, n in keys.items())
        lines.append(f"keys that this build does not know, taken out of robot.toml: {told}")
    return lines


def _failures(results: list[dict[str, Any]]) -> list[str]:
    """The failures, a line each with how often."""
    failed = Counter(
        f"{column}: {r[column]['failed'][:140]}"
        for r in results
        for column in ("platform", "fit")
        if r[column].get("failed") is not None
    )
    return [f"failed {n} times: {said}" for said, n in failed.items()]


if __name__ == "__main__":
    print("\n".join(table([run for path in sys.argv[1:] for run in json.loads(Path(path).read_text())])))
