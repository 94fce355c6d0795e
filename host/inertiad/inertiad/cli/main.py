# SPDX-License-Identifier: Apache-2.0
"""inertiactl: the command line. Commands only parse, call one module and say what came out.

Exit codes: 0 good, 1 a check failed, 2 bad usage or input, with one line on stderr.
"""

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.exceptions import TyperException

from inertiad.base.channels import DEFAULT_PREFIX, DEFAULT_URL
from inertiad.base.error import InputError

HELP = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="inertiactl",
    help="Describe a robot, simulate or import a run, watch what the daemon identifies.",
    context_settings=HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

RobotFile = Annotated[Path, typer.Argument(metavar="ROBOT", help="Robot description, robot.toml.")]
RunFolder = Annotated[Path, typer.Option("-o", "--output", metavar="RUN", help="Run folder to write.")]
Url = Annotated[str, typer.Option("--lcm", metavar="URL", help="LCM network.")]
Prefix = Annotated[str, typer.Option(metavar="TEXT", help="Channel prefix.")]


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A spinner with the current step on stderr, if that is a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda step: None
        return
    with console.status("start") as status:
        yield lambda step: status.update(f"{step} ...")


def _command() -> str:
    """What was typed."""
    return shlex.join(["inertiactl", *sys.argv[1:]])


def _say(text: str) -> None:
    typer.echo(text, err=True)


@app.command("compile", epilog="Example: inertiactl compile firmware/robots/cogiro/robot.toml -o robot.cfg")
def compile_command(
    robot: RobotFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Configuration to write.")],
    blind: Annotated[
        bool, typer.Option("--blind", help="Leave [nominal] out: the estimate starts from nothing.")
    ] = False,
) -> None:
    """Check a robot description and its DBC files and write the daemon's configuration.

    Every key of robot.toml with its default: python -m pydoc inertiad.robot.description
    """
    from inertiad.robot import configuration, description

    described = description.load(robot)
    if blind:
        described = described.model_copy(update={"nominal": None})
    n_bytes = configuration.write(output, described, str(robot))
    _say(f"{output}: {n_bytes} bytes")


@app.command(epilog="Example: inertiactl simulate firmware/robots/cogiro/robot.toml --faults modern --seed 1 -o run")
def simulate(
    robot: RobotFile,
    output: RunFolder,
    trajectory: Annotated[str, typer.Option(metavar="paper|hold|FILE.csv", help="What the platform does.")] = "paper",
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="IMU and force samples; default: by --faults.")
    ] = None,
    faults: Annotated[
        str, typer.Option(metavar="PRESET|FILE", help="ideal, modern, paper, faults.. (below), or a TOML file.")
    ] = "modern",
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Same seed, same files.")] = 0,
    body: Annotated[
        Path | None, typer.Option(metavar="FILE", help="True body: mass, cog, inertia_cog; .toml or .json.")
    ] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="True mass instead of the body's.")] = None,
    pose: Annotated[str, typer.Option(metavar="X,Y,Z,R,P,Y", help="Pose of hold, m and rad.")] = "0,0,2,0,0,0",
    duration: Annotated[float, typer.Option(metavar="S", min=0.1, max=1e5, help="Duration of hold, s.")] = 10.0,
    plant: Annotated[
        str, typer.Option(metavar="exact|rigid|elastic|FILE", help="Follow the trajectory exactly, or by forces.")
    ] = "exact",
    payload: Annotated[
        list[str] | None, typer.Option(metavar="KG@S", help="Taken up at a time; KG@S@x,y,z or BODY.toml@S.")
    ] = None,
) -> None:
    """Simulate a run: CAN log, tracker positions and the truth behind them.

    --plant rigid or elastic: forward dynamics under a tracking controller that keeps tensions within their limits.
    --faults also: lossy, dropouts, stuck, silent, blind, drift, clockstep, late: modern sensors with that on top.
    Keys of a plant FILE: python -m pydoc inertiad.model.forward_dynamics; of a fault FILE:
    python -m pydoc inertiad.simulate.sensor_models
    """
    from inertiad.model import forward_dynamics
    from inertiad.model import payload as payloads
    from inertiad.model import trajectory as trajectories
    from inertiad.robot import description
    from inertiad.simulate import sensor_models, simulator

    described = description.load(robot)
    level = sensor_models.faults(faults)
    true_body = simulator.body_of(described, robot, body, mass)
    path = trajectories.named(trajectory, pose, duration)
    run = simulator.Run(
        robot_file=robot,
        robot=described,
        body=true_body,
        trajectory=path,
        trajectory_name=trajectory,
        level=level,
        faults_name=faults,
        rate=level.rate if rate is None else rate,
        seed=seed,
        plant=forward_dynamics.plant(plant, described),
        payloads=payloads.parse_all(payload or [], true_body, path.duration),
    )
    with _progress() as progress:
        simulated = simulator.simulate(run, output, progress)
    for line in simulated.remarks:
        _say(line)
    _say(f"{output}: {simulated.n_frames} frames over {run.trajectory.duration:.1f} s")


