# SPDX-License-Identifier: Apache-2.0
"""inertiactl: the command line. Commands only parse, call one module and print its result.

Exit codes: 0 good, 1 a check failed, 2 bad usage or input, with a line on stderr for each mistake.
"""

import sys
from typing import Annotated, Any, NoReturn

import typer
from typer.exceptions import TyperException

from inertiad.base import extras
from inertiad.base.error import InputError
from inertiad.base.version import version
from inertiad.cli import control, exchange, identify, live, robot, run, start
from inertiad.cli.options import say

HELP = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="inertiactl",
    help="Describe a robot, simulate or import a run, watch the daemon's estimate.",
    context_settings=HELP,
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for module in (start, robot, run, identify, control, live, exchange):
    app.add_typer(module.commands)


def _show_version(is_wanted: bool) -> None:
    if is_wanted:
        typer.echo(f"inertiactl {version()}")
        raise typer.Exit()


@app.callback()
def _options(
    is_wanted: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Describe a robot, simulate or import a run, watch the daemon's estimate."""


def _keep_brackets(command: Any) -> None:
    """Brackets in help texts are brackets, as in [nominal], and no markup."""
    for name in ("help", "epilog"):
        if text := getattr(command, name, None):
            setattr(command, name, text.replace("[", r"\["))
    for parameter in command.params:
        if text := getattr(parameter, "help", None):
            parameter.help = text.replace("[", r"\[")
    for below in getattr(command, "commands", {}).values():
        _keep_brackets(below)


def main() -> None:
    """Run the command line and exit."""
    command = typer.main.get_command(app)
    _keep_brackets(command)
    try:
        code: Any = command(prog_name="inertiactl", standalone_mode=False)
    except InputError as error:
        _fail(*error.lines)
    except ModuleNotFoundError as error:
        if not extras.is_optional(error.name):
            raise
        _fail(*extras.missing(error.name or "").lines)
    except TyperException as error:
        if not error.format_message():  # no arguments: the help has been shown
            sys.exit(2)
        _fail(error.format_message())
    except OSError as error:
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error.strerror or error))
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(*lines: str) -> NoReturn:
    for line in lines:
        say(f"inertiactl: {' '.join(line.split())}")
    sys.exit(2)
