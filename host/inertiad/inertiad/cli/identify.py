# SPDX-License-Identifier: Apache-2.0
"""Commands that identify: the body, the sensors' errors, the delays, and reports of them."""

from pathlib import Path
from typing import Annotated

import typer

from inertiad.cli.options import (
    Figures,
    Picture,
    RobotFile,
    command_line,
    is_stdout,
    only_one_to_stdout,
    progress_shown,
    say,
    say_written,
    teller,
    written,
)

commands = typer.Typer()


@commands.command(epilog="Example: inertiactl fit run1 run2 --method joint --json estimate.json --validate run3")
def fit(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN|SIGNALS.csv...", help="Runs of one body.")],
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description, where a run has none.")
    ] = None,
    method: Annotated[str, typer.Option(metavar="joint|wls|iv|paper", help="Method; see below.")] = "joint",
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write estimate.json; -: stdout.")] = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option("--validate", metavar="RUN", help="Run that is not fitted, to test the prediction on."),
    ] = None,
    picture: Picture = None,
) -> None:
    """Identify the body offline, from any number of runs together.

    Exit status 0: good or usable with care, 1: not to be used (the file says why), 2: bad usage or input.

    joint: body and sensor errors together, the optimum. wls: plain weighted least squares. iv: instrumental variables.
    paper: the two-step method of the source paper.
    """
    from inertiad.base import extras, finding
    from inertiad.identify import estimate_document, identification
    from inertiad.identify import fit as fitter

    only_one_to_stdout(json, picture)
    if picture is not None:
        extras.require("plotly", "--picture")
        from inertiad.report import picture as pictures

        pictures.check(picture)
    with progress_shown() as progress:
        progress("read")
        described, recordings = fitter.read(runs, robot, method)
        done = identification.identify(method, described, recordings, validate or [], robot, progress)
    if done.estimate is not None:
        teller(picture if is_stdout(picture) else json)(fitter.text(done.estimate, fitter.truth_of(runs)))
        for line in fitter.remarks(done.estimate, recordings, done.validations):
            say(line)
    for line in finding.lines(done.findings):
        say(line)
    if json is not None:
        document = estimate_document.document(
            described, done.estimate, recordings, done.validations, done.findings, done.segments
        )
        with written(json) as path:
            estimate_document.write(path, document)
    if picture is not None:
        with written(picture) as path:
            pictures.write(path, pictures.of_fit(done, recordings, command_line()))
        say_written(picture)
    if finding.verdict(done.findings) == "stop":
        raise typer.Exit(1)


@commands.command(epilog="Example: inertiactl report run1 run2 -o report.html --figures figures")
def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run folders, signals CSVs or LCM logs.")],
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description, where a run has none.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Page to write; default: report.html in RUN; -: stdout."),
    ] = None,
    figures: Figures = None,
) -> None:
    """Write a page on runs of one body: verdict, result, limiting errors, next step. Opens without a network."""
    from inertiad.base import extras

    extras.require("plotly", "report")
    from inertiad.report import document

    page = output or (runs[0] / "report.html" if len(runs) == 1 and runs[0].is_dir() else Path("report.html"))
    with progress_shown() as progress, written(page) as path:
        summary = document.write(runs, robot, path, figures, command_line(), progress)
    for line in summary:
        say(line)
    say_written(page)


@commands.command(epilog="Example: inertiactl paper --seeds 30 -o paper.html")
def paper(
    seeds: Annotated[int, typer.Option(metavar="N", min=1, max=10_000, help="Experiments.")] = 30,
    first: Annotated[int, typer.Option(metavar="N", min=0, help="First seed.")] = 1000,
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot with a [nominal] body; default: CoGiRo.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Page to write; -: stdout.")] = Path(
        "paper.html"
    ),
    figures: Figures = None,
) -> None:
    """Repeat the experiment of Tempel et al. (ICRA 2017) with its method, and with the joint fit on the same data."""
    from inertiad.base import extras
    from inertiad.base.installation import example_robot

    extras.require("plotly", "paper")
    from inertiad.check import paper_experiment
    from inertiad.report import reproduction

    with progress_shown() as progress:
        found = paper_experiment.reproduce(robot or example_robot(), first, seeds, None, progress)
        progress("draw")
        with written(output) as path:
            reproduction.write(found, path, figures, command_line())
    teller(output)(reproduction.text(found))
    say_written(output)


@commands.command(epilog="Example: inertiactl calibrate robot.toml run1 run2 --payload run2=20.0 -o calibration.toml")
def calibrate(
    robot: RobotFile,
    runs: Annotated[list[Path], typer.Argument(metavar="RUN|SIGNALS.csv...", help="Runs with the same sensors.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Calibration to write, TOML; -: stdout.")
    ],
    payload: Annotated[
        list[str] | None, typer.Option("--payload", metavar="RUN=KG", help="Known added mass in a run.")
    ] = None,
    tare: Annotated[
        Path | None, typer.Option(metavar="FILE", help="CSV t,f_1..f_m recorded with no tension in any cable.")
    ] = None,
) -> None:
    """Estimate the sensors' systematic errors, name unobservable ones, and write the calibration for robot.toml.

    In robot.toml: [calibration] file = "calibration.toml". Exit status 0: written, 1: not to be used, so
    not written, 2: bad usage or input.
    """
    from inertiad.base import finding
    from inertiad.identify import calibrate as calibrator
    from inertiad.identify import fit as fitter

    with progress_shown() as progress:
        progress("read and solve")
        result, recordings = calibrator.main(robot, runs, payload or [], tare)
    teller(output)(calibrator.text(result))
    for mass, estimate in zip(result.payloads, result.estimates, strict=True):
        say(f"payload {mass:g} kg: mass {estimate.body.value[0]:.3f} ± {estimate.body.std[0]:.3f} kg")
    for line in fitter.remarks(result.estimates[0], recordings, []):
        say(line)
    for line in calibrator.correlations(result):
        say(line)
    for direction in result.directions:
        say(f"not observable: {direction}")
    for line in finding.lines(result.findings):
        say(line)
    if finding.verdict(result.findings) == "stop":
        say(f"{output}: not written")
        raise typer.Exit(1)
    with written(output) as path:
        calibrator.write(path, result)
    say_written(output)


@commands.command(epilog="Example: inertiactl sync run")
def sync(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Run folder: robot.toml, can.log or signals.csv, tracker.csv.")
    ],
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Default: sync.json in RUN; -: stdout.")
    ] = None,
    picture: Picture = None,
) -> None:
    """Estimate the delays of tracker and forces against the IMU, their sigmas, and the error that wrong delays cause.

    In robot.toml: [calibration] sync = "sync.json", for compile, fit and all others.
    """
    from inertiad.base import extras
    from inertiad.identify import sync as synchroniser

    only_one_to_stdout(json, picture)
    if picture is not None:
        extras.require("plotly", "--picture")
        from inertiad.report import picture as pictures

        pictures.check(picture)
    with progress_shown() as progress:
        found = synchroniser.sync(run, progress)
        drawn = None if picture is None else synchroniser.curves(found, progress)
    for line in synchroniser.text(found):
        teller(picture if is_stdout(picture) else json)(line)
    with written(json or run / "sync.json") as path:
        synchroniser.write(path, found)
    if picture is not None and drawn is not None:
        with written(picture) as path:
            pictures.write(path, pictures.of_sync(found, drawn, command_line()))
        say_written(picture)
