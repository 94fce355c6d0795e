# SPDX-License-Identifier: Apache-2.0
"""What happens to buses, sensors and the record is told on EVENT, counted, and leaves the estimate alive."""

import os
import platform
import re
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import COGIRO, ISOLATED, TOP

from inertiad.robot import configuration, description
from inertiad.run import lcmlog
from inertiad_lcm import event_t, health_t, host_t

pytestmark = pytest.mark.slow

DAEMON = TOP / "build/bin/inertiad"


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """Six seconds at rest."""
    folder = tmp_path_factory.mktemp("run")
    command = [TOP / "build/bin/inertiactl", "simulate", COGIRO / "robot.toml", "-o", folder, "--trajectory", "hold"]
    more = ["--duration", "6", "--rate", "100", "--seed", "5"]
    subprocess.run([*map(str, command), *more], check=True, capture_output=True)
    configuration.write(folder / "robot.cfg", description.load(folder / "robot.toml"), "robot.toml")
    return folder


def stamp(line: str) -> float:
    return float(line[1 : line.index(")")])


def daemon(run: Path, log: Path, record: Path, *more: object, **how) -> subprocess.CompletedProcess:
    command = [
        DAEMON,
        "-v",
        "--config",
        run / "robot.cfg",
        "--bus",
        f"file:{log}",
        "--tracker",
        f"file:{run}/tracker.csv",
    ]
    arguments = [*command, "--lcm", "none", "--record", record, *more]
    return subprocess.run([str(a) for a in arguments], capture_output=True, text=True, timeout=60, **how)


def events_of(record: Path) -> list[tuple[str, str]]:
    events = [event_t.decode(e.data) for e in lcmlog.read(record) if e.channel == "INERTIAD_EVENT"]
    return [(e.source, e.text) for e in events]


def last_health(record: Path) -> health_t:
    return [health_t.decode(e.data) for e in lcmlog.read(record) if e.channel == "INERTIAD_HEALTH"][-1]


def counters(result: subprocess.CompletedProcess) -> dict[str, int]:
    rows = [line.removeprefix("inertiad: ").split() for line in result.stderr.splitlines()]
    return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}


@pytest.mark.slow
def test_sensor_that_falls_silent_is_told_lost_and_back(run, tmp_path):
    lines = (run / "can.log").read_text().splitlines()
    begin = stamp(lines[0])
    force = {line.split()[2].split("#")[0] for line in lines if "#" in line}
    force = sorted(force)[-2:]  # the force frames have the highest identifiers
    kept = [x for x in lines if not (2.0 < stamp(x) - begin < 3.5 and x.split()[2].split("#")[0] in force)]
    log = tmp_path / "can.log"
    log.write_text("\n".join(kept) + "\n")
    result = daemon(run, log, tmp_path / "run.lcmlog")
    assert result.returncode == 0
    told = [(source, text.split(",")[0].split(" after ")[0]) for source, text in events_of(tmp_path / "run.lcmlog")]
    assert told == [("force", "lost"), ("force", "back")]
    back = events_of(tmp_path / "run.lcmlog")[1][1]
    assert float(back.split()[2]) == pytest.approx(1.5, abs=0.25)
    n = counters(result)
    assert (n["imu.silences"], n["force.silences"], n["position.silences"]) == (0, 1, 0)
    assert n["align.rows"] + sum(n[f"align.{c}"] for c in ("force.missing", "force.late", "overrun")) > 590


def test_force_sensor_that_sticks_is_named_and_done_without(run, tmp_path):
    lines = (run / "can.log").read_text().splitlines()
    begin = stamp(lines[0])
    is_force = [" 020#" in line for line in lines]  # forces 1 to 4, 16 bits each
    value = next(x[-8:-4] for x, f in zip(lines, is_force, strict=True) if f and stamp(x) - begin > 2.6)
    is_stuck = [f and 2.6 < stamp(x) - begin < 3.9 for x, f in zip(lines, is_force, strict=True)]
    log = tmp_path / "can.log"
    kept = [f"{x[:-8]}{value}{x[-4:]}" if s else x for x, s in zip(lines, is_stuck, strict=True)]
    log.write_text("\n".join(kept) + "\n")
    result = daemon(run, log, tmp_path / "run.lcmlog")
    assert result.returncode == 0
    events = [text for source, text in events_of(tmp_path / "run.lcmlog") if source == "force"]
    assert re.fullmatch(
        r"the sensor of cable 3 is stuck at \S+ N: the estimate goes on without it; check it", events[0]
    )
    assert re.fullmatch(r"the sensor of cable 3 is well again; \d+ samples were stuck", events[1])
    assert len(events) == 2
    n = counters(result)
    assert n["stuck.force.unknown"] == pytest.approx(123, abs=5)
    assert n["stuck.force.refused"] == 0
    assert n["detect.changes"] == 0


def test_late_sensor_is_reported_with_the_key_to_raise(run, tmp_path):
    robot = tmp_path / "robot"
    shutil.copytree(run, robot)
    text = (robot / "robot.toml").read_text()
    (robot / "robot.toml").write_text(text + "\n[align]\ndelay_position = 0.31\n")  # its stamps are its arrivals
    configuration.write(robot / "robot.cfg", description.load(robot / "robot.toml"), "robot.toml")
    result = daemon(robot, run / "can.log", tmp_path / "run.lcmlog")
    advice = r"samples arrive up to 0\.3\d\d s late; rows wait 0\.25 s: raise align\.max_wait to at least 0\.35"
    told = [text for source, text in events_of(tmp_path / "run.lcmlog") if source == "position"]
    assert len(told) == 1 and re.fullmatch(advice, told[0]), told
    assert re.fullmatch(f"inertiad: position: {advice}", result.stderr.splitlines()[-1])
    assert counters(result)["position.lateness_max_us"] == pytest.approx(310_000, abs=20_000)


