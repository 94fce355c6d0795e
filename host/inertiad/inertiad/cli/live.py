# SPDX-License-Identifier: Apache-2.0
"""Commands beside a running daemon and its instruments."""

import re
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand

from inertiad.base.channels import DEFAULT_PREFIX, DEFAULT_URL
from inertiad.base.error import InputError
from inertiad.cli.options import Json, Prefix, RunFolder, Url, progress_shown, say, write_json

commands = typer.Typer()


@commands.command(epilog="Example: inertiactl watch --seconds 10")
def watch(
    url: Url = DEFAULT_URL,
    prefix: Prefix = DEFAULT_PREFIX,
    seconds: Annotated[float | None, typer.Option(metavar="S", min=0.0, help="Stop after this long.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One line of JSON per message, for scripts.")] = False,
) -> int:
    """Show the daemon's estimate with its standard deviations, buses, latencies, losses and events, live.

    Four pages: keys 1 to 4 or Tab; q ends. NIS is the normalised innovation squared of the last window: its misfit in
    its own sigmas, squared. 6 is expected; more than 17, again and again, means a push, a slack cable or a bad sensor.

    Exit code 1: nobody sent anything.
    """
    from inertiad.live import watch as watcher

    if watcher.watch(url, prefix, seconds, as_json):
        return 0
    say(f"inertiactl: --lcm {url}: nothing came on {prefix}...: does inertiad run there?")
    return 1


@commands.command(epilog="Example: inertiactl live --robot robot.toml")
def live(
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Address to serve on; 0.0.0.0: every network.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Port; 0: any free one.")] = 8765,
    run: Annotated[
        Path | None,
        typer.Option("--run", metavar="RUN", help="Play this run's run.lcmlog instead of the network, in real time."),
    ] = None,
    robot: Annotated[
        Path | None, typer.Option("--robot", metavar="ROBOT", help="Robot description, for its nominal body.")
    ] = None,
    url: Url = DEFAULT_URL,
    prefix: Prefix = DEFAULT_PREFIX,
    seconds: Annotated[float | None, typer.Option(metavar="S", min=0.0, help="Stop after this long.")] = None,
) -> None:
    """Show the robot and the daemon's estimate live on a web page, or a recorded run again.

    The page has the robot in 3D with tensions, CoG and ellipsoid of inertia, the ten numbers, convergence, residuals,
    sensors, buses, losses, findings and events. Its buttons send commands to the daemon; on an address that other
    machines reach, and for a recording, they are off.
    """
    from inertiad.live import web_view

    web_view.serve(web_view.Options(host, port, run, robot, url, prefix, seconds), say)


SET_DOWN: Final = re.compile(r"-[\d.][^@]*@")
"""a payload with a negative mass, which is no option"""


class _TakesPayload(TyperCommand):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Click's, with a negative mass behind "--"."""
        if "--" not in args:
            masses = [word for word in args if SET_DOWN.match(word)]
            args = [*(word for word in args if word not in masses), "--", *masses]
        return super().parse_args(ctx, args)


@commands.command(cls=_TakesPayload, epilog='Example: inertiactl command mark "load on"')
def command(
    name: Annotated[str, typer.Argument(metavar="freeze|resume|reset|tare|configure|mark|expect")],
    argument: Annotated[
        str | None,
        typer.Argument(metavar="[FILE|TEXT|PAYLOAD]", help="FILE of configure, TEXT of mark, PAYLOAD of expect."),
    ] = None,
    std: Annotated[
        str | None, typer.Option(metavar="KG,M,KGM2", help="Sigmas of an expected payload's mass, CoG and inertia.")
    ] = None,
    url: Url = DEFAULT_URL,
    prefix: Prefix = DEFAULT_PREFIX,
    patience: Annotated[
        float, typer.Option("--wait", metavar="S", min=0.0, help="Wait this long for an answer.")
    ] = 3.0,
) -> int:
    """Send a command to a running daemon and print its answer.

    freeze: learn nothing more; resume: learn again; reset: start from the prior; tare: take the gyro's bias at rest;
    configure FILE: use this compiled configuration; mark TEXT: note it in the record. expect KG@S@x,y,z: a point mass
    touches the platform S seconds from now, at this position in P. expect FILE@S: a body. A negative KG is set down:
    -5@2@0,0,0.

    Exit code 0: done, 1: the daemon refused, 2: no answer.
    """
    from inertiad.live import command as commands

    answer = commands.send(commands.make(name, argument, std), url, prefix, patience)
    if answer is None:
        raise InputError(f"--lcm {url}: no answer on {prefix}EVENT within {patience:g} s: does inertiad run there?")
    typer.echo(answer.text)
    return 0 if answer.is_done else 1


@commands.command(epilog="Example: inertiactl replay run --bus socketcan:vcan0 --speed 1")
def replay(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder, or a log: .log .asc .blf .trc .mf4 .lcmlog.")],
    bus: Annotated[
        list[str] | None,
        typer.Option(metavar="ADDRESS", help="socketcan:vcan0, one per bus of the log; -: candump lines on stdout."),
    ] = None,
    speed: Annotated[float, typer.Option(metavar="S", help="Speed, log seconds per second.")] = 1.0,
    loop: Annotated[int, typer.Option(metavar="N", min=1, help="Number of repetitions.")] = 1,
    start: Annotated[float, typer.Option(metavar="S", min=0.0, help="Skip everything before, s.")] = 0.0,
    stop: Annotated[float | None, typer.Option(metavar="S", help="Skip everything after, s.")] = None,
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
    with progress_shown() as progress:
        progress(f"play {run}")
        played = replayer.replay(options, remarks)
    for line in (*remarks, *played.lateness):
        say(str(line))
    waits = f", {played.n_waits} times a queue was full" if played.n_waits else ""
    unsent = f", stopped with {played.n_unsent} unsent" if played.n_unsent else ""
    say(f"{played.duration:.3f} s{waits}{unsent}")


@commands.command(epilog="Example: inertiactl record --from udp:5000 --format dtrack -o run")
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
    device_time: Annotated[bool, typer.Option(help="Use the instrument's time stamps.")] = True,
    natnet_version: Annotated[str, typer.Option(metavar="N.N", help="Protocol that Motive is set to.")] = "4.1",
    channels: Annotated[
        str, typer.Option(metavar="REGEX", help="LCM channels to log; default: all with the prefix, POSE too.")
    ] = "",
    seconds: Annotated[float | None, typer.Option(metavar="S", min=0.0, help="Stop after this long.")] = None,
    json: Json = None,
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
    summary = recorder.record(recorder.Options(address, described, output, url, prefix, seconds, channels))
    for line in summary.lines:
        say(line)
    if json is not None:
        write_json(json, summary.document)
