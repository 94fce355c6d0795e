# SPDX-License-Identifier: Apache-2.0
"""Runs to and from the files of other tools (file_formats.py), identified bodies to them (body_formats.py)."""

import difflib
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.base.table import Table, at_ns, header
from inertiad.exchange import body_formats, dataset, file_formats, fmu, foreign_messages, foreign_tables, motion_capture
from inertiad.exchange.dataset import Dataset
from inertiad.robot import description
from inertiad.run import canlog
from inertiad.run import folder as run_folder

FMU: Final = "fmu"
RUN_FILES: Final = (
    *("robot.toml", "can.log", "signals.csv", "tracker.csv", "lengths.csv", "run.lcmlog", "estimate.json"),
    *("truth.json", "header.json", "sync.json"),
)
"""of a run folder, that commands write and read"""
IS_OWN: Final[dict[str, Callable[[Path], bool]]] = {
    ".parquet": foreign_tables.is_own_parquet,
    ".mat": foreign_tables.is_own_mat,
    ".mf4": foreign_tables.is_own_mf4,
    ".mcap": foreign_messages.is_own_mcap,
}
"""by ending: whether a file is of export"""


def _check(form: str) -> None:
    known = [*file_formats.FORMATS, *body_formats.FORMATS, FMU]
    if form not in known:
        near = difflib.get_close_matches(form, known, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise InputError(f'--to "{form}": unknown format: allowed: {", ".join(known)}{hint}')


def _check_overwrites(run: Path, robot: Path | None, output: Path) -> None:
    """InputError: output, or a file that would be written beside it, is one that a run consists of."""
    folder = run if run.is_dir() else run.parent
    own = [run, *(folder / name for name in RUN_FILES), *folder.glob("*.dbc")]
    own += [] if robot is None else [robot, *robot.parent.glob("*.dbc")]
    kept = {path.resolve() for path in own if path.exists()}
    for target in file_formats.all_written(output):
        if target.resolve() in kept:
            raise InputError(f"{target}: is what is exported: allowed: another file to write")


def export(run: Path, form: str, output: Path, robot: Path | None, prefix: str, remarks: list[str]) -> list[str]:
    """Write a run, or its identified body, in one of the known formats. Returns the contents of each file as text.

    remarks: what the run lacks and where it is damaged. InputError: unknown format, output is what is read, nothing to
    export, a package that is not installed.
    """
    _check(form)
    described = run / "robot.toml" if run.is_dir() else run
    _check_overwrites(run, robot, output)
    if form == FMU:
        if robot is not None:
            raise InputError(f"--robot {robot}: not wanted with --to fmu: pass it instead of {run}")
        return [fmu.write(described, output)]
    if form in body_formats.FORMATS:
        if robot is not None:
            raise InputError(
                f"--robot {robot}: not wanted with --to {form}: the body is in the platform's own frame; leave it out"
            )
        body = body_formats.read(run)
        body_formats.write(output, body, form)
        return [f"{output}: mass {body.mass:.6g} kg"]
    data = dataset.read(run, robot, prefix, remarks)
    if form == "mcap" and data.robot is None:
        remarks.append("no usable robot description: without the robot in 3D; pass --robot ROBOT")
    written = file_formats.FORMATS[form].write(output, data)
    contents = [f"{table.name} {len(table)}" for table in data.all()]
    if form == "candump" and data.frames is not None:
        contents = [f"frames {len(data.frames)}"]
    if file_formats.FORMATS[form].is_per_table:
        return [f"{path}: {what}" for path, what in zip(written, contents, strict=True)]
    return [f"{output}: {', '.join(contents)}", *(f"{path}: layout" for path in written[1:])]


def _reader(path: Path) -> Callable[[Path], Dataset]:
    ending = path.suffix.lower()
    if ending in (*canlog.OTHER_FORMATS, ".txt") and ending != ".mf4":
        return file_formats.read_can
    for form in file_formats.FORMATS.values():
        if form.ending == ending:
            return form.read
    known = sorted({*(f.ending for f in file_formats.FORMATS.values()), *canlog.OTHER_FORMATS})
    raise InputError(f"{path}: unknown ending: allowed: {', '.join(known)}")


def _valid_positions(table: Table) -> Table:
    """The columns of tracker.csv, of the samples that count."""
    chosen = table.columns.get("valid", np.ones(len(table), np.bool_))
    names = [name for name in (*"xyz", *quantity.QUATERNION) if name in table.columns]
    return at_ns(table.name, table.t_ns[chosen], {name: table.columns[name][chosen] for name in names})


def _write_run(data: Dataset, folder: Path) -> Iterator[str]:
    for name, kept in (("signals", lambda table: table), ("tracker", _valid_positions)):
        if name in data.tables:
            table = kept(data.tables[name])
            dataset.write_csv(folder / f"{name}.csv", table, with_units=False)
            yield f"{folder / name}.csv: {len(table)} rows"
    if data.frames is not None:
        file_formats.write_candump(folder / "can.log", data)
        yield f"{folder / 'can.log'}: {len(data.frames)} frames"


def is_foreign(file: Path) -> bool:
    """Whether a file has other columns than export and encode know, so that a mapping is needed.

    InputError: it cannot be read.
    """
    if not file.exists():
        return False
    ending = file.suffix.lower()
    if foreign_messages.is_bag(file) or ending == ".tsv" or motion_capture.kind(file) is not None:
        return True
    return _is_foreign_csv(file) if ending == ".csv" else ending in IS_OWN and not IS_OWN[ending](file)


def _is_foreign_csv(file: Path) -> bool:
    try:
        names, _ = header(file)
    except InputError:
        return True
    if not any(key in names for key in dataset.KEY_COLUMN.values()):
        return not _is_health(names)
    return ("acc_x" in names or "f_1" in names) and _has_blanks(file)


def _has_blanks(file: Path) -> bool:
    """Whether cells are blank in the first rows, as where sensors of different rates share a file."""
    with file.open(encoding="utf-8-sig", errors="replace") as lines:
        return any(
            not cell.strip() for line in itertools.islice(lines, 1, 200) if line.strip() for cell in line.split(",")
        )


def _is_health(names: list[str]) -> bool:
    """Counters of the daemon: stage_cause."""
    return any(name.startswith(("decode_", "align_", "group_")) for name in names)


def read_file(file: Path) -> Dataset:
    """A file of another tool. InputError: not there, unknown ending, unusable."""
    if not file.exists():
        raise InputError(f"{file}: No such file or directory")
    return _reader(file)(file)


def import_file(file: Path, folder: Path, robot: Path | None, remarks: list[str]) -> list[str]:
    """A file of another tool -> a run folder with what of can.log, tracker.csv, signals.csv is in it.

    remarks: what is left out or damaged. InputError: unknown ending, unusable file, nothing of a run in it.
    """
    data = read_file(file)
    if data.frames is not None:
        remarks.extend(data.frames.remarks)
    left = [name for name in data.tables if name not in ("signals", "tracker")]
    if left:
        remarks.append(f"{file}: {', '.join(left)}: left out, the daemon and fit make them anew")
    run_folder.open_run(folder)
    written = list(_write_run(data, folder))
    if not written:
        raise InputError(f"{file}: no signals, positions or CAN frames in it")
    if robot is not None:
        run_folder.write_robot(folder, description.load(robot), description.read_data(robot))
    return written
