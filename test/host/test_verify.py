# SPDX-License-Identifier: Apache-2.0
"""verify passes a good run and fails one for every kind of damage: in the log, on the way, in the configuration."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import COGIRO, ISOLATED, TOP

import inertiad_core
from inertiad.base import installation
from inertiad.base.error import InputError
from inertiad.check import daemon_run, verify
from inertiad.control.daemon import Daemon
from inertiad.robot import configuration, dbc, description
from inertiad.run import lcmlog

pytestmark = pytest.mark.slow

DAEMON = TOP / "build/bin/inertiad"


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    """The paper's motion at 50 Hz."""
    run = tmp_path_factory.mktemp("verify") / "run"
    arguments = ["simulate", COGIRO / "robot.toml", "--rate", "50", "--faults", "modern", "--seed", "1", "-o", run]
    subprocess.run([sys.executable, "-m", "inertiad", *map(str, arguments)], check=True, capture_output=True, cwd=TOP)
    return run


@pytest.fixture
def run(good: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(good, tmp_path / "run"))


def failed(run: Path, **options: object) -> dict[str, str]:
    """Checks that fail, with what they say."""
    checks = verify.verify(verify.Options(run, **options), lambda _: None)  # type: ignore[arg-type]
    return {c.name: c.detail for c in checks if c.passed is False}


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def wrapper(path: Path, script: str) -> Path:
    """A daemon that changes what the real one gets. $@ are its arguments."""
    path.write_text(f'#!/usr/bin/env bash\nset -e\n{script}\nexec {DAEMON} "${{args[@]}}"\n')
    path.chmod(0o755)
    return path


def test_good_run_passes_and_says_so(inertiactl, run):
    result = inertiactl("verify", run)
    assert result.returncode == 0, result.stdout + result.stderr
    lines = result.stdout.splitlines()
    open_lines = [line for line in lines if not line.startswith("PASS")]
    unknown = "the configuration of the run is unknown, so changes since cannot be checked"
    assert open_lines == [f"OPEN  robot.toml: {unknown}: no robot.cfg and no CONFIG in a run.lcmlog"]
    assert re.fullmatch(r"PASS: (\d+) of (\d+) passed, 1 could not be made", lines[-1])
    assert any("estimates" in line and "bit-identical" in line for line in lines)
    document = json.loads((run / "verify.json").read_text())
    assert document["passed"] and len(document["checks"]) == len(lines) - 1


def test_frame_dropped_from_the_log_fails(inertiactl, run):
    lines = (run / "can.log").read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if i > 5000 and " 012#" in line)
    (run / "can.log").write_text("".join(lines[:at] + lines[at + 1 :]))
    result = inertiactl("verify", run)
    assert result.returncode == 1
    assert "FAIL  nothing lost or refused: group.imu.incomplete 1" in result.stdout
    assert "FAIL  counter IMU_RATE.counter: 1 steps of other than one" in result.stdout


def test_frame_dropped_on_the_way_fails(run, tmp_path):
    less = tmp_path / "less.log"
    script = f"sed 5000d {run}/can.log > {less}\n"
    script += f'args=(); for a in "$@"; do case $a in file:*can.log*) a=file:{less};; esac; args+=("$a"); done'
    found = failed(run, daemon=wrapper(tmp_path / "daemon", script))
    assert "frame 5000 was" in found["frames of bus 0"]
    assert "frames add up" in found


def test_swapped_byte_order_fails(run):
    edit(run / "platform.dbc", "f_1 : 0|16@1+", "f_1 : 7|16@0+")
    found = failed(run)
    assert {"batch fit", "truth", "nothing lost or refused"} & set(found)


def test_daemon_with_another_byte_order_fails(run, tmp_path):
    other = Path(shutil.copytree(run, tmp_path / "other"))
    signal = next(line for line in (run / "platform.dbc").read_text().splitlines() if " SG_ acc_x " in line)
    swapped = signal.replace("@1", "@0") if "@1" in signal else signal.replace("@0", "@1")
    start = int(signal.split(":")[1].split("|")[0])
    swapped = swapped.replace(f": {start}|", f": {start + 7 if '@1' in signal else start - 7}|")
    edit(other / "platform.dbc", signal, swapped)
    configuration.write(tmp_path / "other.cfg", description.load(other / "robot.toml"), "other")
    found = failed(run, config=tmp_path / "other.cfg")
    assert {"configuration", "decoder", "estimates"} <= set(found)


