# SPDX-License-Identifier: Apache-2.0
"""python odd_inputs.py FIRST N: odd signals files through fit, calibrate, report and sync; prints what went wrong.

A case is a seed. Each takes a good signals file and a robot description, and spoils one to three things in them:
values, times, units, noise, lengths, or a number of the description.
"""

import contextlib
import io
import json
import math
import re
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inertiad.cli.main import main as run_command_line

RATE = 50.0
SECONDS = 12.0
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")
COMMANDS = ("fit", "wls", "iv", "paper", "calibrate", "report", "sync")

Table = dict[str, np.ndarray]
Spoil = Callable[[Table, np.random.Generator], None]


@dataclass(frozen=True)
class Good:
    """A run that is as it should be."""

    folder: Path
    signals: Table
    tracker: Table
    robot: str


def command_of(seed: int) -> str:
    """Each command in turn."""
    return COMMANDS[seed % len(COMMANDS)]


def _some(table: Table, rng: np.random.Generator) -> list[str]:
    """Names of a few columns, time not among them."""
    names = [name for name in table if name != "t"]
    return list(rng.choice(names, size=min(len(names), rng.integers(1, 5)), replace=False))


def _cut(table: Table, rng: np.random.Generator) -> None:
    n = int(rng.choice([0, 1, 2, 3, 10, 40, 150]))
    for name in table:
        table[name] = table[name][:n]


def _hold(table: Table, rng: np.random.Generator) -> None:
    for name in _some(table, rng):
        table[name][:] = table[name][:1].sum()


def _rest(table: Table, rng: np.random.Generator) -> None:
    for name, value in table.items():
        if name != "t":
            value[:] = value[:1].sum()


def _scale(table: Table, rng: np.random.Generator) -> None:
    factor = float(rng.choice([0.0, -1.0, 1e-9, 1e-3, 57.3, 1e3, 1e9, 1e30]))
    for name in _some(table, rng):
        table[name] = table[name] * factor


def _scale_kind(table: Table, rng: np.random.Generator) -> None:
    start = str(rng.choice(["acc", "gyro", "f_", "pos", "q_"]))
    factor = float(rng.choice([0.0, -1.0, 1e-3, 0.1, 2.0, 57.3, 1e3]))
    for name in table:
        if name.startswith(start):
            table[name] = table[name] * factor


def _noise(table: Table, rng: np.random.Generator) -> None:
    size = float(10.0 ** rng.uniform(-9, 4))
    for name in _some(table, rng):
        table[name] = table[name] + rng.normal(0.0, size, len(table[name]))


def _holes(table: Table, rng: np.random.Generator) -> None:
    value = float(rng.choice([np.nan, np.inf, -np.inf, 1e308]))
    for name in _some(table, rng):
        n = len(table[name])
        table[name][rng.random(n) < rng.choice([0.01, 0.5, 1.0])] = value


def _gaps(table: Table, rng: np.random.Generator) -> None:
    keep = rng.random(len(table["t"])) > rng.choice([0.01, 0.2, 0.9])
    for name in table:
        table[name] = table[name][keep]


def _times(table: Table, rng: np.random.Generator) -> None:
    t = table["t"]
    kind = rng.integers(0, 6)
    if kind == 0:
        t[:] = t[:1].sum()
    elif kind == 1:
        t[:] = t[::-1].copy()
    elif kind == 2:
        t[rng.random(len(t)) < 0.05] += rng.choice([0.9, -0.9, 100.0, 1e12])
    elif kind == 3:
        t *= rng.choice([1e-6, 1e-3, 1e3, 1e9])
    elif kind == 4:
        t += rng.choice([-100.0, 1.7e9, 1e10, 1e18])
    else:
        t += rng.normal(0.0, 10.0 ** rng.uniform(-6, 0), len(t))


def _swap(table: Table, rng: np.random.Generator) -> None:
    a, b = rng.choice([name for name in table if name != "t"], size=2, replace=False)
    table[a], table[b] = table[b], table[a]