@app.command(epilog="Example: inertiactl encode robot.toml signals.csv --tracker tracker.csv -o run")
def encode(
    robot: RobotFile,
    signals: Annotated[Path, typer.Argument(metavar="SIGNALS", help="CSV: t,acc_x,..,gyro_z,q_w,..,q_z,f_1,..,f_m.")],
    output: RunFolder,
    tracker: Annotated[Path | None, typer.Option(metavar="FILE", help="CSV: t,x,y,z [m].")] = None,
) -> None:
    """Turn recorded signals into a run folder with a CAN log that the daemon and other tools read.

    Columns of SIGNALS: s, m/s2 (specific force), rad/s, unit quaternion body to world (or roll,pitch,yaw in rad), N.
    """
    from inertiad.robot import description
    from inertiad.run import encode as encoder

    with _progress() as progress:
        progress("pack frames")
        n_frames = encoder.encode(robot, description.load(robot), signals, tracker, output)
    _say(f"{output}: {n_frames} frames")


@app.command(epilog="Example: inertiactl excite firmware/robots/cogiro/robot.toml --duration 20 -o excite.csv")
def excite(
    robot: RobotFile,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Pose CSV; beside it FILE.json.")],
    motion: Annotated[str, typer.Option(metavar="optimal|paper", help="Best found, or there and back.")] = "optimal",
    duration: Annotated[float, typer.Option(metavar="S", help="Of the whole motion.")] = 20.0,
    sigma: Annotated[
        str | None, typer.Option(metavar="TEXT", help="Shortest that reaches, e.g. mass=0.2%,cog=1mm,inertia=1%.")
    ] = None,
    poses: Annotated[int, typer.Option(metavar="N", min=0, max=60, help="Instead: N poses at rest.")] = 0,
    hold: Annotated[float, typer.Option(metavar="S", min=0.5, max=100, help="At each of --poses.")] = 3.0,
    start: Annotated[
        str | None, typer.Option(metavar="POSE", help="x,y,z,roll,pitch,yaw in m and deg; default: middle of the box.")
    ] = None,
    end: Annotated[str | None, typer.Option(metavar="POSE", help="Other end of paper.")] = None,
    criterion: Annotated[str, typer.Option(metavar="A|D", help="Sum of variances, or volume of uncertainty.")] = "A",
    starts: Annotated[int, typer.Option(metavar="N", min=1, max=200, help="Searches from random motions.")] = 4,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Same seed, same file.")] = 0,
    box: Annotated[str | None, typer.Option(metavar="M", help="x_min,y_min,z_min,x_max,y_max,z_max of P.")] = None,
    tilt: Annotated[float, typer.Option(metavar="DEG", min=1.0, max=80.0, help="At most, from level.")] = 30.0,
    yaw: Annotated[float, typer.Option(metavar="DEG", min=1.0, max=170.0, help="At most, either way.")] = 35.0,
    speed: Annotated[float, typer.Option(metavar="M/S", min=0.01, max=100.0, help="Tracker's limit.")] = 4.0,
    acceleration: Annotated[float, typer.Option(metavar="M/S2", min=0.01, max=100.0, help="Tracker's limit.")] = 2.0,
    picture: Annotated[Path | None, typer.Option(metavar="PNG", help="Draw motion, tensions, sigma ellipses.")] = None,
) -> None:
    """Plan a motion that tells mass, CoG and inertia as well as the cables allow, and predict how well.

    The file holds t, pose, velocities and accelerations; simulate --trajectory reads it.
    """
    from inertiad.excite import plan_file
    from inertiad.excite import request as asked

    words = asked.Asked(
        motion, duration, sigma, poses, hold, start, end, criterion, box, tilt, yaw, speed, acceleration
    )
    with _progress() as progress:
        request, plan = asked.plan(robot, words, starts, seed, progress)
        plan_file.write_csv(output, request, plan)
        plan_file.write_json(output.with_suffix(".json"), request, plan)
        if picture is not None:
            plan_file.draw(picture, request, plan)
    for line in plan_file.spoken(plan):
        _say(line)


