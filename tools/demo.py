# SPDX-License-Identifier: Apache-2.0
"""The paper's experiment on CoGiRo, from CAN frames to identified parameters.

Simulates the robot with modern sensors, streams the CAN log through the daemon, listens to its estimate over LCM,
prints it beside the truth and the errors of the paper, and draws how it converged (build/demo/convergence.png). 20 s.
"""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import lcm
import matplotlib
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from inertiad.base.body import NAMES, UNITS, Body, errors, of_message, read, read_truth
from inertiad.base.channels import DEFAULT_URL
from inertiad.base.error import InputError
from inertiad.base.text_files import read_json
from inertiad.identify import two_step
from inertiad.live.lcm_network import connect
from inertiad_lcm import estimate_t

matplotlib.use("Agg")
import matplotlib.pyplot as plt

TOP = Path(__file__).resolve().parent.parent
BIN = Path("build/bin")
ROBOT = Path("firmware/robots/cogiro/robot.toml")
RUN = Path("build/demo")
SEED = 1
SPEED = 4
PREFIX = f"DEMO{os.getpid()}_"
"""Of this demo's channels: other daemons on the machine keep theirs."""
QUEUE = 10_000
ISOLATED = "--isolated"

console = Console(highlight=False, soft_wrap=True)


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


def enter_own_network() -> None:
    """Run again in a network namespace whose loopback carries multicast; returns where that is not allowed."""
    setup = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
    command = ["unshare", "--map-root-user", "--net", "sh", "-c", setup, "sh"]
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        return
    if subprocess.run([*command, "true"], capture_output=True).returncode == 0:
        os.execvp(command[0], [*command, sys.executable, __file__, ISOLATED])


def live_url() -> str | None:
    """LCM URL the daemon can be listened to on, or None: this machine has no multicast and allows none to be made."""
    if multicast_works():
        return DEFAULT_URL
    if ISOLATED not in sys.argv:
        enter_own_network()
    return None


# ---- the experiment --------------------------------------------------------------------------------------------------


def run(*command: object) -> None:
    """Show and run a program to its end; its messages are shown only if it fails."""
    words = [str(word) for word in command]
    console.print(f"[dim]$ {' '.join(words).removeprefix(f'{BIN}/')}[/]")
    result = subprocess.run(words, capture_output=True, text=True)
    if result.returncode != 0:
        sys.exit(result.stderr.rstrip() or f"{words[0]} failed")


def daemon(url: str, speed: int) -> list[str]:
    """The daemon's command line."""
    return [
        *(str(BIN / "inertiad"), "--config", str(RUN / "robot.cfg")),
        *("--bus", f"file:{RUN}/can.log?speed={speed}", "--tracker", f"file:{RUN}/tracker.csv"),
        *("--lcm", url, "--lcm-prefix", PREFIX, "--estimate", str(RUN / "estimate.json")),
    ]


def listen_live(url: str, duration: float) -> History:
    """Start the daemon at SPEED times real time and collect what it publishes until it ends."""
    history = History()
    bus: lcm.LCM = connect(url)
    bus.subscribe(f"{PREFIX}ESTIMATE", history.on_estimate).set_queue_capacity(QUEUE)
    command = daemon(url, SPEED)
    console.print(f"[dim]$ {' '.join(command).removeprefix(f'{BIN}/')}[/]")
    columns = (TextColumn("  {task.description}"), BarColumn(), TimeRemainingColumn())
    with (
        Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress,
        (RUN / "inertiad.log").open("w") as log,
    ):
        task = progress.add_task("listening", total=duration)
        with subprocess.Popen(command, stderr=log) as process:
            while process.poll() is None or bus.handle_timeout(100) > 0:
                bus.handle_timeout(100)
                if history.t:
                    mass, std = history.body[-1].value[0], history.body[-1].std[0]
                    done = history.t[-1] - history.t[0]
                    progress.update(task, completed=done, description=f"mass {mass:7.2f} ± {std:5.2f} kg")
    if process.returncode != 0:
        sys.exit((RUN / "inertiad.log").read_text().rstrip())
    return history


def listen_to_log() -> History:
    """Let the daemon write its messages into an LCM log, then read it."""
    path = RUN / "run.lcmlog"
    path.unlink(missing_ok=True)
    run(*daemon(f"file://{path}?mode=w", 0))
    history = History()
    for event in lcm.EventLog(str(path), "r"):
        if event.channel == f"{PREFIX}ESTIMATE":
            history.on_estimate(event.channel, event.data)
    return history


# ---- what came out ---------------------------------------------------------------------------------------------------


def shown(index: int, value: float, signed: bool = False) -> str:
    """A value of NAMES[index]; centre of gravity in mm."""
    scale, digits = (1e3, 1) if UNITS[index] == "m" else (1.0, 2)
    return f"{scale * value:{'+' if signed else ''}.{digits}f}"


def result_table(estimate: Body, truth: Body) -> Table:
    """Parameter, truth, ours, our error, the paper's error."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in ("", "unit"):
        table.add_column(heading)
    for heading in ("truth", "ours", "± std", "our error", "paper's error"):
        table.add_column(heading, justify="right")
    published = [e - n for e, n in zip(two_step.ESTIMATED, two_step.NOMINAL, strict=True)]
    for i, error in enumerate(errors(estimate, truth)):
        unit = "mm" if UNITS[i] == "m" else UNITS[i]
        values = (shown(i, truth.value[i]), shown(i, estimate.value[i]), shown(i, estimate.std[i]))
        table.add_row(NAMES[i], unit, *values, f"[bold]{shown(i, error, True)}[/]", shown(i, published[i], True))
    return table


def draw(history: History, truth: Body, path: Path) -> None:
    """One small picture per parameter: value, +- 2 sigma, truth."""
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
    figure.suptitle("CoGiRo, modern sensors: what the daemon knows of the platform", x=0.008, ha="left", fontsize=12)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main() -> None:
    """Simulate, identify, compare."""
    os.chdir(TOP)
    url = live_url()
    shutil.rmtree(RUN, ignore_errors=True)
    run(BIN / "inertiactl", "simulate", ROBOT, "--faults", "modern", "--seed", SEED, "-o", RUN)
    run(BIN / "inertiactl", "compile", RUN / "robot.toml", "--blind", "-o", RUN / "robot.cfg")
    if url is None:
        console.print("no multicast on this machine: the daemon's messages go through a log file, not over the network")
    duration = float(read_json(RUN / "truth.json")["duration_s"])
    history = listen_to_log() if url is None else listen_live(url, duration)
    estimate, truth = read(RUN / "estimate.json"), read_truth(RUN / "truth.json")
    if not history.t:
        sys.exit(f"no estimate heard on {url}; the daemon's own messages are in {RUN}/inertiad.log")
    console.print()
    console.print(result_table(estimate, truth))
    console.print(
        "\n[dim]truth: what was simulated, the daemon was not told; paper's error: Table III on the robot itself,"
        " estimated - nominal[/]"
    )
    draw(history, truth, RUN / "convergence.png")
    console.print(f"{len(history.t)} estimates over LCM; how they converged: {RUN}/convergence.png")


if __name__ == "__main__":
    main()
