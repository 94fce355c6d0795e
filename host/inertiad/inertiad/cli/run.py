# SPDX-License-Identifier: Apache-2.0
"""Commands that make a run, and the one that checks it."""

from pathlib import Path
from typing import Annotated

import typer

from inertiad.base.channels import DEFAULT_URL
from inertiad.cli.options import RobotFile, RunFolder, Url, progress_shown, say, teller, written

commands = typer.Typer()


@commands.command(
    epilog="Example: inertiactl simulate firmware/robots/cogiro/robot.toml --faults modern --seed 1 -o run"
)
def simulate(
    robot: RobotFile,
    output: RunFolder,
    trajectory: Annotated[
        str | None,
        typer.Option(metavar="paper|hold|FILE.csv", help="Motion; default: paper, fitted to the robot where needed."),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="IMU and force samples; default: by --faults.")
    ] = None,
    faults: Annotated[
        str, typer.Option(metavar="PRESET|FILE", help="ideal, modern, paper, faults.. (below), or a TOML file.")
    ] = "modern",
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed; the same seed gives the same files.")] = 0,
    body: Annotated[
        Path | None, typer.Option(metavar="FILE", help="True body: mass, cog, inertia_cog; .toml or .json.")
    ] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="True mass instead of the body's.")] = None,
    pose: Annotated[str, typer.Option(metavar="X,Y,Z,R,P,Y", help="Pose of hold, m and rad.")] = "0,0,2,0,0,0",
    duration: Annotated[float, typer.Option(metavar="S", min=0.1, max=1e5, help="Duration of hold, s.")] = 10.0,
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="exact|rigid|elastic|FILE",
            help="Follow the trajectory exactly, or by forces; default: exact, elastic with fewer than 6 cables.",
        ),
    ] = None,
    payload: Annotated[
        list[str] | None,
        typer.Option(metavar="KG@S", help="Payload taken up at a time; also KG@S@x,y,z or BODY.toml@S."),
    ] = None,
) -> None:
    """Simulate a run: CAN log, tracker positions and the truth behind them.

    --plant rigid or elastic: forward dynamics under a tracking controller that keeps tensions within their limits.
    --faults also: lossy, dropouts, stuck, silent, blind, drift, clockstep, late: modern sensors plus this fault.
    Keys of a plant FILE: python -m pydoc inertiad.model.forward_dynamics; of a fault FILE:
    python -m pydoc inertiad.simulate.sensor_models
    """
    from inertiad.simulate import request as requests
    from inertiad.simulate import simulator

    words = requests.Arguments(trajectory, rate, faults, seed, body, mass, pose, duration, plant, tuple(payload or ()))
    with progress_shown() as progress:
        progress("choose the motion")
        run, remarks = requests.run_of(robot, words)
        simulated = simulator.simulate(run, output, progress)
    for line in (*remarks, *simulated.remarks):
        say(line)
    say(f"{output}: {simulated.n_frames} frames over {run.trajectory.duration:.1f} s")


@commands.command(epilog="Example: inertiactl encode robot.toml signals.csv --tracker tracker.csv -o run")
def encode(
    robot: RobotFile,
    signals: Annotated[Path, typer.Argument(metavar="SIGNALS", help="CSV: t,acc_x,..,gyro_z,q_w,..,q_z,f_1,..,f_m.")],
    output: RunFolder,
    tracker: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV: t,x,y,z [m].")] = None,
) -> None:
    """Convert recorded signals into a run folder with a CAN log that the daemon and other tools read.

    Columns of SIGNALS: s, m/s2 (specific force), rad/s, unit quaternion body to world (or roll,pitch,yaw in rad), N.
    Without --tracker, positions follow from length_1,..,length_m [m], attachment to anchor, there or in lengths.csv.
    """
    from inertiad.robot import description
    from inertiad.run import encode as encoder

    with progress_shown() as progress:
        progress("pack frames")
        n_frames, notes = encoder.encode(robot, description.load(robot), signals, tracker, output)
    for line in (*notes, f"{output}: {n_frames} frames"):
        say(line)


@commands.command(epilog="Example: inertiactl verify run --bus file")
def verify(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder with robot.toml, can.log, tracker.csv.")],
    bus: Annotated[
        list[str] | None, typer.Option(metavar="file|socketcan:vcan0", help="Default: file; else one per bus.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Default: verify.json in RUN; -: stdout.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Verify this robot.cfg instead of compiling robot.toml.")
    ] = None,
    daemon: Annotated[Path | None, typer.Option(metavar="FILE", help="Another inertiad than build/bin's.")] = None,
    url: Url = DEFAULT_URL,
    latency_max: Annotated[float, typer.Option(metavar="S", help="p99 allowed, frame's stamp to message.")] = 0.1,
) -> None:
    """Run the daemon on a recorded run and verify its output. Exit code 1: a check failed.

    robot.toml and its DBC files are compared with the configuration of RUN, from the daemon's record
    run.lcmlog or robot.cfg. A check that could not be made is OPEN and does not fail.
    """
    from inertiad.check import verify as verifier

    buses = () if bus in (None, [], ["file"]) else tuple(bus or ())
    options = verifier.Options(run, buses, config, daemon, url, latency_max)
    with progress_shown() as progress:
        checks = verifier.verify(options, progress)
    tell = teller(json)
    for check in checks:
        tell(str(check))
    with written(json or run / "verify.json") as path:
        verifier.write(path, options, checks)
    n_failed, n_open = (sum(check.passed is verdict for check in checks) for verdict in (False, None))
    left = f", {n_open} could not be made" if n_open else ""
    tell(f"{'FAIL' if n_failed else 'PASS'}: {len(checks) - n_failed - n_open} of {len(checks)} passed{left}")
    if n_failed:
        raise typer.Exit(1)
