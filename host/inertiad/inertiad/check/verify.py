# SPDX-License-Identifier: Apache-2.0
"""Verification of the daemon on a run. One line per check: PASS, FAIL, or OPEN where it could not be made.

The frames in RAW are compared with the log, the positions in ORDER with those sent, the counters with each other, the
rows with a decoder of our own (from the DBC, in numpy). Rows and estimates are compared bit for bit with a
recomputation by the same core from RAW and ORDER, in the order in which the daemon used them. The last estimate is
compared with the joint batch solver on the published rows, and with the truth of a simulated run. robot.toml and its
DBC files are compared with the configuration of the run, if it is in the daemon's record run.lcmlog or in robot.cfg.
A run compiled --blind is verified without [nominal].
"""

import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from inertiad.base import channels, installation
from inertiad.base.error import InputError
from inertiad.check import daemon_run, estimate_checks, input_checks, row_checks
from inertiad.check.case import Case, Check
from inertiad.check.daemon_run import Setup
from inertiad.robot import configuration, dbc, description
from inertiad.robot.description import Robot
from inertiad.run import canlog

LATENCY_MAX: Final = 0.1
"""s, p99 from a frame's stamp to the arrival of its RAW message"""
NS_PER_S: Final = 1e9

# ---- time ------------------------------------------------------------------------------------------------------------


def _check_latency(case: Case, limit: float) -> Iterator[Check]:
    p = case.published
    if not p.is_live:
        yield Check(
            "speed", True, f"{len(case.raw) / max(p.seconds, 1e-9):.0f} frames/s with start and messages written"
        )
        return
    if not p.messages["RAW"]:
        return
    late = np.array(p.arrival_ns["RAW"]) - np.array([m.t_ns for m in p.messages["RAW"]])
    p50, p99, worst = np.percentile(late, [50, 99, 100]) / NS_PER_S
    detail = f"frame's stamp to message: {1e3 * p50:.2f} ms (p50), {1e3 * p99:.2f} ms (p99), {1e3 * worst:.2f} ms (max)"
    yield Check("latency", bool(p99 <= limit), f"{detail}, p99 allowed {1e3 * limit:g}")


# ---- all -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Options:
    """Options of `inertiactl verify`."""

    run: Path
    buses: tuple[str, ...] = ()
    """none: from the run's files"""
    config: Path | None = None
    daemon: Path | None = None
    url: str = channels.DEFAULT_URL
    latency_max: float = LATENCY_MAX


def _installed_daemon() -> Path:
    """InputError: there is none; the option that gives another one."""
    try:
        return installation.daemon()
    except InputError as error:
        raise InputError(f"{error}, or pass --daemon FILE") from None


def _setup(options: Options, robot: Robot, data: bytes, folder: Path) -> Setup:
    config = options.config
    if config is None:
        config = folder / "robot.cfg"
        config.write_bytes(data)
    with_tracker = robot.position.source == "tracker"
    if with_tracker and not (options.run / "tracker.csv").exists():
        raise InputError(f'{options.run / "tracker.csv"}: not found, but position.source = "tracker"')
    daemon = options.daemon or _installed_daemon()
    return Setup(options.run, folder, config, daemon, max(1, len(robot.bus)), with_tracker, options.url)


def judge(case: Case, latency_max: float) -> list[Check]:
    """All checks, in the order of the data's way."""
    mine = estimate_checks.recompute(case)
    checks = [*input_checks.check_record(case)]
    checks += [
        *input_checks.check_description(case),
        *input_checks.check_config(case),
        *input_checks.check_daemon(case),
    ]
    checks += [*input_checks.check_frames(case), *input_checks.check_counters(case)]
    checks += [
        *row_checks.check_sample_counters(case),
        *input_checks.check_positions(case),
        *row_checks.check_rows(case),
    ]
    checks += [*estimate_checks.check_recomputation(case, mine), *estimate_checks.check_batch(case)]
    return [
        *checks,
        *estimate_checks.check_truth(case),
        *estimate_checks.check_golden(case),
        *_check_latency(case, latency_max),
    ]


def verify(options: Options, progress: Callable[[str], None]) -> list[Check]:
    """Run the daemon on a run and check it. InputError: the run, bus or daemon cannot be used."""
    source = options.run / "robot.toml"
    robot = description.load(source)
    data = configuration.compile_robot(robot, str(source))
    blind_robot = robot.model_copy(update={"nominal": None})
    blind_data = configuration.compile_robot(blind_robot, str(source))
    is_blind = input_checks.is_blind(options.run, options.config, data, blind_data)
    if is_blind:
        robot, data = blind_robot, blind_data
    if not (options.run / "can.log").exists() and (options.run / "signals.csv").exists():
        raise InputError(
            f"{options.run}: no can.log to run the daemon on; inertiactl encode makes a run folder from signals.csv"
        )
    log = canlog.read(options.run / "can.log")
    with tempfile.TemporaryDirectory(prefix="inertiad-") as name:
        setup = _setup(options, robot, data, Path(name))
        progress("run the daemon")
        is_live = bool(options.buses)
        published = daemon_run.live(setup, list(options.buses), len(log)) if is_live else daemon_run.from_file(setup)
        progress("check")
        given = setup.config.read_bytes()
        positions = daemon_run.positions_of(setup, published)
        bindings = dbc.bind(robot, str(source))
        raw = published.frames(setup.n_buses)
        case = Case(robot, data, given, log, raw, published, positions, bindings, options.run, is_blind)
        return judge(case, options.latency_max)


def write(path: Path, options: Options, checks: list[Check]) -> None:
    """verify.json."""
    document = {
        "run": str(options.run),
        "bus": list(options.buses) or ["file"],
        "passed": all(c.passed is not False for c in checks),
        "checks": [asdict(c) for c in checks],
    }
    path.write_text(json.dumps(document, indent=1) + "\n")