@pytest.mark.parametrize("factor", [1.02, 1.3])
def test_changed_coefficient_in_the_daemons_configuration_fails(run, tmp_path, factor):
    described = description.load(run / "robot.toml")
    config = configuration.config_of(described, dbc.bind(described, "x"))
    index = next(i for i, s in enumerate(config.signal) if s.quantity == inertiad_core.QUANTITIES["f_3"])
    config.signal[index].scale *= factor
    (tmp_path / "changed.cfg").write_bytes(configuration.to_bytes(config))
    found = failed(run, config=tmp_path / "changed.cfg")
    assert {"configuration", "estimates"} <= set(found)


def test_changed_coefficient_in_the_dbc_disagrees_with_the_runs_own_result(run, tmp_path):
    config = tmp_path / "robot.cfg"
    configuration.write(config, description.load(run / "robot.toml"), "run")
    command = [DAEMON, "--config", config, "--bus", f"file:{run}/can.log", "--tracker", f"file:{run}/tracker.csv"]
    command += ["--lcm", "none", "--estimate", run / "estimate.json"]
    subprocess.run([str(c) for c in command], check=True, capture_output=True)
    assert failed(run) == {}
    edit(run / "robot.toml", "weight_per_length = 0.628", "weight_per_length = 0.640")
    assert "the run's estimate.json" in failed(run)


def record_configuration(run: Path, record: str, data: bytes) -> None:
    """Leave a compiled configuration in the run as the daemon or a user does: in its record, or as a file."""
    if record == "robot.cfg":
        (run / record).write_bytes(data)
    else:
        log = lcmlog.Writer(run / record)
        log.write(0, "INERTIAD_CONFIG", data[:-4])
        log.close()


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        (
            "robot.toml",
            "weight_per_length = 0.628",
            "weight_per_length = 0.640",
            "cable[1].weight_per_length is 0.64, ",
        ),
        ("platform.dbc", None, None, "f_3.scale is "),
    ],
)
@pytest.mark.parametrize("record", ["robot.cfg", "run.lcmlog"])
def test_changed_coefficient_is_named_where_the_run_says_what_it_was_made_with(run, record, file, old, new, said):
    record_configuration(run, record, configuration.compile_robot(description.load(run / "robot.toml"), "run"))
    assert failed(run) == {}
    if old is None:
        old = next(line for line in (run / file).read_text().splitlines() if " SG_ f_3 " in line)
        scale = old[old.index("(") + 1 : old.index(",")]
        new = old.replace(f"({scale},", f"({1.02 * float(scale):.9g},")
    edit(run / file, old, new)
    assert f"differs from {record}, the configuration of the run: {said}" in failed(run)["robot.toml"]


@pytest.mark.parametrize("record", ["robot.cfg", "run.lcmlog"])
def test_run_compiled_blind_is_verified_without_nominal(run, record):
    blind = description.load(run / "robot.toml").model_copy(update={"nominal": None})
    record_configuration(run, record, configuration.compile_robot(blind, "run"))
    checks = {c.name: c for c in verify.verify(verify.Options(run), lambda _: None)}
    assert [c for c in checks.values() if c.passed is False] == []
    assert checks["robot.toml"].detail.endswith("the configuration of the run, compiled --blind")
    edit(run / "robot.toml", "weight_per_length = 0.628", "weight_per_length = 0.640")
    assert "cable[1].weight_per_length is 0.64, " in failed(run)["robot.toml"]


@pytest.mark.parametrize("record", ["robot.cfg", "run.lcmlog"])
def test_configuration_of_another_version_leaves_what_has_changed_open(run, record):
    data = (
        bytes(8) + configuration.compile_robot(description.load(run / "robot.toml"), "run")[8:]
    )  # another fingerprint
    record_configuration(run, record, data)
    checks = {c.name: c for c in verify.verify(verify.Options(run), lambda _: None)}
    assert checks["robot.toml"].passed is None
    assert checks["robot.toml"].detail.endswith(f"cannot be checked: {record} was written by another version")
    assert [c for c in checks.values() if c.passed is False] == []


