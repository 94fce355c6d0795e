# SPDX-License-Identifier: Apache-2.0
"""The tracker's beam is lost: attitude and IMU carry the position on, counted, and the host's rows are the same."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import COGIRO, TOP

import inertiad_core
from inertiad.base import body as estimate
from inertiad.check import verify
from inertiad.robot import configuration, description
from inertiad.run import canlog, lcmlog, reader, tracker_csv
from inertiad.simulate.sensor_models import PRESETS
from inertiad_lcm import health_t, signals_t

pytestmark = pytest.mark.slow

LOST_AT = 12.0  # s
RATE = 100  # Hz
MAX_CARRY = 0.5  # s, the default
LOST = ("overrun",)


def run_with_gap(folder: Path, gap: float) -> Path:
    """The paper's motion, modern sensors, no tracker for gap [s]."""
    level = PRESETS["modern"].model_copy(update={"silent": "tracker", "fault_start": LOST_AT, "fault_duration": gap})
    faults, run = folder / "faults.toml", folder / "run"
    faults.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in level.model_dump().items()))
    command = ["simulate", COGIRO / "robot.toml", "--faults", faults, "--rate", RATE, "--seed", 41, "-o", run]
    subprocess.run([TOP / "build/bin/inertiactl", *map(str, command)], check=True, capture_output=True)
    return run


def daemon(run: Path) -> tuple[dict[str, int], signals_t]:
    """Counters of the last HEALTH, and the rows."""
    configuration.write(run / "robot.cfg", description.load(run / "robot.toml"), "robot.toml")
    command = [TOP / "build/bin/inertiad", "-v", "--config", run / "robot.cfg", "--bus", f"file:{run}/can.log",
               "--tracker", f"file:{run}/tracker.csv", "--lcm", "none", "--record", run / "run.lcmlog",
               "--estimate", run / "estimate.json"]  # fmt: skip
    subprocess.run([str(c) for c in command], check=True, capture_output=True)
    events = list(lcmlog.read(run / "run.lcmlog"))
    health = [health_t.decode(e.data) for e in events if e.channel == "INERTIAD_HEALTH"][-1]
    rows = [row for e in events if e.channel == "INERTIAD_SIGNALS" for row in signals_t.decode(e.data).row]
    return {c.name: c.value for c in health.counter}, rows


@pytest.mark.parametrize("gap", [0.2, 0.5, 2.0])
def test_estimate_holds_while_the_position_is_carried(tmp_path, gap):
    run = run_with_gap(tmp_path, gap)  # given
    n, rows = daemon(run)  # when
    gone = RATE * gap
    carried = n["motion.carried"]  # then
    if gap < 0.25:  # max_age_position: short enough to be interpolated
        assert carried <= 2  # at the end, past the last position
    else:
        assert carried == pytest.approx(min(gone, RATE * MAX_CARRY), abs=3)
    dropped = n["motion.no_position"]
    assert dropped == pytest.approx(max(0.0, gone - RATE * MAX_CARRY), abs=3)
    assert n["align.imu.samples"] == n["align.rows"] + sum(n[f"align.{cause}"] for cause in LOST)
    body, truth = estimate.read(run / "estimate.json"), estimate.read_truth(run / "truth.json")
    assert np.all(np.abs(estimate.errors(body, truth)) < 3.0 * np.array(body.std))
    offline = reader.read(run)
    assert offline.counters["motion.carried"] == carried
    assert np.array_equal(offline.rows.position, [row.position for row in rows])


def test_positions_that_come_late_change_nothing(tmp_path):
    run = run_with_gap(tmp_path, 0.4)
    robot = description.load(run / "robot.toml")
    config = reader.config_of(robot, "run")
    log, tracker = canlog.read(run / "can.log"), tracker_csv.read(run / "tracker.csv")
    xyz = tracker.stack("x", "y", "z")
    late = np.repeat(np.random.default_rng(1).uniform(0.0, 0.1, len(tracker.t) // 50 + 1), 50)[: len(tracker.t)]  # s
    estimates = []
    for lateness in (np.zeros(len(late)), late):  # given: as in a file, and as a network that stalls brings them
        pipeline = inertiad_core.Pipeline(config)
        due = np.maximum.accumulate(np.rint(1e9 * (tracker.t + lateness)))
        order = np.argsort(np.r_[log.t_ns, due], kind="stable")
        for k in order.tolist():
            if k < len(log):
                data = log.data[k, : log.length[k]].tobytes()
                pipeline.push_frame(int(log.t_ns[k]), 0, int(log.can_id[k]), data, int(log.flags[k]))
            else:
                pipeline.push_position(round(1e9 * tracker.t[k - len(log)]), xyz[k - len(log)])
            pipeline.drain()
        pipeline.flush()
        pipeline.drain()
        assert pipeline.counters["motion.carried"] > 35
        estimates.append(pipeline.estimate)
    assert all(np.array_equal(estimates[0][name], estimates[1][name]) for name in estimates[0])  # when, then


def test_verify_passes_a_gap_that_is_carried_and_tells_it(tmp_path):
    run = run_with_gap(tmp_path, 0.45)
    checks = {c.name: c for c in verify.verify(verify.Options(run), lambda _: None)}
    assert [c for c in checks.values() if c.passed is False] == []
    assert "motion.carried 4" in checks["rows"].detail
    assert checks["tracker positions"].detail.endswith("used; silent 1 times")


def test_verify_fails_the_same_gap_when_nothing_may_be_carried(tmp_path):
    run = run_with_gap(tmp_path, 0.9)
    with (run / "robot.toml").open("a") as file:
        file.write("[align]\nmax_carry = 0.0\n")
    failed = {c.name: c.detail for c in verify.verify(verify.Options(run), lambda _: None) if c.passed is False}
    assert "align.position.missing" in failed["rows"]
