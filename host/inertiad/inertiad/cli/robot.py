# SPDX-License-Identifier: Apache-2.0
"""Commands for a robot: its configuration, and motions to identify it with."""

from pathlib import Path
from typing import Annotated

import typer

from inertiad.cli.options import (
    Json,
    RobotFile,
    command_line,
    is_stdout,
    only_one_to_stdout,
    progress_shown,
    say,
    say_written,
    write_json,
    written,
)

commands = typer.Typer()


@commands.command("compile", epilog="Example: inertiactl compile firmware/robots/cogiro/robot.toml -o robot.cfg")
def compile_command(
    robot: RobotFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Configuration to write; -: stdout.")],
    blind: Annotated[
        bool, typer.Option("--blind", help="Leave [nominal] out: the estimate starts from nothing.")
    ] = False,
    json: Json = None,
) -> None:
    """Check a robot description and its DBC files and write the daemon's configuration.

    All mistakes are listed at once. Lines that begin with care: allowed, but most likely wrong. Every key of robot.toml
    with its range and default: inertiactl help robot.toml
    """
    from inertiad.base import finding
    from inertiad.robot import description, geometry

    only_one_to_stdout(output, json)
    described = description.load(robot)
    if blind:
        described = described.model_copy(update={"nominal": None})
    data, findings = geometry.compiled(described, str(robot))
    with written(output) as path:
        path.write_bytes(data)
    for line in finding.lines(findings)[1:]:
        say(line)
    if not is_stdout(output):
        say(f"{output}: {len(data)} bytes")
    if json is not None:
        write_json(
            json, {"robot": described.name, "file": str(output), "bytes": len(data), **finding.document(findings)}
        )


@commands.command(epilog="Example: inertiactl view robot.toml -o robot.html")
def view(
    source: Annotated[Path, typer.Argument(metavar="ROBOT|RUN", help="Robot description, or a run folder with one.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Page to write; -: stdout.")] = Path(
        "view.html"
    ),
) -> None:
    """Draw a robot as a page in 3D: anchors, pulleys, cables, platform, sensors, workspace; of a run also the motion.

    The page opens without a network and lists what looks wrong in the description.
    """
    from inertiad.base import extras

    extras.require("plotly", "view")
    from inertiad.report import view as viewer

    with progress_shown() as progress, written(output) as path:
        lines = viewer.write(source, path, command_line(), progress)
    for line in lines:
        say(line)
    say_written(output)


@commands.command(epilog="Example: inertiactl excite firmware/robots/cogiro/robot.toml --duration 20 -o excite.csv")
def excite(
    robot: RobotFile,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Pose CSV, beside it FILE.json; -: stdout.")
    ],
    motion: Annotated[
        str, typer.Option(metavar="optimal|paper", help="Optimised, or two poses back and forth.")
    ] = "optimal",
    duration: Annotated[float, typer.Option(metavar="S", help="Duration of the whole motion.")] = 20.0,
    sigma: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Wanted sigmas, for the shortest motion: mass=0.2%,cog=1mm,inertia=1%."),
    ] = None,
    poses: Annotated[int, typer.Option(metavar="N", min=0, max=60, help="Static poses instead of a motion.")] = 0,
    hold: Annotated[float, typer.Option(metavar="S", min=0.5, max=100, help="Time at each static pose.")] = 3.0,
    start: Annotated[
        str | None, typer.Option(metavar="POSE", help="x,y,z,roll,pitch,yaw in m and deg; default: middle of the box.")
    ] = None,
    end: Annotated[str | None, typer.Option(metavar="POSE", help="Other end of the paper motion.")] = None,
    criterion: Annotated[str, typer.Option(metavar="A|D", help="Sum of variances, or volume of uncertainty.")] = "A",
    starts: Annotated[int, typer.Option(metavar="N", min=1, max=200, help="Searches from random motions.")] = 4,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed; the same seed gives the same file.")] = 0,
    box: Annotated[str | None, typer.Option(metavar="M", help="x_min,y_min,z_min,x_max,y_max,z_max of P.")] = None,
    tilt: Annotated[
        float, typer.Option(metavar="DEG", min=1.0, max=80.0, help="Greatest tilt of the platform.")
    ] = 30.0,
    yaw: Annotated[float, typer.Option(metavar="DEG", min=1.0, max=170.0, help="Greatest yaw, either way.")] = 35.0,
    speed: Annotated[
        float, typer.Option(metavar="M/S", min=0.01, max=100.0, help="Greatest of the tracked point.")
    ] = 4.0,
    acceleration: Annotated[
        float, typer.Option(metavar="M/S2", min=0.01, max=100.0, help="Greatest of the tracked point.")
    ] = 2.0,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw motion, tensions, sigma ellipses; -: stdout.")
    ] = None,
) -> None:
    """Plan the most informative motion for mass, CoG and inertia within the robot's limits, and predict the sigmas.

    The file holds t, pose, velocities and accelerations; simulate --trajectory reads it.
    """
    from inertiad.excite import plan_file
    from inertiad.excite import request as requests

    only_one_to_stdout(output, picture)
    words = requests.Arguments(
        motion, duration, sigma, poses, hold, start, end, criterion, box, tilt, yaw, speed, acceleration
    )
    with progress_shown() as progress:
        request, plan = requests.plan(robot, words, starts, seed, progress)
        with written(output) as path:
            plan_file.write_csv(path, request, plan)
        if not is_stdout(output):
            plan_file.write_json(output.with_suffix(".json"), request, plan)
        if picture is not None:
            with written(picture, ".png") as path:
                plan_file.draw(path, request, plan)
    for line in plan_file.summary(plan):
        say(line)
