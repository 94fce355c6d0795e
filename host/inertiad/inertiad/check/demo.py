# SPDX-License-Identifier: Apache-2.0
"""The paper's experiment on CoGiRo, from CAN frames to identified parameters.

Simulates the robot with modern sensors, streams the CAN log through the daemon, listens to its estimate over LCM,
prints its error beside that of the paper's two steps on the same run, and draws how the estimate converged. Takes 25 s.
"""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from inertiad.base import extras, installation
from inertiad.base.body import NAMES, UNITS, Body, errors, of_message, read, read_truth
from inertiad.base.channels import DEFAULT_URL
from inertiad.base.error import InputError
from inertiad.base.text_files import read_json
from inertiad.live.lcm_network import connect
from inertiad.run import lcmlog
from inertiad_lcm import estimate_t

SEED: Final = 1
SPEED: Final = 4
PREFIX: Final = f"DEMO{os.getpid()}_"
"""Of this demo's channels: other daemons on the machine keep theirs."""
QUEUE: Final = 10_000
TOOL: Final = (
    f"import sys; sys.path.insert(0, {str(installation.PACKAGE.parent)!r}); import inertiad.cli.main as m; m.main()"
)
"""inertiactl for this interpreter, whatever kind of installation it runs from"""

console = Console(highlight=False, soft_wrap=True)


def tool(*arguments: object) -> list[str]:
    """The command line of inertiactl with arguments."""
    return [sys.executable, "-c", TOOL, *map(str, arguments)]


@dataclass
class History:
    """Every estimate received, in order."""

    t: list[float] = field(default_factory=list)
    """s since the first frame"""
    body: list[Body] = field(default_factory=list)

    def on_estimate(self, _channel: str, data: bytes) -> None:
        message = estimate_t.decode(data)
        self.t.append(1e-9 * message.t_ns)
        self.body.append(of_message(message))


# ---- network ---------------------------------------------------------------------------------------------------------


def multicast_works() -> bool:
    """Does a message published on the default URL come back to this machine?"""
    try:
        bus = connect(DEFAULT_URL)
    except InputError:
        return False
    heard: list[bytes] = []
    bus.subscribe(f"{PREFIX}ECHO", lambda _channel, data: heard.append(data))
    bus.publish(f"{PREFIX}ECHO", b"?")
    return bus.handle_timeout(500) > 0 and len(heard) == 1


def enter_own_network(again: list[str]) -> None:
    """Run inertiactl again in a network whose loopback carries multicast; returns where that is refused."""
    setup = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
    command = ["unshare", "--map-root-user", "--net", "sh", "-c", setup, "sh"]
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        return
    if subprocess.run([*command, "true"], capture_output=True).returncode == 0:
        os.execvp(command[0], [*command, *tool(*again)])


def live_url(again: list[str] | None) -> str | None:
    """LCM URL the daemon can be listened to on, or None: this machine has no multicast and allows none to be made.

    again: arguments of inertiactl to run again with in a network of its own; None: it runs in one already.
    """
    if multicast_works():
        return DEFAULT_URL
    if again is not None:
        enter_own_network(again)
    return None


# ---- the experiment --------------------------------------------------------------------------------------------------


def show(command: list[str]) -> None:
    console.print(f"[dim]$ {' '.join(command)}[/]")


def finish(command: list[str], name: str) -> None:
    """Run a program to its end; its messages are shown only if it fails. InputError: it has."""
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode != 0:
        raise InputError(*(result.stderr.rstrip().splitlines() or [f"{name}: failed"]))


def run_tool(*arguments: object) -> None:
    """Show and run inertiactl."""
    show(["inertiactl", *map(str, arguments)])
    finish(tool(*arguments), f"inertiactl {arguments[0]}")


def daemon(folder: Path, url: str, speed: int) -> list[str]:
    """The daemon's options."""
    return [
        *("--config", str(folder / "robot.cfg"), "--bus", f"file:{folder}/can.log?speed={speed}"),
        *("--tracker", f"file:{folder}/tracker.csv", "--lcm", url, "--lcm-prefix", PREFIX),
        *("--estimate", str(folder / "estimate.json")),
    ]


def listen_live(folder: Path, url: str, duration: float) -> History:
    """Start the daemon at SPEED times real time and collect what it publishes until it ends."""
    history = History()
    bus: Any = connect(url)
    bus.subscribe(f"{PREFIX}ESTIMATE", history.on_estimate).set_queue_capacity(QUEUE)
    options = daemon(folder, url, SPEED)
    show(["inertiad", *options])
    columns = (TextColumn("  {task.description}"), BarColumn(), TimeRemainingColumn())
    with (
        Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress,
        (folder / "inertiad.log").open("w") as log,
    ):
        task = progress.add_task("listening", total=duration)
        with subprocess.Popen([str(installation.daemon()), *options], stderr=log) as process:
            while process.poll() is None or bus.handle_timeout(100) > 0:
                bus.handle_timeout(100)
                if history.t:
                    mass, std = history.body[-1].value[0], history.body[-1].std[0]
                    done = history.t[-1] - history.t[0]
                    progress.update(task, completed=done, description=f"mass {mass:7.2f} ± {std:5.2f} kg")
    if process.returncode != 0:
        raise InputError(*(folder / "inertiad.log").read_text().rstrip().splitlines())
    return history


