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
    lines += _beside_undisturbed(results) + _found_changes(results) + _failures(results)
    keys = Counter(key for r in results for key in r.get("unknown_keys", []))
    if keys:
        told = ", ".join(f"{key} ({n} runs)" for key, n in keys.items())
        lines.append(f"keys that this build does not know, taken out of robot.toml: {told}")
    return lines


UNDISTURBED = {
    "tracker-spikes-10": "declared",
    "force-spikes-10": "declared",
    "tracker-gaps": "declared",
    "pushed": "declared-60s",
    "pushed-four": "declared-60s",
}
"""scenes whose runs are those of another scene, robot and seed alike, with a disturbance on top"""


def _shift(disturbed: dict[str, Any], quiet: dict[str, Any]) -> float | None:
    """Largest change of an observable parameter, in sigma of the undisturbed run."""
    if "value" not in disturbed or "value" not in quiet:
        return None
    columns = zip(disturbed["value"], quiet["value"], quiet["std"], quiet["observable"], strict=True)
    return max((abs(a - b) / std for a, b, std, seen in columns if seen and std > 0.0), default=None)


def _beside_undisturbed(results: list[dict[str, Any]]) -> list[str]:
    """How far disturbances carry the estimate away from the same run without them."""
    quiet = {(r["scene"], r["robot"], r["seed"]): r for r in results}
    lines = []
    for scene, other in UNDISTURBED.items():
        for column in ("platform", "fit"):
            pairs = [(r, quiet.get((other, r["robot"], r["seed"]))) for r in results if r["scene"] == scene]
            shifts = [_shift(r[column], q[column]) for r, q in pairs if q is not None]
            known = [s for s in shifts if s is not None]
            if known:
                said = f"median {median(known):.2f}, worst {max(known):.1f} sigma from the same run without"
                lines.append(f"{scene}, {column}: {said} ({len(known)} runs)")
    return lines


def _found_changes(results: list[dict[str, Any]]) -> list[str]:
    """When the platform noticed changes of payload, and how often there was none."""
    lines = []
    for scene in dict.fromkeys(r["scene"] for r in results if "change_s" in r.get("truth", {})):
        runs = [r for r in results if r["scene"] == scene and "change_times" in r["platform"]]
        late = [[t - r["truth"]["change_s"] for t in r["platform"]["change_times"]] for r in runs]
        found = [min(t for t in times if t >= 0.0) for times in late if any(0.0 <= t <= 10.0 for t in times)]
        false = sum(sum(not 0.0 <= t <= 10.0 for t in times) for times in late)
        within = f"found after {median(found):.2f} s (median), {max(found):.2f} s (worst)" if found else "none found"
        lines.append(f"{scene}: {within}, {len(runs) - len(found)} of {len(runs)} missed within 10 s, {false} false")
    return lines


def sigmas(before: list[dict[str, Any]], after: list[dict[str, Any]]) -> list[str]:
    """Ratio of published sigma, after / before, of runs in both with declared errors only: medians by robot."""
    was = {(r["scene"], r["robot"], r["seed"]): r for r in before}
    ratios: dict[tuple[str, str], list[float]] = {}
    for r in after:
        old = was.get((r["scene"], r["robot"], r["seed"]))
        if r["known"] != "declared" or old is None or r["scene"] == "perfect":
            continue
        for column in ("platform", "fit"):
            if "std" in r[column] and "std" in old[column]:
                pairs = zip(r[column]["std"], old[column]["std"], old[column]["observable"], strict=True)
                ratios.setdefault((column, r["robot"]), []).extend(a / b for a, b, seen in pairs if seen and b > 0.0)
    lines = [f"{column:9} {robot:8} sigma x {median(v):.2f} ({len(v)} values)" for (column, robot), v in ratios.items()]
    for column in ("platform", "fit"):
        every = [v for (c, _), values in ratios.items() if c == column for v in values]
        lines += [f"{column:9} all      sigma x {median(every):.2f}"] if every else []
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


def main(arguments: list[str]) -> int:
    """table.py RESULTS.json... prints their table; table.py --sigma BEFORE.json AFTER.json the ratio of sigmas."""
    beside = arguments[:1] == ["--sigma"]
    read = [json.loads(Path(path).read_text(encoding="utf-8")) for path in arguments[beside:]]
    if not read or (beside and len(read) != 2):
        print(main.__doc__, file=sys.stderr)
        return 2
    print("\n".join(sigmas(*read) if beside else table([run for results in read for run in results])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
