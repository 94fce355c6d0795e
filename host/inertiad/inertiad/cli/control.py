# SPDX-License-Identifier: Apache-2.0
"""The command that closes the loop."""

from pathlib import Path
from typing import Annotated

import typer

from inertiad.cli.options import Figures, Folder, RobotFile, command_line, progress_shown, say, say_written

commands = typer.Typer()


@commands.command(
    epilog="Example: inertiactl control firmware/robots/cogiro/robot.toml --mass 91 --payload 70@12 -o control"
)
def control(
    robot: RobotFile,
    output: Folder,
    payload: Annotated[
        list[str] | None,
        typer.Option(metavar="KG@S", help="Payload taken up at a time; also KG@S@x,y,z or BODY.toml@S."),
    ] = None,
    bandwidth: Annotated[str, typer.Option(metavar="HZ,..", help="Of the controller of the pose.")] = "1.5",
    arms: Annotated[
        str, typer.Option(metavar="ARM,..", help="Where parameters come from.")
    ] = "nominal,live,oracle,adaptive",
    pose: Annotated[
        str, typer.Option(metavar="true|measured", help="Of the controller: measured by tracker and IMU, late.")
    ] = "true",
    plant: Annotated[str, typer.Option(metavar="rigid|elastic|FILE", help="As in simulate.")] = "rigid",
    faults: Annotated[str, typer.Option(metavar="PRESET|FILE", help="As in simulate.")] = "modern",
    seeds: Annotated[
        int, typer.Option(metavar="N", min=1, help="Seeds 0 to N - 1; the same seeds, the same bytes.")
    ] = 1,
    trajectory: Annotated[str | None, typer.Option(metavar="paper|hold|FILE.csv", help="As in simulate.")] = None,
    body: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Body at the start, known as nominal; .toml or .json.")
    ] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="Its mass instead of [nominal]'s.")] = None,
    announce: Annotated[
        list[str] | None,
        typer.Option(metavar="payload|KG@S", help="Tell the daemon 1 s before: what --payload says, or another one."),
    ] = None,
    kill: Annotated[
        float | None, typer.Option(metavar="S", help="Kill the daemon then; it comes back 1 s later.")
    ] = None,
    figures: Figures = None,
) -> None:
    """Control a simulated robot with the daemon's live parameters, beside nominal, exact and adapted ones.

    The daemon runs in its own process, in lock-step: frames and positions with faults go in, and commands; ESTIMATE
    comes out and reaches the controller through the parameter gate. Writes control.json and control.html.
    Exit code 1: live parameters were worse than nominal ones, commands were cut off at the limits of the tensions, or
    the platform was lost.
    Arms: nominal: the body at the start; live; oracle: the true body; adaptive: Slotine and Li's law.
    """
    from inertiad.base import finding
    from inertiad.base.error import InputError
    from inertiad.control import experiment, request
    from inertiad.report import control as reporter
    from inertiad.run import folder

    if pose not in ("true", "measured"):
        raise InputError(f'--pose "{pose}": allowed: true, measured')
    words = request.Arguments(
        tuple(payload or ()),
        bandwidth,
        arms,
        pose == "measured",
        plant,
        faults,
        seeds,
        trajectory,
        body,
        mass,
        kill,
        announce=tuple(announce or ()),
    )
    with progress_shown() as progress:
        progress("choose the motion")
        wanted, remarks = request.request_of(robot, words)
        folder.open_run(output)
        outcomes = experiment.run_all(wanted, progress)
        progress("write")
        experiment.write_json(output / "control.json", outcomes)
        reporter.write(output / "control.html", figures, wanted, outcomes, command_line())
    for line in (*remarks, *experiment.notes(outcomes)):
        say(line)
    for line in experiment.lines(outcomes):
        typer.echo(line)
    verdict = reporter.judge(outcomes)
    for line in finding.lines(verdict.findings):
        typer.echo(line)
    say_written(output / "control.html")
    if verdict.severity == "stop":
        raise typer.Exit(1)
