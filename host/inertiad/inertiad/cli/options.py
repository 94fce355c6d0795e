# SPDX-License-Identifier: Apache-2.0
"""Options that commands share, and their output on the terminal."""

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

RobotFile = Annotated[Path, typer.Argument(metavar="ROBOT", help="Robot description, robot.toml.")]
RunFolder = Annotated[Path, typer.Option("-o", "--output", metavar="RUN", help="Run folder to write.")]
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


def write_text(output: Path, text: str) -> None:
    """Text into a file, or to stdout for "-"."""
    if str(output) == "-":
        typer.echo(text.rstrip("\n"))
    else:
        output.write_text(text, encoding="utf-8")
        say(f"{output}: written")


def command_line() -> str:
    """The command as typed."""
    return shlex.join(["inertiactl", *sys.argv[1:]])


def say(text: str) -> None:
    """A line for people, on stderr."""
    typer.echo(text, err=True)