@app.command(epilog="Example: inertiactl watch --seconds 10")
def watch(
    url: Url = DEFAULT_URL,
    prefix: Prefix = DEFAULT_PREFIX,
    seconds: Annotated[float | None, typer.Option(metavar="S", min=0.0, help="Stop after this long.")] = None,
) -> None:
    """Show the daemon's estimate with its standard deviations, buses, latencies, losses and events, live."""
    from inertiad.live import watch as watcher

    watcher.watch(url, prefix, seconds)


@app.command(epilog='Example: inertiactl command mark "load on"')
def command(
    name: Annotated[str, typer.Argument(metavar="freeze|resume|reset|tare|configure|mark")],
    argument: Annotated[
        str | None, typer.Argument(metavar="[FILE|TEXT]", help="FILE of configure, TEXT of mark.")
    ] = None,
    url: Url = DEFAULT_URL,
    prefix: Prefix = DEFAULT_PREFIX,
    patience: Annotated[
        float, typer.Option("--wait", metavar="S", min=0.0, help="Wait this long for an answer.")
    ] = 3.0,
) -> int:
    """Tell a running daemon what to do and print its answer.

    freeze: learn nothing more; resume: learn again; reset: start from the prior; tare: take the gyro's bias at rest;
    configure FILE: use this compiled configuration; mark TEXT: note it in the record.

    Exit status 0: done, 1: the daemon refused, 2: nobody answered.
    """
    from inertiad.live import command as commands

    answer = commands.send(commands.make(name, argument), url, prefix, patience)
    if answer is None:
        raise InputError(f"--lcm {url}: no answer on {prefix}EVENT within {patience:g} s: does inertiad run there?")
    typer.echo(answer.text)
    return 0 if answer.is_done else 1


@app.command(epilog="Example: inertiactl replay run --bus socketcan:vcan0 --speed 1")
def replay(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder, or a log: .log .asc .blf .trc .mf4 .lcmlog.")],
    bus: Annotated[
        list[str] | None,
        typer.Option(metavar="ADDRESS", help="socketcan:vcan0, one per bus of the log; -: candump lines on stdout."),
    ] = None,
    speed: Annotated[float, typer.Option(metavar="S", help="Log seconds per second.")] = 1.0,
    loop: Annotated[int, typer.Option(metavar="N", min=1, help="Play it this often.")] = 1,
    start: Annotated[float, typer.Option(metavar="S", min=0.0, help="Leave out what is before, s.")] = 0.0,
    stop: Annotated[float | None, typer.Option(metavar="S", help="Leave out what is after, s.")] = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            metavar="lcm|none|FORMAT=ADDRESS",
            help="Where tracker.csv goes; default: lcm, none with --bus -. An emulated instrument: "
            "dtrack=udp:127.0.0.1:5000, formats and addresses as in record.",
        ),
    ] = None,
    url: Url = DEFAULT_URL,
    prefix: Prefix = DEFAULT_PREFIX,
) -> None:
    """Play a run again as it was recorded: frames to CAN or stdout, tracker positions as LCM messages."""
    from inertiad.live import replay as replayer

    layout, address = replayer.emulated(tracker)
    buses, remarks = bus or [], list[str]()
    is_tracked = tracker not in (None, "none") or (tracker is None and buses != ["-"])
    options = replayer.Options(run, buses, speed, loop, start, stop, is_tracked, url, prefix, layout, address)
    with _progress() as progress:
        progress(f"play {run}")
        played = replayer.replay(options, remarks)
    for line in (*remarks, *played.lateness):
        _say(str(line))
    waits = f", {played.n_waits} times a queue was full" if played.n_waits else ""
    unsent = f", stopped with {played.n_unsent} unsent" if played.n_unsent else ""
    _say(f"{played.duration:.3f} s{waits}{unsent}")


