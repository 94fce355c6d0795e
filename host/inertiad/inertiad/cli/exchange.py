# SPDX-License-Identifier: Apache-2.0
"""Commands for the files of other tools."""

from pathlib import Path
from typing import Annotated

import typer

from inertiad.base.channels import DEFAULT_PREFIX
from inertiad.cli.options import RunFolder, is_stdout, progress_shown, say, written

commands = typer.Typer()


@commands.command("export", epilog="Example: inertiactl export run --to parquet -o run.parquet")
def export_command(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN", help="Run folder, .lcmlog of the daemon, CAN log, or estimate.json; for fmu: robot.toml."
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="csv parquet mcap mat mf4 candump; of the body: urdf mjcf json; of a robot: fmu.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write; -: stdout.")],
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description, where the run has none.")
    ] = None,
    prefix: Annotated[str, typer.Option(metavar="TEXT", help="Channel prefix in an .lcmlog.")] = DEFAULT_PREFIX,
) -> None:
    """Write a run for other tools: signals, tracker, estimates, frames, events, health, all with units.

    csv and parquet hold one of these each: FILE the first, FILE's stem.tracker.csv and so on the others. urdf, mjcf
    and json hold the identified body in the platform frame. fmu is the feed-forward for Simulink and other tools (FMI
    3.0): parameters are inputs, wrench and tensions outputs. Layouts: python -m pydoc inertiad.exchange.file_formats
    """
    from inertiad.exchange import convert

    remarks: list[str] = []
    with progress_shown() as progress:
        progress(f"write {output}")
        with written(output, f".{to}") as path:
            contents = convert.export(run, to, path, robot, prefix, remarks)
        if is_stdout(output) and len(contents) > 1:
            written_part = "the first table only" if to in ("csv", "parquet") else "without the layouts"
            remarks.append(f"-: {written_part}; with a FILE each gets a file of its own")
    for line in remarks if is_stdout(output) else (*remarks, *contents):
        say(line)


@commands.command("import", epilog="Example: inertiactl import run.mf4 -o run")
def import_command(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A file of export, or .csv .parquet .mat .mf4 .mcap, ROS bag, CAN log of others."
        ),
    ],
    output: RunFolder,
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description to put into the run.")
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option("--map", metavar="MAP", help="Channels by quantity, TOML, as import proposes it.")
    ] = None,
    dbc: Annotated[
        list[Path] | None,
        typer.Option("--dbc", metavar="FILE", help="DBC of a CAN log's bus, also several: its signals are channels."),
    ] = None,
    tracker: Annotated[
        Path | None, typer.Option("--tracker", metavar="FILE", help="Positions that another program recorded.")
    ] = None,
    tracker_start: Annotated[
        float | None,
        typer.Option(metavar="S", help="Time in the first FILE at which the clock of --tracker is 0."),
    ] = None,
) -> None:
    """Convert another tool's file into a run folder: signals.csv, tracker.csv, can.log, as far as it holds them.

    A file with other names, units or separators, or with sensors of different rates: its channels are listed, a mapping
    to quantities is proposed from names, units and values, used, and written into RUN, to be changed and given back
    by --map. Read like this: CSV, Parquet, MATLAB 5 and 7.3, MDF 4, MCAP (JSON, protobuf), ROS bags (the folder of
    ROS 2), exports of Motive, Vicon and Qualisys, and with --dbc CAN logs (.log .asc .blf .trc .mf4).

    --tracker joins the positions of a second recording to the first. Their clocks may differ: unless --tracker-start
    says by how much, the motion does, and whether y or z points up. A CAN log needs --dbc, or --robot with [signals].
    """
    from inertiad.base.error import InputError
    from inertiad.exchange import channels, convert, foreign_import

    remarks: list[str] = []
    with progress_shown() as progress:
        progress(f"read {file}")
        if tracker_start is not None and tracker is None:
            raise InputError("--tracker-start without --tracker: pass both, or neither")
        if mapping is not None or dbc or tracker is not None or convert.is_foreign(file):
            chosen = None if mapping is None else channels.read_mapping(mapping)
            second = None if tracker is None else foreign_import.Tracker(tracker, tracker_start)
            contents = foreign_import.import_mapped(file, output, robot, chosen, remarks, dbc or (), second)
        else:
            contents = convert.import_file(file, output, robot, remarks)
    for line in (*remarks, *contents):
        say(line)