def test_record_without_the_configuration_leaves_what_has_changed_open(run):
    log = lcmlog.Writer(run / "run.lcmlog")
    log.write(0, "INERTIAD_TRACKER", b"")
    log.close()
    (check,) = [c for c in verify.verify(verify.Options(run), lambda _: None) if c.name == "robot.toml"]
    assert check.passed is None and check.detail.endswith("no robot.cfg and no CONFIG in its run.lcmlog")


def test_wrong_truth_fails(run):
    truth = json.loads((run / "truth.json").read_text())
    (run / "truth.json").write_text(json.dumps(truth | {"mass": truth["mass"] + 5.0}))
    assert list(failed(run)) == ["truth"]


def test_daemon_that_crashes_fails(run, tmp_path):
    daemon = tmp_path / "daemon"
    daemon.write_text("#!/bin/sh\nkill -SEGV $$\n")
    daemon.chmod(0o755)
    assert "exit status -11" in failed(run, daemon=daemon)["daemon"]


def test_unusable_run_is_one_line_and_exit_2(inertiactl, run):
    (run / "tracker.csv").unlink()
    result = inertiactl("verify", run)
    assert result.returncode == 2
    assert "tracker.csv: not found" in result.stderr and len(result.stderr.splitlines()) == 1


STALLING = """
"$DAEMON" "$@" &
pid=$!
trap 'kill -CONT $pid; kill -TERM $pid' TERM
(while kill -STOP $pid 2>/dev/null; do sleep 1.3; kill -CONT $pid 2>/dev/null; sleep 0.7; done) &
while kill -0 $pid 2>/dev/null; do wait $pid; status=$?; done
exit $status
"""


def test_estimates_are_bit_identical_when_the_daemon_stalls_for_seconds(run, tmp_path, can_over_udp):
    """On a live bus, whose frames and positions a stalled daemon finds in two queues, in no order of their stamps."""
    text = (run / "robot.toml").read_text()
    (run / "robot.toml").write_text(text + "\n[align]\nmax_wait = 0.05\n")
    stalling = tmp_path / "stalling"
    stalling.write_text(f"#!/usr/bin/env bash\nDAEMON={DAEMON}{STALLING}")
    stalling.chmod(0o755)
    command = ["verify", run, "--bus", "socketcan:vcan0", "--daemon", stalling, "--latency-max", "10"]
    command = [*ISOLATED, "env", f"LD_PRELOAD={can_over_udp}", sys.executable, "-m", "inertiad", *command]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=180)
    lines = {line[6:].split(": ")[0]: line for line in done.stdout.splitlines()}
    assert lines["messages"].startswith("PASS") and lines["frames add up"].startswith("PASS"), done.stdout + done.stderr
    assert lines["rows recomputed"].endswith("bit-identical") and lines["rows recomputed"].startswith("PASS"), (
        done.stdout
    )
    assert lines["estimates"].endswith("bit-identical") and lines["estimates"].startswith("PASS"), done.stdout


def test_missing_daemon_names_the_option_where_there_is_one(run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(installation, "SOURCE_TREE", tmp_path)
    with pytest.raises(InputError, match=r"not found; run make build, or pass --daemon FILE$"):
        verify.verify(verify.Options(run), lambda _: None)
    with pytest.raises(InputError, match=r"not found; run make build$"):
        Daemon(run / "robot.cfg", tmp_path / "said")


def test_times_since_1970_of_a_tracker_file_are_the_daemons():
    """A double holds them to 0.2 us only; the daemon reads the digits."""
    for t_ns in range(1_763_650_456_278_868_000, 1_763_650_456_378_868_000, 8_333_000):
        assert daemon_run.seconds(t_ns) == float(f"{t_ns // 10**9}.{t_ns % 10**9:09d}")
    assert daemon_run.seconds(123_456_789) == 0.123456789