def _steps(table: Table, rng: np.random.Generator) -> None:
    """A payload from the middle on, a sensor stuck, a spike."""
    for name in _some(table, rng):
        n = len(table[name])
        table[name][n // 2 :] += float(rng.choice([1.0, 100.0, -1e4]))


SPOILS: tuple[Spoil, ...] = (
    *(_cut, _hold, _rest, _scale, _scale_kind, _noise, _holes, _gaps, _times, _swap, _steps),
    *(_hold, _scale_kind, _noise, _steps),
)


def _spoil_robot(text: str, rng: np.random.Generator) -> str:
    """Another number in place of one of the description's."""
    found = list(NUMBER.finditer(text))
    at = found[int(rng.integers(len(found)))]
    value = float(at.group())
    other = float(rng.choice([0.0, -value, 1e-6 * value, 0.5 * value, 2.0 * value, 1e3 * value, 1e9]))
    return f"{text[: at.start()]}{other!r}{text[at.end() :]}"


def _write(path: Path, table: Table) -> None:
    rows = np.column_stack([table[name] for name in table])
    np.savetxt(path, rows, "%.12g", ",", header=",".join(table), comments="")


def make(good: Good, folder: Path, seed: int) -> Path:
    """Case of a seed in a folder: robot.toml, signals.csv, and, for sync, can.log and tracker.csv."""
    rng = np.random.default_rng(seed)
    robot, is_sync = good.robot, command_of(seed) == "sync"
    table = {name: value.copy() for name, value in (good.tracker if is_sync else good.signals).items()}
    n_spoils = int(rng.integers(1, 4))
    for _ in range(n_spoils):
        if rng.random() < 0.2:
            robot = _spoil_robot(robot, rng)
        else:
            with np.errstate(all="ignore"):
                SPOILS[int(rng.integers(len(SPOILS)))](table, rng)
    (folder / "robot.toml").write_text(robot)
    for dbc in good.folder.glob("*.dbc"):
        (folder / dbc.name).write_bytes(dbc.read_bytes())
    if is_sync:
        (folder / "can.log").write_bytes((good.folder / "can.log").read_bytes())
        _write(folder / "tracker.csv", table)
    else:
        _write(folder / "signals.csv", table)
    return folder / "signals.csv"


def arguments(command: str, signals: Path) -> list[str]:
    """The command line of a case."""
    robot, folder = str(signals.with_name("robot.toml")), signals.parent
    if command == "calibrate":
        return ["calibrate", robot, str(signals), "-o", str(folder / "calibration.toml")]
    if command == "report":
        return ["report", str(signals), "-o", str(folder / "report.html")]
    if command == "sync":
        return ["sync", str(folder), "--json", str(folder / "sync.json")]
    method = "joint" if command == "fit" else command
    return ["fit", str(signals), "--method", method, "--json", str(folder / "estimate.json")]


def _numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [x for v in value.values() for x in _numbers(v)]
    if isinstance(value, list):
        return [x for v in value for x in _numbers(v)]
    return [float(value)] if isinstance(value, float) else []


def _wrong_result(command: str, folder: Path) -> str:
    """What is wrong with a result that the command says may be used."""
    file = folder / {"sync": "sync.json"}.get(command, "estimate.json")
    if command in ("calibrate", "report") or not file.exists():
        return ""
    document = json.loads(file.read_text())
    if not all(map(math.isfinite, _numbers(document))):
        return f"{file.name} has a number that is not finite"
    return "not converged, but not refused" if document.get("converged") is False else ""


def judge(command: str, signals: Path) -> str:
    """Run one command on a case, warnings being errors; "" if it did what it should."""
    (signals.parent / "estimate.json").unlink(missing_ok=True)
    output, argv = io.StringIO(), sys.argv
    sys.argv = ["inertiactl", *arguments(command, signals)]
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            warnings.simplefilter("error")
            run_command_line()
    except SystemExit as end:
        if end.code not in (0, 1, 2):
            return f"exit status {end.code}"
        if end.code == 2 and len(output.getvalue().splitlines()) != 1:
            return f"not one line: {output.getvalue()!r}"
        return _wrong_result(command, signals.parent) if end.code == 0 else ""
    except BaseException:  # whatever it is, it is what is looked for
        return traceback.format_exc()
    finally:
        sys.argv = argv
    return ""


def good_run(folder: Path) -> Good:
    """CoGiRo's paper motion."""
    from conftest import COGIRO

    from inertiad.base import table
    from inertiad.exchange import convert
    from inertiad.robot import description
    from inertiad.run import signals_csv, tracker_csv

    done = ["simulate", str(COGIRO / "robot.toml"), "-o", str(folder), "--seed", "2", "--rate", str(RATE)]
    argv, sys.argv = sys.argv, ["inertiactl", *done]
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            run_command_line()
    except SystemExit:
        pass
    finally:
        sys.argv = argv
    robot = description.load(folder / "robot.toml")
    convert.export(folder, "csv", folder / "signals.csv", None, "INERTIAD_", [])
    read = table.read(folder / "signals.csv", signals_csv.columns(robot))
    kept = read.t < read.t[0] + SECONDS
    columns = {"t": read.t[kept], **{name: value[kept] for name, value in read.columns.items()}}
    tracked = tracker_csv.read(folder / "tracker.csv")
    tracker = {"t": tracked.t, **{name: tracked.columns[name] for name in "xyz"}}
    return Good(folder, columns, tracker, (folder / "robot.toml").read_text())


def main() -> None:
    first, n = int(sys.argv[1]), int(sys.argv[2])
    n_wrong = 0
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "good").mkdir()
        good = good_run(Path(name) / "good")
        for seed in range(first, first + n):
            folder = Path(name) / str(seed)
            folder.mkdir()
            signals, command = make(good, folder, seed), command_of(seed)
            wrong = judge(command, signals)
            if wrong:
                n_wrong += 1
                print(f"---- seed {seed}, {command}\n{wrong}", flush=True)
    print(f"{n} odd inputs from seed {first} on: {n_wrong} wrong")


if __name__ == "__main__":
    main()