@app.command(epilog="Example: inertiactl fit run1 run2 --method joint --json estimate.json --validate run3")
def fit(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN|SIGNALS.csv...", help="Runs of one body.")],
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description, where a run has none.")
    ] = None,
    method: Annotated[str, typer.Option(metavar="joint|wls|iv|paper", help="How; see below.")] = "joint",
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write estimate.json.")] = None,
    validate: Annotated[
        list[Path] | None, typer.Option("--validate", metavar="RUN", help="Predict this run, which is not used.")
    ] = None,
) -> None:
    """Identify the body offline, from any number of runs together.

    Exit status 0: good or usable with care, 1: not to be used (the file says why), 2: bad usage or input.

    joint: body and sensor errors together, the optimum. wls: plain weighted least squares. iv: instrumental variables.
    paper: the two-step method of the source paper.
    """
    from inertiad.base import finding
    from inertiad.identify import fit as fitter
    from inertiad.identify import identification

    with _progress() as progress:
        progress("read")
        described, recordings = fitter.read(runs, robot, method)
        done = identification.identify(method, described, recordings, validate or [], robot, progress)
    if done.estimate is not None:
        typer.echo(fitter.text(done.estimate, fitter.truth_of(runs)))
        for line in fitter.remarks(done.estimate, recordings, done.validations):
            _say(line)
    for line in finding.lines(done.findings):
        _say(line)
    if json is not None:
        data = fitter.document(described, done.estimate, recordings, done.validations, done.findings, done.segments)
        fitter.write(json, data)
    if finding.verdict(done.findings) == "stop":
        raise typer.Exit(1)


@app.command(epilog="Example: inertiactl report run1 run2 -o report.html --figures figures")
def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run folders, signals CSVs or LCM logs.")],
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description, where a run has none.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Page to write; default: report.html in RUN.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write every figure there as PNG and PDF, too.")
    ] = None,
) -> None:
    """One page about runs of one body: verdict, result, what limits it, what to do next. Opens without a network."""
    from inertiad.report import document

    page = output or (runs[0] / "report.html" if len(runs) == 1 and runs[0].is_dir() else Path("report.html"))
    with _progress() as progress:
        spoken = document.write(runs, robot, page, figures, _command(), progress)
    for line in spoken:
        _say(line)
    _say(f"{page}: written")


@app.command(epilog="Example: inertiactl paper --seeds 30 -o paper.html")
def paper(
    seeds: Annotated[int, typer.Option(metavar="N", min=1, max=10_000, help="Experiments.")] = 30,
    first: Annotated[int, typer.Option(metavar="N", min=0, help="First seed.")] = 1000,
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="With a [nominal] body; default: CoGiRo.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Page to write.")] = Path("paper.html"),
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write every figure there as PNG and PDF, too.")
    ] = None,
) -> None:
    """Repeat the experiment of Tempel et al. (ICRA 2017) with its method, and with ours on the same data."""
    from inertiad.check import paper_experiment
    from inertiad.report import reproduction

    with _progress() as progress:
        found = paper_experiment.reproduce(robot or paper_experiment.ROBOT, first, seeds, None, progress)
        progress("draw")
        reproduction.write(found, output, figures, _command())
    typer.echo(reproduction.text(found))
    _say(f"{output}: written")


