# SPDX-License-Identifier: Apache-2.0
"""Options that commands share, and their output on the terminal."""

import json
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from inertiad.base.error import InputError

RobotFile = Annotated[Path, typer.Argument(metavar="ROBOT", help="Robot description, robot.toml.")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; -: stdout.")]


def _folder(output: Path | None) -> Path | None:
    """InputError: stdout is named where a folder is written."""
    if str(output) == "-":
        raise InputError("-: allowed: a folder; several files do not go to stdout")
    return output


RunFolder = Annotated[
    Path, typer.Option("-o", "--output", metavar="RUN", callback=_folder, help="Run folder to write.")
]
Folder = Annotated[
    Path, typer.Option("-o", "--output", metavar="FOLDER", callback=_folder, help="Folder for the files it writes.")
]
Figures = Annotated[
    Path | None,
    typer.Option("--figures", metavar="FOLDER", callback=_folder, help="Folder for every figure as PNG and PDF."),
]
Picture = Annotated[
    Path | None, typer.Option("--picture", metavar="FILE", help="Draw the result, .html or .png; -: a page to stdout.")
]
Url = Annotated[str, typer.Option("--lcm", metavar="URL", help="LCM network.")]
Prefix = Annotated[str, typer.Option(metavar="TEXT", help="Channel prefix.")]


@contextmanager
def progress_shown() -> Iterator[Callable[[str], None]]:
    """A spinner with the current step on stderr, if that is a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda step: None
        return
    with console.status("start") as status:
        yield lambda step: status.update(f"{step} ...")


def is_stdout(output: Path | None) -> bool:
    """Whether an option names stdout, by "-"."""
    return str(output) == "-"


@contextmanager
def written(output: Path, suffix: str = "") -> Iterator[Path]:
    """The path to write to: output itself; for "-" a file with that suffix whose content goes to stdout at the end."""
    if not is_stdout(output):
        yield output
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stdout{suffix}"
        yield path
        sys.stdout.flush()
        sys.stdout.buffer.write(path.read_bytes())
        sys.stdout.buffer.flush()


def write_text(output: Path, text: str) -> None:
    """Text into a file, which is said, or to stdout for "-"."""
    with written(output) as path:
        path.write_text(text, encoding="utf-8")
    say_written(output)


def write_json(output: Path, document: dict[str, Any]) -> None:
    """A JSON document into a file, or to stdout for "-"."""
    with written(output) as path:
        path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def say_written(output: Path) -> None:
    """A line on stderr, unless the output is stdout."""
    if not is_stdout(output):
        say(f"{output}: written")


def only_one_to_stdout(*outputs: Path | None) -> None:
    """InputError: more than one option names stdout."""
    if sum(map(is_stdout, outputs)) > 1:
        raise InputError("-: stdout takes one output: give the others a file")


def teller(json_output: Path | None) -> Callable[[str], None]:
    """A function that prints a line of the result: on stdout, or on stderr where stdout takes the JSON."""
    return say if is_stdout(json_output) else typer.echo


def command_line() -> str:
    """The command as typed."""
    return shlex.join(["inertiactl", *sys.argv[1:]])


def say(text: str) -> None:
    """A line for people, on stderr."""
    typer.echo(text, err=True)