def test_states_of_the_controller_are_told_once_and_counted(run, tmp_path):
    lines = (run / "can.log").read_text().splitlines()
    begin = stamp(lines[0])
    frames = {1.0: "20000004#0004000000000000", 2.0: "20000004#0010000000000000", 3.0: "20000040#0000000000000000"}
    frames |= {3.5: "20000100#0000000000000000", 4.0: "20000004#0001000000000000"}
    extra = [f"({begin + t:.6f}) can0 {frame}" for t, frame in frames.items() for _ in range(3)]
    log = tmp_path / "can.log"
    log.write_text("\n".join(sorted(lines + extra, key=stamp)) + "\n")
    result = daemon(run, log, tmp_path / "run.lcmlog")
    assert result.returncode == 0
    texts = [text for source, text in events_of(tmp_path / "run.lcmlog") if source == str(log)]
    assert texts[:6] == ["error-warning", "error-passive", "bus-off", "restarted", "restarted", "restarted"]
    assert "frames are being lost" in texts[6]
    n = counters(result)
    names = ("error_warning", "error_passive", "bus_off", "restarted", "controller_overruns", "error_frames")
    assert [n[f"bus0.{name}"] for name in names] == [1, 1, 1, 3, 3, 15]
    health = last_health(tmp_path / "run.lcmlog")
    assert (health.bus[0].name, bool(health.bus[0].up), health.bus[0].condition) == (str(log), True, 0)


def test_full_disk_is_told_and_counted_and_the_rest_goes_on(run, tmp_path):
    """A limit on the size of files stands for the full disk."""

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))

    result = daemon(run, run / "can.log", tmp_path / "run.lcmlog", preexec_fn=limit)
    assert result.returncode == 1  # the record of a replay is not whole
    n = counters(result)
    assert n["record.dropped"] > 0 and n["record.errors"] > 0 and n["rls.updates"] > 30
    assert f"lacks {n['record.dropped']} messages: File too large" in result.stderr
    remarks: list[str] = []
    assert len(list(lcmlog.read(tmp_path / "run.lcmlog", remarks))) == n["record.messages"] + 1 and not remarks


NETWORK_GONE = """
"$@" & daemon=$!
sleep 1.5
ip link set lo down
sleep 2.5
ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo
wait $daemon
"""


def test_network_that_goes_and_comes_back_stops_neither_record_nor_estimate(run, tmp_path):
    record, estimate = tmp_path / "run.lcmlog", tmp_path / "estimate.json"
    command = [DAEMON, "-v", "--config", run / "robot.cfg", "--bus", f"file:{run}/can.log?speed=1"]
    command += ["--tracker", f"file:{run}/tracker.csv", "--record", record, "--estimate", estimate]
    isolated = [*ISOLATED, "sh", "-c", NETWORK_GONE, "-", *map(str, command)]
    result = subprocess.run(isolated, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    n = counters(result)
    told = [text for source, text in events_of(record) if source == "lcm"]
    assert told == ["messages cannot be sent", f"messages are sent again; {n['lcm.failed']} were not sent"]
    assert 50 < n["lcm.failed"] < n["lcm.messages"]
    undisturbed = counters(daemon(run, run / "can.log", tmp_path / "undisturbed.lcmlog"))
    for name in ("bus0.frames", "align.rows", "rls.updates"):
        assert n[name] == undisturbed[name]
    assert n["record.dropped"] == 0 and n["record.messages"] >= undisturbed["record.messages"]


def test_latencies_are_measured_where_time_is_kept(run, tmp_path):
    lines = (run / "can.log").read_text().splitlines()
    log = tmp_path / "can.log"
    log.write_text("\n".join(lines[: len(lines) // 2]) + "\n")
    result = daemon(run, f"{log}?speed=1", tmp_path / "run.lcmlog")
    health = last_health(tmp_path / "run.lcmlog")
    decoded, estimate = health.latency
    assert (decoded.name, estimate.name) == ("decoded", "estimate")
    assert decoded.n == counters(result)["bus0.frames"] == sum(decoded.bucket)
    assert estimate.n > 50
    for x in (decoded, estimate):
        assert 0 < x.p50 <= x.p99 <= x.p999 <= x.longest < 1.0
    assert "latency.estimate: " in result.stderr
    daemon(run, log, tmp_path / "fast.lcmlog")
    assert [x.n for x in last_health(tmp_path / "fast.lcmlog").latency] == [0, 0]


def test_record_tells_the_machine_it_was_made_on(run, tmp_path):
    daemon(run, run / "can.log", tmp_path / "run.lcmlog")
    hosts = [host_t.decode(e.data) for e in lcmlog.read(tmp_path / "run.lcmlog") if e.channel == "INERTIAD_HOST"]
    facts = {fact.name: fact.value for fact in hosts[0].fact}
    assert platform.release() in facts["kernel"] and facts["host"] == platform.node()
    assert facts["scheduling"] == "SCHED_OTHER" and facts["clock.synchronised"].split(":")[0] in (
        "yes",
        "no",
        "unknown",
    )
    assert facts["processors"].endswith(f"of {os.cpu_count()}")
    command = [
        sys.executable,
        "-m",
        "inertiad",
        "watch",
        "--lcm",
        f"file://{tmp_path}/run.lcmlog?speed=0",
        "--seconds",
        "5",
    ]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=TOP)
    assert f"kernel: {facts['kernel'].split()[0]}" in shown.stdout, shown.stderr