@app.command(epilog="Example: inertiactl calibrate robot.toml run1 run2 --payload run2=20.0 -o calibration.toml")
def calibrate(
    robot: RobotFile,
    runs: Annotated[list[Path], typer.Argument(metavar="RUN|SIGNALS.csv...", help="Runs with the same sensors.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Calibration to write, TOML.")],
    payload: Annotated[
        list[str] | None, typer.Option("--payload", metavar="RUN=KG", help="Known added mass on the robot in a run.")
    ] = None,
    tare: Annotated[
        Path | None, typer.Option(metavar="FILE", help="CSV t,f_1..f_m recorded with no tension in any cable.")
    ] = None,
) -> None:
    """Find the sensors' systematic errors, say what the runs cannot tell, and write what compile takes in.

    In robot.toml: [calibration] file = "calibration.toml". Exit status 0: written, 1: not to be used, so
    not written, 2: bad usage or input.
    """
    from inertiad.base import finding
    from inertiad.identify import calibrate as calibrator
    from inertiad.identify import fit as fitter

    with _progress() as progress:
        progress("read and solve")
        result, recordings = calibrator.main(robot, runs, payload or [], tare)
    typer.echo(calibrator.text(result))
    for mass, estimate in zip(result.payloads, result.estimates, strict=True):
        _say(f"payload {mass:g} kg: mass {estimate.body.value[0]:.3f} ± {estimate.body.std[0]:.3f} kg")
    for line in fitter.remarks(result.estimates[0], recordings, []):
        _say(line)
    for line in calibrator.correlations(result):
        _say(line)
    for direction in result.directions:
        _say(f"not told: {direction}")
    for line in finding.lines(result.findings):
        _say(line)
    if finding.verdict(result.findings) == "stop":
        _say(f"{output}: not written")
        raise typer.Exit(1)
    calibrator.write(output, result)
    _say(f"{output}: written")


@app.command(epilog="Example: inertiactl sync run")
def sync(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder with robot.toml, can.log, tracker.csv.")],
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Default: sync.json in RUN.")] = None,
) -> None:
    """Find how late tracker and forces are against the IMU, how sure that is, and what it costs.

    In robot.toml: [calibration] sync = "sync.json", for compile, fit and all others.
    """
    from inertiad.identify import sync as synchroniser

    with _progress() as progress:
        found = synchroniser.sync(run, progress)
    for line in synchroniser.text(found):
        typer.echo(line)
    synchroniser.write(json or run / "sync.json", found)


@app.command(epilog="Example: inertiactl verify run --bus file")
def verify(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder with robot.toml, can.log, tracker.csv.")],
    bus: Annotated[
        list[str] | None, typer.Option(metavar="file|socketcan:vcan0", help="Default: file; else one per bus.")
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Default: verify.json in RUN.")] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Verify this robot.cfg instead of compiling robot.toml.")
    ] = None,
    daemon: Annotated[Path | None, typer.Option(metavar="FILE", help="Another inertiad than build/bin's.")] = None,
    url: Url = DEFAULT_URL,
    latency_max: Annotated[float, typer.Option(metavar="S", help="p99 allowed, frame's stamp to message.")] = 0.1,
) -> None:
    """Run the daemon on a recorded run and check line by line what it does. Exit code 1: a check failed.

    robot.toml and its DBC files are held against what RUN was made with: the daemon's record run.lcmlog or robot.cfg.
    A check that could not be made is OPEN and fails nothing.
    """
    from inertiad.check import verify as verifier

    buses = () if bus in (None, [], ["file"]) else tuple(bus or ())
    options = verifier.Options(run, buses, config, daemon, url, latency_max)
    with _progress() as progress:
        checks = verifier.verify(options, progress)
    for check in checks:
        typer.echo(str(check))
    verifier.write(json or run / "verify.json", options, checks)
    n_failed, n_open = (sum(check.passed is verdict for check in checks) for verdict in (False, None))
    left = f", {n_open} could not be made" if n_open else ""
    typer.echo(f"{'FAIL' if n_failed else 'PASS'}: {len(checks) - n_failed - n_open} of {len(checks)} passed{left}")
    if n_failed:
        raise typer.Exit(1)


