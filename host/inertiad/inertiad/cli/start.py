# SPDX-License-Identifier: Apache-2.0
"""Commands for the first steps: a new robot.toml, the reference of its keys, their JSON schema."""

from pathlib import Path
from typing import Annotated

import typer

from inertiad.base.error import InputError
from inertiad.cli.options import Folder, say, write_text

commands = typer.Typer()

TextOutput = Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write; -: stdout.")]


@commands.command(epilog="Example: inertiactl demo -o demo")
def demo(
    output: Folder = Path("demo"),
    isolated: Annotated[bool, typer.Option("--isolated", hidden=True, help="It runs in a network of its own.")] = False,
) -> None:
    """Simulate the paper's experiment, stream it through the daemon, compare the estimate with the truth."""
    from inertiad.check import demo as demonstration

    demonstration.run(output, None if isolated else ["demo", "-o", str(output), "--isolated"])


@commands.command("init", epilog="Example: inertiactl init --cables 4 -o robot.toml")
def init_command(
    cables: Annotated[int | None, typer.Option(metavar="N", min=1, max=16, help="Number of cables.")] = None,
    dbc: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="DBC of the bus, also several: propose signals by name.")
    ] = None,
    recording: Annotated[
        Path | None, typer.Option("--from", metavar="RECORDING", help="Take cables and IMU rate from recorded columns.")
    ] = None,
    name: Annotated[str | None, typer.Option(metavar="TEXT", help="Name of the robot.")] = None,
    output: TextOutput = Path("robot.toml"),
    force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
) -> None:
    """Write a commented robot.toml to start from. Its places of the cables are an example: replace them.

    RECORDING is any file that import reads. Then: inertiactl compile robot.toml -o robot.cfg
    """
    from inertiad.exchange import channels, foreign_import
    from inertiad.robot import template

    if str(output) != "-" and output.exists() and not force:
        raise InputError(f"{output}: is there already; choose another -o, or --force to overwrite it")
    title = name or (output.resolve().parent.name if str(output) != "-" else "robot")
    rate = None
    if recording is not None:
        found = channels.summary(recording, None, dbc or () if foreign_import.is_can_log(recording) else ())
        n_found, rate = channels.n_forces(found), channels.rate_of(found, "acc_x")
        if cables is None and n_found == 0 and not dbc:
            raise InputError(f"{recording}: no force channels recognised in it: give --cables N")
        cables = cables or n_found or None
    if dbc:
        start = template.start_from_dbc(title, dbc, cables, rate, output.parent)
    else:
        start = template.Start(title, cables or 8, rate)
    write_text(output, template.text(start))
    for quantity, others in start.choices.items():
        say(f"signals.{quantity} = {start.signals[quantity]}: might also be {', '.join(others)}")
    if start.missing:
        say(f"not found in the DBC, fill in before compile: {', '.join(start.missing)}")
    say(f"{start.n_cables} cables at example places: replace anchor and attachment of each")


@commands.command("help", epilog="Example: inertiactl help robot.toml")
def help_command(
    topic: Annotated[str, typer.Argument(metavar="TOPIC", help="robot.toml.")] = "robot.toml",
) -> None:
    """Print the reference of a file's keys, with types, ranges, units and defaults."""
    from inertiad.robot import reference

    if topic != "robot.toml":
        raise InputError(f'"{topic}": unknown topic: allowed: robot.toml; of a command: inertiactl COMMAND -h')
    typer.echo(reference.text())


@commands.command("schema", epilog="Example: inertiactl schema -o robot.schema.json")
def schema_command(output: TextOutput = Path("-")) -> None:
    """Write the JSON schema of robot.toml, so that editors complete and check its keys.

    Editors with a TOML language server read it by a first line #:schema ./robot.schema.json in robot.toml.
    """
    import json

    from inertiad.robot import reference

    write_text(output, json.dumps(reference.schema(), indent=2, ensure_ascii=False) + "\n")