def listen_to_log(folder: Path) -> History:
    """Let the daemon write its messages into an LCM log, then read it."""
    path = folder / "run.lcmlog"
    path.unlink(missing_ok=True)
    options = daemon(folder, f"file://{path.resolve()}?mode=w", 0)
    show(["inertiad", *options])
    finish([str(installation.daemon()), *options], "inertiad")
    history = History()
    for event in lcmlog.read(path, []):
        if event.channel == f"{PREFIX}ESTIMATE":
            history.on_estimate(event.channel, event.data)
    return history


# ---- what came out ---------------------------------------------------------------------------------------------------


def shown(index: int, value: float, signed: bool = False) -> str:
    """A value of NAMES[index]; centre of gravity in mm."""
    scale, digits = (1e3, 1) if UNITS[index] == "m" else (1.0, 2)
    return f"{scale * value:{'+' if signed else ''}.{digits}f}"


def result_table(estimate: Body, two_steps: Body, truth: Body) -> Table:
    """Parameter, truth, the daemon's estimate and its error, the error of the paper's two steps on the same run."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in ("", "unit"):
        table.add_column(heading)
    for heading in ("truth", "inertiad", "± std", "its error", "two-step error"):
        table.add_column(heading, justify="right")
    pairs = zip(errors(estimate, truth), errors(two_steps, truth), strict=True)
    for i, (error, of_two_steps) in enumerate(pairs):
        unit = "mm" if UNITS[i] == "m" else UNITS[i]
        values = (shown(i, truth.value[i]), shown(i, estimate.value[i]), shown(i, estimate.std[i]))
        table.add_row(NAMES[i], unit, *values, f"[bold]{shown(i, error, True)}[/]", shown(i, of_two_steps, True))
    return table


def draw(history: History, truth: Body, path: Path) -> None:
    """One small picture per parameter: value, +- 2 sigma, truth."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    t = np.array(history.t) - history.t[0]
    value = np.array([b.value for b in history.body])
    std = np.array([b.std for b in history.body])
    plt.rcParams.update({"font.size": 9, "font.family": "DejaVu Sans", "axes.linewidth": 0.6})
    figure, axes = plt.subplots(2, 5, figsize=(13, 5.6), sharex=True, layout="constrained")
    for i, axis in enumerate(axes.flat):
        scale, unit = (1e3, "mm") if UNITS[i] == "m" else (1.0, UNITS[i].replace("m2", "m²"))
        x, s, true = scale * value[:, i], scale * std[:, i], scale * truth.value[i]
        axis.fill_between(t, x - 2 * s, x + 2 * s, color="#9ecae1", linewidth=0, label="± 2 σ")
        axis.plot(t, x, color="#08519c", linewidth=1.2, label="estimate")
        axis.axhline(true, color="#d94801", linewidth=1.0, linestyle=(0, (5, 3)), label="truth")
        half = 1.3 * max(np.quantile(np.abs(x - true) + 2 * s, 0.75), 4 * s[-1])
        axis.set_ylim(true - half, true + half)
        axis.set_title(f"{NAMES[i]}  [{unit}]", loc="left", fontsize=9.5)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(axis="y", color="#dddddd", linewidth=0.5)
        axis.set_xlim(0, t[-1])
    for axis in axes[1]:
        axis.set_xlabel("time [s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    figure.suptitle("CoGiRo, modern sensors: convergence of the daemon's estimate", x=0.008, ha="left", fontsize=12)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def run(folder: Path, again: list[str] | None) -> None:
    """Simulate, identify, compare; every file goes into folder. InputError: a step has failed.

    again: arguments of inertiactl that do the same in a network of its own; None: it runs in one already.
    """
    url = live_url(again)
    robot = installation.example_robot()
    robot = robot.relative_to(Path.cwd()) if robot.is_relative_to(Path.cwd()) else robot
    if folder.exists() and any(folder.iterdir()) and not (folder / "truth.json").exists():
        raise InputError(f"{folder}: holds something else than a simulated run; choose another -o")
    run_tool("simulate", robot, "--faults", "modern", "--seed", SEED, "-o", folder)
    run_tool("compile", folder / "robot.toml", "--blind", "-o", folder / "robot.cfg")
    if url is None:
        console.print("no multicast on this machine: the daemon's messages go through a log file, not over the network")
    duration = float(read_json(folder / "truth.json")["duration_s"])
    history = listen_to_log(folder) if url is None else listen_live(folder, url, duration)
    run_tool("fit", folder, "--method", "paper", "--json", folder / "two_steps.json")
    estimate, truth = read(folder / "estimate.json"), read_truth(folder / "truth.json")
    if not history.t:
        raise InputError(f"no estimate heard on {url}; the daemon's own messages are in {folder}/inertiad.log")
    console.print()
    console.print(result_table(estimate, read(folder / "two_steps.json"), truth))
    console.print(
        "\n[dim]truth: the simulated body, unknown to the daemon;"
        " two-step error: the method of the ICRA 2017 paper on the same run[/]"
    )
    heard = f"{len(history.t)} estimates received over LCM"
    if not extras.has("matplotlib"):
        console.print(f"{heard}; for a plot of them: {extras.remedy('plot')}", markup=False)
        return
    draw(history, truth, folder / "convergence.png")
    console.print(f"{heard}; convergence plot: {folder}/convergence.png")