@app.command(epilog="Example: inertiactl record --from udp:5000 --format dtrack -o run")
def record(
    address: Annotated[
        str,
        typer.Option("--from", metavar="ADDRESS", help="udp:PORT tcp:HOST:PORT tcp-listen:PORT serial:DEV file:PATH"),
    ],
    output: RunFolder,
    form: Annotated[
        str, typer.Option("--format", metavar="NAME", help="text, struct, spatialanalyzer, emscon, dtrack, natnet.")
    ] = "text",
    columns: Annotated[str, typer.Option(metavar="A,B,..", help="x y z q_w..z t frame valid, - to skip.")] = "t,x,y,z",
    separator: Annotated[str, typer.Option(metavar="TEXT", help="Between columns of text; empty: blanks.")] = ",",
    layout: Annotated[str, typer.Option("--struct", metavar="TEXT", help="One letter per column, as <Id3d.")] = "",
    unit: Annotated[str, typer.Option(metavar="m|mm|..", help="Of x y z.")] = "m",
    time_unit: Annotated[str, typer.Option(metavar="s|ms|us|ns", help="Of t.")] = "s",
    wrap: Annotated[float, typer.Option("--time-wrap", metavar="S", help="Device time starts again after this.")] = 0.0,
    body: Annotated[int | None, typer.Option(metavar="N", help="Body of dtrack, natnet; default: the first.")] = None,
    device_time: Annotated[bool, typer.Option(help="Take what the instrument says of time.")] = True,
    natnet_version: Annotated[str, typer.Option(metavar="N.N", help="Protocol that Motive is set to.")] = "4.1",
    channels: Annotated[
        str, typer.Option(metavar="REGEX", help="LCM channels to log; default: all with the prefix, POSE too.")
    ] = "",
    seconds: Annotated[float | None, typer.Option(metavar="S", min=0.0, help="Stop after this long.")] = None,
    url: Url = DEFAULT_URL,
    prefix: Prefix = DEFAULT_PREFIX,
) -> None:
    """Record a laser tracker or motion capture system: publish TRACKER, write tracker.csv and run.lcmlog.

    Formats with examples: python -m pydoc inertiad.live.tracker_protocols. Ctrl-C ends it with a summary.
    """
    from inertiad.live import record as recorder
    from inertiad.live import tracker_protocols

    named = tuple(columns.split(","))
    described = tracker_protocols.Layout(
        form, named, separator, layout, unit, time_unit, wrap, body, device_time, natnet_version
    )
    for line in recorder.record(recorder.Options(address, described, output, url, prefix, seconds, channels)):
        _say(line)


@app.command("export", epilog="Example: inertiactl export run --to parquet -o run.parquet")
def export_command(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Run folder, .lcmlog of the daemon, CAN log, or estimate.json.")
    ],
    to: Annotated[
        str,
        typer.Option("--to", metavar="FORMAT", help="csv parquet mcap mat mf4 candump; of the body: urdf mjcf json."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")],
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description, where the run has none.")
    ] = None,
    prefix: Annotated[str, typer.Option(metavar="TEXT", help="Channel prefix in an .lcmlog.")] = DEFAULT_PREFIX,
) -> None:
    """Write a run for other tools: signals, tracker, estimates, frames, events, health, all with units.

    csv and parquet hold one of these each: FILE the first, FILE's stem.tracker.csv and so on the others. urdf, mjcf
    and json hold the identified body in the platform frame. Layouts: python -m pydoc inertiad.exchange.file_formats
    """
    from inertiad.exchange import convert

    remarks: list[str] = []
    with _progress() as progress:
        progress(f"write {output}")
        written = convert.export(run, to, output, robot, prefix, remarks)
    for line in (*remarks, *written):
        _say(line)


@app.command("import", epilog="Example: inertiactl import run.mf4 -o run")
def import_command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="What export wrote, or .csv .mat .mf4 .asc .blf .trc .log of others.")
    ],
    output: RunFolder,
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description to put into the run.")
    ] = None,
) -> None:
    """Make a run folder of another tool's file: signals.csv, tracker.csv, can.log, as far as they are in it."""
    from inertiad.exchange import convert

    remarks: list[str] = []
    with _progress() as progress:
        progress(f"read {file}")
        written = convert.import_file(file, output, robot, remarks)
    for line in (*remarks, *written):
        _say(line)


def main() -> None:
    """Run the command line and exit."""
    try:
        code: Any = app(prog_name="inertiactl", standalone_mode=False)
    except InputError as error:
        _fail(str(error))
    except TyperException as error:
        if not error.format_message():  # no arguments: the help has been shown
            sys.exit(2)
        _fail(error.format_message())
    except OSError as error:
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error.strerror or error))
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(text: str) -> NoReturn:
    _say(f"inertiactl: {' '.join(text.split())}")
    sys.exit(2)
